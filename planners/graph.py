"""A problem as the compiled search sees it: the graph of its map, and the bound that guides a search."""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.search.tiles import TileBound
from jaxurban.planners.base import Problem
from jaxurban.planners.moves import STEPS

SAMPLES = 4093  # cells of a map that stand for all


class Graph(NamedTuple):
    """A grid as the search sees it; nodes are flat cell numbers. ``M`` nodes, ``K`` steps.

    Step k from P to Q costs ``step_cost[k] + from_share[k] * cost[P] + to_share[k] * cost[Q]``.

    Attributes:
      cost: ``[M]`` float64 map cost.
      moves: ``[M]`` uint8, bit k: step k is allowed.
      num_cols: cells in a row.
      steps: ``[K, 2]`` int64 rows and columns of each step.
      step_cost, from_share, to_share: ``[K]`` float64.
      sample: ``[S]`` float64 costs of cells all over the map from which steps lead.
    """

    cost: np.ndarray
    moves: np.ndarray
    num_cols: int
    steps: np.ndarray
    step_cost: np.ndarray
    from_share: np.ndarray
    to_share: np.ndarray
    sample: np.ndarray


class LandmarkBound(NamedTuple):
    """Costs to a few cells, which bound the cost to the goal (see `landmarks`). ``K`` landmarks.

    The bound is the greatest ``|costs[r, c, k] - at_goal[k]|``, plus ``goal_term - cost_share * cost[r, c]``.

    Attributes:
      costs: ``[Y, X, K]`` float64, inf where there is no way.
      at_goal: ``[K]`` the same at the goal.
      cost: ``[Y, X]`` the problem's map cost.
      cost_share, goal_term: what turns symmetric costs into those of the problem's steps.
    """

    costs: np.ndarray
    at_goal: np.ndarray
    cost: np.ndarray
    cost_share: float
    goal_term: float


class Heuristic(NamedTuple):
    """A bound ``h(n)`` on the cost to the goal, evaluated node by node. ``Y`` rows, ``X`` columns.

    With ``dr, dc`` rows and columns to the goal: a distance part ``euclidean * hypot(dr, dc)
    + straight * max(dr, dc) + diagonal * min(dr, dc)``, plus ``field[r, c]`` where it has any cells. Landmarks or
    tiles may raise it.

    Attributes:
      euclidean, straight, diagonal: cost per cell side.
      field: ``[Y, X]`` float64 map cost to the goal, or ``[0, 0]``. With a distance part of 0 it may hold
        the whole cost to go; inf proves that there is no way.
      landmarks, tiles: further bounds, of which the largest counts. A type of its own where there is one, so
        that the search is compiled without it for all others.
    """

    euclidean: float
    straight: float
    diagonal: float
    field: np.ndarray
    landmarks: LandmarkBound | None = None
    tiles: TileBound | None = None


NO_HEURISTIC = Heuristic(0.0, 0.0, 0.0, np.empty((0, 0)))  # 0, which makes A* Dijkstra's search


def graph_of(problem: Problem, *, is_symmetric: bool = False) -> Graph:
    """Return the problem's map as the search sees it.

    Args:
      problem: the query.
      is_symmetric: under the ``cell`` model, count half of each of a step's two cells instead of the one
        entered. A path from P to Q then costs ``(cost[P] - cost[Q]) / 2`` more than it does in truth.
    """
    cost, moves = problem.cost, problem.moves.reshape(-1)
    stride = max(1, moves.size // SAMPLES)
    sample = cost.reshape(-1)[::stride][moves[::stride] > 0]
    steps = np.array(STEPS)
    length_m = np.hypot(*steps.T) * problem.resolution_m
    if problem.cost_model.kind == "line":
        # Half of an edge lies in each of its two cells.
        from_share = to_share = length_m / (2 * problem.cost_model.reference_length_m)
    else:
        from_share = np.full(len(steps), 0.5 if is_symmetric else 0.0)
        to_share = 1.0 - from_share
    return Graph(
        cost=cost.reshape(-1),
        moves=moves,
        num_cols=cost.shape[1],
        steps=steps,
        step_cost=problem.distance_weight * length_m,
        from_share=from_share,
        to_share=to_share,
        sample=sample,
    )
