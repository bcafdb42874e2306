"""A route cut at cell borders: lengths, climbs, segments, and clearance."""

import itertools

import numpy as np
import pytest
import shapely
from scipy.ndimage import distance_transform_edt

from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.paths.profile import clearance_m, cut_evenly, nearest_level_m
from jaxurban.planners.cost import path_states

OBSTACLES = np.random.default_rng(3).random((30, 40)) < 0.08
RES = 5.0


def straight_walk(seed: int, num: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (40 * RES, 30 * RES), (num, 2))


def test_crossings_have_the_lengths_of_shapelys_intersections():
    points = straight_walk(1)
    crossings = crossed_cells(points, RES)
    by_cell = np.zeros((30, 40))
    np.add.at(by_cell, (crossings.row, crossings.col), crossings.length_m)
    for row, col in np.ndindex(30, 40):
        cell = shapely.box(col * RES, row * RES, (col + 1) * RES, (row + 1) * RES)
        inside = sum(shapely.LineString(pair).intersection(cell).length for pair in itertools.pairwise(points))
        assert by_cell[row, col] == pytest.approx(inside, abs=1e-6)
    ends_m = crossings.ends_m
    np.testing.assert_allclose(ends_m[1:, 0], ends_m[:-1, 1])
    np.testing.assert_allclose(np.linalg.norm(np.diff(ends_m, axis=1)[:, 0], axis=1), crossings.length_m, atol=1e-9)


def test_a_climb_is_longer_in_the_air_than_over_the_ground():
    crossings = crossed_cells(
        np.array([[2.5, 2.5, 20.0], [32.5, 42.5, 20.0], [32.5, 42.5, 60.0], [62.5, 42.5, 20.0]]), RES
    )
    ends_m = crossings.ends_m
    over_m = np.hypot(*np.diff(ends_m[:, :, :2], axis=1)[:, 0].T)
    assert over_m.sum() == pytest.approx(50 + 0 + 30)
    assert crossings.length_m.sum() == pytest.approx(50 + 40 + 50)
    straight_up = over_m == 0
    assert [(r, c) for r, c in zip(crossings.row[straight_up], crossings.col[straight_up], strict=True)] == [(8, 6)] * 2
    np.testing.assert_allclose(ends_m[straight_up][0], [[32.5, 42.5, 20], [32.5, 42.5, 40]])
    np.testing.assert_allclose(np.diff(ends_m[:, :, 2], axis=1)[:, 0].sum(), 0.0, atol=1e-9)


@pytest.mark.parametrize("points", [[[12.5, 7.5]], [[12.5, 7.5], [12.5, 7.5]]])
def test_a_route_of_one_place_is_one_crossing_of_no_length(points):
    crossings = crossed_cells(np.array(points), RES)
    assert [crossings.row.tolist(), crossings.col.tolist(), crossings.length_m.tolist()] == [[1], [2], [0]]
    assert cut_evenly(np.array(points[:1]), 10).size == 0


def test_segments_are_equal_up_to_a_step():
    states_m = path_states(straight_walk(2), RES)
    segment = cut_evenly(states_m, 7)
    length_m = np.bincount(segment, np.linalg.norm(np.diff(states_m, axis=0), axis=1))
    assert np.array_equal(np.unique(segment), np.arange(7))
    assert np.all(np.diff(segment) >= 0)
    assert np.ptp(length_m) <= 2 * RES
    assert np.array_equal(cut_evenly(states_m[:4], 10), [0, 1, 2])


def test_clearance_is_that_of_brute_force():
    points = straight_walk(4)
    lines = np.stack([points[:-1], points[1:]], axis=1)
    row, col = np.nonzero(OBSTACLES)
    low, high = np.column_stack([col, row]) * RES, np.column_stack([col + 1, row + 1]) * RES
    for line, found_m in zip(lines, clearance_m(lines, OBSTACLES, RES), strict=True):
        along = line[0] + np.linspace(0, 1, 2001)[:, None, None] * (line[1] - line[0])
        away = np.maximum(np.maximum(low - along, along - high), 0)
        sampled_m = np.hypot(away[..., 0], away[..., 1]).min()
        half_step_m = np.hypot(*(line[1] - line[0])) / 4000
        assert found_m <= sampled_m <= found_m + half_step_m


def test_clearance_agrees_with_scipys_distance_transform_as_its_pixels_shrink():
    rows, cols = np.nonzero(~OBSTACLES)
    centres = np.column_stack([cols + 0.5, rows + 0.5]) * RES
    exact_m = clearance_m(np.stack([centres, centres], axis=1), OBSTACLES, RES)
    for finer in (1, 5, 15):
        fine_m = distance_transform_edt(~np.kron(OBSTACLES, np.ones((finer, finer), bool))) * RES / finer
        there_m = fine_m[rows * finer + finer // 2, cols * finer + finer // 2]
        half_pixel_m = np.sqrt(0.5) * RES / finer  # from a pixel's centre to its corner
        assert np.all((exact_m <= there_m) & (there_m <= exact_m + half_pixel_m + 1e-9))


def test_an_obstacle_is_found_however_far_and_none_is_told():
    one = np.zeros((30, 400), bool)
    one[10, 399] = True
    line = np.array([[[2.5, 52.5], [7.5, 52.5]]])
    assert clearance_m(line, one, RES)[0] == pytest.approx(399 * RES - 7.5)
    assert np.isinf(clearance_m(line, np.zeros_like(one), RES)[0])


def test_the_lower_of_two_altitudes_as_near_is_taken():
    assert nearest_level_m(np.array([20.0, 40.0, 41.0, 500.0]), (60.0, 20.0)).tolist() == [20, 20, 60, 60]
