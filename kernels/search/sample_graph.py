"""Random geometric graphs searched in bulk: neighbours, edge costs and relaxation over all samples at once.

The samples of many queries are one graph of many parts, since nodes are joined to those of their own query only. So one
call serves queries of any sizes and stages, and its shapes depend on nothing but the number of all their nodes.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxurban.kernels.line.segment_costs import segment_costs
from jaxurban.kernels.search.relaxation import NO_PARENT as NO_PARENT
from jaxurban.kernels.search.relaxation import Edges, OfNode, Tree, relaxed_by_edges, relaxed_by_nodes

NO_QUERY = -1
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
    """Room in the arrays of a search, and how much is done in one turn; each choice compiles anew. ``N`` nodes.

    Attributes:
      candidates: nodes that the nine squares around a node may hold.
      edges: edges in the mean of all ``N``.
      nodes_together, edges_together: of one turn; they divide ``N``, and ``edges * N``.
    """

    candidates: int
    edges: int
    nodes_together: int
    edges_together: int


class Trees(NamedTuple):
    """What a search found. ``N`` nodes.

    Attributes:
      g, parent, edge_cost: ``[N]`` as in `Samples`; where ``most_candidates`` or ``num_edges`` are more than there is
        room for, they are what was given.
      num_costed: ``[N]`` int32 edges to each node whose cost was computed.
      num_rounds: of relaxation.
      most_candidates, num_edges: the room that would do (``num_edges`` is known only where candidates have room).
    """

    g: Array
    parent: Array
    edge_cost: Array
    num_costed: Array
    num_rounds: Array
    most_candidates: Array
    num_edges: Array


@partial(jax.jit, static_argnames=("is_line", "sizes", "shape"))
def search_samples(
    samples: Samples,
    cell_cost: Array,
    per_side: float | Array,
    passes_corners: bool | Array,
    *,
    is_line: bool,
    sizes: Sizes,
    shape: Literal["cpu", "gpu"] | None = None,
) -> Trees:
    """Return the cheapest paths from every query's start over its random geometric graph and the tree given.

    All pairs of nodes within the radius are joined, but for edges whose lower bound says that they cannot lead to a
    cheaper path than those known; each edge is costed by `segment_costs`, in both directions. Costs are relaxed, all
    nodes together, until none falls, so that the goal's ``g`` is that of Dijkstra's search, or the one given.

    Call it under ``jax.enable_x64(True)``.

    Args:
      samples: the nodes.
      cell_cost, per_side, passes_corners, is_line: the map of all queries, as in `segment_costs`.
      sizes: room; too little is told in the result, and nothing is searched then.
      shape: of the computation, for a CPU or a GPU; left out, for the platform for which it is compiled. Of equally
        cheap paths another one may be found.
    """
    order = jnp.argsort(_squares(samples, cell_cost.shape)[0]).astype(jnp.int32)
    place = jnp.zeros_like(order).at[order].set(jnp.arange(order.size, dtype=jnp.int32))

    def renumbered(parent: Array, number: Array) -> Array:
        return jnp.where(parent == NO_PARENT, NO_PARENT, number[jnp.maximum(parent, 0)])

    ordered = Samples(*(values[order] for values in samples))
    ordered = ordered._replace(parent=renumbered(ordered.parent, place))
    edges, of_node, most_candidates = neighbours(ordered, cell_cost.shape, sizes)
    num_edges = edges.num
    has_room = num_edges <= edges.cost.size
    edges = edges._replace(num=jnp.where(has_room, num_edges, 0))

    def by_edges(edges: Edges, samples: Samples, *on_map: Any) -> tuple[Tree, Array]:
        edges = costed(edges, samples, *on_map, is_line=is_line, sizes=sizes, shape="cpu")
        return relaxed_by_edges(edges, _tree_of(samples), sizes.edges_together)

    def by_nodes(edges: Edges, samples: Samples, *on_map: Any) -> tuple[Tree, Array]:
        edges = costed(edges, samples, *on_map, is_line=is_line, sizes=sizes, shape="gpu")
        edges_of_node = of_node._replace(num=jnp.where(has_room, of_node.num, 0))
        return relaxed_by_nodes(edges, edges_of_node, _tree_of(samples), sizes.candidates)

    search = edges, ordered, cell_cost, per_side, passes_corners
    if shape is None:
        tree, num_rounds = lax.platform_dependent(*search, cpu=by_edges, default=by_nodes)
    else:
        tree, num_rounds = (by_edges if shape == "cpu" else by_nodes)(*search)
    return Trees(
        tree.g[place],
        renumbered(tree.parent[place], order),
        tree.edge_cost[place],
        of_node.num[place],
        num_rounds,
        most_candidates,
        num_edges,
    )


def _tree_of(samples: Samples) -> Tree:
    return Tree(samples.g, samples.parent, samples.edge_cost)


def _squares(samples: Samples, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return ``[N]`` the number of the square that holds each node, and the squares in a row.

    Squares are no smaller than the radius, and have a frame of empty ones, so that squares side by side in different
    rows or queries never follow each other.
    """
    longest = float(max(shape))
    side = jnp.clip(samples.radius, longest / MOST_SQUARES, longest)
    num_cols = (longest / side).astype(jnp.int64) + 3
    col, row = (jnp.floor(samples.xy / side[:, None]).astype(jnp.int64) + 1).T
    square = samples.query.astype(jnp.int64) * SQUARES_OF_A_QUERY + row * num_cols + col
    return jnp.where(samples.query == NO_QUERY, jnp.iinfo(jnp.int64).max, square), num_cols


def neighbours(samples: Samples, shape: tuple[int, ...], sizes: Sizes) -> tuple[Edges, OfNode, Array]:
    """Return the edges within the radius, yet without costs, the edges of each node, and `most_candidates`.

    An edge is kept where by its lower bound it may give its end a lower cost than it has, and the query a cheaper path.
    Where edges lack room their number tells it; where candidates do, no edge is kept.

    Args:
      samples: sorted by square.
      shape: rows and columns of the map.
      sizes: room.
    """
    square, num_cols = _squares(samples, shape)
    west = square[:, None] + num_cols[:, None] * jnp.arange(-1, 2) - 1
    # Unrolled, as the loop would be one launch a step.
    begin, end = (
        jnp.searchsorted(square, ends, side=side, method="scan_unrolled")
        for ends, side in ((west, "left"), (west + 2, "right"))
    )
    is_node = samples.query != NO_QUERY
    ends = jnp.cumsum(jnp.where(is_node[:, None], end - begin, 0), axis=1).astype(jnp.int32)  # of three rows of squares
    begin = begin.astype(jnp.int32).at[:, 1:].add(-ends[:, :2])  # so that slot k of row r of squares is begin + k
    most_candidates = ends[:, 2].max()
    ends = jnp.where(most_candidates <= sizes.candidates, ends, 0)
    num_nodes = jnp.sum(ends[:, 2] > 0)
    slot = jnp.arange(sizes.candidates, dtype=jnp.int32)
    num_places = sizes.edges * square.size

    def turn(carry: tuple[Edges, OfNode, Array]) -> tuple[Edges, OfNode, Array]:
        edges, of_node, first = carry

        def here(values: Array) -> Array:
            return lax.dynamic_slice_in_dim(values, first, sizes.nodes_together)[:, None]

        last, start = here(ends)[:, 0], here(begin)[:, 0]
        in_row = [slot < last[:, :1], slot < last[:, 1:2]]
        origin = slot + jnp.where(in_row[0], start[:, :1], jnp.where(in_row[1], start[:, 1:2], start[:, 2:]))
        is_edge = slot < last[:, 2:]
        origin = jnp.where(is_edge, origin, 0)
        node = jnp.broadcast_to(first + jnp.arange(sizes.nodes_together, dtype=jnp.int32)[:, None], origin.shape)
        dx, dy = samples.xy[origin, 0] - here(samples.xy[:, 0]), samples.xy[origin, 1] - here(samples.xy[:, 1])
        distance = jnp.sqrt(dx * dx + dy * dy)
        map_part = jnp.maximum(
            jnp.abs(samples.row_at[origin] - here(samples.row_at)),
            jnp.abs(samples.col_at[origin] - here(samples.col_at)),
        )
        reach = samples.from_start[origin] + here(samples.least_per_side) * distance + here(samples.enter) + map_part
        is_edge &= (distance <= here(samples.radius)) & (origin != node)
        is_edge &= (reach < here(samples.g)) & (reach + here(samples.to_goal) < here(samples.incumbent))
        num_here = jnp.sum(is_edge, axis=1, dtype=jnp.int32)
        behind = edges.num + jnp.cumsum(num_here)
        of_node_here = OfNode(behind - num_here, num_here)
        place = of_node_here.first[:, None] + jnp.cumsum(is_edge, axis=1, dtype=jnp.int32) - 1
        place = jnp.where(is_edge, place, num_places)  # out of bounds, hence dropped
        edges = edges._replace(
            origin=edges.origin.at[place].set(origin, mode="drop"),
            target=edges.target.at[place].set(node, mode="drop"),
            num=behind[-1],
        )
        of_node = OfNode(
            *(lax.dynamic_update_slice_in_dim(*whole, first, 0) for whole in zip(of_node, of_node_here, strict=True))
        )
        return edges, of_node, first + sizes.nodes_together

    nowhere = jnp.zeros(num_places, jnp.int32)
    edges = Edges(nowhere, nowhere, jnp.zeros(num_places), jnp.int32(0))
    none = jnp.zeros(square.size, jnp.int32)
    carry = (edges, OfNode(none, none), jnp.int32(0))
    edges, of_node, _ = _in_turns(turn, carry, num_nodes, square.size // sizes.nodes_together)
    return edges, of_node, most_candidates


def costed(
    edges: Edges,
    samples: Samples,
    cell_cost: Array,
    per_side: float | Array,
    passes_corners: bool | Array,
    *,
    is_line: bool,
    sizes: Sizes,
    shape: Literal["cpu", "gpu"],
) -> Edges:
    """Return the edges with the costs of those that, by their costs, may still help.

    For a CPU the others are dropped, for a GPU they stay, with cost inf. So many are costed in each turn that no place
    goes empty.
    """
    num_places = edges.cost.size

    def turn(carry: tuple[Edges, Array]) -> tuple[Edges, Array]:
        kept, first = carry
        is_edge = first + jnp.arange(sizes.edges_together) < edges.num
        origin, target = (
            jnp.where(is_edge, lax.dynamic_slice_in_dim(nodes, first, sizes.edges_together), 0)
            for nodes in (kept.origin, kept.target)
        )
        start, end = samples.xy[origin], samples.xy[target]
        cost = segment_costs(cell_cost, start, end, per_side, is_line, passes_corners, shape=shape)
        reach = samples.from_start[origin] + cost
        is_kept = is_edge & (reach < samples.g[target]) & (reach + samples.to_goal[target] < samples.incumbent[target])
        if shape == "gpu":
            cost = jnp.where(is_kept, cost, jnp.inf)
            kept = kept._replace(cost=lax.dynamic_update_slice_in_dim(kept.cost, cost, first, 0))
        else:
            behind = kept.num + jnp.cumsum(is_kept, dtype=jnp.int32)
            place = jnp.where(is_kept, behind - 1, num_places)  # at or before the edge's own
            kept = Edges(
                kept.origin.at[place].set(origin, mode="drop"),
                kept.target.at[place].set(target, mode="drop"),
                kept.cost.at[place].set(cost, mode="drop"),
                behind[-1],
            )
        return kept, first + sizes.edges_together

    carry = (edges if shape == "gpu" else edges._replace(num=jnp.int32(0)), jnp.int32(0))
    return _in_turns(turn, carry, edges.num, num_places // sizes.edges_together)[0]


def _in_turns(turn: Callable[[Any], Any], carry: Any, num: Array, most_turns: int) -> Any:
    """Return what is carried, whose last part is how many are done, when so many are; one turn needs no loop."""
    return turn(carry) if most_turns == 1 else lax.while_loop(lambda carry: carry[-1] < num, turn, carry)
