"""The highest of the cells that straight lines home touch, from every cell of a grid, exactly.

``Y, X`` cells, ``C`` corners of cells. Places are in cells from the southwest corner. A cell counts for a line that
touches its square, be it by a side or a corner alone; beyond the grid there is nothing.

The lines from a cell are those from anywhere in its square. The cells that they touch are those that the four lines
from the square's corners touch: between two of these lines, one side of a square apart at most, no square has room. So
it is corners that are computed, each once.

Corners that lie farther east of home than north or south of it (and by turning the grid, all others) are computed
together, one line of corners from south to north after the other. A line home from such a corner climbs or falls by a
cell at most from one of these lines to the next, so that every cell that it touches has a side on one of them where the
line passes. Rays from home, less than a quarter of a cell apart, carry the highest cell so far. Two of them, on either
side of a corner's line, pass all cells that it touches, and it touches all cells that both pass: where these have the
same maximum, that is the answer. Only for the few other corners, at the edges of what is high, the line itself is
followed.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.tolerances import SAME_LENGTH

RAYS_PER_CELL = 8  # at the grid's border, at least: more leave fewer corners to follow, and take longer themselves
BESIDE = 1e-3  # of the way from ray to ray: a corner so little beyond a ray is on it, and takes the one before
CORNERS_AT_ONCE = 2**14  # whose lines are followed together


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
            corners = np.maximum(corners, _highest_east(top_m, row, col))
            row, col = top_m.shape[1] - col, row
            top_m, corners = np.rot90(top_m), np.rot90(corners)
    rows = np.maximum(corners[1:], corners[:-1])
    return np.maximum(rows[:, 1:], rows[:, :-1])


def _highest_east(
    top_m: Float[np.ndarray, "Y X"], row: float, col: float
) -> Float[np.ndarray, "Y+1 X+1"]:
    """Return the highest top on the line home from each corner to the east of home, -inf of the others."""
    # The higher of the cells west and east of each line of corners, with nothing beyond the grid.
    padded = np.pad(top_m.T, 1, constant_values=-np.inf)
    sides = jnp.asarray(np.maximum(padded[1:], padded[:-1]))
    highest = np.array(_swept(sides, row, col))
    is_open = np.isnan(highest)
    corners = np.argwhere(is_open)
    filled = np.pad(corners, [(0, -len(corners) % CORNERS_AT_ONCE), (0, 0)], mode="edge")
    groups = filled.reshape(-1, CORNERS_AT_ONCE, 2)
    followed = [np.asarray(_followed(sides, row, col, group)) for group in groups]
    highest[is_open] = np.append([], followed)[: len(corners)]
    return highest.T


@jax.jit
def _swept(sides: Float[Array, "X+1 Y+2"], row: Array, col: Array) -> Float[Array, "X+1 Y+1"]:
    """Return the highest top on the line home from each corner to the east, NaN where rays leave it open."""
    num_lines, num_rows = sides.shape
    per_slope = RAYS_PER_CELL * num_lines
    slope = jnp.arange(-1, 2 * per_slope + 3) / per_slope - 1
    corner_row = jnp.arange(num_rows - 1)

    def advance(line, state):
        """Carry the rays to the next line of corners, and see what those around each corner say."""
        passed, passed_by_both, corners = state
        run = line - col
        ray_row = _index(row + slope * run)
        top = sides[line, ray_row]
        passed = jnp.maximum(passed, top)
        is_of_both = ray_row[2:] == ray_row[:-2]
        passed_by_both = jnp.where(is_of_both, jnp.maximum(passed_by_both, top[2:]), passed_by_both)

        corner_slope = (corner_row - row) / run
        ray = jnp.ceil((corner_slope + 1) * per_slope + 1 - BESIDE).astype(int) - 1
        highest = jnp.maximum(passed[ray], passed[ray + 2])
        values = jnp.where(highest == passed_by_both[ray], highest, jnp.nan)
        values = jnp.where(jnp.abs(corner_slope) <= 1, values, -jnp.inf)
        return passed, passed_by_both, corners.at[line].set(values)

    shapes = (len(slope), len(slope) - 2, (num_lines, num_rows - 1))
    start = tuple(jnp.full(shape, -jnp.inf, sides.dtype) for shape in shapes)
    return lax.fori_loop(jnp.floor(col).astype(int) + 1, num_lines, advance, start)[-1]


@jax.jit
def _followed(
    sides: Float[Array, "X+1 Y+2"], row: Array, col: Array, corners: Int[Array, "C 2"]
) -> Float[Array, " C"]:
    """Return the highest top on the line home from each of some corners (line and row), which is followed."""
    last, corner_row = corners.T
    slope = (corner_row - row) / (last - col)

    def advance(line, highest):
        """Take in the cells that lines touch where they cross a line of corners."""
        at = row + slope * (line - col)
        below = sides[line, _index(jnp.ceil(at - SAME_LENGTH) - 1)]
        top = jnp.maximum(below, sides[line, _index(at + SAME_LENGTH)])
        return jnp.where(line <= last, jnp.maximum(highest, top), highest)

    start = jnp.full(len(corners), -jnp.inf, sides.dtype)
    return lax.fori_loop(jnp.floor(col).astype(int) + 1, last.max() + 1, advance, start)


def _index(row: Array) -> Array:
    """Return the index of the cell that holds a row, in lines with a cell more at either end, for all beyond."""
    return jnp.maximum(jnp.floor(row).astype(int) + 1, 0)  # beyond the north JAX takes the last
