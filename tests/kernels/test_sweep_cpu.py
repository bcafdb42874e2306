"""The sweep on a CPU against shadow heights, bit by bit: words, and what tiles hand on."""

import itertools

import numpy as np
import pytest

from jaxurban.kernels.shadows.sweep import ENTRY_STEPS, Line, Ring, digital_lines, shadow_height, stacked
from jaxurban.kernels.shadows.sweep_cpu import COLUMNS, STRIP, hand_on, mark_visible

FIRST = (901_234, -117_003)  # row and column
AZIMUTH_RAD = np.radians([0, 17, 45, 63.3, 90, 111.9, 135, 160.2, 180, 200, 225, 254.4, 270, 283, 315, 340.7, 10, 200])
ELEVATION_RAD = np.radians([5, 31, 12, 60, 8, 20, 75, 90, 30, 9, 14, 22, 41, 17, 50, 6, 0, 0])
ALTITUDES_M = (10.0, 60.0)


def tops(shape, dtype=np.float32, seed=0):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < 0.3, rng.uniform(5, 150, shape), 0).astype(dtype)


def lines_over(shape, first=FIRST, growth=1, which=slice(None)) -> list[Line]:
    """Return the lines over a grid at ``first`` grown on each side."""
    grown = tuple(side + 2 * growth for side in shape)
    return digital_lines(AZIMUTH_RAD[which], ELEVATION_RAD[which], 5.0, *(at - growth for at in first), grown)


def words_of(shadows_m, receivers_m) -> np.ndarray:
    """Return the words of shadow heights ``[S, y, x]`` at receivers ``[A, y, x]``."""
    words = np.zeros((-(-len(shadows_m) // 32), *receivers_m.shape), np.uint32)
    for s, shadow_m in enumerate(shadows_m):
        words[s // 32] |= (shadow_m <= receivers_m).astype(np.uint32) << np.uint32(s % 32)
    return words


@pytest.mark.parametrize(
    ("shape", "window"),
    [
        ((23, 31), (slice(6, 13), slice(8, 17))),
        ((3 * STRIP + 5, 2 * STRIP), (slice(0, 3 * STRIP + 5), slice(STRIP - 1, 2 * STRIP))),
        ((40, COLUMNS + 30), (slice(11, 12), slice(COLUMNS - 3, COLUMNS + 5))),
        ((1, 1), (slice(0, 1), slice(0, 1))),
    ],
)
@pytest.mark.parametrize("has_terrain", [False, True])
def test_a_satellite_is_seen_where_its_shadow_is_not_above_the_receiver(shape, window, has_terrain):
    top_m = tops(shape)
    ground_m = np.random.default_rng(1).uniform(0, 20, shape).astype(np.float32)[window]
    altitudes_m = np.array(ALTITUDES_M, np.float32)
    receivers_m = np.broadcast_to(altitudes_m[:, None, None], (2, *ground_m.shape)) + (ground_m if has_terrain else 0)
    shadows_m = [np.asarray(shadow_height(top_m, line))[window] for line in lines_over(shape, growth=0)]
    words = np.zeros((1, 2, *ground_m.shape), np.uint32)
    first_cell = window[0].start, window[1].start
    mark_visible(
        words, top_m, ground_m.copy() if has_terrain else None, altitudes_m, stacked(lines_over(shape)), first_cell
    )
    np.testing.assert_array_equal(words, words_of(shadows_m, receivers_m))


def test_words_hold_more_than_32_satellites_and_what_they_held_before():
    shape, top_m = (30, 40), tops((30, 40))
    which = np.arange(70) % len(AZIMUTH_RAD)
    shadows_m = [np.asarray(shadow_height(top_m, line)) for line in lines_over(shape, growth=0, which=which)]
    expected = words_of(shadows_m, np.full((1, *shape), 60.0, np.float32))
    words = np.zeros((3, 1, *shape), np.uint32)
    words[2] = 1 << 31
    mark_visible(words, top_m, None, np.array([60.0], np.float32), stacked(lines_over(shape, which=which)))
    np.testing.assert_array_equal(words[:2], expected[:2])
    np.testing.assert_array_equal(words[2], expected[2] | np.uint32(1 << 31))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_tiles_that_hand_on_give_the_words_of_the_whole(dtype):
    """Tiles one after the other, from each satellite's quadrant on, as a tiled run does."""
    shape, top_m = (2 * STRIP + 7, 45), tops((2 * STRIP + 7, 45), dtype)
    altitudes_m = np.array(ALTITUDES_M, dtype)
    whole = np.zeros((1, 2, *shape), np.uint32)
    mark_visible(whole, top_m, None, altitudes_m, stacked(lines_over(shape)))
    rows, cols = ((0, 13, 2 * STRIP + 7), (0, 19, 45))
    tiles = [
        (slice(*row), slice(*col)) for row, col in itertools.product(itertools.pairwise(rows), itertools.pairwise(cols))
    ]
    found = np.zeros_like(whole)
    for s in range(len(AZIMUTH_RAD)):
        carried_m = np.full(
            (shape[0] + 2, shape[1] + 2), -np.inf, dtype
        )  # what tiles hand on, in their outermost cells
        north, east = np.cos(AZIMUTH_RAD[s]) >= 0, np.sin(AZIMUTH_RAD[s]) >= 0
        for tile in sorted(tiles, key=lambda tile: (tile[0].start * (1 - 2 * north), tile[1].start * (1 - 2 * east))):
            row, col = (slice(part.start, part.stop + 2) for part in tile)
            around = carried_m[row, col]
            ring = Ring(around[:1], around[-1:], around[None, 1:-1, 0], around[None, 1:-1, -1])
            at = FIRST[0] + tile[0].start, FIRST[1] + tile[1].start
            part_m = np.ascontiguousarray(top_m[tile])
            line = stacked(lines_over(part_m.shape, at, which=[s]))
            words = np.zeros((1, 2, *part_m.shape), np.uint32)
            mark_visible(words, part_m, None, altitudes_m, line, rings=ring)
            found[0][:, tile[0], tile[1]] |= words[0] << np.uint32(s)
            edges = hand_on(part_m, line, ring)
            inner = carried_m[1:-1, 1:-1][tile]
            inner[0], inner[-1], inner[:, 0], inner[:, -1] = (side[0] for side in edges)
    np.testing.assert_array_equal(found, whole)


def test_what_is_handed_on_is_the_higher_of_roof_and_shadow_in_the_outermost_cells():
    shape, top_m = (20, 33), tops((20, 33))
    lines = lines_over(shape)
    rng = np.random.default_rng(4)
    rings = [Ring(*(rng.uniform(0, 90, n).astype(np.float32) for n in (35, 35, 20, 20))) for _ in lines]
    found = hand_on(top_m, stacked(lines), Ring(*(np.stack(side) for side in zip(*rings, strict=True))))
    for s, (line, ring) in enumerate(zip(lines, rings, strict=True)):
        raised_m = top_m + ENTRY_STEPS * np.float32(line.drop_m)
        carried_m = np.maximum(raised_m, np.asarray(shadow_height(top_m, line, ring)))
        for side, expected in zip(found, (carried_m[0], carried_m[-1], carried_m[:, 0], carried_m[:, -1]), strict=True):
            np.testing.assert_array_equal(side[s], expected)


def test_a_top_that_is_unknown_hides_what_lies_behind_it():
    shape, top_m = (20, 33), tops((20, 33))
    top_m[12, 9] = np.nan
    shadows_m = [np.asarray(shadow_height(top_m, line)) for line in lines_over(shape, growth=0)]
    words = np.zeros((1, 1, *shape), np.uint32)
    mark_visible(words, top_m, None, np.array([60.0], np.float32), stacked(lines_over(shape)))
    np.testing.assert_array_equal(words, words_of(shadows_m, np.full((1, *shape), 60.0, np.float32)))
