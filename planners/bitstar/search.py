"""The compiled search of BIT*: the queue that grows the tree over one batch."""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.kernels.search.heap import EXHAUSTED, FULL, PAUSED, drop_top, place

SAMPLE, OLD, FRESH, EXPANDED = 0, 1, 2, 3  # a node's state; all but SAMPLE are in the tree
NOT_COSTED = -1.0  # a queued edge whose cost is not known yet
# An edge in the queue: two nodes, and its cost or NOT_COSTED. One from a node to itself stands for the expansion of
# that node, the paper's vertex queue. Edges are ordered by the least cost of a solution through them.
EDGE = np.dtype([("origin", np.int32), ("target", np.int32), ("cost", np.float64)])


class TreeNodes(NamedTuple):
    """Tree and samples of one batch: ``N`` nodes, those of the tree before those that are only samples.

    Within each of the two groups the nodes are sorted by square bucket, row by row, so that
    ``tree_begin[b]:tree_begin[b + 1]`` are the tree's nodes of bucket b (and ``sample_begin`` the rest).

    Attributes:
      xy: ``[N, 2]`` float64 in cell sides.
      least_f: ``[N]`` lower bound of the cost of any path through a node.
      to_goal: ``[N]`` lower bound of the cost to the goal.
      row_at, col_at, enter: ``[N]`` parts of an edge's lower bound (see `bitstar.bounds.Bounds`).
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
    least_f: np.ndarray
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


class Buckets(NamedTuple):
    """Squares that hold the nodes, with a frame of empty ones; cell sides.

    Attributes:
      side: no less than the radius.
      num_cols: squares in a row, the frame's two among them.
      num: all squares.
      x, y: southwest corner of the squares within the frame.
    """

    side: float
    num_cols: int
    num: int
    x: float
    y: float

    def of(self, xy: np.ndarray) -> np.ndarray:
        """Return ``[N]`` the square of points that lie within the frame."""
        col, row = ((xy - (self.x, self.y)) / self.side).astype(np.int64).T + 1
        return row * self.num_cols + col


class BatchGraph(NamedTuple):
    """The random geometric graph of one batch.

    Attributes:
      goal: the goal's node.
      radius: nodes this near each other are joined, in cell sides.
      per_side: lower bound of an edge's cost per cell side.
      buckets: where nodes are looked up.
    """

    goal: int
    radius: float
    per_side: float
    buckets: Buckets


@compiled()
def _push(queue, f, origin, target, cost):
    """Put an edge into a queue that has room."""
    edge = queue.item[place(queue, f)]
    edge.origin = origin
    edge.target = target
    edge.cost = cost


@compiled()
def _num_near(begin, num_cols, bucket):
    """Return how many nodes lie in a bucket and its eight neighbours; buckets have a frame of empty ones."""
    count = 0
    for low in (bucket - num_cols, bucket, bucket + num_cols):
        count += begin[low + 2] - begin[low - 1]
    return count


@compiled()
def _queue_edges(nodes, queue, graph, node, begin, bucket):
    """Queue the edges from a node to those within the radius that they may improve."""
    x, y = nodes.xy[node]
    g, incumbent = nodes.g[node], nodes.best[graph.goal]
    row_at, col_at = nodes.row_at[node], nodes.col_at[node]
    num_cols = graph.buckets.num_cols
    for low in (bucket - num_cols, bucket, bucket + num_cols):
        for near in range(begin[low - 1], begin[low + 2]):
            dx, dy = nodes.xy[near, 0] - x, nodes.xy[near, 1] - y
            square = dx * dx + dy * dy
            if square > graph.radius * graph.radius or near == node:
                continue
            map_part = max(abs(nodes.row_at[near] - row_at), abs(nodes.col_at[near] - col_at))
            reach = g + graph.per_side * np.sqrt(square) + nodes.enter[near] + map_part
            f = reach + nodes.to_goal[near]
            if reach < nodes.best[near] and f < incumbent:
                _push(queue, f, node, near, NOT_COSTED)


@compiled()
def _expand(nodes, queue, graph, node, most):
    """Queue what a node leads to; return whether it was, nothing being done where the queue would pass ``most``.

    A node known from earlier batches leads to samples only: its edges to the tree were weighed before. A
    node that is new or was improved leads to both, and to its children that lie beyond the radius.
    """
    x, y = nodes.xy[node]
    buckets = graph.buckets
    bucket = (int((y - buckets.y) / buckets.side) + 1) * buckets.num_cols + int((x - buckets.x) / buckets.side) + 1
    is_fresh = nodes.state[node] == FRESH
    num_most = _num_near(nodes.sample_begin, buckets.num_cols, bucket)
    if is_fresh:
        num_most += _num_near(nodes.tree_begin, buckets.num_cols, bucket) + nodes.long_child.size
    if queue.size[0] + num_most > most:
        return False
    nodes.state[node] = EXPANDED
    _queue_edges(nodes, queue, graph, node, nodes.sample_begin, bucket)
    if not is_fresh:
        return True
    _queue_edges(nodes, queue, graph, node, nodes.tree_begin, bucket)
    k = np.searchsorted(nodes.long_parent, node)
    while k < nodes.long_parent.size and nodes.long_parent[k] == node:
        child = nodes.long_child[k]
        reach = nodes.g[node] + nodes.edge_cost[child]
        if nodes.parent[child] == node and reach < nodes.best[child]:
            nodes.best[child] = reach
            _push(queue, reach + nodes.to_goal[child], node, child, nodes.edge_cost[child])
        k += 1
    return True


@compiled()
def advance(cost_grid, nodes, queue, graph, max_taken):
    """Take edges from the queue until none can improve the solution, or ``max_taken`` entries are done.

    An edge is queued by its lower bound and costed when it comes first; where its true cost no longer
    puts it first, it goes back with that. So the tree grows in order of cost, as A*'s would. A node that
    was improved is expanded again, which brings the improvement to all that hangs from it. Equal entries
    come in an order that only the nodes decide, so runs repeat.

    Args:
      cost_grid, nodes, graph: see there; nodes are altered.
      queue: a `Heap` of EDGE; altered.
      max_taken: entries of the queue.

    Returns: how the chunk ended (EXHAUSTED: the batch is done), and the edges costed.
    """
    num_costed = 0
    goal = graph.goal
    for _ in range(max_taken):
        if queue.size[0] == 0 or queue.f[0] >= nodes.g[goal]:
            return EXHAUSTED, num_costed
        edge = queue.item[0]
        node, target, cost = edge.origin, edge.target, edge.cost
        drop_top(queue)
        if node == target:
            if nodes.state[node] == EXPANDED:
                continue
            if not _expand(nodes, queue, graph, node, queue.f.size):
                _push(queue, nodes.g[node] + nodes.to_goal[node], node, node, NOT_COSTED)
                return FULL, num_costed
            continue
        g = nodes.g[node]
        if cost == NOT_COSTED:
            limit = min(nodes.best[target], nodes.best[goal] - nodes.to_goal[target]) - g
            if limit <= 0.0:
                continue
            x, y = nodes.xy[node]
            cost = segment_cost(cost_grid, x, y, nodes.xy[target, 0], nodes.xy[target, 1], limit)
            num_costed += 1
            if g + cost >= nodes.best[target]:
                continue
            nodes.best[target] = g + cost
            f = g + cost + nodes.to_goal[target]
            if queue.size[0] > 0 and f > queue.f[0]:
                _push(queue, f, node, target, cost)
                continue
        if g + cost >= nodes.g[target]:
            continue
        nodes.g[target] = g + cost
        nodes.best[target] = min(nodes.best[target], g + cost)
        nodes.parent[target] = node
        nodes.edge_cost[target] = cost
        if target != goal:
            nodes.state[target] = FRESH
            _push(queue, g + cost + nodes.to_goal[target], target, target, NOT_COSTED)
    return PAUSED, num_costed
