"""The sweep on a CPU: the satellites of one heading in one pass over the visibility words.

Row by row from the source every satellite's shadow goes on, some columns at a time, and sets its bits in words that
stay in a core's cache until all satellites have; only then are they joined with those in memory. For lines that head
east or west the rows of the sweep are columns: strips of the grid are turned on the way in, their words on the way out.

Heights and answers are those of `jaxurban.kernels.shadows.sweep.shadow_height` to the bit.

Legend: ``S`` satellites, ``W`` words, ``A`` altitudes, ``Y, X`` cells of the surface, ``y, x`` of the region in it;
``R, C`` rows and columns of the surface as the sweep meets them, ``N`` satellites of its heading.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt

from jaxurban.kernels.compiled import compiled, on_host
from jaxurban.kernels.shadows.sweep import (
    EAST,
    ENTRY_STEPS,
    NORTH,
    SOUTH,
    WEST,
    WORD_BITS,
    Line,
    Ring,
)

STRIP = 16  # rows of a sweep at a time: columns of a cache line, where they are turned
COLUMNS = 1024  # of all satellites at a time: what they need fits a core's first cache
TURNED = 8  # cells that are turned together: a number known to the compiler, twice as fast as any


class _Bundle(NamedTuple):
    """The lines of one heading, and what comes in at the borders of the surface, as the sweep meets them.

    Attributes:
      number: ``[N]`` of each satellite.
      drop_m, entry_m: ``[N]`` height that a ray gains from row to row, and before it meets a roof; of the tops' type.
      shifts: ``[N, R]`` sideways cells from each row to the next one toward the source.
      near_m: ``[N, C + 2]`` max(raised, sweep) in the row beyond the surface, toward the source, corners included.
      left_m, right_m: ``[N, R]`` the same in the columns beside it.
    """

    number: np.ndarray
    drop_m: np.ndarray
    entry_m: np.ndarray
    shifts: np.ndarray
    near_m: np.ndarray
    left_m: np.ndarray
    right_m: np.ndarray


def mark_visible(
    words: UInt[np.ndarray, "W A y x"],
    top_m: Float[np.ndarray, "Y X"],
    ground_m: Float[np.ndarray, "y x"] | None,
    altitudes_m: Float[np.ndarray, " A"],
    lines: Line,
    first_cell: tuple[int, int] = (0, 0),
    rings: Ring | None = None,
    *,
    every: int = 1,
    entry_steps: float = ENTRY_STEPS,
    turned_top_m: Float[np.ndarray, "Y X"] | None = None,
) -> None:
    """Set the bit of every satellite in the visibility words where it is seen.

    It is seen where its `shadow_height` is not above the receiver, to the bit. A sweep stops where the region ends.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; altered.
      top_m: absolute height of roofs and bare ground.
      ground_m: terrain of the region; None for flat ground. Of the type of the tops, as the altitudes are.
      altitudes_m: heights above the ground.
      lines: from `digital_line`, for the surface grown by one cell on each side, fields stacked along ``S``.
      first_cell: row and column of the region's southwest cell in the surface.
      rings: what the grids around the surface hand on, fields stacked along ``S``; left out, nothing stands there.
      every: n: receivers stand in every n-th cell of the region both ways, from ``n // 2`` on; the words are theirs.
      entry_steps: share of a step before a cell's middle at which a ray meets its roof.
      turned_top_m: the tops for lines that head east or west; left out, those for all.
    """
    ground_m = np.empty((0, 0), top_m.dtype) if ground_m is None else ground_m
    for heading in np.unique(lines.heading):
        is_turned, toward_last = heading in (EAST, WEST), heading in (NORTH, EAST)
        tops = turned_top_m if is_turned and turned_top_m is not None else top_m
        bundle = _bundle(lines, heading, tops, rings, entry_steps)
        no_edges = np.empty((0, 2, 0), top_m.dtype)
        region = first_cell[::-1] if is_turned else first_cell
        surface = on_host(tops), on_host(ground_m)
        _sweep(
            words,
            *surface,
            altitudes_m,
            bundle,
            region,
            is_turned,
            toward_last,
            no_edges,
            no_edges,
            every,
        )


def hand_on(top_m: Float[np.ndarray, "Y X"], lines: Line, rings: Ring) -> Ring:
    """Return what a grid hands on to its neighbours: max(raised, sweep) in its outermost cells, stacked along ``S``.

    The rows are ``[S, X]`` here, a part of the neighbours' rings. Arguments as in `mark_visible`.
    """
    num, (num_rows, num_cols), dtype = len(lines.heading), top_m.shape, top_m.dtype
    rows, cols = np.empty((num, 2, num_cols), dtype), np.empty((num, 2, num_rows), dtype)
    no_words, no_altitudes_m = np.empty((0, 0, *top_m.shape), np.uint32), np.empty(0, dtype)
    surface = on_host(top_m), on_host(np.empty((0, 0), dtype))
    for heading in np.unique(lines.heading):
        is_turned, toward_last = heading in (EAST, WEST), heading in (NORTH, EAST)
        bundle = _bundle(lines, heading, top_m, rings)
        ends, sides = (cols, rows) if is_turned else (rows, cols)
        _sweep(
            no_words,
            *surface,
            no_altitudes_m,
            bundle,
            (0, 0),
            is_turned,
            toward_last,
            ends,
            sides,
            1,
        )
    return Ring(rows[:, 0], rows[:, 1], cols[:, 0], cols[:, 1])


def _bundle(
    lines: Line,
    heading: int,
    top_m: np.ndarray,
    rings: Ring | None,
    entry_steps: float = ENTRY_STEPS,
) -> _Bundle:
    """Return what a sweep needs of the lines of one heading and of the rings."""
    number = np.flatnonzero(lines.heading == heading)
    num_rows, num_cols = top_m.shape if heading in (NORTH, SOUTH) else top_m.shape[::-1]
    drop_m = lines.drop_m[number].astype(top_m.dtype)
    shifts = np.ascontiguousarray(lines.shifts[number, 1 : num_rows + 1])
    if rings is None:
        near_m = np.full((len(number), num_cols + 2), -np.inf, top_m.dtype)
        left_m = right_m = np.full((len(number), num_rows), -np.inf, top_m.dtype)
    else:
        south_m, north_m, west_m, east_m = (np.asarray(side)[number] for side in rings)
        if heading in (EAST, WEST):
            west_m, east_m = (
                np.concatenate([south_m[:, end], side, north_m[:, end]], axis=1)
                for end, side in ((slice(0, 1), west_m), (slice(-1, None), east_m))
            )
            south_m, north_m, west_m, east_m = west_m, east_m, south_m[:, 1:-1], north_m[:, 1:-1]
        near_m, left_m, right_m = north_m if heading in (NORTH, EAST) else south_m, west_m, east_m
    borders = (np.ascontiguousarray(side, top_m.dtype) for side in (near_m, left_m, right_m))
    return _Bundle(number, drop_m, top_m.dtype.type(entry_steps) * drop_m, shifts, *borders)


@compiled(nogil=True)
def _sweep(
    words,
    top_m,
    ground_m,
    altitudes_m,
    bundle,
    first_cell,
    is_turned,
    toward_last,
    ends,
    sides,
    every,
):
    """Sweep the lines of one heading over a surface, and mark words, or keep what is handed on.

    Args:
      words: ``[W, A, y / n, x / n]`` of the region; no altitudes where nothing is marked.
      top_m: ``[Y, X]``.
      ground_m: ``[y, x]``; of no cells for flat ground.
      altitudes_m: ``[A]``.
      bundle: the lines.
      first_cell: the region's first row and column, as the sweep meets them.
      is_turned: rows of the sweep are columns of the arrays.
      toward_last: the source is beyond the last row.
      ends: ``[S, 2, C]`` max(raised, sweep) in the first and last row, filled; of no satellites if they are not kept.
      sides: ``[S, 2, R]`` the same in the first and last column.
      every: receivers stand in every n-th cell of the region both ways, from ``n // 2`` on.
    """
    number, drop_m, entry_m, shifts, near_m, left_m, right_m = bundle
    num_lines, num_rows = shifts.shape
    num_cols = near_m.shape[1] - 2
    num_words, num_altitudes = words.shape[:2]
    region_rows, region_cols = words.shape[2] * every, words.shape[3] * every
    if is_turned:
        region_rows, region_cols = region_cols, region_rows
    first_row, first_col = first_cell
    end_row, end_col = first_row + region_rows, first_col + region_cols

    tops_m = np.empty((STRIP, num_cols), top_m.dtype)
    grounds_m = np.zeros((STRIP, region_cols), top_m.dtype)
    marks = np.empty((num_words, num_altitudes, STRIP, region_cols), np.uint32)
    receiver_m = np.empty((num_altitudes, COLUMNS), top_m.dtype)
    shadow_m = np.empty(COLUMNS, top_m.dtype)
    # By turns this row's and the next one's max(raised, sweep): two cells more on each side, the ring and what a shift
    # finds beyond it.
    carried_m = np.full((2, num_lines, num_cols + 4), -np.inf).astype(top_m.dtype)
    carried_m[0, :, 1:-1] = near_m
    turn = 0

    for n in range(0, num_rows - first_row if toward_last else end_row, STRIP):
        size = min(STRIP, (num_rows - first_row if toward_last else end_row) - n)
        strip_row = num_rows - n - size if toward_last else n
        has_marks = num_altitudes > 0 and strip_row < end_row and strip_row + size > first_row
        _take(tops_m[:size], top_m, strip_row, is_turned)
        inner = max(strip_row, first_row), min(strip_row + size, end_row)  # rows of the region
        if has_marks:
            marks[:] = 0
            if ground_m.size:
                _take(grounds_m[: inner[1] - inner[0]], ground_m, inner[0] - first_row, is_turned)
        for i in range(size):
            at = size - 1 - i if toward_last else i
            row = strip_row + at
            is_inner = (
                has_marks and inner[0] <= row < inner[1] and (row - first_row) % every == every // 2
            )
            for col in range(0, num_cols, COLUMNS):
                width = min(COLUMNS, num_cols - col)
                begin, end = max(col, first_col), min(col + width, end_col)  # columns of the region
                if is_inner and begin < end:
                    for a in range(num_altitudes):
                        ground = grounds_m[row - inner[0], begin - first_col : end - first_col]
                        _add(receiver_m[a, : end - begin], ground, altitudes_m[a])
                for k in range(num_lines):
                    behind = col + 2 + shifts[k, row]
                    _cast(
                        carried_m[turn, k, behind : behind + width],
                        carried_m[1 - turn, k, col + 2 : col + 2 + width],
                        shadow_m[:width],
                        tops_m[at, col : col + width],
                        drop_m[k],
                        entry_m[k],
                    )
                    if is_inner and begin < end:
                        bit = np.uint32(1 << (number[k] % WORD_BITS))
                        for a in range(num_altitudes):
                            _mark(
                                marks[
                                    number[k] // WORD_BITS,
                                    a,
                                    row - inner[0],
                                    begin - first_col : end - first_col,
                                ],
                                shadow_m[begin - col : end - col],
                                receiver_m[a, : end - begin],
                                bit,
                            )
            for k in range(num_lines):
                shift = shifts[k, row]
                before, now = carried_m[turn, k], carried_m[1 - turn, k]
                now[1] = _higher(left_m[k, row], before[1 + shift] - drop_m[k])
                now[num_cols + 2] = _higher(
                    right_m[k, row], before[num_cols + 2 + shift] - drop_m[k]
                )
            turn = 1 - turn
            if len(ends):
                for k in range(num_lines):
                    now = carried_m[turn, k]
                    sides[number[k], 0, row], sides[number[k], 1, row] = now[2], now[num_cols + 1]
                    if row == 0:
                        ends[number[k], 0] = now[2:-2]
                    if row == num_rows - 1:
                        ends[number[k], 1] = now[2:-2]
        if has_marks:
            for w in range(num_words):
                for a in range(num_altitudes):
                    _join(
                        words[w, a],
                        marks[w, a, : inner[1] - inner[0]],
                        inner[0] - first_row,
                        is_turned,
                        every,
                    )


@compiled(nogil=True)
def _higher(one_m, other_m):
    """Return the larger number, NaN where one is."""
    return one_m if one_m > other_m or one_m != one_m else other_m


@compiled(nogil=True)
def _cast(before_m, now_m, shadow_m, top_m, drop_m, entry_m):
    """Fill one line's shadow on some cells of a row, and what it hands on from there."""
    for j in range(len(top_m)):
        shadow_m[j] = before_m[j] - drop_m
        now_m[j] = _higher(top_m[j] + entry_m, shadow_m[j])


@compiled(nogil=True)
def _add(receiver_m, ground_m, altitude_m):
    for j in range(len(receiver_m)):
        receiver_m[j] = ground_m[j] + altitude_m


@compiled(nogil=True)
def _mark(marks, shadow_m, receiver_m, bit):
    for j in range(len(marks)):
        marks[j] |= bit if shadow_m[j] <= receiver_m[j] else np.uint32(0)


@compiled(nogil=True)
def _take(rows, values, first, is_turned):
    """Fill rows with those of an array, from one on; with its columns, where these are turned."""
    if not is_turned:
        rows[:] = values[first : first + len(rows)]
        return
    num_cols = rows.shape[1]
    whole = num_cols // TURNED * TURNED
    for col in range(0, whole, TURNED):
        for i in range(len(rows)):
            row = rows[i, col : col + TURNED]
            for j in range(TURNED):
                row[j] = values[col + j, first + i]
    for j in range(whole, num_cols):
        rows[:, j] = values[j, first : first + len(rows)]


@compiled(nogil=True)
def _join(words, rows, first, is_turned, every):
    """Join rows of words with those of an array, from one on; with its columns, where these are turned.

    Of both every n-th counts, from ``n // 2`` on.
    """
    num_cols = rows.shape[1]
    if every > 1:
        for i in range(len(rows)):
            at, is_kept = (first + i) // every, (first + i) % every == every // 2
            for j in range(num_cols // every if is_kept else 0):
                word = rows[i, j * every + every // 2]
                if is_turned:
                    words[j, at] |= word
                else:
                    words[at, j] |= word
        return
    if not is_turned:
        for i in range(len(rows)):
            for j in range(num_cols):
                words[first + i, j] |= rows[i, j]
        return
    whole = num_cols // TURNED * TURNED
    for col in range(0, whole, TURNED):
        for i in range(len(rows)):
            for j in range(TURNED):
                words[col + j, first + i] |= rows[i, col + j]
    for j in range(whole, num_cols):
        words[j, first : first + len(rows)] |= rows[:, j]
