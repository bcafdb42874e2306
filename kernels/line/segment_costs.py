"""What many straight segments cost over a map of cells at once, in JAX."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxurban.kernels.line.traversal import DIAGONAL_SIDES, TOUCH_CELLS


class _Walk(NamedTuple):
    """A walk from border to border: cell, borders still ahead, cell sides behind, cost so far."""

    row: Array
    col: Array
    num_x: Array
    num_y: Array
    at: Array
    total: Array


@partial(jax.jit, static_argnames="is_line")
def segment_costs(
    cell_cost: Float[Array, "Y X"],
    start: Float[Array, "E 2"],
    end: Float[Array, "E 2"],
    per_side: float | Float[Array, ""],
    is_line: bool,
    passes_corners: bool | Bool[Array, ""],
) -> Float[Array, " E"]:
    """Return the cost of each of ``E`` segments, inf where it is not a free way, infinite costs being blocked cells.

    Segments are cut exactly at cell borders, as in `kernels.line.traversal`, and are free by the law of its
    `is_free_way`: a corner passed within ``TOUCH_CELLS`` counts as touched, so that the cells beside it are not
    crossed.
    ``line``: the cell's cost is integrated along the segment. ``cell``: every state costs that of the cell in which it
    lies; states stand one cell side apart, the end is one, the start is none, and a segment up to a diagonal long has
    no other. A segment of no length costs nothing.

    It takes as many rounds as the segment with most cells has cells. The precision is that of the
    coordinates: call it under ``jax.enable_x64(True)``, since float32 tells no corners apart.

    Args:
      cell_cost: cost of a cell per cell side crossed (`line`) or per state (`cell`); inf: no way through.
      start, end: x, y in cell sides, off the borders of their cells, finite.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
    """
    in_axes = (None, 0, 0, None, None)
    return jax.vmap(partial(_cost, is_line=is_line), in_axes)(cell_cost, start, end, per_side, passes_corners)


def _cost(
    cell_cost: Array, start: Array, end: Array, per_side: float | Array, passes_corners: bool | Array, *, is_line: bool
) -> Array:
    delta = end - start
    length = jnp.hypot(*delta)
    col, row = jnp.floor(start).astype(int)
    num_x, num_y = jnp.abs(jnp.floor(end).astype(int) - jnp.stack([col, row]))
    step_x, step_y = jnp.where(delta > 0, 1, -1)
    # Cell sides along the segment per cell side of x and of y.
    along_x, along_y = length / jnp.where(delta == 0, 1.0, delta)
    last_state = jnp.where(length > DIAGONAL_SIDES, jnp.ceil(length * (1 - TOUCH_CELLS)) - 1, 0.0)

    def cost_at(row: Array, col: Array) -> Array:
        is_inside = (row >= 0) & (row < cell_cost.shape[0]) & (col >= 0) & (col < cell_cost.shape[1])
        return jnp.where(is_inside, cell_cost[row, col], jnp.inf)

    def segment(walk: _Walk) -> _Walk:
        next_x = jnp.where(walk.num_x > 0, (walk.col + (step_x > 0) - start[0]) * along_x, jnp.inf)
        next_y = jnp.where(walk.num_y > 0, (walk.row + (step_y > 0) - start[1]) * along_y, jnp.inf)
        to = jnp.minimum(jnp.minimum(next_x, next_y), length)
        if is_line:
            share = to - walk.at
        else:
            # A state on a border belongs to the cell it came through.
            before, by_now = (jnp.clip(jnp.floor(sides + TOUCH_CELLS), 0, last_state) for sides in (walk.at, to))
            share = by_now - before
        here = cost_at(walk.row, walk.col)
        added = jnp.where(jnp.isinf(here), jnp.inf, share * jnp.where(jnp.isinf(here), 0.0, here))
        is_corner = jnp.abs(next_x - next_y) < TOUCH_CELLS
        beside = jnp.minimum(cost_at(walk.row + step_y, walk.col), cost_at(walk.row, walk.col + step_x))
        added = jnp.where(is_corner & jnp.isinf(beside) & ~passes_corners, jnp.inf, added)
        go_x, go_y = is_corner | (next_x < next_y), is_corner | (next_y < next_x)
        return _Walk(
            walk.row + go_y * step_y,
            walk.col + go_x * step_x,
            walk.num_x - go_x,
            walk.num_y - go_y,
            to,
            walk.total + added,
        )

    def is_under_way(walk: _Walk) -> Array:
        return ((walk.num_x > 0) | (walk.num_y > 0)) & jnp.isfinite(walk.total)

    walk = jax.lax.while_loop(
        is_under_way, segment, _Walk(row, col, num_x, num_y, jnp.zeros_like(length), per_side * length)
    )
    total = segment(walk).total
    if not is_line:
        total += cost_at(walk.row, walk.col)
    return jnp.where(length > 0, total, 0.0)
