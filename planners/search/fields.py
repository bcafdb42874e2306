"""Fields: the costs from every cell of a map to a goal, for landmarks and for queries that share a goal."""

import numpy as np

from jaxurban.planners.base import Problem
from jaxurban.planners.graph import NO_HEURISTIC, graph_of
from jaxurban.planners.search.grid import EXHAUSTED, GridSearch


def symmetric_costs(problem: Problem, end_s: float = np.inf) -> np.ndarray:
    """Return ``[Y, X]`` the costs between a problem's goal and every cell, inf without a way, by Dijkstra's search.

    Under the ``cell`` model half of each of a step's two cells is counted (see `landmarks`), so that the cost is the
    same both ways.

    Args:
      problem: of any map and weights; its start plays no part.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      TimeoutError: the clock passed it.
    """
    search = GridSearch(graph_of(problem, is_symmetric=True), NO_HEURISTIC, problem.goal, None)
    if search.run(end_s=end_s) != EXHAUSTED:
        raise TimeoutError
    return search.costs_from_start().reshape(problem.is_free.shape)


def cost_to_go(problem: Problem, end_s: float = np.inf) -> np.ndarray:
    """Return ``[Y, X]`` the exact cost from every cell to a problem's goal, inf without a way.

    It is kept with the map for all queries to the same goal, until another goal's takes its place: a search with
    ``heuristic="exact"`` then walks down on it.

    Args:
      problem, end_s: as in `symmetric_costs`.

    Raises:
      TimeoutError: the clock passed it; nothing new is kept.
    """
    kept: dict[tuple[int, ...], np.ndarray] = problem.shared.get("cost_to_go", {})
    if problem.goal not in kept:
        costs = symmetric_costs(problem, end_s)
        if problem.cost_model.kind == "cell":
            half = 0.5 * (problem.cost[problem.goal] - np.where(problem.is_free, problem.cost, 0.0))
            costs = np.maximum(costs + half, 0.0)  # rounding might leave less
        kept = problem.shared["cost_to_go"] = {problem.goal: costs}
    return kept[problem.goal]


def has_cost_to_go(problem: Problem) -> bool:
    """Return whether the costs to the problem's goal are there already."""
    return problem.goal in problem.shared.get("cost_to_go", {})
