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
# # 2. GPS, lidar, people and walls by altitude
#
# **What does a drone have to go by at 10 m, and what at 600 m?**
#
# Lower Manhattan, from the data that come with the package. Five maps, each a number between 0 and 1 for every cell of
# 10 m, at every altitude:
#
# | map | 1 means | 0 means |
# |---|---|---|
# | GPS | the best satellite geometry there is | no position fix, or hopeless geometry |
# | lidar | a building returns the beam in every direction | nothing within the lidar's range of 100 m |
# | population | as many people below as anywhere in the region | nobody |
# | risk, the distance to obstacles | no wall within 50 m | at a wall |
# | obstacle | a building is here: nobody may fly | free |
#
# The first call on a machine compiles for some ten seconds; later ones take seconds.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.plot import (
    plot_gps_rating,
    plot_heights,
    plot_metric,
    plot_population,
    plot_sensor_choice,
)

city = ju.sample_city("lower-manhattan")
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(10, 20, 40, 60, 90, 122, 200, 600))
shown = (20, 60, 122, 600)  # the paper's altitudes
plot_heights(maps)

# %% [markdown]
# ## GPS: what the roofs leave of the sky
#
# A satellite counts where the straight line to it clears every roof. With few of them, or all on one side, an error in
# range becomes a larger error in position: by the factor GDOP. `m_gps` is 1 at GDOP 1 and 0 at GDOP 20.

# %%
plot_metric(maps, "num_visible", altitude_m=shown)

# %%
plot_metric(maps, "gps", altitude_m=shown)

# %% [markdown]
# The same in words that pilots use: the rating of the paper.

# %%
plot_gps_rating(maps, altitude_m=shown)

# %% [markdown]
# ## Lidar: the other way round
#
# A lidar finds its place by walls. Between them it sees in nearly all directions; above the roofs there is nothing left
# to see.

# %%
plot_metric(maps, "lidar", altitude_m=shown)

# %% [markdown]
# ## Which of the two to trust

# %%
plot_sensor_choice(maps, altitude_m=shown)

# %% [markdown]
# ## People: they do not change with altitude, but with the hour
#
# The census counts where people sleep. By day offices fill and homes empty: commercial districts are taken to hold
# three times as many people as at night, all others half as many. Colours are logarithmic.

# %%
plot_population(maps)

# %% [markdown]
# ## Walls: how much room there is

# %%
plot_metric(maps, "risk", altitude_m=shown)

# %% [markdown]
# ## All of it in one picture
#
# Over the rivers little changes with altitude. So look at the streets: the cells that are free at 10 m with a wall
# within 50 m. Straight up from there lidar fades as GPS and room grow. What the one lacks the other has: the paper's
# main finding.

# %%
is_street = maps.is_free(10.0, "centre") & (maps.m("risk", 10.0) < 1)
means = pd.DataFrame(
    {
        z: {name: np.nanmean(maps.m(name, z)[is_street]) for name in ("gps", "lidar", "risk")}
        | {"GPS better than lidar": maps.prefers_gps(z)[is_street].mean()}
        for z in maps.altitudes_m
    }
).T.rename_axis("altitude (m)")
print(f"{is_street.mean():.0%} of the region is street")
means.round(3)

# %%
plt.style.use("tableau-colorblind10")
figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
for name, style in (
    ("gps", "o-"),
    ("lidar", "s-"),
    ("risk", "^-"),
    ("GPS better than lidar", "k--"),
):
    axes.plot(means.index, means[name], style, label=name)
axes.set(
    xscale="log",
    xlabel="altitude above ground (m)",
    ylabel="mean m over the streets,\nor share of them",
)
axes.set_ylim(0, 1.03)
axes.set_xticks(means.index, [f"{z:g}" for z in means.index])
axes.minorticks_off()
axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()

# %% [markdown]
# ## A question to try
#
# At which altitude would you fly if the GPS were jammed? Take `gps` out of the last picture and look for the best of
# the rest.
