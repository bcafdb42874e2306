"""The bound that all planners off the grid share: against SciPy's Dijkstra over corners, and over points on borders."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import pdist, squareform

from jaxurban.planners.any_angle import ptp, theta_star
from jaxurban.planners.astar import astar_plus
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.corners import STRETCH, corner_bound, with_corner_bound
from jaxurban.planners.cost import CostModel
from jaxurban.planners.refine import refine


def made(seed, shape, free=0.8):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < free
    is_free[0, 0] = is_free[-1, -1] = True
    goal = (shape[0] - 1, shape[1] - 1)
    return Problem(rng.random((1, *shape)) ** 3, is_free, (0, 0), goal, 5.0, 0.02)


def over_borders(problem, num):
    """Return the least cost of ways over ``num`` points on each side of a cell, straight in each: by SciPy's Dijkstra.

    Of curves, of which these are some, none of them costs less than the best: with more points they come near it.
    """
    rate = problem.resolution_m * (
        problem.distance_weight + problem.cost / problem.cost_model.reference_length_m
    )
    one, none, all_of = np.linspace(0, 1, num + 1), np.zeros(num + 1), np.ones(num + 1)
    x, y = np.concatenate([one, one, none, all_of]), np.concatenate([none, all_of, one, one])
    of_cell, number = np.unique(np.column_stack([x, y]), axis=0), {}
    parts = []
    for row, col in np.argwhere(problem.is_free):
        points = of_cell + np.array([col, row])
        if (row, col) in (problem.start, problem.goal):
            points = np.append(points, [[col + 0.5, row + 0.5]], axis=0)
        ids = [number.setdefault(tuple(np.rint(2 * num * point)), len(number)) for point in points]
        here, there = np.meshgrid(ids, ids)
        parts.append(
            (rate[row, col] * squareform(pdist(points)).ravel(), here.ravel(), there.ravel())
        )
    cost, here, there = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.lexsort((cost, there, here))  # of a side the cheaper cell counts
    kept = order[np.append(True, (np.diff(here[order]) != 0) | (np.diff(there[order]) != 0))]
    kept = kept[cost[kept] > 0]
    graph = coo_array((cost[kept], (here[kept], there[kept])), shape=(len(number),) * 2).tocsr()
    start, goal = (
        number[2 * num * (col + 0.5), 2 * num * (row + 0.5)]
        for row, col in (problem.start, problem.goal)
    )
    return dijkstra(graph, directed=False, indices=start)[goal]


def test_a_straight_way_over_one_cost_has_the_bound_of_the_closed_form():
    problem = Problem(np.full((1, 5, 12), 0.5), np.ones((5, 12), bool), (2, 1), (2, 10), 2.0, 1.0)
    rate = 1.0 + 0.5 / problem.cost_model.reference_length_m
    assert corner_bound(problem) == pytest.approx(rate * 2.0 * (8 / STRETCH + 1), rel=1e-12)


def trial(seed, shape=(7, 8), num=6):
    """Try the bound on a random map; return the bound over the best way found, NaN where nothing joins the ends."""
    problem = made(seed, shape)
    best = over_borders(problem, num)
    bound = corner_bound(problem)
    assert bound <= best * (1 + 1e-12)
    path = refine(problem, theta_star(problem))
    if path.status.has_path:
        assert best <= path.cost * 1.02  # of so many points
        assert bound <= path.cost
    return bound / best if np.isfinite(best) else np.nan


def test_the_bound_is_near_the_cheapest_way_at_any_angle_and_never_above_it():
    shares = [trial(seed) for seed in range(20)]
    assert np.isfinite(shares).sum() > 8
    assert 1 / STRETCH**2 < np.nanmin(shares) < np.nanmax(shares) < 1


@pytest.mark.slow
def test_the_same_on_1000_maps():
    assert np.isfinite([trial(seed) for seed in range(100, 1100)]).sum() > 500


def test_the_best_path_of_the_grid_over_the_stretch_is_no_bound_beside_an_obstacle():
    is_free = np.array([[True, True], [False, True]])
    problem = Problem(np.zeros((1, 2, 2)), is_free, (0, 0), (1, 1), 1.0, 1.0)
    assert astar_plus(problem).cost / STRETCH > 1.8 > np.sqrt(2) > corner_bound(problem)


def test_all_planners_of_one_query_have_one_bound():
    problem = made(3, (30, 40), 0.95)
    paths = [
        theta_star(problem),
        refine(problem, theta_star(problem)),
        bitstar_plus(problem, max_samples=2000),
    ]
    paths = [
        with_corner_bound(problem, path) for path in [*paths, ptp(problem)] if path.status.has_path
    ]
    assert len(paths) >= 3  # obstacles may lie in the straight way
    assert {path.lower_bound for path in paths} == {corner_bound(problem)}
    of_grid = astar_plus(problem)
    assert with_corner_bound(problem, of_grid) is of_grid


def test_where_every_cell_entered_costs_alike_the_bound_is_left_to_the_planner():
    problem = made(3, (30, 40), 0.95)
    cell = Problem(
        problem.costs, problem.is_free, problem.start, problem.goal, 5.0, 0.02, CostModel("cell")
    )
    path = bitstar_plus(cell, max_samples=2000)
    assert path.status is Status.BUDGET_FEASIBLE
    assert with_corner_bound(cell, path) is path
