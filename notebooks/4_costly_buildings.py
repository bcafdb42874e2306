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
# **If one building were a metre higher, how much dearer would the route be?**
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

import jax
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.build import soft_city, view_sky
from jaxurban.layers import MapParams
from jaxurban.plotting.buildings import plot_building_costs
from jaxurban.soft.engine import SoftParams
from jaxurban.studies.buildings import building_costs

city = ju.demo_city(width_m=1_600, height_m=1_600)
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(25.0,))
x_m, y_m = maps.grid.x_m, maps.grid.y_m
ends = {"start_xy_m": (x_m[48], y_m[20]), "goal_xy_m": (x_m[100], y_m[140])}
route = ju.plan(maps, **ends, altitude_m=25.0, snap=True)
print(f"{len(city.buildings):,} buildings; the route costs {route.cost:.1f} over {route.length_m:,.0f} m")

# %% [markdown]
# ## One gradient for all buildings
#
# `soft_city` holds the city ready to be differentiated; `building_costs` ranks the buildings by what a metre more of
# each costs the route, and says through which map. Negative numbers are buildings that help: walls that the lidar sees.
# Doubles (`x64`) keep small effects from drowning in rounding.

# %%
sky = view_sky(maps.grid, "nominal", maps.times, mask_deg=5.0, reference=None, max_age_days=90.0)
with jax.enable_x64(True):
    soft = soft_city(city, maps.grid, sky, MapParams(altitudes_m=(25.0,)), dtype=np.float64)
    table = building_costs(city, soft, route, SoftParams(25.0))
columns = ["building", "per_metre", "gps", "lidar", "risk", "height_m", "distance_m"]
print(f"{len(table):,} buildings have any effect. The costliest, in cost per metre of height:")
table[columns].head(8).round(3)

# %%
plot_building_costs(city, route, table, maps.grid)

# %% [markdown]
# ## Which of the buildings matter
#
# Heights near the route's altitude decide: much lower roofs are below all rays, and of much higher ones a metre more
# changes only long shadows.

# %%
figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
for name, colour in (("gps", "#0072b2"), ("lidar", "#e69f00"), ("risk", "#009e73")):
    axes.scatter(table["height_m"], table[name], s=16, color=colour, label=name)
axes.axvline(route.altitude_m, color="black", linewidth=0.8, linestyle=":", label="altitude of the route")
axes.set(xlabel="height of the building (m)", ylabel="cost per metre of height (1/m)", xscale="log")
axes.set_yscale("symlog", linthresh=1e-2)
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## Does the gradient tell the truth?
#
# Raise each of the three costliest buildings, and of the two that help most, by 4 m, make the **exact** maps again, and
# weigh the same route on them. The sign should agree and the size roughly: a gradient is a promise about small changes,
# and the exact maps answer in jumps.

# %%
STEP_M = 4.0
corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
rows = {}
for row in pd.concat([table.head(3), table.tail(2)]).itertuples():
    height_m = city.buildings.height_m.copy()
    height_m[row.building] += STEP_M
    higher = replace(city, buildings=replace(city.buildings, height_m=height_m))
    again = ju.weigh(ju.build_maps(higher, resolution_m=10.0, altitudes_m=(25.0,)), 25.0)
    rows[row.building] = {
        "height (m)": row.height_m,
        "foretold by the gradient": STEP_M * row.per_metre,
        "exact maps": again.evaluate(route.xy_m - corner_m).total - route.cost,
    }
pd.DataFrame(rows).T.rename_axis("building, 4 m higher").round(3)
