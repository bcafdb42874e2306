"""The lidar metric against Embree rays through the exact prisms of Lower Manhattan."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.rasterise import build_surface
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.settings import Buildings
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from tests.embree_scene import CityScene

pytestmark = pytest.mark.data

NUM_CELLS = 1500
REGION = Grid.from_bounds((-74.02, 40.70, -73.98, 40.73), 5.0, "EPSG:32618")
PARAMS = Lidar()


@pytest.fixture(scope="module")
def city(data_dir) -> City:
    bounds_m = REGION.padded(20, 20, 20, 20).bounds_m
    source = read_buildings(Buildings(data_dir / "osm" / "lower-manhattan.osm.pbf"), REGION.crs, bounds_m=bounds_m)
    return City(REGION.crs, bounds_m, buildings=source.buildings)


@pytest.fixture(scope="module")
def scene(city) -> CityScene:
    return CityScene(city.buildings.polygons, city.buildings.height_m)


def scan_with_embree(scene: CityScene, start_m: np.ndarray) -> np.ndarray:
    """Return the share of scan positions that return at each point, every beam a ray. Walls begin at the ground."""
    azimuth_rad = 2 * np.pi * np.arange(PARAMS.azimuths) / PARAMS.azimuths
    returned = np.zeros((len(start_m), PARAMS.azimuths), bool)
    for elevation_rad in sorted(PARAMS.elevations_rad, key=abs):  # the likeliest beams first, to save rays
        point, k = np.nonzero(~returned)
        level = np.cos(elevation_rad)
        up = np.full(len(k), np.sin(elevation_rad))
        direction = np.column_stack([level * np.sin(azimuth_rad[k]), level * np.cos(azimuth_rad[k]), up])
        returned[point, k] = scene.distance_m(start_m[point], direction) <= PARAMS.range_m
    return returned.mean(axis=1)


@pytest.mark.parametrize(
    ("altitude_m", "mean_error", "bias"),
    [
        (20.0, 0.012, 0.002),
        pytest.param(60.0, 0.009, 0.004, marks=pytest.mark.slow),
        pytest.param(122.0, 0.004, 0.002, marks=pytest.mark.slow),
    ],
)
def test_lidar_agrees_with_embree_at_5_m(city, scene, altitude_m, mean_error, bias):
    surface = build_surface(city, REGION, REGION.padded(20, 20, 20, 20))
    m = np.asarray(compute_lidar(surface, jnp.asarray([altitude_m]), PARAMS))[0]
    free = np.argwhere(np.asarray(surface.crop(surface.roof_m)) < altitude_m)
    row, col = np.random.default_rng(0).choice(free, NUM_CELLS, replace=False).T
    start_m = np.column_stack([REGION.x_m[col], REGION.y_m[row], np.full(NUM_CELLS, altitude_m)])
    difference = m[row, col] - scan_with_embree(scene, start_m)
    assert np.abs(difference).mean() <= mean_error
    assert abs(difference.mean()) <= bias
