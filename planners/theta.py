"""Theta*: any-angle search under the line cost model (Nash, Daniel, Koenig & Felner 2007)."""

import time
from functools import cache

import numpy as np

from jaxurban.errors import InputError, nearest_name
from jaxurban.planners.base import CostModel, Path, Problem, Status
from jaxurban.planners.bitstar_bounds import HEURISTICS, Bounds, make_bounds
from jaxurban.planners.evaluate import evaluate_on
from jaxurban.planners.evaluate import warm_up as warm_up_evaluation
from jaxurban.planners.theta_search import (
    EXHAUSTED,
    FOUND,
    HEAP_FULL,
    MARGIN,
    NO_PARENT,
    TIE,
    Estimate,
    Ground,
    Nodes,
    advance,
    shortcut,
)

CHUNK = 10_000  # expansions between two looks at the clock: some 5 to 50 ms
FIRST_HEAP = 4096  # entries; doubled when full
SPACING = 0.4  # cell sides between the points that shortcuts join; 0.7 loses 0.04 %, 0.34 gains 0.01 %
REACH = 64  # points that a shortcut may span: 128 gains less than 0.001 % (both on Lower Manhattan)


def theta_star(problem: Problem, *, budget_s: float = np.inf, seed: int = 0, heuristic: str = "plus") -> Path:
    """Return a path of straight segments between cells and points between them, free of the grid's eight directions.

    Theta* lets a cell hang from the parent of its neighbour, by the straight segment, where that is
    cheaper than the step; then the path is cut short between points along it, at their best (dynamic
    programming). Segments are costed, and tested for obstacles, over the exact cells that
    they cross. Never costlier than the cheapest grid path. Of ``diagonal`` only ``"always"`` plays a part: then a
    path may pass between two obstacles that touch at a corner. ``connectivity`` plays none.

    Differs from the paper: with map costs the straight segment may be the dearer one, so both ways are
    costed and compared; the paper always takes the segment where it is free, which can end above A*.

    The status is OPTIMAL where the cost meets a lower bound of every curve (as on an empty map), else
    FEASIBLE. The budget and Ctrl-C are heeded within some 50 ms. Deterministic; the seed plays no part.

    Args:
      problem: the question, under the ``line`` cost model, or under any where only length is charged.
      budget_s: seconds of search.
      seed: taken for the planner contract.
      heuristic: ``"euclidean"`` or ``"plus"`` (see `bitstar_bounds.make_bounds`).

    Raises:
      InputError: the ``cell`` cost model with map costs, an unknown heuristic, or a budget that is not positive.
    """
    if heuristic not in HEURISTICS:
        raise InputError(
            f"unknown heuristic {heuristic!r}{nearest_name(heuristic, HEURISTICS)}: "
            f"choose one of {', '.join(HEURISTICS)}"
        )
    if not budget_s > 0:
        raise InputError(f"budget_s must be a positive number of seconds, got {budget_s}")
    check_line_model(problem, "planner 'theta-star'")
    _warm_up()
    begin_s = time.perf_counter()
    points_m, cost, note, num_expanded = np.empty((0, 2)), np.inf, "", 0
    islands = problem.islands
    if islands[problem.start] != islands[problem.goal]:
        status, lower_bound = Status.NO_PATH, np.inf
    else:
        is_reachable = islands == islands[problem.start]
        bounds = make_bounds(heuristic, problem, is_reachable)
        lower_bound = bounds.from_start_to_goal()
        ground = line_ground(problem, is_reachable)
        xy, num_expanded = _search(problem, ground, bounds, begin_s + budget_s)
        status = Status.BUDGET_EMPTY
        if len(xy):
            points_m = shortened(ground, xy) * problem.resolution_m
            cost = evaluate_on(problem, points_m).total
            status = Status.OPTIMAL if cost <= lower_bound * (1 + TIE) else Status.FEASIBLE
            lower_bound = min(lower_bound, cost)
            if problem.distance_weight == 0 and cost == 0:
                note = "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."
    return Path(
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=lower_bound,
        num_expanded=num_expanded,
        elapsed_s=time.perf_counter() - begin_s,
        planner="theta-star",
        heuristic=heuristic,
        backend="numba",
        note=note,
    )


def check_line_model(problem: Problem, what: str) -> None:
    """Refuse the ``cell`` cost model, but where only length is charged, since there the models agree.

    Raises:
      InputError: the problem's cost model is ``cell``, and its map has costs.
    """
    if problem.cost_model.kind == "cell" and problem.cost[problem.is_free].any():
        raise InputError(
            f"{what} weighs straight segments of any direction by the length in each cell, which is not how "
            "cost_model='cell' charges: choose cost_model='line' (--cost-model line)"
        )


def line_ground(problem: Problem, is_reachable: np.ndarray) -> Ground:
    """Return the map as segments see it, closed outside the cells ``[Y, X]`` that paths may cross."""
    per_side = problem.resolution_m / problem.cost_model.reference_length_m
    charge = np.where(is_reachable, problem.cost * per_side, np.inf)
    return Ground(charge, float(problem.distance_weight * problem.resolution_m), problem.cost_model.passes_corners)


def subdivided(xy: np.ndarray, longest: float) -> np.ndarray:
    """Return a polyline ``[N, 2]`` with points added so that no segment is longer; its course stays the same."""
    return _with_parts(xy, longest)[0]


def _with_parts(xy: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a subdivided polyline ``[M, 2]``, and ``[M]`` which of its points were added."""
    num_parts = np.maximum(1, np.ceil(np.hypot(*np.diff(xy, axis=0).T) / longest)).astype(np.int64)
    at = np.arange(num_parts.sum()) - np.repeat(np.cumsum(num_parts) - num_parts, num_parts)
    share = (at / np.repeat(num_parts, num_parts))[:, None]
    begin = np.repeat(np.arange(len(num_parts)), num_parts)
    points = xy[begin] + share * (xy[begin + 1] - xy[begin])
    return np.concatenate([points, xy[-1:]]), np.append(at > 0, False)


def shortened(ground: Ground, xy: np.ndarray) -> np.ndarray:
    """Return a polyline cut short between points along it at their best, with no points that do nothing."""
    points, is_added = _with_parts(xy, SPACING)
    # Between points on borders a segment could run along an obstacle's wall.
    is_near_border = (np.abs(points - np.rint(points)) < MARGIN).any(axis=1)
    return shortcut(ground, shortcut(ground, points[~(is_added & is_near_border)], REACH), REACH)


def _search(problem: Problem, ground: Ground, bounds: Bounds, end_s: float) -> tuple[np.ndarray, int]:
    """Return ``[N, 2]`` the path's cell centres, none where time ran out, and the cells expanded."""
    (start_row, start_col), (goal_row, goal_col) = problem.start, problem.goal
    num_cols = ground.charge.shape[1]
    start, goal = start_row * num_cols + start_col, goal_row * num_cols + goal_col
    row_at, col_at = (0.5 * (sums[:-1] + sums[1:]) for sums in (bounds.row_sum, bounds.col_sum))
    estimate = Estimate(bounds.per_side, np.abs(row_at - row_at[goal_row]), np.abs(col_at - col_at[goal_col]))
    num_cells = ground.charge.size
    nodes = Nodes(
        g=np.full(num_cells, np.inf),
        parent=np.full(num_cells, NO_PARENT, np.int32),
        tried=np.full(num_cells, NO_PARENT, np.int32),
        is_closed=np.zeros(num_cells, np.bool_),
    )
    heap_f, heap_node = np.zeros(FIRST_HEAP), np.empty(FIRST_HEAP, np.int32)
    nodes.g[start], heap_node[0] = 0.0, start
    size, num_expanded = 1, 0
    while True:
        ended, size, num_done = advance(ground, estimate, nodes, goal, heap_f, heap_node, size, CHUNK)
        num_expanded += num_done
        if ended == HEAP_FULL:
            heap_f = np.concatenate([heap_f, np.empty_like(heap_f)])
            heap_node = np.concatenate([heap_node, np.empty_like(heap_node)])
        elif ended in (FOUND, EXHAUSTED):
            break
        if time.perf_counter() >= end_s:
            break
    path = []
    node = goal
    while node != NO_PARENT and ended == FOUND:
        path.append(node)
        node = int(nodes.parent[node])
    cells = np.array(path[::-1], np.int64)
    return np.stack([cells % num_cols, cells // num_cols], axis=-1) + 0.5, num_expanded


@cache
def _warm_up() -> None:
    """Compile what a search runs, so that its time is its own."""
    problem = Problem(np.zeros((1, 1, 3)), np.ones((1, 3), bool), (0, 0), (0, 2), 1.0, 1.0, CostModel("line"))
    ground = line_ground(problem, problem.is_free)
    xy, _ = _search(problem, ground, make_bounds("plus", problem, problem.is_free), np.inf)
    shortened(ground, xy)
    warm_up_evaluation()
