"""The compiled search of BIT*: exact edge costs, and the queue that grows the tree over one batch.

All that is compiled together stays in this file: Numba's cache looks only at the file of the outer function.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

BATCH_DONE, PAUSED, QUEUE_FULL, COSTS_WANTED = 0, 1, 2, 3  # how a chunk of search ended
SAMPLE, OLD, FRESH, EXPANDED = 0, 1, 2, 3  # a node's state; all but SAMPLE are in the tree
NO_PARENT = -1
NOT_COSTED = -1.0  # a queued edge whose cost is not known yet
TOUCH_SIDES = 1e-9  # a cut this short is rounding of a touched corner or border, not a crossing
DIAGONAL_SIDES = np.sqrt(2) * (1 + 1e-9)  # the longest segment that is one step in the `cell` model


class Ground(NamedTuple):
    """The map as edges see it, in cell sides. ``Y`` rows, ``X`` columns.

    Attributes:
      charge: ``[Y, X]`` float64 map cost of a cell, per cell side crossed (`line`) or step (`cell`); inf
        where no path can lead.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: edges may pass between two blocked cells that touch at a corner.
    """

    charge: np.ndarray
    per_side: float
    is_line: bool
    passes_corners: bool


class Nodes(NamedTuple):
    """Tree and samples of one batch: ``N`` nodes, those of the tree before those that are only samples.

    Within each of the two groups the nodes are sorted by square bucket, row by row, so that
    ``tree_begin[b]:tree_begin[b + 1]`` are the tree's nodes of bucket b (and ``sample_begin`` the rest).

    Attributes:
      xy: ``[N, 2]`` float64 in cell sides.
      to_goal: ``[N]`` lower bound of the cost to the goal.
      row_at, col_at, enter: ``[N]`` parts of an edge's lower bound (see `bitstar_bounds.Bounds`).
      g: ``[N]`` cost of the path through the tree, inf for samples. Never too low; it may be too high
        for a node below one that was improved last, until the improvement reaches it.
      best: ``[N]`` the lowest cost of reaching a node found in this batch, queued edges included.
      parent: ``[N]`` int32.
      edge_cost: ``[N]`` cost of the edge from the parent.
      state: ``[N]`` uint8, one of SAMPLE, OLD, FRESH, EXPANDED.
      tree_begin, sample_begin: ``[B + 1]`` first node of each bucket.
      long_parent, long_child: ``[K]`` tree edges longer than the radius, sorted by parent.
    """

    xy: np.ndarray
    to_goal: np.ndarray
    row_at: np.ndarray
    col_at: np.ndarray
    enter: np.ndarray
    g: np.ndarray
    best: np.ndarray
    parent: np.ndarray
    edge_cost: np.ndarray
    state: np.ndarray
    tree_begin: np.ndarray
    sample_begin: np.ndarray
    long_parent: np.ndarray
    long_child: np.ndarray


class Queue(NamedTuple):
    """A 4-ary heap of edges by the least cost of a solution through them. ``Q`` entries.

    An entry from a node to itself stands for the expansion of that node, the paper's vertex queue.

    Attributes:
      f: ``[Q]`` float64.
      origin, target: ``[Q]`` int32 nodes.
      cost: ``[Q]`` float64 cost of the edge, or NOT_COSTED.
    """

    f: np.ndarray
    origin: np.ndarray
    target: np.ndarray
    cost: np.ndarray


@njit(cache=True)
def _is_pinched(ground, row, col, to_row, to_col):
    """Whether the cells beside a step to a diagonal neighbour leave no gap between them."""
    if ground.passes_corners:
        return False
    return ground.charge[to_row, col] == np.inf and ground.charge[row, to_col] == np.inf


@njit(cache=True)
def edge_cost(ground, x0, y0, x1, y1, limit):
    """Return the cost of a segment between two points inside cells, or inf: blocked, or not below ``limit``.

    The walk from border to border is that of `kernels.traversal` and the law that of its `is_free_way`;
    the charges are those of `evaluate`. Both ends lie off the borders of their cells.
    """
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    total = ground.per_side * length
    if total >= limit or length == 0.0:
        return np.inf if total >= limit else 0.0
    row, col = int(np.floor(y0)), int(np.floor(x0))
    num_x = abs(int(np.floor(x1)) - col)
    num_y = abs(int(np.floor(y1)) - row)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    sides_x = length / dx if num_x else 0.0  # along the segment, per cell side of x
    sides_y = length / dy if num_y else 0.0
    next_x = (col + (step_x > 0) - x0) * sides_x if num_x else np.inf
    next_y = (row + (step_y > 0) - y0) * sides_y if num_y else np.inf
    # In the `cell` model the next state to be charged, as far along the segment as this.
    next_state = length if length <= DIAGONAL_SIDES else 1.0
    at = 0.0
    while True:
        end = min(next_x, next_y, length)
        charge = ground.charge[row, col]
        if charge == np.inf:
            return np.inf
        if ground.is_line:
            total += charge * (end - at)
        else:
            # A state on a border belongs to the cell it came through; the last step may be shorter.
            while next_state < length * (1 - TOUCH_SIDES) and next_state <= end + TOUCH_SIDES:
                total += charge
                next_state += 1.0
        if total >= limit:
            return np.inf
        if num_x <= 0 and num_y <= 0:
            break
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
    if not ground.is_line:
        total += ground.charge[row, col]
    return total if total < limit else np.inf


@njit(cache=True)
def _push(queue, size, f, origin, target, cost):
    """Put an entry into a queue of ``size`` entries."""
    i = size
    while i > 0:
        up = (i - 1) >> 2
        if queue.f[up] <= f:
            break
        _move(queue, up, i)
        i = up
    queue.f[i], queue.origin[i], queue.target[i], queue.cost[i] = f, origin, target, cost


@njit(cache=True)
def _drop_top(queue, size):
    """Remove the lowest entry of a queue of ``size`` entries; ``size - 1`` remain."""
    last = size - 1
    f = queue.f[last]
    i = 0
    while True:
        first = 4 * i + 1
        if first >= last:
            break
        low = first
        for j in range(first + 1, min(first + 4, last)):
            if queue.f[j] < queue.f[low]:
                low = j
        if queue.f[low] >= f:
            break
        _move(queue, low, i)
        i = low
    _move(queue, last, i)


@njit(cache=True)
def _move(queue, origin, target):
    queue.f[target] = queue.f[origin]
    queue.origin[target] = queue.origin[origin]
    queue.target[target] = queue.target[origin]
    queue.cost[target] = queue.cost[origin]


@njit(cache=True)
def _num_near(begin, num_cols, bucket):
    """Return how many nodes lie in a bucket and its eight neighbours; buckets have a frame of empty ones."""
    count = 0
    for low in (bucket - num_cols, bucket, bucket + num_cols):
        count += begin[low + 2] - begin[low - 1]
    return count


@njit(cache=True)
def _queue_edges(nodes, queue, size, node, goal, begin, num_cols, bucket, radius, per_side):
    """Queue the edges from a node to those within the radius that they may improve; return the new size."""
    x, y = nodes.xy[node]
    g, incumbent = nodes.g[node], nodes.best[goal]
    row_at, col_at = nodes.row_at[node], nodes.col_at[node]
    for low in (bucket - num_cols, bucket, bucket + num_cols):
        for near in range(begin[low - 1], begin[low + 2]):
            dx, dy = nodes.xy[near, 0] - x, nodes.xy[near, 1] - y
            square = dx * dx + dy * dy
            if square > radius * radius or near == node:
                continue
            map_part = max(abs(nodes.row_at[near] - row_at), abs(nodes.col_at[near] - col_at))
            reach = g + per_side * np.sqrt(square) + nodes.enter[near] + map_part
            f = reach + nodes.to_goal[near]
            if reach < nodes.best[near] and f < incumbent:
                _push(queue, size, f, node, near, NOT_COSTED)
                size += 1
    return size


@njit(cache=True)
def _expand(nodes, queue, size, most, node, goal, buckets, radius, per_side):
    """Queue what a node leads to; return the new size, or -1, with nothing done, where it would pass ``most``.

    A node known from earlier batches leads to samples only: its edges to the tree were weighed before. A
    node that is new or was improved leads to both, and to its children that lie beyond the radius.
    """
    x, y = nodes.xy[node]
    bucket = (int((y - buckets.y) / buckets.side) + 1) * buckets.num_cols + int((x - buckets.x) / buckets.side) + 1
    is_fresh = nodes.state[node] == FRESH
    num_most = _num_near(nodes.sample_begin, buckets.num_cols, bucket)
    if is_fresh:
        num_most += _num_near(nodes.tree_begin, buckets.num_cols, bucket) + nodes.long_child.size
    if size + num_most > most:
        return -1
    nodes.state[node] = EXPANDED
    size = _queue_edges(nodes, queue, size, node, goal, nodes.sample_begin, buckets.num_cols, bucket, radius, per_side)
    if not is_fresh:
        return size
    size = _queue_edges(nodes, queue, size, node, goal, nodes.tree_begin, buckets.num_cols, bucket, radius, per_side)
    k = np.searchsorted(nodes.long_parent, node)
    while k < nodes.long_parent.size and nodes.long_parent[k] == node:
        child = nodes.long_child[k]
        reach = nodes.g[node] + nodes.edge_cost[child]
        if nodes.parent[child] == node and reach < nodes.best[child]:
            nodes.best[child] = reach
            _push(queue, size, reach + nodes.to_goal[child], node, child, nodes.edge_cost[child])
            size += 1
        k += 1
    return size


@njit(cache=True)
def advance(ground, nodes, queue, size, goal, buckets, radius, per_side, max_taken, wanted):
    """Take edges from the queue until none can improve the solution, or ``max_taken`` entries are done.

    An edge is queued by its lower bound and costed when it comes first; where its true cost no longer
    puts it first, it goes back with that. So the tree grows in order of cost, as A*'s would. A node that
    was improved is expanded again, which brings the improvement to all that hangs from it. Equal entries
    come in an order that only the nodes decide, so runs repeat.

    Args:
      ground, nodes, queue: see there; nodes and queue are altered.
      size: entries in the queue.
      goal: the goal's node.
      buckets: see `bitstar_tree.Buckets`.
      radius: of the graph.
      per_side: lower bound of an edge's cost per cell side.
      max_taken: entries of the queue.
      wanted: ``[W, 2]`` int32 room for edges, origin and target, that the caller is to cost in bulk and
        to give to `put_back`; ``[0, 2]``: each is costed here. Taking many before any is costed tries
        some more, and finds as good a path.

    Returns: how the chunk ended, the entries left in the queue, and the edges costed, or wanted.
    """
    num_costed = num_wanted = 0
    for _ in range(max_taken):
        if size == 0 or queue.f[0] >= nodes.g[goal]:
            if num_wanted:
                return COSTS_WANTED, size, num_wanted
            return BATCH_DONE, 0, num_costed
        node, target, cost = queue.origin[0], queue.target[0], queue.cost[0]
        _drop_top(queue, size)
        size -= 1
        if node == target:
            if nodes.state[node] == EXPANDED:
                continue
            most = queue.f.size - num_wanted
            new_size = _expand(nodes, queue, size, most, node, goal, buckets, radius, per_side)
            if new_size < 0:
                _push(queue, size, nodes.g[node] + nodes.to_goal[node], node, node, NOT_COSTED)
                if num_wanted:
                    return COSTS_WANTED, size + 1, num_wanted
                return QUEUE_FULL, size + 1, num_costed
            size = new_size
            continue
        g = nodes.g[node]
        if cost == NOT_COSTED:
            limit = min(nodes.best[target], nodes.best[goal] - nodes.to_goal[target]) - g
            if limit <= 0.0:
                continue
            if len(wanted):
                wanted[num_wanted, 0], wanted[num_wanted, 1] = node, target
                num_wanted += 1
                if num_wanted == len(wanted):
                    return COSTS_WANTED, size, num_wanted
                continue
            x, y = nodes.xy[node]
            cost = edge_cost(ground, x, y, nodes.xy[target, 0], nodes.xy[target, 1], limit)
            num_costed += 1
            if g + cost >= nodes.best[target]:
                continue
            nodes.best[target] = g + cost
            f = g + cost + nodes.to_goal[target]
            if size > 0 and f > queue.f[0]:
                _push(queue, size, f, node, target, cost)
                size += 1
                continue
        if g + cost >= nodes.g[target]:
            continue
        nodes.g[target] = g + cost
        nodes.best[target] = min(nodes.best[target], g + cost)
        nodes.parent[target] = node
        nodes.edge_cost[target] = cost
        if target != goal:
            nodes.state[target] = FRESH
            _push(queue, size, g + cost + nodes.to_goal[target], target, target, NOT_COSTED)
            size += 1
    if num_wanted:
        return COSTS_WANTED, size, num_wanted
    return PAUSED, size, num_costed


@njit(cache=True)
def put_back(nodes, queue, size, goal, edges, costs):
    """Queue edges ``[W, 2]`` that `advance` wanted costed, with their ``[W]`` costs; return the new size."""
    for k in range(len(edges)):
        node, target = edges[k]
        reach = nodes.g[node] + costs[k]
        f = reach + nodes.to_goal[target]
        if reach < nodes.best[target] and f < nodes.best[goal]:
            nodes.best[target] = reach
            _push(queue, size, f, node, target, costs[k])
            size += 1
    return size
