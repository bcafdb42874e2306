"""Landmarks: distances from a few cells to all others, which bound the cost between any two (differential heuristics).

With S(L, n) the cost between landmark L and node n, the triangle inequality gives |S(L, n) - S(L, t)| as a
bound from n to t, admissible and consistent (Goldberg & Harrelson 2005; Sturtevant et al. 2009). S must be
symmetric. The ``line`` model is; under ``cell`` a step costs the cell entered, so S counts half of each of
its two cells, and a path from n to t costs S plus (c(t) - c(n)) / 2: one field serves both ways.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.graph import LandmarkBound
from jaxurban.planners.search.fields import symmetric_costs

NUM_LANDMARKS = 8  # 8 float64 fill a cache line


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Costs between each landmark and every cell. ``Y`` rows, ``X`` columns, ``K`` landmarks.

    Attributes:
      cells: the landmarks.
      costs: ``[Y, X, K]`` float64 symmetric costs S; inf where there is no way.
      slack: what the bound is lowered by, so that rounding never lifts it above the true cost: one unit in
        the last place of the largest cost, for every cell, more than the sums along any path can lose.
    """

    cells: tuple[Cell, ...]
    costs: np.ndarray
    slack: float


def make_landmarks(problem: Problem, num: int = NUM_LANDMARKS, end_s: float = np.inf) -> Landmarks:
    """Return landmarks for a problem's map and weights, built once for all its queries (`Problem.between`).

    Landmarks that are there already are returned, whatever their number.

    Args:
      problem: the query; its start and goal play no part.
      num: how many, where the map has as many cells.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      TimeoutError: the clock passed it.
    """
    if "landmarks" not in problem.shared:
        cells = landmark_cells(problem, num)
        costs = np.empty((*problem.is_free.shape, len(cells)))
        for k, cell in enumerate(cells):
            costs[..., k] = symmetric_costs(problem.between(cell, cell), end_s)
        largest = np.max(costs, where=np.isfinite(costs), initial=0.0)
        slack = float(largest) * problem.is_free.size * np.finfo(np.float64).eps
        problem.shared["landmarks"] = Landmarks(tuple(cells), costs, slack)
    made: Landmarks = problem.shared["landmarks"]
    return made


def landmark_cells(problem: Problem, num: int) -> list[Cell]:
    """Return up to ``num`` cells of the largest connected part of the map, far from its middle and from each other.

    The first is the cell farthest from the mean, each next one the cell farthest from all before, in a
    straight line. Choosing by cost instead, or by the share of shortest paths left uncovered (avoid, Goldberg
    & Werneck 2005), saved no more expansions on Lower Manhattan and needs searches of its own.
    """
    # A diagonal step between two free neighbours joins what they join already.
    parts, _ = label(problem.is_free, np.ones((3, 3)) if problem.cost_model.joins_corners else None)
    rows, cols = np.nonzero(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    away = np.hypot(rows - rows.mean(), cols - cols.mean())
    cells: list[Cell] = []
    nearest = np.full(rows.size, np.inf)
    while len(cells) < min(num, rows.size):
        i = np.argmax(nearest if cells else away)
        cells.append((int(rows[i]), int(cols[i])))
        nearest = np.minimum(nearest, np.hypot(rows - rows[i], cols - cols[i]))
    return cells


def landmark_bound(problem: Problem, landmarks: Landmarks) -> LandmarkBound:
    """Return the landmarks' bound on the cost to a problem's goal."""
    cost_share = 0.5 if problem.cost_model.kind == "cell" else 0.0
    return LandmarkBound(
        costs=landmarks.costs,
        at_goal=landmarks.costs[problem.goal],
        cost=problem.cost,
        cost_share=cost_share,
        goal_term=cost_share * float(problem.cost[problem.goal]) - landmarks.slack,
    )
