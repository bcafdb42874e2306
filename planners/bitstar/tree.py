"""The tree and the samples of BIT* between batches: pruning, new samples, and buckets for the next search."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from jaxurban.kernels.search.sample_graph import NO_PARENT
from jaxurban.planners.bitstar.bounds import Bounds
from jaxurban.planners.bitstar.search import OLD, SAMPLE, Buckets, TreeNodes

ROUNDING = 1 + 1e-12  # a node of the best path may seem that much too costly


@dataclass(frozen=True, eq=False)
class Tree:
    """Start, goal and samples with what the search has found. ``N`` nodes, start and goal among them.

    Attributes:
      xy: ``[N, 2]`` in cell sides.
      least_f: ``[N]`` lower bound of the cost of any path through a node.
      to_goal, row_at, col_at, enter: ``[N]`` parts of the bounds.
      g: ``[N]`` cost of the path through the tree, inf for a node that is not in it.
      parent: ``[N]`` int32, NO_PARENT for the start and for nodes outside the tree.
      edge_cost: ``[N]`` cost of the edge from the parent.
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

    @classmethod
    def of_samples(cls, xy: np.ndarray, bounds: Bounds) -> Self:
        """Return samples that nothing joins yet."""
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
        return replace(ends, g=np.array([0.0, np.inf]))

    def with_samples(self, xy: np.ndarray, bounds: Bounds) -> Self:
        """Return the tree with more samples behind its nodes."""
        more = type(self).of_samples(xy, bounds)
        return type(self)(*(np.concatenate([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self)))

    def taken(self, order: np.ndarray) -> Self:
        """Return the nodes in another order, or some of them; the parents of tree nodes must be among them."""
        place = np.full(len(self.xy), NO_PARENT, np.int32)
        place[order] = np.arange(len(order), dtype=np.int32)
        taken = {f.name: getattr(self, f.name)[order] for f in fields(self)}
        has_parent = taken["parent"] != NO_PARENT
        taken["parent"] = np.where(has_parent, place[taken["parent"]], NO_PARENT)
        return type(self)(**taken)

    def path(self, goal: int) -> np.ndarray:
        """Return the nodes of the tree's path to a node, the start first; none where it is not in the tree."""
        nodes = []
        node = goal
        while node != NO_PARENT and np.isfinite(self.g[goal]):
            nodes.append(node)
            node = int(self.parent[node])
        return np.array(nodes[::-1], np.int64)

    def path_cost(self, path: np.ndarray) -> float:
        """Return the cost of a path that `path` gave, inf for none; it may be below the last node's ``g``."""
        return float(np.cumsum(self.edge_cost[path])[-1]) if len(path) else np.inf

    def pruned(self, start: int, goal: int) -> tuple[Self, int, int]:
        """Return the tree without what cannot lie on a path cheaper than the goal's, and where start and goal are now.

        A node that might, but not by its way through the tree, becomes a sample again, and so do all
        that hang from it.
        """
        incumbent = self.g[goal]
        is_kept = self.least_f < incumbent
        in_tree = is_kept & np.isfinite(self.g) & (self.g + self.to_goal <= incumbent * ROUNDING)
        in_tree[self.path(goal)] = True
        in_tree[start] = True
        has_parent = self.parent != NO_PARENT
        while True:
            is_cut = in_tree & has_parent & ~in_tree[self.parent]
            if not is_cut.any():
                break
            in_tree[is_cut] = False
        is_kept |= in_tree
        is_kept[goal] = True
        cut = replace(
            self, g=np.where(in_tree, self.g, np.inf), parent=np.where(in_tree, self.parent, np.int32(NO_PARENT))
        )
        order = np.flatnonzero(is_kept)
        start, goal = (int(k) for k in np.searchsorted(order, [start, goal]))
        return cut.taken(order), start, goal

    def in_buckets(self, radius: float, start: int, goal: int) -> tuple[Self, int, int, Buckets]:
        """Return the tree sorted for the search, where start and goal are now, and the buckets."""
        low, high = self.xy.min(axis=0), self.xy.max(axis=0)
        extent = float((high - low).max()) + 1e-6
        side = max(min(radius, 2 * extent), extent / (2 * np.sqrt(len(self.xy)) + 1))
        num_cols, num_rows = ((high - low) / side).astype(np.int64) + 3
        buckets = Buckets(side, int(num_cols), int(num_cols * num_rows), float(low[0]), float(low[1]))
        order = np.argsort(buckets.of(self.xy) + np.where(np.isfinite(self.g), 0, buckets.num), kind="stable")
        start, goal = (int(np.flatnonzero(order == node)[0]) for node in (start, goal))
        return self.taken(order), start, goal, buckets

    def nodes(self, radius: float, buckets: Buckets) -> TreeNodes:
        """Return what the search works on, of a tree that `in_buckets` sorted."""
        is_tree = np.isfinite(self.g)
        num_tree = int(np.count_nonzero(is_tree))
        bucket = buckets.of(self.xy)
        squares = np.arange(buckets.num + 1)
        has_parent = np.flatnonzero(self.parent != NO_PARENT)
        length = np.hypot(*(self.xy[has_parent] - self.xy[self.parent[has_parent]]).T)
        long_child = has_parent[length > radius]
        long_child = long_child[np.argsort(self.parent[long_child], kind="stable")]
        return TreeNodes(
            **vars(self),
            best=self.g.copy(),
            state=np.where(is_tree, OLD, SAMPLE).astype(np.uint8),
            tree_begin=np.searchsorted(bucket[:num_tree], squares),
            sample_begin=np.searchsorted(bucket[num_tree:], squares) + num_tree,
            long_parent=self.parent[long_child],
            long_child=long_child.astype(np.int32),
        )
