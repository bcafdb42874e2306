"""The straight segment, Theta* and refinement: closed forms, and the shortest way around corners by brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from jaxurban.planners.any_angle import ptp, theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.planner import bitstar_dist, bitstar_plus
from jaxurban.planners.refine import refine
from tests.planners.problems import ends_of, graph_cost, open_problem, random_problem

SHAPE = (48, 48)


def line_problem(layers, start, goal, is_free=None, distance_weight=0.2):
    return open_problem(SHAPE, start, goal, layers, "line", distance_weight, is_free)


def sampled_by(planner, num):
    return lambda problem: planner(problem, budget_s=np.inf, max_samples=num)


def refined_after(planner):
    return lambda problem: refine(problem, planner(problem))


def test_samples_lie_one_resolution_step_apart_and_end_at_the_goal():
    problem = Problem(np.zeros((1, 40, 40)), np.ones((40, 40), bool), (3, 2), (20, 33), 5.0, 1.0)
    path = ptp(problem)
    steps_m = np.hypot(*np.diff(path.points_m, axis=0).T)
    length_m = 5 * np.hypot(17, 31)
    assert len(steps_m) == np.ceil(length_m / 5)
    np.testing.assert_allclose(steps_m[:-1], 5.0)
    np.testing.assert_array_equal(path.points_m[[0, -1]], [[12.5, 17.5], [167.5, 102.5]])
    assert (path.cost, path.lower_bound) == (pytest.approx(length_m), pytest.approx(length_m))


@pytest.mark.parametrize("resolution_m", [0.1, 0.3, 5.0])
def test_a_whole_number_of_steps_gets_no_sliver_step(resolution_m):
    path = ptp(
        Problem(
            np.ones((1, 1, 50)), np.ones((1, 50), bool), (0, 1), (0, 48), resolution_m, 0.0, "cell"
        )
    )
    assert (len(path.points_m), path.cost) == (48, 47)


def bends_of(is_free):
    """Points just off the corners of obstacles around which a taut string may bend, in cell sides."""
    points = []
    for row, col in np.argwhere(is_free[1:-1, 1:-1]) + 1:
        for up, east in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            if (
                not is_free[row + up, col + east]
                and is_free[row, col + east]
                and is_free[row + up, col]
            ):
                points.append([col + 0.5 + east * 0.4999999, row + 0.5 + up * 0.4999999])
    return points


def test_on_uniform_maps_paths_come_near_the_shortest_way_around_corners():
    excess = []
    for seed in range(12):
        drawn = random_problem(seed, (10, 12), kind="line", diagonal="both-free")
        problem = drawn.with_weights([1.0, 0.0, 0.0, 0.0])
        path = theta_star(problem)
        if path.status is not Status.NO_PATH:
            framed = np.pad(problem.is_free, 1)
            bends = np.array(bends_of(framed)) - 1
            best = graph_cost(problem, np.concatenate([ends_of(problem), bends]), np.inf)
            assert path.cost >= best * (1 - 1e-9)
            excess.append(path.cost / best - 1)
    assert len(excess) > 6
    # Turns lie in the middle of cells and not on corners: that much is lost on obstacles of one cell.
    assert np.mean(excess) < 0.05
    assert max(excess) < 0.12


BENDING = {
    "theta-star": (theta_star, 1.01),
    "bitstar-dist": (sampled_by(bitstar_dist, 4000), 1.003),
    "bitstar-plus": (sampled_by(bitstar_plus, 4000), 1.003),
    "A* refined": (refined_after(astar), 1.0001),
    "Theta* refined": (refined_after(theta_star), 1.0001),
}


@pytest.mark.parametrize(("planner", "within"), BENDING.values(), ids=BENDING)
def test_two_media_are_crossed_as_snells_law_asks(planner, within):
    layers = np.zeros((1, *SHAPE))
    layers[:, 24:] = 3.0
    problem = line_problem(layers, (4, 3), (44, 40))

    def refracted(x_m):
        return 0.2 * np.hypot(x_m, 19.5 * 2) + (0.2 + 3.0 / 4) * np.hypot(37 * 2 - x_m, 20.5 * 2)

    best = minimize_scalar(refracted, bounds=(0, 74), method="bounded").fun
    assert best * (1 - 1e-9) <= planner(problem).cost < within * best
    assert min(astar(problem).cost, ptp(problem).cost) > 1.02 * best


@pytest.mark.parametrize(
    ("planner", "within"),
    [(sampled_by(bitstar_dist, 8000), 1.01), (theta_star, 1.02), (refined_after(astar), 1.0001)],
)
def test_the_way_around_a_block_tends_to_the_taut_string(planner, within):
    is_free = np.ones(SHAPE, bool)
    is_free[10:30, 20:24] = False
    problem = line_problem(None, (15, 5), (18, 40), is_free, distance_weight=1.0)
    corners = 2.0 * np.array([[5.5, 15.5], [20, 10], [24, 10], [40.5, 18.5]])
    best = np.hypot(*np.diff(corners, axis=0).T).sum()
    assert best * (1 - 1e-9) <= planner(problem).cost < within * best
    assert astar(problem).cost > 1.03 * best


def test_where_the_cost_per_metre_falls_as_one_over_y_the_path_becomes_the_half_planes_arc():
    # The metric of the Poincare half-plane: the distance is arccosh(1 + d^2 / (2 y_0 y_1)), along circles about y = 0.
    y_m = (np.arange(48) + 0.5) * 2.0 + 20.0
    mean = 40.0 * np.log((y_m + 1) / (y_m - 1)) / 2  # over each cell
    layers = np.broadcast_to((4.0 * (mean - 0.2))[:, None], SHAPE)[None]
    problem = line_problem(layers, (6, 3), (9, 44))
    best = 40.0 * np.arccosh(1 + (82.0**2 + 6.0**2) / (2 * y_m[6] * y_m[9]))
    assert ptp(problem).cost > 1.1 * best
    # A path along a row's lower border pays the mean of the row: somewhat less than the continuous optimum.
    assert refine(problem, theta_star(problem)).cost == pytest.approx(best, rel=3e-3)


def test_what_cannot_get_cheaper_comes_back_as_it_was():
    problem = line_problem(None, (3, 2), (20, 45))
    straight = theta_star(problem)
    refined = refine(problem, straight)
    np.testing.assert_array_equal(refined.points_m, straight.points_m)
    assert (refined.status, refined.note) == (Status.OPTIMAL, "Refinement found nothing cheaper.")


def test_points_on_borders_and_beyond_walls_corners_are_taken():
    # Along the border of an obstacle, over its corner, and along the map's own border.
    is_free = np.ones(SHAPE, bool)
    is_free[10, 10] = False
    problem = line_problem(np.ones((1, *SHAPE)), (5, 5), (40, 40), is_free)
    points_m = 2.0 * np.array([[5.5, 5.5], [11, 5], [11, 11], [48, 30], [48, 48], [40.5, 40.5]])
    assert not problem.features(points_m).is_valid  # the map's east border lies outside
    points_m = np.minimum(points_m, 96 - 1e-7)
    path = replace(theta_star(problem), points_m=points_m, cost=problem.cost_of(points_m))
    assert refine(problem, path).cost < path.cost
