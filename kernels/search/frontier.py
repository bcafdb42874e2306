"""Exact search of many grid queries at once: all open cells near each query's lowest f are expanded together."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxurban.kernels.tolerances import CHEAPER

NO_STEP = 255  # in `Frontier.reached_by`: the start, or not reached


class Grids(NamedTuple):
    """Maps to search, cells numbered row by row. ``M`` maps, ``N`` cells, ``K`` steps.

    Step k from P to Q costs ``step_cost[k] + from_share[k] * cost[P] + to_share[k] * cost[Q]``.

    Attributes:
      cost: ``[M, N]`` float64 map cost, >= 0.
      moves: ``[M, N]`` uint8, bit k: step k is allowed.
      step_cost, from_share, to_share: ``[M, K]`` float64.
      straight, diagonal: ``[M]`` float64, cost bound: with dr, dc rows and columns to the goal no path is
        cheaper than ``straight * max(dr, dc) + diagonal * min(dr, dc)``.
      steps: ``[K, 2]`` int32 rows and columns of each step.
      num_cols: int32 cells in a row.
    """

    cost: Array
    moves: Array
    step_cost: Array
    from_share: Array
    to_share: Array
    straight: Array
    diagonal: Array
    steps: Array
    num_cols: Array


class Frontier(NamedTuple):
    """The searches of ``Q`` queries over ``N`` cells, with one list of ``B`` open cells for all of them.

    Attributes:
      map_index, start, goal: ``[Q]`` int32; cells are flat numbers.
      band: ``[Q]`` float64, how far above the query's lowest f cells are expanded.
      g: ``[Q, N]`` float64 lowest cost found from the start, inf where none.
      reached_by: ``[Q, N]`` uint8 the step that led there, or `NO_STEP`.
      lowest_f: ``[Q]`` float64 lowest f still open, inf where nothing is: that query is done.
      num_expanded: ``[Q]`` int64.
      open_query, open_cell: ``[B]`` int32, in the first ``num_open`` places.
      open_g, open_f: ``[B]`` float64, as they were when the cell was opened; f is inf in empty places.
      num_open: int32.
    """

    map_index: Array
    start: Array
    goal: Array
    band: Array
    g: Array
    reached_by: Array
    lowest_f: Array
    num_expanded: Array
    open_query: Array
    open_cell: Array
    open_g: Array
    open_f: Array
    num_open: Array


def empty_frontier(num_queries: int, num_cells: int, list_size: int) -> Frontier:
    """Return a frontier with nothing open: every query is done until `begin` gives it a start and a goal.

    Args:
      num_queries: Q.
      num_cells: N, of every map.
      list_size: B, open cells that the list has room for.
    """
    return Frontier(
        map_index=jnp.zeros(num_queries, jnp.int32),
        start=jnp.zeros(num_queries, jnp.int32),
        goal=jnp.zeros(num_queries, jnp.int32),
        band=jnp.zeros(num_queries),
        g=jnp.full((num_queries, num_cells), jnp.inf),
        reached_by=jnp.full((num_queries, num_cells), NO_STEP, jnp.uint8),
        lowest_f=jnp.full(num_queries, jnp.inf),
        num_expanded=jnp.zeros(num_queries, jnp.int64),
        open_query=jnp.zeros(list_size, jnp.int32),
        open_cell=jnp.zeros(list_size, jnp.int32),
        open_g=jnp.full(list_size, jnp.inf),
        open_f=jnp.full(list_size, jnp.inf),
        num_open=jnp.int32(0),
    )


def _bound(grids: Grids, map_index: Array, cell: Array, goal: Array) -> Array:
    """Return the least cost between two cells, by distance alone."""
    rows = jnp.abs(cell // grids.num_cols - goal // grids.num_cols)
    cols = jnp.abs(cell % grids.num_cols - goal % grids.num_cols)
    longer = jnp.maximum(rows, cols).astype(grids.cost.dtype)
    shorter = jnp.minimum(rows, cols).astype(grids.cost.dtype)
    return grids.straight[map_index] * longer + grids.diagonal[map_index] * shorter


@partial(jax.jit, donate_argnums=0)
def begin(
    frontier: Frontier,
    grids: Grids,
    query: Array,
    map_index: Array,
    start: Array,
    goal: Array,
    band: Array,
) -> Frontier:
    """Return the frontier with a query begun: its start alone is open.

    The place of the query must be free (done or dropped), and the list must have room for one more cell.

    Args:
      frontier: of all queries; its memory is used again.
      grids: the maps.
      query: number of the query's place, below Q.
      map_index: number of its map.
      start, goal: flat cell numbers.
      band: how far above the query's lowest f cells are expanded, as a cost.
    """
    f = _bound(grids, map_index, start, goal)
    place = frontier.num_open
    of_query: dict[str, Any] = {"map_index": map_index, "start": start, "goal": goal, "band": band}
    of_query |= {"g": jnp.inf, "reached_by": NO_STEP, "lowest_f": f, "num_expanded": 0}
    of_place: dict[str, Any] = {"open_query": query, "open_cell": start, "open_g": 0.0, "open_f": f}
    fields = frontier._asdict()
    for index, values in ((query, of_query), (place, of_place)):
        for name, value in values.items():
            fields[name] = fields[name].at[index].set(value)
    begun = Frontier(**fields)
    return begun._replace(g=begun.g.at[query, start].set(0.0), num_open=place + 1)


@partial(jax.jit, donate_argnums=0)
def drop(frontier: Frontier, query: Array) -> Frontier:
    """Return the frontier with nothing of one query open any more."""
    is_dropped = frontier.open_query == query
    return frontier._replace(
        lowest_f=frontier.lowest_f.at[query].set(jnp.inf),
        open_f=jnp.where(is_dropped, jnp.inf, frontier.open_f),
    )


def with_list_of(list_size: int, frontier: Frontier) -> Frontier:
    """Return the frontier with room for ``list_size`` open cells, at least as many as before; new places are empty."""
    more = (0, list_size - frontier.open_f.size)
    return frontier._replace(
        open_query=jnp.pad(frontier.open_query, more),
        open_cell=jnp.pad(frontier.open_cell, more),
        open_g=jnp.pad(frontier.open_g, more, constant_values=jnp.inf),
        open_f=jnp.pad(frontier.open_f, more, constant_values=jnp.inf),
    )


@partial(jax.jit, donate_argnums=0, static_argnames="num_together")
def advance(frontier: Frontier, grids: Grids, max_rounds: Array, num_together: int) -> Frontier:
    """Return the frontier after up to ``max_rounds`` rounds, fewer where nothing is open any more.

    A round expands up to ``num_together`` of the open cells whose f lies within the band above the lowest
    f of their query. A cell that is left over, or is reached at a lower cost later, is expanded in a later round;
    a query is done when no open f is below the cost of its goal. So the goal's g is exact for every band.
    Rounds also end where the list might overflow (see `is_crowded`). The memory of the frontier given is used again.
    """

    def may_go_on(carry: tuple[Frontier, Array]) -> Array:
        """Return whether another round is allowed, is needed and has room."""
        frontier, num_rounds = carry
        return (
            (num_rounds < max_rounds)
            & (frontier.num_open > 0)
            & ~is_crowded(frontier, grids, num_together)
        )

    def go_on(carry: tuple[Frontier, Array]) -> tuple[Frontier, Array]:
        return _round(carry[0], grids, num_together), carry[1] + 1

    frontier, _ = jax.lax.while_loop(may_go_on, go_on, (frontier, jnp.int32(0)))
    lowest_f, *_ = _lowest_f(frontier)
    return frontier._replace(lowest_f=lowest_f)


def is_crowded(frontier: Frontier, grids: Grids, num_together: int) -> Array:
    """Return whether the list lacks room for one more round and the begin of every query: see `with_list_of`."""
    needed = grids.steps.shape[0] * num_together + frontier.goal.size
    return frontier.num_open + needed > frontier.open_f.size


def _lowest_f(frontier: Frontier) -> tuple[Array, Array, Array]:
    """Return ``[Q]`` the lowest open f of each query, ``[B]`` each entry's f, and ``[Q]`` the g of each query's goal.

    An entry's f is inf where it cannot help any more. The goals' g are a little less (`CHEAPER`).
    """
    num_queries = frontier.goal.size
    goal_g = frontier.g[jnp.arange(num_queries), frontier.goal] * CHEAPER
    f = jnp.where(frontier.open_f < goal_g[frontier.open_query], frontier.open_f, jnp.inf)
    return jnp.full(num_queries, jnp.inf).at[frontier.open_query].min(f), f, goal_g


def _round(frontier: Frontier, grids: Grids, num_together: int) -> Frontier:
    """Return the frontier after one round: the chosen open cells are expanded together.

    Arrays of fixed size stand for lists of any length, so places without an entry hold numbers out of bounds: reading
    there gives the fill value, and writing there is dropped. Below, ``T`` is ``num_together`` and ``K`` the steps.
    """
    num_queries = frontier.goal.size
    list_size = frontier.open_f.size
    lowest_f, f, goal_g = _lowest_f(frontier)
    is_open = f < jnp.inf
    is_near = is_open & (f <= (lowest_f + frontier.band)[frontier.open_query])

    # Choose up to T entries of the list near the lowest f of their query, ``[T]`` each.
    chosen = jnp.nonzero(is_near, size=num_together, fill_value=list_size)[0]
    query = frontier.open_query.at[chosen].get(mode="fill", fill_value=num_queries)
    cell = frontier.open_cell.at[chosen].get(mode="fill", fill_value=0)
    g = frontier.open_g.at[chosen].get(mode="fill", fill_value=jnp.inf)
    # An entry is outdated once its cell was reached at a lower cost: the newer entry stands for it.
    is_current = (query < num_queries) & (
        g == frontier.g.at[query, cell].get(mode="fill", fill_value=-1.0)
    )
    num_expanded = frontier.num_expanded.at[query].add(is_current.astype(jnp.int64), mode="drop")
    map_index = frontier.map_index.at[query].get(mode="fill", fill_value=0)
    goal = frontier.goal.at[query].get(mode="fill", fill_value=0)

    # All K steps from them, ``[T, K]``: the cells that they lead to, and g and f there.
    step = jnp.arange(grids.steps.shape[0], dtype=jnp.uint8)[None]
    offset = (grids.steps[:, 0] * grids.num_cols + grids.steps[:, 1])[None]
    is_allowed = ((grids.moves[map_index, cell][:, None] >> step) & 1 == 1) & is_current[:, None]
    to = jnp.where(is_allowed, cell[:, None] + offset, 0)
    to_g = g[:, None] + (
        grids.step_cost[map_index]
        + grids.from_share[map_index] * grids.cost[map_index, cell][:, None]
        + grids.to_share[map_index] * grids.cost[map_index[:, None], to]
    )
    to_f = to_g + _bound(grids, map_index[:, None], to, goal[:, None])
    to_query = jnp.broadcast_to(query[:, None], to.shape)

    # Keep the steps that lower g, and that may lie on a path cheaper than the goal's.
    is_better = is_allowed & (to_g < frontier.g.at[to_query, to].get(mode="fill", fill_value=-1.0))
    is_better &= to_f < goal_g.at[to_query].get(mode="fill", fill_value=0.0)
    better_query = jnp.where(is_better, to_query, num_queries)  # out of bounds, hence dropped
    new_g = frontier.g.at[better_query, to].min(to_g, mode="drop")
    # Of several steps to one cell at the same cost the one that the array keeps opens it, so that it opens once.
    is_best = is_better & (to_g == new_g.at[better_query, to].get(mode="fill", fill_value=-1.0))
    best_query = jnp.where(is_best, to_query, num_queries)
    steps = jnp.broadcast_to(step, to.shape)
    reached_by = frontier.reached_by.at[best_query, to].set(steps, mode="drop")
    opens = is_best & (reached_by.at[best_query, to].get(mode="fill", fill_value=NO_STEP) == steps)

    # The new list: what was open and not chosen, then the cells that these steps open.
    stays = is_open.at[chosen].set(False, mode="drop")
    is_kept = jnp.concatenate([stays, opens.ravel()])
    kept = jnp.nonzero(is_kept, size=list_size, fill_value=is_kept.size)[0]

    def listed(old: Array, new: Array, empty: float) -> Array:
        """Return one field of the new list, ``[B]``; ``empty`` stands in its free places."""
        return jnp.concatenate([old, new.ravel()]).at[kept].get(mode="fill", fill_value=empty)

    return frontier._replace(
        g=new_g,
        reached_by=reached_by,
        lowest_f=lowest_f,
        num_expanded=num_expanded,
        open_query=listed(frontier.open_query, to_query, 0),
        open_cell=listed(frontier.open_cell, to, 0),
        open_g=listed(frontier.open_g, to_g, jnp.inf),
        open_f=listed(frontier.open_f, to_f, jnp.inf),
        num_open=jnp.sum(is_kept, dtype=jnp.int32),
    )
