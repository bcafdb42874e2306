"""The GPS metric and its maps: equations, crops, obstacles, terrain."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.dop import Clocks
from jaxurban.kernels.shadows.sweep import digital_line, shadow_height
from jaxurban.metrics import gps
from jaxurban.metrics.gps import Gps, Rating, gps_metric, maps_of_words, rating, satellites_of
from jaxurban.metrics.visibility import shadow_reach_m, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface
from tests.metrics.whole_maps import compute_gps, gps_maps, seen, surface_on

ALTITUDES_M = [20.0, 60.0]
# Axes, diagonals and directions a hair beside them, high and low.
AZIMUTH_DEG = [0.0, 90.0, 180.0, 270.0, 45.0, 135.0, 225.0, 315.0, 44.999, 89.999, 200.0, 20.0, 155.0]
ELEVATION_DEG = [35.0, 50.0, 15.0, 60.0, 30.0, 40.0, 70.0, 25.0, 55.0, 20.0, 80.0, 10.0, 45.0]
AZIMUTH_RAD, ELEVATION_RAD = np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG)


def random_city(num_rows=200, num_cols=220, share=0.02, seed=0):
    """Roofs of up to 60 m on a grid far from the CRS's origin."""
    rng = np.random.default_rng(seed)
    roof_m = np.where(rng.random((num_rows, num_cols)) < share, rng.uniform(5, 60, (num_rows, num_cols)), 0)
    return roof_m, Grid("EPSG:32618", 5.0, 901_000, 116_000, num_rows, num_cols)


def test_m_falls_from_1_at_gdop_1_to_0_at_the_threshold():
    gdop = jnp.array([0.5, 1.0, 10.5, 20.0, 40.0, jnp.inf])
    np.testing.assert_allclose(gps_metric(gdop, 20.0), [1, 1, 0.5, 0, 0, 0], rtol=1e-6)
    assert np.all(np.isfinite(jax.vmap(jax.grad(gps_metric), (0, None))(gdop, 20.0)))


def test_ratings_follow_the_papers_table():
    gdop = np.array([[0.9, 1.0, 1.1, 4.0], [4.1, 6.0, 7.9, 8.1], [20.0, 20.1, 300.0, np.inf]])
    names = [["IDEAL", "IDEAL", "EXCELLENT", "EXCELLENT"], ["GOOD", "GOOD", "MODERATE", "FAIR"]]
    names.append(["FAIR", "POOR", "POOR", "POOR"])
    assert [[Rating(r).name for r in row] for row in rating(gdop)] == names


def test_over_terrain_maps_of_a_sub_box_equal_the_crop_of_the_larger_map_bit_for_bit():
    roof_m, grid = random_city()
    ground_m = 15 * np.sin(np.arange(200)[:, None] / 20) * np.cos(np.arange(220) / 30)
    large = Grid(grid.crs, 5.0, grid.first_row + 75, grid.first_col + 80, 50, 60)
    small = Grid(grid.crs, 5.0, large.first_row + 11, large.first_col + 7, 20, 31)
    # The small box's surface reaches just as far as its satellites ask for.
    margins_m = shadow_reach_m(AZIMUTH_RAD, ELEVATION_RAD, 60 + np.ptp(ground_m), min(ALTITUDES_M), 5.0)
    maps = []
    for on, region in ((grid, large), (small.padded(*(math.ceil(margin / 5.0) for margin in margins_m)), small)):
        where = on.window_in(grid)
        surface = surface_on(roof_m[where], on, region, ground_m[where])
        maps.append(compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, ALTITUDES_M))
    for whole, part in zip(*map(jax.tree.leaves, maps), strict=True):
        np.testing.assert_array_equal(whole[:, *small.window_in(large)], part)
    assert len(np.unique(maps[1].num_visible)) > 3


def test_shadow_reach_is_the_length_of_the_longest_shadow_by_side():
    west, south, east, north = shadow_reach_m(np.radians([90.0, 225.0]), np.radians([45.0, 45.0]), 120.0, 20.0, 5.0)
    np.testing.assert_allclose([west, south, east], [100 / math.sqrt(2) + 5, 100 / math.sqrt(2) + 5, 105])
    assert north < 5.1  # cos 90 degrees is not quite 0
    assert shadow_reach_m(np.radians([90.0]), np.radians([45.0]), 20.0, 20.0, 5.0) == (0, 0, 0, 0)
    assert shadow_reach_m(np.array([1.0]), np.array([0.0]), 30.0, 20.0, 5.0) == (0, 0, math.inf, math.inf)


def test_each_bit_is_a_shadow_height_compared_with_the_altitude():
    roof_m, grid = random_city(60, 70)
    region = Grid(grid.crs, 5.0, grid.first_row + 9, grid.first_col + 4, 40, 50)
    azimuth, elevation = np.resize(AZIMUTH_RAD, 35), np.resize(ELEVATION_RAD, 35)
    words = visibility(surface_on(roof_m, grid, region), azimuth, elevation, ALTITUDES_M)
    assert words.shape == (2, 2, 40, 50)
    for s in (0, 7, 31, 32, 34):
        line = digital_line(azimuth[s], elevation[s], 5.0, grid.first_row, grid.first_col, grid.shape)
        shadow_m = np.asarray(shadow_height(jnp.asarray(roof_m, jnp.float32), line))[9:49, 4:54]
        np.testing.assert_array_equal(seen(words, 35)[s], shadow_m <= np.array(ALTITUDES_M)[:, None, None])


def test_visibility_keeps_float64_where_only_the_caller_enabled_it():
    roof_m, grid = random_city(40, 50)
    with jax.enable_x64(True):
        roof_m = jnp.asarray(np.where(roof_m > 20, 20 + 1e-9, 0.0))  # one nanometre above the altitude hides
        surface = Surface(roof_m, None, None, None, grid, grid)
        for azimuth_rad in (0.0, np.pi / 2):
            words = visibility(surface, [azimuth_rad], [0.0], [20.0])
            line = digital_line(azimuth_rad, 0.0, 5.0, grid.first_row, grid.first_col, grid.shape)
            expected = np.asarray(shadow_height(surface.roof_m, line)) <= 20.0
            assert 0 < expected.sum() < expected.size
            np.testing.assert_array_equal(np.asarray(words)[0, 0] == 1, expected)


def test_inside_obstacles_nothing_is_seen_and_fewer_than_four_satellites_give_m_0():
    roof_m, grid = random_city(40, 50, share=0.3)
    altitudes_m = [5.0, 60.0]
    maps = compute_gps(surface_on(roof_m, grid, grid), AZIMUTH_RAD, ELEVATION_RAD, altitudes_m)
    inside, few = roof_m >= np.array(altitudes_m)[:, None, None], np.asarray(maps.num_visible) < 4
    assert np.all(np.asarray(maps.num_visible)[inside] == 0)
    assert (few & ~inside).any()
    assert not few.all()
    assert np.all(np.asarray(maps.m)[few] == 0)
    for name in ("gdop", "tdop"):
        assert np.all(np.isinf(np.asarray(getattr(maps, name))[few]))
    assert np.all(np.isfinite(maps.m))


def test_without_satellites_m_is_0():
    roof_m, grid = random_city(6, 7)
    maps = compute_gps(surface_on(roof_m, grid, grid), np.zeros(0), np.zeros(0), ALTITUDES_M)
    assert maps.m.shape == (2, 6, 7)
    assert not np.any(maps.m)
    assert not np.any(maps.num_visible)


@pytest.mark.parametrize(("num", "clocks"), [(40, None), (20, Clocks(np.arange(20) % 2, 2))])
def test_maps_by_way_of_the_subsets_that_are_seen_are_those_of_every_cell_to_the_bit(num, clocks, monkeypatch):
    rng = np.random.default_rng(num)
    in_view = InView(rng.uniform(0, 2 * np.pi, num), rng.uniform(0.1, 1.5, num), (), clocks=clocks)
    bits = rng.random((40, num)) < 0.5
    subsets = np.stack([(bits[:, w : w + 32] << np.arange(bits[:, w : w + 32].shape[1])).sum(1) for w in (0, 32)])
    words = jnp.asarray(subsets[: -(-num // 32), rng.integers(0, 40, (150, 130))], jnp.uint32)
    is_obstacle = jnp.asarray(rng.random((150, 130)) < 0.2)
    expected = maps_of_words(jnp.where(is_obstacle, 0, words), satellites_of(in_view), Gps().gdop_threshold)

    def of_a_block(block, *arguments):
        assert block.shape[1:] == (gps.BLOCK_CELLS,)
        return maps_of_words(block, *arguments)

    monkeypatch.setattr(gps, "maps_of_words", of_a_block)
    found = gps_maps(words, is_obstacle, in_view)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    assert len(np.unique(found.gdop)) > 20
