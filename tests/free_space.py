"""Whether a path keeps to free cells, as Shapely sees it."""

import numpy as np
from shapely import LineString, STRtree, box, intersection, length


class Obstacles:
    """Boxes of the cells that are not free, and all around the map, as Shapely sees them."""

    def __init__(self, is_free: np.ndarray, side_m: float, x_m: float = 0.0, y_m: float = 0.0) -> None:
        frame = np.pad(is_free, 1)
        rows, cols = np.nonzero(~frame)
        west, south = x_m + (cols - 1) * side_m, y_m + (rows - 1) * side_m
        self._tree = STRtree(box(west, south, west + side_m, south + side_m))

    def crossed_m(self, points_m: np.ndarray) -> float:
        """Length of a path within obstacles; one point counts as a path of no length."""
        line = LineString(points_m if len(points_m) > 1 else np.repeat(points_m, 2, axis=0))
        near = self._tree.geometries[self._tree.query(line)]
        return float(length(intersection(near, line)).sum()) if len(near) else 0.0
