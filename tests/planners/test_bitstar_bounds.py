"""BIT*'s bounds and samples: against Dijkstra on dense graphs, closed forms, and areas."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from jaxurban.planners.base import Problem
from jaxurban.planners.bitstar.bounds import HEURISTICS, InformedSet, graph_radius, make_bounds
from jaxurban.planners.cost import CostModel
from tests.planners.problems import ends_of, sample_edges

RESOLUTION_M = 2.0


def problem_on(cost, cost_model, start, goal, is_free=None, distance_weight=0.3):
    is_free = np.ones(cost.shape, bool) if is_free is None else is_free
    return Problem(
        cost[None], is_free, start, goal, RESOLUTION_M, distance_weight, CostModel(cost_model, 3.0)
    )


def true_cost(problem, *xy):
    return problem.cost_of(np.array(xy) * RESOLUTION_M)


@pytest.mark.parametrize("heuristic", HEURISTICS)
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_no_path_of_a_dense_graph_costs_less_than_the_bounds(cost_model, heuristic):
    rng = np.random.default_rng(1)
    num_leaps = 0
    for trial in range(3):
        # Dear rows and columns tempt paths to leap them.
        cost = (
            0.2
            + rng.random((6, 7))
            + 5.0 * (rng.random((6, 1)) < 0.4)
            + 5.0 * (rng.random((1, 7)) < 0.4)
        )
        is_free = rng.random(cost.shape) < (1.0, 0.9, 0.8)[trial]
        is_free[0, 1] = is_free[5, 5] = True
        problem = problem_on(cost, cost_model, (0, 1), (5, 5), is_free)
        bounds = make_bounds(heuristic, problem, is_free)
        xy = rng.uniform(0, 1, (170, 2)) * (7, 6)
        xy = np.concatenate(
            [ends_of(problem), xy[is_free[xy[:, 1].astype(int), xy[:, 0].astype(int)]]]
        )
        edges = sample_edges(problem, xy, 1.45)
        from_start, to_goal = bounds.from_start_and_to_goal(xy)
        reached, back = dijkstra(edges, indices=0), dijkstra(edges.T, indices=1)
        assert np.isfinite(reached[1])
        assert np.all(from_start <= reached + 1e-9)
        assert np.all(to_goal <= back + 1e-9)
        row_at, col_at, enter = bounds.edge_parts(xy)
        i, j = np.nonzero(edges)
        map_part = np.maximum(np.abs(row_at[i] - row_at[j]), np.abs(col_at[i] - col_at[j]))
        least = bounds.per_side * np.hypot(*(xy[i] - xy[j]).T) + enter[j] + map_part
        assert np.all(least <= edges[i, j] + 1e-9)
        assert np.all(to_goal[i] <= edges[i, j] + to_goal[j] + 1e-9)  # consistent
        num_leaps += np.sum(np.abs(np.diff(np.floor(xy[np.stack([i, j])]), axis=0)) == 2)
    assert num_leaps > 100


def test_plus_is_tight_where_the_straight_line_is_best():
    rng = np.random.default_rng(2)
    uniform = problem_on(np.full((9, 12), 0.7), "line", (1, 2), (7, 10))
    straight = true_cost(uniform, [2.5, 1.5], [10.5, 7.5])
    assert make_bounds("plus", uniform, uniform.is_free).from_start_to_goal() == pytest.approx(
        straight
    )
    striped = problem_on(np.repeat(rng.random((9, 1)), 12, axis=1), "line", (1, 4), (7, 4))
    straight = true_cost(striped, [4.5, 1.5], [4.5, 7.5])
    assert make_bounds("plus", striped, striped.is_free).from_start_to_goal() == pytest.approx(
        straight
    )
    distance = make_bounds("euclidean", striped, striped.is_free).from_start_to_goal()
    assert distance == pytest.approx(0.3 * 6 * RESOLUTION_M)


def test_under_the_cell_model_the_goal_costs_and_the_start_does_not():
    cost = np.zeros((5, 5))
    cost[1, 1], cost[3, 3] = 100.0, 10.0
    problem = problem_on(cost, "cell", (1, 1), (3, 3), distance_weight=0.0)
    bounds = make_bounds("plus", problem, problem.is_free)
    at_start, at_goal, between = np.array([[1.5, 1.5], [3.5, 3.5], [2.2, 2.7]])
    from_start, to_goal = bounds.from_start_and_to_goal(np.array([at_start, at_goal, between]))
    np.testing.assert_allclose(from_start, [0, 10, 0])
    np.testing.assert_allclose(to_goal, [10, 0, 10])


@pytest.mark.parametrize("heuristic", HEURISTICS)
def test_samples_fill_the_informed_set_evenly(heuristic):
    rng = np.random.default_rng(3)
    is_free = rng.random((40, 60)) < 0.8
    is_free[20, [10, 50]] = True
    problem = problem_on(rng.random((40, 60)), "line", (20, 10), (20, 50), is_free)
    bounds = make_bounds(heuristic, problem, is_free)
    informed = InformedSet(bounds, is_free)
    assert informed.measure == is_free.sum()
    incumbent = 1.25 * bounds.from_start_to_goal()
    informed.shrink(incumbent)
    xy = informed.sample(20_000, rng)
    row, col = xy[:, 1].astype(int), xy[:, 0].astype(int)
    assert len(xy) == 20_000
    assert is_free[row, col].all()
    assert np.add(*bounds.from_start_and_to_goal(xy)).max() < incumbent
    if heuristic == "euclidean":  # the ellipse: sum of distances to its foci
        assert np.hypot(*(xy - (10.5, 20.5)).T).max() + 10.5 < 60.5
        area = np.pi / 4 * 50 * 30
        assert informed.measure == pytest.approx(0.8 * area, rel=0.06)
    # Cells that lie wholly inside hold as many each as their share of the set's area.
    corners = np.stack(np.meshgrid([1e-3, 0.999], [1e-3, 0.999]), axis=-1).reshape(-1, 2)
    cells = np.argwhere(is_free)
    f = [np.add(*bounds.from_start_and_to_goal(cells[:, ::-1] + corner)) for corner in corners]
    inside = cells[np.max(f, axis=0) < incumbent]
    count = np.bincount(row * 60 + col, minlength=2400)[inside[:, 0] * 60 + inside[:, 1]]
    assert count.mean() == pytest.approx(20_000 / informed.measure, rel=0.05)
    assert count.var() == pytest.approx(count.mean(), rel=0.25)  # as Poisson counts


def test_an_ellipse_thinner_than_a_cell_still_gives_samples():
    problem = problem_on(np.zeros((50, 50)), "line", (3, 4), (40, 44))
    bounds = make_bounds("euclidean", problem, problem.is_free)
    informed = InformedSet(bounds, problem.is_free)
    informed.shrink(bounds.from_start_to_goal() * (1 + 1e-8))
    xy = informed.sample(500, np.random.default_rng(0))
    assert len(xy) == 500
    length = np.hypot(37, 40)
    off_line = np.abs((xy - (4.5, 3.5)) @ (-37, 40)) / length
    assert off_line.max() <= length / 2 * np.sqrt(2e-8) * 1.01
    assert informed.measure == pytest.approx(np.pi / 4 * length**2 * np.sqrt(2e-8), rel=1e-3)
    informed.shrink(bounds.from_start_to_goal() * 0.999)
    assert len(informed.sample(10, np.random.default_rng(0))) == 0


def test_the_radius_is_that_of_the_theory():
    # 2 eta (1 + 1/2)^(1/2) (area / pi)^(1/2) (log q / q)^(1/2), Gammell et al. 2015
    assert graph_radius(1000, 400.0, 1.1) == pytest.approx(
        2.2 * np.sqrt(1.5 * 400 / np.pi * np.log(1000) / 1000)
    )
