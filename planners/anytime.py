"""Anytime A*: a first path fast, better ones while there is time, and at every moment how far off they may be."""

import time
from collections.abc import Iterator
from itertools import chain, repeat

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.checks import check_budget, free_ride
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.heuristics import ADMISSIBLE, AUTO, prepare
from jaxurban.planners.search.grid import DEFER, PAUSED

# Chosen on Lower Manhattan over the default weights and 20 random ones (docs/heuristics.md).
LANDMARK_INFLATION = 1.07  # landmarks miss a few percent of the cost to go
LEAST_INFLATION = 1.2  # of the other bounds, even where the map costs hardly more than they count
MAP_SHARE = 0.65  # of the median cell's cost, what paths pay: they seek the cheaper cells
ROUND_FACTOR = 4  # less makes for more rounds: 2 expanded half as many nodes again until the end
NEAR_ONE = 1.02  # an inflation below this is as slow as none


@compiled_first()
def astar_anytime(
    problem: Problem,
    *,
    budget_s: float = np.inf,
    seed: int = 0,
    heuristic: str = AUTO,
    inflation: float | None = None,
) -> Path:
    """Return the cheapest path, or the best one that the budget allows with a bound on what it misses.

    Anytime repairing A* (Likhachev, Gordon & Thrun 2003): the heuristic is multiplied by an inflation, so
    that the search hurries to the goal; each further round quarters what it exceeds 1 by, and starts from
    the nodes that the last one left open or found a cheaper way to. A round ends with a path at most
    ``inflation`` times costlier than the best; so does, and often more tightly, the least ``g + h`` among
    all nodes left. Rounds end when no node left can lie on a cheaper path: status OPTIMAL, gap 0.

    ``history`` holds, after each round, seconds, nodes expanded and the cost of the best path, ``bounds``
    the lower bound proven by then. The budget and Ctrl-C are heeded within some 50 ms, ``lower_bound`` is
    as of the end.

    Args:
      problem: the query.
      budget_s: seconds of search and of the tables that its heuristic needs.
      seed: taken for the planner contract; it plays no part.
      heuristic: an admissible one of `heuristics.HEURISTICS`, or ``"auto"`` (see `astar.astar`).
      inflation: of the first round, at least 1; left out, as `first_inflation` judges the weights.

    Raises:
      InputError: an unknown or inadmissible heuristic, an inflation below 1, a budget that is not positive.
    """
    check_budget(budget_s)
    if heuristic not in (AUTO, *ADMISSIBLE):
        raise InputError(
            f"astar-anytime takes no heuristic {heuristic!r}: choose one of {', '.join((AUTO, *ADMISSIBLE))}"
        )
    if inflation is not None and not 1 <= inflation < np.inf:
        raise InputError(f"inflation must be a finite number of at least 1, got {inflation}")
    prepared = prepare(heuristic, problem, budget_s)
    begin_s = time.perf_counter()
    search = prepared.search(problem)
    end_s = begin_s + budget_s - prepared.tables_s
    points_m, cost, low, ended, num_open = np.empty((0, 2)), np.inf, search.low_f, PAUSED, 0
    history: list[tuple[float, int, float]] = []
    bounds: list[float] = []
    first = first_inflation(prepared.name, problem) if inflation is None else inflation
    for weight in chain(_falling(first), repeat(1.0)) if prepared.is_ready else ():
        search.requeue(weight, num_open)
        ended = search.run(closed=DEFER, inflation=weight, upper=cost, end_s=end_s)
        if search.cost_to(search.goal) < cost:
            points_m = search.points_m(problem.resolution_m)
            cost = min(cost, problem.cost_of(points_m))
        low_open, num_open = search.lower_bound()
        low = min(cost, max(low, low_open, 0.0 if ended == PAUSED else cost / weight))
        if cost < np.inf:
            history.append((time.perf_counter() - begin_s, search.num_expanded, cost))
            bounds.append(low)
        if ended == PAUSED or low >= cost:
            break
    if cost < np.inf:
        status = Status.OPTIMAL if low >= cost else Status.BUDGET_FEASIBLE
    else:
        status = Status.BUDGET_EMPTY if ended == PAUSED else Status.NO_PATH
    return Path(
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=low,
        num_expanded=search.num_expanded,
        elapsed_s=prepared.tables_s + time.perf_counter() - begin_s,
        planner="astar-anytime",
        heuristic=prepared.name,
        backend="numba",
        note=" ".join(filter(None, (prepared.note, free_ride(problem.distance_weight, cost)))),
        history=tuple(history),
        bounds=tuple(bounds),
        graph=problem.grid_name,
    )


def first_inflation(heuristic: str, problem: Problem) -> float:
    """Return what to multiply a heuristic by so that a search hurries to the goal and its path stays good.

    Landmarks see nearly all of the cost to go, whatever the weights, so a constant serves. The other bounds
    see the distance and, ``plus`` and ``tiles``, what the map, or a tile, costs everywhere: they are brought up to
    what paths typically pay, `MAP_SHARE` of the median cell's cost in place of what they count. Where they are 0
    everywhere no inflation helps.
    """
    if heuristic in ("landmarks", "exact"):
        return LANDMARK_INFLATION if heuristic == "landmarks" else 1.0
    share = 1.0 if problem.cost_model.kind == "cell" else problem.resolution_m / problem.cost_model.reference_length_m
    least = np.zeros(1)
    if heuristic == "tiles":
        least = problem.tile_minima
    elif heuristic == "plus":
        least = np.concatenate(problem.line_minima)
    median = problem.once("median_cost", lambda: float(np.median(problem.cost[problem.is_free])))
    typical, counted = share * median, share * float(least[np.isfinite(least)].mean())
    per_side = problem.distance_weight * problem.resolution_m + counted
    if per_side == 0:
        return LEAST_INFLATION
    return max(LEAST_INFLATION, 1 + MAP_SHARE * (typical - counted) / per_side)


def _falling(inflation: float) -> Iterator[float]:
    """Yield the inflations of the rounds before the last."""
    while inflation > NEAR_ONE:
        yield inflation
        inflation = 1 + (inflation - 1) / ROUND_FACTOR
