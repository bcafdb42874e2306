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
# # 11. A batch of maps in one call
#
# **At which hours, and under how strict a limit, is GPS good enough in these streets?**
#
# `ju.grad.all_maps` is every map of one time as a pure function of arrays. So JAX can map it over whatever changes:
# here over 24 skies, one an hour, and over three thresholds of GDOP above which a fix counts for nothing. One program
# makes the 72 sets of maps; on a GPU the same lines run there. Compiling it takes some seconds, on the first call.

# %%
# %matplotlib inline
from dataclasses import replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxurban as ju

city = ju.sample_city("lower-manhattan")
gps = city.gps or ju.Gps()
grid = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,), progress=False).grid
times = [f"2020-04-27T{hour:02}:00:00Z" for hour in range(24)]
inputs, skies = ju.grad.map_inputs(city, grid, altitudes_m=(20.0,), gps=replace(gps, times=times))
thresholds = jnp.array([6.0, 10.0, 20.0])

# %% [markdown]
# ## One program, 72 skies and limits
#
# The inner `vmap` runs over the skies, the outer one over the thresholds: it replaces one leaf of `inputs`. What varies
# with neither (lidar, distances, people) is computed once. Only GPS is asked for here.


# %%
def gps_maps(threshold, sky):
    """Return m_gps, satellites in view and HDOP, ``[altitude, y, x]`` each."""
    stricter = replace(inputs.settings["gps"], gdop_threshold=threshold)
    maps = ju.grad.all_maps(replace(inputs, settings={**inputs.settings, "gps": stricter}), sky)
    return {name: maps[name] for name in ("gps", "num_visible", "hdop")}


batch = jax.jit(jax.vmap(jax.vmap(gps_maps, (None, 0)), (0, None)))
made = batch(thresholds, skies)
made["gps"].shape  # thresholds, hours, altitudes, rows, columns

# %% [markdown]
# ## The hours
#
# The streets are the cells that are free at 20 m with an obstacle within 50 m. The lines: the share of them where
# m_gps is above 0.5. The circles: the share with a position fix, where HDOP is finite.

# %%
one = ju.grad.all_maps(inputs, jax.tree.map(lambda values: values[0], skies))
is_street = np.asarray((one["obstacle"][0] == 0) & (one["risk"][0] < 1))
good = np.asarray(made["gps"][:, :, 0] > 0.5)[..., is_street].mean(axis=-1)
has_fix = np.isfinite(made["hdop"][0, :, 0])[..., is_street].mean(axis=-1)

plt.style.use("tableau-colorblind10")
figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
for threshold, shares in zip(thresholds, good, strict=True):
    axes.plot(range(24), 100 * shares, label=f"m_gps above 0.5, threshold {threshold:g}")
axes.plot(range(24), 100 * has_fix, "ko", markersize=4, label="a position fix")
axes.set(
    xlabel="hour of 2020-04-27 (UTC)",
    ylabel="share of the streets (%)",
    xticks=range(0, 24, 3),
    ylim=(0, 100),
)
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## The places
#
# At how many of the 24 hours GPS is good (threshold 10): dark places are poor all day, and no choice of the hour helps
# there.

# %%
hours = np.where(
    np.asarray(one["obstacle"][0] == 0),
    (np.asarray(made["gps"][1, :, 0]) > 0.5).sum(axis=0),
    np.nan,
)
figure, axes = plt.subplots(figsize=(7.0, 5.0), layout="constrained")
axes.set_facecolor("0.75")  # obstacles
picture = axes.pcolormesh(
    grid.x_m - grid.x_m[0], grid.y_m - grid.y_m[0], hours, vmin=0, vmax=24, rasterized=True
)
axes.set(
    aspect="equal",
    xlabel="east of the southwest corner (m)",
    ylabel="north of it (m)",
    title=city.attribution,
)
figure.colorbar(picture, label="hours with m_gps above 0.5, of 24", ticks=range(0, 25, 6))
plt.show()

# %% [markdown]
# ## The same maps as `build_maps` makes
#
# One of the 72, beside the engine that commands use:

# %%
plain = ju.build_maps(
    city,
    grid=grid,
    altitudes_m=(20.0,),
    gps=replace(gps, times=times[12:13], gdop_threshold=10.0),
    progress=False,
)
is_free = plain.m("obstacle", 20.0) == 0
np.abs(np.asarray(made["gps"][1, 12, 0]) - plain.m("gps", 20.0))[is_free].max()

# %% [markdown]
# ## A question to try
#
# At which altitude does the hour stop mattering? Give `map_inputs` the altitudes 20, 60 and 122 m, and draw the lines
# of each.
