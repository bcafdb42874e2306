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
# # A first city in ten lines
#
# *What do GPS, lidar, people and walls look like to a drone over a city, and which way would it fly?*
#
# The city here is the embedded one: generated, and shaped like Manhattan. For real files see the README.

# %%
import jaxurban as ju
from jaxurban.plotting import plot_metric, plot_paths, plot_sensor_choice

city = ju.demo_city(width_m=2_000, height_m=3_000)
maps = ju.build_maps(city, resolution_m=10.0)
x_m, y_m = maps.grid.x_m, maps.grid.y_m
ends = {"start_xy_m": (x_m[60], y_m[40]), "goal_xy_m": (x_m[125], y_m[240])}
paths = [ju.plan(maps, **ends, altitude_m=20.0, planner=p, snap=True) for p in ("ptp", "astar-dist", "astar-plus")]
for path in paths:
    print(f"{path.search.planner:12}{path.status.value:10} cost {path.cost:8.1f}  length {path.length_m:7.0f} m")

# %% [markdown]
# GPS quality `m_gps` by altitude: 1 is the best geometry there is, 0 means that GPS is not to be relied on.

# %%
plot_metric(maps, "gps")

# %% [markdown]
# Where a lidar sees more than GPS does: deep in the streets.

# %%
plot_sensor_choice(maps)

# %% [markdown]
# The cost of all four metrics together, and the paths over it.

# %%
plot_paths(maps, {20.0: paths})
