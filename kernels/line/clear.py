"""How far straight legs keep from closed cells.

Points are x, y in cell sides from the map's southwest corner.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled


@compiled()
def keeps_off(cells, closed, x0, y0, x1, y1, margin):
    """Whether a segment keeps more than a margin from every cell that holds ``closed``, and from the map's border.

    The margin counts along x and y: no cell's square, grown by it on all sides, meets the segment. Column after column
    of grown squares, the part of the segment within it lies between two heights, which name the rows to look at. A
    segment that is clear crosses free cells only, and passes no corner between two closed ones.
    """
    num_rows, num_cols = cells.shape
    if x1 < x0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
    first, last = int(np.floor(x0 - margin)), int(np.floor(x1 + margin))
    if first < 0 or last >= num_cols:
        return False
    for col in range(first, last + 1):
        west, east = max(x0, col - margin), min(x1, col + 1 + margin)
        low, high = y0 + (west - x0) * slope, y0 + (east - x0) * slope
        if x1 == x0:
            low, high = y0, y1
        bottom, top = int(np.floor(min(low, high) - margin)), int(np.floor(max(low, high) + margin))
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
    """Whether all legs of a polyline ``[N, 2]`` do; of a single point, that point."""
    for k in range(max(1, len(xy) - 1)):
        end = min(k + 1, len(xy) - 1)
        if not is_clear(is_free, xy[k, 0], xy[k, 1], xy[end, 0], xy[end, 1], margin):
            return False
    return True
