"""Whether a path keeps to free cells, as Shapely sees it."""

import numpy as np
from shapely import LineString, STRtree, box, intersection, length, points


def pinched_corners(is_free: np.ndarray) -> np.ndarray:
    """``[P, 2]`` x, y, in cell sides, of corners at which two obstacles touch and the two cells beside are free."""
    south_west, south_east, north_west, north_east = (
        is_free[rows, cols] for rows in (np.s_[:-1], np.s_[1:]) for cols in (np.s_[:-1], np.s_[1:])
    )
    is_pinched = (
        (south_west == north_east) & (south_east == north_west) & (south_west != south_east)
    )
    return np.argwhere(is_pinched)[:, ::-1] + 1.0


def line_of(points_m: np.ndarray) -> LineString:
    """The line of a path; of one point, a line of no length."""
    return LineString(points_m if len(points_m) > 1 else np.repeat(points_m, 2, axis=0))


class Obstacles:
    """Boxes of the cells that are not free, and all around the map, as Shapely sees them."""

    def __init__(
        self, is_free: np.ndarray, side_m: float, x_m: float = 0.0, y_m: float = 0.0
    ) -> None:
        frame = np.pad(is_free, 1)
        rows, cols = np.nonzero(~frame)
        west, south = x_m + (cols - 1) * side_m, y_m + (rows - 1) * side_m
        self._tree = STRtree(box(west, south, west + side_m, south + side_m))
        self._pinches = STRtree(points(pinched_corners(is_free) * side_m + (x_m, y_m)))
        self._touch_m = 1e-9 * side_m

    def is_pinched(self, points_m: np.ndarray) -> bool:
        """Whether a path runs through a corner at which two obstacles touch that have none beside it."""
        return len(self._pinches.query(line_of(points_m), "dwithin", self._touch_m)) > 0

    def is_near(self, points_m: np.ndarray, distance_m: float) -> bool:
        """Whether a path passes nearer than that to an obstacle."""
        return len(self._tree.query(line_of(points_m), "dwithin", distance_m)) > 0

    def crossed_m(self, points_m: np.ndarray) -> float:
        """Length of a path within obstacles."""
        line = line_of(points_m)
        near = self._tree.geometries[self._tree.query(line)]
        return float(length(intersection(near, line)).sum()) if len(near) else 0.0
