"""The GPS metric and its maps: equations, obstacles, subsets of satellites; supersampled answers and bounds."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.dop import Clocks
from jaxurban.kernels.shadows.sweep import digital_line, shadow_height
from jaxurban.metrics import gps
from jaxurban.metrics.gps import Gps, Rating, gps_metric, maps_of_words, rating, satellites_of
from jaxurban.metrics.visibility import bounding_visibility, shadow_reach_m, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface
from tests.metrics.whole_maps import compute_gps, gps_maps, surface_on

# Axes, diagonals and directions a hair beside them, high and low.
AZIMUTH_DEG = [0.0, 90.0, 180.0, 270.0, 45.0, 135.0, 225.0, 315.0, 44.999, 89.999, 200.0, 20.0, 155.0]
ELEVATION_DEG = [35.0, 50.0, 15.0, 60.0, 30.0, 40.0, 70.0, 25.0, 55.0, 20.0, 80.0, 10.0, 45.0]
RNG = np.random.default_rng(0)
GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 40, 50)  # far from the CRS's origin

ROOF_M = np.where(RNG.random(GRID.shape) < 0.3, RNG.uniform(5, 60, GRID.shape), 0)


def test_m_falls_from_1_at_gdop_1_to_0_at_the_threshold():
    gdop = jnp.array([0.5, 1.0, 10.5, 20.0, 40.0, jnp.inf])
    np.testing.assert_allclose(gps_metric(gdop, 20.0), [1, 1, 0.5, 0, 0, 0], rtol=1e-6)
    assert np.all(np.isfinite(jax.vmap(jax.grad(gps_metric), (0, None))(gdop, 20.0)))


def test_ratings_follow_the_papers_table():
    gdop = np.array([[0.9, 1.0, 1.1, 4.0], [4.1, 6.0, 7.9, 8.1], [20.0, 20.1, 300.0, np.inf]])
    names = "IDEAL IDEAL EXCELLENT EXCELLENT GOOD GOOD MODERATE FAIR FAIR POOR POOR POOR"
    assert " ".join(Rating(each).name for each in rating(gdop).flat) == names


def test_shadow_reach_is_the_length_of_the_longest_shadow_by_side():
    west, south, east, north = shadow_reach_m(np.radians([90.0, 225.0]), np.radians([45.0, 45.0]), 120.0, 20.0, 5.0)
    np.testing.assert_allclose([west, south, east], [100 / math.sqrt(2) + 5, 100 / math.sqrt(2) + 5, 105])
    assert north < 5.1  # cos 90 degrees is not quite 0
    assert shadow_reach_m(np.radians([90.0]), np.radians([45.0]), 20.0, 20.0, 5.0) == (0, 0, 0, 0)
    assert shadow_reach_m(np.array([1.0]), np.array([0.0]), 30.0, 20.0, 5.0) == (0, 0, math.inf, math.inf)


def test_visibility_keeps_float64_where_only_the_caller_enabled_it():
    with jax.enable_x64(True):
        roof_m = jnp.asarray(np.where(ROOF_M > 50, 20 + 1e-9, 0.0))  # one nanometre above the altitude hides
        surface = Surface(roof_m, None, None, None, GRID, GRID)
        for azimuth_rad in (0.0, np.pi / 2):
            words = visibility(surface, [azimuth_rad], [0.0], [20.0])
            line = digital_line(azimuth_rad, 0.0, 5.0, GRID.first_row, GRID.first_col, GRID.shape)
            expected = np.asarray(shadow_height(surface.roof_m, line)) <= 20.0
            assert 0 < expected.sum() < expected.size
            np.testing.assert_array_equal(np.asarray(words)[0, 0] == 1, expected)


def test_without_satellites_m_is_0():
    maps = compute_gps(surface_on(ROOF_M, GRID, GRID), [], [], [5.0, 60.0])
    assert maps.m.shape == (2, *GRID.shape)
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


OUTER = Grid("EPSG:32618", 6.0, 750_000, 96_000, 40, 44)
REGION = Grid("EPSG:32618", 6.0, 750_009, 96_007, 20, 24)
ANGLES = np.radians([AZIMUTH_DEG, ELEVATION_DEG])


def fine_city(oversample: int, terrain: bool = False) -> Surface:
    """Return boxes of subcells, the same for every oversample."""
    grid, rng = OUTER.refined(oversample), np.random.default_rng(3)
    row, col = np.indices(grid.shape)
    coarse = rng.uniform(0, 40, (20, 20)) * (rng.random((20, 20)) < 0.3)
    roof_m = coarse[row * 20 // grid.num_rows, col * 20 // grid.num_cols]
    ground_m = 6 * np.sin(row / grid.num_rows * 9) + 5 * np.cos(col / grid.num_cols * 7)
    return surface_on(roof_m, grid, REGION.refined(oversample), ground_m if terrain else None)


@pytest.mark.parametrize("terrain", [False, True])
@pytest.mark.parametrize("oversample", [3, 2])
def test_satellites_at_centres_are_those_of_the_full_fine_sweep(oversample, terrain):
    supersampled = fine_city(oversample, terrain=terrain)
    centre = slice(oversample // 2, None, oversample)
    found = visibility(supersampled, *ANGLES, [10.0, 25.0], every=oversample)
    expected = np.asarray(visibility(supersampled, *ANGLES, [10.0, 25.0]))[..., centre, centre]
    assert len(np.unique(expected)) > 10
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("oversample", [1, 3])
def test_who_is_seen_past_roofs_that_hide_most_is_seen_past_those_that_hide_least(oversample):
    view = fine_city(oversample), *ANGLES, [10.0, 25.0], oversample
    most, least = (bounding_visibility(*view, hides_most=hides_most) for hides_most in (True, False))
    assert np.all(most & ~least == 0)
    assert np.any(most != least)
