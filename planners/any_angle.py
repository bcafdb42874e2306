"""Theta*: any-angle search under the line cost model (Nash, Daniel, Koenig & Felner 2007)."""

import time

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, FULL, Heap, push
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status
from jaxurban.planners.bitstar.bounds import HEURISTICS, Bounds, make_bounds
from jaxurban.planners.checks import check_budget, check_name
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.cost_grid import cost_grid_of, reachable_cells
from jaxurban.planners.search.any_angle import MARGIN, NO_PARENT, AnyAngleNodes, Estimate, advance, shortcut

CHUNK = 10_000  # expansions between two looks at the clock: some 5 to 50 ms
FIRST_HEAP = 4096  # entries; doubled when full
SPACING = 0.4  # cell sides between the points that shortcuts join; 0.7 loses 0.04 %, 0.34 gains 0.01 %
REACH = 64  # points that a shortcut may span: 128 gains less than 0.001 % (both on Lower Manhattan)


@compiled_first()
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
      problem: the query, under the ``line`` cost model, or under any where only length costs.
      budget_s: seconds of search.
      seed: taken for the planner contract.
      heuristic: ``"euclidean"`` or ``"plus"`` (see `bitstar.bounds.make_bounds`).

    Raises:
      InputError: the ``cell`` cost model with map costs, an unknown heuristic, or a budget that is not positive.
    """
    check_name("heuristic", heuristic, HEURISTICS)
    check_budget(budget_s)
    check_line_model(problem, "planner 'theta-star'")
    begin_s = time.perf_counter()
    points_m, status, lower_bound, num_expanded = np.empty(0), Status.NO_PATH, np.inf, 0
    is_reachable = reachable_cells(problem)
    if is_reachable is not None:
        bounds = make_bounds(heuristic, problem, is_reachable)
        cost_grid = cost_grid_of(problem, is_reachable)
        xy, num_expanded = _search(problem, cost_grid, bounds, begin_s + budget_s)
        status, lower_bound = Status.FEASIBLE if len(xy) else Status.BUDGET_EMPTY, bounds.from_start_to_goal()
        if len(xy):
            points_m = shortened(cost_grid, xy) * problem.resolution_m
    return Path.of(
        problem,
        points_m,
        status,
        lower_bound,
        begin_s,
        num_expanded=num_expanded,
        planner="theta-star",
        heuristic=heuristic,
        graph=EVERY_PATH,
    )


def check_line_model(problem: Problem, what: str) -> None:
    """Refuse the ``cell`` cost model, but where only length costs, since there the models agree.

    Raises:
      InputError: the problem's cost model is ``cell``, and its map has costs.
    """
    if problem.cost_model.kind == "cell" and problem.cost[problem.is_free].any():
        raise InputError(
            f"{what} weighs straight segments of any direction by the length in each cell, which is not how "
            "cost_model='cell' counts: choose cost_model='line' (--cost-model line)"
        )


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


def shortened(cost_grid: CostGrid, xy: np.ndarray) -> np.ndarray:
    """Return a polyline cut short between points along it at their best, with no points that do nothing."""
    points, is_added = _with_parts(xy, SPACING)
    # Between points on borders a segment could run along an obstacle's wall.
    is_near_border = (np.abs(points - np.rint(points)) < MARGIN).any(axis=1)
    return shortcut(cost_grid, shortcut(cost_grid, points[~(is_added & is_near_border)], REACH), REACH)


def _search(problem: Problem, cost_grid: CostGrid, bounds: Bounds, end_s: float) -> tuple[np.ndarray, int]:
    """Return ``[N, 2]`` the path's cell centres, none where time ran out, and the cells expanded."""
    (start_row, start_col), (goal_row, goal_col) = problem.start, problem.goal
    num_cols = cost_grid.cell_cost.shape[1]
    start, goal = start_row * num_cols + start_col, goal_row * num_cols + goal_col
    row_at, col_at = (0.5 * (sums[:-1] + sums[1:]) for sums in (bounds.row_sum, bounds.col_sum))
    estimate = Estimate(bounds.per_side, np.abs(row_at - row_at[goal_row]), np.abs(col_at - col_at[goal_col]))
    num_cells = cost_grid.cell_cost.size
    nodes = AnyAngleNodes(
        g=np.full(num_cells, np.inf),
        parent=np.full(num_cells, NO_PARENT, np.int32),
        tried=np.full(num_cells, NO_PARENT, np.int32),
        is_closed=np.zeros(num_cells, np.bool_),
    )
    heap = Heap.empty(FIRST_HEAP)
    nodes.g[start] = 0.0
    push(heap, 0.0, start)
    num_expanded = 0
    while True:
        ended, num_done = advance(cost_grid, estimate, nodes, goal, heap, CHUNK)
        num_expanded += num_done
        if ended == FULL:
            heap = heap.grown()
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
