"""What straight segments cost over a map of cells, and how far they keep from closed ones: in Numba, many in JAX.

Points are x, y in cell sides from the map's southwest corner, inside it.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.traversal import DIAGONAL_SIDES, TOUCH_CELLS


class CostGrid(NamedTuple):
    """The map as segments see it, in cell sides. ``Y`` rows, ``X`` columns.

    Attributes:
      cell_cost: ``[Y, X]`` float64 map cost of a cell, per cell side crossed (`line`) or step (`cell`); inf
        where no path can lead.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
      margin: that segments keep from blocked cells and from the map's border, below half a cell side (`keeps_off`).
    """

    cell_cost: np.ndarray
    per_side: float
    is_line: bool
    passes_corners: bool
    margin: float = 0.0


@compiled()
def keeps_off(cells, closed, x0, y0, x1, y1, margin):
    """Return whether a segment keeps more than a margin from every cell that is ``closed``, and from the map's border.

    The margin counts along x and y: the square of a closed cell, grown by the margin on all sides, must not meet the
    segment. In each column of grown squares the part of the segment in that column spans a range of y, which gives the
    rows to look at. A segment that is clear crosses free cells only, and passes no corner between two closed ones.

    Args:
      cells: ``[Y, X]`` of any type.
      closed: value of a closed cell.
      x0, y0, x1, y1: ends of the segment, in cell sides.
      margin: in cell sides, below one half.
    """
    num_rows, num_cols = cells.shape
    if x1 < x0:  # always from west to east
        x0, y0, x1, y1 = x1, y1, x0, y0
    slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
    first = int(np.floor(x0 - margin))
    last = int(np.floor(x1 + margin))
    if first < 0 or last >= num_cols:
        return False
    for col in range(first, last + 1):
        west = max(x0, col - margin)
        east = min(x1, col + 1 + margin)
        y_west, y_east = y0 + (west - x0) * slope, y0 + (east - x0) * slope
        if x1 == x0:
            y_west, y_east = y0, y1
        bottom = int(np.floor(min(y_west, y_east) - margin))
        top = int(np.floor(max(y_west, y_east) + margin))
        if bottom < 0 or top >= num_rows:
            return False
        for row in range(bottom, top + 1):
            if cells[row, col] == closed:
                return False
    return True


@compiled()
def is_clear(is_free, x0, y0, x1, y1, margin):
    """Whether a segment keeps more than a margin from every cell that is not free (`keeps_off`)."""
    return keeps_off(is_free, False, x0, y0, x1, y1, margin)


@compiled()
def are_clear(is_free, xy, margin):
    """Return ``[N - 1]`` bool which legs of a polyline ``[N, 2]`` are clear (`is_clear`); for one point, ``[1]``."""
    are = np.empty(max(1, len(xy) - 1), np.bool_)
    for k in range(len(are)):
        end = min(k + 1, len(xy) - 1)
        are[k] = is_clear(is_free, xy[k, 0], xy[k, 1], xy[end, 0], xy[end, 1], margin)
    return are


@compiled()
def is_pinched(cost_grid, row, col, to_row, to_col):
    """Whether the cells beside a step to a diagonal neighbour leave no gap between them, or none for the margin."""
    if cost_grid.margin > 0.0:
        return max(cost_grid.cell_cost[to_row, col], cost_grid.cell_cost[row, to_col]) == np.inf
    if cost_grid.passes_corners:
        return False
    return cost_grid.cell_cost[to_row, col] == np.inf and cost_grid.cell_cost[row, to_col] == np.inf


@compiled()
def segment_cost(cost_grid, x0, y0, x1, y1, limit):
    """Return the cost of a segment; inf if it is blocked, or if its cost is not below ``limit``.

    The walk from border to border is that of `kernels.line.traversal` and the law that of its `is_free_way`, but an end
    on a border counts as lying in the cell north or east of it: a segment that only touches an obstacle with its end
    may count as blocked. Costs are those of `path_features`; under ``cell`` both ends must lie off the borders of their
    cells. A segment of no length costs nothing.

    Args:
      cost_grid: `CostGrid`.
      x0, y0, x1, y1: ends of the segment, in cell sides.
      limit: the walk ends where the cost reaches it; inf for none.
    """
    # What can be decided without a walk: the distance alone, and the margin.
    dx, dy = x1 - x0, y1 - y0
    length = np.sqrt(dx * dx + dy * dy)
    total = cost_grid.per_side * length
    if total >= limit:
        return np.inf
    if cost_grid.margin > 0.0 and not keeps_off(
        cost_grid.cell_cost, np.inf, x0, y0, x1, y1, cost_grid.margin
    ):
        return np.inf

    # Borders still to be crossed along x and along y, and where on the segment (in cell sides) the next one lies.
    row, col = int(np.floor(y0)), int(np.floor(x0))
    num_x = abs(int(np.floor(x1)) - col)
    num_y = abs(int(np.floor(y1)) - row)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    sides_x = length / dx if num_x else 0.0  # along the segment, per cell side of x
    sides_y = length / dy if num_y else 0.0
    next_x = (col + (step_x > 0) - x0) * sides_x if num_x else np.inf
    next_y = (row + (step_y > 0) - y0) * sides_y if num_y else np.inf
    # Under `cell`, where on the segment the next state lies; a step up to a diagonal long has the state at its end
    # only.
    next_state = length if length <= DIAGONAL_SIDES else 1.0

    begin = 0.0  # of the part in the current cell
    while True:
        end = min(next_x, next_y, length)
        cell_cost = cost_grid.cell_cost[row, col]
        if cell_cost == np.inf:
            return np.inf
        if cost_grid.is_line:
            total += cell_cost * (end - begin)
        else:
            # A state on a border belongs to the cell it came through; the last step may be shorter.
            while next_state < length * (1 - TOUCH_CELLS) and next_state <= end + TOUCH_CELLS:
                total += cell_cost
                next_state += 1.0
        if total >= limit:
            return np.inf
        if num_x <= 0 and num_y <= 0:
            break

        # Go on to the next cell: through a corner along both axes at once, if that leaves a gap.
        is_corner = abs(next_x - next_y) < TOUCH_CELLS
        if is_corner and is_pinched(cost_grid, row, col, row + step_y, col + step_x):
            return np.inf
        go_x = is_corner or next_x < next_y
        go_y = is_corner or next_y < next_x
        if go_x:
            col += step_x
            num_x -= 1
            next_x = (col + (step_x > 0) - x0) * sides_x if num_x > 0 else np.inf
        if go_y:
            row += step_y
            num_y -= 1
            next_y = (row + (step_y > 0) - y0) * sides_y if num_y > 0 else np.inf
        begin = end

    # Under `cell` the end is a state of its own.
    if not cost_grid.is_line and length > 0.0:
        total += cost_grid.cell_cost[row, col]
    return total if total < limit else np.inf
