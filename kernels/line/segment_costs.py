"""What many straight segments cost over a map of cells at once, in JAX.

Segments are cut where they pass from cell to cell; all of them are walked along together, from cut to cut.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxurban.kernels.line.traversal import DIAGONAL_SIDES, TOUCH_CELLS


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

    It takes as many rounds as the segment with most cells has cells. The precision is that of the coordinates: call it
    under ``jax.enable_x64(True)``, since float32 tells no corners apart.

    Args:
      cell_cost: cost of a cell per cell side crossed (`line`) or per state (`cell`); inf: no way through.
      start, end: x, y in cell sides, off the borders of their cells, finite.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
    """
    num_rows, num_cols = cell_cost.shape

    def cost_at(col: Array, row: Array) -> Array:
        is_inside = (row >= 0) & (row < num_rows) & (col >= 0) & (col < num_cols)
        return jnp.where(is_inside, cell_cost[row, col], jnp.inf)

    def cost(start: Array, end: Array) -> Array:
        """Return what one segment costs; of two, x comes before y, apart, as arrays of two take twice as long."""
        delta = end - start
        length = jnp.hypot(*delta)
        first, last = (jnp.floor(point).astype(jnp.int32) for point in (start, end))
        step = jnp.where(delta > 0, 1, -1).astype(jnp.int32)
        border = first + (delta > 0)  # of its cell on the way
        along = length / jnp.where(delta == 0, 1.0, delta)  # cell sides along the segment per cell side of x and of y
        num_cuts = jnp.abs(last - first)
        last_state = jnp.where(length > DIAGONAL_SIDES, jnp.ceil(length * (1 - TOUCH_CELLS)) - 1, 0.0)
        (x, y), (step_x, step_y) = zip(border, step, start, along, num_cuts, strict=True), step

        def next_cut(num_passed: Array, axis: tuple[Array, ...]) -> Array:
            border, step, start, along, num_cuts = axis
            return jnp.where(num_passed < num_cuts, (border + step * num_passed - start) * along, jnp.inf)

        def is_under_way(walk: tuple[Array, ...]) -> Array:
            num_x, num_y, _, total = walk
            return ((num_x < num_cuts[0]) | (num_y < num_cuts[1])) & jnp.isfinite(total)

        def go_on(walk: tuple[Array, ...]) -> tuple[Array, ...]:
            """Go on to the next cut, from so many of x and of y that are passed, cell sides behind, and the cost."""
            num_x, num_y, behind, total = walk
            next_x, next_y = next_cut(num_x, x), next_cut(num_y, y)
            to = jnp.minimum(jnp.minimum(next_x, next_y), length)
            if is_line:
                share = to - behind
            else:
                # A state on a border belongs to the cell it came through.
                before, by_now = (jnp.clip(jnp.floor(sides + TOUCH_CELLS), 0, last_state) for sides in (behind, to))
                share = by_now - before
            col, row = first[0] + step_x * num_x, first[1] + step_y * num_y
            here = cost_at(col, row)
            total += jnp.where(jnp.isinf(here), jnp.inf, share * jnp.where(jnp.isinf(here), 0.0, here))
            is_corner = jnp.abs(next_x - next_y) < TOUCH_CELLS
            beside = jnp.minimum(cost_at(col, row + step_y), cost_at(col + step_x, row))
            is_pinched = is_corner & jnp.isinf(beside) & ~jnp.asarray(passes_corners)
            num_x, num_y = num_x + (is_corner | (next_x < next_y)), num_y + (is_corner | (next_y < next_x))
            return num_x, num_y, to, jnp.where(is_pinched, jnp.inf, total)

        none = jnp.zeros_like(num_cuts[0])
        total = go_on(lax.while_loop(is_under_way, go_on, (none, none, jnp.zeros_like(length), per_side * length)))[3]
        return jnp.where(length > 0, total if is_line else total + cost_at(*last), 0.0)

    return jax.vmap(cost)(start, end)
