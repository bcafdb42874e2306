"""Supersampling: the answers of the supersampled surface at the map's cells, crops, bounds."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.lidar import Lidar, compute_lidar, lidar_at_centres
from jaxurban.metrics.visibility import bounding_visibility, visibility
from jaxurban.world.city import Footprints
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface, obstacle_mask

UTM = "EPSG:32618"
OUTER = Grid(UTM, 6.0, 750_000, 96_000, 40, 44)
REGION = Grid(UTM, 6.0, 750_009, 96_007, 20, 24)
# Axes, diagonals and directions beside them.
ANGLES = np.radians([(0, 20), (90, 25), (180, 15), (270, 30), (45, 20), (225, 35), (44.9, 15), (200, 60), (110, 10)])


def fine_city(oversample: int, region: Grid = REGION, outer: Grid = OUTER, terrain: bool = False) -> Surface:
    """Return boxes of subcells, the same whatever part of the world is asked for."""
    whole = OUTER.refined(oversample)
    row, col = np.indices(whole.shape)
    rng = np.random.default_rng(3)
    coarse = rng.uniform(0, 40, (20, 20)) * (rng.random((20, 20)) < 0.3)
    roof_m = coarse[row * 20 // whole.num_rows, col * 20 // whole.num_cols]
    ground_m = 6 * np.sin(row / whole.num_rows * 9) + 5 * np.cos(col / whole.num_cols * 7)
    part = outer.refined(oversample).window_in(whole)
    return Surface(
        jnp.asarray(roof_m[part], jnp.float32),
        jnp.asarray(ground_m[part], jnp.float32) if terrain else None,
        None,
        None,
        outer.refined(oversample),
        region.refined(oversample),
    )


@pytest.mark.parametrize("terrain", [False, True])
@pytest.mark.parametrize("oversample", [3, 2])
def test_satellites_at_centres_are_those_of_the_full_fine_sweep(oversample, terrain):
    supersampled = fine_city(oversample, terrain=terrain)
    centre = slice(oversample // 2, None, oversample)
    found = visibility(supersampled, *ANGLES.T, [10.0, 25.0], every=oversample)
    expected = np.asarray(visibility(supersampled, *ANGLES.T, [10.0, 25.0]))[..., centre, centre]
    assert len(np.unique(expected)) > 10
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("terrain", [False, True])
def test_a_sub_box_equals_the_crop_bit_for_bit(terrain):
    inner = Grid(UTM, 6.0, REGION.first_row + 5, REGION.first_col + 3, 11, 13)
    around = inner.padded(10, 14, 8, 8)  # to the end in the west and south, where these satellites stand
    angles = ANGLES[[3, 5, 7, 2]]
    params = Lidar(beams=5, azimuths=12, range_m=40.0)
    found = []
    for region, outer in ((REGION, OUTER), (inner, around)):
        supersampled = fine_city(3, region, outer, terrain)
        seen = visibility(supersampled, *angles.T, [10.0, 25.0], every=3)
        free = jnp.zeros((2, *region.shape), bool)
        found.append((np.asarray(seen), np.asarray(lidar_at_centres(supersampled, 3, free, [10.0, 25.0], params))))
    window = inner.window_in(REGION)
    for whole, part in zip(*found, strict=True):
        assert len(np.unique(part)) > 2
        np.testing.assert_array_equal(whole[..., *window], part)


def test_oversampling_by_one_is_the_plain_lidar():
    supersampled = fine_city(1)
    params = Lidar(beams=4, azimuths=12, range_m=40.0)
    is_obstacle = obstacle_mask(supersampled.crop(supersampled.roof_m), [10.0])
    np.testing.assert_array_equal(
        lidar_at_centres(supersampled, 1, is_obstacle, [10.0], params), compute_lidar(supersampled, [10.0], params)
    )


@pytest.mark.parametrize("oversample", [1, 3])
def test_who_is_seen_past_roofs_that_hide_most_is_seen_past_those_that_hide_least(oversample):
    view = fine_city(oversample), *ANGLES.T, [10.0, 25.0], oversample
    most, least = (bounding_visibility(*view, hides_most=hides_most) for hides_most in (True, False))
    assert np.all(most & ~least == 0)
    assert np.any(most != least)


@pytest.mark.slow
def test_bounds_are_ordered_and_fine_maps_keep_the_obstacles_of_plain_ones():
    x0, y0 = 500_000.0, 4_500_000.0
    polygons = np.array([shapely.box(x0 + x, y0 + y, x0 + x + 23, y0 + y + 31) for x in (40, 110) for y in (50, 120)])
    zeros = np.zeros(4)
    buildings = Footprints(polygons, np.array([20.0, 60, 90, 35]), zeros, zeros.astype(np.uint8), zeros.astype(bool))
    city = ju.City(UTM, (x0, y0, x0 + 200.0, y0 + 200.0), buildings)
    options = {"resolution_m": 10.0, "altitudes_m": (15.0, 40.0), "lidar": Lidar(azimuths=24)}
    plain, supersampled = (
        ju.build_maps(city, oversample=oversample, gps=ju.Gps(bounds=oversample > 1), **options)
        for oversample in (1, 3)
    )
    np.testing.assert_array_equal(plain.ds["obstacle"], supersampled.ds["obstacle"])
    assert not (supersampled.ds["gps_lower"] > supersampled.ds["gps_upper"]).any()
    assert (supersampled.ds["gps_lower"] < supersampled.ds["gps_upper"]).any()
    assert not np.array_equal(plain.ds["lidar"], supersampled.ds["lidar"])


def test_bounds_want_an_odd_oversample():
    settings = {
        "region": {"bounds": [-74.0, 40.7, -73.9, 40.8], "oversample": 4},
        "buildings": {"source": "synthetic"},
        "gps": {"bounds": True},
    }
    with pytest.raises(InputError, match="odd oversample"):
        Scenario.from_dict(settings)
