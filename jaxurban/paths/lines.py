"""Polylines as arrays of points: how far along each point lies, and their lines as Shapely takes them."""

import numpy as np
import shapely


def along_of(points_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` metres from the first of ``[N, D]`` points to each, along the polyline."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1)))


def line_of(xy_m: np.ndarray) -> shapely.LineString:
    """Return the line through ``[N, 2]`` points; a lone point is one without length."""
    return shapely.LineString(xy_m[[0, *range(len(xy_m))]])
