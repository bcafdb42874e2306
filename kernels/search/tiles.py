"""Exact search of many grid queries at once by active tiles: those near each query's lowest f are relaxed whole."""

from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.programs import kept_jit

SIDE = 32  # cells along a side of a tile: 16 make for fewer cells visited and more rounds
CYCLES = 2  # of sweeps to the north, south, east and west in one visit of a tile on a CPU
TURNS = 40  # on a GPU, where few launches matter most: of all cells of a tile at once in one visit
Step = tuple[int, int]  # rows and columns
FRAME = ((1, 1), (1, 1), (0, 0))  # of one cell around tiles
Edges = dict[
    Step, Array
]  # ``[SIDE, SIDE, A]`` cost of each step from the cells of tiles, inf where not allowed
RIM = {-1: slice(1), 0: slice(None), 1: slice(-1, None)}  # cells of a tile next to a neighbour


class TileGrid(NamedTuple):
    """A map of ``I x J`` tiles.

    A step from P to Q costs ``base + from_share * cost[P] + to_share * cost[Q]``.

    Attributes:
      cost: ``[I * SIDE + 2, J * SIDE + 2]`` float64, finite, in a frame.
      moves: ``[I * SIDE, J * SIDE]`` uint8, whose bits are the steps that are allowed.
      steps: bit, base, from_share and to_share of each step.
    """

    cost: Array
    moves: Array
    steps: dict[Step, tuple[int, float, float, float]]


class Search(NamedTuple):
    """The searches of ``Q`` queries on a map of ``I x J`` tiles, each from its goal toward its start.

    Attributes:
      start: ``[Q, 2]`` int32 row and column, out of bounds for costs from all cells.
      bound: ``[Q, I, J]`` float64 what a path from the start to any cell of a tile costs at least.
      g: ``[Q, I * SIDE + 2, J * SIDE + 2]`` float64 lowest cost found to the goal, inf where none, in a frame.
      open_g: ``[Q, I + 2, J + 2]`` float64 lowest g of cells that may lower some of a tile, inf without one; framed.
      num_visits: ``[Q]`` int64 of tiles.
    """

    start: Array
    bound: Array
    g: Array
    open_g: Array
    num_visits: Array


@kept_jit
def begin(start: Array, goal: Array, bound: Array) -> Search:
    """Return a search in which the tiles of the goals, and of the cells next to them, are open.

    Args:
      start, bound: of `Search`.
      goal: ``[Q, 2]`` int32; a query is done from the first if it lies far out of bounds.
    """
    num_queries, num_i, num_j = bound.shape
    query = jnp.arange(num_queries)
    g = jnp.full((num_queries, num_i * SIDE + 2, num_j * SIDE + 2), jnp.inf)
    open_g = jnp.full((num_queries, num_i + 2, num_j + 2), jnp.inf)
    for step in product(RIM, RIM):  # the goal itself may lower cells of the next tile
        beside = (goal + jnp.array([step], goal.dtype)) // SIDE + 1
        open_g = open_g.at[query, *beside.T].set(0.0, mode="drop")
    return Search(
        start,
        bound,
        g.at[query, *(goal + 1).T].set(0.0, mode="drop"),
        open_g,
        jnp.zeros(num_queries, jnp.int64),
    )


@partial(kept_jit, donate_argnums=0, static_argnames=("num_together",))
def advance_tiles(
    search: Search, grid: TileGrid, band: float, max_rounds: int, *, num_together: int
) -> tuple[Search, Array]:
    """Return the search after up to ``max_rounds`` rounds, and ``[Q]`` the lowest open f of each query.

    A round visits up to ``num_together`` of the tiles that are open within the band above the lowest f of their query.
    A query is done, and its lowest f inf, when no tile is open at an f up to the cost of its start. So the g of every
    cell on a cheapest path is exact, for every band and whatever other queries there are.

    Args:
      search: its memory is used again.
      grid: the map.
      band: how far above the lowest f of its query a tile is visited.
      max_rounds, num_together: see above.
    """

    def may_go_on(carry: tuple[Search, Array]) -> Array:
        search, num_rounds = carry
        return (num_rounds < max_rounds) & jnp.any(_open_f(search) < jnp.inf)

    def go_on(carry: tuple[Search, Array]) -> tuple[Search, Array]:
        return _round(carry[0], grid, band, num_together), carry[1] + 1

    search, _ = lax.while_loop(may_go_on, go_on, (search, jnp.int32(0)))
    return search, _open_f(search).min((1, 2))


def _open_f(search: Search) -> Array:
    """Return ``[Q, I, J]`` the lowest f of each open tile, inf where no path through it can be the cheapest."""
    f = search.open_g[:, 1:-1, 1:-1] + search.bound
    query = jnp.arange(len(f))
    of_start = search.g.at[query, *(search.start + 1).T].get(mode="fill", fill_value=jnp.inf)
    return jnp.where(f <= SAME_COST * of_start[:, None, None], f, jnp.inf)


def _round(search: Search, grid: TileGrid, band: float, num_together: int) -> Search:
    """Return the search after one visit of the chosen tiles, which are computed side by side: ``A`` is their number.

    Places without a tile have a query out of bounds: what is read there is of no meaning, and writing there is dropped.
    """
    # Choose up to A open tiles near the lowest f of their query.
    f = _open_f(search)
    is_near = (f <= f.min((1, 2), keepdims=True) + band) & (f < jnp.inf)
    (chosen,) = jnp.nonzero(is_near.ravel(), size=num_together, fill_value=f.size)
    query, tile = jnp.divmod(chosen, f[0].size)
    i, j = jnp.divmod(tile, f.shape[2])

    def taken(side: int, layer: Array, values: Array) -> Array:
        """Return ``[side, side, A]`` windows of layers of ``[Q, Y, X]`` at the tiles."""
        windows = jax.vmap(lambda *at: lax.dynamic_slice(values, at, (1, side, side))[0])
        return jnp.moveaxis(windows(layer, i * SIDE, j * SIDE), 0, -1)

    cost = taken(SIDE + 2, 0 * query, grid.cost[None])
    moves = taken(SIDE, 0 * query, grid.moves[None])
    edges = {}
    for (di, dj), (bit, base, from_share, to_share) in grid.steps.items():
        there = cost[1 + di :, 1 + dj :][:SIDE, :SIDE]
        paid = base + from_share * cost[1:-1, 1:-1] + to_share * there
        edges[di, dj] = jnp.where(moves & bit, paid, jnp.inf)

    def turn(_: int, g: Array) -> Array:
        return jnp.minimum(g, jnp.pad(_lowered(g, edges), FRAME, constant_values=jnp.inf))

    def cycle(_: int, g: Array) -> Array:
        for axis, side in product((0, 1), (-1, 1)):
            g = _swept(g, edges, axis, side)
        return g

    before = taken(SIDE + 2, query, search.g)
    last = lax.platform_dependent(
        before,
        cpu=lambda g: lax.fori_loop(0, CYCLES, cycle, g),
        default=lambda g: lax.fori_loop(0, TURNS, turn, g, unroll=4),
    )
    own = _lowered(last, edges)

    # Open what these cells may lower: the tile itself by those of the last turn, others by all that were lowered.
    lowered, again = (jnp.where(own < old[1:-1, 1:-1], own, jnp.inf) for old in (before, last))
    of_rows = [lowered[rim].min(0) for rim in RIM.values()]
    lowest = jnp.array([[row[rim].min(0) for rim in RIM.values()] for row in of_rows])
    lowest = lowest.at[1, 1].set(again.min((0, 1)))
    di, dj = jnp.indices((3, 3, 1))[:2]
    open_g = search.open_g.at[query, i + 1, j + 1].set(jnp.inf, mode="drop")
    open_g = open_g.at[query[None, None], i[None, None] + di, j[None, None] + dj].min(
        lowest, mode="drop"
    )

    numbers = lax.ScatterDimensionNumbers((1, 2), (0,), (0, 1, 2))
    places = jnp.stack([query, i * SIDE + 1, j * SIDE + 1], axis=1)
    return search._replace(
        g=lax.scatter(search.g, places, jnp.moveaxis(own, -1, 0), numbers, mode="drop"),
        open_g=open_g,
        num_visits=search.num_visits.at[query].add(1, mode="drop"),
    )


def _swept(g: Array, edges: Edges, axis: int, side: int) -> Array:
    """Return g of tiles after a sweep, line by line.

    Args:
      g: as in `_lowered`.
      edges: of the tiles.
      axis: across which the lines lie.
      side: where the line before each one lies along it, 1 or -1: from three of its cells each cell may be lowered.
    """
    ahead = {step: edge for step, edge in edges.items() if step[axis] == side}

    def lower(k: Array, g: Array) -> Array:
        at = k if side < 0 else SIDE - 1 - k
        lines = lax.dynamic_slice_in_dim(g, at, 3, axis)
        steps = {step: lax.dynamic_slice_in_dim(edge, at, 1, axis) for step, edge in ahead.items()}
        place = (at + 1, 1, 0) if axis == 0 else (1, at + 1, 0)
        return lax.dynamic_update_slice(g, _lowered(lines, steps), place)

    return lax.fori_loop(0, SIDE, lower, g)


def _lowered(g: Array, edges: Edges) -> Array:
    """Return ``[Y, X, A]`` the g of cells after each was lowered once, by all at once.

    Args:
      g: ``[Y + 2, X + 2, A]`` of these cells and of those around them.
      edges: ``[Y, X, A]`` by step.
    """
    lowest = g[1:-1, 1:-1]
    num_rows, num_cols, _ = lowest.shape
    for (di, dj), edge in edges.items():
        lowest = jnp.minimum(lowest, edge + g[1 + di :, 1 + dj :][:num_rows, :num_cols])
    return lowest
