"""Shadows over a grid of any shape by one compiled program of a CPU: in square blocks that hand on to each other.

A block is cast with what its neighbours toward the source hand on as a ring around it, so its answers are those of the
whole grid, to the bit. For each quadrant of the sky the first block lies in the grid's corner toward the source; the
last ones may stick out of it on the other side, where nothing looks. Satellites are cast `AT_ONCE`, and fewer fill up.

Legend: ``S`` satellites, ``W`` words, ``A`` altitudes, ``Y, X`` cells of the grid, ``y, x`` receivers, ``T`` side of a
block.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, UInt

from jaxurban.kernels.blocks import LARGE, SMALL, part_of
from jaxurban.kernels.shadows.sweep import (
    ENTRY_STEPS,
    NORTH,
    SOUTH,
    WORD_BITS,
    DigitalLine,
    Ring,
)
from jaxurban.programs import kept_jit

AT_ONCE = 8  # satellites of a call


class Roofs(NamedTuple):
    """What throws shadows in a block.

    Attributes:
      top_m: ``[T, T]`` absolute height of roofs and bare ground.
      turned_m: the same for lines that head east or west; None where that is ``top_m``.
      entry_steps: share of a step before a cell's middle at which a ray meets its roof.
    """

    top_m: Float[Array | np.ndarray, "T T"]
    turned_m: Float[Array | np.ndarray, "T T"] | None
    entry_steps: Float[Array | np.ndarray, ""]


class Receivers(NamedTuple):
    """Where a grid's receivers stand.

    Attributes:
      first_cell: row and column of the southwest cell of their region.
      every: n: they stand in every n-th cell of it both ways, from ``n // 2`` on.
      ground_m: ``[Y', X']`` elevation of the region's cells; None for flat ground.
      altitudes_m: ``[A]`` above the ground.
    """

    first_cell: tuple[int, int]
    every: int
    ground_m: Float[np.ndarray, "y x"] | None
    altitudes_m: Float[np.ndarray, " A"]


def mark_visible(
    words: UInt[np.ndarray, "W A y x"],
    top_m: Float[np.ndarray, "Y X"],
    receivers: Receivers,
    lines: DigitalLine,
    rings: Ring | None = None,
    *,
    entry_steps: float = ENTRY_STEPS,
    turned_top_m: Float[np.ndarray, "Y X"] | None = None,
) -> None:
    """Set the bit of every satellite in the visibility words of the receivers that see it.

    A receiver sees a satellite if the satellite's `jaxurban.kernels.shadows.sweep.shadow_height`, to the bit, is not
    above the receiver.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; altered.
      top_m: absolute height of roofs and bare ground.
      receivers: to which the words belong.
      lines: from `digital_line`, for the grid grown by one cell on each side, fields stacked along ``S``.
      rings: what the grids around this one hand on, fields stacked along ``S``; left out, nothing stands there.
      entry_steps: share of a step before a cell's middle at which a ray meets its roof.
      turned_top_m: the tops for lines that head east or west; left out, ``top_m``.
    """
    tops = _Tops(top_m, turned_top_m, entry_steps)
    for which in _bundles(lines):
        _walk(tops, lines, rings, which, receivers, words[which[0] // WORD_BITS])


def shadows_on_receivers(
    top_m: Float[np.ndarray, "Y X"],
    shape: tuple[int, int],
    receivers: Receivers,
    lines: DigitalLine,
    rings: Ring | None = None,
) -> Float[np.ndarray, "S y x"]:
    """Return how high each satellite's shadow reaches at the receivers, which `mark_visible` compares with theirs.

    Args:
      top_m, receivers, lines, rings: as for `mark_visible`; the receivers' altitudes do not matter.
      shape: rows and columns of receivers.
    """
    heights_m = np.full((len(lines.heading), *shape), -np.inf, top_m.dtype)
    for which in _bundles(lines):
        bundle_m = heights_m[which]
        _walk(_Tops(top_m), lines, rings, which, receivers, bundle_m)
        heights_m[which] = bundle_m
    return heights_m


def hand_on(
    top_m: Float[np.ndarray, "Y X"], lines: DigitalLine, rings: Ring
) -> tuple[Float[np.ndarray, "S X"], Float[np.ndarray, "S Y"]]:
    """Return ``max(raised, sweep)`` in a grid's last row and last column, those farthest from each satellite.

    The next grids take these as their rings. Arguments are those of `mark_visible`; no receivers stand in this grid.
    """
    num_rows, num_cols = top_m.shape
    num = len(lines.heading)
    rows = np.empty((num, num_cols), top_m.dtype)
    cols = np.empty((num, num_rows), top_m.dtype)
    nobody = Receivers((0, 0), 1, None, np.empty(0, top_m.dtype))
    no_words = np.empty((0, *top_m.shape), np.uint32)
    for which in _bundles(lines):
        walked = _walk(_Tops(top_m), lines, rings, which, nobody, no_words)
        rows[which], cols[which] = walked
    return rows, cols


class _Tops(NamedTuple):
    """The whole grid's `Roofs`, on the host."""

    top_m: np.ndarray
    turned_m: np.ndarray | None = None
    entry_steps: float = ENTRY_STEPS

    def block(self, corner: tuple[int, int], side: int) -> Roofs:
        """Return the roofs of a block from its southwest cell and its side in cells; beyond the grid nothing stands."""
        shape = side, side
        top_m = part_of(self.top_m, corner, shape, -np.inf)
        turned_m = None
        if self.turned_m is not None:
            turned_m = part_of(self.turned_m, corner, shape, -np.inf)
        return Roofs(top_m, turned_m, self.top_m.dtype.type(self.entry_steps))


def _bundles(lines: DigitalLine) -> Iterator[np.ndarray]:
    """Yield ``[n]`` numbers of satellites that are cast together: at most `AT_ONCE`, of one quadrant and one word."""
    toward = np.asarray(lines.toward)  # [S, 2] names each satellite's quadrant
    of_word = np.arange(len(toward)) // WORD_BITS
    keys = np.column_stack([of_word, toward])
    for key in np.unique(keys, axis=0):
        members = np.flatnonzero((keys == key).all(axis=1))
        yield from np.split(members, range(AT_ONCE, len(members), AT_ONCE))


def _side(shape: tuple[int, int], every: int) -> int:
    """Return the side of the blocks over a grid, in cells, of which each receiver has n both ways."""
    return every * (LARGE if every == 1 and max(shape) > 3 * SMALL else SMALL)


def _walk(
    tops: _Tops,
    lines: DigitalLine,
    rings: Ring | None,
    which: np.ndarray,
    receivers: Receivers,
    marked: UInt[np.ndarray, "A y x"] | Float[np.ndarray, "n y x"],
) -> tuple[np.ndarray, np.ndarray]:
    """Cast the shadows of satellites of one quadrant block by block, mark receivers, and return what is handed on.

    Blocks are visited from the source on, row of blocks by row of blocks, so that what a block's neighbours toward the
    source hand on is known before it is cast.

    Args:
      tops: what throws shadows.
      lines, rings, receivers: as in `mark_visible`.
      which: ``[n]`` numbers of the satellites, of one quadrant and one word.
      marked: of all receivers their word, or how high each satellite's shadow reaches there; altered.

    Returns:
      ``[n, X]`` and ``[n, Y]`` the grid's row, and column, farthest from the source (see `hand_on`).
    """
    shape = tops.top_m.shape
    dtype = tops.top_m.dtype
    num = len(which)
    side = _side(shape, receivers.every)
    marks_words = marked.dtype == np.uint32
    toward = tuple(int(ahead) for ahead in lines.toward[which[0]])  # 1 or -1, by axis

    # Where blocks begin, as far as receivers need them.
    ends = [
        first + size * receivers.every
        for first, size in zip(receivers.first_cell, marked.shape[1:], strict=True)
    ]
    row_starts, col_starts = (
        _starts(*axis, side) for axis in zip(shape, toward, receivers.first_cell, ends, strict=True)
    )
    bundle = _filled(lines, which)
    bits = np.zeros(AT_ONCE, np.uint32)
    bits[:num] = np.uint32(1) << (which % WORD_BITS).astype(np.uint32)

    # What is handed on to the first row and the first column of blocks.
    beyond_m = np.full((AT_ONCE, shape[1] + 2), -np.inf, dtype)  # the row toward the source
    beside_m = np.full((AT_ONCE, shape[0]), -np.inf, dtype)  # the column toward it
    if rings is not None:
        source_row_m = rings.north if toward[0] > 0 else rings.south
        source_col_m = rings.east if toward[1] > 0 else rings.west
        beyond_m[:num] = np.asarray(source_row_m)[which]
        beside_m[:num] = np.asarray(source_col_m)[which]
    cols_m = np.empty_like(beside_m)

    for row in row_starts:
        last_row, rows = _handed(row, side, shape[0], toward[0])
        # The row that this row of blocks hands on to the next, whose corner lies in the column toward the source.
        next_m = np.full_like(beyond_m, -np.inf)
        next_m[:, -1 if toward[1] > 0 else 0] = beside_m[:, row + last_row]
        side_m = part_of(beside_m, (0, row), (AT_ONCE, side), -np.inf)
        for col in col_starts:
            last_col, cols = _handed(col, side, shape[1], toward[1])
            ring = _ring(part_of(beyond_m, (0, col), (AT_ONCE, side + 2), -np.inf), side_m, toward)
            at = _Place(row, col, side, receivers)
            block = Block(
                tops.block((row, col), side),
                at.heights_m(dtype),
                _along(bundle, row, col, side),
                ring,
                bits,
                np.asarray(num, np.int32),
                at.phase,
                (np.int32(last_row), np.int32(last_col)),
            )
            marks, row_m, side_m = cast(block, every=receivers.every, marks_words=marks_words)
            at.mark(marked, marks)
            side_m = np.asarray(side_m)
            next_m[:, 1 + cols.start : 1 + cols.stop] = np.asarray(row_m)[
                :, cols.start - col : cols.stop - col
            ]
        cols_m[:, rows] = side_m[:, rows.start - row : rows.stop - row]
        beyond_m = next_m
    return beyond_m[:num, 1:-1], cols_m[:num]


def _starts(size: int, ahead: int, begin: int, end: int, side: int) -> list[int]:
    """Return where the blocks along one axis begin, the block nearest to the source first.

    Args:
      size: cells of the grid along the axis.
      ahead: 1 where the source is beyond the last cell, -1 where it is beyond the first.
      begin, end: first cell that needs an answer, and the one after the last; blocks beyond these are left out.
      side: of a block, in cells.
    """
    if ahead > 0:
        return [size - side * (k + 1) for k in range(-(-(size - begin) // side))]
    return [side * k for k in range(-(-end // side))]


def _handed(start: int, side: int, size: int, ahead: int) -> tuple[int, slice]:
    """Return which row (column) of a block hands on, and the grid's rows (columns) that the block holds."""
    inside = slice(max(start, 0), min(start + side, size))
    return (inside.start if ahead > 0 else inside.stop - 1) - start, inside


def _filled(lines: DigitalLine, which: np.ndarray) -> DigitalLine:
    """Return the lines of some satellites, filled up with the first of them."""
    chosen = np.resize(which, AT_ONCE)
    return DigitalLine(*(np.asarray(values)[chosen] for values in lines))


def _along(lines: DigitalLine, row: int, col: int, side: int) -> DigitalLine:
    """Return the parts of lines over a whole grid, grown by one cell, that a block with its ring meets."""
    is_rows = np.isin(lines.heading, (NORTH, SOUTH))
    by_row, by_col = (
        part_of(lines.shifts, (0, start), (AT_ONCE, side + 2), 0) for start in (row, col)
    )
    return lines._replace(shifts=np.where(is_rows[:, None], by_row, by_col))


def _ring(near_m: np.ndarray, side_m: np.ndarray, toward: tuple[int, ...]) -> Ring:
    """Return the ring of a block: only its row and column toward the source hold anything."""
    no_row_m, no_col_m = (np.full_like(values, -np.inf) for values in (near_m, side_m))
    rows = (no_row_m, near_m) if toward[0] > 0 else (near_m, no_row_m)
    cols = (no_col_m, side_m) if toward[1] > 0 else (side_m, no_col_m)
    return Ring(*rows, *cols)


class _Place(NamedTuple):
    """A block among the receivers of a grid."""

    row: int
    col: int
    side: int
    receivers: Receivers

    @property
    def phase(self) -> tuple[np.int32, np.int32]:
        """Row and column of the block's first receiver in it."""
        every = self.receivers.every
        row, col = ((every // 2 - start) % every for start in self.in_region)
        return np.int32(row), np.int32(col)

    @property
    def in_region(self) -> tuple[int, int]:
        """Row and column of the block's southwest cell in the region."""
        return self.row - self.receivers.first_cell[0], self.col - self.receivers.first_cell[1]

    def heights_m(self, dtype: np.dtype) -> np.ndarray:
        """Return the absolute height of the block's receivers, ``[A, T / n, T / n]``; ``[A, 1, 1]`` on flat ground.

        Beyond the region the ground counts as 0; no receiver is marked there.
        """
        z_m = self.receivers.altitudes_m.astype(dtype)[:, None, None]
        if self.receivers.ground_m is None:
            return z_m
        ground_m = part_of(self.receivers.ground_m, self.in_region, (self.side, self.side), 0)
        every = self.receivers.every
        size = self.side // every
        row, col = self.phase
        return ground_m[row::every, col::every][:size, :size] + z_m

    def mark(self, marked: np.ndarray, marks: Array) -> None:
        """Join a block's words ``[A, t, t]`` (OR) or shadows ``[n, t, t]`` (maximum) with the region's, in place."""
        # Row and column of the block's first receiver among the region's; may be negative.
        every = self.receivers.every
        size = self.side // every
        starts = [
            (int(start + phase) - every // 2) // every
            for start, phase in zip(self.in_region, self.phase, strict=True)
        ]
        # The region's receivers that the block holds.
        rows, cols = (
            slice(max(start, 0), max(0, min(start + size, num)))
            for start, num in zip(starts, marked.shape[1:], strict=True)
        )
        if rows.start < rows.stop and cols.start < cols.stop:
            inside = marked[:, rows, cols]
            join = np.bitwise_or if marked.dtype == np.uint32 else np.maximum
            here = np.asarray(marks)[
                : len(marked),
                rows.start - starts[0] : rows.stop - starts[0],
                cols.start - starts[1] : cols.stop - starts[1],
            ]
            join(inside, here, out=inside)


class Block(NamedTuple):
    """A block, and the satellites whose shadows are cast over it.

    Attributes:
      roofs: of the block.
      height_m: ``[A, t, t]`` absolute height of the receivers, or ``[A, 1, 1]``.
      lines: of the satellites over the block grown by one cell, fields stacked along ``S``.
      rings: what is handed on to the block, fields stacked along ``S``.
      bits: ``[S]`` of each satellite in the word.
      num: how many satellites there are; those behind fill up.
      phase: row and column of the first receiver.
      last: row and column that hand on.
    """

    roofs: Roofs
    height_m: Float[Array | np.ndarray, "A ..."]
    lines: DigitalLine
    rings: Ring
    bits: UInt[Array | np.ndarray, " S"]
    num: Int[Array | np.ndarray, ""]
    phase: tuple[np.int32, np.int32]
    last: tuple[np.int32, np.int32]


@partial(kept_jit, static_argnames=("every", "marks_words"))
def cast(
    block: Block, *, every: int = 1, marks_words: bool = True
) -> tuple[UInt[Array, "A t t"] | Float[Array, "S t t"], Float[Array, "S T"], Float[Array, "S T"]]:
    """Return the word of a block's receivers, and the row and the column that the block hands on.

    Satellites are cast one after the other; those that fill up are left out.

    Args:
      block: the block with its satellites.
      every: n: receivers stand in every n-th cell both ways.
      marks_words: False for the heights of the shadows instead of the word.

    Returns:
      ``[A, t, t]`` uint32 with the bits of the satellites seen, or ``[S, t, t]`` the height of each one's shadow at the
      receivers, -inf of those that fill up; ``[S, T]`` the row and ``[S, T]`` the column of
      ``max(raised, sweep)`` numbered by ``block.last``.
    """
    side = len(block.roofs.top_m)
    dtype = block.roofs.top_m.dtype
    # By `DigitalLine.heading`: NORTH, SOUTH, EAST, WEST.
    headings = [
        partial(form, block, every=every, toward_last=toward_last)
        for form in (_cast_along_rows, _cast_along_columns)
        for toward_last in (True, False)
    ]

    def add(k: Array, result: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Add satellite k to the marks, and what the block hands on for it."""
        marks, rows, cols = result
        line, ring = jax.tree.map(lambda values: values[k], (block.lines, block.rings))
        shadow_m, row_m, col_m = lax.switch(line.heading, headings, line, ring)
        if marks_words:
            seen = jnp.where(shadow_m[None] <= block.height_m, block.bits[k], jnp.uint32(0))
            marks = marks | seen
        else:
            marks = marks.at[k].set(shadow_m)
        return marks, rows.at[k].set(row_m), cols.at[k].set(col_m)

    size = side // every
    marks = jnp.full((len(block.bits), size, size), -jnp.inf, dtype)
    if marks_words:
        marks = jnp.zeros((len(block.height_m), size, size), jnp.uint32)
    edges = jnp.full((len(block.bits), side), -jnp.inf, dtype)
    return lax.fori_loop(0, block.num, add, (marks, edges, edges))


def _cast_along_rows(
    block: Block, line: DigitalLine, ring: Ring, *, every: int, toward_last: bool
) -> tuple[Array, Array, Array]:
    """Return the shadow of one satellite where receivers stand, and the row and the column that are handed on.

    This is `jaxurban.kernels.shadows.sweep.sweep` inside a ring, but keeps only the cells that are needed.

    Args:
      block: its roofs, the place of its receivers (``phase``) and what it hands on (``last``) are read.
      line: toward a source beyond the last row (the first, if not ``toward_last``).
      ring: what is handed on to the block.
      every: n, as in `cast`.
      toward_last: whether the source is beyond the last row.

    Returns:
      ``[t, t]`` the shadow's height at the receivers; ``[T]`` the row and ``[T]`` the column handed on.
    """
    top_m = jnp.asarray(block.roofs.top_m)
    side = len(top_m)
    drop_m = jnp.asarray(line.drop_m, top_m.dtype)
    gained_m = block.roofs.entry_steps * drop_m
    (first_row, first_col), (last_row, last_col) = block.phase, block.last

    def received(values_m: Array, first: Array | np.int32) -> Array:
        """Return every n-th value along the first axis, from ``first`` on: the rows (columns) with receivers."""
        if every == 1:
            return values_m
        return lax.dynamic_slice_in_dim(values_m, first, side - every + 1)[::every]

    def step(carry: Any, row: Any) -> tuple[Any, Any]:
        """Cast onto one row: the row toward the source, shifted along the lines and less the ray's climb."""
        beyond_m, handed_m = carry
        row_top_m, shift, west_m, east_m, number = row
        shadow_m = lax.dynamic_slice(beyond_m, (1 + shift,), (side,)) - drop_m
        carried_m = jnp.maximum(row_top_m + gained_m, shadow_m)
        handed_m = jnp.where(number == last_row, carried_m, handed_m)
        beyond_m = jnp.concatenate([west_m[None], carried_m, east_m[None]])
        return (beyond_m, handed_m), (received(shadow_m, first_col), carried_m[last_col])

    numbers = jnp.arange(side, dtype=jnp.int32)
    rows = top_m, line.shifts[1:-1], ring.west, ring.east, numbers
    start = ring.north if toward_last else ring.south, jnp.full(side, -jnp.inf, top_m.dtype)
    (_, row_m), (shadow_m, col_m) = lax.scan(step, start, rows, reverse=toward_last)
    return received(shadow_m, first_row), row_m, col_m


def _cast_along_columns(
    block: Block, line: DigitalLine, ring: Ring, *, every: int, toward_last: bool
) -> tuple[Array, Array, Array]:
    """Return what `_cast_along_rows` does, for a source beyond the last column (the first, if not ``toward_last``).

    The block and its ring are turned, so that columns become rows. Arguments and results are those of
    `_cast_along_rows`, of the block as it was before.
    """
    # Lines toward the east or west may see other roofs.
    roofs = block.roofs
    top_m = roofs.top_m if roofs.turned_m is None else roofs.turned_m
    turned = block._replace(
        roofs=roofs._replace(top_m=top_m.T, turned_m=None),
        phase=block.phase[::-1],
        last=block.last[::-1],
    )
    # Rows have the corners of a ring, columns do not.
    turned_ring = Ring(
        south=jnp.concatenate([ring.south[:1], ring.west, ring.north[:1]]),
        north=jnp.concatenate([ring.south[-1:], ring.east, ring.north[-1:]]),
        west=ring.south[1:-1],
        east=ring.north[1:-1],
    )
    received_m, col_m, row_m = _cast_along_rows(
        turned, line, turned_ring, every=every, toward_last=toward_last
    )
    return received_m.T, row_m, col_m
