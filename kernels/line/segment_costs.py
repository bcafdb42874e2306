"""What straight segments cost, many at once in JAX; one by one, in Numba, in `kernels.line.segment_cost`."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxurban.kernels.line.traversal import DIAGONAL_SIDES, TOUCH_CELLS
from jaxurban.programs import kept_jit


@partial(kept_jit, static_argnames=("is_line",))
def segment_costs(
    cell_cost: Float[Array, "Y X"],
    start: Float[Array, "E 2"],
    end: Float[Array, "E 2"],
    per_side: float | Float[Array, ""],
    passes_corners: bool | Bool[Array, ""],
    *,
    is_line: bool,
) -> Float[Array, " E"]:
    """Return the cost of each of ``E`` segments, inf for a segment that is not a free way.

    All segments are walked along together, from cut to cut. They are cut exactly at cell borders, as in
    `kernels.line.traversal`, and are free by the law of its `is_free_way`: a corner passed within ``TOUCH_CELLS``
    counts as touched, so that the cells beside it are not crossed.

    Under ``line`` the cell's cost is integrated along the segment. Under ``cell`` every state costs as much as the cell
    in which it lies; states stand one cell side apart, the end is a state, the start is none, and a segment up to a
    diagonal long has no state but its end. A segment of no length costs nothing.

    The number of rounds is the number of cells of the segment with most cells. The precision is that of the
    coordinates: call it under ``jax.enable_x64(True)``, since float32 does not distinguish corners.

    Args:
      cell_cost: cost of a cell per cell side crossed (`line`) or per state (`cell`); inf for a blocked cell.
      start, end: x, y in cell sides, off the borders of their cells, finite.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
    """
    num_rows, num_cols = cell_cost.shape

    def cost_at(col: Array, row: Array) -> Array:
        """Return the cost of a cell, inf outside the map."""
        is_inside = (row >= 0) & (row < num_rows) & (col >= 0) & (col < num_cols)
        return jnp.where(is_inside, cell_cost[row, col], jnp.inf)

    def cost(start: Array, end: Array) -> Array:
        """Return the cost of one segment.

        Values of both axes come x before y, and the loop takes them apart: arrays of two take twice as long.
        """
        delta = end - start
        length = jnp.hypot(*delta)
        first, last = (jnp.floor(point).astype(jnp.int32) for point in (start, end))
        step = jnp.where(delta > 0, 1, -1).astype(jnp.int32)

        # Along either axis: the first border on the way, cell sides of the segment per cell side, and borders to cut.
        border = first + (delta > 0).astype(jnp.int32)
        along = length / jnp.where(delta == 0, 1.0, delta)
        num_cuts = jnp.abs(last - first)

        # Where the last state before the end lies, in cell sides from the start; 0 if there is none.
        last_state = jnp.where(
            length > DIAGONAL_SIDES, jnp.ceil(length * (1 - TOUCH_CELLS)) - 1, 0.0
        )
        # All that `next_cut` takes, for each axis.
        x, y = zip(border, step, start, along, num_cuts, strict=True)
        step_x, step_y = step

        def next_cut(num_passed: Array, axis: tuple[Array, ...]) -> Array:
            """Return how far along the segment the next border of an axis is cut; inf if all of them are passed."""
            border, step, start, along, num_cuts = axis
            next_border = (border + step * num_passed).astype(start.dtype)
            return jnp.where(num_passed < num_cuts, (next_border - start) * along, jnp.inf)

        def is_under_way(walk: tuple[Array, ...]) -> Array:
            """Return whether a border is left to pass on a segment that is not blocked so far."""
            num_x, num_y, _, total = walk
            return ((num_x < num_cuts[0]) | (num_y < num_cuts[1])) & jnp.isfinite(total)

        def go_on(walk: tuple[Array, ...]) -> tuple[Array, ...]:
            """Add the cost of the part up to the next cut.

            The walk holds how many borders of x and of y are passed, how many cell sides of the segment lie behind, and
            the cost so far.
            """
            num_x, num_y, behind, total = walk
            next_x, next_y = next_cut(num_x, x), next_cut(num_y, y)
            ahead = jnp.minimum(jnp.minimum(next_x, next_y), length)

            # How much of the segment counts in this part's cell: its length under `line`, its states under `cell`.
            if is_line:
                share = ahead - behind
            else:
                # A state on a border belongs to the cell it came through.
                before, by_now = (
                    jnp.clip(jnp.floor(sides + TOUCH_CELLS), 0, last_state)
                    for sides in (behind, ahead)
                )
                share = by_now - before  # number of states on the part

            # The cell of this part, and its cost.
            col, row = first[0] + step_x * num_x, first[1] + step_y * num_y
            here = cost_at(col, row)
            # The inner `where` keeps 0 times inf, which is NaN, out of the sum.
            total += jnp.where(
                jnp.isinf(here), jnp.inf, share * jnp.where(jnp.isinf(here), 0.0, here)
            )

            # A corner is passed along both axes at once; blocked cells on both sides of it leave no gap.
            is_corner = jnp.abs(next_x - next_y) < TOUCH_CELLS
            beside = jnp.minimum(cost_at(col, row + step_y), cost_at(col + step_x, row))
            is_pinched = is_corner & jnp.isinf(beside) & ~jnp.asarray(passes_corners)
            num_x += (is_corner | (next_x < next_y)).astype(jnp.int32)
            num_y += (is_corner | (next_y < next_x)).astype(jnp.int32)
            return num_x, num_y, ahead, jnp.where(is_pinched, jnp.inf, total)

        # From cut to cut, and once more after the last cut for the part that leads to the end.
        none = jnp.zeros_like(num_cuts[0])
        begin = none, none, jnp.zeros_like(length), per_side * length
        *_, total = go_on(lax.while_loop(is_under_way, go_on, begin))
        return jnp.where(length > 0, total if is_line else total + cost_at(*last), 0.0)

    return jax.vmap(cost)(start, end)
