"""The bound by tiles against brute force: every step of random maps, and SciPy's costs to go."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.search.bounds import TILE
from jaxurban.planners.astar import astar, heuristic_at, make_heuristic
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.grid_search import graph_of

SHAPES = [
    (43, 61),
    (3 * TILE + 1, 5 * TILE),
    (TILE, 2),
    (1, 50),
]  # short of a tile, a whole number of them, less than one


def problem_on(shape, seed, cost_model, spread=1.0, share_free=0.8, distance_weight=0.3):
    """Costs in patches larger than a tile, which the bound can see, with noise; its goal and start anywhere free."""
    rng = np.random.default_rng(seed)
    patches = np.kron(rng.random((6, 8)), np.ones((13, 13)))[: shape[0], : shape[1]]
    layers = (spread * np.exp(3 * patches) * (0.9 + 0.2 * rng.random(shape)))[None]
    is_free = rng.random(shape) < share_free
    is_free[0, 0] = is_free[-1, -1] = True
    start, goal = (tuple(map(int, cell)) for cell in rng.permutation(np.argwhere(is_free))[:2])
    return Problem(layers, is_free, start, goal, 2.0, distance_weight, cost_model)


def steps_of(problem):
    """Every allowed step's origin, target and cost, by the graph's definition."""
    graph = graph_of(problem)
    origins, targets, costs = [], [], []
    for k, (rows, cols) in enumerate(graph.steps):
        origin = np.flatnonzero(graph.moves >> k & 1)
        target = origin + rows * graph.num_cols + cols
        share = graph.from_share[k] * graph.cost[origin] + graph.to_share[k] * graph.cost[target]
        origins.append(origin), targets.append(target), costs.append(graph.step_cost[k] + share)
    return tuple(map(np.concatenate, (origins, targets, costs)))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_tile_costs_what_its_cheapest_free_cell_does_rim_included(shape):
    problem = problem_on(shape, 1, CostModel(), share_free=0.1)
    found = problem.tile_minima
    cost = np.where(problem.is_free, problem.cost, np.inf)
    expected = np.full(found.shape, np.inf)
    for i in range(found.shape[0] - 2):
        for j in range(found.shape[1] - 2):
            tile = cost[i * TILE : (i + 1) * TILE + 1, j * TILE : (j + 1) * TILE + 1]
            expected[i + 1, j + 1] = tile.min(initial=np.inf)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", ["cell", "line"])
@pytest.mark.parametrize(("connectivity", "diagonal"), [(8, "both-free"), (8, "always"), (4, "both-free")])
@pytest.mark.parametrize("distance_weight", [0.0, 2.0])
def test_no_step_lowers_the_bound_by_more_than_it_costs(shape, kind, connectivity, diagonal, distance_weight):
    for seed in range(4):
        model = CostModel(kind, 3.0, connectivity, diagonal)
        problem = problem_on(shape, seed, model, distance_weight=distance_weight)
        heuristic = make_heuristic("tiles", problem)
        size, num_cols = problem.is_free.size, shape[1]
        values = np.array([heuristic_at(heuristic, divmod(node, num_cols), problem.goal) for node in range(size)])
        origin, target, cost = steps_of(problem)
        goal = problem.goal[0] * num_cols + problem.goal[1]
        steps = coo_matrix((np.maximum(cost, 1e-300), (target, origin)), (size, size)).tocsr()
        to_goal = dijkstra(steps, indices=goal)
        if np.isinf(values[problem.start[0] * num_cols + problem.start[1]]):
            assert np.isinf(to_goal[problem.start[0] * num_cols + problem.start[1]])
            continue
        assert values[goal] == pytest.approx(0.0, abs=1e-12)
        assert np.all(values[origin] <= cost + values[target] + 1e-12 * values.max())
        is_free = problem.is_free.reshape(-1)
        assert np.all(values[is_free] <= to_goal[is_free] * (1 + 1e-12) + 1e-12 * values.max())


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_the_bound_sees_costs_that_the_distance_does_not(kind):
    y, x = np.mgrid[:200, :300]
    noise = 1 + 0.05 * np.random.default_rng(0).random(y.shape)
    layers = ((2 + 1.8 * np.sin(x / 40) * np.sin(y / 30)) * noise)[None]
    problem = Problem(layers, np.ones(y.shape, bool), (60, 60), (150, 250), 1.0, 0.1, CostModel(kind, 1.0))
    octile, tiles = (astar(problem, heuristic=name) for name in ("octile", "tiles"))
    assert tiles.cost == pytest.approx(octile.cost, rel=1e-12)
    assert tiles.num_expanded < 0.5 * octile.num_expanded


def test_a_wall_thicker_than_a_tile_proves_that_there_is_no_way_before_the_search_begins():
    is_free = np.ones((20, 90), bool)
    is_free[:, 30 : 30 + 2 * TILE + 1] = False
    problem = Problem(np.ones((1, 20, 90)), is_free, (3, 3), (15, 80), 1.0, 1.0)
    path = astar(problem, heuristic="tiles")
    assert (path.status, path.num_expanded) == (Status.NO_PATH, 0)


def test_a_detour_beyond_what_the_bound_looks_at_is_found():
    is_free = np.ones((60, 400), bool)
    is_free[:58, 30] = False  # thinner than a tile: the bound goes straight through
    is_free[2:, 34] = False
    problem = Problem(np.ones((1, 60, 400)), is_free, (0, 25), (0, 40), 1.0, 1.0)
    octile, tiles = (astar(problem, heuristic=name) for name in ("octile", "tiles"))
    assert tiles.status is Status.OPTIMAL
    assert tiles.cost == pytest.approx(octile.cost, rel=1e-12)
