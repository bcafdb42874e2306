"""The compiled parts of any-angle planning: the search of Theta*, shortcuts, and moves of waypoints.

Points are x, y in cell sides from the map's southwest corner, inside it; nodes are flat cell numbers.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import is_pinched, segment_cost
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, FULL, PAUSED, drop_top, push

NO_PARENT = -1
STEPS_PER_NODE = 8
MARGIN = 1e-6  # cell sides that waypoints keep from borders, lest rounding puts them in the cell beyond
TIE = 1e-12  # relative: costs this close are equal
GROW, SHRINK = 1.5, 0.5  # of a waypoint's step, where it helped and where it did not


class Estimate(NamedTuple):
    """A lower bound of any curve's cost from a cell's centre to the goal's (see `bitstar.bounds.Bounds`).

    Attributes:
      per_side: cost per cell side of distance.
      rows, cols: ``[Y]``, ``[X]`` map cost of the rows (columns) between; the larger one counts.
    """

    per_side: float
    rows: np.ndarray
    cols: np.ndarray


class AnyAngleNodes(NamedTuple):
    """What the search knows of every cell. ``M`` cells.

    Attributes:
      g: ``[M]`` float64 cost of the best path found, inf for none.
      parent: ``[M]`` int32 cell where its last segment begins, NO_PARENT at the start.
      tried: ``[M]`` int32 the last cell from which a straight segment was tried.
      is_closed: ``[M]`` bool.
    """

    g: np.ndarray
    parent: np.ndarray
    tried: np.ndarray
    is_closed: np.ndarray


@compiled()
def advance(cost_grid, estimate, nodes, goal, heap, max_expanded):
    """Expand cells in order of f until the goal is met, no cell is open, or ``max_expanded`` are done.

    A neighbour is reached by the step to it, or by the straight segment from the expanded cell's own
    parent, whichever is cheaper: so no cell is closed at more than the cheapest grid path to it costs
    (the first open cell of that path never costs more, and comes before any cell closed too early).
    A segment is costed once for each parent in turn, not for each neighbour that has this parent.

    Returns: how the chunk ended, and the cells expanded.
    """
    num_rows, num_cols = cost_grid.cell_cost.shape
    goal_row, goal_col = goal // num_cols, goal % num_cols
    num_expanded = 0
    while heap.size[0] > 0:
        if num_expanded >= max_expanded:
            return PAUSED, num_expanded
        if heap.size[0] + STEPS_PER_NODE > heap.f.size:
            return FULL, num_expanded
        node = heap.item[0]
        drop_top(heap)
        if nodes.is_closed[node]:
            continue
        nodes.is_closed[node] = True
        if node == goal:
            return FOUND, num_expanded
        num_expanded += 1
        row, col, parent = node // num_cols, node % num_cols, nodes.parent[node]
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
                best, best_parent = nodes.g[to], NO_PARENT
                g = nodes.g[node] + length * (cost_grid.per_side + 0.5 * (cost_grid.cell_cost[row, col] + cell_cost))
                if g < best:
                    best, best_parent = g, node
                if parent != NO_PARENT and parent != nodes.tried[to]:
                    nodes.tried[to] = parent
                    x, y = parent % num_cols + 0.5, parent // num_cols + 0.5
                    from_g = nodes.g[parent]
                    g = from_g + segment_cost(cost_grid, x, y, to_col + 0.5, to_row + 0.5, best - from_g)
                    if g < best:
                        best, best_parent = g, parent
                if best_parent != NO_PARENT:
                    nodes.g[to], nodes.parent[to] = best, best_parent
                    dr, dc = float(to_row - goal_row), float(to_col - goal_col)
                    bound = estimate.per_side * np.sqrt(dr * dr + dc * dc)
                    bound += max(estimate.rows[to_row], estimate.cols[to_col])
                    push(heap, best + bound, to)
    return EXHAUSTED, num_expanded


@compiled()
def shortcut(cost_grid, xy, reach):
    """Return the cheapest way ``[K, 2]`` through some of the points ``[N, 2]`` in their order, ends included.

    Of all ways whose segments span at most ``reach`` points, by dynamic programming; of equally cheap
    ones, one with long segments. Where every way is blocked the points come back.
    """
    num = len(xy)
    best = np.full(num, np.inf)
    parent = np.full(num, NO_PARENT)
    best[0] = 0.0
    for k in range(1, num):
        for j in range(k - 1, max(-1, k - 1 - reach), -1):
            limit = best[k] * (1 + TIE) - best[j]
            if limit > 0.0:
                cost = best[j] + segment_cost(cost_grid, xy[j, 0], xy[j, 1], xy[k, 0], xy[k, 1], limit)
                if cost < np.inf:
                    best[k], parent[k] = cost, j
    if best[num - 1] == np.inf:
        return xy
    is_kept = np.zeros(num, np.bool_)
    k = num - 1
    while k != NO_PARENT:
        is_kept[k] = True
        k = parent[k]
    return xy[is_kept]


@compiled()
def _is_near_border(x, y):
    return min(x % 1.0, y % 1.0) < MARGIN or max(x % 1.0, y % 1.0) > 1.0 - MARGIN


@compiled()
def move_points(cost_grid, xy, direction, step, longest):
    """Move each inner point by its step along its direction, or against it, where that makes its two segments cheaper.

    Point after point, each against the exact cost at the places that its neighbours have by then: the path
    never gets costlier, nor blocked. Steps grow where they helped and shrink where they did not. Points stay
    on the map and off the borders of cells, and no segment grows longer than ``longest``. ``xy`` and ``step``
    are altered.
    """
    num_rows, num_cols = cost_grid.cell_cost.shape
    for k in range(1, len(xy) - 1):
        x0, y0 = xy[k - 1]
        x1, y1 = xy[k]
        x2, y2 = xy[k + 1]
        cost = segment_cost(cost_grid, x0, y0, x1, y1, np.inf) + segment_cost(cost_grid, x1, y1, x2, y2, np.inf)
        factor = SHRINK
        for sign in (1.0, -1.0):
            x, y = x1 + sign * step[k] * direction[k, 0], y1 + sign * step[k] * direction[k, 1]
            if not (0.0 <= x < num_cols and 0.0 <= y < num_rows) or _is_near_border(x, y):
                continue
            if max(np.hypot(x - x0, y - y0), np.hypot(x - x2, y - y2)) > longest:
                continue
            first = segment_cost(cost_grid, x0, y0, x, y, cost)
            if first < cost and first + segment_cost(cost_grid, x, y, x2, y2, cost - first) < cost * (1 - TIE):
                xy[k, 0], xy[k, 1] = x, y
                factor = GROW
                break
        step[k] *= factor
