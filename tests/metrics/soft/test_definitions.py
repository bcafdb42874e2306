"""Soft GPS cell by cell as it is defined, and the two forms of the soft lidar."""

import math

import jax
import numpy as np

from tests.metrics.soft.scene import (
    ALTITUDE_M,
    AZIMUTH_RAD,
    CASES,
    ELEVATION_RAD,
    GRID,
    REGION,
)


def shadow_by_walking(top_m, cell, azimuth_rad, elevation_rad):
    """The highest top on the global digital line beyond a cell, less the ray's climb to it."""
    east, north = math.sin(azimuth_rad), math.cos(azimuth_rad)
    tops, (row, col), along, across, first = (top_m, cell, north, east, GRID.first_row)
    if abs(east) > abs(north):
        tops, (row, col), along, across, first = top_m.T, cell[::-1], east, north, GRID.first_col
    climb_m = GRID.resolution_m / abs(along) * math.tan(elevation_rad)
    shadow_m, start = -np.inf, math.floor(across / along * (first + row) + 0.5)
    for steps in range(1, tops.shape[0]):
        beyond = row + int(math.copysign(steps, along))
        to = col + math.floor(across / along * (first + beyond) + 0.5) - start
        if 0 <= beyond < tops.shape[0] and 0 <= to < tops.shape[1]:
            shadow_m = max(shadow_m, tops[beyond, to] - (steps - 0.25) * climb_m)
    return shadow_m


def gdop_by_inverse(weights):
    level = np.cos(ELEVATION_RAD)
    east, north = np.sin(AZIMUTH_RAD) * level, np.cos(AZIMUTH_RAD) * level
    matrix = np.column_stack([east, north, np.sin(ELEVATION_RAD), -np.ones(len(level))])
    normal = matrix.T @ np.diag(weights) @ matrix
    return math.sqrt(np.trace(np.linalg.inv(normal))) if np.linalg.cond(normal) < 1e9 else math.inf


def test_soft_gps_equals_its_definition_cell_by_cell():
    case, softness_m = CASES["gps"], 2.0
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(case.m)(case.inputs(), case.view(np.float64)))
        roof_m, ground_m = np.asarray(case.surface(np.float64).roof_m), case.ground_m
    expected = np.zeros(REGION.shape)
    for here in np.ndindex(REGION.shape):
        cell = tuple(np.add(here, (REGION.first_row - GRID.first_row, REGION.first_col - GRID.first_col)))
        angles = zip(AZIMUTH_RAD, ELEVATION_RAD, strict=True)
        shadows_m = [shadow_by_walking(roof_m + ground_m, cell, *toward) for toward in angles]
        clear_m = ground_m[cell] + ALTITUDE_M - np.array(shadows_m)
        gdop = gdop_by_inverse((1 + np.exp(-clear_m / softness_m)) ** -2)
        t = np.clip((ALTITUDE_M - roof_m[cell]) / softness_m, 0, 1) if roof_m[cell] > 0 else 1
        expected[here] = t**3 * (10 - 15 * t + 6 * t**2) * (case.limit - min(gdop, case.limit)) / (case.limit - 1)
    assert np.mean((expected > 0) & (expected < 0.85)) > 0.1
    assert (expected == 0).any()
    np.testing.assert_allclose(found, expected, atol=1e-9)
