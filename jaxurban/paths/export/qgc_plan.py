"""QGroundControl plan: take-off at the first point, then a waypoint at every turn.

Points within a centimetre of the straight line between their neighbours are left out, so that a grid path is not a
mission of thousands. Altitudes are relative to the home position, the first point. Over maps with terrain they follow
the ground: points are added until the straight lines between waypoints miss the planned height above ground by at
most `GROUND_TOLERANCE_M`, and home has the terrain file's elevation. Without terrain level ground is assumed, and
home is at 0 m; `height_note` says which, and the
file holds it as ``note`` beside the path's ``settings``. There is no landing: a pilot adds it.
"""

import json
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import shapely

from jaxurban.errors import InputError
from jaxurban.paths.export.base import DECIMALS, Z_DECIMALS, Named, facts_of

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath

STRAIGHT_M = 0.01  # a waypoint closer than this to the line through its neighbours is left out
GROUND_TOLERANCE_M = 1.0  # by which the straight lines may miss the planned height above ground

# MAVLink common message set, and the values that QGroundControl's plan format takes from it
MAV_CMD_NAV_WAYPOINT, MAV_CMD_NAV_TAKEOFF = 16, 22
MAV_FRAME_GLOBAL_RELATIVE_ALT = 3
MAV_AUTOPILOT_PX4, MAV_TYPE_QUADROTOR = 12, 2
ALTITUDE_RELATIVE = 1


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


def _waypoints(route: "PlannedPath") -> np.ndarray:
    """Return ``[W, 3]`` longitude, latitude and height above the first point's ground of a mission's waypoints."""
    if route.ground is None:
        return np.column_stack([route.lonlat, route.z_m])[_turns(route.xy_m, route.z_m)]
    ground, number = route.ground, np.arange(len(route.z_m))
    xyz_m = np.column_stack([np.interp(ground.at, number, values) for values in (*route.xy_m.T, route.z_m)])
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)))
    height_m = xyz_m[:, 2] + ground.elevation_m - ground.elevation_m[0]
    kept = _with_bends(_turns(xyz_m[:, :2], xyz_m[:, 2]), along_m, height_m)
    return np.column_stack([ground.lonlat, height_m])[kept]


def height_note(route: "PlannedPath") -> str:
    """Return what the altitudes of a ``.plan`` take the ground for, in a sentence or two."""
    if route.ground is None:
        return (
            "These maps hold no terrain, so level ground is assumed: altitudes are relative to home, and equal heights "
            "above ground only where the ground is as high as there. Home's elevation is not known and written as 0."
        )
    return (
        f"Altitudes are relative to home and follow the ground: straight lines between waypoints keep the planned "
        f"height above it within {GROUND_TOLERANCE_M:g} m. Home is at {route.ground.elevation_m[0]:.1f} m above the "
        "zero of the terrain file, whose vertical datum need not be mean sea level."
    )


def to_qgc_plan(routes: Named, report: "RouteReport | None") -> bytes:
    """Return a path as a mission of QGroundControl.

    Raises:
      InputError: several paths.
    """
    if len(routes) > 1:
        raise InputError(f"a .plan holds one path, and these are {len(routes)}: write a file for each")
    ((_, route),) = routes
    facts, _ = facts_of(route, report)
    speed_m_s = facts.get("speed_m_s")
    home_m = 0.0 if route.ground is None else float(route.ground.elevation_m[0])
    corners = np.round(_waypoints(route), DECIMALS).tolist()
    commands = [MAV_CMD_NAV_TAKEOFF] + [MAV_CMD_NAV_WAYPOINT] * (len(corners) - 1)
    items = [
        {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": command,
            "doJumpId": number,
            "frame": MAV_FRAME_GLOBAL_RELATIVE_ALT,
            "Altitude": z_m,
            "AltitudeMode": ALTITUDE_RELATIVE,
            "AMSLAltAboveTerrain": None,
            "params": [0, 0, 0, None, lat, lon, z_m],  # the fourth: yaw as the autopilot sees fit
        }
        for number, (command, (lon, lat, z_m)) in enumerate(zip(commands, corners, strict=True), start=1)
    ]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "note": f"{height_note(route)} {facts['message']}".strip(),  # no key of the format: readers leave it alone
        "settings": facts.get("settings", {}),  # nor is this: what the path was planned under, for fits of weights
        "mission": {
            "version": 2,
            "firmwareType": MAV_AUTOPILOT_PX4,
            "vehicleType": MAV_TYPE_QUADROTOR,
            "globalPlanAltitudeMode": ALTITUDE_RELATIVE,
            "cruiseSpeed": speed_m_s or 15,  # m/s; else QGroundControl's defaults
            "hoverSpeed": speed_m_s or 5,
            "plannedHomePosition": [corners[0][1], corners[0][0], round(home_m, Z_DECIMALS)],
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return (json.dumps(plan, indent=2, allow_nan=False) + "\n").encode()
