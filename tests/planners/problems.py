"""Problems and the costs of paths, for tests that have bare arrays in hand."""

from types import SimpleNamespace

import numpy as np

from jaxurban.planners.base import Problem


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
