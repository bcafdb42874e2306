"""Problems, SciPy's least costs over steps written out, and what holds of a best path, for tests of bare arrays."""

import itertools
from types import SimpleNamespace

import numpy as np
from scipy.ndimage import label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.cost import CostModel

LEVELS_M = np.array([20.0, 22.0, 29.0, 60.0])
NEXT_TO_NOTHING = (
    1e-200  # what a step that costs nothing costs for SciPy, which takes an edge of 0 for none
)


def costed(points_m, costs, is_free, resolution_m, distance_weight, model):
    """Return what a path costs over layers of weight 1: total, length, each layer's part, and whether it is valid."""
    free = tuple(int(index) for index in np.argwhere(is_free)[0])
    problem = Problem(costs, is_free, free, free, resolution_m, distance_weight, model)
    found = problem.features(points_m)
    total = found.cost(problem.weights)
    return SimpleNamespace(
        total=total, length_m=found.phi[0], per_layer=found.phi[1:], is_valid=found.is_valid
    )


def open_problem(
    shape, start, goal, layers=None, cost_model="line", distance_weight=1.0, is_free=None
):
    """No obstacles and no costs but those given; cells of 2 m, a reference length of 4 m."""
    is_free = np.ones(shape, bool) if is_free is None else is_free
    layers = np.zeros((1, *shape)) if layers is None else layers
    return Problem(layers, is_free, start, goal, 2.0, distance_weight, CostModel(cost_model, 4.0))


def walled_problem(seed, cost_model, shape=(24, 30)):
    """A wall with one gap between start and goal, scattered obstacles, and random costs."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.9
    is_free[:, 15] = False
    is_free[4:8, 14:17] = True
    is_free[12, [2, 27]] = True
    layers = np.where(is_free, rng.random((2, *shape)), np.nan)
    return open_problem(shape, (12, 2), (12, 27), layers, cost_model, 0.2, is_free)


def random_problem(seed, shape=(13, 17), dtype=np.float64, share_free=0.75, **model):
    """A map, or levels of which every second has buildings, with costs in patches larger than a tile, some of them 0.

    What is not given of the cost model is random; inside obstacles every second map is NaN.
    """
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < share_free
    if len(shape) == 3 and seed % 2:
        is_free = np.logical_or.accumulate(is_free)
    start, goal = random_cells(rng, is_free)
    patches = np.kron(rng.random((8, 8)), np.ones((13, 13)))[: shape[-2], : shape[-1]]
    costs = (0.1 + rng.random((3, *shape)) ** 3) * np.exp(2 * patches)
    costs[:, rng.random(shape) < rng.choice([0.0, 0.2])] = 0.0
    costs[:, ~is_free] = np.nan if seed % 2 else 1.0
    drawn = {
        "connectivity": int(rng.choice([4, 8])),
        "diagonal": str(rng.choice(["both-free", "always"])),
    }
    model = CostModel(
        **{"kind": str(rng.choice(["cell", "line"])), "reference_length_m": 3.0, **drawn, **model}
    )
    levels_m = LEVELS_M[: shape[0]] if len(shape) == 3 else None
    weights = [
        rng.choice([0.0, 0.3]),
        *rng.choice([0.0, 0.5, 2.0], 3),
        *rng.choice([0.0, 0.4], 2 * (len(shape) - 2)),
    ]
    return Problem(costs.astype(dtype), is_free, start, goal, 2.0, weights, model, levels_m)


def random_cells(rng, is_free, num=2):
    """Return free cells, drawn one by one."""
    return [tuple(map(int, cell)) for cell in rng.choice(np.argwhere(is_free), num)]


def random_queries(problem, num, seed=0):
    """Return the problem between other cells, so many times."""
    rng = np.random.default_rng(seed)
    return [problem.between(*random_cells(rng, problem.is_free)) for _ in range(num)]


def edges_of(problem):
    """Return ``[N, N]`` the cost of every step of a problem's grid or levels, written out by its definition."""
    model, side_m = problem.cost_model, problem.resolution_m
    is_free = problem.is_free.reshape(-1, *problem.is_free.shape[-2:])
    z_m = np.zeros(1) if problem.levels_m is None else problem.levels_m
    cost = np.tensordot(problem.layer_weights, np.nan_to_num(problem.costs), 1).reshape(
        is_free.shape
    )
    framed, parts = np.pad(is_free, 1), []
    for up, rows, cols in itertools.product((-1, 0, 1), repeat=3):
        if (up, rows, cols) == (0, 0, 0) or (rows and cols and model.connectivity == 4):
            continue
        passed = {(0, 0), (rows, cols)} | (
            {(rows, 0), (0, cols)} if model.diagonal == "both-free" else set()
        )
        ends = [
            np.roll(framed, (-z, -row, -col), (0, 1, 2)) for z in {0, up} for row, col in passed
        ]
        here = np.argwhere(np.all(ends, axis=0)[1:-1, 1:-1, 1:-1])
        there = here + np.array([up, rows, cols])
        rise_m = z_m[there[:, 0]] - z_m[here[:, 0]]
        length_m = np.sqrt((rows**2 + cols**2) * side_m**2 + rise_m**2)
        entered, left = cost[tuple(there.T)], cost[tuple(here.T)]
        of_map = (
            entered
            if model.kind == "cell"
            else length_m * (entered + left) / 2 / model.reference_length_m
        )
        of_height = (
            np.maximum(rise_m, 0) * problem.height_costs[0]
            + np.maximum(-rise_m, 0) * problem.height_costs[1]
        )
        numbers = [np.ravel_multi_index(tuple(cells.T), cost.shape) for cells in (here, there)]
        parts.append(
            [problem.distance_weight * length_m + of_map + of_height + NEXT_TO_NOTHING, *numbers]
        )
    costs, here, there = (np.concatenate(values) for values in zip(*parts, strict=True))
    return csr_array((costs, (here, there)), shape=(cost.size, cost.size))


def costs_to_goal(problem, edges=None):
    """Return the least cost from every cell or node to the goal, inf without a way, by SciPy."""
    goal = np.ravel_multi_index(problem.goal, problem.is_free.shape)
    return dijkstra((edges_of(problem) if edges is None else edges).T, indices=goal).reshape(
        problem.is_free.shape
    )


def assert_optimal(path, problem, optimum=None):
    """Assert that a path leads from neighbour to neighbour at the least cost of all, or that there is none."""
    optimum = costs_to_goal(problem)[problem.start] if optimum is None else optimum
    if np.isinf(optimum):
        none = (Status.NO_PATH, np.inf, np.inf, (0, problem.is_free.ndim))
        assert (path.status, path.cost, path.lower_bound, path.points_m.shape) == none
        return
    assert path.status is Status.OPTIMAL
    np.testing.assert_allclose(path.cost, optimum, rtol=1e-12, atol=1e-12)
    assert path.lower_bound == path.cost
    assert problem.features(path.points_m).is_valid
    cells = np.floor(path.points_m[:, 1::-1] / problem.resolution_m).astype(int)
    np.testing.assert_array_equal(cells[[0, -1]], [problem.start[-2:], problem.goal[-2:]])
    assert np.abs(np.diff(cells, axis=0)).max(initial=0) <= 1


def reachable(problem):
    """The cells that 4-neighbours join to the start."""
    islands, _ = label(problem.is_free)
    return islands == islands[problem.start]


def sample_edges(problem, xy, radius, more_edges=()):
    """Return ``[N, N]`` the costs of edges between points within the radius, and more ``(origin, target)``; 0: none."""
    edges, cost_grid = np.zeros((len(xy), len(xy))), cost_grid_of(problem, problem.is_free)
    within = np.argwhere(np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1)) <= radius)
    for i, j in [*within, *more_edges]:
        if i != j:
            cost = segment_cost(cost_grid, *xy[i], *xy[j], np.inf)
            edges[i, j] = cost if np.isfinite(cost) else 0.0
    return edges


def graph_cost(problem, xy, radius, more_edges=(), ends=(0, 1)):
    """Return the least cost from one point to another over `sample_edges`, by SciPy."""
    return dijkstra(sample_edges(problem, xy, radius, more_edges), indices=ends[0])[ends[1]]


def ends_of(problem):
    """Start and goal as points, in cell sides."""
    return np.array([[cell[1] + 0.5, cell[0] + 0.5] for cell in (problem.start, problem.goal)])
