"""Rays that walk their own lines: the shadows of the sweep, at single places."""

import numpy as np

from jaxurban.kernels.shadows.rays import shadows_at, walks
from jaxurban.kernels.shadows.sweep import digital_lines, shadow_heights, stacked

NUM_ROWS, NUM_COLS, RESOLUTION_M = 90, 110, 2.0
FIRST_ROW, FIRST_COL = (
    1_977_123,
    231_009,
)  # as of a UTM zone, where float32 would not hold a line's phase
NUM_SATELLITES, NUM_RAYS = 24, 6000
MOST_M = 160.0


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return tops, the directions of satellites, and of each ray its satellite, row and column."""
    rng = np.random.default_rng(0)
    is_roof = rng.random((NUM_ROWS, NUM_COLS)) < 0.1
    top_m = np.where(is_roof, rng.uniform(5, 150, is_roof.shape), 0.0).astype(np.float32)
    azimuth = np.append(rng.uniform(0, 2 * np.pi, NUM_SATELLITES - 4), np.arange(4) * np.pi / 2)
    elevation = np.radians(rng.uniform(5, 85, NUM_SATELLITES))
    numbers = [rng.integers(0, most, NUM_RAYS) for most in (NUM_SATELLITES, NUM_ROWS, NUM_COLS)]
    return top_m, azimuth, elevation, *numbers


def test_every_ray_has_the_shadow_of_the_sweep_over_the_whole_grid():
    top_m, azimuth, elevation, s, row, col = scene()
    lines = digital_lines(azimuth, elevation, RESOLUTION_M, FIRST_ROW, FIRST_COL, top_m.shape)
    swept_m = np.asarray(shadow_heights(top_m, stacked(lines), (0, NUM_ROWS, 0, NUM_COLS)))[
        s, row, col
    ]
    own = walks(azimuth[s], elevation[s], RESOLUTION_M, FIRST_ROW + row, FIRST_COL + col)
    walked_m = shadows_at(top_m, row, col, own, MOST_M)
    matters = (
        np.maximum(swept_m, walked_m) > 0
    )  # below the ground no shadow is of interest, and none is followed
    assert matters.mean() > 0.5
    np.testing.assert_allclose(walked_m[matters], swept_m[matters], atol=1e-3)


def test_a_ray_is_the_same_alone_and_in_company():
    top_m, azimuth, elevation, s, row, col = scene()
    own = walks(azimuth[s], elevation[s], RESOLUTION_M, FIRST_ROW + row, FIRST_COL + col)
    together_m = shadows_at(top_m, row, col, own, MOST_M)
    for ray in range(5):
        alone = type(own)(*(values[ray : ray + 1] for values in own))
        np.testing.assert_array_equal(
            shadows_at(top_m, row[ray : ray + 1], col[ray : ray + 1], alone, MOST_M),
            together_m[ray : ray + 1],
        )


def test_where_nothing_stands_nothing_shadows():
    empty_m = np.full((5, 5), -np.inf, np.float32)
    row = col = np.array([2])
    own = walks(np.array([0.3]), np.array([0.5]), RESOLUTION_M, row, col)
    assert shadows_at(empty_m, row, col, own, MOST_M) == -np.inf
