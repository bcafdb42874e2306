"""Outlines burnt into cells, by their centres and by any area that they share, and what hangs put on what stands.

The highest value wins; a slab that rests on a roof raises it.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.traversal import TOUCH_CELLS, walk_edge

SNAP_CELLS = 1e-6  # an outline's corner this close to a border of cells lies on it: micrometres, by rounding of metres


@compiled()
def burn_outlines(
    points,
    ring_start,
    outline_start,
    values,
    first_row,
    first_col,
    centre,
    touched,
    is_crossed,
    row,
    col,
    length,
):
    """Raise cells to the highest value among the outlines that hold them, in place, in one pass over the outlines.

    An outline holds a cell of ``centre`` if the cell's centre lies in it. A centre on the border between two outlines
    belongs to the northern or the western one; a centre on an edge of a hole that runs along the row is held. These are
    the cells that GDAL burns.

    An outline holds a cell of ``touched`` if one of its edges crosses the cell's interior. With the cells of ``centre``
    these are all cells that the outline shares area with, since a cell that no edge crosses is inside or outside as a
    whole. An edge along a border of cells crosses none; a corner within ``SNAP_CELLS`` of a border counts as lying on
    it.

    Args:
      points: ``[P, 2]`` float64 x, y of the rings' corners in cell sides from the CRS's origin, first and last of a
        ring the same.
      ring_start: ``[R + 1]`` int64 where each ring begins in ``points``, and the end.
      outline_start: ``[N + 1]`` int64 where each outline, an exterior ring and its holes, begins in the rings.
      values: ``[N]`` of the outlines, in the type of ``centre``.
      first_row, first_col: southwest cell of ``centre``, counted from the CRS's origin.
      centre: ``[Y, X]``, row 0 in the south, altered; what lies outside is left out.
      touched: ``[Y, X]`` of the same type, altered; ``[0, 0]`` if it is not needed.
      is_crossed: ``[M]`` bool working memory, all False, for the cells of any outline's box with two columns more on
        each side; left all False.
      row, col, length: ``[L]`` int64, int64 and float64 working memory, for the parts of any edge (see `walk_edge`).
    """
    for outline in range(len(values)):
        rings = ring_start[outline_start[outline] : outline_start[outline + 1] + 1]
        _fill(points, rings, values[outline], first_row, first_col, centre, is_crossed)
        if touched.size:
            _touch(points, rings, values[outline], first_row, first_col, touched, row, col, length)


@compiled()
def _fill(points, rings, value, first_row, first_col, centre, is_crossed):
    """Raise the cells of ``centre`` whose centre lies in one outline, by even-odd scan lines.

    Where an edge crosses a row of centres is computed from the CRS's origin, so that it is rounded alike whatever part
    is burnt: an edge through a centre leaves it on the same side in every tile.

    Args:
      points, first_row, first_col, centre, is_crossed: as in `burn_outlines`.
      rings: ``[R + 1]`` where each ring of the outline begins in ``points``, and the end; the exterior comes first.
      value: of the outline.
    """
    # The box of rows and columns in which centres can lie.
    num_rows, num_cols = centre.shape
    west = south = np.inf
    east = north = -np.inf
    for at in range(rings[0], rings[1]):
        x, y = points[at]
        west = min(west, x)
        east = max(east, x)
        south = min(south, y)
        north = max(north, y)
    low_row = max(_row_from(south) - first_row, 0)
    end_row = min(_row_from(north) - first_row, num_rows)
    # A column more on each side, should rounding carry an edge beyond its ends.
    low_col = max(_col_from(west) - 1 - first_col, 0)
    end_col = min(_col_from(east) + 1 - first_col, num_cols)
    num = end_col - low_col
    if low_row >= end_row or num <= 0:
        return

    # For each row mark the cell from which on an edge lies in the west; two edges at one cell undo each other.
    for ring in range(len(rings) - 1):
        for at in range(rings[ring], rings[ring + 1] - 1):
            x0, y0 = points[at]
            x1, y1 = points[at + 1]
            if y0 > y1:
                x0, y0, x1, y1 = x1, y1, x0, y0
            elif y0 == y1:
                # An edge along a row crosses none; the edge of a hole along a row of centres holds them.
                row = _row_from(y0)
                if ring > 0 and y0 == row + 0.5 and low_row <= row - first_row < end_row:
                    first = _col_from(min(x0, x1)) - first_col
                    end = _col_from(max(x0, x1)) - first_col
                    for col in range(max(first, 0), min(end, num_cols)):
                        centre[row - first_row, col] = max(centre[row - first_row, col], value)
                continue
            for row in range(
                max(_row_from(y0) - first_row, low_row), min(_row_from(y1) - first_row, end_row)
            ):
                x = (first_row + row + 0.5 - y0) * (x1 - x0) / (y1 - y0) + x0
                col = max(_col_from(x) - first_col - low_col, 0)
                if col < num:
                    place = (row - low_row) * num + col
                    is_crossed[place] = not is_crossed[place]

    # From west to east each mark leads into the outline or out of it; marks are cleared on the way.
    place = 0
    for row in range(low_row, end_row):
        is_inside = False
        for col in range(low_col, end_col):
            if is_crossed[place]:
                is_crossed[place] = False
                is_inside = not is_inside
            if is_inside and value > centre[row, col]:
                centre[row, col] = value
            place += 1


@compiled()
def _row_from(y):
    """Return the first row whose centre does not lie south of ``y``."""
    return int(np.ceil(y - 0.5))


@compiled()
def _col_from(x):
    """Return the first column whose centre lies east of ``x``."""
    return int(np.floor(x + 0.5))


@compiled()
def _touch(points, rings, value, first_row, first_col, touched, row, col, length):
    """Raise the cells of ``touched`` whose interior an edge of one outline crosses.

    Args:
      points, first_row, first_col, touched, row, col, length: as in `burn_outlines`.
      rings, value: as in `_fill`.
    """
    num_rows, num_cols = touched.shape
    for ring in range(len(rings) - 1):
        x1 = _snapped(points[rings[ring], 0] - first_col)
        y1 = _snapped(points[rings[ring], 1] - first_row)
        for at in range(rings[ring] + 1, rings[ring + 1]):
            x0, y0 = x1, y1
            x1 = _snapped(points[at, 0] - first_col)
            y1 = _snapped(points[at, 1] - first_row)
            if (
                max(x0, x1) < 0
                or max(y0, y1) < 0
                or min(x0, x1) > num_cols
                or min(y0, y1) > num_rows
            ):
                continue  # wholly outside
            # An edge along a border of cells crosses no interior.
            if (x0 == x1 and x0 == np.rint(x0)) or (y0 == y1 and y0 == np.rint(y0)):
                continue
            for part in range(walk_edge(x0, y0, x1, y1, row, col, length, np.int64(0))):
                r, c = row[part], col[part]
                if (
                    length[part] > TOUCH_CELLS
                    and 0 <= r < num_rows
                    and 0 <= c < num_cols
                    and value > touched[r, c]
                ):
                    touched[r, c] = value


@compiled()
def _snapped(value):
    border = np.rint(value)
    return border if abs(value - border) < SNAP_CELLS else value


@compiled()
def settle(roof_m, cell, floor_m, top_m, is_of_cell):
    """Raise roofs by the slabs that rest on them, and return which slabs hang freely, ``[H]`` bool.

    A slab hangs freely if its floor is above the roof of its cell, which slabs below it may have raised.

    Args:
      roof_m: ``[Y * X]`` roof heights of the cells; altered.
      cell: ``[H]`` int64 number of the cell that each slab lies over, ascending; in one cell floors ascend.
      floor_m, top_m: ``[H]`` heights of each slab's underside and top, in the type of the roofs.
      is_of_cell: ``[H]`` bool whether the slab counts for the whole cell; other slabs raise no roof.
    """
    hangs = np.zeros(len(cell), np.bool_)
    for slab in range(len(cell)):
        if floor_m[slab] > roof_m[cell[slab]]:
            hangs[slab] = True
        elif is_of_cell[slab]:
            roof_m[cell[slab]] = max(roof_m[cell[slab]], top_m[slab])
    return hangs
