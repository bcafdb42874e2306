"""A small city in which parts and a deck hang over the ground, for tests."""

from dataclasses import replace

import numpy as np
import shapely

from jaxurban.io.city import City
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.lidar import Lidar
from jaxurban.settings import SLABS, Hanging
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from tests.tiled_runs import sky

CRS, X_M, Y_M, SIDE_M = "EPSG:32618", 583_000.0, 4_507_000.0, 600.0
DECK = shapely.box(X_M + 60, Y_M + 190, X_M + 540, Y_M + 214)
DECK_FLOOR_M, DECK_TOP_M = 12.0, 13.5
RESOLUTION_M = 5.0
REGION = Grid(CRS, RESOLUTION_M, int((Y_M + 100) // 5), int((X_M + 50) // 5), 67, 93)
PARAMS = MapParams(
    altitudes_m=(2.0, 12.0, 13.0, 20.0, 42.0), sections={"lidar": Lidar(azimuths=36, range_m=70.0)}
)
# Outline, floor and top of each.
STANDING = [
    (shapely.box(X_M + 40, Y_M + 240, X_M + 90, Y_M + 300), 0.0, 70.0),
    (shapely.box(X_M + 100, Y_M + 250, X_M + 130, Y_M + 290), 0.0, 15.0),  # a podium
    (shapely.box(X_M + 300, Y_M + 60, X_M + 360, Y_M + 150), 0.0, 40.0),
    (shapely.box(X_M + 420, Y_M + 300, X_M + 470, Y_M + 420), 0.0, 120.0),
]
HANGING = [
    (DECK, DECK_FLOOR_M, DECK_TOP_M),
    (shapely.box(X_M + 105, Y_M + 255, X_M + 125, Y_M + 285), 15.0, 55.0),  # rests on the podium
    (
        shapely.box(X_M + 90, Y_M + 250, X_M + 100, Y_M + 290),
        30.0,
        36.0,
    ),  # between tower and podium
    (
        shapely.affinity.rotate(shapely.box(X_M + 180, Y_M + 330, X_M + 300, Y_M + 350), 30),
        6.0,
        8.0,
    ),
    (
        shapely.affinity.rotate(shapely.box(X_M + 180, Y_M + 330, X_M + 300, Y_M + 350), 30),
        40.0,
        44.0,
    ),  # over it
]


def city(hanging: Hanging = SLABS, with_terrain: bool = False) -> City:
    """Return the city; with terrain, over hills."""
    polygons, floor_m, top_m = zip(*STANDING, *HANGING, strict=True)
    origin, is_part = (
        np.full(len(polygons), HeightOrigin.HEIGHT, np.uint8),
        np.ones(len(polygons), bool),
    )
    buildings = Footprints(
        np.array(polygons, object), np.array(top_m), np.array(floor_m), origin, is_part
    )
    terrain = None
    if with_terrain:
        size = int(SIDE_M // 25)
        hills = (np.random.default_rng(0).random((size, size)) * 9).astype(np.float32)
        terrain = Raster(hills, (25.0, 0.0, X_M, 0.0, -25.0, Y_M + SIDE_M), CRS)
    extent_m = (X_M, Y_M, X_M + SIDE_M, Y_M + SIDE_M)
    ground_m = None if terrain is None else extent_m
    return City(
        CRS, extent_m, buildings, terrain=terrain, terrain_extent_m=ground_m, hanging=hanging
    )


def task(of: City, **settings) -> MapTask:
    """Return the maps of a region of the city, with other ``settings`` than `PARAMS`."""
    return MapTask(of, REGION, sky(), replace(PARAMS, **settings))
