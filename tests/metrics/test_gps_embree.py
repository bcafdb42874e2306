"""Visibility over Lower Manhattan against Embree rays through the exact polygons, satellite by satellite."""

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.orbits import look_angles, read_orbits
from jaxurban.io.read.rasterise import burn
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.visibility import shadow_reach_m, visibility
from jaxurban.settings import Buildings as BuildingSource
from jaxurban.world.city import Footprints
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface
from tests.embree_scene import CityScene

BOUNDS = (-74.02, 40.70, -73.98, 40.73)
CRS = "EPSG:32618"
REFERENCE = (-74.0, 40.715)
ALTITUDES_M = [20.0, 60.0, 122.0]
NUM_CELLS = 5000

# Least shares by altitude: all answers, those blocked in truth, those clear in truth.
BARS_5M = ((0.975, 0.992, 0.996), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))
BARS_2M = ((0.988, 0.996, 0.998), (0.86, 0.91, 0.91), (0.99, 0.99, 0.99))


@dataclass(frozen=True)
class Manhattan:
    buildings: Footprints
    scene: CityScene


@pytest.fixture(scope="module")
def manhattan(data_dir):
    buildings = read_buildings(BuildingSource(data_dir / "osm" / "lower-manhattan.osm.pbf"), CRS).buildings
    return Manhattan(buildings, CityScene(buildings.polygons, buildings.height_m))


@pytest.mark.data
@pytest.mark.parametrize(
    ("time", "resolution_m", "bars", "lowest_deg"),
    [
        ("2020-04-27T16:00:00Z", 5.0, BARS_5M, 18),
        pytest.param("2020-04-27T00:20:00Z", 5.0, BARS_5M, 8, marks=pytest.mark.slow),
        pytest.param("2020-04-27T16:00:00Z", 2.0, BARS_2M, 18, marks=pytest.mark.slow),
    ],
)
def test_visibility_agrees_with_embree(data_dir, manhattan, time, resolution_m, bars, lowest_deg):
    region = Grid.from_bounds(BOUNDS, resolution_m, CRS, nest_with_m=(2, 5, 10))
    convergence_rad = region.convergence_rad(*REFERENCE)
    orbits = read_orbits(data_dir / "gps" / "gps-ops_2020-04-27.tle")
    sky = look_angles(orbits, [time], *REFERENCE, convergence_rad=convergence_rad).under(5.0)
    azimuth, elevation = sky.azimuth_rad[0], sky.elevation_rad[0]
    assert elevation.min() < math.radians(lowest_deg)
    margins_m = shadow_reach_m(azimuth, elevation, manhattan.buildings.height_m.max(), 20.0, resolution_m)
    grid = region.padded(*(math.ceil(min(margin, 2000) / resolution_m) for margin in margins_m))  # no data beyond
    roof_m = burn(manhattan.buildings.polygons, manhattan.buildings.height_m, grid, 0.0, "float32")[0]
    surface = Surface(jnp.asarray(roof_m), None, None, None, grid, region)
    words = np.asarray(visibility(surface, azimuth, elevation, ALTITUDES_M))[0]

    directions = unit_vectors(azimuth, elevation)
    rng = np.random.default_rng(0)
    for k, altitude_m in enumerate(ALTITUDES_M):
        free = np.argwhere(np.asarray(surface.crop(surface.roof_m)) < altitude_m)
        row, col = rng.choice(free, NUM_CELLS, replace=False).T
        start_m = np.column_stack([*region.xy_of_cell(row, col), np.full(NUM_CELLS, altitude_m)])
        is_blocked = np.array([manhattan.scene.is_blocked(start_m, np.tile(d, (NUM_CELLS, 1))) for d in directions])
        is_seen = (words[k, row, col] >> np.arange(len(directions), dtype=np.uint32)[:, None]) & 1 == 1
        agrees = is_seen != is_blocked
        shares = agrees.mean(), agrees[is_blocked].mean(), agrees[~is_blocked].mean()
        print(f"{time} {resolution_m} m, {altitude_m} m up:", *(f"{share:.4f}" for share in shares))
        for share, bar in zip(shares, bars, strict=True):
            assert share >= bar[k]
