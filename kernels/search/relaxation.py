"""Costs of nodes relaxed along many edges at once, until none falls: a shape for a CPU and one for a GPU.

By edges: a round hands costs on along all edges, a part of them after the other, so that later parts know what earlier
ones found. By nodes: a round is one kernel, in which every node takes the best of the edges that lead to it.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

NO_PARENT = -1
BY_TREE = -1  # in place of an edge's number: the parent in the tree given, or none
ROUNDS_TOGETHER = 24  # by nodes, between two looks whether a cost still falls
FROM_ITSELF, FROM_PARENT, FROM_EDGES = 0, 1, 2  # the ways to a node; edge k of a node is way FROM_EDGES + k


class Edges(NamedTuple):
    """Edges in a list with room for ``E``: in the first ``num`` places, what lies behind means nothing.

    Attributes:
      origin, target: ``[E]`` int32 nodes.
      cost: ``[E]`` float64, inf where no way leads along the edge.
      num: int32.
    """

    origin: Array
    target: Array
    cost: Array
    num: Array


class OfNode(NamedTuple):
    """Which edges lead to each of ``[N]`` nodes: ``num`` from edge ``first`` on, int32."""

    first: Array
    num: Array


class Tree(NamedTuple):
    """Cheapest paths to ``[N]`` nodes.

    Attributes:
      g: cost of the path, inf without one.
      parent: int32, `NO_PARENT` at starts and without a path.
      edge_cost: of the edge from the parent.
    """

    g: Array
    parent: Array
    edge_cost: Array


def relaxed_by_edges(edges: Edges, tree: Tree, edges_together: int) -> tuple[Tree, Array]:
    """Return the tree when no edge, nor the tree given, lowers a cost, and the rounds done.

    Each round looks at the edges of the tree given, then at all others, ``edges_together`` of them together. Parents
    change with a strictly lower cost only, so that they lead back to the start even where edges cost nothing.
    """
    is_child = tree.parent != NO_PARENT
    tree_parent = jnp.maximum(tree.parent, 0)
    tree_cost = jnp.where(is_child, tree.edge_cost, jnp.inf)

    def one_turn(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        g, reached_by, first = carry
        origin, target, cost = (lax.dynamic_slice_in_dim(values, first, edges_together) for values in edges[:3])
        edge = first + jnp.arange(edges_together, dtype=jnp.int32)
        reach = jnp.where(edge < edges.num, g[origin] + cost, jnp.inf)
        lowest = g.at[target].min(reach)
        is_better = (reach < g[target]) & (reach == lowest[target])
        reached_by = reached_by.at[jnp.where(is_better, target, g.size)].set(edge, mode="drop")
        return lowest, reached_by, first + edges_together

    def go_on(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        before, reached_by, _, num_rounds = carry
        along_tree = before[tree_parent] + tree_cost
        reached_by = jnp.where(along_tree < before, BY_TREE, reached_by)
        g = jnp.minimum(before, along_tree)
        g, reached_by, _ = lax.while_loop(lambda turn: turn[2] < edges.num, one_turn, (g, reached_by, jnp.int32(0)))
        return g, reached_by, jnp.any(g < before), num_rounds + 1

    to_begin = (tree.g, jnp.full(tree.g.size, BY_TREE, jnp.int32), jnp.array(True), jnp.int32(0))
    g, reached_by, _, num_rounds = lax.while_loop(lambda carry: carry[2], go_on, to_begin)
    return _tree_by(reached_by, g, tree, edges), num_rounds


def relaxed_by_nodes(edges: Edges, of_node: OfNode, tree: Tree, most_of_node: int) -> tuple[Tree, Array]:
    """Return what `relaxed_by_edges` does, but for the choice among equally cheap paths, after more rounds.

    All nodes change together, from what all were before, so that here too parents lead back to the start.

    Args:
      edges, tree: as there.
      of_node: where to find the edges.
      most_of_node: that lead to one node.
    """
    way = np.arange(FROM_EDGES + most_of_node, dtype=np.int32)
    edge = jnp.clip(of_node.first[:, None] + way - FROM_EDGES, 0, edges.cost.size - 1)
    node = jnp.arange(tree.g.size, dtype=jnp.int32)
    origin, cost = (
        jnp.where(way == FROM_ITSELF, itself[:, None], jnp.where(way == FROM_PARENT, given[:, None], of_edges[edge]))
        for itself, given, of_edges in (
            (node, jnp.maximum(tree.parent, 0), edges.origin),
            (jnp.zeros_like(tree.g), jnp.where(tree.parent == NO_PARENT, jnp.inf, tree.edge_cost), edges.cost),
        )
    )
    cost = jnp.where(way < FROM_EDGES + of_node.num[:, None], cost, jnp.inf)

    def cheaper(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[Array, Array]:
        is_one = (one[0] < other[0]) | ((one[0] == other[0]) & (one[1] < other[1]))
        return jnp.where(is_one, one[0], other[0]), jnp.where(is_one, one[1], other[1])

    no_way = jnp.float64(jnp.inf), jnp.int32(jnp.iinfo(jnp.int32).max)

    def one_round(g: Array, by: Array) -> tuple[Array, Array]:
        # Ways that lead to a lower cost are positive; the one that did before is negative, so that it wins a draw.
        ways = jnp.where(way == FROM_ITSELF, -jnp.abs(by)[:, None], way)
        return lax.reduce((g[origin] + cost, ways), no_way, cheaper, (1,))

    def go_on(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        g, by, _, num_rounds = carry
        for _ in range(ROUNDS_TOGETHER):
            g, by = one_round(g, by)
        return g, by, jnp.any(by > 0), num_rounds + ROUNDS_TOGETHER

    to_begin = (tree.g, jnp.full(tree.g.size, -FROM_PARENT, jnp.int32), jnp.array(True), jnp.int32(0))
    g, by, _, num_rounds = lax.while_loop(lambda carry: carry[2], go_on, to_begin)
    by = jnp.abs(by)
    reached_by = jnp.where(by == FROM_PARENT, BY_TREE, of_node.first + by - FROM_EDGES)
    return _tree_by(reached_by, g, tree, edges), num_rounds


def _tree_by(reached_by: Array, g: Array, tree: Tree, edges: Edges) -> Tree:
    """Return the tree whose nodes are reached by edges of these numbers, or as in the tree given."""
    is_by_tree = reached_by == BY_TREE
    edge = jnp.clip(reached_by, 0, edges.cost.size - 1)
    parent = jnp.where(is_by_tree, tree.parent, edges.origin[edge])
    return Tree(g, parent, jnp.where(is_by_tree, tree.edge_cost, edges.cost[edge]))
