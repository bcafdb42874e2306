"""Angles at the edge (zenith, mask, axes, diagonals, from a hill downward), and under a deck, against Embree.

The world of angles is made of cells, each a column up to its terrain or roof, so that Embree sees the rasters.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar, compute_lidar, lidar_at_centres
from jaxurban.metrics.visibility import shadow_reach_m, visibility
from jaxurban.world.city import SLABS, City, Footprints
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface, obstacles_on
from tests.embree_scene import CityScene
from tests.metrics.whole_maps import seen, surface_on

GRID = Grid("EPSG:32618", 5.0, 900_000, 100_000, 48, 48)
REGION = Grid("EPSG:32618", 5.0, 900_012, 100_012, 24, 24)
OVERSAMPLE, ALTITUDE_M = 5, 8.0


class World:
    """Roofs and terrain in whole cells, and the same as columns for Embree."""

    def __init__(self, hill_m: float):
        rng = np.random.default_rng(5)
        is_roof = np.kron(rng.random((16, 16)) < 0.25, np.ones((3, 3))) > 0
        self.roof_m = np.where(is_roof, np.kron(rng.integers(6, 40, (16, 16)), np.ones((3, 3))), 0.0)
        row, col = np.indices(GRID.shape)
        self.terrain_m = np.round(hill_m * np.exp(-((row - 24) ** 2 + (col - 24) ** 2) / 150.0), 1)
        x, y = (v.ravel() * 5.0 for v in (col + GRID.first_col, row + GRID.first_row))
        # A millimetre less: a ray along a diagonal runs through corners, which must not count as hits.
        cells = shapely.box(x + 1e-3, y + 1e-3, x + 5.0 - 1e-3, y + 5.0 - 1e-3)
        top_m, is_roof = (self.terrain_m + self.roof_m).ravel(), self.roof_m.ravel() > 0
        self.buildings = CityScene(cells[is_roof], top_m[is_roof])
        self.ground = CityScene(cells, np.where(is_roof, 0.0, self.terrain_m.ravel())) if hill_m else None
        free = self.roof_m[REGION.window_in(GRID)] < ALTITUDE_M
        self.row, self.col = np.nonzero(free)
        own_m = self.terrain_m[REGION.window_in(GRID)][free]
        self.start_m = np.column_stack([*REGION.xy_of_cell(self.row, self.col), own_m + ALTITUDE_M])

    def surface(self, oversample: int = 1) -> Surface:
        roof_m, terrain_m = (np.kron(v, np.ones((oversample, oversample))) for v in (self.roof_m, self.terrain_m))
        grid, region = GRID.refined(oversample), REGION.refined(oversample)
        return surface_on(roof_m, grid, region, terrain_m if self.ground else None)

    def is_clear(self, angles: np.ndarray) -> np.ndarray:
        """Return ``[S, N]`` whether the free cells see each direction."""
        scenes = [scene for scene in (self.buildings, self.ground) if scene is not None]
        return np.all([scene.sees(self.start_m, unit_vectors(*angles.T)) for scene in scenes], axis=0)

    def seen(self, oversample: int, angles: np.ndarray) -> np.ndarray:
        words = visibility(self.surface(oversample), *angles.T, [ALTITUDE_M], every=oversample)
        return seen(words, len(angles))[:, 0, self.row, self.col]


@pytest.fixture(scope="module", params=[0.0, 25.0], ids=["flat", "hill"])
def world(request) -> World:
    return World(request.param)


AXES = [(azimuth, elevation) for azimuth in (0, 90, 180, 270) for elevation in (5, 20, 50)]
DIAGONALS = [(azimuth, elevation) for azimuth in (45, 135, 225, 315) for elevation in (5, 20, 50)]


@pytest.mark.parametrize(
    ("angles_deg", "plain", "fine"),
    [([(0, 90), (123, 90)], 1.0, 1.0), (AXES, 0.97, 0.993), (DIAGONALS, 0.93, 0.985)],
    ids=["zenith", "axes", "diagonals"],
)
def test_edge_angles_agree_with_embree(world, angles_deg, plain, fine):
    angles = np.radians(angles_deg)
    is_clear = world.is_clear(angles)
    shares = [(world.seen(n, angles) == is_clear).mean() for n in (1, OVERSAMPLE)]
    assert shares[0] >= plain
    assert shares[1] >= fine
    assert is_clear.all() == (plain == 1)  # the zenith is seen from every free cell


def test_a_satellite_exactly_at_the_mask_counts_and_one_below_does_not():
    mask_rad = np.radians(5.0)
    elevation, zero = np.array([[mask_rad, np.nextafter(mask_rad, 0), 1.0]]), np.zeros((1, 3))
    sky = Sky(("2020-04-27T16:00:00Z",), tuple("abc"), zero, elevation, ("gps",) * 3, zero)
    assert sky.under(5.0).names == ("a", "c")


def test_a_lidar_on_a_hill_looking_down_agrees_with_embree():
    world, params = World(25.0), Lidar(beams=8, field_of_view_deg=(-25.0, 5.0), azimuths=40, range_m=55.0)
    expected = world.buildings.scan(world.start_m, params, world.ground)
    on_top = world.terrain_m[REGION.window_in(GRID)][world.row, world.col] > 15
    assert on_top.sum() > 20
    free = jnp.zeros((1, *REGION.shape), bool)
    plain = compute_lidar(world.surface(), [ALTITUDE_M], params)
    fine = lidar_at_centres(world.surface(OVERSAMPLE), OVERSAMPLE, free, [ALTITUDE_M], params)
    for m, bar in ((plain, 0.035), (fine, 0.012)):
        error = np.abs(np.asarray(m)[0, world.row, world.col] - expected)
        assert error.mean() <= bar
        assert error[on_top].mean() <= bar


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
