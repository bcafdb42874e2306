"""Random geometric graphs searched in bulk: neighbours, edge costs and relaxation over all samples at once.

The samples of many queries are one graph of many parts, since nodes are joined to those of their own query only. So one
call serves queries of any sizes and stages, and its shapes depend on nothing but the number of all their nodes.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxurban.kernels.line.segment_costs import segment_costs
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.programs import kept_jit

NO_QUERY = -1
BY_TREE = -1  # in place of an edge's number: the parent in the tree given, or none
MOST_SQUARES = 1 << 12  # along a side of the map, so that a square's number fits beside its query's
SQUARES_OF_A_QUERY = 1 << 26


class Samples(NamedTuple):
    """Nodes of all queries: starts, goals and samples, those of no query (`NO_QUERY`) last. ``N`` nodes, in cell sides.

    No path from the start reaches a node for less than ``from_start``, nor the goal from there for less than
    ``to_goal``; an edge costs at least ``least_per_side`` times its length, ``enter`` of its end, and the larger of the
    differences of ``row_at`` and ``col_at`` (see `planners.bitstar.bounds.Bounds`).

    Attributes:
      query: ``[N]`` int32.
      xy: ``[N, 2]`` float64, off the borders of cells.
      radius: ``[N]`` nodes of a query this near each other are joined; the same for all of a query.
      incumbent: ``[N]`` cost of the query's best path, inf without one: edges that cannot lead to a cheaper one are
        left out.
      least_per_side, from_start, to_goal, row_at, col_at, enter: ``[N]`` the bounds.
      g: ``[N]`` cost of the path through the query's tree, 0 at the start, inf outside the tree.
      parent: ``[N]`` int32, `NO_PARENT` at the start and outside the tree.
      edge_cost: ``[N]`` cost of the edge from the parent.
    """

    query: Array
    xy: Array
    radius: Array
    incumbent: Array
    least_per_side: Array
    from_start: Array
    to_goal: Array
    row_at: Array
    col_at: Array
    enter: Array
    g: Array
    parent: Array
    edge_cost: Array


class Sizes(NamedTuple):
    """Room in the arrays of a search, and how much is done in one turn; each choice compiles again. ``N`` nodes.

    Attributes:
      candidates: nodes that the nine squares around a node may hold.
      edges: edges in the mean of all ``N``.
      nodes_together, edges_together: of one turn; they divide ``N``, and ``edges * N``.
    """

    candidates: int
    edges: int
    nodes_together: int
    edges_together: int


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


class Trees(NamedTuple):
    """What a search found. ``N`` nodes.

    Attributes:
      g, parent, edge_cost: ``[N]`` as in `Samples`; where ``most_candidates`` or ``num_edges`` are more than there is
        room for, they are what was given.
      num_costed: ``[N]`` int32 edges to each node whose cost was computed.
      most_candidates, num_edges: the room that would do (``num_edges`` is known only where candidates have room).
    """

    g: Array
    parent: Array
    edge_cost: Array
    num_costed: Array
    most_candidates: Array
    num_edges: Array


@partial(kept_jit, static_argnames=("is_line", "sizes"))
def search_samples(
    samples: Samples,
    cell_cost: Array,
    per_side: float | Array,
    passes_corners: bool | Array,
    *,
    is_line: bool,
    sizes: Sizes,
) -> Trees:
    """Return the cheapest paths from every query's start over its random geometric graph and the tree in ``samples``.

    All pairs of nodes within the radius are joined, but for edges whose lower bound proves that they cannot lead to a
    path cheaper than the query's best. Each edge is costed by `segment_costs`, in both directions. Costs are relaxed,
    all nodes together, until none falls, so that the goal's ``g`` is that of Dijkstra's search, or the tree's if lower.

    Call it under ``jax.enable_x64(True)``.

    Args:
      samples: the nodes.
      cell_cost, per_side, passes_corners, is_line: the map of all queries, as in `segment_costs`.
      sizes: room in the arrays. If it is too little, nothing is searched, and the result says what would do.
    """
    # Sort nodes by square, so that the nodes of neighbouring squares are next to each other in memory.
    order = jnp.argsort(_squares(samples, cell_cost.shape)[0]).astype(jnp.int32)
    place = jnp.zeros_like(order).at[order].set(jnp.arange(order.size, dtype=jnp.int32))

    def renumbered(parent: Array, number: Array) -> Array:
        """Return parents by their new numbers; no parent stays none."""
        return jnp.where(parent == NO_PARENT, NO_PARENT, number[jnp.maximum(parent, 0)])

    ordered = Samples(*(values[order] for values in samples))
    ordered = ordered._replace(parent=renumbered(ordered.parent, place))

    # Find the edges, cost them and relax; with too little room for them there are none.
    edges, num_of_node, most_candidates = neighbours(ordered, cell_cost.shape, sizes)
    num_edges = edges.num
    edges = edges._replace(num=jnp.where(num_edges <= edges.cost.size, num_edges, 0))
    edges = costed(
        edges, ordered, cell_cost, per_side, passes_corners, is_line=is_line, sizes=sizes
    )
    g, parent, edge_cost = relaxed(edges, ordered, sizes.edges_together)

    # Back to the order in which nodes were given.
    return Trees(
        g[place],
        renumbered(parent[place], order),
        edge_cost[place],
        num_of_node[place],
        most_candidates,
        num_edges,
    )


def _squares(samples: Samples, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return ``[N]`` int64 the number of the square that holds each node, and ``[N]`` how many squares a row has.

    Numbers ascend by query, then row, then column; a node of no query has the largest. A square's side is the query's
    radius, within limits, and a frame of empty squares surrounds the map, so that the squares at the end of a row and
    at the beginning of the next one, or of the next query, are never taken for neighbours.

    Args:
      samples: the nodes.
      shape: rows and columns of the map.
    """
    longest = float(max(shape))  # of the map's sides, in cell sides
    side = jnp.clip(samples.radius, longest / MOST_SQUARES, longest)
    num_cols = (longest / side).astype(jnp.int64) + 3  # one begun, and the frame's two
    col, row = (jnp.floor(samples.xy / side[:, None]).astype(jnp.int64) + 1).T  # 0 is the frame
    square = samples.query.astype(jnp.int64) * SQUARES_OF_A_QUERY + row * num_cols + col
    behind_all = jnp.iinfo(jnp.int64).max
    return jnp.where(samples.query == NO_QUERY, behind_all, square), num_cols


def neighbours(
    samples: Samples, shape: tuple[int, ...], sizes: Sizes
) -> tuple[Edges, Array, Array]:
    """Return the edges between nodes within the radius, still without costs.

    An edge is kept if by its lower bound it may lower the cost of its end and lead to a cheaper path of the query.

    Args:
      samples: the nodes, sorted by square.
      shape: rows and columns of the map.
      sizes: room in the arrays.

    Returns:
      The edges, whose ``num`` is larger than their arrays if these lack room; ``[N]`` int32 how many edges lead to each
      node; and the most candidates that a node has. If that is above ``sizes.candidates``, there are no edges.
    """
    # Candidates of a node: the nodes in its own square and the eight around, three squares in each of three rows. As
    # nodes are sorted, each row of three is a range of nodes, from `begin` to `end`, ``[N, 3]``.
    square, num_cols = _squares(samples, shape)
    west = square[:, None] + num_cols[:, None] * jnp.arange(-1, 2)[None] - 1
    # Unrolled, as the loop would be one launch a step.
    position = partial(jnp.searchsorted, square, method="scan_unrolled")
    begin = position(west)
    end = position(west + 2, side="right")

    # Candidates get slots, 0 and up, through the three rows; `ends` are the slots at which the rows end.
    is_node = samples.query != NO_QUERY
    ends = jnp.cumsum(jnp.where(is_node[:, None], end - begin, 0), axis=1).astype(jnp.int32)
    # Less the slots before a row, so that the candidate in slot k of row r is node begin[r] + k.
    begin = begin.astype(jnp.int32).at[:, 1:].add(-ends[:, :2])

    # Without room for the candidates of one node all have none.
    most_candidates = ends[:, 2].max()
    ends = jnp.where(most_candidates <= sizes.candidates, ends, 0)
    num_nodes = jnp.sum(ends[:, 2] > 0)
    slot = jnp.arange(sizes.candidates, dtype=jnp.int32)[None]
    num_places = sizes.edges * square.size

    def turn(carry: tuple[Edges, Array, Array]) -> tuple[Edges, Array, Array]:
        """Add the edges that lead to the next T = ``nodes_together`` nodes, behind the edges in the list.

        The carry is the edges, the number of edges to each node, and the first of these nodes. Arrays are ``[T, C]``:
        a node's row holds its ``C`` slots for candidates.
        """
        edges, num_of_node, first = carry

        def here(values: Array) -> Array:
            """Return the values of these nodes, ``[T, 1]`` or ``[T, 1, 3]``, which broadcast over slots."""
            return lax.dynamic_slice_in_dim(values, first, sizes.nodes_together)[:, None]

        # The candidate in each slot: the south row of squares first, then the middle one, then the north. Columns of
        # `last` and `start`, ``[T, 3]``, are these three.
        last = here(ends)[:, 0]
        start = here(begin)[:, 0]
        start_of_slot = jnp.where(slot < last[:, 1:2], start[:, 1:2], start[:, 2:])
        origin = slot + jnp.where(slot < last[:, :1], start[:, :1], start_of_slot)
        is_edge = slot < last[:, 2:]
        origin = jnp.where(is_edge, origin, 0)
        node = jnp.broadcast_to(
            first + jnp.arange(sizes.nodes_together, dtype=jnp.int32)[:, None], origin.shape
        )

        # Lower bound of the cost of a path from the start over the edge to its end (see `Samples`).
        dx = samples.xy[origin, 0] - here(samples.xy[:, 0])
        dy = samples.xy[origin, 1] - here(samples.xy[:, 1])
        distance = jnp.sqrt(dx * dx + dy * dy)
        map_part = jnp.maximum(
            jnp.abs(samples.row_at[origin] - here(samples.row_at)),
            jnp.abs(samples.col_at[origin] - here(samples.col_at)),
        )
        reach = (
            samples.from_start[origin]
            + here(samples.least_per_side) * distance
            + here(samples.enter)
            + map_part
        )

        # Keep edges within the radius that may lower the cost of their end, and of the query's path.
        is_edge &= (distance <= here(samples.radius)) & (origin != node)
        is_edge &= (reach < here(samples.g)) & (
            reach + here(samples.to_goal) < here(samples.incumbent)
        )

        # Write the edges kept one after the other. The edges of a node end before `behind` in the list, and begin as
        # many places before; `place` is where each edge goes, by how many are kept before it in its row.
        num_here = jnp.sum(is_edge, axis=1, dtype=jnp.int32)
        behind = edges.num + jnp.cumsum(num_here)
        place = (behind - num_here)[:, None] + jnp.cumsum(is_edge, axis=1, dtype=jnp.int32) - 1
        place = jnp.where(is_edge, place, num_places)  # out of bounds, hence dropped
        edges = edges._replace(
            origin=edges.origin.at[place].set(origin, mode="drop"),
            target=edges.target.at[place].set(node, mode="drop"),
            num=behind[-1],
        )
        num_of_node = lax.dynamic_update_slice_in_dim(num_of_node, num_here, first, 0)
        return edges, num_of_node, first + sizes.nodes_together

    # Turn after turn, until all nodes with candidates are done: these come first, as nodes of no query are last.
    nowhere = jnp.zeros(num_places, jnp.int32)
    edges = Edges(nowhere, nowhere, jnp.zeros(num_places), jnp.int32(0))
    carry = (edges, jnp.zeros(square.size, jnp.int32), jnp.int32(0))
    edges, num_of_node, _ = _in_turns(turn, carry, num_nodes, square.size // sizes.nodes_together)
    return edges, num_of_node, most_candidates


def costed(
    edges: Edges,
    samples: Samples,
    cell_cost: Array,
    per_side: float | Array,
    passes_corners: bool | Array,
    *,
    is_line: bool,
    sizes: Sizes,
) -> Edges:
    """Return the edges that may still help when their costs are known, with these costs.

    An edge helps if it may lower the cost of its end and lead to a cheaper path of the query.

    Args:
      edges: from `neighbours`.
      samples: the nodes.
      cell_cost, per_side, passes_corners, is_line: as in `segment_costs`.
      sizes: how many edges are costed together.
    """
    num_places = edges.cost.size

    def turn(carry: tuple[Edges, Array]) -> tuple[Edges, Array]:
        """Cost the next few edges, and move the edges that are kept to the front of the list, in their order.

        The carry is the list, whose ``num`` counts the edges kept, and the first edge that is not costed yet.
        """
        kept, first = carry
        is_edge = first + jnp.arange(sizes.edges_together, dtype=jnp.int32) < edges.num

        def here(nodes: Array) -> Array:
            """Return the nodes of these edges, 0 behind the last edge."""
            return jnp.where(
                is_edge, lax.dynamic_slice_in_dim(nodes, first, sizes.edges_together), 0
            )

        origin = here(kept.origin)
        target = here(kept.target)
        start = samples.xy[origin]
        end = samples.xy[target]
        cost = segment_costs(cell_cost, start, end, per_side, passes_corners, is_line=is_line)
        reach = samples.from_start[origin] + cost
        is_kept = (
            is_edge
            & (reach < samples.g[target])
            & (reach + samples.to_goal[target] < samples.incumbent[target])
        )
        behind = kept.num + jnp.cumsum(is_kept, dtype=jnp.int32)
        place = jnp.where(is_kept, behind - 1, num_places)  # at or before the edge's own
        kept = Edges(
            kept.origin.at[place].set(origin, mode="drop"),
            kept.target.at[place].set(target, mode="drop"),
            kept.cost.at[place].set(cost, mode="drop"),
            behind[-1],
        )
        return kept, first + sizes.edges_together

    carry = (edges._replace(num=jnp.int32(0)), jnp.int32(0))
    return _in_turns(turn, carry, edges.num, num_places // sizes.edges_together)[0]


def relaxed(edges: Edges, tree: Samples, edges_together: int) -> tuple[Array, Array, Array]:
    """Return the costs and the parents that are left when neither an edge nor the tree lowers a cost any more.

    Each round looks at the edges of the tree, then at all others, ``edges_together`` of them together. Parents change
    with a strictly lower cost only, so that they lead back to the start even where edges cost nothing.

    Args:
      edges: from `costed`.
      tree: the nodes; its ``g``, ``parent`` and ``edge_cost`` are the tree to begin with.
      edges_together: edges of one turn.

    Returns:
      ``g``, ``parent`` and ``edge_cost``, ``[N]`` each as in `Samples`.
    """
    is_child = tree.parent != NO_PARENT
    tree_parent = jnp.maximum(tree.parent, 0)
    tree_cost = jnp.where(is_child, tree.edge_cost, jnp.inf)

    def one_turn(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Lower the costs at the targets of the next few edges, and note the edge by which each was lowered.

        The carry is ``g``, the number of the edge by which each node was reached, and the first of these edges.
        """
        g, reached_by, first = carry
        origin, target, cost = (
            lax.dynamic_slice_in_dim(values, first, edges_together) for values in edges[:3]
        )
        edge = first + jnp.arange(edges_together, dtype=jnp.int32)
        reach = jnp.where(edge < edges.num, g[origin] + cost, jnp.inf)
        lowest = g.at[target].min(reach)
        is_better = (reach < g[target]) & (reach == lowest[target])
        reached_by = reached_by.at[jnp.where(is_better, target, g.size)].set(edge, mode="drop")
        return lowest, reached_by, first + edges_together

    def go_on(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Lower all costs once, along the tree and along every edge.

        The carry is ``g``, the edge by which each node was reached, and whether a cost fell.
        """
        before, reached_by, _ = carry
        along_tree = before[tree_parent] + tree_cost
        reached_by = jnp.where(along_tree < before, BY_TREE, reached_by)
        g = jnp.minimum(before, along_tree)
        g, reached_by, _ = lax.while_loop(
            lambda turn: turn[2] < edges.num, one_turn, (g, reached_by, jnp.int32(0))
        )
        return g, reached_by, jnp.any(g < before)

    to_begin = (tree.g, jnp.full(tree.g.size, BY_TREE, jnp.int32), jnp.array(True))
    g, reached_by, _ = lax.while_loop(lambda carry: carry[2], go_on, to_begin)

    # A node whose cost no edge lowered keeps its parent in the tree.
    is_by_tree = reached_by == BY_TREE
    edge = jnp.clip(reached_by, 0, edges.cost.size - 1)
    parent = jnp.where(is_by_tree, tree.parent, edges.origin[edge])
    return g, parent, jnp.where(is_by_tree, tree.edge_cost, edges.cost[edge])


def _in_turns(turn: Callable[[Any], Any], carry: Any, num: Array, most_turns: int) -> Any:
    """Repeat a turn until the carry's last part is at least ``num``; return the carry. One turn needs no loop."""
    if most_turns == 1:
        return turn(carry)
    return lax.while_loop(lambda carry: carry[-1] < num, turn, carry)
