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
from tests.metrics.whole_maps import seen

CRS, X_M, Y_M = "EPSG:32618", 583_000.0, 4_507_000.0
RESOLUTION_M = 2.0
FLOOR_M, TOP_M = 12.0, 13.5
DECK_ALTITUDES_M = [1.5, 2.0, 5.0, 11.0]
BESIDE_M = 60.0  # from the deck: farther away it hides nothing at 10 degrees and hardly a ray of the others
# A sky all around: 24 directions, from 10 degrees up to near the zenith.
AZIMUTH_RAD = np.radians(np.arange(24) * 15.0 + 4.0)
ELEVATION_RAD = np.radians(np.tile([10.0, 20.0, 33.0, 48.0, 63.0, 80.0], 4))


@pytest.mark.parametrize("turned_deg", [0.0, 27.0, 45.0, 81.0])
def test_98_percent_of_answers_under_and_beside_a_deck_are_those_of_embree(turned_deg):
    deck = np.array([shapely.affinity.rotate(shapely.box(X_M - 150, Y_M - 9, X_M + 150, Y_M + 9), turned_deg)])
    tops, floors = np.array([TOP_M]), np.array([FLOOR_M])
    buildings = Footprints(deck, tops, floors, np.zeros(1, np.uint8), np.ones(1, bool))
    city = City(CRS, shapely.box(X_M - 400, Y_M - 400, X_M + 400, Y_M + 400).bounds, buildings, hanging=SLABS)
    region = Grid(CRS, RESOLUTION_M, int(Y_M / 2) - 80, int(X_M / 2) - 80, 160, 160)
    margins_m = shadow_reach_m(AZIMUTH_RAD, ELEVATION_RAD, TOP_M, min(DECK_ALTITUDES_M), RESOLUTION_M)
    surface = build_surface(city, region, region.padded(*(math.ceil(margin / RESOLUTION_M) for margin in margins_m)))
    assert not np.any(obstacles_on(surface, DECK_ALTITUDES_M))
    is_seen = seen(visibility(surface, AZIMUTH_RAD, ELEVATION_RAD, DECK_ALTITUDES_M), len(AZIMUTH_RAD))
    scene, directions = CityScene(deck, tops, floors), unit_vectors(AZIMUTH_RAD, ELEVATION_RAD)
    x, y = region.xy_of_cell(*np.indices(region.shape).reshape(2, -1))
    distance_m = shapely.distance(deck[0], shapely.points(x, y)).reshape(region.shape)
    for where in (distance_m == 0, (distance_m > 0) & (distance_m < BESIDE_M)):
        row, col = np.nonzero(where)
        for a, altitude_m in enumerate(DECK_ALTITUDES_M):
            start_m = np.column_stack([*region.xy_of_cell(row, col), np.full(len(row), altitude_m)])
            agrees = is_seen[:, a, row, col] == scene.sees(start_m, directions)
            assert agrees.mean() >= 0.98, (altitude_m, agrees.mean())
