"""Planning off the grid without samples: PTP, the straight segment; Theta*, any-angle search.

Theta* works under the line cost model (Nash, Daniel, Koenig & Felner 2007). In compiled parts points are x, y in cell
sides from the map's southwest corner, inside it; nodes are flat cell numbers.
"""

import time
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import CostGrid, is_pinched, segment_cost
from jaxurban.kernels.search.heap import (
    AS_HEAP,
    EXHAUSTED,
    FOUND,
    FULL,
    NO_PARENT,
    PAUSED,
    Heap,
    drop_top,
    place,
)
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status, cell_index, way_to
from jaxurban.planners.bitstar.bounds import Bounds, cost_grid_of, make_bounds, reachable_cells
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.cost import sample_segment
from jaxurban.planners.refine import check_line_model, shortcut_line

STEPS_PER_NODE = 8
CHUNK = 10_000  # expansions between two looks at the clock: some 5 to 50 ms
FIRST_HEAP = 4096  # entries; doubled when full


@compiled_first()
def ptp(problem: Problem, *, budget_s: float = np.inf, seed: int = 0) -> Path:
    """Return the straight path, sampled every resolution step, or BLOCKED if it is not a free way (`is_free_way`).

    The status is otherwise FEASIBLE, never OPTIMAL, since nothing else was tried. The lower bound is the cost of the
    distance alone, and holds for any path.

    Args:
      problem: the query, on one altitude.
      budget_s, seed: taken for the planner contract; neither plays a part.
    """
    begin_s = time.perf_counter()
    start_m = (np.array(problem.start[::-1]) + 0.5) * problem.resolution_m
    goal_m = (np.array(problem.goal[::-1]) + 0.5) * problem.resolution_m
    points_m = sample_segment(start_m, goal_m, problem.resolution_m)
    is_valid = problem.features(points_m).is_valid
    return Path.of(
        problem,
        points_m if is_valid else np.empty(0),
        Status.FEASIBLE if is_valid else Status.BLOCKED,
        problem.distance_weight * float(np.hypot(*(goal_m - start_m))),
        begin_s,
        num_expanded=len(points_m) - 1,
        planner="ptp",
        backend="numpy",
        graph="",
    )


@compiled_first()
def theta_star(
    problem: Problem, *, budget_s: float = np.inf, seed: int = 0, heuristic: str = "plus"
) -> Path:
    """Return a path of straight segments between cells and points between them, free of the grid's eight directions.

    Theta* takes as a cell's parent the parent of its neighbour, by the straight segment, where that is cheaper than the
    step. Then the path is shortcut between points along it, by dynamic programming. Segments are costed, and tested for
    obstacles, over the exact cells that they cross. The path is never costlier than the cheapest grid path. Of
    ``diagonal`` only ``"always"`` plays a part: then a path may pass between two obstacles that touch at a corner.
    ``connectivity`` plays none.

    Differs from the paper: with map costs the straight segment may be the more expensive one, so both ways are
    costed and compared; the paper always takes the segment where it is free, which can end above A*.

    OPTIMAL where the cost meets a lower bound of every curve (as on an empty map), else FEASIBLE. The budget and Ctrl-C
    are heeded within some 50 ms. Deterministic; the seed plays no part.

    Args:
      problem: the query, under the ``line`` cost model, or under any where only length costs.
      budget_s: seconds of search.
      seed: taken for the planner contract.
      heuristic: ``"euclidean"`` or ``"plus"`` (see `bitstar.bounds.make_bounds`).

    Raises:
      InputError: the ``cell`` cost model with map costs, or an unknown heuristic.
    """
    check_line_model(problem, "planner 'theta-star'")
    begin_s = time.perf_counter()

    # Without a way between start and goal there is nothing to search.
    points_m = np.empty(0)
    status = Status.NO_PATH
    lower_bound = np.inf
    num_expanded = 0
    is_reachable = reachable_cells(problem)
    if is_reachable[problem.goal]:
        bounds = make_bounds(heuristic, problem, is_reachable)
        cost_grid = cost_grid_of(problem, is_reachable)
        xy, num_expanded = _search(problem, cost_grid, bounds, begin_s + budget_s)
        lower_bound = bounds.from_start_to_goal()
        status = Status.BUDGET_EMPTY
        if len(xy):
            status = Status.FEASIBLE
            points_m = shortcut_line(cost_grid, xy) * problem.resolution_m
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


def _search(
    problem: Problem, cost_grid: CostGrid, bounds: Bounds, end_s: float
) -> tuple[np.ndarray, int]:
    """Search, and return ``[N, 2]`` x, y of the path's cell centres in cell sides, and how many cells were expanded.

    Args:
      problem: the query.
      cost_grid: its map, on which a way joins start and goal.
      bounds: its lower bounds.
      end_s: time of `time.perf_counter` at which the search gives up; N is 0 then.
    """
    num_cells = cost_grid.cell_cost.size
    num_cols = cost_grid.cell_cost.shape[1]
    start = cell_index(problem, problem.start)
    goal = cell_index(problem, problem.goal)
    goal_row, goal_col = problem.goal

    # The bound's map part at cells' centres, which lie half-way between the borders.
    row_at = 0.5 * (bounds.row_sum[:-1] + bounds.row_sum[1:])
    col_at = 0.5 * (bounds.col_sum[:-1] + bounds.col_sum[1:])
    nodes = AnyAngleNodes(
        g=np.full(num_cells, np.inf),
        parent=np.full(num_cells, NO_PARENT, np.int32),
        tried=np.full(num_cells, NO_PARENT, np.int32),
        is_closed=np.zeros(num_cells, np.bool_),
        per_side=bounds.per_side,
        rows=np.abs(row_at - row_at[goal_row]),
        cols=np.abs(col_at - col_at[goal_col]),
    )

    # Search from the start, in chunks between two looks at the clock.
    heap = Heap.empty(FIRST_HEAP)
    nodes.g[start] = 0.0
    heap.item[place(heap, 0.0, AS_HEAP)] = start
    num_expanded = 0
    while True:
        ended, num_done = advance_any_angle(cost_grid, nodes, goal, heap, CHUNK)
        num_expanded += num_done
        if ended == FULL:
            heap = heap.grown()
        elif ended in (FOUND, EXHAUSTED):
            break
        if time.perf_counter() >= end_s:
            break

    cells = np.array(way_to(goal, nodes.parent) if ended == FOUND else [], np.int64)
    return np.stack([cells % num_cols, cells // num_cols], axis=-1) + 0.5, num_expanded


class AnyAngleNodes(NamedTuple):
    """What the search knows of every cell, and a lower bound of any curve's cost from its centre to the goal's.

    ``M`` cells, ``Y`` rows, ``X`` columns; the bound is that of `bitstar.bounds.Bounds`.

    Attributes:
      g: ``[M]`` float64 cost of the best path found, inf for none.
      parent: ``[M]`` int32 cell where its last segment begins, NO_PARENT at the start.
      tried: ``[M]`` int32 the last cell from which a straight segment was tried.
      is_closed: ``[M]`` bool.
      per_side: cost per cell side of distance.
      rows, cols: ``[Y]``, ``[X]`` map cost of the rows (columns) between; the larger one counts.
    """

    g: np.ndarray
    parent: np.ndarray
    tried: np.ndarray
    is_closed: np.ndarray
    per_side: float
    rows: np.ndarray
    cols: np.ndarray


@compiled()
def advance_any_angle(cost_grid, nodes, goal, heap, max_expanded):
    """Expand cells in order of f until the goal is reached, no cell is open, or ``max_expanded`` cells are expanded.

    A neighbour is reached by the step to it, or by the straight segment from the expanded cell's own
    parent, whichever is cheaper: so no cell is closed at more than the cheapest grid path to it costs
    (the first open cell of that path never costs more, and comes before any cell closed too early).
    A segment is costed once for each parent in turn, not for each neighbour that has this parent.

    Args:
      cost_grid: `CostGrid`, the map.
      nodes: `AnyAngleNodes`; its arrays are altered.
      goal: flat cell number.
      heap: the open cells, by f; altered. Outdated entries stay in it, and are skipped when their cell is closed.
      max_expanded: cells.

    Returns:
      How the chunk ended (FOUND, EXHAUSTED, PAUSED, or FULL for want of room in the heap), and the cells expanded.
    """
    num_rows, num_cols = cost_grid.cell_cost.shape
    goal_row = goal // num_cols
    goal_col = goal % num_cols
    num_expanded = 0
    while heap.size[0] > 0:
        if num_expanded >= max_expanded:
            return PAUSED, num_expanded
        if heap.size[0] + STEPS_PER_NODE > heap.f.size:
            return FULL, num_expanded

        # Close the open cell of lowest f.
        node = heap.item[0]
        drop_top(heap)
        if nodes.is_closed[node]:
            continue
        nodes.is_closed[node] = True
        if node == goal:
            return FOUND, num_expanded
        num_expanded += 1
        row = node // num_cols
        col = node % num_cols
        parent = nodes.parent[node]

        # The neighbours on the map, but for those that are closed or blocked.
        for to_row in range(max(row - 1, 0), min(row + 2, num_rows)):
            for to_col in range(max(col - 1, 0), min(col + 2, num_cols)):
                to = to_row * num_cols + to_col
                cell_cost = cost_grid.cell_cost[to_row, to_col]
                if nodes.is_closed[to] or cell_cost == np.inf:
                    continue
                length = 1.0
                if to_row != row and to_col != col:
                    length = np.sqrt(2.0)
                    if is_pinched(cost_grid, row, col, to_row, to_col):
                        continue

                # By the step: half of it lies in each of the two cells.
                best = nodes.g[to]
                best_parent = NO_PARENT
                g = nodes.g[node] + length * (
                    cost_grid.per_side + 0.5 * (cost_grid.cell_cost[row, col] + cell_cost)
                )
                if g < best:
                    best, best_parent = g, node

                # By the segment from the parent, unless it was tried last; one no cheaper than the best costs inf.
                if parent != NO_PARENT and parent != nodes.tried[to]:
                    nodes.tried[to] = parent
                    x = parent % num_cols + 0.5
                    y = parent // num_cols + 0.5
                    from_g = nodes.g[parent]
                    g = from_g + segment_cost(
                        cost_grid, x, y, to_col + 0.5, to_row + 0.5, best - from_g
                    )
                    if g < best:
                        best, best_parent = g, parent

                # Open the neighbour where either is cheaper than what is known, at f = g + the bound to the goal.
                if best_parent != NO_PARENT:
                    nodes.g[to], nodes.parent[to] = best, best_parent
                    dr, dc = float(to_row - goal_row), float(to_col - goal_col)
                    bound = nodes.per_side * np.sqrt(dr * dr + dc * dc)
                    bound += max(nodes.rows[to_row], nodes.cols[to_col])
                    heap.item[place(heap, best + bound, AS_HEAP)] = to
    return EXHAUSTED, num_expanded
