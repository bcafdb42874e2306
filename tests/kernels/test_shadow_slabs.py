"""Shadows of slabs against a walk along every receiver's line."""

import math

import numpy as np
import pytest

from jaxurban.kernels.shadows.slabs import SlabReceivers, hide_behind_slabs

RESOLUTION_M = 2.0
FIRST_ROW, FIRST_COL, EVERY = 901_234, -117_003, 3
NUM_ROWS, NUM_COLS = 9, 11
ALTITUDES_M = np.array([1.5, 8.0, 30.0])
AZIMUTH_RAD = np.radians(
    [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0, 17.0, 63.3, 111.9, 160.2, 254.4, 340.7]
)
ELEVATION_RAD = np.radians(
    [5.0, 0.0, 20.0, 88.0, 35.0, 61.0, 90.0, 15.0, 8.0, 44.0, 3.0, 27.0, 70.0, 12.0]
)


AZIMUTH_RAD, ELEVATION_RAD = (
    np.resize(angles, 40) for angles in (AZIMUTH_RAD, ELEVATION_RAD)
)  # in two words


def slabs(with_terrain: bool):
    """Return cells in and around the receivers' grid, and floors and tops, two over some of them."""
    rng = np.random.default_rng(3)
    row, col = rng.integers(-40, 70, (2, 400))
    floor_m = rng.uniform(2, 25, 400) + (rng.uniform(-5, 5, 400) if with_terrain else 0)
    return (row + FIRST_ROW, col + FIRST_COL), (floor_m, floor_m + rng.uniform(0.3, 9, 400))


def walk(cells, heights_m, ground_m) -> np.ndarray:
    """Return which satellites the slabs hide ``[S, A, y, x]``: every receiver looks along its line, cell by cell."""
    hidden = np.zeros((len(AZIMUTH_RAD), len(ALTITUDES_M), NUM_ROWS, NUM_COLS), bool)
    over: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for row, col, floor_m, top_m in zip(*cells, *heights_m, strict=True):
        over.setdefault((int(row), int(col)), []).append((floor_m, top_m))
    for s, (azimuth, elevation) in enumerate(zip(AZIMUTH_RAD, ELEVATION_RAD, strict=True)):
        east, north = math.sin(azimuth), math.cos(azimuth)
        is_rows = abs(north) >= abs(east)
        along, across = (north, east) if is_rows else (east, north)
        climb_m = RESOLUTION_M / abs(along) * math.tan(elevation)
        for i in range(NUM_ROWS):
            for j in range(NUM_COLS):
                place = FIRST_ROW + EVERY * i, FIRST_COL + EVERY * j
                start, beside = place if is_rows else place[::-1]
                for step in range(150):
                    at = start + (step if along > 0 else -step)
                    side = (
                        beside
                        + math.floor(across / along * at + 0.5)
                        - math.floor(across / along * start + 0.5)
                    )
                    for floor_m, top_m in over.get((at, side) if is_rows else (side, at), ()):
                        own_m = ALTITUDES_M + ground_m[i, j]
                        enters_m, leaves_m = (
                            own_m + max(step - 0.5, 0) * climb_m,
                            own_m + (step + 0.5) * climb_m,
                        )
                        hidden[s, :, i, j] |= (enters_m <= top_m) & (leaves_m >= floor_m)
    return hidden


@pytest.mark.parametrize("with_terrain", [False, True])
def test_the_satellites_hidden_are_those_of_a_walk_along_every_line(with_terrain):
    cells, heights_m = slabs(with_terrain)
    ground_m = np.random.default_rng(1).uniform(-5, 5, (NUM_ROWS, NUM_COLS)) * with_terrain
    words = np.full((2, len(ALTITUDES_M), NUM_ROWS, NUM_COLS), 2**32 - 1, np.uint32)
    receivers = SlabReceivers(
        FIRST_ROW, FIRST_COL, EVERY, ground_m if with_terrain else np.empty((0, 0))
    )
    hide_behind_slabs(
        words, ALTITUDES_M, receivers, cells, heights_m, AZIMUTH_RAD, ELEVATION_RAD, RESOLUTION_M
    )
    found = [words[s // 32] >> s % 32 & 1 == 0 for s in range(len(AZIMUTH_RAD))]
    expected = walk(cells, heights_m, ground_m)
    assert 0.05 < expected.mean() < 0.5
    np.testing.assert_array_equal(found, expected)
    assert (words[1] >> 8 == 2**24 - 1).all()  # of no satellite
