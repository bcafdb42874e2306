"""Shadow heights against closed forms, a walk along each cell's line, and cropped grids."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxurban.kernels.shadows.sweep import ENTRY_STEPS, digital_line, shadow_height, sweep

SHAPE = (23, 31)
FIRST_ROW, FIRST_COL = 901_234, -117_003
AZIMUTHS_DEG = [
    0.0,
    45.0,
    90.0,
    135.0,
    180.0,
    225.0,
    270.0,
    315.0,
    17.0,
    63.3,
    111.9,
    160.2,
    200.0,
    254.4,
    283.0,
    340.7,
]


def random_tops(shape=SHAPE, seed=0):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < 0.3, rng.uniform(5, 150, shape), 0).astype(np.float32)


def line_of(azimuth_deg, elevation_deg, shape=SHAPE, first_row=FIRST_ROW, first_col=FIRST_COL, resolution_m=5.0):
    return digital_line(
        math.radians(azimuth_deg), math.radians(elevation_deg), resolution_m, first_row, first_col, shape
    )


def walk(top_m, azimuth_deg, elevation_deg, resolution_m=5.0):
    """The definition, cell by cell: one step a row (column), sideways by the rounded global line."""
    east, north = math.sin(math.radians(azimuth_deg)), math.cos(math.radians(azimuth_deg))
    if abs(east) > abs(north):
        rows_are_cols = True
        top_m, along, across, first = top_m.T, east, north, FIRST_COL
    else:
        rows_are_cols = False
        along, across, first = north, east, FIRST_ROW
    drop_m = resolution_m / abs(along) * math.tan(math.radians(elevation_deg))
    ahead = int(math.copysign(1, along))
    shadow_m = np.full(top_m.shape, -np.inf)
    for row in range(top_m.shape[0]):
        start = math.floor(across / along * (first + row) + 0.5)
        for steps in range(1, max(top_m.shape)):
            beyond = row + ahead * steps
            if not 0 <= beyond < top_m.shape[0]:
                break
            shift = math.floor(across / along * (first + beyond) + 0.5) - start
            for col in range(top_m.shape[1]):
                if 0 <= col + shift < top_m.shape[1]:
                    height = top_m[beyond, col + shift] - (steps - ENTRY_STEPS) * drop_m
                    shadow_m[row, col] = max(shadow_m[row, col], height)
    return shadow_m.T if rows_are_cols else shadow_m


@pytest.mark.parametrize("azimuth_deg", AZIMUTHS_DEG)
def test_shadow_height_equals_a_walk_along_every_line(azimuth_deg):
    top_m = random_tops()
    shadow_m = shadow_height(top_m, line_of(azimuth_deg, 31.0))
    np.testing.assert_allclose(shadow_m, walk(top_m, azimuth_deg, 31.0), atol=1e-3)  # a millimetre


@pytest.mark.parametrize(("azimuth_deg", "axis", "sign"), [(0, 0, 1), (180, 0, -1), (90, 1, 1), (270, 1, -1)])
def test_a_wall_throws_the_shadow_of_its_height_away_from_the_satellite(azimuth_deg, axis, sign):
    top_m = np.zeros(SHAPE, np.float32)
    middle = SHAPE[axis] // 2
    top_m[(middle, slice(None)) if axis == 0 else (slice(None), middle)] = 100.0
    shadow_m = np.asarray(shadow_height(top_m, line_of(azimuth_deg, 45.0)))
    behind = (
        np.take(shadow_m, middle - sign * np.arange(1, 10), axis=axis).T
        if axis == 0
        else shadow_m[:, middle - sign * np.arange(1, 10)]
    )
    expected_m = 100.0 - (np.arange(1, 10) - ENTRY_STEPS) * 5.0  # tan 45 degrees = 1
    np.testing.assert_allclose(behind, np.broadcast_to(expected_m, behind.shape), rtol=1e-6)
    before = np.take(shadow_m, middle + sign * 2, axis=axis)
    assert before.max() <= 0  # on the sunny side only the ground stands in the way


def test_the_zenith_is_never_shadowed():
    assert np.all(shadow_height(random_tops(), line_of(12.0, 90.0)) < 0)


def test_a_satellite_on_the_horizon_is_hidden_by_the_highest_roof_beyond():
    top_m = random_tops()
    shadow_m = np.asarray(shadow_height(top_m, line_of(0.0, 0.0)))
    beyond_m = np.maximum.accumulate(top_m[::-1], axis=0)[::-1][1:]
    np.testing.assert_array_equal(shadow_m[:-1], beyond_m)
    assert np.all(np.isneginf(shadow_m[-1]))


def test_the_shadow_shortens_as_the_satellite_climbs():
    top_m = random_tops()
    low, high = (np.asarray(shadow_height(top_m, line_of(200.0, e))) for e in (20.0, 50.0))
    assert np.all(high <= low)


@settings(max_examples=100, deadline=None)
@given(azimuth_rad=st.floats(-7, 7), first=st.integers(-2_000_000, 2_000_000))
def test_the_digital_line_stays_within_a_cell_of_the_ray(azimuth_rad, first):
    line = digital_line(azimuth_rad, 0.5, 2.0, first, first, (200, 200))
    along, across = sorted((math.cos(azimuth_rad), math.sin(azimuth_rad)), key=abs, reverse=True)
    ahead = int(math.copysign(1, along))
    sideways = np.cumsum(line.shifts[::ahead].astype(int))
    ray = np.arange(1, 201) * across / abs(along)
    assert set(np.unique(line.shifts)) <= {-1, 0, 1}
    assert np.all(np.abs(sideways - ray) <= 1 + 1e-6)


@pytest.mark.parametrize("azimuth_deg", AZIMUTHS_DEG)
def test_a_ring_of_the_neighbours_sweep_carries_it_on_bit_for_bit(azimuth_deg):
    raised_m = random_tops()
    line = line_of(azimuth_deg, 12.0)
    whole = np.asarray(sweep(raised_m, line))
    rows, cols = slice(4, 16), slice(7, 22)
    ring = np.maximum(raised_m, whole)[rows, cols]
    ring[1:-1, 1:-1] = raised_m[rows, cols][1:-1, 1:-1]
    part = sweep(ring, line_of(azimuth_deg, 12.0, ring.shape, FIRST_ROW + 4, FIRST_COL + 7))
    np.testing.assert_array_equal(np.asarray(part)[1:-1, 1:-1], whole[rows, cols][1:-1, 1:-1])


def test_one_program_serves_every_direction():
    top_m = random_tops()
    shadow_height(top_m, line_of(1.0, 40.0))
    compiled = shadow_height._cache_size()
    for azimuth_deg in AZIMUTHS_DEG:
        shadow_height(top_m, line_of(azimuth_deg, 10.0))
    assert shadow_height._cache_size() == compiled


def test_the_derivative_of_a_shadow_is_that_of_its_one_roof():
    top_m = np.zeros(SHAPE, np.float32)
    top_m[12, 9] = 60.0
    slope = jax.grad(lambda top: shadow_height(top, line_of(0.0, 30.0))[8, 9])(jnp.asarray(top_m))
    expected = np.zeros(SHAPE)
    expected[12, 9] = 1.0
    np.testing.assert_array_equal(slope, expected)
