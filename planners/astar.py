"""A* on the grid, 4- or 8-connected, and through a stack of levels: both cost models, several heuristics."""

import time
from functools import partial

import numpy as np

from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, PAUSED
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.bounds import AUTO, PRINTED, TABLES, has_tables, heuristic_at, make_heuristic
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.grid_search import GridSearch, cell_of, graph_of, way_m


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
    """Return the cheapest path over the grid, or through the volume, or why there is none.

    The status is OPTIMAL where the heuristic is admissible, else FEASIBLE. The search runs in chunks, so
    that the budget and Ctrl-C are heeded within some 50 ms; it is deterministic, and the seed plays no part.

    Args:
      problem: the query.
      budget_s: seconds of search and of the tables that its heuristic needs.
      seed: taken for the planner contract.
      heuristic: a name of `bounds.HEURISTICS`, or ``"auto"``: ``tiles``; in a volume one of `bounds.VOLUME_HEURISTICS`.
        The path says which ran.
      reopen: expand a node again when a cheaper way to it turns up after it was closed. It changes
        nothing with a consistent heuristic, as all admissible ones here are; with a printed one it
        mends some paths, at up to exponential cost.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic.
    """
    begin_s = time.perf_counter()
    end_s = begin_s + budget_s
    name = "tiles" if heuristic == AUTO else heuristic
    tables = "" if has_tables(name, problem) else TABLES[name]
    try:
        bound, made = make_heuristic(name, problem, end_s), "took"
    except TimeoutError:
        bound, made = make_heuristic("octile", problem), "were not done in"
    took_s = time.perf_counter() - begin_s
    start, goal = (cell_of(problem, node) for node in (problem.start, problem.goal))
    search = GridSearch(graph_of(problem), bound, start, goal)
    ended = search.run(reopen=reopen, end_s=end_s) if made == "took" else PAUSED
    points_m, lower_bound = np.empty(0), search.low_f if ended == PAUSED else np.inf
    if ended == FOUND:
        status = Status.FEASIBLE if name in PRINTED else Status.OPTIMAL
        points_m = way_m(problem, search.states, search.graph.steps)
    else:
        status = Status.NO_PATH if ended == EXHAUSTED else Status.BUDGET_EMPTY
    if name in PRINTED:
        lower_bound = heuristic_at(make_heuristic("octile", problem), start, goal)
    return Path.of(
        problem,
        points_m,
        status,
        lower_bound,
        begin_s,
        num_expanded=search.num_expanded,
        planner=planner,
        heuristic=name,
        note=f"{tables} {made} {took_s:.3g} s." if tables else "",
    )


# The paper's two: guided by the straight distance, and by distance and map costs, with an admissible bound.
astar_dist = partial(astar, heuristic="euclidean", planner="astar-dist")
astar_plus = partial(astar, heuristic=AUTO, planner="astar-plus")
volume_astar = partial(astar, heuristic="plus", planner="astar-volume")  # through a stack of levels, 26-connected
