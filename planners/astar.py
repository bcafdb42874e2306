"""A* on the grid: 4- or 8-connected, both cost models, several heuristics."""

import time
from functools import cache

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.evaluate import evaluate_on
from jaxurban.planners.evaluate import warm_up as warm_up_evaluation
from jaxurban.planners.heuristics import ADMISSIBLE, Heuristic, heuristic_at, make_heuristic
from jaxurban.planners.moves import STEPS
from jaxurban.planners.search import (
    EXHAUSTED,
    FOUND,
    HEAP_FULL,
    NO_PARENT,
    PARENT_STEP,
    Graph,
    advance,
)

CHUNK = 200_000  # expansions between two looks at the clock: some 50 ms
FIRST_HEAP = 4096  # entries; doubled when full


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
      budget_s: seconds of search.
      seed: taken for the planner contract.
      heuristic: a name of `heuristics.HEURISTICS`.
      reopen: expand a node again when a cheaper way to it turns up after it was closed. It changes
        nothing with a consistent heuristic, as all admissible ones here are; with a printed one it
        mends some paths, at up to exponential cost.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic, or a budget that is not positive.
    """
    if not budget_s > 0:
        raise InputError(f"budget_s must be a positive number of seconds, got {budget_s}")
    _warm_up(heuristic)
    begin_s = time.perf_counter()
    bound = make_heuristic(heuristic, problem)
    is_admissible = heuristic in ADMISSIBLE
    ended, parents, num_expanded, low_f = _search(problem, bound, reopen, begin_s + budget_s)
    points_m, cost, note = np.empty((0, 2)), np.inf, ""
    if ended == FOUND:
        status = Status.OPTIMAL if is_admissible else Status.FEASIBLE
        points_m = _points_m(problem, parents)
        cost = evaluate_on(problem, points_m).total
        if problem.distance_weight == 0 and cost == 0:
            note = "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."
    else:
        status = Status.NO_PATH if ended == EXHAUSTED else Status.BUDGET_EMPTY
    if status is Status.OPTIMAL:
        lower_bound = cost
    elif status is Status.NO_PATH:
        lower_bound = np.inf
    elif is_admissible:
        lower_bound = low_f
    else:
        lower_bound = heuristic_at(make_heuristic("octile", problem), problem.start, problem.goal)
    return Path(
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=lower_bound,
        num_expanded=num_expanded,
        elapsed_s=time.perf_counter() - begin_s,
        planner=planner,
        heuristic=heuristic,
        backend="numba",
        note=note,
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
    heuristic: str = "plus",
    reopen: bool = False,
) -> Path:
    """Return the cheapest path, guided by distance and map costs, with an admissible bound (see `astar`)."""
    return astar(problem, budget_s=budget_s, seed=seed, heuristic=heuristic, reopen=reopen, planner="astar-plus")


def _search(problem: Problem, bound: Heuristic, reopen: bool, end_s: float) -> tuple[int, np.ndarray, int, float]:
    """Return how the search ended, every node's state, the nodes expanded, and the lowest f still open."""
    graph = _graph(problem)
    num_cols = graph.num_cols
    start, goal = (row * num_cols + col for row, col in (problem.start, problem.goal))
    g = np.full(graph.cost.size, np.inf)
    state = np.full(graph.cost.size, NO_PARENT, np.uint8)
    heap_f, heap_node = np.empty(FIRST_HEAP), np.empty(FIRST_HEAP, np.int32)
    g[start] = 0.0
    heap_f[0], heap_node[0] = heuristic_at(bound, problem.start, problem.goal), start
    size, num_expanded = 1, 0
    while True:
        ended, size, num_done = advance(graph, bound, goal, reopen, g, state, heap_f, heap_node, size, CHUNK)
        num_expanded += num_done
        if ended == HEAP_FULL:
            heap_f = np.concatenate([heap_f, np.empty_like(heap_f)])
            heap_node = np.concatenate([heap_node, np.empty_like(heap_node)])
        elif ended in (FOUND, EXHAUSTED):
            break
        if time.perf_counter() >= end_s:
            break
    return ended, state, num_expanded, float(heap_f[0])


def _graph(problem: Problem) -> Graph:
    """Return the problem's map as the search sees it."""
    steps = np.array(STEPS)
    length_m = np.hypot(*steps.T) * problem.resolution_m
    is_line = problem.cost_model == "line"
    # Half of an edge lies in each of its two cells.
    half = length_m / (2 * problem.reference_length_m)
    return Graph(
        cost=problem.cost.reshape(-1),
        moves=problem.moves.reshape(-1),
        num_cols=problem.cost.shape[1],
        steps=steps,
        step_cost=problem.distance_weight * length_m,
        from_share=half if is_line else np.zeros(len(steps)),
        to_share=half if is_line else np.ones(len(steps)),
    )


def _points_m(problem: Problem, state: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` the cell centres from start to goal, by the steps that led to each cell."""
    row, col = problem.goal
    cells = [(row, col)]
    while (row, col) != problem.start:
        rows, cols = STEPS[state[row * problem.cost.shape[1] + col] & PARENT_STEP]
        row, col = row - rows, col - cols
        cells.append((row, col))
    return (np.array(cells[::-1], np.float64)[:, ::-1] + 0.5) * problem.resolution_m


@cache
def _warm_up(heuristic: str) -> None:
    """Compile what a search with this heuristic runs, so that its time is the search's own."""
    problem = Problem(np.zeros((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0)
    _search(problem, make_heuristic(heuristic, problem), False, np.inf)
    warm_up_evaluation()
