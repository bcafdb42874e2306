"""The tree and the samples of BIT*: the compiled search that grows it over one batch, and what is done between two."""

from typing import Any, NamedTuple, Self

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.kernels.search.heap import (
    AS_HEAP,
    EXHAUSTED,
    FULL,
    NO_PARENT,
    PAUSED,
    drop_top,
    place,
)
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.planners.base import way_to
from jaxurban.planners.bitstar.bounds import Bounds

SAMPLE, OLD, FRESH, EXPANDED = 0, 1, 2, 3  # a node's state; all but SAMPLE are in the tree
NOT_COSTED = -1.0  # a queued edge whose cost is not known yet
# An edge in the queue: two nodes, and its cost or NOT_COSTED. One from a node to itself stands for the expansion of
# that node, the paper's vertex queue. Edges are ordered by the least cost of a solution through them.
EDGE = np.dtype([("origin", np.int32), ("target", np.int32), ("cost", np.float64)])
# A tree's arrays; the rest is of one search.
LASTING = ("xy", "least_f", "to_goal", "row_at", "col_at", "enter", "g", "parent", "edge_cost")
NONE = np.empty(0, np.int64)


class BatchGraph(NamedTuple):
    """The random geometric graph of one batch, and squares that hold its nodes, with a frame of empty ones; cell sides.

    Attributes:
      radius: nodes this near each other are joined.
      per_side: lower bound of an edge's cost per cell side.
      side: of a square, no less than the radius.
      num_cols: squares in a row, the frame's two among them.
      num: all squares.
      x, y: southwest corner of the squares within the frame.
    """

    radius: float
    per_side: float
    side: float
    num_cols: int
    num: int
    x: float
    y: float

    @classmethod
    def of(cls, xy: np.ndarray, radius: float, per_side: float) -> Self:
        """Return the graph of nodes ``[N, 2]``, in cell sides.

        A square's side is the radius (twice the nodes' extent at most), or more, so that there are at most about four
        times as many squares as nodes.
        """
        low, high = xy.min(axis=0), xy.max(axis=0)
        extent = float((high - low).max()) + 1e-6
        side = max(min(radius, 2 * extent), extent / (2 * np.sqrt(len(xy)) + 1))
        num_cols, num_rows = (((high - low) / side).astype(np.int64) + 3).tolist()
        return cls(radius, per_side, side, num_cols, num_cols * num_rows, *low.tolist())

    def bucket_of(self, xy: np.ndarray) -> np.ndarray:
        """Return ``[N]`` the square of points that lie within the frame."""
        col, row = ((xy - (self.x, self.y)) / self.side).astype(np.int64).T + 1
        return row * self.num_cols + col


class Tree(NamedTuple):
    """Start, goal and samples with what the search has found. ``N`` nodes, start and goal among them.

    For a search (`ready`) the nodes of the tree come before those that are only samples, and within each of the two
    groups they are sorted by square bucket, row by row, so that ``tree_begin[b]:tree_begin[b + 1]`` are the tree's
    nodes of bucket b (and ``sample_begin`` the rest).

    Attributes:
      xy: ``[N, 2]`` float64 in cell sides.
      least_f: ``[N]`` lower bound of the cost of any path through a node.
      to_goal: ``[N]`` lower bound of the cost to the goal.
      row_at, col_at, enter: ``[N]`` parts of an edge's lower bound (see `bitstar.bounds.Bounds`).
      g: ``[N]`` cost of the path through the tree, inf for a node that is not in it. Never too low; in a search it may
        be too high for a node below one that was improved last, until the improvement reaches it.
      parent: ``[N]`` int32, NO_PARENT for the start and for nodes outside the tree.
      edge_cost: ``[N]`` cost of the edge from the parent.
      start, goal: their nodes.
      best: ``[N]`` the lowest cost of reaching a node found in this batch, queued edges included.
      state: ``[N]`` uint8, one of SAMPLE, OLD, FRESH, EXPANDED.
      tree_begin, sample_begin: ``[B + 1]`` first node of each bucket.
      long_child: ``[K]`` children by tree edges longer than the radius, sorted by parent; ``long_begin`` ``[N + 1]``
        where those of each node begin.
    """

    xy: np.ndarray
    least_f: np.ndarray
    to_goal: np.ndarray
    row_at: np.ndarray
    col_at: np.ndarray
    enter: np.ndarray
    g: np.ndarray
    parent: np.ndarray
    edge_cost: np.ndarray
    start: int = 0
    goal: int = 1
    best: np.ndarray = NONE
    state: np.ndarray = NONE
    tree_begin: np.ndarray = NONE
    sample_begin: np.ndarray = NONE
    long_begin: np.ndarray = NONE
    long_child: np.ndarray = NONE

    @classmethod
    def of_samples(cls, xy: np.ndarray, bounds: Bounds) -> Self:
        """Return samples ``[N, 2]`` of free cells with their bounds, none of them in a tree yet."""
        from_start, to_goal = bounds.from_start_and_to_goal(xy)
        return cls(
            xy,
            from_start + to_goal,
            to_goal,
            *bounds.edge_parts(xy),
            g=np.full(len(xy), np.inf),
            parent=np.full(len(xy), NO_PARENT, np.int32),
            edge_cost=np.zeros(len(xy)),
        )

    @classmethod
    def of_ends(cls, bounds: Bounds) -> Self:
        """Return a tree of the start alone, node 0, and the goal, node 1, that is a sample yet."""
        ends = cls.of_samples(np.stack([bounds.start, bounds.goal]), bounds)
        return ends._replace(g=np.array([0.0, np.inf]))

    def with_samples(self, xy: np.ndarray, bounds: Bounds) -> Self:
        """Return the tree with more samples behind its nodes."""
        more = type(self).of_samples(xy, bounds)
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(each, name) for each in (self, more)]) for name in LASTING
        }
        return self._replace(**arrays)

    def taken(self, order: np.ndarray) -> Self:
        """Return some of the nodes, in a given order.

        Args:
          order: ``[M]`` numbers of the nodes; start, goal, and the parents of tree nodes must be among them.
        """
        # The new number of each node, by which the parents are named.
        number = np.full(len(self.xy), NO_PARENT, np.int32)
        number[order] = np.arange(len(order), dtype=np.int32)
        arrays: dict[str, Any] = {name: getattr(self, name)[order] for name in LASTING}
        taken = self._replace(**arrays, start=int(number[self.start]), goal=int(number[self.goal]))
        return taken._replace(
            parent=np.where(taken.parent != NO_PARENT, number[taken.parent], NO_PARENT)
        )

    def path(self) -> np.ndarray:
        """Return the nodes of the tree's path to the goal, the start first; none where it is not in the tree."""
        is_there = np.isfinite(self.g[self.goal])
        return np.array(way_to(self.goal, self.parent) if is_there else [], np.int64)

    def path_cost(self, path: np.ndarray) -> float:
        """Return the cost of a path that `path` gave, inf for none; it may be below the last node's ``g``."""
        return float(np.cumsum(self.edge_cost[path])[-1]) if len(path) else np.inf

    def pruned(self) -> Self:
        """Return the tree without what cannot lie on a path cheaper than the goal's.

        A node that might lie on a cheaper path, but not by its way through the tree, becomes a sample again, and so do
        all nodes below it in the tree.
        """
        incumbent = self.g[self.goal]
        is_kept = self.least_f < incumbent
        in_tree = is_kept & np.isfinite(self.g) & (self.g + self.to_goal <= incumbent * SAME_COST)
        in_tree[self.path()] = True
        in_tree[self.start] = True
        has_parent = self.parent != NO_PARENT

        # Cut off the children of nodes that left the tree, generation by generation.
        while True:
            is_cut = in_tree & has_parent & ~in_tree[self.parent]
            if not is_cut.any():
                break
            in_tree[is_cut] = False

        is_kept |= in_tree
        is_kept[self.goal] = True
        cut = self._replace(
            g=np.where(in_tree, self.g, np.inf),
            parent=np.where(in_tree, self.parent, np.int32(NO_PARENT)),
        )
        return cut.taken(np.flatnonzero(is_kept))

    def ready(self, graph: BatchGraph) -> Self:
        """Return the tree sorted for a search of its graph, with the arrays that only a search needs.

        Nodes of the tree, whose ``g`` is finite, come first, and then samples, either by their squares in the graph.
        The arrays are those from ``best`` on (see `Tree`): the costs before the search, the states before it, and where
        to look for the nodes near a node and for its children beyond the radius.
        """
        # Sort; samples count as if they lay in squares beyond the last one.
        squares_before = np.where(np.isfinite(self.g), 0, graph.num)
        tree = self.taken(np.argsort(graph.bucket_of(self.xy) + squares_before, kind="stable"))

        is_tree = np.isfinite(tree.g)
        num_tree = np.count_nonzero(is_tree)
        bucket = graph.bucket_of(tree.xy)
        squares = np.arange(graph.num + 1)

        # Edges of the tree that are longer than the radius, by their children, sorted by parent.
        child = np.flatnonzero(tree.parent != NO_PARENT)
        length = np.hypot(*(tree.xy[child] - tree.xy[tree.parent[child]]).T)
        far_child = child[length > graph.radius]
        long_child = far_child[np.argsort(tree.parent[far_child], kind="stable")]
        return tree._replace(
            best=tree.g.copy(),
            state=np.where(is_tree, OLD, SAMPLE).astype(np.uint8),
            tree_begin=np.searchsorted(bucket[:num_tree], squares),
            sample_begin=np.searchsorted(bucket[num_tree:], squares) + num_tree,
            long_begin=np.searchsorted(tree.parent[long_child], np.arange(len(bucket) + 1)),
            long_child=long_child.astype(np.int32),
        )


@compiled()
def _push(queue, f, origin, target, cost):
    """Put an edge into a queue that has room."""
    edge = queue.item[place(queue, f, AS_HEAP)]
    edge.origin = origin
    edge.target = target
    edge.cost = cost


@compiled()
def _num_near(begin, num_cols, bucket):
    """Return how many nodes lie in a square bucket and its eight neighbours.

    Args:
      begin: ``[B + 1]`` first node of each bucket; three buckets in a row hold nodes that follow each other.
      num_cols: buckets in a row.
      bucket: not in the frame of empty buckets.
    """
    count = 0
    for middle in (bucket - num_cols, bucket, bucket + num_cols):
        count += begin[middle + 2] - begin[middle - 1]
    return count


@compiled()
def _queue_edges(nodes, queue, graph, node, begin, bucket):
    """Queue the edges from a node to the nodes within the radius that they may improve, each by its lower bound.

    Args:
      nodes: `Tree`, ready for the search.
      queue: a `Heap` of EDGE with room; altered.
      graph: `BatchGraph`.
      node: where the edges begin.
      begin: ``tree_begin`` or ``sample_begin``: edges to the tree's nodes, or to samples.
      bucket: of the node.
    """
    x, y = nodes.xy[node]
    g = nodes.g[node]
    incumbent = nodes.best[nodes.goal]
    row_at, col_at = nodes.row_at[node], nodes.col_at[node]
    num_cols = graph.num_cols
    for middle in (bucket - num_cols, bucket, bucket + num_cols):
        for near in range(begin[middle - 1], begin[middle + 2]):
            dx, dy = nodes.xy[near, 0] - x, nodes.xy[near, 1] - y
            square = dx * dx + dy * dy
            if square > graph.radius * graph.radius or near == node:
                continue
            # At least this much costs a path to the node near, and one on to the goal.
            map_part = max(abs(nodes.row_at[near] - row_at), abs(nodes.col_at[near] - col_at))
            reach = g + graph.per_side * np.sqrt(square) + nodes.enter[near] + map_part
            f = reach + nodes.to_goal[near]
            if reach < nodes.best[near] and f < incumbent:
                _push(queue, f, node, np.int32(near), NOT_COSTED)


@compiled()
def _expand(nodes, queue, graph, node, most):
    """Queue the edges that lead on from a node, and return True; return False, with nothing done, for want of room.

    A node known from earlier batches has edges to samples only, since its edges to the tree were weighed before. A
    node that is new or was improved (FRESH) has edges to both, and to its children that lie beyond the radius.

    Args:
      nodes: `Tree`, ready for the search; altered: the node becomes EXPANDED.
      queue: a `Heap` of EDGE; altered.
      graph: `BatchGraph`.
      node: number of the node.
      most: entries that the queue has room for.
    """
    x, y = nodes.xy[node]
    row = int((y - graph.y) / graph.side) + 1  # as `BatchGraph.bucket_of`
    col = int((x - graph.x) / graph.side) + 1
    bucket = row * graph.num_cols + col

    # Room for all nodes near, more than the edges that will be queued.
    is_fresh = nodes.state[node] == FRESH
    num_most = _num_near(nodes.sample_begin, graph.num_cols, bucket)
    if is_fresh:
        num_most += _num_near(nodes.tree_begin, graph.num_cols, bucket) + nodes.long_child.size
    if queue.size[0] + num_most > most:
        return False

    nodes.state[node] = EXPANDED
    _queue_edges(nodes, queue, graph, node, nodes.sample_begin, bucket)
    if not is_fresh:
        return True
    _queue_edges(nodes, queue, graph, node, nodes.tree_begin, bucket)

    # Its children beyond the radius, by tree edges whose costs are known.
    for k in range(nodes.long_begin[node], nodes.long_begin[node + 1]):
        child = nodes.long_child[k]
        reach = nodes.g[node] + nodes.edge_cost[child]
        if nodes.parent[child] == node and reach < nodes.best[child]:
            nodes.best[child] = reach
            _push(queue, reach + nodes.to_goal[child], node, child, nodes.edge_cost[child])
    return True


@compiled()
def take_edges(cost_grid, nodes, queue, graph, max_taken):
    """Take edges from the queue until none can improve the solution, or ``max_taken`` entries are done.

    An edge is queued by its lower bound and costed when it comes first. If its true cost no longer puts it first,
    it goes back into the queue with that cost. So the tree grows in order of cost, as that of A* would. A node that
    was improved is expanded again, which brings the improvement to all nodes below it. Equal entries
    come in an order that only the nodes decide, so runs repeat.

    Args:
      cost_grid: `CostGrid`, the map.
      nodes: `Tree`, ready for the search; altered.
      queue: a `Heap` of EDGE; altered.
      graph: `BatchGraph`.
      max_taken: entries to take from the queue.

    Returns:
      How the chunk ended (EXHAUSTED: the batch is done; FULL: the queue lacks room; PAUSED), and the edges costed.
    """
    num_costed = 0
    goal = nodes.goal
    for _ in range(max_taken):
        if queue.size[0] == 0 or queue.f[0] >= nodes.g[goal]:
            return EXHAUSTED, num_costed

        edge = queue.item[0]
        node, target, cost = edge.origin, edge.target, edge.cost
        drop_top(queue)

        # An edge from a node to itself stands for the node's expansion; without room it goes back.
        if node == target:
            if nodes.state[node] == EXPANDED:
                continue
            if not _expand(nodes, queue, graph, node, queue.f.size):
                _push(queue, nodes.g[node] + nodes.to_goal[node], node, node, NOT_COSTED)
                return FULL, num_costed
            continue

        # Cost an edge if it may still improve its end and the solution; it waits if another entry comes before it now.
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

        # Join the target to the tree by the edge, if that improves it, and have it expanded; the goal leads nowhere.
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
