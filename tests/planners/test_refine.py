"""Refinement: closed forms, the shortest way around corners, and laws that every path keeps."""

import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from shapely import LineString, box, union_all

from jaxurban.errors import InputError
from jaxurban.planners.any_angle import ptp, refine, theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar
from jaxurban.planners.cost import CostModel

SHAPE = (48, 48)


def line_problem(layers, start, goal, is_free=None, distance_weight=0.2):
    is_free = np.ones(SHAPE, bool) if is_free is None else is_free
    return Problem(layers, is_free, start, goal, 2.0, distance_weight, CostModel("line", 4.0))


def random_problem(seed, share_free=0.8):
    rng = np.random.default_rng(seed)
    is_free = rng.random(SHAPE) < share_free
    is_free[2, 2] = is_free[41, 44] = True
    return line_problem(np.where(is_free, rng.random((2, *SHAPE)), np.nan), (2, 2), (41, 44), is_free)


def obstacles(problem):
    cells = np.argwhere(~problem.is_free) * 2.0
    return union_all([box(x, y, x + 2, y + 2) for y, x in cells])


@pytest.mark.parametrize(
    "planner", [astar, theta_star, partial(bitstar, options=BitStarOptions(max_batches=5), budget_s=np.inf)]
)
def test_a_refined_path_is_cheaper_keeps_its_ends_and_to_free_cells(planner):
    gains = []
    for seed in range(4):
        problem = random_problem(seed)
        path = planner(problem)
        if not path.status.has_path:
            continue
        refined = refine(problem, path)
        assert refined.cost == pytest.approx(problem.cost_of(refined.points_m), rel=1e-12)
        assert refined.lower_bound <= refined.cost < path.cost
        np.testing.assert_array_equal(refined.points_m[[0, -1]], path.points_m[[0, -1]])
        assert LineString(refined.points_m).intersection(obstacles(problem)).length < 1e-6
        assert refined.note.startswith(
            f"Refinement lowered what the search minimises by {1 - refined.cost / path.cost:.2%}"
        )
        assert refined.status in (Status.FEASIBLE, Status.BUDGET_FEASIBLE)
        assert refined.planner == path.planner
        gains.append(1 - refined.cost / path.cost)
    assert len(gains) >= 3


def test_a_grid_path_around_one_wall_becomes_the_shortest_way_around_its_corners():
    is_free = np.ones(SHAPE, bool)
    is_free[10:30, 20:24] = False
    problem = line_problem(np.zeros((1, *SHAPE)), (15, 5), (18, 40), is_free, distance_weight=1.0)
    corners = 2.0 * np.array([[5.5, 15.5], [20, 10], [24, 10], [40.5, 18.5]])
    best = np.hypot(*np.diff(corners, axis=0).T).sum()
    grid = astar(problem)
    refined = refine(problem, grid)
    assert grid.cost > 1.03 * best
    assert best * (1 - 1e-9) <= refined.cost < 1.0001 * best


def test_an_open_grid_path_becomes_the_straight_line_and_is_then_proven_optimal():
    problem = line_problem(np.full((1, *SHAPE), 0.3), (3, 2), (20, 45))
    refined = refine(problem, astar(problem))
    assert refined.cost == pytest.approx((0.2 + 0.3 / 4) * 2 * np.hypot(17, 43), rel=1e-9)
    assert refined.status is Status.OPTIMAL


def test_two_media_are_crossed_as_snells_law_asks():
    layers = np.zeros((1, *SHAPE))
    layers[:, 24:] = 3.0
    problem = line_problem(layers, (4, 3), (44, 40))
    below, above = 0.2, 0.2 + 3.0 / 4

    def refracted(x_m):
        return below * np.hypot(x_m, 19.5 * 2) + above * np.hypot(37 * 2 - x_m, 20.5 * 2)

    best = minimize_scalar(refracted, bounds=(0, 74), method="bounded").fun
    for planner in (astar, theta_star):
        refined = refine(problem, planner(problem))
        assert best * (1 - 1e-9) <= refined.cost < 1.0001 * best


def test_where_the_cost_per_metre_falls_as_one_over_y_the_path_becomes_the_half_planes_arc():
    # The metric of the Poincare half-plane: the distance is arccosh(1 + d^2 / (2 y_0 y_1)), along circles about y = 0.
    y_m = (np.arange(48) + 0.5) * 2.0 + 20.0
    mean = 40.0 * np.log((y_m + 1) / (y_m - 1)) / 2  # over each cell
    layers = np.broadcast_to((4.0 * (mean - 0.2))[:, None], SHAPE)[None]
    problem = line_problem(layers, (6, 3), (9, 44))
    best = 40.0 * np.arccosh(1 + (82.0**2 + 6.0**2) / (2 * y_m[6] * y_m[9]))
    refined = refine(problem, theta_star(problem))
    assert ptp(problem).cost > 1.1 * best
    # A path along a row's lower border pays the mean of the row: somewhat less than the continuous optimum.
    assert refined.cost == pytest.approx(best, rel=3e-3)


def test_what_cannot_get_cheaper_comes_back_as_it_was():
    problem = line_problem(np.zeros((1, *SHAPE)), (3, 2), (20, 45))
    straight = theta_star(problem)
    refined = refine(problem, straight)
    np.testing.assert_array_equal(refined.points_m, straight.points_m)
    assert refined.status is Status.OPTIMAL
    assert refined.note == "Refinement found nothing cheaper."
    at_goal = theta_star(problem.between((3, 2), (3, 2)))
    assert refine(problem.between((3, 2), (3, 2)), at_goal).cost == 0.0


def test_no_path_stays_no_path():
    is_free = np.ones(SHAPE, bool)
    is_free[:, 20] = False
    problem = line_problem(np.zeros((1, *SHAPE)), (3, 2), (20, 45), is_free)
    assert refine(problem, theta_star(problem)).status is Status.NO_PATH


def test_points_on_borders_and_beyond_walls_corners_are_taken():
    # Along the border of an obstacle, over its corner, and along the map's own border.
    is_free = np.ones(SHAPE, bool)
    is_free[10, 10] = False
    problem = line_problem(np.ones((1, *SHAPE)), (5, 5), (40, 40), is_free)
    points_m = 2.0 * np.array([[5.5, 5.5], [11, 5], [11, 11], [48, 30], [48, 48], [40.5, 40.5]])
    path = replace(theta_star(problem), points_m=points_m, cost=problem.cost_of(points_m))
    assert not problem.features(points_m).is_valid  # the map's east border lies outside
    points_m[:, 0] = np.minimum(points_m[:, 0], 96 - 1e-7)
    points_m[:, 1] = np.minimum(points_m[:, 1], 96 - 1e-7)
    path = replace(path, points_m=points_m, cost=problem.cost_of(points_m))
    assert refine(problem, path).cost < path.cost


def test_it_ends_with_the_budget():
    problem = random_problem(1, share_free=0.9)
    path = astar(problem)
    refine(problem, path)
    begin_s = time.perf_counter()
    refined = refine(problem, path, budget_s=1e-4)
    assert time.perf_counter() - begin_s < 0.5
    assert refined.cost <= path.cost


def test_a_path_off_the_map_is_refused():
    problem = random_problem(0, share_free=1.0)
    with pytest.raises(InputError, match="leaves the map"):
        refine(problem, replace(theta_star(problem), points_m=np.array([[5.0, 5.0], [500.0, 5.0]])))


def test_the_cell_model_is_refused_with_the_remedy():
    problem = Problem(np.ones((1, *SHAPE)), np.ones(SHAPE, bool), (0, 0), (3, 2), 2.0, 1.0, "cell")
    with pytest.raises(InputError, match=r"refinement weighs .* choose cost_model='line'"):
        refine(problem, astar(problem))
