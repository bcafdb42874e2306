"""The search over a grid finds what SciPy's Dijkstra finds, whatever its arrays held before."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.search.heap import EXHAUSTED, FOUND
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import STEPS, CostModel
from jaxurban.planners.grid_search import NO_HEURISTIC, GridSearch, graph_of

FREE = 1e-200  # what a step that costs nothing costs for SciPy, which takes an edge of 0 for none
SHAPE = (41, 53)


def random_problem(seed, shape=SHAPE, dtype=np.float32, free_share=0.8):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < free_share
    free = np.argwhere(is_free)
    start, goal = (tuple(int(index) for index in free[k]) for k in rng.integers(len(free), size=2))
    costs = np.where(is_free, rng.random((3, *shape)) ** 3, np.nan).astype(dtype)
    kind, connectivity = rng.choice(["cell", "line"]), int(rng.choice([4, 8]))
    model = CostModel(str(kind), 3.0, connectivity, str(rng.choice(["both-free", "always"])))
    weights = np.concatenate([rng.choice([0.0, 0.3], 1), rng.choice([0.0, 0.5, 2.0], 3)])
    return Problem(costs, is_free, start, goal, 2.0, weights, model)


def costs_to_all(problem):
    """``[Y, X]`` the least cost from the start, by SciPy over the problem's moves and weighted layers."""
    shape, cost = problem.is_free.shape, np.zeros(problem.is_free.shape)
    for layer, weight in zip(problem.costs, problem.weights[1:], strict=True):
        cost += np.where(problem.is_free, layer, 0) * weight
    number, origins, targets, prices = np.arange(cost.size).reshape(shape), [], [], []
    for k, step in enumerate(STEPS):
        origin = np.argwhere(problem.moves >> k & 1)
        target = origin + step
        length_m = problem.resolution_m * np.hypot(*step)
        entered, left = cost[tuple(target.T)], cost[tuple(origin.T)]
        is_cell = problem.cost_model.kind == "cell"
        of_map = entered if is_cell else length_m * (entered + left) / 2 / problem.cost_model.reference_length_m
        origins.append(number[tuple(origin.T)])
        targets.append(number[tuple(target.T)])
        prices.append(problem.distance_weight * length_m + of_map + FREE)
    edges = (np.concatenate(prices), (np.concatenate(origins), np.concatenate(targets)))
    graph = csr_array(edges, shape=(cost.size, cost.size))
    return dijkstra(graph, indices=number[problem.start]).reshape(shape)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), dtype=st.sampled_from([np.float32, np.float64]))
def test_paths_cost_what_dijkstra_finds(seed, dtype):
    problem = random_problem(seed, dtype=dtype)
    expected = costs_to_all(problem)
    for name in ("none", "tiles"):
        path = astar(problem, heuristic=name)
        assert (path.status is Status.OPTIMAL) == np.isfinite(expected[problem.goal])
        if path.status is Status.OPTIMAL:
            np.testing.assert_allclose(path.cost, expected[problem.goal], rtol=1e-12, atol=1e5 * FREE)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    reopen=st.booleans(),
    left_there=st.sampled_from([0.0, -1.0, np.nan, np.inf, 5e-324]),
)
def test_costs_to_all_cells_are_dijkstras_whatever_the_memory_held(seed, reopen, left_there):
    problem = random_problem(seed)
    search = GridSearch(graph_of(problem), NO_HEURISTIC, problem.start, None)
    search._g[search._state == 0] = left_there
    assert search.run(reopen=reopen) == EXHAUSTED
    found = search.costs_from_start().reshape(problem.is_free.shape)
    np.testing.assert_allclose(found, costs_to_all(problem), rtol=1e-12, atol=1e5 * FREE)


def test_a_search_that_ends_early_knows_no_way_to_what_it_has_not_come_to():
    problem = random_problem(0, free_share=1.0).between((1, 1), (2, 2))
    search = GridSearch(graph_of(problem), NO_HEURISTIC, problem.start, problem.goal)
    assert search.run() == FOUND
    costs = search.costs_from_start()
    assert 0 < costs[search.goal] < np.inf
    assert np.isinf(costs[-1])


def test_a_map_without_layers_is_searched_by_length_alone():
    problem = Problem(np.zeros((0, 3, 4)), np.ones((3, 4), bool), (0, 0), (0, 3), 2.0, 1.0)
    assert astar(problem).cost == 6.0
