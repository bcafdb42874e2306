"""The highest of the cells that straight lines home touch, from every cell of a grid, exactly.

``Y, X`` cells, ``R`` rays, ``C`` corners of cells. Places are in cells from the southwest corner. A cell counts for a
line that touches its square, be it by a side or a corner alone; beyond the grid there is nothing.

The lines from a cell are those from anywhere in its square. The cells that they touch are those that the four lines
from the square's corners touch: between two of these lines, one side of the square apart at most, no square has room.
So it is corners that are computed, each once.

Corners that lie farther east of home than north or south of it (and by turning the grid, all others) are computed
together, one line of corners from south to north after the other. A line home from such a corner climbs or falls by a
cell at most from one of these lines to the next, so that every cell that it touches has a side on one of them where the
line passes. Rays from home, less than half a cell apart, carry the highest cell so far, and between which slopes a line
home touches it. The two rays beside a corner pass all cells that its line touches: so where it touches the higher of
theirs, that is the answer. Only for the few other corners, at the edges of what is high, the line itself is followed.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.tolerances import SAME_LENGTH

RAYS_PER_CELL = 4  # at the grid's border, at least: more leave fewer corners to follow, and take longer themselves
BESIDE = 1e-3  # of the way from ray to ray: a corner so near to a ray is on it, and has the next ones beside it
CORNERS_AT_ONCE = 2**14  # whose lines are followed together


def highest_homeward(
    top_m: Float[np.ndarray, "Y X"], home: tuple[float, float]
) -> Float[np.ndarray, "Y X"]:
    """Return the highest top of all cells that are touched by a straight line home from anywhere in each cell.

    Args:
      top_m: float32, inf where it is not known; no NaN.
      home: row and column of a place in the grid, not whole: (0.5, 0.5) is the centre of the southwest cell.
    """
    near = [slice(max(math.ceil(at) - 1, 0), math.floor(at) + 1) for at in home]
    home_top = top_m[*near].max()  # of the cells that home touches
    corners = np.full(np.add(top_m.shape, 1), home_top)
    with jax.enable_x64(True):
        for step in (1, -1):  # to the east and the west, then to the north and the south
            for is_turned in (False, True):
                tops, places, (row, col) = top_m, corners, home
                if is_turned:
                    tops, places, (row, col) = tops.T, places.T, (col, row)
                if step < 0:
                    col = tops.shape[1] - col
                tops, places = tops[:, ::step], places[:, ::step]  # a view of the corners
                np.maximum(places, _highest_east(tops, home_top, row, col), out=places)
    rows = np.maximum(corners[1:], corners[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


def _highest_east(
    top_m: Float[np.ndarray, "Y X"], home_top: np.float32, row: float, col: float
) -> Float[np.ndarray, "Y+1 X+1"]:
    """Return the highest top on the line home from each corner; -inf of those that `_swept` leaves out."""
    # The higher of the cells west and east of each line of corners, with nothing beyond the grid.
    padded = np.pad(top_m.T, 1, constant_values=-np.inf)
    sides = jnp.asarray(np.maximum(padded[1:], padded[:-1]))
    highest = np.array(_swept(sides, home_top, row, col))
    at_col, at_row = np.nonzero(np.isnan(highest))
    for first in range(0, len(at_col), CORNERS_AT_ONCE):
        some = slice(first, first + CORNERS_AT_ONCE)
        lack = (0, max(0, first + CORNERS_AT_ONCE - len(at_col)))
        places = [np.pad(at[some], lack, mode="edge") for at in (at_col, at_row)]
        followed = _followed(sides, home_top, row, col, *places)
        highest[at_col[some], at_row[some]] = np.asarray(followed)[: len(at_col[some])]
    return highest.T


@jax.jit
def _swept(
    sides: Float[Array, "X+1 Y+2"], home_top: Array, row: Array, col: Array
) -> Float[Array, "X+1 Y+1"]:
    """Return the highest top on the line home from each corner, NaN where rays do not say.

    Corners that are nearer to home from west to east than from south to north, or west of it, have -inf.
    """
    num_lines, num_rows = sides.shape
    per_slope = RAYS_PER_CELL * num_lines
    slope = jnp.arange(-1, 2 * per_slope + 2) / per_slope - 1.0
    corner_row = jnp.arange(num_rows - 1)

    def advance(line, state):
        """Carry the rays to the next line of corners, and see what they say there."""
        highest, low, high, corners = state
        run = line - col
        ray_row = jnp.floor(row + slope * run)
        top = sides[line, _padded(ray_row, num_rows)]
        # Cells as high as the highest one join it: the ray touches both.
        starts_low = (ray_row - SAME_LENGTH - row) / run
        ends_high = (ray_row + 1 + SAME_LENGTH - row) / run
        is_new, is_same = top > highest, top == highest
        low = jnp.where(is_new, starts_low, jnp.where(is_same, jnp.minimum(low, starts_low), low))
        high = jnp.where(is_new, ends_high, jnp.where(is_same, jnp.maximum(high, ends_high), high))
        highest = jnp.maximum(highest, top)

        # The corners: the rays below and above each, and whether its line touches what is the highest on them.
        corner_slope = (corner_row - row) / run
        place = (corner_slope + 1.0) * per_slope + 1
        below = jnp.ceil(place - BESIDE).astype(int) - 1
        above = jnp.floor(place + BESIDE).astype(int) + 1
        most = jnp.maximum(highest[below], highest[above])
        is_touched = False
        for ray in (below, above):
            is_within = (low[ray] <= corner_slope) & (corner_slope <= high[ray])
            is_touched |= is_within & (highest[ray] == most)
        values = jnp.where(is_touched, most, jnp.nan)
        values = jnp.where(jnp.abs(corner_slope) <= 1, values, -jnp.inf)
        return highest, low, high, corners.at[line].set(values)

    start = (
        jnp.full(slope.shape, home_top),
        jnp.full(slope.shape, -jnp.inf),
        jnp.full(slope.shape, jnp.inf),
        jnp.full((num_lines, num_rows - 1), -jnp.inf, sides.dtype),
    )
    first = jnp.floor(col).astype(int) + 1
    return lax.fori_loop(first, num_lines, advance, start)[-1]


@jax.jit
def _followed(
    sides: Float[Array, "X+1 Y+2"],
    home_top: Array,
    row: Array,
    col: Array,
    at_col: Int[Array, " C"],
    at_row: Int[Array, " C"],
) -> Float[Array, " C"]:
    """Return the highest top on the line home from each of some corners, which is followed cell by cell."""
    slope = (at_row - row) / (at_col - col)

    def advance(line, highest):
        """Take in the cells that lines touch where they cross a line of corners."""
        line_row = row + slope * (line - col)
        for touched in (jnp.floor(line_row + SAME_LENGTH), jnp.ceil(line_row - SAME_LENGTH) - 1):
            top = sides[line, _padded(touched, sides.shape[1])]
            highest = jnp.where(line <= at_col, jnp.maximum(highest, top), highest)
        return highest

    first = jnp.floor(col).astype(int) + 1
    start = jnp.full(slope.shape, home_top)
    return lax.fori_loop(first, at_col.max() + 1, advance, start)


def _padded(row: Array, num_rows: int) -> Array:
    """Return the index of a row in an array with a row more at either end, which stands for all beyond."""
    return jnp.clip(row.astype(int) + 1, 0, num_rows - 1)
