"""Shadows of what hangs over the ground: every slab cast straight onto the receivers behind it.

Slabs are few, so each walks along the digital line away from the satellite, cell by cell, as far as its shadow can
reach. A receiver at height h, d rows (columns) behind a slab's cell, is hidden where its ray is between floor and top
somewhere within that cell: from half a row before the cell's middle to half a row behind it the ray climbs from
h + (d - 1/2) drop to h + (d + 1/2) drop; from its own cell, d = 0, a ray starts at h. So neighbouring cells of a thin
slab leave no gap between them, however steep the ray. (Roofs are met a quarter row before the middle, `ENTRY_STEPS`.)

The lines are those of `jaxurban.kernels.shadows.sweep.digital_line`. Bits are only ever taken away, each by numbers
that depend on slab, receiver and satellite alone: a part of a map gets the same bits as the whole.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.shadows.sweep import WORD_BITS

HALF_ROW = 0.5  # from a cell's middle to where a ray enters and leaves it, in rows (columns)
LEAST_DROP_M = 1e-9  # a ray along the horizon is followed to the border of the map


class SlabReceivers(NamedTuple):
    """Where the receivers of a map stand on the slabs' grid. ``y, x`` receivers.

    Attributes:
      first_row, first_col: global number of the southwesternmost receiver's cell.
      every: cells from one receiver to the next, both ways.
      ground_m: ``[y, x]`` elevation of the ground there; of no cells for flat ground.
    """

    first_row: int
    first_col: int
    every: int
    ground_m: np.ndarray


def hide_behind_slabs(
    words: UInt[np.ndarray, "W A y x"],
    altitudes_m: Float[np.ndarray, " A"],
    receivers: SlabReceivers,
    cells: tuple[np.ndarray, np.ndarray],
    heights_m: tuple[np.ndarray, np.ndarray],
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    resolution_m: float,
) -> None:
    """Clear the bit of every satellite in the visibility words of the receivers from which a slab hides it.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; altered.
      altitudes_m: heights of the receivers above the ground.
      receivers: where the receivers stand.
      cells: global row and column of every slab, ``[H]`` int64 each; with no slab nothing is done.
      heights_m: absolute height of every slab's underside and top, ``[H]`` float64 each.
      azimuth_rad, elevation_rad: ``[S]`` of the satellites, clockwise from grid north and above the horizon.
      resolution_m: side of the slabs' cells.
    """
    row, col = cells
    if not len(row):
        return

    receivers = receivers._replace(ground_m=np.asarray(receivers.ground_m, np.float64))
    altitudes_m = np.asarray(altitudes_m, np.float64)
    ground_m = receivers.ground_m
    range_m = (float(ground_m.min()), float(ground_m.max())) if ground_m.size else (0.0, 0.0)
    # First and last row, and first and last column, among slabs and receivers: lines are needed there.
    spans = [
        (min(int(cell.min()), first), max(int(cell.max()), first + receivers.every * (num - 1)))
        for cell, first, num in zip(cells, receivers[:2], words.shape[2:], strict=True)
    ]

    for number, (azimuth, elevation) in enumerate(zip(azimuth_rad, elevation_rad, strict=True)):
        east, north = math.sin(azimuth), math.cos(azimuth)
        is_rows = abs(north) >= abs(east)
        along, across = (north, east) if is_rows else (east, north)
        first, last = spans[0 if is_rows else 1]
        # The digital line of `jaxurban.kernels.shadows.sweep.digital_line`, by global rows (columns).
        line = _Line(
            np.floor(across / along * np.arange(first, last + 1) + 0.5).astype(np.int64),
            first,
            is_rows,
            1 if along > 0 else -1,
            resolution_m / abs(along) * math.tan(elevation),
        )
        of_slabs = *((row, col) if is_rows else (col, row)), *heights_m
        kept = ~np.uint32(1 << (number % WORD_BITS))  # every bit but this satellite's
        _cast(words[number // WORD_BITS], kept, altitudes_m, receivers, range_m, of_slabs, line)


class _Line(NamedTuple):
    """A digital line toward a satellite.

    Attributes:
      sideways: ``[N]`` int64 cells sideways, by the line's row (column).
      first: the first of these.
      is_rows: whether the line is followed row by row.
      ahead: 1 where the satellite is beyond the last row (column), -1 where it is beyond the first.
      drop_m: height that a ray gains from one row (column) to the next.
    """

    sideways: np.ndarray
    first: int
    is_rows: bool
    ahead: int
    drop_m: float


@compiled()
def _cast(words, kept, altitudes_m, receivers, range_m, slabs, line):
    """Clear one satellite's bit in the words of the receivers that lie behind a slab.

    "Along" is the axis that the line follows (rows if it ``is_rows``, else columns), "across" is the other axis. For
    each slab and altitude the walk leads away from the satellite, from the first receiver that the shadow may reach to
    the last, and tests each receiver exactly.

    Args:
      words: ``[A, y, x]`` uint32 words that hold the satellite's bit; altered.
      kept: uint32 in which every other bit is set.
      altitudes_m: ``[A]`` heights of the receivers above the ground.
      receivers: `SlabReceivers`, where they stand.
      range_m: lowest and highest ground of the receivers.
      slabs: global number of each slab's cell along and across, its floor and its top in metres, ``[H]`` each.
      line: `_Line` toward the satellite.
    """
    first_row, first_col, every, ground_m = receivers
    slab_along, slab_across, floor_m, top_m = slabs
    sideways, first, is_rows, ahead, drop_m = line
    num_rows, num_cols = words.shape[1:]
    first_along, first_across = (first_row, first_col) if is_rows else (first_col, first_row)
    num_along, num_across = (num_rows, num_cols) if is_rows else (num_cols, num_rows)
    last_along = first_along + every * (num_along - 1)
    rows_a_metre = 1 / max(drop_m, LEAST_DROP_M)  # that a ray needs to rise by a metre

    for slab in range(len(floor_m)):
        own, floor, top = slab_along[slab], floor_m[slab], top_m[slab]

        # Steps from the slab to the receivers: none is ahead of its slab, and none outside the map.
        nearest = max(0, own - last_along if ahead > 0 else first_along - own)
        farthest = own - first_along if ahead > 0 else last_along - own
        # A number of steps that leads to a row (column) of receivers leaves this rest, divided by `every`.
        phase = (own - first_along) * ahead % every

        # The line's cell across, from the first receiver's: this number plus the line's offset at each step.
        beside = slab_across[slab] - sideways[own - first] - first_across
        for a in range(len(altitudes_m)):
            # Steps at which a ray from the lowest or the highest receiver can be between floor and top.
            low_m = range_m[0] + altitudes_m[a]
            high_m = range_m[1] + altitudes_m[a]
            if top < low_m:
                continue
            # One step more on either side, in case rounding matters.
            begin = max(nearest, int(max((floor - high_m) * rows_a_metre - HALF_ROW - 1, 0.0)))
            end = min(
                farthest, int(min((top - low_m) * rows_a_metre + HALF_ROW + 1, float(farthest)))
            )
            for step in range(begin + (phase - begin) % every, end + 1, every):
                here = own - ahead * step
                across = beside + sideways[here - first]
                if across < 0 or across >= every * num_across or across % every:
                    continue  # no receiver stands in this cell
                i = (here - first_along) // every
                j = across // every
                r, c = (i, j) if is_rows else (j, i)
                # Hidden where the ray is between floor and top somewhere within the slab's cell.
                height_m = altitudes_m[a] + (ground_m[r, c] if ground_m.size else 0.0)
                enters_m = height_m + max(step - HALF_ROW, 0.0) * drop_m
                leaves_m = height_m + (step + HALF_ROW) * drop_m
                if enters_m <= top and leaves_m >= floor:
                    words[a, r, c] &= kept
