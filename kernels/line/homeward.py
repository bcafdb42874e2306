"""The highest of the cells that straight lines home touch, from every cell of a grid, exactly.

``Y, X`` cells, ``N`` lines of corners. Places are in cells from the southwest corner. A cell counts for a line that
touches its square, be it by a side or a corner alone; beyond the grid there is nothing.

The lines from a cell are those from anywhere in its square. The cells that they touch are those that the four lines
from the square's corners touch: between two of these lines, one side of a square apart at most, no square has room. So
it is corners that are computed, each once.

Corners that lie farther east of home than north or south of it (and by turning the grid, all others) are computed
together. A line home from such a corner climbs or falls by a cell at most from one line of corners, from south to
north, to the next: so every cell that it touches has a side on one of these where it passes. One value is gathered
there: of the cells on both sides, and where it passes a corner, of all four around that.

Two rays from home around each corner settle most of them without following their lines, and took a third to a sixth of
the time, but more than twice the code.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxurban.kernels.blocks import rounded_up
from jaxurban.kernels.tolerances import SAME_LENGTH
from jaxurban.programs import kept_jit

LINES_AT_ONCE = 8  # of corners


def highest_homeward(
    top_m: Float[np.ndarray, "Y X"], home: tuple[float, float]
) -> Float[np.ndarray, "Y X"]:
    """Return the highest top of all cells that are touched by a straight line home from anywhere in each cell.

    Args:
      top_m: float32, inf where it is not known; no NaN.
      home: row and column of a place in the grid, not whole: (0.5, 0.5) is the centre of the southwest cell.
    """
    row, col = home
    near = [slice(max(math.ceil(at) - 1, 0), math.floor(at) + 1) for at in home]
    corners = np.full(np.add(top_m.shape, 1), top_m[*near].max())
    with jax.enable_x64(True):
        for _ in range(4):  # to each side; after the fourth turn all is as it was
            # On each line of corners the highest west and east of it: of a cell, of that and the next one north, ...
            padded = np.pad(top_m.T, 1, constant_values=-np.inf)
            sides = np.maximum(padded[1:], padded[:-1])
            both = np.maximum(sides[:, 1:], sides[:, :-1])
            cells = np.stack([sides[:, :-1], both], axis=-1).reshape(len(sides), -1)
            corners = np.maximum(corners, np.asarray(_highest_east(cells, row, col)).T)
            row, col = top_m.shape[1] - col, row
            top_m, corners = np.rot90(top_m), np.rot90(corners)
    rows = np.maximum(corners[1:], corners[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


@kept_jit
def _highest_east(cells: Float[Array, "N 2*Y+2"], row: Array, col: Array) -> Float[Array, "N Y+1"]:
    """Return the highest on the line home from each corner that lies east of home, -inf of the others.

    Args:
      cells: on each line of corners, beginning south of the grid: of a cell, then of that and the next one.
      row, col: of home.
    """
    num_lines, num_places = cells.shape
    corner_row = jnp.arange(num_places // 2, dtype=row.dtype)[None]
    first = jnp.floor(col).astype(int) + 1

    def of_corners(line):
        """Return the highest on the line home from each corner of some lines of corners, ``[B, 1]``."""
        slope = (corner_row - row) / (line.astype(col.dtype) - col)

        def advance(crossed, highest):
            """Take in what the lines home touch where they cross a line of corners."""
            at = row + slope * (crossed.astype(col.dtype) - col)
            place = jnp.floor(at + SAME_LENGTH) + jnp.ceil(at - SAME_LENGTH) + 1
            top = jnp.take(cells[crossed], place.astype(int), mode="clip")
            return jnp.where(crossed <= line, jnp.maximum(highest, top), highest)

        nothing = jnp.full(slope.shape, -jnp.inf, cells.dtype)
        highest = lax.fori_loop(first, line.max() + 1, advance, nothing)
        return jnp.where(jnp.abs(slope) <= 1 + SAME_LENGTH, highest, nothing)

    lines = jnp.arange(rounded_up(num_lines, LINES_AT_ONCE)).reshape(-1, LINES_AT_ONCE, 1)
    return lax.map(of_corners, lines).reshape(-1, corner_row.size)[:num_lines]
