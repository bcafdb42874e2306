"""Lower Manhattan against Embree rays through the exact prisms: satellites in view, lidar, finer cells, bounds."""

import math

import numpy as np
import pytest

from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.orbits import look_angles, read_orbits
from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.visibility import bounding_visibility, shadow_reach_m, visibility
from jaxurban.settings import Buildings
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface
from tests.embree_scene import CityScene
from tests.metrics.whole_maps import gdop_by_inverse, seen

pytestmark = pytest.mark.data

BOUNDS, CRS, REFERENCE = (-74.02, 40.70, -73.98, 40.73), "EPSG:32618", (-74.0, 40.715)
LATE, EARLY = "2020-04-27T16:00:00Z", "2020-04-27T00:20:00Z"  # early one satellite stands at 8 degrees
ALTITUDES_M = [20.0, 60.0, 122.0]
OVERSAMPLE = 5

# Least shares by altitude: all answers, those blocked in truth, those clear in truth.
BARS_5M = ((0.975, 0.992, 0.996), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))
BARS_2M = ((0.988, 0.996, 0.998), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))
AGREEMENT = (0.993, 0.997, 0.998)  # least share of right answers by altitude; plain cells: 0.978, 0.994, 0.997
WITHIN = (0.96, 0.985, 0.99)  # least share of cells whose m is within 0.02 of the exact one; plain: 0.90, 0.97, 0.99


def region_of(resolution_m: float = 5.0) -> Grid:
    return Grid.from_bounds(BOUNDS, resolution_m, CRS, nest_with_m=(2, 5, 10))


@pytest.fixture(scope="module")
def city(data_dir) -> City:
    buildings = read_buildings(Buildings(data_dir / "osm" / "lower-manhattan.osm.pbf"), CRS).buildings
    return City(CRS, region_of().padded(200, 220, 240, 160).bounds_m, buildings)  # as far as the file reaches


@pytest.fixture(scope="module")
def scene(city) -> CityScene:
    return CityScene(city.buildings.polygons, city.buildings.height_m)


def angles_at(data_dir, time: str) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths and elevations at a time."""
    orbits, convergence_rad = data_dir / "gps" / "gps-ops_2020-04-27.tle", region_of().convergence_rad(*REFERENCE)
    sky = look_angles(read_orbits(orbits), [time], *REFERENCE, convergence_rad=convergence_rad).under(5.0)
    assert sky.elevation_rad.min() < math.radians(8.5 if time == EARLY else 18)
    return sky.azimuth_rad[0], sky.elevation_rad[0]


def receivers(surface: Surface, altitude_m: float, num: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns of random free cells, and the points above their centres."""
    free = np.argwhere(np.asarray(surface.crop(surface.roof_m)) < altitude_m)
    row, col = np.random.default_rng(0).choice(free, num, replace=False).T
    return row, col, np.column_stack([*surface.region.xy_of_cell(row, col), np.full(num, altitude_m)])


def check_shares(is_seen: np.ndarray, is_clear: np.ndarray, bars, k: int) -> None:
    agrees = is_seen == is_clear
    shares = agrees.mean(), agrees[~is_clear].mean(), agrees[is_clear].mean()
    for share, bar in zip(shares, bars, strict=True):
        assert share >= bar[k]


@pytest.mark.parametrize(("resolution_m", "bars"), [(5.0, BARS_5M), pytest.param(2.0, BARS_2M, marks=pytest.mark.slow)])
def test_visibility_agrees_with_embree(city, scene, data_dir, resolution_m, bars):
    angles, region = angles_at(data_dir, LATE), region_of(resolution_m)
    margins_m = shadow_reach_m(*angles, city.buildings.height_m.max(), 20.0, resolution_m)
    grid = region.padded(*(math.ceil(min(margin, 2000) / resolution_m) for margin in margins_m))  # no data beyond
    surface = build_surface(city, region, grid)
    words = seen(visibility(surface, *angles, ALTITUDES_M), len(angles[0]))
    for k, altitude_m in enumerate(ALTITUDES_M):
        row, col, start_m = receivers(surface, altitude_m, 5000)
        check_shares(words[:, k, row, col], scene.sees(start_m, unit_vectors(*angles)), bars, k)


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
    return np.clip((20 - np.minimum(gdop_by_inverse(is_seen.astype(float), directions), 20)) / 19, 0, 1)


@pytest.mark.slow
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
        assert (of["fine"] == is_clear).mean() >= max(AGREEMENT[k], (of["plain"] == is_clear).mean())
        assert (np.abs(m["fine"] - exact_m) <= 0.02).mean() >= WITHIN[k]
        assert not np.any(of["surely seen"] & ~is_clear)
        assert not np.any(is_clear & ~of["maybe seen"])
        assert np.all((m["surely seen"] <= exact_m + 1e-9) & (exact_m <= m["maybe seen"] + 1e-9))
        assert (of["surely seen"] == of["maybe seen"]).mean() >= 0.93
