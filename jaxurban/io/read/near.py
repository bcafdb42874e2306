"""What of a file lies near a region: boxes of features tell before their geometry is decoded."""

from typing import NamedTuple

import numpy as np
from pyproj.exceptions import ProjError

from jaxurban.world.grid import Bounds, transformer

MARGIN_M = 1000.0  # more than projections tilt boxes against each other, and than most outlines and their parts reach


class Near(NamedTuple):
    """A region whose surroundings are read.

    Attributes:
      bounds_m: x_min, y_min, x_max, y_max; what does not touch them is not needed.
      crs: their projected CRS.
    """

    bounds_m: Bounds
    crs: str

    def box_in(self, crs: str) -> Bounds | None:
        """Return the box of the region and `MARGIN_M` around it in another CRS; None where no box holds it."""
        x_min, y_min, x_max, y_max = self.bounds_m
        wide_m = x_min - MARGIN_M, y_min - MARGIN_M, x_max + MARGIN_M, y_max + MARGIN_M
        box = box_between(wide_m, self.crs, crs)
        return box if box is not None and box[0] < box[2] else None  # else it lies across the antimeridian


def box_between(box: Bounds, crs: str, other: str) -> Bounds | None:
    """Return the box in another CRS around a box; None where there is none or it reaches beyond the projection."""
    if not np.isfinite(box).all():
        return None
    try:
        found = transformer(crs, other).transform_bounds(*box, densify_pts=101)
    except ProjError:
        return None
    return found if np.isfinite(found).all() else None


def meets(boxes: np.ndarray, box: Bounds) -> np.ndarray:
    """Return which of the boxes ``[N, 4]`` touch a box, ``[N]`` bool; none that is NaN does."""
    x_min, y_min, x_max, y_max = boxes.T
    return (x_min <= box[2]) & (x_max >= box[0]) & (y_min <= box[3]) & (y_max >= box[1])


def extent_of(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes ``[N, 4]``, NaN left out; inf and -inf without any."""
    low, high = np.fmin.reduce(boxes[:, :2], initial=np.inf), np.fmax.reduce(boxes[:, 2:], initial=-np.inf)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def near_rows(boxes: np.ndarray, box: Bounds) -> np.ndarray:
    """Return which features to read, ``[N]`` bool: those that touch a box, and all that touch one of these.

    So every outline comes with all its parts, and every part with its outline, however large they are.
    """
    is_near = meets(boxes, box)
    return meets(boxes, extent_of(boxes[is_near])) if is_near.any() else is_near
