"""The straight segment: its samples, its cost, and when it is blocked."""

from dataclasses import replace

import numpy as np
import pytest

from jaxurban.planners.any_angle import ptp
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel


def test_samples_lie_one_resolution_step_apart_and_end_at_the_goal():
    problem = Problem(np.zeros((1, 40, 40)), np.ones((40, 40), bool), (3, 2), (20, 33), 5.0, 1.0)
    path = ptp(problem)
    steps_m = np.hypot(*np.diff(path.points_m, axis=0).T)
    length_m = 5 * np.hypot(17, 31)
    assert len(steps_m) == np.ceil(length_m / 5)
    np.testing.assert_allclose(steps_m[:-1], 5.0)
    np.testing.assert_array_equal(path.points_m[[0, -1]], [[12.5, 17.5], [167.5, 102.5]])
    assert path.cost == pytest.approx(length_m)
    assert path.lower_bound == pytest.approx(length_m)
    assert path.status is Status.FEASIBLE


@pytest.mark.parametrize("resolution_m", [0.1, 0.3, 5.0])
def test_a_whole_number_of_steps_gets_no_sliver_step(resolution_m):
    problem = Problem(np.ones((1, 1, 50)), np.ones((1, 50), bool), (0, 1), (0, 48), resolution_m, 0.0, "cell")
    path = ptp(problem)
    assert len(path.points_m) == 48
    assert path.cost == 47


def test_it_is_blocked_by_a_crossed_cell_and_not_by_a_touched_one():
    def path_around(*blocked):
        is_free = np.ones((2, 10), bool)
        is_free[0, list(blocked)] = False
        return ptp(Problem(np.zeros((1, 2, 10)), is_free, (0, 0), (1, 9), 1.0, 1.0))

    assert path_around(5).status is Status.FEASIBLE  # the line leaves row 0 at x = 5: it touches this cell
    assert path_around(5).cost == pytest.approx(np.hypot(9, 1))
    path = path_around(4)
    assert path.status is Status.BLOCKED
    assert path.points_m.shape == (0, 2)
    assert path.cost == np.inf


def test_it_is_blocked_between_two_cells_that_touch_at_a_corner_unless_always_is_set():
    is_free = np.ones((2, 10), bool)
    is_free[0, 5] = is_free[1, 4] = False  # either side of where the line leaves row 0
    problem = Problem(np.zeros((1, 2, 10)), is_free, (0, 0), (1, 9), 1.0, 1.0)
    assert ptp(problem).status is Status.BLOCKED
    assert ptp(replace(problem, cost_model=CostModel(diagonal="always"))).status is Status.FEASIBLE


def test_a_sliver_of_an_obstacle_blocks_though_no_sample_falls_in_it():
    is_free = np.ones((3, 4), bool)
    samples = ptp(Problem(np.zeros((1, 3, 4)), is_free, (0, 0), (2, 3), 1.0, 1.0)).points_m
    sampled = {(int(y), int(x)) for x, y in samples}
    assert (1, 2) in sampled
    assert (0, 1) not in sampled
    is_free[0, 1] = False
    assert ptp(Problem(np.zeros((1, 3, 4)), is_free, (0, 0), (2, 3), 1.0, 1.0)).status is Status.BLOCKED


def test_start_at_the_goal_is_a_path_of_one_point():
    path = ptp(Problem(np.ones((1, 2, 2)), np.ones((2, 2), bool), (1, 1), (1, 1), 5.0, 1.0))
    np.testing.assert_array_equal(path.points_m, [[7.5, 7.5]])
    assert (path.cost, path.status) == (0, Status.FEASIBLE)
