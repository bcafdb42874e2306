"""Boxes around polygons, the box that most of them lie in, and the polygons of a geometry."""

from collections.abc import Sequence

import numpy as np
import shapely

from jaxurban.world.grid import WGS84, Bounds, transformer

MAIN_SHARE = 0.99  # of the buildings: the box around them is where a city stands
SMALL_PART = 0.1  # of an extent: such a box is proposed instead of it


def lonlat_boxes(polygons: np.ndarray, crs: str) -> np.ndarray:
    """Return west, south, east, north in degrees of polygons in ``crs``, ``[N, 4]``; empty ones are left out."""
    vertices, polygon = shapely.get_coordinates(polygons, return_index=True)
    lonlat = np.stack(transformer(crs, WGS84).transform(*vertices.T), axis=1)
    first = np.flatnonzero(np.diff(polygon, prepend=-1))
    return np.hstack([np.minimum.reduceat(lonlat, first), np.maximum.reduceat(lonlat, first)])


def rounded_outward(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes in degrees ``[N, 4]``, rounded outward to 1e-4 degrees, some 10 m."""
    # In units of 1e-4 degrees; rounded first, as a projection there and back moves the sides a little.
    corners = shapely.linestrings(boxes.reshape(-1, 2))
    sides = np.round(1e4 * shapely.bounds(corners), 4)
    west, south = np.floor(sides[:2]) / 1e4
    east, north = np.ceil(sides[2:]) / 1e4
    return float(west), float(south), float(east), float(north)


def main_bounds(polygons: np.ndarray, crs: str, extent: Sequence[float]) -> Bounds | None:
    """Return the box around the polygons in the middle of an extent, if it is a small part of that; else None.

    The polygons that count are those in the extent, without the 1 % (`MAIN_SHARE`) that lie farthest from the median of
    all. How far one lies is the larger of its distances east or west and north or south.

    Args:
      polygons: ``[N]`` in ``crs``.
      crs: of the polygons; the box does not depend on it.
      extent: west, south, east, north in degrees.

    Returns:
      West, south, east, north in degrees, rounded outward to some 10 m; None also without a polygon in the extent.
    """
    boxes = lonlat_boxes(polygons, crs)
    is_inside = (boxes[:, :2] <= extent[2:]) & (boxes[:, 2:] >= extent[:2])
    boxes = boxes[is_inside.all(axis=1)]
    if not len(boxes):
        return None
    centres = (boxes[:, :2] + boxes[:, 2:]) / 2
    median = np.median(centres, axis=0)
    of_longitude = np.cos(np.radians(median[1]))  # a degree of it, in degrees of latitude
    off = (np.abs(centres - median) * [of_longitude, 1.0]).max(axis=1)
    main = rounded_outward(boxes[off <= np.quantile(off, MAIN_SHARE, method="higher")])
    return main if shapely.box(*main).area < SMALL_PART * shapely.box(*extent).area else None


def meets(boxes: np.ndarray, box: Bounds) -> np.ndarray:
    """Return which of the boxes ``[N, 4]`` touch a box, ``[N]`` bool; none that is NaN does."""
    x_min, y_min, x_max, y_max = boxes.T
    return (x_min <= box[2]) & (x_max >= box[0]) & (y_min <= box[3]) & (y_max >= box[1])


def extent_of(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes ``[N, 4]``, NaN left out; inf and -inf without any."""
    low = np.fmin.reduce(boxes[:, :2], initial=np.inf)
    high = np.fmax.reduce(boxes[:, 2:], initial=-np.inf)
    return (*low.tolist(), *high.tolist())


def polygonal(geometry: shapely.Geometry) -> shapely.Geometry:
    """Return the polygons of a geometry or collection, as one Polygon or MultiPolygon; empty if it has none."""
    # Twice: a collection may hold MultiPolygons.
    parts = shapely.get_parts(shapely.get_parts(geometry))
    return shapely.union_all(parts[shapely.get_dimensions(parts) == 2])
