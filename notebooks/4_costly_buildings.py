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
# # 4. Which buildings cost this route most?
#
# **If one building were a metre higher, how much more would the route cost?**
#
# A building hides satellites from some cells (GPS), stands close to others (risk), and is a landmark for the lidar.
# What a route costs is a function of the heights of all buildings, so its **gradient** answers the question for all of
# them at once.
#
# The maps themselves change by jumps: a cell's centre lies on one side of a shadow's edge or on the other. So the
# gradient is taken on *soft* maps, where a roof fades over some 2 m of height instead of ending at once.

# %%
# %matplotlib inline
from dataclasses import replace

import geopandas as gpd
import jax
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import SymLogNorm

import jaxurban as ju
from jaxurban.plot import plot_paths

city = ju.demo_city(width_m=1_600, height_m=1_600)
buildings = city.buildings
assert buildings is not None  # other cities may come as rasters of roofs alone
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(25.0,))
x_m, y_m = maps.grid.x_m, maps.grid.y_m
ends = ju.XY(x_m[48], y_m[20]), ju.XY(x_m[100], y_m[140])
route = ju.cost_map(maps, 25.0).plan(*ends, snap=True)
print(
    f"{len(buildings):,} buildings; the route costs {route.cost:.1f} over {route.length_m:,.0f} m"
)

# %% [markdown]
# ## One gradient for all buildings
#
# `soft_city` holds the city ready to be differentiated; `building_costs` ranks the buildings by what a metre more of
# each costs the route, and says through which map. Negative numbers are buildings that help: walls that the lidar sees.
# Doubles (`x64`) keep small effects from drowning in rounding.

# %%
params = ju.grad.SoftParams(altitude_m=25.0)
with jax.enable_x64(True):
    soft = ju.grad.soft_city(city, maps.grid, params)
    table = ju.studies.building_costs(city, soft, route, params)
columns = ["building", "per_metre", "gps", "lidar", "risk", "height_m", "distance_m"]
print(f"{len(table):,} buildings have any effect. The costliest, in cost per metre of height:")
table[columns].head(8).round(3)

# %% [markdown]
# Red costs, blue helps, on a logarithmic scale on both sides of zero.

# %%
outlines = gpd.GeoDataFrame(table, geometry=buildings.polygons[table["building"]])
most = table["per_metre"].abs().max()
panel = outlines.plot(
    "per_metre",
    cmap="RdBu_r",
    norm=SymLogNorm(most / 1000, vmin=-most, vmax=most),
    legend=True,
    legend_kwds={"label": "cost per metre of height (1/m)"},
    figsize=(7.5, 6.0),
)
panel.plot(*route.xy_m.T, color="black")
panel.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
plt.show()

# %% [markdown]
# ## Which of the buildings matter
#
# Those whose roofs end near the route's altitude cost most: a metre more, and they stand in the way. Higher ones only
# lengthen shadows (GPS); lower ones are landmarks that would mostly be better for being higher (lidar, below zero).
# Effects under 0.001 are left out.

# %%
figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
for name, colour, marker in (
    ("risk", "#009e73", "^"),
    ("gps", "#0072b2", "o"),
    ("lidar", "#e69f00", "s"),
):
    felt = table[table[name].abs() >= 1e-3]
    axes.scatter(felt["height_m"], felt[name], s=20, color=colour, marker=marker, label=name)
axes.axvline(
    route.altitude_m, color="black", linewidth=0.8, linestyle=":", label="altitude of the route"
)
axes.axhline(0, color="black", linewidth=0.5)
axes.set(xlabel="height of the building (m)", ylabel="cost per metre of height (1/m)", xscale="log")
axes.set_xticks([5, 10, 20, 50, 100], ["5", "10", "20", "50", "100"])
axes.minorticks_off()
axes.set_yscale("symlog", linthresh=1e-2)
axes.set_ylim(-0.2, 10)
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## Does the gradient tell the truth?
#
# Raise some buildings by 4 m, one at a time, make the **exact** maps again, and weigh the same route on them. A
# gradient is a promise about small changes, and the exact maps answer in jumps: expect the sign to agree, and the size
# within a factor of a few. `inf` means that the roof now reaches the route, which no cost can pay for; planned again,
# the drone flies around it, and its route costs more by the last column.

# %%
STEP_M = 4.0
corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
rows = {}
for rank, row in table.iloc[[0, 1, 2, 6, 7, -2, -1]].to_dict("index").items():
    height_m = buildings.height_m.copy()
    height_m[row["building"]] += STEP_M
    higher = replace(city, buildings=replace(buildings, height_m=height_m))
    again = ju.cost_map(ju.build_maps(higher, resolution_m=10.0, altitudes_m=(25.0,)), 25.0)
    rows[rank] = {
        "height (m)": row["height_m"],
        "gradient x 4 m": STEP_M * row["per_metre"],
        "same route, exact maps": again.problem.cost_of(route.xy_m - corner_m) - route.cost,
        "planned again": again.plan(*ends, snap=True).cost - route.cost,
    }
pd.DataFrame(rows).T.rename_axis("rank").round(3)

# %% [markdown]
# ## Follow the gradient
#
# Change the city a little, where it helps the route most, and look again: in each round the twenty costliest roofs
# sink by 1 m, those that help (negative) rise by 1 m. The gradient promises what a round saves on soft maps. The exact
# maps save less: to them a roof just under the route's altitude is no obstacle already, while the soft maps charge for
# nearly being one.

# %%
ROUNDS, ROOFS, METRES = 6, 20, 1.0
changed, changed_buildings, planned, rounds = city, buildings, route, []
for number in range(ROUNDS + 1):
    if number:
        changed_maps = ju.build_maps(changed, resolution_m=10.0, altitudes_m=(25.0,))
        planned = ju.cost_map(changed_maps, 25.0).plan(*ends, snap=True)
    with jax.enable_x64(True):
        slopes = ju.studies.building_costs(
            changed, ju.grad.soft_city(changed, maps.grid, params), planned, params
        )
    worst = slopes.reindex(slopes.per_metre.abs().sort_values(ascending=False).index).head(ROOFS)
    promised = METRES * worst.per_metre.abs().sum()
    rounds.append(
        {
            "soft cost": slopes.attrs["soft_cost"],
            "cost": planned.cost,
            "promised for the next round": promised,
        }
    )
    height_m = changed_buildings.height_m.copy()
    height_m[worst.building] = np.maximum(
        height_m[worst.building] - METRES * np.sign(worst.per_metre), 1.0
    )
    changed_buildings = replace(changed_buildings, height_m=height_m)
    changed = replace(changed, buildings=changed_buildings)
saved = pd.DataFrame(rounds).rename_axis("rounds")
for kind in ("soft cost", "cost"):
    saved[f"saved of {kind} by the next"] = -saved[kind].diff().shift(-1)
saved.round(2)

# %% [markdown]
# The first route and the last one, over the first city's maps. The last is what the changed city makes cheapest.

# %%
plot_paths(maps, [route, planned], names=["as the city is", f"after {ROUNDS} rounds"])

# %% [markdown]
# ## A question to try
#
# Which is cheaper for the city: to lower twenty roofs by a metre each, or two by ten? Set `ROOFS` and `METRES`, and
# compare the last row.
