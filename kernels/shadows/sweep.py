"""How high the roofs' shadow reaches above every cell, in JAX: a sweep along digital lines, and doubling along them.

The sweep is the definition, with derivatives; `jaxurban.kernels.shadows.blocks` casts it over grids of any shape. Row
after row, it suits a CPU. On anything wider runs doubling, with no loop over rows. Each pass doubles how far every
cell has looked along its line: ``M_0 = raised`` and ``M_{j+1}[p] = max(M_j[p], M_j[p + 2^j steps] - 2^j x drop)``; the
shadow is ``M_J[p + 1 step] - drop``. A pass is one operation over all cells and directions; a CPU, which does one cell
after the other, is some 30 times slower with it.

The lines are the same, and so are the answers but for rounding: the sweep takes the drop off row by row, doubling a
multiple of it at once. Heights differ by less than 1e-3 m in float32, and a cell's answer only where its receiver
stands within that of a shadow's edge.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, UInt

from jaxurban.programs import kept_jit

WORD_BITS = 32  # satellites in one word of a visibility mask

# A ray is taken to meet a cell's roof this share of a step before the cell's centre line. Of 0 (the centre),
# 0.2 to 0.4 and 0.5 (the near edge), tried against Embree on Lower Manhattan at 5 m, 20 m up: 0 misses 8 to
# 12 % of the blocked results, 0.5 breaks up to 1.1 % of the clear ones, 0.25 misses 7 to 9 % and breaks 0.8 %.
# Boston, which had no part in the choice, orders them alike.
ENTRY_STEPS = 0.25
# Satellites that a GPU casts together, in 64 bytes for each over a cell.
TOGETHER = 4

NORTH, SOUTH, EAST, WEST = range(4)
Shape = tuple[int, int]  # rows and columns of a grid
Window = tuple[int, int, int, int]  # first and end row, first and end column


class DigitalLine(NamedTuple):
    """The digital line of one direction over one grid.

    Attributes:
      shifts: ``[max(Y, X)]`` int32 -1, 0 or 1: sideways cells from each row (column, for east and
        west) to the next one toward the source; the tail is not used.
      drop_m: float64 height that a ray gains from one row (column) to the next.
      heading: the axis swept, and toward where: `NORTH`, `SOUTH`, `EAST` or `WEST`.
      toward: ``[2]`` int32 rows and columns toward the source: 1 north and east, due ones too, or -1.
    """

    shifts: np.ndarray
    drop_m: np.ndarray
    heading: np.ndarray
    toward: np.ndarray


class Ring(NamedTuple):
    """``max(raised, sweep)`` on the ring of cells around a grid, -inf where nothing is handed on.

    Attributes:
      south, north: ``[X + 2]`` rows, corners included.
      west, east: ``[Y]`` columns.
    """

    south: Array | np.ndarray
    north: Array | np.ndarray
    west: Array | np.ndarray
    east: Array | np.ndarray


def digital_line(
    azimuth_rad: float,
    elevation_rad: float,
    resolution_m: float,
    first_row: int,
    first_col: int,
    shape: Shape,
) -> DigitalLine:
    """Return the digital line toward a source, computed in float64 on the host.

    The line's phase comes from the global row (column) number, so it runs through the same cells
    whatever part of the grid is looked at.

    Args:
      azimuth_rad: direction of the source, clockwise from grid north.
      elevation_rad: its height above the horizon, in (-pi/2, pi/2]; at the zenith nothing shadows.
      resolution_m: side of a cell.
      first_row: global number of the southernmost row.
      first_col: global number of the westernmost column.
      shape: rows and columns of the grid.
    """
    east, north = math.sin(azimuth_rad), math.cos(azimuth_rad)

    # The line is swept along the axis that it is nearer to, a row (column) a step.
    is_rows = abs(north) >= abs(east)
    if is_rows:
        along, across = north, east
        heading = NORTH if north > 0 else SOUTH
        index = first_row + np.arange(shape[0])
    else:
        along, across = east, north
        heading = EAST if east > 0 else WEST
        index = first_col + np.arange(shape[1])
    ahead = 1 if along > 0 else -1

    # Cells sideways at each row (column) and at the next one toward the source; shifts are their differences.
    offset = np.floor(across / along * np.stack([index, index + ahead]) + 0.5)
    shifts = np.zeros(max(shape), np.int32)
    shifts[: len(index)] = offset[1] - offset[0]
    drop_m = resolution_m / abs(along) * math.tan(elevation_rad)
    toward = [1 if north >= 0 else -1, 1 if east >= 0 else -1]
    return DigitalLine(
        shifts, np.asarray(drop_m), np.asarray(heading, np.int32), np.asarray(toward, np.int32)
    )


def digital_lines(
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    resolution_m: float,
    first_row: int,
    first_col: int,
    shape: Shape,
) -> list[DigitalLine]:
    """Return the `digital_line` of every direction, ``[S]`` azimuths and elevations; other arguments as there."""
    angles = zip(np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float), strict=True)
    return [digital_line(*pair, resolution_m, first_row, first_col, shape) for pair in angles]


def stacked(lines: Sequence[DigitalLine]) -> DigitalLine:
    """Return lines over one grid as one `DigitalLine`, fields stacked along ``S``; no lines give fields of length 0."""
    if not lines:
        return DigitalLine(
            np.zeros((0, 0), np.int32),
            np.zeros(0),
            np.zeros(0, np.int32),
            np.zeros((0, 2), np.int32),
        )
    return DigitalLine(*(np.stack(values) for values in zip(*lines, strict=True)))


def _sweep_rows(raised_m: Array, shifts: Array, drop_m: Array, toward_last: bool) -> Array:
    """Return `sweep` for a source beyond the last row (the first, if not ``toward_last``), ``[Y, X]``.

    Args:
      raised_m: ``[Y, X]`` tops, raised by what the line gains before it meets them.
      shifts: ``[>= Y]`` as in `DigitalLine`.
      drop_m: height that a ray gains from one row to the next.
      toward_last: whether the source is beyond the last row.
    """
    num_cols = raised_m.shape[1]

    def step(beyond_m, row):
        """Cast the row toward the source onto one row, and return what that row hands on, and its shadow."""
        row_raised_m, shift = row
        shadow_m = lax.dynamic_slice(beyond_m, (1 + shift,), (num_cols,)) - drop_m
        return beyond_m.at[1:-1].set(jnp.maximum(row_raised_m, shadow_m)), shadow_m

    # One cell more on each side, for the shifts.
    nothing = jnp.full(num_cols + 2, -jnp.inf, raised_m.dtype)
    _, shadow_m = lax.scan(
        step, nothing, (raised_m, shifts[: raised_m.shape[0]]), reverse=toward_last
    )
    return shadow_m


@kept_jit
def sweep(raised_m: Float[Array, "Y X"], line: DigitalLine) -> Float[Array, "Y X"]:
    """Return the maximum over the cells beyond each cell on its line of (raised - steps x drop), ``[Y, X]``.

    Nothing stands outside the grid: the maximum over no cell is -inf. To go on from neighbouring
    grids bit for bit, give their ``max(raised, sweep)`` as a ring of one cell around this grid, and
    drop the ring from the result.

    Args:
      raised_m: tops, raised by what the line gains before it meets them.
      line: from `digital_line`, for the same shape.
    """
    drop_m = jnp.asarray(line.drop_m, raised_m.dtype)
    shifts = jnp.asarray(line.shifts)
    # NORTH, SOUTH, EAST, WEST: for the last two columns become rows and back.
    return lax.switch(
        line.heading,
        [
            lambda raised: _sweep_rows(raised, shifts, drop_m, True),
            lambda raised: _sweep_rows(raised, shifts, drop_m, False),
            lambda raised: _sweep_rows(raised.T, shifts, drop_m, True).T,
            lambda raised: _sweep_rows(raised.T, shifts, drop_m, False).T,
        ],
        raised_m,
    )


@kept_jit
def shadow_height(top_m: Float[Array, "Y X"], line: DigitalLine) -> Float[Array, "Y X"]:
    """Return the height below which each cell's centre does not see the source, ``[Y, X]``.

    ``S = max over the cells on the ray of (top - run x tan(elevation))``, the cell itself left out:
    a receiver at absolute height ``h`` sees the source where ``S <= h``. S is -inf where the line meets
    no cell. One pass over the cells serves all heights, and one compiled program serves every direction
    on grids of one shape.

    The ray is replaced by a digital line that stays within one cell of it and enters cells
    `ENTRY_STEPS` before their centre.

    S follows one cell's top, less the ray's climb: its derivative by that top is 1, by all others 0
    (where several tie, JAX shares it), and by the elevation it is that of the climb.

    Args:
      top_m: absolute height of roofs and bare ground, row 0 in the south.
      line: from `digital_line`, for the same shape.
    """
    return sweep(_raised(top_m, line), line)


def _raised(top_m: Array, line: DigitalLine) -> Array:
    """Return tops, raised by what a line gains before it meets them."""
    return top_m + ENTRY_STEPS * jnp.asarray(line.drop_m, top_m.dtype)


def doubled(raised_m: Array, line: DigitalLine, passes: int) -> Array:
    """Return `sweep` of one direction, looking ``2^passes`` rows (columns) far, by doubling (see the top of this file).

    Args:
      raised_m: ``[Y, X]`` tops, raised by what the line gains before it meets them.
      line: from `digital_line`, for the same shape; its fields may be traced, heading too.
      passes: what stands farther shadows nothing.
    """
    num_rows, num_cols = raised_m.shape
    row = lax.broadcasted_iota(jnp.int32, raised_m.shape, 0)
    col = lax.broadcasted_iota(jnp.int32, raised_m.shape, 1)
    is_rows = (line.heading == NORTH) | (line.heading == SOUTH)
    is_forward = (line.heading == NORTH) | (line.heading == EAST)
    ahead = jnp.where(is_forward, 1, -1)

    # Sums of shifts give how many cells the line has moved sideways by each row (column).
    shifts = jnp.asarray(line.shifts)
    summed = jnp.cumsum(shifts)
    # Up to a constant, which cancels.
    offsets = jnp.where(is_forward, summed - shifts, -summed)
    drop_m = jnp.asarray(line.drop_m, raised_m.dtype)

    # Each cell's place along the axis that is swept and across it; one program serves both axes.
    along = jnp.where(is_rows, row, col)
    across = jnp.where(is_rows, col, row)
    length = jnp.where(is_rows, num_rows, num_cols)
    width = jnp.where(is_rows, num_cols, num_rows)
    here = offsets[along]

    def beyond(values_m: Array, steps: int) -> Array:
        """Return the values ``steps`` further along each cell's line, less what a ray gains; -inf beyond the grid."""
        there = along + ahead * steps
        side = across + offsets[jnp.clip(there, 0, length - 1)] - here
        is_inside = (there >= 0) & (there < length) & (side >= 0) & (side < width)
        cell = jnp.where(is_rows, there * num_cols + side, side * num_cols + there)
        reached_m = values_m.reshape(-1)[jnp.where(is_inside, cell, 0)]
        return jnp.where(is_inside, reached_m - steps * drop_m, -jnp.inf)

    # After pass k each cell has the highest of 2^(k + 1) cells from itself on; last, the cell itself is left out.
    highest_m = raised_m
    for k in range(passes):
        highest_m = jnp.maximum(highest_m, beyond(highest_m, 1 << k))
    return beyond(highest_m, 1)


def shadow_heights(
    top_m: Float[Array, "Y X"], lines: DigitalLine, window: Window
) -> Float[Array, "S y x"]:
    """Return `shadow_height` toward every satellite in a window of the grid, ``[S, y, x]``.

    A shadow follows the one top that throws it: its derivative by that top is 1, by every other top 0 (where two tie,
    JAX shares it), and by the ray's climb per row it is minus the number of rows between. The reverse mode sweeps again
    satellite by satellite, so it keeps no rows but those of one sweep; a hand-written rule was tried and was no faster.

    Args:
      top_m: absolute height of roofs and bare ground, row 0 in the south.
      lines: lines of all satellites over this grid, fields stacked along ``S``.
      window: first and end row, first and end column.
    """
    forms = (partial(form, window=window) for form in (heights_by_sweep, heights_by_doubling))
    by_sweep, by_doubling = (jax.checkpoint(form) for form in forms)
    return lax.platform_dependent(top_m, lines, cpu=by_sweep, default=by_doubling)


def heights_by_sweep(top_m: Array, lines: DigitalLine, window: Window) -> Array:
    """Return `shadow_heights`, by the form for a CPU."""
    cast = jax.checkpoint(lambda top_m, line: shadow_height(top_m, line)[_kept(window)])
    return lax.scan(lambda _, line: (None, cast(top_m, line)), None, lines)[1]


def heights_by_doubling(top_m: Array, lines: DigitalLine, window: Window) -> Array:
    """Return `shadow_heights`, by the form for a GPU."""
    return jax.vmap(partial(_height_by_doubling, top_m))(lines)[:, *_kept(window)]


def heights_in_rounds(top_m: Array, lines: DigitalLine, window: Window) -> Array:
    """Return `shadow_heights` where nobody differentiates: a GPU casts `TOGETHER` satellites at once."""

    def by_doubling(top_m: Array, lines: DigitalLine) -> Array:
        def cast(line: DigitalLine) -> Array:
            return _height_by_doubling(top_m, line)[_kept(window)]

        return lax.map(cast, lines, batch_size=TOGETHER)

    by_sweep = partial(heights_by_sweep, window=window)
    return lax.platform_dependent(top_m, lines, cpu=by_sweep, default=by_doubling)


def _height_by_doubling(top_m: Array, line: DigitalLine) -> Array:
    """Return `shadow_height`, by doubling."""
    passes = math.ceil(math.log2(max(2, *top_m.shape)))  # along the longer side
    return doubled(_raised(top_m, line), line, passes)


def _kept(window: Window) -> tuple[slice, slice]:
    return slice(*window[:2]), slice(*window[2:])


@partial(kept_jit, static_argnames=("window",))
def words_along_lines(
    top_m: Float[Array, "Y X"],
    height_m: Float[Array, "A ..."],
    lines: DigitalLine,
    num: Int[Array, ""],
    *,
    window: Window,
) -> UInt[Array, "W A y x"]:
    """Return visibility words: satellite ``s``, bit ``s % 32`` of word ``s // 32``, is seen where no shadow reaches.

    Args:
      top_m: absolute height of roofs and bare ground.
      height_m: ``[A, y, x]`` absolute height of the receivers, or ``[A, 1, 1]``.
      lines: of all satellites, fields stacked along ``S``.
      num: number of satellites; the lines behind them fill up, and are never seen.
      window: of the receivers, as for `shadow_heights`.
    """
    by_sweep = partial(words_by_sweep, window=window)
    by_doubling = partial(words_by_doubling, window=window)
    return lax.platform_dependent(top_m, height_m, lines, num, cpu=by_sweep, default=by_doubling)


def words_by_sweep(
    top_m: Array, height_m: Array, lines: DigitalLine, num: Array, window: Window
) -> Array:
    """Return `words_along_lines`, by the form for a CPU: satellite by satellite, without the lines that fill up."""

    def cast(some: DigitalLine) -> Array:
        return shadow_height(top_m, jax.tree.map(lambda values: values[0], some))[None]

    return _words(cast, height_m, lines, num, window, num, 1)


def words_by_doubling(
    top_m: Array, height_m: Array, lines: DigitalLine, num: Array, window: Window
) -> Array:
    """Return `words_along_lines`, by the form for a GPU: `TOGETHER` satellites at once, whose shadows then go."""
    cast = jax.vmap(partial(_height_by_doubling, top_m))
    together = math.gcd(TOGETHER, len(lines.heading))
    num_rounds = len(lines.heading) // together
    return _words(cast, height_m, lines, num, window, num_rounds, together)


def _words(
    cast: Callable[[DigitalLine], Array],
    height_m: Array,
    lines: DigitalLine,
    num: Array,
    window: Window,
    num_rounds: Array | int,
    together: int,
) -> Array:
    """Return `words_along_lines`, of satellites that are cast and packed in rounds.

    Args:
      cast: returns the `shadow_height` of each of some lines.
      height_m, lines, num, window: as for `words_along_lines`.
      num_rounds: how many rounds there are.
      together: satellites of a round, a divisor of `WORD_BITS`.
    """

    def mark(number: Array, words: Array) -> Array:
        """Add the bits of a round to the words ``[W, A, y, x]``; every bit is added once, so adding sets it."""
        first = number * together
        some = jax.tree.map(lambda all_: lax.dynamic_slice_in_dim(all_, first, together), lines)
        satellite = (first + jnp.arange(together))[:, None, None, None]
        shadow_m = cast(some)[:, None, *_kept(window)]
        seen = (shadow_m <= height_m[None]) & (satellite < num)
        bits = seen.astype(jnp.uint32) << (satellite % WORD_BITS).astype(jnp.uint32)
        return words.at[first // WORD_BITS].add(jnp.sum(bits, axis=0, dtype=jnp.uint32))

    rows, cols = _kept(window)
    shape = len(height_m), rows.stop - rows.start, cols.stop - cols.start
    num_words = max(1, -(-len(lines.heading) // WORD_BITS))
    return lax.fori_loop(0, num_rounds, mark, jnp.zeros((num_words, *shape), jnp.uint32))
