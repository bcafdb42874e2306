"""Estimates of the cost to the goal, by name, in the form that the search evaluates."""

import time
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.search.bounds import printed_plus_field
from jaxurban.kernels.search.tiles import StepCost, TileBound, costs_at_corners, tile_bound
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.checks import check_name
from jaxurban.planners.graph import NO_HEURISTIC, Heuristic, graph_of
from jaxurban.planners.landmarks import landmark_bound, make_landmarks
from jaxurban.planners.search.fields import cost_to_go, has_cost_to_go
from jaxurban.planners.search.grid import GridSearch, estimate

ADMISSIBLE = ("none", "euclidean", "octile", "tiles", "landmarks", "exact")  # all of them consistent too
PRINTED = ("plus-printed", "plus-printed-from-0")
HEURISTICS = ADMISSIBLE + PRINTED
AUTO = "auto"  # "tiles" for one query; of many, `planners.batch` chooses by what they share


class Prepared(NamedTuple):
    """What a search will run with.

    Attributes:
      name: the heuristic.
      is_ready: whether its tables were made within the budget.
      tables_s: what making them took, of the budget; 0 where they were there already or there are none.
      note: what to tell, where there is something.
    """

    name: str
    is_ready: bool
    tables_s: float
    note: str

    def search(self, problem: Problem) -> GridSearch:
        """Return the search for a problem, begun; by distance alone where the tables are not ready."""
        bound = make_heuristic(self.name if self.is_ready else "octile", problem)
        return GridSearch(graph_of(problem), bound, problem.start, problem.goal)


def prepare(name: str, problem: Problem, budget_s: float) -> Prepared:
    """Return the heuristic to run, with the tables made that all queries on the map (or to the goal) share.

    Raises:
      InputError: an unknown name.
    """
    check_name("heuristic", name, (AUTO, *HEURISTICS))
    name = "tiles" if name == AUTO else name
    makes_landmarks = name == "landmarks" and "landmarks" not in problem.shared
    makes_costs = name == "exact" and not has_cost_to_go(problem)
    begin_s = time.perf_counter()
    end_s = begin_s + budget_s
    is_ready, done = True, "took"
    try:
        if makes_landmarks:
            what = "The landmarks, which all queries on this map share,"
            make_landmarks(problem, end_s=end_s)
        elif makes_costs:
            what = "The costs to the goal, which all queries to it share,"
            cost_to_go(problem, end_s=end_s)
        else:
            return Prepared(name, True, 0.0, "")
    except TimeoutError:
        is_ready, done = False, "were not done in"
    tables_s = time.perf_counter() - begin_s
    return Prepared(name, is_ready, tables_s, f"{what} {done} {tables_s:.3g} s.")


def make_heuristic(name: str, problem: Problem) -> Heuristic:
    """Return a heuristic for a problem's goal, map, weights and cost model.

    - ``none``: 0, which makes A* Dijkstra's search.
    - ``euclidean``: ``distance_weight`` times the straight distance (the paper's h_dist).
    - ``octile``: the least length of an 8-connected path; Manhattan distance at connectivity 4.
    - ``tiles``: octile or, where larger, the cost to go over tiles of 8 x 8 cells that cost what their cheapest cell
      does (admissible, consistent).
    - ``landmarks``: octile or, where larger, the best landmark's bound (admissible, consistent).
    - ``exact``: the cost to go itself.
    - ``plus-printed``, ``plus-printed-from-0``: octile, plus the paper's box minima, summed over indices
      1..dx or 0..dx-1: **not** admissible. Under the ``line`` model every line counts in full.

    Raises:
      InputError: an unknown name.
    """
    check_name("heuristic", name, HEURISTICS)
    if name in ("none", "exact"):
        return NO_HEURISTIC if name == "none" else NO_HEURISTIC._replace(field=cost_to_go(problem))
    per_side = problem.distance_weight * problem.resolution_m
    if name == "euclidean":
        return NO_HEURISTIC._replace(euclidean=per_side)
    heuristic = NO_HEURISTIC._replace(
        straight=per_side, diagonal=per_side * (np.sqrt(2) - 1 if problem.cost_model.connectivity == 8 else 1)
    )
    if name == "landmarks":
        return heuristic._replace(landmarks=landmark_bound(problem, make_landmarks(problem)))
    if name == "tiles":
        return heuristic._replace(tiles=_tile_bound(problem))
    if name in PRINTED:
        field = printed_plus_field(_weighted_layers(problem), problem.goal, first_index=int(name == "plus-printed"))
        if problem.cost_model.kind == "line":
            field *= problem.resolution_m / problem.cost_model.reference_length_m
        # Inf comes of NaN inside obstacles here; the search would take it for a proof that there is no way.
        np.minimum(field, np.finfo(np.float64).max / 2, out=field)
        heuristic = heuristic._replace(field=field)
    return heuristic


def _tile_bound(problem: Problem) -> TileBound:
    """Return the tiles' bound on the cost to the problem's goal."""
    graph, minima = graph_of(problem), problem.tile_minima
    share = graph.from_share + graph.to_share
    straight, diagonal = ((float(graph.step_cost[step]), float(share[step])) for step in (0, -1))
    if problem.cost_model.connectivity == 4:
        diagonal = (2 * straight[0], 2 * straight[1])
    step_cost = StepCost(straight, diagonal)
    corners, is_joined = costs_at_corners(minima, step_cost, problem.start, problem.goal)
    return tile_bound(corners, is_joined, minima, step_cost, problem.goal)


def _weighted_layers(problem: Problem) -> np.ndarray:
    """Return ``[L, Y, X]`` float64 the layers times their weights."""
    return problem.costs * problem.layer_weights[:, None, None]


def heuristic_at(heuristic: Heuristic, cell: Cell, goal: Cell) -> float:
    """Return ``h`` at a cell."""
    return float(estimate(heuristic, *cell, *goal))
