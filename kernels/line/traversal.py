"""The exact set of cells that a polyline crosses, with the length in each."""

from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.compiled import compiled

TOUCH_CELLS = 1e-9  # in cell sides: a cut this short is rounding of a touched corner or border, not a crossing
# Cell sides: the longest segment that is one step in the `cell` model.
DIAGONAL_SIDES = 2**0.5 * (1 + 1e-9)


class Crossings(NamedTuple):
    """A polyline cut at the borders of cells, in the order of travel. ``N`` points, ``M`` parts.

    Attributes:
      points_m: ``[N, 2]`` or ``[N, 3]`` float64 x, y (and altitude) of the polyline.
      segment: ``[M]`` int64, which segment of the polyline each part belongs to, ascending.
      row, col: ``[M]`` int64 cell of each part; outside the map's range where the path leaves the map.
      length_m: ``[M]`` float64 length of each part, in the air where it climbs or descends.
    """

    points_m: np.ndarray
    segment: np.ndarray
    row: np.ndarray
    col: np.ndarray
    length_m: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """``[M, 2]`` where on its segment each part begins and ends, from 0 to 1."""
        # The length of each part's whole segment.
        total_m = np.bincount(self.segment, self.length_m)[self.segment]
        share = self.length_m / np.where(total_m > 0, total_m, 1.0)
        end = np.cumsum(share)
        # What the segments before a part's own add to the sum: its value at the segment's first part.
        before = np.append(0.0, end)[np.searchsorted(self.segment, self.segment)]
        return np.stack([end - share - before, end - before], axis=1)


def crossed_cells(points_m: np.ndarray, resolution_m: float) -> Crossings:
    """Return the cells whose interior a polyline crosses, with the length in each.

    Cell (row, col) covers ``[col, col + 1) x [row, row + 1)`` cell sides: a part that runs exactly
    along a border belongs to the cell north or east of it (the floor rule of the grid). A cell that is
    only touched, at a corner or by a vertex of the polyline on its border, is not crossed. A coordinate within
    ``TOUCH_CELLS`` of a border lies on it, and a part shorter than that at a corner counts as touching. Segments of no
    length cross nothing, but a path of no length at all lies in the cell that holds it, with length 0. A segment
    straight up or down is two parts, halves of it.

    Args:
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, or ``[N, 3]`` with altitudes, ``N >= 1``.
      resolution_m: side of a cell.

    Raises:
      InputError: the points are not of these shapes, or not finite.
    """
    points_m = np.array(points_m, np.float64, ndmin=1)
    if (
        points_m.ndim != 2
        or points_m.shape[1] not in (2, 3)
        or not len(points_m)
        or not np.isfinite(points_m).all()
    ):
        raise InputError(
            f"a path must be [N, 2] or [N, 3] finite metres with N >= 1, got shape {points_m.shape}: mend the path"
        )

    # Coordinates in cell sides, those next to a border moved onto it.
    points = points_m[:, :2] / resolution_m
    border = np.rint(points)
    points = np.where(np.abs(points - border) < TOUCH_CELLS, border, points)

    # Walk from border to border. A segment has at most one part more than it changes rows and columns.
    most_parts = int(np.abs(np.diff(np.floor(points), axis=0)).sum()) + len(points)
    places = np.empty((3, most_parts), np.int64)
    length = np.empty(most_parts)
    count = _walk(np.ascontiguousarray(points), *places, length)
    (segment, row, col), length = places[:, :count], length[:count]
    crossings = Crossings(points_m, segment, row, col, length * resolution_m)
    if points_m.shape[1] == 3:
        crossings = _in_air(crossings, points)
    if len(crossings.segment):
        return crossings

    # A path of no length lies in one cell.
    col, row = np.floor(points[:1]).astype(np.int64).T
    return Crossings(points_m, np.zeros(1, np.int64), row, col, np.zeros(1))


def _in_air(plan: Crossings, points: np.ndarray) -> Crossings:
    """Return the parts of a path with altitudes: longer where it climbs, and two for each segment straight up or down.

    Args:
      plan: the parts of its plan, with the path's points ``[N, 3]``.
      points: ``[N, 2]`` x, y of its points, in cell sides.
    """
    # A part is longer than in plan by the same factor as its whole segment.
    legs_m = np.diff(plan.points_m, axis=0).T
    over_m = np.hypot(*legs_m[:2])
    leg_m = np.hypot(over_m, legs_m[2])
    factor = np.divide(leg_m, over_m, out=np.ones_like(over_m), where=over_m > 0)
    before = plan.segment, plan.row, plan.col, plan.length_m * factor[plan.segment]

    # Straight up or down: two halves in one cell, put in the order of segments.
    is_rise = (points[1:] == points[:-1]).all(axis=1) & (legs_m[2] != 0)
    rises = np.repeat(np.flatnonzero(is_rise), 2)
    col, row = np.floor(points[rises]).astype(np.int64).T
    added = rises, row, col, np.abs(legs_m[2, rises]) / 2
    order = np.argsort(np.append(plan.segment, rises), kind="stable")
    parts = zip(before, added, strict=True)
    return Crossings(plan.points_m, *(np.append(*pair)[order] for pair in parts))


def is_free_way(crossings: Crossings, is_free: np.ndarray, passes_corners: bool) -> bool:
    """Return whether a path is a free way: the law that every planner and every evaluation keeps.

    Every cell that the path crosses must be on the map and free. Where the path goes from a cell to a diagonal
    neighbour through their corner, within a segment or at a vertex, at least one of the two cells beside the corner
    must be free: two blocked cells that touch at a corner leave no gap. One blocked cell beside the corner is only
    touched.

    A part along a border lies in the cell north or east of the border, as in `crossed_cells`. So it is not free if that
    cell is blocked, whatever the cell on the other side is.

    Args:
      crossings: of the path, from `crossed_cells`.
      is_free: ``[Y, X]`` bool.
      passes_corners: a path may pass between two blocked cells that touch at a corner.
    """
    row, col = crossings.row, crossings.col
    num_rows, num_cols = is_free.shape
    if (
        row.min() < 0
        or row.max() >= num_rows
        or col.min() < 0
        or col.max() >= num_cols
        or not is_free[row, col].all()
    ):
        return False
    if passes_corners:
        return True
    # Parts after which both row and column change; the cells beside mix the two.
    corner = np.flatnonzero((row[1:] != row[:-1]) & (col[1:] != col[:-1]))
    return bool(
        np.all(is_free[row[corner], col[corner + 1]] | is_free[row[corner + 1], col[corner]])
    )


@compiled()
def _walk(points, segment, row, col, length):
    """Walk each segment of a path from border to border, write its parts, and return how many parts there are.

    Args:
      points: ``[N, 2]`` x, y in cell sides.
      segment, row, col: ``[M]`` int64, filled in place with the number of each part's segment, and its cell.
      length: ``[M]`` float64, filled in place with each part's length in cell sides.
    """
    count = np.int64(0)  # for a bare 0, a literal, `walk_edge` would be compiled once more
    for s in range(len(points) - 1):
        x0, y0 = points[s]
        x1, y1 = points[s + 1]
        end = walk_edge(x0, y0, x1, y1, row, col, length, count)
        segment[count:end] = s
        count = end
    return count


@compiled()
def walk_edge(x0, y0, x1, y1, row, col, length, count):
    """Write the cells that a segment crosses, and the length in each; return ``count`` plus the parts written.

    The number of borders is counted first, so the walk always ends; it writes one part more than there are borders,
    and nothing for a segment of no length.

    Args:
      x0, y0, x1, y1: ends of the segment in cell sides.
      row, col, length: ``[M]`` arrays to write into from ``count`` on, with room for the parts.
      count: how many parts are written already.
    """
    dx, dy = x1 - x0, y1 - y0
    total = np.hypot(dx, dy)
    if total == 0.0:
        return count

    # Count the borders strictly inside the segment. A walk west or south from a border begins in the cell beyond it.
    if dx >= 0.0:
        step_x = 1
        c = int(np.floor(x0))
        num_x = int(np.ceil(x1)) - int(np.floor(x0)) - 1
    else:
        step_x = -1
        c = int(np.ceil(x0)) - 1
        num_x = int(np.ceil(x0)) - int(np.floor(x1)) - 1
    if dy >= 0.0:
        step_y = 1
        r = int(np.floor(y0))
        num_y = int(np.ceil(y1)) - int(np.floor(y0)) - 1
    else:
        step_y = -1
        r = int(np.ceil(y0)) - 1
        num_y = int(np.ceil(y0)) - int(np.floor(y1)) - 1

    # Walk: each part ends at the next border of either axis; a corner is passed along both at once.
    begin = 0.0
    while True:
        next_x = (c + (step_x > 0) - x0) / dx * total if num_x > 0 else np.inf
        next_y = (r + (step_y > 0) - y0) / dy * total if num_y > 0 else np.inf
        end = min(next_x, next_y, total)
        row[count] = r
        col[count] = c
        length[count] = end - begin
        count += 1
        if num_x <= 0 and num_y <= 0:
            return count
        is_corner = abs(next_x - next_y) < TOUCH_CELLS
        if is_corner or next_x < next_y:
            c += step_x
            num_x -= 1
        if is_corner or next_y < next_x:
            r += step_y
            num_y -= 1
        begin = end
