"""A* on the grid: 4- or 8-connected, both cost models, several heuristics."""

import time
from functools import cache

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.evaluate import evaluate_on
from jaxurban.planners.evaluate import warm_up as warm_up_evaluation
from jaxurban.planners.graph import graph_of
from jaxurban.planners.heuristics import ADMISSIBLE, AUTO, heuristic_at, make_heuristic, prepare
from jaxurban.planners.search import EXHAUSTED, FOUND, KEEP, PAUSED, REOPEN, Search


def astar(
    problem: Problem,
    *,
    budget_s: float = np.inf,
    seed: int = 0,
    heuristic: str = "octile",
    reopen: bool = False,
    planner: str = "astar",
) -> Path:
    """Return the cheapest path over the grid, or why there is none.

    The status is OPTIMAL where the heuristic is admissible, else FEASIBLE. The search runs in chunks, so
    that the budget and Ctrl-C are heeded within some 50 ms; it is deterministic, and the seed plays no part.

    Args:
      problem: the question.
      budget_s: seconds of search and of what it needs (``setup_s`` of the path).
      seed: taken for the planner contract.
      heuristic: a name of `heuristics.HEURISTICS`, or ``"auto"``: landmarks where a map and weights serve
        more than a few queries (see `landmarks.should_use`), else ``plus``. The path says which ran.
      reopen: expand a node again when a cheaper way to it turns up after it was closed. It changes
        nothing with a consistent heuristic, as all admissible ones here are; with a printed one it
        mends some paths, at up to exponential cost.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic, or a budget that is not positive.
    """
    check_budget(budget_s)
    warm_up(heuristic)
    prepared = prepare(heuristic, problem, budget_s)
    begin_s = time.perf_counter()
    is_admissible = prepared.name in ADMISSIBLE
    # Where the tables are not ready, the budget is spent.
    bound = make_heuristic(prepared.name if prepared.is_ready else "octile", problem)
    search = Search(graph_of(problem), bound, problem.start, problem.goal)
    ended = PAUSED
    if prepared.is_ready:
        ended = search.run(closed=REOPEN if reopen else KEEP, end_s=begin_s + budget_s - prepared.setup_s)
    points_m, cost, note = np.empty((0, 2)), np.inf, prepared.note
    if ended == FOUND:
        status = Status.OPTIMAL if is_admissible else Status.FEASIBLE
        points_m = search.points_m(problem.resolution_m)
        cost = evaluate_on(problem, points_m).total
        note = " ".join(filter(None, (note, free_ride(problem, cost))))
    else:
        status = Status.NO_PATH if ended == EXHAUSTED else Status.BUDGET_EMPTY
    if status is Status.OPTIMAL:
        lower_bound = cost
    elif status is Status.NO_PATH:
        lower_bound = np.inf
    elif is_admissible:
        lower_bound = search.low_f
    else:
        lower_bound = heuristic_at(make_heuristic("octile", problem), problem.start, problem.goal)
    return Path(
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=lower_bound,
        num_expanded=search.num_expanded,
        elapsed_s=time.perf_counter() - begin_s,
        planner=planner,
        heuristic=prepared.name,
        backend="numba",
        note=note,
        setup_s=prepared.setup_s,
    )


def astar_dist(
    problem: Problem,
    *,
    budget_s: float = np.inf,
    seed: int = 0,
    heuristic: str = "euclidean",
    reopen: bool = False,
) -> Path:
    """Return the cheapest path, guided by the straight distance (the paper's A*-dist; see `astar`)."""
    return astar(problem, budget_s=budget_s, seed=seed, heuristic=heuristic, reopen=reopen, planner="astar-dist")


def astar_plus(
    problem: Problem,
    *,
    budget_s: float = np.inf,
    seed: int = 0,
    heuristic: str = AUTO,
    reopen: bool = False,
) -> Path:
    """Return the cheapest path, guided by distance and map costs, with an admissible bound (see `astar`)."""
    return astar(problem, budget_s=budget_s, seed=seed, heuristic=heuristic, reopen=reopen, planner="astar-plus")


def check_budget(budget_s: float) -> None:
    """Raise InputError unless the budget is a positive number of seconds."""
    if not budget_s > 0:
        raise InputError(f"budget_s must be a positive number of seconds, got {budget_s}")


def free_ride(problem: Problem, cost: float) -> str:
    """Return what to say of a path that costs nothing, else nothing."""
    if problem.distance_weight == 0 and cost == 0:
        return "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."
    return ""


@cache
def warm_up(heuristic: str, is_anytime: bool = False) -> None:
    """Compile what a search with this heuristic runs, so that its time is the search's own."""
    problem = Problem(np.zeros((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0)
    for name in ("plus", "landmarks") if heuristic == AUTO else (heuristic,):
        bound = make_heuristic(prepare(name, problem, np.inf).name, problem)
        search = Search(graph_of(problem), bound, problem.start, problem.goal)
        search.run()
        if is_anytime:
            search.requeue(1.0, search.lower_bound()[1])
    warm_up_evaluation()
