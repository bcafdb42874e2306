"""The costs from everywhere to a goal, against SciPy's Dijkstra."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.io.read.rasterise import rasterise
from jaxurban.planners.astar import astar, cost_to_go
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import FEW_TO_ONE_GOAL, solve_many
from jaxurban.world.grid import Grid
from jaxurban.world.synthetic import demo_city
from tests.planners.test_batch import assert_optimal, dijkstra_to_goal, random_map, random_queries


@pytest.fixture(scope="module")
def city():
    """Of a crop of the synthetic city at 5 m: cells that no roof above 10 m touches, and how near the others are."""
    made = demo_city(2_000, 2_000)
    grid = Grid(made.crs, 5.0, int(made.extent_m[1] // 5) + 60, int(made.extent_m[0] // 5) + 150, 130, 150)
    is_free = rasterise(made, grid, all_touched=True).roof_m < 10.0
    return is_free, np.exp(-distance_transform_edt(is_free) / 4)


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_a_citys_fields_equal_dijkstras_and_are_kept(city, kind):
    is_free, nearness = city
    assert 0.4 < is_free.mean() < 0.9
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    problem = Problem(nearness[None], is_free, anywhere, anywhere, 5.0, [0.02, 1.0], CostModel(kind, diagonal="always"))
    for query in [*random_queries(problem, 3), random_queries(problem, 1)[0].with_weights([0.01, 3.0])]:
        expected = dijkstra_to_goal(query)
        assert query.goal not in query.shared.get("costs_to_go", ())
        found = cost_to_go(query)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
        assert cost_to_go(query) is found
        assert np.isfinite(expected).mean() > 0.3


@pytest.mark.parametrize("backend", ["numba", "jax"])
def test_plan_many_walks_on_the_fields_of_all_shared_goals_and_weights(backend):
    first = random_map(0)
    queries = []
    for problem in (first, first.with_weights(first.weights * [1.0, 5.0, 0.2])):
        for goal in [query.goal for query in random_queries(problem, 3, 4)]:
            queries += [query.between(query.start, goal) for query in random_queries(problem, FEW_TO_ONE_GOAL)]
    paths = dict(solve_many(queries, backend=backend))
    assert {(path.heuristic, path.backend) for path in paths.values()} == {("exact", "numba")}
    for k in range(0, len(queries), 7):
        assert_optimal(paths[k], queries[k])


def test_a_spent_clock_keeps_nothing(monkeypatch):
    problem = random_map(0)
    monkeypatch.setattr("jaxurban.planners.grid_search.CHUNK", 1)
    with pytest.raises(TimeoutError):
        cost_to_go(problem, end_s=0.0)
    assert "costs_to_go" not in problem.shared
    assert astar(problem, heuristic="exact").status is Status.OPTIMAL
