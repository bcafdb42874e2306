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
# # 6. What would change this route?
#
# **How far may a weight be off before the drone flies another way?**
#
# Weights are judgement: nobody measures how many metres a pedestrian is worth. So what matters is where the answer
# changes. The cheapest route stays the same over a range of weights, then **changes** to another at once, at a
# *breakpoint*. `ju.studies.sensitivity` finds every breakpoint, each weight from a tenth to ten times its value, and
# proves by searches that none is missing. The first call on a machine compiles for some ten seconds.

# %%
# %matplotlib inline
import shutil
import tempfile
from pathlib import Path

import jaxurban as ju
from jaxurban.plot import plot_breakpoint_routes, plot_paths

folder = Path(tempfile.mkdtemp())
city = ju.sample_city("lower-manhattan")
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0,))
start, goal = (
    (-74.0162, 40.7036),
    (-73.9817, 40.7265),
)  # longitude, latitude: the Battery, Tompkins Square
found = ju.studies.sensitivity(
    maps, folder / "one", [(start, goal)], altitudes_m=[20.0], snap=True, progress=False
)
route = found.route  # none where no path joins the ends
assert route is not None
found.decided

# %% [markdown]
# ## What the route is made of
#
# `elasticity` is the weight's share of the cost. A share is a level: a number added to a layer everywhere raises it and
# changes no route, so it says nothing of how much a weight matters. `regret` is what a weight twice too large or too
# small would cost.

# %%
found.tables["weights"][["weight_name", "elasticity", "below", "above", "regret"]].round(3)

# %% [markdown]
# ## One weight at a time
#
# Each route that is the cheapest somewhere along the range of a weight.

# %%
plot_breakpoint_routes(route)

# %% [markdown]
# Most breakpoints move the route by a cell or two. At which `factor` does the drone fly another way, which keeps less
# than half of its cells, and what does that cost?

# %%
found.tables["ways"].round(3)

# %% [markdown]
# The routes along one weight as a table: each row is a route, cheapest `from` one value of the weight `to` another;
# `is_given` marks the route under the given weights. `people` is metres flown at the region's highest density; `mean_*`
# the mean of a map along the route.

# %%
route.breakpoints("lidar").drop(columns="weight_name").round(3)

# %% [markdown]
# ## Try it yourself
#
# The cheapest route under weights of your own, beside the shortest one (in blue), which no weight changes.

# %%
mine = {"distance": 0.1, "gps": 1.0, "lidar": 1.0, "population": 1.0, "risk": 1.0}
on = ju.cost_map(maps, 20.0, weights=mine)
shortest = ju.cost_map(maps, 20.0, objective="distance").plan(start, goal, snap=True)
plot_paths(maps, [shortest, on.plan(start, goal, snap=True)], names=["shortest", "my weights"])

# %% [markdown]
# In a running notebook the viewer has sliders: set two ends, let a slider go, and the route is planned again.

# %%
ju.view(maps, weights=mine)

# %% [markdown]
# The report, with all tables and pictures, lies in `folder / "one"`. It can be deleted:

# %%
shutil.rmtree(folder)

# %% [markdown]
# ## A question to try
#
# Which weight could you leave out altogether? Set it to 0 in `mine`, and compare the cost by the given weights.
