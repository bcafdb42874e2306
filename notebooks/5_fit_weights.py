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
# A route says what its pilot cares about: who flies around a crowd spends metres to spare people. Here the pilot is a
# planner with weights of its own, so that the answer can be checked. In real work the routes come from a file
# (`ju.fit.demonstrations`, or `jaxurban tune` on the command line: [weights](../docs/guides/weights.md)). The
# first call on a machine compiles for some ten seconds.

# %%
# %matplotlib inline
import numpy as np

import jaxurban as ju
from jaxurban.plot import plot_fitted_routes, plot_paths, plot_weights
from jaxurban.studies.demonstrations import optimal_demonstrations

city = ju.sample_city("lower-manhattan")
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0,))
own = ju.Weights(distance=0.05, gps=0.4, lidar=0.3, population=4.0, risk=1.0)
pilot = ju.cost_map(maps, 20.0, weights=own)

# %% [markdown]
# ## The routes that the pilot shows
#
# Sixteen flights, short and long, from and to all kinds of places.

# %%
places = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
flights = ju.studies.sample_instances(maps, 20, weights=[own], seed=1).query("is_connected")[:16]
shown = [pilot.plan(ju.XY(x0, y0), ju.XY(x1, y1)) for x0, y0, x1, y1 in flights[places].to_numpy()]
demonstrations = ju.fit.demonstrations(shown, maps)
print(
    f"{len(shown)} routes of {min(p.length_m for p in shown):,.0f} to {max(p.length_m for p in shown):,.0f} m"
)

# %% [markdown]
# ## The fit
#
# Only ratios of weights can be found: twice all weights choose the same routes. So they are scaled to sum to 1, the
# pilot's own too. The weight of `distance` counts per metre, the others per 5 m of the route.

# %%
fit = ju.fit.fit_weights(demonstrations, bootstrap=50)
print(fit.sentence, *fit.cautions, sep="\n")
table = fit.table.copy()
vector = np.array([getattr(own, name) for name in fit.names])
table.insert(0, "pilot's own", vector / vector.sum())
table.round(4)

# %%
plot_weights(fit)

# %% [markdown]
# ## How it was found
#
# Each round searches for routes under the weights so far, and moves these until the pilot's routes are as near to the
# cheapest as they can be. *Regret* is by how much they exceed the cost of the cheapest route.

# %%
fit.curve[["round", "mean_regret", "worst_gap"]].tail()

# %%
planned = optimal_demonstrations([shown.query for shown in demonstrations], fit.weights)
plot_fitted_routes(demonstrations, planned, demonstrations[0].query.cost_map, fit.vector)

# %% [markdown]
# ## Would it choose as the pilot does?
#
# Twenty flights that were not demonstrated, planned under the default weights and under the fitted ones, and
# costed as the pilot would.

# %%
corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
others = ju.studies.sample_instances(maps, 20, weights=[own], seed=2).query("is_connected")
for name, weights in (("default weights", ju.Weights()), ("fitted weights", fit.weights)):
    weighted = ju.cost_map(maps, 20.0, weights=weights)
    regret = []
    for x0, y0, x1, y1 in others[places].to_numpy():
        ends = ju.XY(x0, y0), ju.XY(x1, y1)
        cost = pilot.problem.cost_of(weighted.plan(*ends).xy_m - corner_m)
        regret.append(100 * (cost / pilot.plan(*ends).cost - 1))
    print(
        f"{name}: {np.mean(regret):.2f} % above the pilot's routes on average, {max(regret):.2f} % at worst"
    )

# %% [markdown]
# One of them.

# %%
battery, tompkins_square = (-74.0162, 40.7036), (-73.9817, 40.7265)  # longitude, latitude
two = [
    ju.plan(maps, battery, tompkins_square, altitude_m=20.0, snap=True, weights=each)
    for each in (None, fit.weights)
]
plot_paths(maps, two, names=["default weights", "fitted weights"])

# %% [markdown]
# ## A question to try
#
# How few routes are enough? Fit to the first 3, 5 and 10 of `shown`, and watch the intervals of `fit.table` widen.
