"""Doubling against the sweep: the same shadows and words, whole, within rings and over a city."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.shadows.sweep import (
    Ring,
    digital_lines,
    edges_by_doubling,
    edges_by_sweep,
    heights_by_doubling,
    heights_by_sweep,
    num_passes,
    shadow_height,
    shadow_heights_at_once,
    stacked,
    words_by_doubling,
    words_by_sweep,
)
from jaxurban.kernels.shadows.sweep_cpu import hand_on
from jaxurban.kernels.soft_step import satellite_weights
from jaxurban.metrics.visibility import SkyView, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

SHAPE = (37, 52)
FIRST = (901_234, -117_003)
AZIMUTH_RAD = np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0, 17.0, 63.3, 111.9, 200.0, 254.4, 340.7])
ELEVATION_RAD = np.deg2rad(np.linspace(3.0, 80.0, len(AZIMUTH_RAD)))
ROUNDING_M = 1e-3


def tops(shape=SHAPE, seed=0):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < 0.2, rng.uniform(5, 150, shape), 0).astype(np.float32)


def lines_of(shape, row=0, col=0):
    return digital_lines(AZIMUTH_RAD, ELEVATION_RAD, 5.0, FIRST[0] + row, FIRST[1] + col, shape)


def swept(top_m, lines, rings=None):
    each = zip(lines, rings or [None] * len(lines), strict=True)
    return np.stack([np.asarray(shadow_height(top_m, line, ring)) for line, ring in each])


@pytest.mark.slow
@pytest.mark.parametrize("shape", [SHAPE, SHAPE[::-1], (1, 9), (9, 1)])
def test_every_direction_throws_the_sweep_s_shadows(shape):
    top_m, lines = tops(shape), lines_of(shape)
    found = shadow_heights_at_once(top_m, stacked(lines), passes=num_passes(max(shape)))
    expected = swept(top_m, lines)
    np.testing.assert_array_equal(np.isneginf(found), np.isneginf(expected))
    np.testing.assert_allclose(found, expected, atol=ROUNDING_M)


def test_fewer_passes_leave_out_only_what_stands_farther():
    top_m, lines = tops(), lines_of(SHAPE)
    near = np.asarray(shadow_heights_at_once(top_m, stacked(lines), passes=num_passes(8)))
    far = np.zeros_like(near)
    for s, line in enumerate(lines):
        for row in range(SHAPE[0]):
            for col in range(SHAPE[1]):
                far[s, row, col] = walk(top_m, line, row, col, 8)
    np.testing.assert_allclose(near, far, atol=ROUNDING_M)


def walk(top_m, line, row, col, most_steps):
    """Return the shadow on a cell by walking along its line."""
    is_rows, ahead = line.heading in (0, 1), 1 if line.heading in (0, 2) else -1
    at, side = (row, col) if is_rows else (col, row)
    length, width = SHAPE if is_rows else SHAPE[::-1]
    shadow_m = -math.inf
    for k in range(1, most_steps + 1):
        side += int(line.shifts[at])
        at += ahead
        if not (0 <= at < length and 0 <= side < width):
            break
        top = top_m[(at, side) if is_rows else (side, at)]
        shadow_m = max(shadow_m, top + (0.25 - k) * float(line.drop_m))
    return shadow_m


@pytest.mark.slow
def test_tiles_hand_on_within_rings_as_the_sweep_does():
    top_m, inner = tops(), (slice(9, 30), slice(12, 40))
    whole = swept(top_m, lines_of(SHAPE))
    lines = lines_of((23, 30), 8, 11)
    carried = np.maximum(top_m + 0.25 * np.array([line.drop_m for line in lines])[:, None, None], whole)
    carried = carried.astype(np.float32)[:, 8:31, 11:41]
    rings = [Ring(c[0], c[-1], c[1:-1, 0], c[1:-1, -1]) for c in carried]
    ring = Ring(*(np.stack(values) for values in zip(*rings, strict=True)))
    passes = num_passes(30)
    found = shadow_heights_at_once(top_m[inner], stacked(lines), passes=passes, rings=ring)
    np.testing.assert_allclose(found, swept(top_m[inner], lines, rings), atol=ROUNDING_M)
    forms = hand_on, jax.jit(edges_by_sweep), jax.jit(edges_by_doubling)
    for numba, sweep, doubling in zip(
        *(form(top_m[inner].copy(), stacked(lines), ring) for form in forms), strict=True
    ):
        np.testing.assert_array_equal(sweep, numba)
        np.testing.assert_allclose(doubling, numba, atol=ROUNDING_M)


@pytest.mark.slow
def test_the_derivative_of_a_shadow_is_that_of_its_one_roof():
    top_m = np.zeros(SHAPE, np.float32)
    top_m[12, 9] = 60.0
    lines = stacked(digital_lines([0.0], [math.radians(30)], 5.0, *FIRST, SHAPE))
    slope = jax.grad(lambda top: shadow_heights_at_once(top, lines, passes=6)[0, 8, 9])(jnp.asarray(top_m))
    expected = np.zeros(SHAPE)
    expected[12, 9] = 1.0
    np.testing.assert_array_equal(slope, expected)


@pytest.mark.slow
def test_soft_shadows_have_the_same_gradients_by_both_forms():
    with jax.enable_x64(True):
        top_m = jnp.asarray(tops(), jnp.float64) + np.random.default_rng(2).uniform(0, 0.1, SHAPE)  # no two tie
        lines, at = stacked(lines_of(SHAPE)), jnp.asarray(np.random.default_rng(3).uniform(size=(14, 20, 30)))

        def weighted(top_m, form):
            shadows_m = form(top_m, lines, (9, 29, 12, 42, 1))
            return jnp.sum(at * satellite_weights(30.0, shadows_m, 2.0))

        (swept, by_sweep), (doubled, by_doubling) = (
            jax.jit(jax.value_and_grad(partial(weighted, form=form)))(top_m)
            for form in (heights_by_sweep, heights_by_doubling)
        )
    assert float(doubled) == pytest.approx(float(swept), rel=1e-12)
    np.testing.assert_allclose(by_doubling, by_sweep, atol=1e-12)
    assert np.count_nonzero(by_sweep) > 50


@pytest.mark.parametrize("form", [words_by_sweep, words_by_doubling])
def test_words_hold_more_than_32_satellites_and_none_that_fills_up(form):
    top_m, num, window = tops(), 67, (9, 29, 12, 42, 1)
    lines = (lines_of(SHAPE) * 5)[:70]
    height_m = (np.random.default_rng(1).uniform(0, 9, (20, 30)) + np.array([5.0, 60.0])[:, None, None]).astype(
        np.float32
    )
    arguments = stacked(lines), np.int32(num), None
    words = np.asarray(jax.jit(form, static_argnames="window")(top_m, height_m, *arguments, window=window))
    assert words.shape == (3, 2, 20, 30)
    shadows_m = swept(top_m, lines)[:, 9:29, 12:42]
    for s in range(70):
        seen = words[s // 32] >> (s % 32) & 1
        np.testing.assert_array_equal(seen, (shadows_m[s] <= height_m) & (s < num))
    assert not (words[2] >> 6).any()


@pytest.mark.slow
@pytest.mark.parametrize("has_terrain", [False, True])
def test_the_words_of_a_city_are_equal_by_all_forms(has_terrain):
    city = ju.demo_city(1500, 1500)
    x_min, y_min, _, _ = city.extent_m
    region = Grid(city.crs, 5.0, round(y_min / 5) + 70, round(x_min / 5) + 70, 160, 160)
    outer = region.padded(70, 70, 70, 70)
    surface = build_surface(city, region, outer)
    if has_terrain:
        hills_m = 20 * np.sin(np.arange(300) / 30)[:, None] * np.cos(np.arange(300) / 40)
        surface = Surface(surface.roof_m, hills_m.astype(np.float32), None, None, outer, region)
    numba, jaxs = (
        np.asarray(visibility(surface, AZIMUTH_RAD, ELEVATION_RAD, (20.0, 60.0), engine=engine))
        for engine in ("numba", "jax")
    )
    np.testing.assert_array_equal(jaxs, numba)
    height_m = np.float32([20, 60])[:, None, None] + (surface.terrain_m[70:-70, 70:-70] if has_terrain else 0)
    sky = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)
    form = jax.jit(words_by_doubling, static_argnames="window")
    doubled = form(surface.top_m, height_m, sky.lines, sky.num, None, window=(70, 230, 70, 230, 1))
    np.testing.assert_array_equal(doubled, numba)
    share = np.mean([numba >> s & 1 for s in range(len(AZIMUTH_RAD))])
    assert 0.4 < share < 0.99
