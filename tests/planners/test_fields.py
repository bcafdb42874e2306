"""Fields of many goals by both backends: against SciPy's Dijkstra, each other, and what stands on them."""

import jax
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.errors import InputError
from jaxurban.io.read.rasterise import rasterise
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.batch import FEW_QUERIES, FEW_TO_ONE_GOAL, solve_many
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.landmarks import make_landmarks
from jaxurban.planners.search import fields as fields_module
from jaxurban.planners.search.fields import (
    cost_to_go,
    field_backend,
    has_cost_to_go,
    share_costs_to_go,
    symmetric_costs,
    warm_up_fields,
)
from jaxurban.world.grid import Grid
from jaxurban.world.synthetic import demo_city
from tests.planners.test_batch import MODELS, assert_optimal, dijkstra_to_goal, random_map, random_queries


@pytest.fixture(scope="module")
def city():
    """Of a crop of the synthetic city at 5 m: cells that no roof above 10 m touches, and how near the others are."""
    made = demo_city(2_000, 2_000)
    grid = Grid(made.crs, 5.0, int(made.extent_m[1] // 5) + 60, int(made.extent_m[0] // 5) + 150, 130, 150)
    is_free = rasterise(made, grid, all_touched=True).roof_m < 10.0
    return is_free, np.exp(-distance_transform_edt(is_free) / 4)


def test_goals_of_maps_of_every_kind_are_made_together():
    problems = [random_queries(random_map(k, kind, *moves), 1, k)[0] for k, (kind, moves) in enumerate(MODELS)]
    problems += [problems[0].with_weights(problems[0].weights * 3.0), random_queries(problems[1], 1, 5)[0]]
    problems.append(random_queries(random_map(3, shape=(9, 40)), 1)[0])
    for problem, field in zip(problems, share_costs_to_go(problems, "jax"), strict=True):
        np.testing.assert_allclose(field, dijkstra_to_goal(problem), rtol=1e-9, atol=1e-11)
        assert has_cost_to_go(problem)
        assert cost_to_go(problem, "numba") is field  # kept
        assert field.flags.writeable


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_a_citys_fields_equal_dijkstras_by_both_backends(city, kind):
    is_free, nearness = city
    assert 0.4 < is_free.mean() < 0.9
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    model = CostModel(kind, diagonal="always")
    problem = Problem(nearness[None], is_free, anywhere, anywhere, 5.0, [0.02, 1.0], model)
    queries = [query.between(query.goal, query.goal) for query in random_queries(problem, 3)]
    queries.append(queries[0].with_weights([0.01, 3.0]))
    expected = [dijkstra_to_goal(query) for query in queries]
    for backend in ("jax", "numba"):
        found = share_costs_to_go([query.alone() for query in queries], backend)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
    assert np.isfinite(expected).mean() > 0.3


def test_landmarks_by_jax_are_those_by_numba_and_guide_as_well():
    by_numba, by_jax = random_map(2), random_map(2)
    made = make_landmarks(by_numba, backend="numba"), make_landmarks(by_jax, backend="jax")
    assert [landmarks.backend for landmarks in made] == ["numba", "jax"]
    assert made[0].cells == made[1].cells
    np.testing.assert_allclose(made[1].costs, made[0].costs, rtol=1e-9)
    queries = random_queries(by_numba, FEW_QUERIES + 1)
    costs = [
        [path.cost for _, path in sorted(solve_many([map_.between(q.start, q.goal) for q in queries], num_threads=1))]
        for map_ in (by_numba, by_jax)
    ]
    np.testing.assert_allclose(costs[1], costs[0], rtol=1e-9)
    for query, cost in zip(queries, costs[1], strict=True):
        assert cost == pytest.approx(dijkstra_to_goal(query)[query.start], rel=1e-9)


def test_plan_many_makes_the_fields_of_all_shared_goals_and_weights_at_once(monkeypatch):
    calls = []
    share = fields_module.share_costs_to_go
    monkeypatch.setattr(
        "jaxurban.planners.batch.share_costs_to_go",
        lambda problems, *how: calls.append(len(problems)) or share(problems, *how),
    )
    first = random_map(0)
    queries = []
    for problem in (first, first.with_weights(first.weights * [1.0, 5.0, 0.2])):
        for goal in [query.goal for query in random_queries(problem, 3, 4)]:
            queries += [query.between(query.start, goal) for query in random_queries(problem, FEW_TO_ONE_GOAL)]
    costs = {}
    for backend in ("numba", "jax"):
        fresh = {id(q.cost): q.alone() for q in queries}  # queries of one map share what is made for it
        asked = [fresh[id(q.cost)].between(q.start, q.goal) for q in queries]
        paths = dict(solve_many(asked, backend=backend))
        assert {(path.heuristic, path.backend) for path in paths.values()} == {("exact", backend)}
        costs[backend] = [paths[k].cost for k in range(len(queries))]
    assert calls == [1] * 6 + [6]
    np.testing.assert_allclose(costs["jax"], costs["numba"], rtol=1e-9)
    for k in range(0, len(queries), 7):
        assert_optimal(paths[k], queries[k])


def test_fields_are_made_by_numba_unless_jax_has_a_gpu(monkeypatch):
    if jax.default_backend() != "cpu":
        pytest.skip("JAX has a GPU")
    assert [field_backend(name) for name in ("auto", "numba", "jax")] == ["numba", "numba", "jax"]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert [field_backend(name) for name in ("auto", "numba", "jax")] == ["jax", "numba", "jax"]
    monkeypatch.setitem(fields_module.TILE_WORK, "gpu", fields_module.TileWork(16, 8, 1, 64, 64))  # which a CPU can do
    # All that asks for fields then takes them from there.
    queries = random_queries(random_map(2), FEW_QUERIES + 1)
    paths = dict(solve_many(queries))
    assert make_landmarks(queries[0]).backend == "jax"
    for index, query in enumerate(queries):
        assert (paths[index].heuristic, paths[index].backend) == ("landmarks", "numba")
        assert_optimal(paths[index], query)
    asked = []
    by_tiles = fields_module._by_tiles
    monkeypatch.setattr(fields_module, "_by_tiles", lambda *given: asked.append(given) or by_tiles(*given))
    assert astar(queries[0], heuristic="exact").cost == pytest.approx(paths[0].cost, rel=1e-9)
    assert len(asked) == 1


def test_many_fields_are_made_in_turns_that_fit(monkeypatch):
    problem = random_map(4)
    queries = random_queries(problem, 5)
    expected = list(symmetric_costs(queries, "jax"))
    monkeypatch.setattr(fields_module, "BYTES_OF_FIELDS", {"cpu": 60 * problem.is_free.size})
    assert [len(group) for group in fields_module._groups(queries)] == [2, 2, 1]
    np.testing.assert_allclose(list(symmetric_costs(queries, "jax")), expected, rtol=1e-14)


def test_a_spent_clock_keeps_nothing():
    problem = random_map(0)
    warm_up_fields([problem], "jax")
    with pytest.raises(TimeoutError):
        cost_to_go(problem, "jax", end_s=0.0)
    assert not has_cost_to_go(problem)
    assert astar(problem, heuristic="exact").status is Status.OPTIMAL


def test_an_unknown_backend_is_refused():
    for ask in (cost_to_go, make_landmarks):
        with pytest.raises(InputError, match="backend must be 'auto', 'numba' or 'jax', got 'cuda'"):
            ask(random_map(1), backend="cuda")


@pytest.mark.gpu
def test_a_gpu_makes_the_fields_of_numba(city):
    if jax.default_backend() == "cpu":
        pytest.skip("JAX sees no GPU")
    assert field_backend() == "jax"
    is_free, nearness = city
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    queries = random_queries(Problem(nearness[None], is_free, anywhere, anywhere, 5.0, 0.02), 10)
    for field, expected in zip(symmetric_costs(queries), symmetric_costs(queries, "numba"), strict=True):
        np.testing.assert_allclose(field, expected, rtol=1e-9)
