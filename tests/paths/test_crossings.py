"""A route cut at cell borders: climbs, segments, and clearance."""

import numpy as np
import pytest
import shapely

from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.paths.profile import clearance_m, cut_evenly, nearest_level_m
from jaxurban.planners.cost import path_states

OBSTACLES = np.random.default_rng(3).random((30, 40)) < 0.08
RES = 5.0


def straight_walk(seed: int, num: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (40 * RES, 30 * RES), (num, 2))


def test_a_climb_is_longer_in_the_air_than_over_the_ground():
    way_m = [[2.5, 2.5, 20.0], [32.5, 42.5, 20.0], [32.5, 42.5, 60.0], [62.5, 42.5, 20.0]]
    crossings = crossed_cells(np.array(way_m), RES)
    ends_m = crossings.ends_m
    np.testing.assert_allclose(ends_m[1:, 0], ends_m[:-1, 1])
    np.testing.assert_allclose(np.linalg.norm(np.diff(ends_m, axis=1)[:, 0], axis=1), crossings.length_m, atol=1e-9)
    over_m = np.hypot(*np.diff(ends_m[:, :, :2], axis=1)[:, 0].T)
    assert over_m.sum() == pytest.approx(50 + 0 + 30)
    assert crossings.length_m.sum() == pytest.approx(50 + 40 + 50)
    straight_up = over_m == 0
    assert np.stack([crossings.row, crossings.col], axis=1)[straight_up].tolist() == [[8, 6]] * 2
    np.testing.assert_allclose(ends_m[straight_up][0], [[32.5, 42.5, 20], [32.5, 42.5, 40]])


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


def test_clearance_is_the_distance_that_shapely_measures_however_far_an_obstacle_is():
    rows, cols = np.nonzero(OBSTACLES) * np.array(RES)
    walls = shapely.union_all(shapely.box(cols, rows, cols + RES, rows + RES))
    free = np.argwhere(~OBSTACLES)[:, ::-1] * RES + RES / 2
    walk = straight_walk(4)
    for lines in (np.stack([walk[:-1], walk[1:]], axis=1), np.stack([free, free], axis=1)):
        by_shapely = shapely.distance(shapely.linestrings(lines), walls)
        np.testing.assert_allclose(clearance_m(lines, OBSTACLES, RES), by_shapely, atol=1e-9)
    one = np.zeros((30, 400), bool)
    one[10, 399] = True
    line = np.array([[[2.5, 52.5], [7.5, 52.5]]])
    assert clearance_m(line, one, RES)[0] == pytest.approx(399 * RES - 7.5)
    assert np.isinf(clearance_m(line, np.zeros_like(one), RES)[0])


def test_the_lower_of_two_altitudes_as_near_is_taken():
    assert nearest_level_m(np.array([20.0, 40.0, 41.0, 500.0]), (60.0, 20.0)).tolist() == [20, 20, 60, 60]
