"""Theta*: closed forms, brute force over visible corners, and A* on the same map."""

import itertools
import time

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.sparse.csgraph import dijkstra
from shapely import LineString, MultiPoint, box, union_all

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.planners.any_angle import shortened, subdivided, theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.cost import CostModel
from tests.free_space import pinched_corners


def line_problem(layers, start, goal, is_free=None, distance_weight=0.2, resolution_m=2.0, **options):
    is_free = np.ones(layers.shape[1:], bool) if is_free is None else is_free
    return Problem(layers, is_free, start, goal, resolution_m, distance_weight, CostModel("line", 4.0, **options))


def random_problem(seed, shape=(20, 24), share_free=0.8, **options):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < share_free
    is_free[2, 2] = is_free[17, 21] = True
    return line_problem(np.where(is_free, rng.random((2, *shape)), np.nan), (2, 2), (17, 21), is_free, **options)


def uniform_problem(seed, shape=(12, 14)):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.75
    is_free[1, 1] = is_free[10, 12] = True
    return line_problem(np.zeros((1, *shape)), (1, 1), (10, 12), is_free, distance_weight=1.0, resolution_m=1.0)


def obstacles(problem):
    side = problem.resolution_m
    cells = np.argwhere(~problem.is_free)
    return union_all([box(col * side, row * side, (col + 1) * side, (row + 1) * side) for row, col in cells])


def visibility_optimum(problem):
    """Least length of a polyline that keeps out of the obstacles' interiors, over their corners.

    A dot stops what would pass between two obstacles that touch at a corner.
    """
    blocked = union_all([obstacles(problem), MultiPoint(pinched_corners(problem.is_free)).buffer(1e-6)])
    rows, cols = problem.is_free.shape
    corners = sorted({(c + i, r + j) for r, c in np.argwhere(~problem.is_free) for i in (0, 1) for j in (0, 1)})
    corners = [(x, y) for x, y in corners if 0 < x < cols and 0 < y < rows]
    points = [(cell[1] + 0.5, cell[0] + 0.5) for cell in (problem.start, problem.goal)] + corners
    lengths = np.zeros((len(points), len(points)))
    for i, j in itertools.combinations(range(len(points)), 2):
        if not blocked.relate_pattern(LineString([points[i], points[j]]), "T********"):
            lengths[i, j] = np.hypot(*np.subtract(points[i], points[j]))
    return dijkstra(lengths, directed=False, indices=0)[1]


@pytest.mark.parametrize(
    ("start", "goal"), [((3, 5), (38, 20)), ((0, 0), (0, 39)), ((39, 39), (2, 2)), ((7, 7), (7, 7))]
)
def test_on_an_empty_map_it_is_the_straight_line_and_proven_optimal(start, goal):
    problem = line_problem(np.full((1, 40, 40), 0.6), start, goal)
    path = theta_star(problem)
    length_m = 2.0 * np.hypot(*np.subtract(start, goal))
    assert path.cost == pytest.approx((0.2 + 0.6 / 4) * length_m, rel=1e-12)
    assert path.lower_bound == pytest.approx(path.cost, rel=1e-12)
    assert path.status is Status.OPTIMAL
    assert len(path.points_m) == (1 if start == goal else 2)


@pytest.mark.parametrize("share_free", [0.6, 0.9])
def test_it_is_never_costlier_than_the_best_grid_path_and_keeps_to_free_cells(share_free):
    gains, statuses = [], set()
    for seed in range(25):
        problem = random_problem(seed, share_free=share_free, diagonal="always")
        path, grid = theta_star(problem), astar(problem)
        statuses.add(path.status)
        if grid.status is Status.NO_PATH:
            assert path.status is Status.NO_PATH
            assert path.lower_bound == np.inf
            continue
        assert path.cost == pytest.approx(problem.cost_of(path.points_m), rel=1e-12)
        assert path.lower_bound <= path.cost <= grid.cost * (1 + 1e-9)
        assert LineString(path.points_m).intersection(obstacles(problem)).length < 1e-6
        np.testing.assert_array_equal(path.points_m[[0, -1]], grid.points_m[[0, -1]])
        gains.append(1 - path.cost / grid.cost)
    assert Status.FEASIBLE in statuses
    assert np.mean(gains) > 0.01


def test_on_uniform_maps_it_comes_near_the_shortest_way_around_corners():
    excess = []
    for seed in range(12):
        problem = uniform_problem(seed)
        path = theta_star(problem)
        if path.status is Status.NO_PATH:
            continue
        best = visibility_optimum(problem)
        assert path.cost >= best * (1 - 1e-9)
        excess.append(path.cost / best - 1)
    assert len(excess) > 6
    # Turns lie in the middle of cells and not on corners: that much is lost on obstacles of one cell.
    assert np.mean(excess) < 0.05
    assert max(excess) < 0.12


def test_it_bends_at_the_border_of_two_media_near_snells_angle():
    layers = np.zeros((1, 60, 60))
    layers[:, 30:] = 3.0
    problem = line_problem(layers, (5, 4), (55, 50))
    below, above = 0.2, 0.2 + 3.0 / 4
    near_m, far_m, along_m = 24.5 * 2, 25.5 * 2, 46 * 2

    def refracted(x_m):
        return below * np.hypot(x_m, near_m) + above * np.hypot(along_m - x_m, far_m)

    best = minimize_scalar(refracted, bounds=(0, along_m), method="bounded").fun
    path = theta_star(problem)
    assert best <= path.cost * (1 + 1e-9)
    assert path.cost < 1.01 * best
    assert astar(problem).cost > 1.02 * best


def test_a_path_passes_one_obstacle_at_its_corner_and_two_that_touch_there_only_where_always_is_set():
    is_free = np.array([[True, False], [True, True]])
    problem = line_problem(np.zeros((1, 2, 2)), (0, 0), (1, 1), is_free)
    assert theta_star(problem).cost == pytest.approx(0.2 * 2 * np.sqrt(2))
    is_free[1, 0] = False
    assert theta_star(line_problem(np.zeros((1, 2, 2)), (0, 0), (1, 1), is_free)).status is Status.NO_PATH
    always = line_problem(np.zeros((1, 2, 2)), (0, 0), (1, 1), is_free, diagonal="always")
    assert theta_star(always).cost == pytest.approx(0.2 * 2 * np.sqrt(2))


def test_a_segments_cost_is_that_of_the_evaluation():
    problem = random_problem(4, share_free=0.97)
    cost_grid = cost_grid_of(problem, problem.is_free)
    rng = np.random.default_rng(0)
    num_free = 0
    for _ in range(300):
        xy = rng.uniform(0, (24, 20), (2, 2)) if rng.random() < 0.5 else rng.integers(0, 20, (2, 2)) + 0.5
        cost = segment_cost(cost_grid, *xy[0], *xy[1], np.inf)
        assert cost == pytest.approx(problem.cost_of(xy * 2.0), rel=1e-9)
        num_free += np.isfinite(cost)
        if np.isfinite(cost) and cost > 0:
            assert segment_cost(cost_grid, *xy[0], *xy[1], cost * (1 - 1e-9)) == np.inf
    assert 50 < num_free < 300


def test_subdividing_keeps_the_course_and_shortening_finds_the_straight_line_again():
    xy = np.array([[0.5, 0.5], [0.5, 0.5], [7.5, 3.5], [7.5, 9.5]])
    fine, _ = subdivided(xy, 0.7)
    lengths = np.hypot(*np.diff(fine, axis=0).T)
    assert lengths.max() <= 0.7 + 1e-12
    assert lengths.sum() == pytest.approx(np.hypot(*np.diff(xy, axis=0).T).sum())
    problem = line_problem(np.zeros((1, 12, 12)), (0, 0), (9, 7))
    cost_grid = cost_grid_of(problem, problem.is_free)
    np.testing.assert_array_equal(shortened(cost_grid, xy), xy[[0, -1]])


def test_it_ends_with_the_budget_and_repeats_itself():
    rng = np.random.default_rng(1)
    problem = line_problem(rng.random((1, 700, 700)), (0, 0), (699, 699))
    theta_star(random_problem(0))
    begin_s = time.perf_counter()
    assert theta_star(problem, budget_s=1e-3).status is Status.BUDGET_EMPTY
    assert time.perf_counter() - begin_s < 1.0
    problem = random_problem(2)
    np.testing.assert_array_equal(theta_star(problem).points_m, theta_star(problem, seed=5).points_m)


def test_a_cost_of_zero_everywhere_is_told():
    path = theta_star(line_problem(np.zeros((1, 5, 5)), (0, 0), (4, 3), distance_weight=0.0))
    assert (path.cost, path.status) == (0.0, Status.OPTIMAL)
    assert "weigh the distance too" in path.note


def test_an_unknown_heuristic_is_refused():
    with pytest.raises(InputError, match="heuristic must be 'euclidean' or 'plus', got 'octile'"):
        theta_star(random_problem(0), heuristic="octile")


def test_the_cell_model_is_refused_with_the_remedy_where_the_map_costs_anything():
    costly, costless = (
        Problem(np.full((1, 4, 4), cost), np.ones((4, 4), bool), (0, 0), (3, 2), 2.0, 1.0, "cell")
        for cost in (0.1, 0.0)
    )
    with pytest.raises(InputError, match=r"planner 'theta-star' weighs .* choose cost_model='line'"):
        theta_star(costly)
    assert theta_star(costless).cost == pytest.approx(2 * np.hypot(3, 2))
