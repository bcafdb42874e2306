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
# it asks what **would** be requested, then writes tiny files of the same kinds by hand. Put your own in their place.

# %%
# %matplotlib inline
import os
import shutil
import tempfile
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

import jaxurban as ju
from jaxurban.report.figures import plot_heights, plot_overview

folder = Path(tempfile.mkdtemp(prefix="my-town-"))
os.environ["XDG_CACHE_HOME"] = str(folder / "cache")  # so that nothing is kept elsewhere; leave this out at home
# %run -m jaxurban fetch --bounds=-74.02,40.70,-73.98,40.73 -o {folder}/new-york --dry-run

# %% [markdown]
# In a terminal the command is `jaxurban fetch ...`; `%run -m` runs it inside the notebook. Without `--dry-run` it
# fetches ([fetch.md](../docs/fetch.md) tells what and how politely).
#
# ## Buildings
#
# Any vector file in longitude and latitude, or an OpenStreetMap extract. What counts is the tag `height` (metres) or
# `building:levels`; a building with neither gets the default, and the maps say how many these are. Here: a town of 60 x
# 45 m houses along streets, with one tower.

# %%
WEST, SOUTH, STEP_LON, STEP_LAT = 8.300, 47.050, 0.00120, 0.00080  # a block of about 91 x 89 m
rng = np.random.default_rng(0)


def box(row: float, col: float, rows: float, cols: float) -> shapely.Polygon:
    """Return a box of so many blocks, its southwest corner so many blocks from the town's."""
    x, y = WEST + col * STEP_LON, SOUTH + row * STEP_LAT
    return shapely.box(x, y, x + cols * STEP_LON, y + rows * STEP_LAT)


houses = []
for row, col in np.ndindex(10, 10):
    if row in (6, 7) and col in (2, 3):
        continue  # a park
    house = {"building": "yes", "height": None, "building:levels": None, "geometry": box(row, col, 0.5, 0.66)}
    if (row + col) % 3 == 0:
        house["building:levels"] = str(rng.integers(2, 8))
    else:
        house["height"] = "90" if (row, col) == (4, 6) else str(rng.integers(8, 35))
    houses.append(house)
gpd.GeoDataFrame(houses, crs="EPSG:4326").to_file(folder / "buildings.geojson")
pd.DataFrame(houses).drop(columns="geometry").head(4)

# %% [markdown]
# ## People
#
# Blocks with an identifier, and a table with the same identifier and a count.

# %%
corners = list(np.ndindex(5, 5))
blocks = gpd.GeoDataFrame(
    {"block": [f"{row}{col}" for row, col in corners], "geometry": [box(2 * r, 2 * c, 2, 2) for r, c in corners]},
    crs="EPSG:4326",
)
blocks.to_file(folder / "blocks.geojson")
pd.DataFrame({"block": blocks["block"], "population": rng.integers(0, 400, len(blocks))}).to_csv(
    folder / "people.csv", index=False
)

# %% [markdown]
# ## Settings
#
# A scenario names the files, relative to itself. Only `[region]` and `[buildings]` are required; a misspelt key is an
# error that names the right one.

# %%
_, _, east, north = box(0, 0, 9.5, 9.66).bounds  # as far as the houses go
(folder / "scenario.toml").write_text(f"""
[region]
bounds = [{WEST}, {SOUTH}, {east:.6f}, {north:.6f}]   # west, south, east, north, degrees
resolution_m = 5.0
altitudes_m = [20, 60]
[buildings]
source = "buildings.geojson"
[population]
blocks = "blocks.geojson"
block_field = "block"
table = "people.csv"
""")
scenario = ju.Scenario.from_toml(folder / "scenario.toml")
misspelt = {"region": {"bounds": scenario.region.bounds, "altitude": [20]}, "buildings": {"source": "x"}}
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
# The same in Python, without any folder: `ju.City.from_files`, then `ju.build_maps`. Where heights came from tells how
# far to trust the maps.

# %%
city = ju.City.from_files(
    folder / "buildings.geojson",
    bounds=scenario.region.bounds,
    population=ju.Population(blocks=folder / "blocks.geojson", table=folder / "people.csv", block_field="block"),
)
again = ju.build_maps(city, scenario.region.bounds, resolution_m=5.0, altitudes_m=(20.0, 60.0))
print(f"the same maps: {np.array_equal(again.m('gps', 20.0), maps.m('gps', 20.0), equal_nan=True)}")
city.buildings.origin_counts()

# %% [markdown]
# ## A route
#
# `jaxurban plan` on the command line writes it as GeoJSON, KML or QGroundControl plan; here in Python. Places are
# longitude, latitude.

# %%
start, goal = (WEST + 0.00090, SOUTH + 0.00060), (east - 0.00029, north - 0.00043)
route = ju.plan(maps, start, goal, altitude_m=20.0)
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
# %run -m jaxurban plan {folder}/out {ends} --altitude 20 -o {folder}/route.geojson
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
