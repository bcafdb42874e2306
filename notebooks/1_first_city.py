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
# # 1. A first city in ten lines
#
# **Which way would a drone fly through a city, and why not straight?**
#
# The city is Lower Manhattan: buildings of OpenStreetMap, the 2010 census and nominal GPS satellites come with the
# package, so nothing is downloaded. The ten lines read it, make its maps on cells of 10 m, and plan from the
# Battery to the East Village at 20 m above ground, with three planners. Places are longitude and latitude, as a map on
# the web gives them. The first call on a machine compiles for some ten seconds; later ones take seconds.
#
# - `ptp` (point to point) flies straight, and fails where a building stands in the way;
# - `astar-dist` and `astar-plus` search for the path of least **cost**: 0.1 a metre flown, plus what each cell on
#   the way costs in GPS quality, lidar quality, people below and nearness of walls. They find equally cheap paths by
#   different estimates of what is still to come (notebook 3).

# %%
# %matplotlib inline
import jaxurban as ju
from jaxurban.plot import plot_overview, plot_paths, plot_profile
from jaxurban.settings import PlannerName

city = ju.sample_city("lower-manhattan")
maps = ju.build_maps(city, resolution_m=10.0)
start, goal = (-74.0162, 40.7036), (-73.9904, 40.7289)  # longitude, latitude
planners: tuple[PlannerName, ...] = ("ptp", "astar-dist", "astar-plus")
paths = [ju.plan(maps, start, goal, altitude_m=20.0, planner=p, snap=True) for p in planners]
for path in paths:
    print(
        f"{path.search.planner:12}{path.status.value:10} cost {path.cost:8.1f}  length {path.length_m:7.0f} m"
    )

# %% [markdown]
# ## What the planner sees
#
# All that costs the path, at 20 m. Quality is 1 at best and 0 at worst; a planner pays for what is missing
# from 1, and for people as they are. The last panel adds the four up: dark is good to fly over, and the circle is the
# start, the star the goal.

# %%
plot_overview(maps, paths)

# %% [markdown]
# ## The paths, closer
#
# The two A\* paths cost the same, and where routes coincide the first is the wider line. The maps hold four altitudes;
# here is the one that was asked for.

# %%
plot_paths(maps, paths)

# %% [markdown]
# ## Why this way
#
# `explain` takes the route apart: what each layer cost (`=distance` and so on add up to `cost`), how few satellites
# were in view, how near the walls came.

# %%
report = ju.explain(paths[-1], maps)
print(report.table())
plot_profile(paths[-1], maps, report)

# %% [markdown]
# ## Where to go from here
#
# - What the maps show, altitude by altitude: notebook 2.
# - Other planners, and how they compare: notebook 3.
# - What would change this route: buildings (notebook 4), weights (notebooks 5 and 6).
# - A city of your own: notebook 7. A cost of your own: notebook 8. Many routes and cities: notebook 9.
# - How fine the cells must be: notebook 10. Batches of maps under `jax.vmap`: notebook 11.

# %% [markdown]
# ## A question to try
#
# Which of the three paths changes if you fly at 60 m instead of 20 m? Set `altitude_m=60.0`, and look at the costs:
# which layers cost less, and which cost more?
