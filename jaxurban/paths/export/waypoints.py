"""The waypoints of a planned path: where it bends in plan or in height, over terrain also where the ground does.

Points within a centimetre of the straight line between their neighbours are left out, so that a grid path is not a
mission of thousands. Over maps with terrain points are added until the straight lines between waypoints miss the
planned height above ground by at most `GROUND_TOLERANCE_M`.
"""

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from jaxurban.paths.export.base import DECIMALS

if TYPE_CHECKING:
    from jaxurban.paths.path import PlannedPath

STRAIGHT_M = 0.01  # a waypoint closer than this to the line through its neighbours is left out
GROUND_TOLERANCE_M = 1.0  # by which the straight lines may miss the planned height above ground


class Waypoints(NamedTuple):
    """Waypoints of a path. ``W`` of them.

    Attributes:
      lonlat: ``[W, 2]`` longitude, latitude in degrees, as they are written.
      z_m: ``[W]`` planned height above ground.
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
    if route.ground is None:
        kept = _turns(route.xy_m, route.z_m)
        return Waypoints(np.round(route.lonlat[kept], DECIMALS), np.asarray(route.z_m)[kept], None)
    ground, number = route.ground, np.arange(len(route.z_m))
    xyz_m = np.column_stack([np.interp(ground.at, number, values) for values in (*route.xy_m.T, route.z_m)])
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)))
    kept = _with_bends(_turns(xyz_m[:, :2], xyz_m[:, 2]), along_m, xyz_m[:, 2] + ground.elevation_m)
    return Waypoints(np.round(ground.lonlat[kept], DECIMALS), xyz_m[kept, 2], ground.elevation_m[kept])


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
    """Return the indices to keep and more, so that straight lines miss no height by more than the tolerance, ``[W]``.

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
        if missed_m.max(initial=0.0) > GROUND_TOLERANCE_M:
            worst = int(inner[np.argmax(missed_m)])
            bends.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.array(sorted(bends))
