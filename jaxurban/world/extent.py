"""Boxes in degrees around polygons, and the box that most of them lie in."""

from collections.abc import Sequence

import numpy as np
import shapely

from jaxurban.world.grid import WGS84, Bounds, transformer

MAIN_SHARE = 0.99  # of the buildings: the box around them is where a city stands
SMALL_PART = 0.1  # of an extent: such a box is proposed instead of it


def lonlat_boxes(polygons: np.ndarray, crs: str) -> np.ndarray:
    """Return west, south, east, north in degrees of polygons in ``crs``, ``[N, 4]``."""
    return shapely.bounds(
        shapely.transform(polygons, transformer(crs, WGS84).transform, interleaved=False)
    )


def rounded_outward(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes in degrees ``[N, 4]``, rounded outward to some 10 m."""
    # A projection there and back moves them.
    sides = np.round(1e4 * shapely.total_bounds(shapely.box(*boxes.T)), 4)
    west, south, east, north = (np.append(np.floor(sides[:2]), np.ceil(sides[2:])) / 1e4).tolist()
    return west, south, east, north


def main_bounds(polygons: np.ndarray, crs: str, extent: Sequence[float]) -> Bounds | None:
    """Return the box that `MAIN_SHARE` of the polygons lie in, if it is a small part of an extent; else None.

    Args:
      polygons: ``[N]`` in ``crs``; of those that reach into the extent, the ones that lie nearest the median of all,
        along the axis where they are farther, count as most of them.
      crs: of the polygons; the box does not depend on it.
      extent: west, south, east, north in degrees.

    Returns:
      West, south, east, north in degrees, rounded outward to some 10 m.
    """
    boxes = lonlat_boxes(polygons, crs)
    boxes = boxes[shapely.intersects(shapely.box(*boxes.T), shapely.box(*extent))]
    if not len(boxes):
        return None
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2
    middle = np.median(centre, axis=0)
    off = (np.abs(centre - middle) * [np.cos(np.radians(middle[1])), 1.0]).max(axis=1)
    main = rounded_outward(boxes[off <= np.quantile(off, MAIN_SHARE, method="higher")])
    return main if shapely.box(*main).area < SMALL_PART * shapely.box(*extent).area else None
