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
# # 5. Fitting weights from routes
#
# **A pilot has shown some routes. Which weights would make a planner choose as the pilot does?**
#
# A route says what its pilot cares about: who flies around a crowd accepts metres to spare people. Here the pilot is a planner
# with weights that we keep to ourselves, so that the answer can be checked. In real work the routes come from a file
# (`jaxurban.studies.examples`).

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np

import jaxurban as ju
from jaxurban.plotting import plot_paths
from jaxurban.studies.examples import example_from_path
from jaxurban.studies.imitation import fit_weights
from jaxurban.studies.queries import unit_map

city = ju.demo_city(width_m=2_000, height_m=3_000)
maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,))
hidden = ju.Weights(distance=0.05, gps=0.4, lidar=0.3, population=4.0, risk=1.0)
pilot = ju.weigh(maps, 20.0, weights=hidden)

# %% [markdown]
# ## The routes that the pilot shows
#
# Sixteen flights between random free cells.

# %%
free = np.argwhere(pilot.is_free)
shown = []
for a, b in np.random.default_rng(1).choice(free, (16, 2)):
    flown = pilot.plan(start_xy_m=maps.grid.xy_of_cell(*a), goal_xy_m=maps.grid.xy_of_cell(*b))
    if flown.status.has_path and flown.length_m > 500:
        shown.append(flown)
print(f"{len(shown)} routes of {min(p.length_m for p in shown):,.0f} to {max(p.length_m for p in shown):,.0f} m")

# %% [markdown]
# ## The fit
#
# Only ratios of weights can be found: twice all weights choose the same routes. So they are scaled to sum to 1, here and in the
# pilot's own. `low` and `high` bound the weight in 90 % of fits to routes drawn anew from the sixteen.

# %%
unit = unit_map(maps, 20.0)
fit = fit_weights([example_from_path(unit, flown) for flown in shown], bootstrap=50)
for warning in fit.warnings:
    print(warning)
own = np.array([getattr(hidden, name) for name in fit.names])
table = fit.table().drop(columns="spread")
table.insert(0, "pilot's own", own / own.sum())
table.round(4)

# %%
figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
place = np.arange(len(fit.names))
reach = np.abs(fit.interval - fit.vector)
axes.errorbar(place, fit.vector, yerr=reach, fmt="o", capsize=4, label="fitted, 5 to 95 %")
axes.plot(place, own / own.sum(), "kx", markersize=9, label="the pilot's own")
axes.set_xticks(place, fit.names)
axes.set(yscale="log", ylabel="weight, all summing to 1", xlabel="what is weighed (distance: a metre; others: a cell)")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# ## How it was found
#
# Each round searches for routes under the weights so far and moves these until the pilot's routes are as near to the cheapest as
# they can be. *Regret* is by how much they are dearer than the cheapest routes known.

# %%
figure, axes = plt.subplots(figsize=(7.5, 3.2), layout="constrained")
axes.plot(fit.curve["round"], 100 * fit.curve["mean_regret"], "o-")
axes.set(xlabel="round of searches", ylabel="mean regret of the pilot's routes (%)", yscale="log")
axes.set_xticks(fit.curve["round"])
plt.show()
print(f"{fit.num_plans} searches in {fit.elapsed_s:.1f} s; regret in the end {100 * fit.regret.mean():.4f} %")

# %% [markdown]
# ## Would it choose as the pilot does?
#
# A flight that was not among the examples: the default weights, and the fitted ones. The lines are drawn under each planner's
# name: `astar-dist` carries the default weights here and `astar-plus` the fitted ones. (Their costs cannot be compared, since each is
# in its own weights.)

# %%
x_m, y_m = maps.grid.x_m, maps.grid.y_m
ends = {"start_xy_m": (x_m[30], y_m[20]), "goal_xy_m": (x_m[62], y_m[120]), "altitude_m": 20.0, "snap": True}
default = ju.plan(maps, **ends, planner="astar-dist")
fitted = ju.plan(maps, **ends, weights=fit.weights)
asked = ju.plan(maps, **ends, weights=hidden)
corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
for name, path in (("default", default), ("fitted", fitted), ("the pilot", asked)):
    paid = pilot.evaluate(path.xy_m - corner_m).total
    print(f"{name:10} in the pilot's own weights {paid:7.2f}, {100 * (paid / asked.cost - 1):5.2f} % above the pilot's route")
plot_paths(maps, {20.0: [default, fitted]})
