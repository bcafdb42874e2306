"""Problems and the costs of paths, for tests that have bare arrays in hand."""

from types import SimpleNamespace

import numpy as np
from scipy.ndimage import label
from scipy.sparse.csgraph import dijkstra

from jaxurban.planners.base import Problem
from jaxurban.planners.cost import CostModel


def costed(points_m, costs, is_free, resolution_m, distance_weight, model):
    """Return what a path costs over layers of weight 1: total, length, each layer's part, and whether it is valid."""
    free = tuple(int(index) for index in np.argwhere(is_free)[0])
    problem = Problem(costs, is_free, free, free, resolution_m, distance_weight, model)
    found = problem.features(points_m)
    return SimpleNamespace(
        total=found.cost(problem.weights), length_m=found.phi[0], per_layer=found.phi[1:], is_valid=found.is_valid
    )


def volume_problem(
    cost,
    is_free,
    levels_m,
    start,
    goal,
    resolution_m,
    distance_weight,
    climb_cost=0.0,
    descent_cost=0.0,
    cost_model="cell",
):
    """Return a problem between levels with one layer of weight 1."""
    weights = [distance_weight, 1.0, climb_cost, descent_cost]
    return Problem(np.asarray(cost)[None], is_free, start, goal, resolution_m, weights, cost_model, levels_m)


def open_problem(shape, start, goal, layers=None, cost_model="line", distance_weight=1.0, is_free=None):
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


def reachable(problem):
    """The cells that 4-neighbours join to the start."""
    islands, _ = label(problem.is_free)
    return islands == islands[problem.start]


def graph_cost(problem, xy, radius, more_edges=()):
    """Least cost from node 0 to node 1 over all edges within the radius, and more ``(origin, target)``, by SciPy."""
    edges = np.zeros((len(xy), len(xy)))
    within = np.argwhere(np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1)) <= radius)
    for i, j in [*within, *more_edges]:
        if i != j:
            cost = problem.cost_of(xy[[i, j]] * problem.resolution_m)
            edges[i, j] = cost if np.isfinite(cost) else 0.0
    return dijkstra(edges, indices=0)[1]


def ends_of(problem):
    """Start and goal as points, in cell sides."""
    return np.array([[cell[1] + 0.5, cell[0] + 0.5] for cell in (problem.start, problem.goal)])
