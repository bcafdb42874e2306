# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 10. Which resolution do I need?
#
# **How small must a cell be before a route over the maps stays the same?**
#
# Cells of half the side are four times as many, and so are the bytes of every map. Too large ones close streets that
# are open, and blur what GPS and lidar see between two walls. So make the maps of a part of your city at several
# resolutions, and look at what you will use: the share of free cells, the means over the streets, and the routes. Here
# the city is Shinjuku in Tokyo, with the roofs of Project PLATEAU. The first call on a machine compiles for about half
# a minute.

# %%
# %matplotlib inline
import time

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.plot import plot_paths

city = ju.sample_city("shinjuku")
SIDES_M = (20.0, 10.0, 5.0, 2.5)
maps, seconds = {}, {}
for side_m in SIDES_M:
    began = time.process_time()
    maps[side_m] = ju.build_maps(city, resolution_m=side_m, altitudes_m=(30.0,), progress=False)
    seconds[side_m] = time.process_time() - began

# %% [markdown]
# ## What the maps say
#
# `free` is the share of the region where a planner may fly at 30 m. The means are over the cells that are free and
# nearer than 50 m to an obstacle: the streets. `CPU (s)` is what the maps took; the first row holds what had to be
# loaded or compiled. On a region as small as this one the number of cells hardly shows in it.

# %%
rows = {}
for side_m, made in maps.items():
    is_street = made.is_free(30.0) & (made.m("risk", 30.0) < 1)
    names = {"gps": "mean m_gps", "lidar": "mean m_lidar", "risk": "mean m_risk"}
    means = {text: np.nanmean(made.m(name, 30.0)[is_street]) for name, text in names.items()}
    rows[side_m] = {"free": made.is_free(30.0).mean(), **means, "CPU (s)": seconds[side_m]}
pd.DataFrame(rows).T.rename_axis("cell (m)").round(3)

# %% [markdown]
# ## What the routes say
#
# Pairs of places that streets join on the coarsest maps, planned on the maps of each resolution. A route is judged on
# the finest maps: what would it cost there, and would it be free at all? Its *regret* is by how much it then exceeds
# the cheapest route of the finest maps. Ends are moved to the centre of a free cell, which is another place at every
# resolution: a regret of a few per cent, above or below 0, is of the ends.

# %%
finest = maps[SIDES_M[-1]]
truth = ju.cost_map(finest, 30.0)
pairs = ju.studies.sample_instances(maps[SIDES_M[0]], 40, weights=[ju.Weights()], seed=3).query(
    "is_connected"
)
corner_m = np.array([finest.grid.x_min_m, finest.grid.y_min_m])
ends_of = [
    (finest.grid.lonlat_of_xy(x0, y0), finest.grid.lonlat_of_xy(x1, y1))
    for x0, y0, x1, y1 in pairs[["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]].to_numpy()
]
routes = []
for number, ends in enumerate(ends_of):
    best = truth.plan(*ends, snap=True)
    for side_m in SIDES_M[:-1]:
        planned = ju.plan(maps[side_m], *ends, altitude_m=30.0, snap=True)
        if best.status.has_path and planned.status.has_path:
            cost = truth.problem.cost_of(planned.xy_m - corner_m)
            routes.append(
                {
                    "pair": number,
                    "cell (m)": side_m,
                    "regret (%)": 100 * (cost / best.cost - 1),
                    "is blocked": np.isinf(cost),
                }
            )
judged = pd.DataFrame(routes)
open_ones = judged[~judged["is blocked"]].groupby("cell (m)")["regret (%)"]
pd.DataFrame(
    {
        "routes": judged.groupby("cell (m)").size(),
        "blocked on the finest maps": judged.groupby("cell (m)")["is blocked"].sum(),
        "median regret (%)": open_ones.median(),
        "worst regret (%)": open_ones.max(),
    }
).round(2)

# %%
plt.style.use("tableau-colorblind10")
figure, axes = plt.subplots(figsize=(7.5, 3.8), layout="constrained")
is_open = ~judged["is blocked"]
for side_m in SIDES_M[:-1]:
    regret = np.sort(judged[is_open & (judged["cell (m)"] == side_m)]["regret (%)"])
    axes.plot(regret, np.linspace(0, 100, len(regret)), marker=".", label=f"cells of {side_m:g} m")
axes.set(
    xlabel=f"regret of a route on the maps of {SIDES_M[-1]:g} m (%)",
    ylabel="share of the routes (%)",
)
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## Where they part
#
# The pair with the largest regret, planned on the coarsest and on the finest maps, drawn over the finest.

# %%
coarsest = judged[judged["cell (m)"] == SIDES_M[0]]
largest = coarsest["regret (%)"].replace(np.inf, -1).argmax()
ends = ends_of[coarsest["pair"].to_numpy()[largest]]
two = [
    ju.plan(maps[side_m], *ends, altitude_m=30.0, snap=True) for side_m in (SIDES_M[0], SIDES_M[-1])
]
plot_paths(finest, two, names=[f"{side_m:g} m cells" for side_m in (SIDES_M[0], SIDES_M[-1])])

# %% [markdown]
# So: plan on cells that are small against the streets that must stay open, and check with half the side. What the
# maps' own values miss by resolution, city by city, is in [how accurate](../docs/evidence/accuracy.md).

# %% [markdown]
# ## A question to try
#
# `oversample=5` makes the values of finer rays without larger maps. Does `ju.build_maps(city, resolution_m=10.0,
# oversample=5, ...)` come nearer to the maps of 2.5 m than plain cells of 10 m do?
