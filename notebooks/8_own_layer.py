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
# # 8. A cost layer of your own
#
# **What would a drone do differently if quiet streets mattered?**
#
# GPS, lidar, people and walls are not all that a flight costs. Anything with a value at each place can be weighed
# beside them: here the gusts between buildings, made by a function of the surface, and the complaints of residents
# about noise, an array. Both are made up, and the city is Lower Manhattan; yours may come from
# a raster file ([own layers](../docs/guides/own_layer.md)). The first call on a machine compiles for about half a
# minute.

# %%
# %matplotlib inline
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxurban as ju
from jaxurban.plot import plot_breakpoint_routes, plot_metric, plot_paths

city = ju.sample_city("lower-manhattan")
plain = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0, 60.0))
start, goal = (
    (-74.0162, 40.7036),
    (-73.9817, 40.7265),
)  # longitude, latitude: the Battery, Tompkins Square

# %% [markdown]
# ## From an array
#
# `complaints` are as many as people sleep below: 60 a year where most do. The `scale` says which values cost 0 and 1:
# it is fixed, so that a weight means the same on every map.

# %%
people = plain.m("population", time_of_day="night")
a_year = 60.0 * (people / people.max())
complaints = ju.Layer(a_year, "high-is-bad", (0.0, 60.0))

# %% [markdown]
# ## From a function
#
# Wind is fast in narrow streets between high roofs. The function gets the surface and the altitude, and returns a value
# for each cell of `surface.region`; `reach_m` is how far beyond a cell it looks. Written in `jax.numpy`, it runs
# compiled, and with `soft=` it could be differentiated by the heights like the built-in metrics.


# %%
def gusts(surface, altitude_m):
    """Return metres of wall above the altitude within 30 m to the west and east, a stand-in for gusts."""
    halo = round(30.0 / surface.grid.resolution_m)
    roof_m = surface.crop_with_halo(surface.roof_m, halo)
    rows, cols = surface.region.shape
    west_east = [roof_m[halo : halo + rows, k : k + cols] for k in range(2 * halo + 1)]
    return jnp.maximum(jnp.stack(west_east).max(axis=0) - altitude_m, 0.0)


layers = {
    "complaints": complaints,
    "gusts": ju.Layer(gusts, "high-is-bad", (0.0, 50.0), reach_m=30.0),
}
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0, 60.0), layers=layers)
plot_metric(maps, "complaints", altitude_m=[20.0])

# %%
plot_metric(maps, "gusts")

# %% [markdown]
# ## What the route makes of it
#
# By name, like all weights. A layer that nobody names weighs 1.

# %%
routes = {
    name: ju.plan(maps, start, goal, altitude_m=20.0, snap=True, weights=weights)
    for name, weights in {
        "without": {"complaints": 0, "gusts": 0},
        "few complaints": {"complaints": 3, "gusts": 0},
        "no gusts": {"complaints": 0, "gusts": 3},
    }.items()
}
for name, route in routes.items():
    along = maps.m("complaints", 20.0), maps.m("gusts", 20.0)
    row, col = np.floor(
        (route.xy_m - [maps.grid.x_min_m, maps.grid.y_min_m]).T[::-1] / 10.0
    ).astype(int)
    means = ", ".join(
        f"{layer} {m[row, col].mean():.3f}" for layer, m in zip(layers, along, strict=True)
    )
    print(f"{name:15} {route.length_m:6,.0f} m; mean along it: {means}")
plot_paths(maps, routes)

# %% [markdown]
# ## How much may the weight be off?
#
# Own layers take part in every study. Each route that the weight of `complaints` can lead to, from a tenth of 3
# to ten times 3:

# %%
settings = ju.studies.SensitivitySettings(vary=("complaints", "gusts"))
found = ju.studies.sensitivity(
    maps,
    Path(tempfile.mkdtemp()),
    [(start, goal)],
    altitudes_m=[20.0],
    weights={"complaints": 3, "gusts": 1},
    snap=True,
    settings=settings,
    progress=False,
)
assert found.route is not None
plot_breakpoint_routes(found.route)

# %% [markdown]
# And by hand, in the viewer, where a notebook is running:

# %%
ju.view(maps, weights={"complaints": 3, "gusts": 1})

# %% [markdown]
# ## A question to try
#
# Above the roofs the gusts end. Plan at 60 m: does the drone still avoid the streets where people sleep, and what does
# it cost in lidar?
