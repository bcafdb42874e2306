"""A* on the grid: 4- or 8-connected, both cost models, several heuristics."""

import time
from functools import partial

import numpy as np

from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.checks import check_budget
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.heuristics import ADMISSIBLE, AUTO, heuristic_at, make_heuristic, prepare
from jaxurban.planners.search.grid import EXHAUSTED, FOUND, PAUSED


@compiled_first()
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
      problem: the query.
      budget_s: seconds of search and of the tables that its heuristic needs.
      seed: taken for the planner contract.
      heuristic: a name of `heuristics.HEURISTICS`, or ``"auto"``: ``tiles``. The path says which ran.
      reopen: expand a node again when a cheaper way to it turns up after it was closed. It changes
        nothing with a consistent heuristic, as all admissible ones here are; with a printed one it
        mends some paths, at up to exponential cost.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic, or a budget that is not positive.
    """
    check_budget(budget_s)
    prepared = prepare(heuristic, problem, budget_s)
    begin_s = time.perf_counter()
    is_admissible = prepared.name in ADMISSIBLE
    search = prepared.search(problem)
    ended = PAUSED
    if prepared.is_ready:
        ended = search.run(reopen=reopen, end_s=begin_s + budget_s - prepared.tables_s)
    points_m, lower_bound = np.empty(0), search.low_f if ended == PAUSED else np.inf
    if ended == FOUND:
        status = Status.OPTIMAL if is_admissible else Status.FEASIBLE
        points_m = search.points_m(problem.resolution_m)
    else:
        status = Status.NO_PATH if ended == EXHAUSTED else Status.BUDGET_EMPTY
    if not is_admissible:
        lower_bound = heuristic_at(make_heuristic("octile", problem), problem.start, problem.goal)
    return Path.of(
        problem,
        points_m,
        status,
        lower_bound,
        begin_s - prepared.tables_s,
        num_expanded=search.num_expanded,
        planner=planner,
        heuristic=prepared.name,
        note=prepared.note,
    )


# The paper's two: guided by the straight distance, and by distance and map costs, with an admissible bound.
astar_dist = partial(astar, heuristic="euclidean", planner="astar-dist")
astar_plus = partial(astar, heuristic=AUTO, planner="astar-plus")
