"""QGroundControl plan: take-off at the first point, a waypoint at every turn, and an end at the last point.

Waypoints are those of `waypoints`: simplify the path first (`jaxurban.simplify`) for a mission of tens. Altitudes are
relative to the home position, the first point. Over maps with terrain they follow the ground, and home has the terrain
file's elevation. Without terrain level ground is assumed, and home is at 0 m; `height_note` says which. The mission
ends with a landing at the last point, or with the autopilot's return, or hovers there (`ENDS`). A report's speed is
set after take-off. The no-fly zones near the path that it was planned around are exclusion polygons of the geofence.
The file holds what to know of all that as ``note`` beside the path's ``settings``.
"""

import json
from collections.abc import Sequence
from typing import Any

from jaxurban.errors import InputError
from jaxurban.flights.export.base import (
    Z_DECIMALS,
    Named,
    Waypoints,
    description_of,
    facts_of,
    upward,
    waypoints,
)
from jaxurban.flights.export.fences import exclusions
from jaxurban.flights.export.own_check import check_own
from jaxurban.flights.missions.flight import LAND, RETURN, SPEED, TAKEOFF, WAYPOINT
from jaxurban.flights.missions.items import FIRMWARES
from jaxurban.flights.missions.parts import AUTOPILOTS
from jaxurban.kernels.tolerances import GROUND_TOLERANCE_M
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.route_report import RouteReport
from jaxurban.settings import FlownBy, MissionEnd

# MAVLink common message set, and the values that QGroundControl's plan format takes from it
MAV_FRAME_MISSION, MAV_FRAME_GLOBAL_RELATIVE_ALT = 2, 3
MAV_TYPE_QUADROTOR = 2
FIRMWARE_TYPES = {name: number for number, name in FIRMWARES.items()}
ALTITUDE_RELATIVE = 1
GROUND_SPEED, THROTTLE_AS_IT_IS = 1, -1

END_NOTES: dict[MissionEnd, str] = {
    "land": "It ends with a landing at the goal.",
    "return": "It ends with the autopilot's return to launch: straight home at the autopilot's own altitude, which was "
    "not checked for obstacles.",
    "none": "It ends at the last waypoint, without a landing.",
}


def height_note(route: PlannedPath) -> str:
    """Return what the altitudes of a ``.plan`` take the ground for, in a sentence or two."""
    if route.ground is None:
        return (
            "These maps hold no terrain, so level ground is assumed: altitudes are relative to home, and equal heights "
            "above ground only where the ground is as high as there. Home's elevation is not known and written as 0."
        )
    return (
        f"Altitudes are relative to home and follow the ground: straight lines between waypoints keep at least the "
        f"planned height above it, and at most {GROUND_TOLERANCE_M:g} m more. Home is at "
        f"{route.ground.elevation_m[0]:.1f} m above the zero of the terrain file, whose vertical datum need not be "
        "mean sea level."
    )


def mission_note(route: PlannedPath, end: MissionEnd = "land", autopilot: FlownBy = "px4") -> str:
    """Return what to know of a ``.plan``: its autopilot, altitudes, end and geofence, in a few sentences."""
    _, zone_note = exclusions(route)
    flown_by = f"It is a mission for {AUTOPILOTS[autopilot]}."
    return f"{flown_by} {height_note(route)} {END_NOTES[end]} {zone_note}".rstrip()


def to_qgc_plan(
    routes: Named,
    report: RouteReport | None,
    end: MissionEnd = "land",
    autopilot: FlownBy = "px4",
) -> bytes:
    """Return a path as a mission of QGroundControl, JSON in UTF-8, if its own check finds nothing (`check_own`).

    Args:
      routes: one path with its name, which the format has no place for.
      report: of the path, whose speed the mission takes; without one, the speed of the path's vehicle, if it has any.
      end: how the mission ends, one of `ENDS`.
      autopilot: which one flies it. The items are the same, as both know them; each is judged as it flies them.

    Raises:
      InputError: several paths, or findings of the check.
    """
    if len(routes) > 1:
        raise InputError(
            f"a .plan holds one path, and these are {len(routes)}: write a file for each"
        )

    # What the file says: the facts of the path, its waypoints, the height of home and the rings to keep out of.
    ((_, route, facts),) = facts_of(routes, report)
    speed_m_s = facts.get("speed_m_s")
    along = waypoints(route)
    home_m = 0.0 if along.ground_m is None else float(upward(along.ground_m[0]))
    rings, _ = exclusions(route)
    plan: dict[str, Any] = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        # No key of the format: readers leave it alone.
        "note": description_of(facts, mission_note(route, end, autopilot)),
        "settings": facts["settings"],  # nor is this: what the path was planned under
        "mission": {
            "version": 2,
            "firmwareType": FIRMWARE_TYPES[autopilot],
            "vehicleType": MAV_TYPE_QUADROTOR,
            "globalPlanAltitudeMode": ALTITUDE_RELATIVE,
            "cruiseSpeed": speed_m_s or 15,  # m/s; else QGroundControl's defaults
            "hoverSpeed": speed_m_s or 5,
            "plannedHomePosition": [*along.lonlat[0, ::-1].tolist(), home_m],
            "items": _items(along, speed_m_s, end),
        },
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                {"version": 1, "inclusion": False, "polygon": ring[:, ::-1].tolist()}
                for ring in rings
            ],
        },
        "rallyPoints": {"version": 2, "points": []},
    }
    plan["note"] += f" {check_own(route, _encoded(plan))}"
    return _encoded(plan)


def _encoded(plan: dict[str, Any]) -> bytes:
    """Return a plan as JSON in UTF-8."""
    return (json.dumps(plan, indent=2, allow_nan=False) + "\n").encode()


def _items(along: Waypoints, speed_m_s: float | None, end: str) -> list[dict[str, Any]]:
    """Return the items of a mission: take-off, the speed if it is given, waypoints, the end.

    Args:
      along: the waypoints; the mission takes off at the first.
      speed_m_s: over the ground; None leaves it to the autopilot.
      end: one of `ENDS`; ``"none"`` adds no item.
    """
    lonlats = along.lonlat.tolist()
    heights_m = upward(along.above_home_m).tolist()
    items = [_place(TAKEOFF, lonlats[0], heights_m[0])]
    if speed_m_s is not None:
        params = [GROUND_SPEED, speed_m_s, THROTTLE_AS_IT_IS, 0, 0, 0, 0]
        items.append(_command(SPEED, params))
    for lonlat, height_m in zip(lonlats[1:], heights_m[1:], strict=True):
        items.append(_place(WAYPOINT, lonlat, height_m))
    if end == "land":
        ground_m = 0.0 if along.ground_m is None else float(along.ground_m[-1] - along.ground_m[0])
        items.append(_place(LAND, lonlats[-1], round(ground_m, Z_DECIMALS)))
    elif end == "return":
        items.append(_command(RETURN, [0] * 7))
    return [item | {"doJumpId": number} for number, item in enumerate(items, start=1)]


def _place(command: int, lonlat: Sequence[float], z_m: float) -> dict[str, Any]:
    """Return an item of a mission at a place.

    Args:
      command: number of the MAVLink command.
      lonlat: longitude, latitude in degrees.
      z_m: altitude above home.
    """
    lon, lat = lonlat
    any_yaw = None
    params = [0, 0, 0, any_yaw, lat, lon, z_m]
    height = {"Altitude": z_m, "AltitudeMode": ALTITUDE_RELATIVE, "AMSLAltAboveTerrain": None}
    return _command(command, params, MAV_FRAME_GLOBAL_RELATIVE_ALT) | height


def _command(
    command: int, params: Sequence[float | None], frame: int = MAV_FRAME_MISSION
) -> dict[str, Any]:
    """Return an item of a mission as the JSON of a plan has it.

    Args:
      command: number of the MAVLink command.
      params: its seven parameters; None for one that the autopilot chooses.
      frame: in which they count: `MAV_FRAME_MISSION` for commands that have no place.
    """
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "frame": frame,
        "params": params,
    }
