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
# # 7. Your own city, from downloaded files
#
# **Which files does a city need, and what do they become?**
#
# Buildings are all that is needed; people and satellites make the maps complete:
#
# | files | for example | without them |
# |---|---|---|
# | building outlines with heights | OpenStreetMap | no maps |
# | census blocks, and a table of who lives there | US Census | no population layer |
# | districts, commercial or residential | a city's open data | all districts change by day like residential ones |
# | element sets of the GPS satellites | CelesTrak | the nominal constellation of 24 |
#
# `jaxurban fetch` downloads all four for a region and writes the settings beside them. This notebook makes no request:
# it asks what **would** be requested, then takes files of the same kinds that come with the package, of Lower
# Manhattan, as if you had downloaded them. Put your own in their place. The first call on a machine compiles for
# some ten seconds.

# %%
# %matplotlib inline
import os
import shutil
import tempfile
from pathlib import Path

import geopandas as gpd
import numpy as np

import jaxurban as ju
from jaxurban.io.samples import located
from jaxurban.plot import plot_heights, plot_overview

folder = Path(tempfile.mkdtemp(prefix="my-town-"))
os.environ["XDG_CACHE_HOME"] = str(
    folder / "cache"
)  # so that nothing is kept elsewhere; leave this out at home
# %run -m jaxurban fetch --bounds=-74.02,40.70,-73.98,40.73 -o {folder}/new-york --dry-run

# %% [markdown]
# In a terminal the command is `jaxurban fetch ...`; `%run -m` runs it inside the notebook. Without `--dry-run` it
# fetches ([your own city](../docs/guides/own_city.md) lists what, and from where).
#
# ## Buildings
#
# Any vector file in longitude and latitude, or an OpenStreetMap extract. What counts is the tag `height` (metres) or
# `building:levels`; a building with neither gets the default, and the maps say how many these are.

# %%
for name in ("buildings.parquet", "blocks.parquet", "districts.parquet", "gps.tle"):
    shutil.copy(located(f"sample:lower-manhattan/{name}"), folder)
buildings = gpd.read_parquet(folder / "buildings.parquet")
buildings.drop(columns="geometry").sample(6, random_state=1)

# %% [markdown]
# ## People
#
# Blocks with an identifier and a count of people, in one file or in two that share the identifier; districts, so that
# offices fill by day.

# %%
blocks, districts = (
    gpd.read_parquet(folder / "blocks.parquet"),
    gpd.read_parquet(folder / "districts.parquet"),
)
print(f"{len(blocks):,} blocks, {len(districts)} districts")
blocks.drop(columns="geometry").head(3)

# %% [markdown]
# ## Satellites
#
# Two lines for each satellite, of the day that you fly or near it. Files older than 90 days are refused.

# %%
print(*(folder / "gps.tle").read_text().splitlines()[:3], sep="\n")

# %% [markdown]
# ## Settings
#
# A scenario names the files, relative to itself. Only `[region]` and `[buildings]` are required; a misspelt key is an
# error that names the right one.

# %%
(folder / "scenario.toml").write_text("""
[region]
bounds = [-74.02, 40.70, -73.99, 40.72]   # west, south, east, north, degrees
resolution_m = 10.0
altitudes_m = [20, 60]
[buildings]
source = "buildings.parquet"
[population]
blocks = "blocks.parquet"
districts = "districts.parquet"
[gps]
orbits = "gps.tle"
times = ["2020-04-27T16:00:00Z"]
""")
scenario = ju.Scenario.from_toml(folder / "scenario.toml")
misspelt = {
    "region": {"bounds": scenario.region.bounds, "altitude": [20]},
    "buildings": {"source": "x"},
}
try:
    ju.Scenario.from_dict(misspelt)
except ju.InputError as error:
    print(error)

# %% [markdown]
# ## Maps
#
# From the command line, which writes Zarr, GeoTIFF and a record of what went in (`run.json`):

# %%
# %run -m jaxurban maps {folder}/scenario.toml -o {folder}/out
print(*sorted(path.name for path in (folder / "out").glob("**/*.tif")), sep="\n")

# %%
maps = ju.open_maps(folder / "out")
plot_heights(maps)

# %% [markdown]
# The same in Python, without any folder: `ju.City.from_files`, then `ju.build_maps`. Where heights came from says how
# far to trust the maps.

# %%
city = ju.City.from_files(
    folder / "buildings.parquet",
    bounds=scenario.region.bounds,
    population=ju.Population(
        blocks=folder / "blocks.parquet", districts=folder / "districts.parquet"
    ),
)
gps = ju.Gps(orbits=folder / "gps.tle", times=scenario.gps.times)
again = ju.build_maps(
    city, scenario.region.bounds, resolution_m=10.0, altitudes_m=(20.0, 60.0), gps=gps
)
print(f"the same maps: {np.array_equal(again.m('gps', 20.0), maps.m('gps', 20.0), equal_nan=True)}")
assert city.buildings is not None  # other cities may come as rasters of roofs alone
city.buildings.origin_counts()

# %% [markdown]
# ## A route
#
# `jaxurban plan` on the command line writes it as GeoJSON, KML or QGroundControl plan; here in Python. Places are
# longitude, latitude.

# %%
start, goal = (-74.0162, 40.7036), (-73.9950, 40.7150)
route = ju.plan(maps, start, goal, altitude_m=20.0, snap=True)
print(f"{route.status.value}: {route.length_m:,.0f} m, cost {route.cost:.1f}")
plot_overview(maps, route)

# %% [markdown]
# Other weights, other routes: in a running notebook, set two ends in the viewer and let a slider go.

# %%
ju.view(maps)

# %% [markdown]
# The same route from the command line:

# %%
ends = f"--start={start[0]:.5f},{start[1]:.5f} --goal={goal[0]:.5f},{goal[1]:.5f}"
# %run -m jaxurban plan {folder}/out {ends} --altitude 20 --snap -o {folder}/route.geojson
print((folder / "route.geojson").stat().st_size, "bytes")

# %% [markdown]
# All of it lies in `folder`, and can be deleted:

# %%
shutil.rmtree(folder)

# %% [markdown]
# ## A question to try
#
# What does the route do with another guess for the heights that nobody mapped? Set `default_height_m` in the scenario's
# `[buildings]` to 20, and make the maps again.
