"""The waypoints of a planned path: where it bends in plan or in height, over terrain also where the ground does.

Points within a centimetre of the straight line between their neighbours are left out, so that a grid path is not a
mission of thousands. No straight line between waypoints is lower than planned: these are raised by as much as a line
would be. Over maps with terrain points are added until no line is more than `GROUND_TOLERANCE_M` higher.
"""

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from jaxurban.paths.export.base import DECIMALS
from jaxurban.paths.ground import MOST_BULGE_M

if TYPE_CHECKING:
    from jaxurban.paths.path import PlannedPath

STRAIGHT_M = 0.01  # a waypoint closer than this to the line through its neighbours is left out
GROUND_TOLERANCE_M = 1.0  # by which the straight lines may exceed the planned height above ground
MISSED_M = GROUND_TOLERANCE_M / 2 - MOST_BULGE_M  # twice, and the rest is for the ground's cover and for rounding up


class Waypoints(NamedTuple):
    """Waypoints of a path. ``W`` of them.

    Attributes:
      lonlat: ``[W, 2]`` longitude, latitude in degrees, as they are written.
      z_m: ``[W]`` height above ground, the planned one or more.
      ground_m: ``[W]`` the ground's elevation above the zero of the terrain file; None over maps without terrain.
    """

    lonlat: np.ndarray
    z_m: np.ndarray
    ground_m: np.ndarray | None

    @property
    def above_home_m(self) -> np.ndarray:
        """``[W]`` height above the ground at the first waypoint; level ground is assumed where it is not known."""
        return self.z_m if self.ground_m is None else self.z_m + self.ground_m - self.ground_m[0]


def waypoints(route: "PlannedPath") -> Waypoints:
    """Return the waypoints of a path."""
    ground, lonlat = route.ground, route.lonlat
    xyz_m = np.column_stack([route.xy_m, route.z_m])
    height_m = xyz_m[:, 2]
    if ground is not None:
        lonlat, number = ground.lonlat, np.arange(len(xyz_m))
        xyz_m = np.column_stack([np.interp(ground.at, number, values) for values in xyz_m.T])
        height_m = xyz_m[:, 2] + ground.cover_m
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)))
    kept = _turns(xyz_m[:, :2], xyz_m[:, 2])
    if ground is not None:
        kept = _with_bends(kept, along_m, height_m)
    too_low_m = height_m - np.interp(along_m, along_m[kept], height_m[kept])
    of_leg_m = np.maximum.reduceat(too_low_m, kept[:-1]) if len(kept) > 1 else np.zeros(0)
    raised_m = height_m[kept] + np.maximum(np.append(of_leg_m, 0.0), np.append(0.0, of_leg_m)).clip(0.0)
    elevation_m = None if ground is None else ground.elevation_m[kept]
    z_m = raised_m if elevation_m is None else raised_m - elevation_m
    return Waypoints(np.round(lonlat[kept], DECIMALS), z_m, elevation_m)


def _turns(xy_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """Return the indices of the points that bend the path, in plan or in profile, first and last included, ``[W]``."""
    if len(xy_m) < 3:
        return np.arange(len(xy_m))
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T)))
    bends = [
        # The index rides along as z, which simplifying ignores.
        shapely.LineString(np.column_stack([drawn, np.arange(len(drawn))])).simplify(STRAIGHT_M)
        for drawn in (xy_m, np.column_stack([along_m, z_m]))
    ]
    return np.unique(np.concatenate([shapely.get_coordinates(line, include_z=True)[:, 2] for line in bends])).astype(
        int
    )


def _with_bends(kept: np.ndarray, along_m: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Return the indices to keep and more, so that lines miss no height by more than `MISSED_M`, ``[W]``.

    Raised by as much they are nowhere too low.

    Args:
      kept: indices that stay, first and last included.
      along_m: ``[G]`` length flown.
      height_m: ``[G]`` height to keep to.
    """
    bends, spans = set(kept.tolist()), list(pairwise(kept.tolist()))
    while spans:
        first, last = spans.pop()
        inner = np.arange(first + 1, last)
        line_m = np.interp(along_m[inner], along_m[[first, last]], height_m[[first, last]])
        missed_m = np.abs(height_m[inner] - line_m)
        if missed_m.max(initial=0.0) > MISSED_M:
            worst = int(inner[np.argmax(missed_m)])
            bends.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.array(sorted(bends))
