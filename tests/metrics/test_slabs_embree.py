"""Visibility under and beside what hangs, against Embree rays through the exact prisms."""

import math

import numpy as np
import pytest
import shapely

from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.visibility import shadow_reach_m, visibility
from jaxurban.world.city import SLABS, City, Footprints
from jaxurban.world.grid import Grid
from jaxurban.world.surface import obstacles_on
from tests.embree_scene import CityScene

CRS, X_M, Y_M = "EPSG:32618", 583_000.0, 4_507_000.0
RESOLUTION_M = 2.0
FLOOR_M, TOP_M = 12.0, 13.5
DECK_ALTITUDES_M = [1.5, 2.0, 5.0, 11.0]
BESIDE_M = 60.0  # from the deck: farther away it hides nothing at 10 degrees and hardly a ray of the others
# A sky all around: 24 directions, from 10 degrees up to near the zenith.
AZIMUTH_RAD = np.radians(np.arange(24) * 15.0 + 4.0)
ELEVATION_RAD = np.radians(np.tile([10.0, 20.0, 33.0, 48.0, 63.0, 80.0], 4))


def city_of(polygons: list, floor_m: list, top_m: list, hanging: str) -> City:
    number = len(polygons)
    buildings = Footprints(
        np.array(polygons, object),
        np.array(top_m),
        np.array(floor_m),
        np.zeros(number, np.uint8),
        np.ones(number, bool),
    )
    return City(CRS, tuple(shapely.box(X_M - 400, Y_M - 400, X_M + 400, Y_M + 400).bounds), buildings, hanging=hanging)


def seen(city: City, region: Grid, altitudes_m: list[float], azimuth_rad: np.ndarray, elevation_rad: np.ndarray):
    """Return which satellites are seen ``[S, A, y, x]``, and which cells are obstacles ``[A, y, x]``."""
    highest_m = float(city.buildings.height_m.max())
    margins_m = shadow_reach_m(azimuth_rad, elevation_rad, highest_m, min(altitudes_m), region.resolution_m)
    grid = region.padded(*(math.ceil(min(margin, 2000) / region.resolution_m) for margin in margins_m))
    surface = build_surface(city, region, grid)
    words = np.asarray(visibility(surface, azimuth_rad, elevation_rad, altitudes_m))[0]
    bits = np.arange(len(azimuth_rad), dtype=np.uint32)[:, None, None, None]
    return (words >> bits) & 1 == 1, np.asarray(obstacles_on(surface, altitudes_m))


def truth(scene: CityScene, region: Grid, cells: np.ndarray, altitude_m: float, directions: np.ndarray) -> np.ndarray:
    """Return which directions Embree sees free from cells, ``[S, N]``."""
    start_m = np.column_stack([*region.xy_of_cell(*cells.T), np.full(len(cells), altitude_m)])
    return np.array([~scene.is_blocked(start_m, np.tile(d, (len(cells), 1))) for d in directions])


@pytest.mark.parametrize("turned_deg", [0.0, 27.0, 45.0, 81.0])
def test_98_percent_of_answers_under_and_beside_a_deck_are_those_of_embree(turned_deg):
    deck = shapely.affinity.rotate(shapely.box(X_M - 150, Y_M - 9, X_M + 150, Y_M + 9), turned_deg)
    floors, tops = np.array([FLOOR_M]), np.array([TOP_M])
    scene = CityScene(np.array([deck]), tops, floors)
    region = Grid(CRS, RESOLUTION_M, int(Y_M / 2) - 80, int(X_M / 2) - 80, 160, 160)
    is_seen, is_obstacle = seen(
        city_of([deck], [FLOOR_M], [TOP_M], SLABS), region, DECK_ALTITUDES_M, AZIMUTH_RAD, ELEVATION_RAD
    )
    assert not is_obstacle.any()
    x, y = region.xy_of_cell(*np.indices(region.shape).reshape(2, -1))
    distance_m = shapely.distance(deck, shapely.points(x, y)).reshape(region.shape)
    directions = unit_vectors(AZIMUTH_RAD, ELEVATION_RAD)
    for where in (distance_m == 0, (distance_m > 0) & (distance_m < BESIDE_M)):
        cells = np.argwhere(where)
        for a, altitude_m in enumerate(DECK_ALTITUDES_M):
            expected = truth(scene, region, cells, altitude_m, directions)
            agrees = is_seen[:, a, cells[:, 0], cells[:, 1]] == expected
            assert agrees.mean() >= 0.98, (altitude_m, agrees.mean())
