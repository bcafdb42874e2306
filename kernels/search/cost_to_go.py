"""The costs from every cell of a grid to many goals at once, by active tiles in JAX (block Bellman-Ford)."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

TILE = 16  # cells along the side of a tile
NUM_PASSES = 8  # over a tile in one round
Steps = tuple[tuple[int, int], ...]


class FieldMaps(NamedTuple):
    """Maps of one shape on which fields are made. ``M`` maps, ``Y`` rows, ``X`` columns, ``K`` steps.

    Step k from P to Q costs ``step_cost[k] + from_share[k] * cost[P] + to_share[k] * cost[Q]``.

    Attributes:
      cost: ``[M, Y, X]`` map cost, >= 0 where steps lead; anything elsewhere.
      moves: ``[M, Y, X]`` uint8, bit k: step k is allowed.
      step_cost, from_share, to_share: ``[M, K]``.
      band: ``[M]`` how far above a field's lowest pending cost its tiles are relaxed, >= 0.
    """

    cost: Array
    moves: Array
    step_cost: Array
    from_share: Array
    to_share: Array
    band: Array


class CostFields(NamedTuple):
    """The costs to ``G`` goals as far as they are known, on ``N`` tiles each of ``T`` x ``T`` cells.

    Attributes:
      map_index: ``[G]`` int32 the map of each field.
      cost: ``[G, 1 + Y' + 1, 1 + X' + 1]`` cost of the cheapest way to the goal found so far, inf without one; rows
        and columns filled up to whole tiles, with a frame of inf.
      pending: ``[G, N]`` the lowest cost in or beside a tile that was not yet followed inside it, inf where there is
        none. A field with nothing pending is final.
      num_rounds: int32 rounds so far.
      num_visits: ``[G]`` int32 how often a tile of each field was relaxed.
    """

    map_index: Array
    cost: Array
    pending: Array
    num_rounds: Array
    num_visits: Array


@partial(jax.jit, static_argnames=("shape", "tile"))
def begin(goals: Array, map_index: Array, shape: tuple[int, int], tile: int = TILE) -> CostFields:
    """Return fields of which nothing is known but their goals.

    Args:
      goals: ``[G, 2]`` int32 row and column; a row below 0 begins a field without a goal, which stays empty.
      map_index: ``[G]`` int32.
      shape: rows and columns of the maps.
      tile: cells along the side of a tile.
    """
    num_rows, num_cols = (-(-size // tile) for size in shape)
    field = jnp.arange(len(goals))
    has_goal = goals[:, 0] >= 0
    row, col = (jnp.where(has_goal, index, shape[0] + tile) for index in goals.T)  # dropped: outside
    cost = jnp.full((len(goals), num_rows * tile + 2, num_cols * tile + 2), jnp.inf)
    cost = cost.at[field, 1 + row, 1 + col].set(0.0, mode="drop")
    # The goal has not fallen when its own tile is relaxed and would wake no other: all that touch it begin.
    beside = jnp.array([(rows, cols) for rows in (-1, 0, 1) for cols in (-1, 0, 1)])
    rows = jnp.clip(goals[:, :1] + beside[:, 0], 0, shape[0] - 1) // tile
    cols = jnp.clip(goals[:, 1:] + beside[:, 1], 0, shape[1] - 1) // tile
    place = jnp.where(has_goal[:, None], rows * num_cols + cols, num_rows * num_cols)
    pending = jnp.full((len(goals), num_rows * num_cols), jnp.inf)
    pending = pending.at[field[:, None], place].set(0.0, mode="drop")
    num_visits = jnp.zeros(len(goals), jnp.int32)
    return CostFields(map_index.astype(jnp.int32), cost, pending, jnp.int32(0), num_visits)


@partial(jax.jit, static_argnames=("steps", "tile", "num_together", "num_passes", "unroll"))
def advance(
    fields: CostFields,
    maps: FieldMaps,
    max_rounds: Array | int,
    *,
    steps: Steps,
    num_together: int,
    tile: int = TILE,
    num_passes: int = NUM_PASSES,
    unroll: int = 1,
) -> CostFields:
    """Return the fields after so many rounds more, or fewer where all of them are final before.

    A round takes tiles whose pending cost lies within the band above the lowest one of their field, of all fields
    together, and relaxes each by itself: every pass gives all its cells the best of their steps. What has fallen at a
    tile's rim is pending in the tiles beside it, what still fell in the last pass in the tile itself. No cost is ever
    below the true one, and with nothing pending no step can lower any: then the field is that of Dijkstra's search, for
    every band and number of tiles and passes. It ends, as no way's sum falls with another step, rounded or not, and a
    cost can fall to finitely many sums. A wide band does more together and more twice.

    All shapes are fixed, so that it is one program on a GPU; other goals, maps and weights may come by `jax.vmap`, too.

    Args:
      fields: what is known.
      maps: the maps that ``fields.map_index`` tells of.
      max_rounds: see above.
      steps: rows and columns of each step, one of the eight neighbours each; at most ``K``.
      num_together: tiles relaxed in one round at most, of all fields together.
      tile: as in `begin`.
      num_passes: over each of them, 2 or more.
      unroll: passes that a turn of their loop holds: 1 for a CPU, whose compiler would melt several into one that
        repeats their work many times; all but the first and the last for a GPU, where a pass is then one kernel.
    """
    num_fields, num_tiles = fields.pending.shape
    num_cols = (fields.cost.shape[2] - 2) // tile
    over = [size - 2 - cells for size, cells in zip(fields.cost.shape[1:], maps.cost.shape[1:], strict=True)]
    cost = jnp.pad(maps.cost, [(0, 0), *((1, rest + 1) for rest in over)])
    moves = jnp.pad(maps.moves, [(0, 0), *((0, rest) for rest in over)])
    # Wakened by a tile: whoever lies beyond its rim, and in the middle the tile itself.
    side = np.arange(tile)
    at_rim = np.stack([side == 0, np.ones(tile, bool), side == tile - 1])
    is_beside = at_rim[:, None, :, None] & at_rim[None, :, None, :]  # [3, 3, T, T]
    is_itself = np.zeros((3, 3, 1, 1), bool)
    is_itself[1, 1] = True

    def windows(values: Array, origin: tuple[Array, ...], size: int) -> Array:
        """Return ``[A, size, size]`` cells of ``[*, Y, X]`` values."""
        return jax.vmap(lambda *at: lax.dynamic_slice(values, at, (1, size, size))[0])(*origin)

    def framed(values: Array) -> Array:
        return jnp.pad(values, ((0, 0), (1, 1), (1, 1)), constant_values=jnp.inf)

    def ahead(around: Array, rows: int, cols: int) -> Array:
        """Return the cells that lie so many rows and columns off those inside a frame."""
        return around[:, 1 + rows : 1 + rows + tile, 1 + cols : 1 + cols + tile]

    def one_round(fields: CostFields) -> CostFields:
        lowest = fields.pending.min(axis=1, keepdims=True)
        is_near = (fields.pending <= lowest + maps.band[fields.map_index, None]) & (fields.pending < jnp.inf)
        rank = jnp.cumsum(is_near.ravel(), dtype=jnp.int32).reshape(is_near.shape)
        is_taken = is_near & (rank <= num_together)
        place = jnp.where(is_taken, rank - 1, num_together).ravel()
        every = jnp.arange(num_fields * num_tiles, dtype=jnp.int32)
        taken = jnp.full(num_together, every.size, jnp.int32).at[place].set(every, mode="drop")
        field, tile_number = taken // num_tiles, taken % num_tiles  # an empty place: the field after the last
        tile_row, tile_col = tile_number // num_cols, tile_number % num_cols
        row, col = tile_row * tile, tile_col * tile

        on_map = fields.map_index[field]
        cost_around = windows(cost, (on_map, row, col), tile + 2)
        moves_here = windows(moves, (on_map, row, col), tile)
        edges = []
        for k, (rows, cols) in enumerate(steps):
            step, from_share, to_share = (
                share[on_map, k, None, None] for share in (maps.step_cost, maps.from_share, maps.to_share)
            )
            edge = step + from_share * ahead(cost_around, 0, 0) + to_share * ahead(cost_around, rows, cols)
            edges.append(jnp.where((moves_here >> k) & 1 == 1, edge, jnp.inf))

        def relaxed(around: Array) -> Array:
            best = ahead(around, 0, 0)
            for edge, (rows, cols) in zip(edges, steps, strict=True):
                best = jnp.minimum(best, edge + ahead(around, rows, cols))
            return best

        # The frame counts once: it stays as it is.
        around = windows(fields.cost, (field, row, col), tile + 2)
        passes = (0, num_passes - 2, lambda _, best: relaxed(framed(best)), relaxed(around))
        before_last = lax.fori_loop(*passes, unroll=unroll)
        best = relaxed(framed(before_last))

        falls_still = jnp.where(best < before_last, best, jnp.inf)[:, None, None]
        fell = jnp.where(best < ahead(around, 0, 0), best, jnp.inf)[:, None, None]
        wakened = jnp.where(is_itself, falls_still, jnp.where(is_beside, fell, jnp.inf)).min(axis=(3, 4))  # [A, 3, 3]
        by = jnp.arange(-1, 2)
        to_row, to_col = jnp.broadcast_arrays(tile_row[:, None, None] + by[:, None], tile_col[:, None, None] + by)
        is_there = (to_row >= 0) & (to_row < num_tiles // num_cols) & (to_col >= 0) & (to_col < num_cols)
        to = jnp.where(is_there, to_row * num_cols + to_col, num_tiles)
        pending = jnp.where(is_taken, jnp.inf, fields.pending)
        return fields._replace(
            cost=lax.scatter(
                fields.cost,
                jnp.stack([field, 1 + row, 1 + col], axis=1),
                best,
                lax.ScatterDimensionNumbers((1, 2), (0,), (0, 1, 2)),
                mode=lax.GatherScatterMode.FILL_OR_DROP,
            ),
            pending=pending.at[field[:, None, None], to].min(wakened, mode="drop"),
            num_rounds=fields.num_rounds + 1,
            num_visits=fields.num_visits + is_taken.sum(axis=1, dtype=jnp.int32),
        )

    end = fields.num_rounds + max_rounds

    def may_go_on(fields: CostFields) -> Array:
        return jnp.any(fields.pending < jnp.inf) & (fields.num_rounds < end)

    return lax.while_loop(may_go_on, one_round, fields)
