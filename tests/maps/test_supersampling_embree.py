"""Supersampled answers and bounds against Embree rays through the exact prisms of Lower Manhattan."""

import math

import numpy as np
import pytest

from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.orbits import look_angles, read_orbits
from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.visibility import bounding_visibility, visibility
from jaxurban.settings import Buildings
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from tests.embree_scene import CityScene

pytestmark = [pytest.mark.data, pytest.mark.slow]

REFERENCE = (-74.0, 40.715)
TIME = "2020-04-27T00:20:00Z"  # one satellite stands at 8 degrees
ALTITUDES_M = [20.0, 60.0, 122.0]
NUM_CELLS, OVERSAMPLE = 4000, 5
AGREEMENT = (0.993, 0.997, 0.998)  # least share of right answers by altitude; plain cells: 0.978, 0.994, 0.997
WITHIN = (0.96, 0.985, 0.99)  # least share of cells whose m is within 0.02 of the exact one; plain: 0.90, 0.97, 0.99


def metric_of(is_seen: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return m by NumPy's inverse, for ``[S, N]`` answers."""
    rows = np.column_stack([directions, -np.ones(len(directions))])
    normal = np.einsum("sn,si,sj->nij", is_seen.astype(float), rows, rows)
    is_determined = (is_seen.sum(axis=0) >= 4) & (np.linalg.cond(normal) < 1e8)
    inverse = np.linalg.inv(np.where(is_determined[:, None, None], normal, np.eye(4)))
    gdop = np.where(is_determined, np.sqrt(np.trace(inverse, axis1=1, axis2=2)), np.inf)
    return np.clip((20 - np.minimum(gdop, 20)) / 19, 0, 1)


def bits(words: np.ndarray, num: int) -> np.ndarray:
    return np.array([(np.asarray(words)[0] >> np.uint32(s)) & 1 == 1 for s in range(num)])


def test_oversampled_answers_and_bounds_of_lower_manhattan_hold_against_embree(data_dir):
    region = Grid.from_bounds((-74.02, 40.70, -73.98, 40.73), 5.0, "EPSG:32618", nest_with_m=(2, 5, 10))
    outer = region.padded(200, 220, 240, 160)  # as far as the file reaches
    buildings = read_buildings(Buildings(data_dir / "osm" / "lower-manhattan.osm.pbf"), region.crs).buildings
    scene = CityScene(buildings.polygons, buildings.height_m)
    city = City(region.crs, outer.bounds_m, buildings)
    sky = look_angles(
        read_orbits(data_dir / "gps" / "gps-ops_2020-04-27.tle"),
        [TIME],
        *REFERENCE,
        convergence_rad=region.convergence_rad(*REFERENCE),
    ).under(5.0)
    angles = sky.azimuth_rad[0], sky.elevation_rad[0]
    assert angles[1].min() < math.radians(8.5)
    directions = unit_vectors(*angles)
    surface = build_surface(city, region, outer)
    finer = city, region.refined(OVERSAMPLE), outer.refined(OVERSAMPLE)
    fine, touched = (build_surface(*finer, all_touched) for all_touched in (False, True))
    view = *angles, ALTITUDES_M, OVERSAMPLE
    makers = {
        "plain": lambda: visibility(surface, *angles, ALTITUDES_M),
        "fine": lambda: visibility(fine, *angles, ALTITUDES_M, every=OVERSAMPLE),
        "surely seen": lambda: bounding_visibility(touched, *view, hides_most=True),
        "maybe seen": lambda: bounding_visibility(fine, *view, hides_most=False),
    }
    words = {name: bits(make(), len(directions)) for name, make in makers.items()}
    rng = np.random.default_rng(1)
    for k, altitude_m in enumerate(ALTITUDES_M):
        free = np.argwhere(np.asarray(surface.crop(surface.roof_m)) < altitude_m)
        row, col = rng.choice(free, NUM_CELLS, replace=False).T
        start_m = np.column_stack([*region.xy_of_cell(row, col), np.full(NUM_CELLS, altitude_m)])
        is_clear = ~np.array([scene.is_blocked(start_m, np.tile(d, (NUM_CELLS, 1))) for d in directions])
        seen = {name: values[:, k, row, col] for name, values in words.items()}
        agreement = {name: (values == is_clear).mean() for name, values in seen.items()}
        m = {name: metric_of(values, directions) for name, values in seen.items()}
        exact_m = metric_of(is_clear, directions)
        within = {name: (np.abs(values - exact_m) <= 0.02).mean() for name, values in m.items()}
        certain = (seen["surely seen"] == seen["maybe seen"]).mean()
        print(altitude_m, "m: agreement", agreement, "m within 0.02", within, "certain answers", certain)
        assert agreement["fine"] >= max(AGREEMENT[k], agreement["plain"])
        assert within["fine"] >= WITHIN[k]
        assert not np.any(seen["surely seen"] & ~is_clear)
        assert not np.any(is_clear & ~seen["maybe seen"])
        assert np.all((m["surely seen"] <= exact_m + 1e-9) & (exact_m <= m["maybe seen"] + 1e-9))
        assert certain >= 0.93
