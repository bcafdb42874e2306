"""Lower Manhattan, angles at the edge and a deck against Embree rays through the exact prisms.

Edges are the zenith, the mask, axes, diagonals and down from a hill, in a world of cells, each a column up to its
terrain or roof, so that Embree sees the rasters.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxurban.cities.city import read_buildings
from jaxurban.io.city import City
from jaxurban.io.orbits import look_angles, read_orbits
from jaxurban.io.rasterise import build_surface
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.visibility import bounding_visibility, shadow_reach_m, visibility
from jaxurban.settings import SLABS, Buildings
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface, obstacles_on
from tests.embree_scene import CityScene
from tests.metrics.whole_maps import gdop_by_inverse, seen, surface_on

BOUNDS, CRS, REFERENCE = (-74.02, 40.70, -73.98, 40.73), "EPSG:32618", (-74.0, 40.715)
LATE, EARLY = (
    "2020-04-27T16:00:00Z",
    "2020-04-27T00:20:00Z",
)  # early one satellite stands at 8 degrees
ALTITUDES_M = [20.0, 60.0, 122.0]
OVERSAMPLE = 5

# Least shares by altitude: all answers, those blocked in truth, those clear in truth.
BARS_5M = ((0.975, 0.992, 0.996), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))
BARS_2M = ((0.988, 0.996, 0.998), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))
AGREEMENT = (
    0.993,
    0.997,
    0.998,
)  # least share of right answers by altitude; plain cells: 0.978, 0.994, 0.997
WITHIN = (
    0.96,
    0.985,
    0.99,
)  # least share of cells whose m is within 0.02 of the exact one; plain: 0.90, 0.97, 0.99


def region_of(resolution_m: float = 5.0) -> Grid:
    return Grid.from_bounds(BOUNDS, resolution_m, CRS, nest_with_m=(2, 5, 10))


@pytest.fixture(scope="module")
def city(data_dir) -> City:
    buildings = read_buildings(
        Buildings(data_dir / "osm" / "lower-manhattan.osm.pbf"), CRS
    ).buildings
    return City(
        CRS, region_of().padded(200, 220, 240, 160).bounds_m, buildings
    )  # as far as the file reaches


@pytest.fixture(scope="module")
def scene(city) -> CityScene:
    return CityScene(city.buildings.polygons, city.buildings.height_m)


def angles_at(data_dir, time: str) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths and elevations at a time."""
    orbits, convergence_rad = (
        data_dir / "gps" / "gps-ops_2020-04-27.tle",
        region_of().convergence_rad(*REFERENCE),
    )
    sky = look_angles(
        read_orbits(orbits), [time], *REFERENCE, convergence_rad=convergence_rad
    ).under(5.0)
    assert sky.elevation_rad.min() < math.radians(8.5 if time == EARLY else 18)
    return sky.azimuth_rad[0], sky.elevation_rad[0]


def receivers(
    surface: Surface, altitude_m: float, num: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns of random free cells, and the points above their centres."""
    free = np.argwhere(np.asarray(surface.crop(surface.roof_m)) < altitude_m)
    row, col = np.random.default_rng(0).choice(free, num, replace=False).T
    return (
        row,
        col,
        np.column_stack([*surface.region.xy_of_cell(row, col), np.full(num, altitude_m)]),
    )


def check_shares(is_seen: np.ndarray, is_clear: np.ndarray, bars, k: int) -> None:
    agrees = is_seen == is_clear
    shares = agrees.mean(), agrees[~is_clear].mean(), agrees[is_clear].mean()
    for share, bar in zip(shares, bars, strict=True):
        assert share >= bar[k]


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(
    ("resolution_m", "bars"), [(5.0, BARS_5M), pytest.param(2.0, BARS_2M, marks=pytest.mark.slow)]
)
def test_visibility_agrees_with_embree(city, scene, data_dir, resolution_m, bars):
    angles, region = angles_at(data_dir, LATE), region_of(resolution_m)
    margins_m = shadow_reach_m(*angles, city.buildings.height_m.max(), 20.0, resolution_m)
    grid = region.padded(
        *(math.ceil(min(margin, 2000) / resolution_m) for margin in margins_m)
    )  # no data beyond
    surface = build_surface(city, region, grid)
    words = seen(visibility(surface, *angles, ALTITUDES_M), len(angles[0]))
    for k, altitude_m in enumerate(ALTITUDES_M):
        row, col, start_m = receivers(surface, altitude_m, 5000)
        check_shares(words[:, k, row, col], scene.sees(start_m, unit_vectors(*angles)), bars, k)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(
    ("altitude_m", "mean_error", "bias"),
    [
        (20.0, 0.012, 0.002),
        pytest.param(60.0, 0.009, 0.004, marks=pytest.mark.slow),
        pytest.param(122.0, 0.004, 0.002, marks=pytest.mark.slow),
    ],
)
def test_lidar_agrees_with_embree_at_5_m(city, scene, altitude_m, mean_error, bias):
    surface = build_surface(city, region_of(), region_of().padded(20, 20, 20, 20))
    row, col, start_m = receivers(surface, altitude_m, 1500)
    m = np.asarray(compute_lidar(surface, np.array([altitude_m]), Lidar()))[0, row, col]
    difference = m - scene.scan(start_m, Lidar())
    assert np.abs(difference).mean() <= mean_error
    assert abs(difference.mean()) <= bias


def metric_of(is_seen: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return m for ``[S, N]`` answers."""
    return np.clip(
        (20 - np.minimum(gdop_by_inverse(is_seen.astype(float), directions), 20)) / 19, 0, 1
    )


@pytest.mark.slow
@pytest.mark.data
def test_plain_and_oversampled_answers_and_bounds_hold_against_embree(city, scene, data_dir):
    region, angles = region_of(), angles_at(data_dir, EARLY)
    outer, directions = region.padded(200, 220, 240, 160), unit_vectors(*angles)
    surface = build_surface(city, region, outer)
    finer = city, region.refined(OVERSAMPLE), outer.refined(OVERSAMPLE)
    fine, touched = (build_surface(*finer, all_touched) for all_touched in (False, True))
    view = *angles, ALTITUDES_M, OVERSAMPLE
    words = {
        "plain": visibility(surface, *angles, ALTITUDES_M),
        "fine": visibility(fine, *angles, ALTITUDES_M, every=OVERSAMPLE),
        "surely seen": bounding_visibility(touched, *view, hides_most=True),
        "maybe seen": bounding_visibility(fine, *view, hides_most=False),
    }
    words = {name: seen(values, len(directions)) for name, values in words.items()}
    for k, altitude_m in enumerate(ALTITUDES_M):
        row, col, start_m = receivers(surface, altitude_m, 4000)
        is_clear = scene.sees(start_m, directions)
        of = {name: values[:, k, row, col] for name, values in words.items()}
        m = {name: metric_of(values, directions) for name, values in of.items()}
        exact_m = metric_of(is_clear, directions)
        check_shares(of["plain"], is_clear, BARS_5M, k)
        assert (of["fine"] == is_clear).mean() >= max(
            AGREEMENT[k], (of["plain"] == is_clear).mean()
        )
        assert (np.abs(m["fine"] - exact_m) <= 0.02).mean() >= WITHIN[k]
        assert not np.any(of["surely seen"] & ~is_clear)
        assert not np.any(is_clear & ~of["maybe seen"])
        assert np.all((m["surely seen"] <= exact_m + 1e-9) & (exact_m <= m["maybe seen"] + 1e-9))
        assert (of["surely seen"] == of["maybe seen"]).mean() >= 0.93


GRID = Grid(CRS, 5.0, 900_000, 100_000, 48, 48)
REGION = Grid(CRS, 5.0, 900_012, 100_012, 24, 24)
ALTITUDE_M = 8.0


class World:
    """Roofs and terrain in whole cells, and the same as columns for Embree."""

    def __init__(self, hill_m: float):
        rng = np.random.default_rng(5)
        is_roof = np.kron(rng.random((16, 16)) < 0.25, np.ones((3, 3))) > 0
        self.roof_m = np.where(
            is_roof, np.kron(rng.integers(6, 40, (16, 16)), np.ones((3, 3))), 0.0
        )
        row, col = np.indices(GRID.shape)
        self.terrain_m = np.round(hill_m * np.exp(-((row - 24) ** 2 + (col - 24) ** 2) / 150.0), 1)
        x, y = (v.ravel() * 5.0 for v in (col + GRID.first_col, row + GRID.first_row))
        # A millimetre less: a ray along a diagonal runs through corners, which must not count as hits.
        cells = shapely.box(x + 1e-3, y + 1e-3, x + 5.0 - 1e-3, y + 5.0 - 1e-3)
        top_m, is_roof = (self.terrain_m + self.roof_m).ravel(), self.roof_m.ravel() > 0
        self.buildings = CityScene(cells[is_roof], top_m[is_roof])
        self.ground = (
            CityScene(cells, np.where(is_roof, 0.0, self.terrain_m.ravel())) if hill_m else None
        )
        free = self.roof_m[REGION.window_in(GRID)] < ALTITUDE_M
        self.row, self.col = np.nonzero(free)
        own_m = self.terrain_m[REGION.window_in(GRID)][free]
        self.start_m = np.column_stack([*REGION.xy_of_cell(self.row, self.col), own_m + ALTITUDE_M])

    def surface(self, oversample: int = 1) -> Surface:
        roof_m, terrain_m = (
            np.kron(v, np.ones((oversample, oversample))) for v in (self.roof_m, self.terrain_m)
        )
        grid, region = GRID.refined(oversample), REGION.refined(oversample)
        return surface_on(roof_m, grid, region, terrain_m if self.ground else None)

    def is_clear(self, angles: np.ndarray) -> np.ndarray:
        """Return ``[S, N]`` whether the free cells see each direction."""
        scenes = [scene for scene in (self.buildings, self.ground) if scene is not None]
        return np.all(
            [scene.sees(self.start_m, unit_vectors(*angles.T)) for scene in scenes], axis=0
        )

    def seen(self, oversample: int, angles: np.ndarray) -> np.ndarray:
        words = visibility(self.surface(oversample), *angles.T, [ALTITUDE_M], every=oversample)
        return seen(words, len(angles))[:, 0, self.row, self.col]


@pytest.fixture(scope="module", params=[0.0, 25.0], ids=["flat", "hill"])
def world(request) -> World:
    return World(request.param)


AXES, DIAGONALS = (
    [(turn + 90 * k, elevation) for k in range(4) for elevation in (5, 20, 50)] for turn in (0, 45)
)


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
    world, params = (
        World(25.0),
        Lidar(beams=8, field_of_view_deg=(-25.0, 5.0), azimuths=40, range_m=55.0),
    )
    expected = world.buildings.scan(world.start_m, params, world.ground)
    on_top = world.terrain_m[REGION.window_in(GRID)][world.row, world.col] > 15
    assert on_top.sum() > 20
    free = jnp.zeros((1, *REGION.shape), bool)
    plain = compute_lidar(world.surface(), [ALTITUDE_M], params)
    fine = compute_lidar(world.surface(OVERSAMPLE), [ALTITUDE_M], params, "auto", OVERSAMPLE, free)
    for m, bar in ((plain, 0.035), (fine, 0.012)):
        error = np.abs(np.asarray(m)[0, world.row, world.col] - expected)
        assert error.mean() <= bar
        assert error[on_top].mean() <= bar


X_M, Y_M = 583_000.0, 4_507_000.0
RESOLUTION_M = 2.0
FLOOR_M, TOP_M = 12.0, 13.5
DECK_ALTITUDES_M = [1.5, 2.0, 5.0, 11.0]
BESIDE_M = 60.0  # from the deck: farther away it hides nothing at 10 degrees and hardly a ray of the others
# A sky all around: 24 directions, from 10 degrees up to near the zenith.
AZIMUTH_RAD = np.radians(np.arange(24) * 15.0 + 4.0)
ELEVATION_RAD = np.radians(np.tile([10.0, 20.0, 33.0, 48.0, 63.0, 80.0], 4))


@pytest.mark.slow
@pytest.mark.parametrize("turned_deg", [0.0, 27.0, 45.0, 81.0])
def test_98_percent_of_answers_under_and_beside_a_deck_are_those_of_embree(turned_deg):
    deck = np.array(
        [shapely.affinity.rotate(shapely.box(X_M - 150, Y_M - 9, X_M + 150, Y_M + 9), turned_deg)]
    )
    tops, floors = np.array([TOP_M]), np.array([FLOOR_M])
    buildings = Footprints(deck, tops, floors, np.zeros(1, np.uint8), np.ones(1, bool))
    city = City(
        CRS,
        shapely.box(X_M - 400, Y_M - 400, X_M + 400, Y_M + 400).bounds,
        buildings,
        hanging=SLABS,
    )
    region = Grid(CRS, RESOLUTION_M, int(Y_M / 2) - 80, int(X_M / 2) - 80, 160, 160)
    margins_m = shadow_reach_m(
        AZIMUTH_RAD, ELEVATION_RAD, TOP_M, min(DECK_ALTITUDES_M), RESOLUTION_M
    )
    surface = build_surface(
        city, region, region.padded(*(math.ceil(margin / RESOLUTION_M) for margin in margins_m))
    )
    assert not np.any(obstacles_on(surface, DECK_ALTITUDES_M))
    is_seen = seen(
        visibility(surface, AZIMUTH_RAD, ELEVATION_RAD, DECK_ALTITUDES_M), len(AZIMUTH_RAD)
    )
    scene, directions = CityScene(deck, tops, floors), unit_vectors(AZIMUTH_RAD, ELEVATION_RAD)
    x, y = region.xy_of_cell(*np.indices(region.shape).reshape(2, -1))
    distance_m = shapely.distance(deck[0], shapely.points(x, y)).reshape(region.shape)
    for where in (distance_m == 0, (distance_m > 0) & (distance_m < BESIDE_M)):
        row, col = np.nonzero(where)
        for a, altitude_m in enumerate(DECK_ALTITUDES_M):
            start_m = np.column_stack([*region.xy_of_cell(row, col), np.full(len(row), altitude_m)])
            agrees = is_seen[:, a, row, col] == scene.sees(start_m, directions)
            assert agrees.mean() >= 0.98, (altitude_m, agrees.mean())
