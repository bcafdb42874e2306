"""The compiled parts of any-angle planning: segment costs, the search of Theta*, shortcuts, and moves of waypoints.

All that is compiled together stays in this file: Numba's cache looks only at the file of the outer function.
Points are x, y in cell sides from the map's southwest corner, inside it; nodes are flat cell numbers.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

FOUND, EXHAUSTED, PAUSED, HEAP_FULL = 0, 1, 2, 3  # how a chunk of search ended
NO_PARENT = -1
STEPS_PER_NODE = 8
TOUCH_SIDES = 1e-9  # a cut this short is rounding of a touched corner or border, not a crossing
MARGIN = 1e-6  # cell sides that waypoints keep from borders, lest rounding puts them in the cell beyond
TIE = 1e-12  # relative: costs this close are equal
GROW, SHRINK = 1.5, 0.5  # of a waypoint's step, where it helped and where it did not


class Ground(NamedTuple):
    """The map as segments see it. ``Y`` rows, ``X`` columns.

    Attributes:
      charge: ``[Y, X]`` float64 map cost per cell side crossed; inf where no path can lead.
      per_side: distance cost per cell side.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
    """

    charge: np.ndarray
    per_side: float
    passes_corners: bool


class Estimate(NamedTuple):
    """A lower bound of any curve's cost from a cell's centre to the goal's (see `bitstar_bounds.Bounds`).

    Attributes:
      per_side: cost per cell side of distance.
      rows, cols: ``[Y]``, ``[X]`` map cost of the rows (columns) between; the larger one counts.
    """

    per_side: float
    rows: np.ndarray
    cols: np.ndarray


class Nodes(NamedTuple):
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


@njit(cache=True)
def _is_pinched(ground, row, col, to_row, to_col):
    """Whether the cells beside a step to a diagonal neighbour leave no gap between them."""
    if ground.passes_corners:
        return False
    return ground.charge[to_row, col] == np.inf and ground.charge[row, to_col] == np.inf


@njit(cache=True)
def segment_cost(ground, x0, y0, x1, y1, limit):
    """Return the cost of a segment, or inf: blocked, or not below ``limit``.

    The walk from border to border is that of `kernels.traversal` and the law that of its `is_free_way`, but an end on
    a border counts as lying in the cell north or east of it: a segment that only touches an obstacle with its end may
    count as blocked.
    """
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    total = ground.per_side * length
    if total >= limit:
        return np.inf
    row, col = int(np.floor(y0)), int(np.floor(x0))
    num_x = abs(int(np.floor(x1)) - col)
    num_y = abs(int(np.floor(y1)) - row)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    sides_x = length / dx if num_x else 0.0  # along the segment, per cell side of x
    sides_y = length / dy if num_y else 0.0
    next_x = (col + (step_x > 0) - x0) * sides_x if num_x else np.inf
    next_y = (row + (step_y > 0) - y0) * sides_y if num_y else np.inf
    at = 0.0
    while True:
        charge = ground.charge[row, col]
        end = min(next_x, next_y, length)
        if charge == np.inf:
            return np.inf
        total += charge * (end - at)
        if total >= limit:
            return np.inf
        if num_x <= 0 and num_y <= 0:
            return total
        is_corner = abs(next_x - next_y) < TOUCH_SIDES
        if is_corner and _is_pinched(ground, row, col, row + step_y, col + step_x):
            return np.inf
        go_x, go_y = is_corner or next_x < next_y, is_corner or next_y < next_x
        if go_x:
            col += step_x
            num_x -= 1
            next_x = (col + (step_x > 0) - x0) * sides_x if num_x > 0 else np.inf
        if go_y:
            row += step_y
            num_y -= 1
            next_y = (row + (step_y > 0) - y0) * sides_y if num_y > 0 else np.inf
        at = end


@njit(cache=True)
def _push(heap_f, heap_node, size, f, node):
    """Put a node into a 4-ary heap of ``size`` entries."""
    i = size
    while i > 0:
        up = (i - 1) >> 2
        if heap_f[up] <= f:
            break
        heap_f[i], heap_node[i] = heap_f[up], heap_node[up]
        i = up
    heap_f[i], heap_node[i] = f, node


@njit(cache=True)
def _drop_top(heap_f, heap_node, size):
    """Remove the lowest entry of a heap of ``size`` entries; ``size - 1`` remain."""
    last = size - 1
    f, node = heap_f[last], heap_node[last]
    i = 0
    while True:
        first = 4 * i + 1
        if first >= last:
            break
        low = first
        for j in range(first + 1, min(first + 4, last)):
            if heap_f[j] < heap_f[low]:
                low = j
        if heap_f[low] >= f:
            break
        heap_f[i], heap_node[i] = heap_f[low], heap_node[low]
        i = low
    heap_f[i], heap_node[i] = f, node


@njit(cache=True)
def advance(ground, estimate, nodes, goal, heap_f, heap_node, size, max_expanded):
    """Expand cells in order of f until the goal is met, none is open, or ``max_expanded`` are done.

    A neighbour is reached by the step to it, or by the straight segment from the expanded cell's own
    parent, whichever is cheaper: so no cell is closed at more than the cheapest grid path to it costs
    (the first open cell of that path never costs more, and comes before any cell closed too early).
    A segment is costed once for each parent in turn, not for each neighbour that has this parent.

    Returns: how the chunk ended, the entries left in the heap, and the cells expanded.
    """
    num_rows, num_cols = ground.charge.shape
    goal_row, goal_col = goal // num_cols, goal % num_cols
    num_expanded = 0
    while size > 0:
        if num_expanded >= max_expanded:
            return PAUSED, size, num_expanded
        if size + STEPS_PER_NODE > heap_f.size:
            return HEAP_FULL, size, num_expanded
        node = heap_node[0]
        _drop_top(heap_f, heap_node, size)
        size -= 1
        if nodes.is_closed[node]:
            continue
        nodes.is_closed[node] = True
        if node == goal:
            return FOUND, size, num_expanded
        num_expanded += 1
        row, col, parent = node // num_cols, node % num_cols, nodes.parent[node]
        for to_row in range(max(row - 1, 0), min(row + 2, num_rows)):
            for to_col in range(max(col - 1, 0), min(col + 2, num_cols)):
                to = to_row * num_cols + to_col
                charge = ground.charge[to_row, to_col]
                if nodes.is_closed[to] or charge == np.inf:
                    continue
                length = 1.0
                if to_row != row and to_col != col:
                    length = np.sqrt(2.0)
                    if _is_pinched(ground, row, col, to_row, to_col):
                        continue
                best, best_parent = nodes.g[to], NO_PARENT
                g = nodes.g[node] + length * (ground.per_side + 0.5 * (ground.charge[row, col] + charge))
                if g < best:
                    best, best_parent = g, node
                if parent != NO_PARENT and parent != nodes.tried[to]:
                    nodes.tried[to] = parent
                    x, y = parent % num_cols + 0.5, parent // num_cols + 0.5
                    from_g = nodes.g[parent]
                    g = from_g + segment_cost(ground, x, y, to_col + 0.5, to_row + 0.5, best - from_g)
                    if g < best:
                        best, best_parent = g, parent
                if best_parent != NO_PARENT:
                    nodes.g[to], nodes.parent[to] = best, best_parent
                    dr, dc = float(to_row - goal_row), float(to_col - goal_col)
                    bound = estimate.per_side * np.sqrt(dr * dr + dc * dc)
                    bound += max(estimate.rows[to_row], estimate.cols[to_col])
                    _push(heap_f, heap_node, size, best + bound, to)
                    size += 1
    return EXHAUSTED, size, num_expanded


@njit(cache=True)
def shortcut(ground, xy, reach):
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
                cost = best[j] + segment_cost(ground, xy[j, 0], xy[j, 1], xy[k, 0], xy[k, 1], limit)
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


@njit(cache=True)
def _is_near_border(x, y):
    return min(x % 1.0, y % 1.0) < MARGIN or max(x % 1.0, y % 1.0) > 1.0 - MARGIN


@njit(cache=True)
def move_points(ground, xy, direction, step, longest):
    """Move each inner point by its step along its direction, or against it, where that makes its two segments cheaper.

    Point after point, each against the exact cost at the places that its neighbours have by then: the path
    never gets costlier, nor blocked. Steps grow where they helped and shrink where they did not. Points stay
    on the map and off the borders of cells, and no segment grows longer than ``longest``. ``xy`` and ``step``
    are altered.
    """
    num_rows, num_cols = ground.charge.shape
    for k in range(1, len(xy) - 1):
        x0, y0 = xy[k - 1]
        x1, y1 = xy[k]
        x2, y2 = xy[k + 1]
        cost = segment_cost(ground, x0, y0, x1, y1, np.inf) + segment_cost(ground, x1, y1, x2, y2, np.inf)
        factor = SHRINK
        for sign in (1.0, -1.0):
            x, y = x1 + sign * step[k] * direction[k, 0], y1 + sign * step[k] * direction[k, 1]
            if not (0.0 <= x < num_cols and 0.0 <= y < num_rows) or _is_near_border(x, y):
                continue
            if max(np.hypot(x - x0, y - y0), np.hypot(x - x2, y - y2)) > longest:
                continue
            first = segment_cost(ground, x0, y0, x, y, cost)
            if first < cost and first + segment_cost(ground, x, y, x2, y2, cost - first) < cost * (1 - TIE):
                xy[k, 0], xy[k, 1] = x, y
                factor = GROW
                break
        step[k] *= factor
