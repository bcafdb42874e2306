"""Shadows: a walk along each cell's line, closed forms, whole grids and blocks of them, by sweeps and by doubling."""

import itertools
import math
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxurban as ju
from jaxurban.io.rasterise import build_surface
from jaxurban.kernels.blocks import SMALL
from jaxurban.kernels.shadows.blocks import Receivers, hand_on, mark_visible
from jaxurban.kernels.shadows.sweep import (
    ENTRY_STEPS,
    Ring,
    digital_line,
    digital_lines,
    doubled,
    heights_by_doubling,
    heights_by_sweep,
    shadow_height,
    stacked,
    sweep,
    words_by_doubling,
    words_by_sweep,
)
from jaxurban.kernels.soft_step import satellite_weights
from jaxurban.metrics.visibility import SkyView, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

SHAPE = (23, 31)
FIRST = (901_234, -117_003)  # row and column
AZIMUTH_RAD = np.radians(
    [0, 17, 45, 63.3, 90, 111.9, 135, 160.2, 180, 200, 225, 254.4, 270, 283, 315, 340.7, 10, 0]
)
ELEVATION_RAD = np.radians([5, 31, 12, 60, 8, 20, 75, 90, 30, 9, 14, 22, 41, 17, 50, 6, 0, 0])
ALTITUDES_M = (10.0, 60.0)
ROUNDING_M = 1e-3
INNER, WINDOW = (slice(4, 16), slice(7, 22)), (4, 16, 7, 22)


def tops(shape=SHAPE, dtype=np.float32):
    rng = np.random.default_rng(0)
    return np.where(rng.random(shape) < 0.3, rng.uniform(5, 150, shape), 0).astype(dtype)


def lines_over(shape, first=FIRST, growth=1, which=slice(None)):
    """Return the lines over a grid at ``first`` grown on each side."""
    grown = tuple(side + 2 * growth for side in shape)
    return digital_lines(
        AZIMUTH_RAD[which], ELEVATION_RAD[which], 5.0, *(at - growth for at in first), grown
    )


def swept(top_m, lines):
    return np.stack([np.asarray(shadow_height(top_m, line)) for line in lines])


def swept_within(part_m, lines, rings):
    """Return what `swept` does, of a part inside the ring of one cell that its neighbours hand on to each line."""
    shadows_m = []
    for line, ring in zip(lines, rings, strict=True):
        raised_m = part_m + ENTRY_STEPS * np.asarray(line.drop_m, part_m.dtype)
        rows = np.concatenate([ring.west[:, None], raised_m, ring.east[:, None]], axis=1)
        grown_m = np.concatenate([ring.south[None], rows, ring.north[None]])
        shadows_m.append(np.asarray(sweep(grown_m, line))[1:-1, 1:-1])
    return np.stack(shadows_m)


def words_of(shadows_m, receivers_m):
    """Return the words of shadow heights ``[S, y, x]`` at receivers ``[A, y, x]``."""
    words = np.zeros((-(-len(shadows_m) // 32), *receivers_m.shape), np.uint32)
    for s, shadow_m in enumerate(shadows_m):
        words[s // 32] |= (shadow_m <= receivers_m).astype(np.uint32) << np.uint32(s % 32)
    return words


def by_side(rings):
    """Return rings of one satellite each as one of all."""
    return Ring(*(np.stack(side) for side in zip(*rings, strict=True)))


@cache
def walks(most_steps=10**9):
    """The definition, cell by cell: one step a row (column), sideways by the rounded global line; all directions."""
    found = []
    for azimuth, elevation in zip(AZIMUTH_RAD, ELEVATION_RAD, strict=True):
        east, north = math.sin(azimuth), math.cos(azimuth)
        is_cols = abs(east) > abs(north) * (1 + 1e-12)
        top_m = tops().T if is_cols else tops()
        along, across, first = (east, north, FIRST[1]) if is_cols else (north, east, FIRST[0])
        drop_m = 5.0 / abs(along) * math.tan(elevation)
        shadow_m, ahead = np.full(top_m.shape, -np.inf), int(math.copysign(1, along))
        for row, steps in itertools.product(
            range(len(top_m)), range(1, min(len(top_m), most_steps + 1))
        ):
            beyond = row + ahead * steps
            if 0 <= beyond < len(top_m):
                start, end = (
                    math.floor(across / along * (first + at) + 0.5) for at in (row, beyond)
                )
                for col in range(
                    max(0, start - end), min(top_m.shape[1], top_m.shape[1] + start - end)
                ):
                    height_m = top_m[beyond, col + end - start] - (steps - ENTRY_STEPS) * drop_m
                    shadow_m[row, col] = max(shadow_m[row, col], height_m)
        found.append(shadow_m.T if is_cols else shadow_m)
    return np.array(found)


def test_shadow_heights_equal_a_walk_along_every_line_by_one_program():
    lines = lines_over(SHAPE, growth=0)
    swept(tops(), lines[:1])
    compiled = len(shadow_height.programs)
    np.testing.assert_allclose(swept(tops(), lines), walks(), atol=ROUNDING_M)
    assert len(shadow_height.programs) == compiled


def test_fewer_passes_leave_out_only_what_stands_farther():
    near = [
        doubled(tops() + ENTRY_STEPS * np.float32(line.drop_m), line, passes=3)
        for line in lines_over(SHAPE, growth=0)
    ]
    np.testing.assert_allclose(near, walks(8), atol=ROUNDING_M)


@pytest.mark.parametrize(
    ("azimuth_deg", "axis", "sign"), [(0, 0, 1), (180, 0, -1), (90, 1, 1), (270, 1, -1)]
)
def test_a_wall_throws_the_shadow_of_its_height_away_from_the_satellite(azimuth_deg, axis, sign):
    top_m, middle = np.zeros(SHAPE, np.float32), SHAPE[axis] // 2
    np.moveaxis(top_m, axis, 0)[middle] = 100.0
    line = digital_line(math.radians(azimuth_deg), math.radians(45), 5.0, *FIRST, SHAPE)
    shadow_m = np.moveaxis(np.asarray(shadow_height(top_m, line)), axis, 0)
    behind_m = shadow_m[middle - sign * np.arange(1, 10)].T
    expected_m = 100.0 - (np.arange(1, 10) - ENTRY_STEPS) * 5.0  # tan 45 degrees = 1
    np.testing.assert_allclose(behind_m, np.broadcast_to(expected_m, behind_m.shape), rtol=1e-6)
    assert (
        shadow_m[middle + sign * 2].max() <= 0
    )  # on the sunny side only the ground stands in the way


@settings(max_examples=100)
@given(azimuth_rad=st.floats(-7, 7), first=st.integers(-2_000_000, 2_000_000))
def test_the_digital_line_stays_within_a_cell_of_the_ray(azimuth_rad, first):
    line = digital_line(azimuth_rad, 0.5, 2.0, first, first, (200, 200))
    along, across = sorted((math.cos(azimuth_rad), math.sin(azimuth_rad)), key=abs, reverse=True)
    ahead = int(math.copysign(1, along))
    sideways = np.cumsum(line.shifts[::ahead].astype(int))
    ray = np.arange(1, 201) * across / abs(along)
    assert set(np.unique(line.shifts)) <= {-1, 0, 1}
    assert np.all(np.abs(sideways - ray) <= 1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "form", [heights_by_sweep, pytest.param(heights_by_doubling, marks=pytest.mark.slow)]
)
def test_the_derivative_of_a_shadow_is_that_of_its_one_roof(form):
    top_m, expected = np.zeros(SHAPE, np.float32), np.zeros(SHAPE)
    top_m[12, 9], expected[12, 9] = 60.0, 1.0
    lines = stacked(digital_lines([0.0], [math.radians(30)], 5.0, *FIRST, SHAPE))
    slope = jax.grad(lambda top: form(top, lines, (0, *SHAPE[:1], 0, *SHAPE[1:]))[0, 8, 9])(
        jnp.asarray(top_m)
    )
    np.testing.assert_array_equal(slope, expected)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [SHAPE, (1, 9), (9, 1)])
def test_doubling_throws_the_sweeps_shadows_in_every_direction(shape):
    top_m, lines = tops(shape), lines_over(shape, growth=0)
    found = heights_by_doubling(top_m, stacked(lines), (0, shape[0], 0, shape[1]))
    np.testing.assert_allclose(found, swept(top_m, lines), atol=ROUNDING_M)


@pytest.mark.slow
def test_a_part_within_the_ring_of_its_neighbours_hands_on_the_higher_of_roof_and_shadow():
    whole, lines = (
        swept(tops(), lines_over(SHAPE, growth=0)),
        lines_over((12, 15), (FIRST[0] + 4, FIRST[1] + 7)),
    )
    raised_m = (
        tops() + ENTRY_STEPS * np.array([line.drop_m for line in lines], np.float32)[:, None, None]
    )
    carried = np.maximum(raised_m, whole)
    rings = [Ring(c[0], c[-1], c[1:-1, 0], c[1:-1, -1]) for c in carried[:, 3:17, 6:23]]
    part_m, expected = tops()[INNER].copy(), carried[:, *INNER]
    np.testing.assert_array_equal(swept_within(part_m, lines, rings), whole[:, *INNER])
    rows, cols = hand_on(part_m, stacked(lines), by_side(rings))
    for s, line in enumerate(lines):
        last = [0 if ahead > 0 else -1 for ahead in line.toward]
        np.testing.assert_array_equal(rows[s], expected[s, last[0]])
        np.testing.assert_array_equal(cols[s], expected[s, :, last[1]])


@pytest.mark.slow
def test_soft_shadows_have_the_same_gradients_by_both_forms():
    with jax.enable_x64(True):
        top_m = jnp.asarray(tops(), jnp.float64) + np.random.default_rng(2).uniform(
            0, 0.1, SHAPE
        )  # no two tie
        lines = stacked(lines_over(SHAPE, growth=0))
        at = jnp.asarray(np.random.default_rng(3).uniform(size=(len(AZIMUTH_RAD), 12, 15)))

        def weighted(top_m, form):
            return jnp.sum(at * satellite_weights(30.0, form(top_m, lines, WINDOW), 2.0))

        (swept_sum, by_sweep), (doubled, by_doubling) = (
            jax.jit(jax.value_and_grad(partial(weighted, form=form)))(top_m)
            for form in (heights_by_sweep, heights_by_doubling)
        )
    assert float(doubled) == pytest.approx(float(swept_sum), rel=1e-12)
    np.testing.assert_allclose(by_doubling, by_sweep, atol=1e-12)
    assert np.count_nonzero(by_sweep) > 50


@pytest.mark.parametrize(
    ("shape", "window"),
    [
        (SHAPE, (slice(6, 13), slice(8, 17))),
        ((SMALL + 5, 2 * SMALL + 9), (slice(0, SMALL + 5), slice(SMALL - 1, 2 * SMALL + 3))),
        ((40, 5 * SMALL), (slice(11, 12), slice(3 * SMALL - 3, 5 * SMALL))),
        ((1, 1), (slice(0, 1), slice(0, 1))),
    ],
)
@pytest.mark.parametrize("has_terrain", [False, True])
def test_a_satellite_is_seen_where_its_shadow_is_not_above_the_receiver(shape, window, has_terrain):
    top_m = tops(shape)
    top_m[shape[0] // 2, shape[1] // 3] = np.nan  # unknown: hides what lies behind it
    ground_m = np.random.default_rng(1).uniform(0, 20, shape).astype(np.float32)[window]
    altitudes_m = np.array(ALTITUDES_M, np.float32)
    receivers_m = np.broadcast_to(altitudes_m[:, None, None], (2, *ground_m.shape)) + (
        ground_m if has_terrain else 0
    )
    words = np.zeros((1, 2, *ground_m.shape), np.uint32)
    first_cell = window[0].start, window[1].start
    receivers = Receivers(first_cell, 1, ground_m if has_terrain else None, altitudes_m)
    mark_visible(words, top_m, receivers, stacked(lines_over(shape)))
    expected = words_of(swept(top_m, lines_over(shape, growth=0))[:, *window], receivers_m)
    np.testing.assert_array_equal(words, expected)


@pytest.mark.slow
@pytest.mark.parametrize("every", [2, 3, 5])
def test_receivers_in_every_nth_cell_have_the_words_of_these_cells(every):
    shape, first_cell, size = (7 * SMALL // 2, 3 * SMALL), (19, 35), (every * 41, every * 60)
    altitudes_m, top_m = np.array(ALTITUDES_M, np.float32), tops(shape)
    ground_m = np.random.default_rng(1).uniform(0, 20, size).astype(np.float32)
    lines = stacked(lines_over(shape))
    whole, found = (np.zeros((1, 2, *(num // n for num in size)), np.uint32) for n in (1, every))
    mark_visible(whole, top_m, Receivers(first_cell, 1, ground_m, altitudes_m), lines)
    mark_visible(found, top_m, Receivers(first_cell, every, ground_m, altitudes_m), lines)
    middles = slice(every // 2, None, every)
    np.testing.assert_array_equal(found, whole[..., middles, middles])


@pytest.mark.parametrize("form", ["blocks", words_by_sweep, words_by_doubling])
def test_words_hold_more_than_32_satellites_and_none_that_fills_up(form):
    which, num = np.arange(70) % len(AZIMUTH_RAD), 67
    rng = np.random.default_rng(1)
    ground_m, altitudes_m = rng.uniform(0, 9, (12, 15)).astype(np.float32), np.float32([5, 60])
    height_m = ground_m + altitudes_m[:, None, None]
    expected = words_of(
        swept(tops(), lines_over(SHAPE, growth=0, which=which[:num]))[:, *INNER], height_m
    )
    if form == "blocks":
        words = np.zeros((3, 2, 12, 15), np.uint32)
        words[2] = 1 << 31  # what they held before stays
        lines = stacked(lines_over(SHAPE, which=which[:num]))
        mark_visible(words, tops(), Receivers((4, 7), 1, ground_m, altitudes_m), lines)
        expected[2] |= np.uint32(1 << 31)
    else:
        lines = stacked(lines_over(SHAPE, growth=0, which=which))
        words = jax.jit(form, static_argnames="window")(
            tops(), height_m, lines, np.int32(num), window=WINDOW
        )
    np.testing.assert_array_equal(words, expected)


def test_tiles_that_hand_on_give_the_words_of_the_whole():
    """Tiles one after the other, from each satellite's quadrant on, as a tiled run does."""
    shape = SMALL + 20, 45
    top_m, altitudes_m = tops(shape), np.array(ALTITUDES_M, np.float32)
    receivers = Receivers((0, 0), 1, None, altitudes_m)
    whole = np.zeros((1, 2, *shape), np.uint32)
    mark_visible(whole, top_m, receivers, stacked(lines_over(shape)))
    parts = itertools.product(((0, 13), (13, shape[0])), ((0, 19), (19, 45)))
    tiles = [(slice(*row), slice(*col)) for row, col in parts]
    found = np.zeros_like(whole)
    for s in range(len(AZIMUTH_RAD)):
        carried_m = np.full(
            np.array(shape) + 2, -np.inf, np.float32
        )  # what tiles hand on, in their outermost cells
        north, east = np.cos(AZIMUTH_RAD[s]) >= 0, np.sin(AZIMUTH_RAD[s]) >= 0
        for tile in sorted(
            tiles,
            key=lambda tile: (tile[0].start * (1 - 2 * north), tile[1].start * (1 - 2 * east)),
        ):
            row, col = (slice(part.start, part.stop + 2) for part in tile)
            around = carried_m[row, col]
            ring = Ring(around[:1], around[-1:], around[None, 1:-1, 0], around[None, 1:-1, -1])
            part_m = np.ascontiguousarray(top_m[tile])
            line = stacked(
                lines_over(
                    part_m.shape, (FIRST[0] + tile[0].start, FIRST[1] + tile[1].start), which=[s]
                )
            )
            words = np.zeros((1, 2, *part_m.shape), np.uint32)
            mark_visible(words, part_m, receivers, line, ring)
            found[0][:, *tile] |= words[0] << np.uint32(s)
            inner = carried_m[1:-1, 1:-1][tile]
            handed_row_m, handed_col_m = hand_on(part_m, line, ring)
            inner[0 if north else -1] = handed_row_m[0]
            inner[:, 0 if east else -1] = handed_col_m[0]
    np.testing.assert_array_equal(found, whole)


@pytest.mark.slow
@pytest.mark.parametrize("has_terrain", [False, True])
def test_the_words_of_a_city_are_equal_by_all_forms(has_terrain):
    city = ju.demo_city(1000, 1000)
    x_min, y_min, _, _ = city.extent_m
    region = Grid(city.crs, 5.0, round(y_min / 5) + 50, round(x_min / 5) + 50, 100, 100)
    outer = region.padded(50, 50, 50, 50)
    surface = build_surface(city, region, outer)
    if has_terrain:
        hills_m = 20 * np.sin(np.arange(200) / 30)[:, None] * np.cos(np.arange(200) / 40)
        surface = Surface(surface.roof_m, hills_m.astype(np.float32), None, None, outer, region)
    sky = AZIMUTH_RAD, np.maximum(ELEVATION_RAD, 0.05)
    in_blocks = visibility(surface, *sky, ALTITUDES_M)
    height_m = np.float32(ALTITUDES_M)[:, None, None] + (
        surface.terrain_m[50:-50, 50:-50] if has_terrain else 0
    )
    view = SkyView.of(surface, *sky)
    for form in (words_by_sweep, words_by_doubling):
        words = jax.jit(form, static_argnames="window")(
            surface.top_m, height_m, view.lines, view.num, window=(50, 150, 50, 150)
        )
        np.testing.assert_array_equal(words, in_blocks)
    assert 0.4 < np.mean([in_blocks >> s & 1 for s in range(len(AZIMUTH_RAD))]) < 0.99
