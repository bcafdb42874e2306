"""Missions of MAVLink's items from files: QGroundControl's ``.plan``, and the rows of ``QGC WPL 110``."""

import json
import math
from collections.abc import Sequence
from typing import Any

from jaxurban.errors import InputError
from jaxurban.io.read.mission_flight import FRAMES, HAS_HEIGHT, TAKEOFFS, WAYPOINT, Flight, Item
from jaxurban.io.read.mission_parts import (
    LonLat,
    Mission,
    check_place,
    number_of,
    shortened,
    whole_of,
)

HEADER, NUM_COLUMNS = "QGC WPL 110", 12
ARDUPILOT, PLANES = (
    3,
    (1, *range(19, 26)),
)  # MAV_AUTOPILOT; MAV_TYPE: fixed wing, and VTOL of every kind
CALCULATED = (
    3  # QGroundControl's AltitudeMode: it makes metres above the geoid of metres above ground
)
SAME_M = 0.1
Home = tuple[LonLat | None, float | None]  # its place, and its elevation above the geoid


def read_plan(
    data: bytes, name: str, home: LonLat | None, return_altitude_m: float | None
) -> Mission:
    """Return the mission of a plan of QGroundControl.

    Raises:
      InputError, ValueError: it is none, holds no item, or an item cannot be read.
    """
    plan = _object(json.loads(data), "it")
    if not isinstance(plan.get("mission"), dict):
        raise InputError(f"{name!r} holds no mission: save it in QGroundControl again, as a .plan")
    mission = plan["mission"]
    listed = mission.get("items")
    if not isinstance(listed, list):
        raise ValueError("its items are no list")
    items, notes = [], list[str]()
    for number, row in enumerate(listed, 1):
        items.append(_item_of_plan(_object(row, f"item {number}"), number, notes))
    where = mission.get("plannedHomePosition")
    where = where if isinstance(where, list) and len(where) >= 2 else [None, None]
    lat, lon, elevation_m = (number_of("plannedHomePosition", each) for each in (*where, None)[:3])
    is_plane = mission.get("vehicleType") in PLANES
    if is_plane:
        notes.append("the vehicle is an aeroplane, whose turns and glide path are not judged")
    fence, rally = plan.get("geoFence"), plan.get("rallyPoints")
    parts = ("circles", "polygons", "polygon")
    if isinstance(fence, dict) and any(fence.get(part) for part in parts):
        notes.append("its geofence is not judged")
    if isinstance(rally, dict) and rally.get("points"):
        notes.append("its rally points are not judged")
    speed_m_s = number_of("its speed", mission.get("cruiseSpeed" if is_plane else "hoverSpeed"))
    is_ardupilot = mission.get("firmwareType") == ARDUPILOT
    return _flown(
        name,
        [_without_place(item) for item in items] if is_ardupilot else items,
        (home, None) if home else _home(lon, lat, elevation_m),
        return_altitude_m,
        notes,
        speed_m_s if speed_m_s > 0 else None,
    )


def read_waypoints(
    data: bytes, name: str, home: LonLat | None, return_altitude_m: float | None
) -> Mission:
    """Return the mission of a file of ``QGC WPL 110``, whose row 0 is home if it is a waypoint.

    Raises:
      InputError, ValueError: it is none, holds no item, or a row cannot be read.
    """
    lines = [line.strip() for line in data.decode("utf-8-sig", "replace").splitlines()]
    rows = [(number, line) for number, line in enumerate(lines, 1) if line[:1] not in ("", "#")]
    if not rows or rows[0][1] != HEADER:
        raise InputError(
            f"{name!r} does not begin with {HEADER!r}: save the mission again, as .waypoints or .plan"
        )
    items = [_item_of_row(line.split(), number) for number, line in rows[1:]]
    own_home: Home = (None, None)
    if items and items[0].key == 0 and items[0].command in (0, WAYPOINT):
        first = items.pop(0)
        is_above_geoid = first.datum == "geoid"
        own_home = _home(first.lon, first.lat, first.height_m if is_above_geoid else math.nan)
        items = [_without_place(item) for item in items]
    numbered = [item._replace(number=number) for number, item in enumerate(items, 1)]
    return _flown(name, numbered, (home, None) if home else own_home, return_altitude_m, [], None)


def _flown(
    name: str,
    items: Sequence[Item],
    home: Home,
    return_altitude_m: float | None,
    notes: Sequence[str],
    speed_m_s: float | None,
) -> Mission:
    """Return the mission of items.

    Raises:
      InputError: there is none, or none that leads anywhere.
    """
    if not items:
        raise InputError(f"{name!r} holds no items: give a mission that has some")
    flight = Flight(items, home[0], return_altitude_m)
    sentences = shortened([*flight.not_judged, *notes])
    if not flight.legs and not sentences:
        raise InputError(f"{name!r} leads nowhere: give a mission that has waypoints")
    speed_m_s = flight.speed_m_s or speed_m_s
    return Mission(name, tuple(flight.legs), *home, sentences, speed_m_s)


def _object(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what} is no JSON object")
    return value


def _home(lon: float, lat: float, elevation_m: float) -> Home:
    """Return home and its elevation, None for what is not set: NaN, or 0, which ground stations write instead."""
    check_place("home", lon, lat, elevation_m)
    if math.isnan(lon) or math.isnan(lat) or (lon, lat) == (0, 0):
        return None, None
    return (lon, lat), elevation_m if abs(elevation_m) > 0 else None


def _without_place(item: Item) -> Item:
    """Return an item as ArduPilot reads it, which takes off where it stands."""
    return item._replace(lon=0.0, lat=0.0) if item.command in TAKEOFFS else item


def _item_of_plan(row: dict[str, Any], number: int, notes: list[str]) -> Item:
    """Return an item of a plan; ``notes`` get what is strange about its height."""
    what = f"item {number}"
    key = whole_of(f"doJumpId of {what}", row.get("doJumpId", number))
    if row.get("type") != "SimpleItem":
        kind = str(row.get("complexItemType", "kind of item"))[:40]
        return Item(number, key, -1, what=f"a {kind} ({str(row.get('type'))[:40]})")
    params = row.get("params")
    if not isinstance(params, list) or len(params) != 7:
        raise ValueError(f"{what} has no list of seven params")
    values = [number_of(f"a parameter of {what}", value) for value in params]
    command = whole_of(f"command of {what}", row.get("command"))
    item = _item(what, number, key, command, whole_of(f"frame of {what}", row.get("frame")), values)
    if command not in HAS_HEIGHT:
        return item
    shown_m, amsl_m = (
        number_of(f"{part} of {what}", row.get(part))
        for part in ("Altitude", "AMSLAltAboveTerrain")
    )
    is_calculated = row.get("AltitudeMode") == CALCULATED and item.datum == "geoid"
    if is_calculated and math.isnan(item.height_m):  # QGroundControl has not seen the terrain
        return item._replace(height_m=shown_m, datum="ground")
    meant_m = amsl_m if item.datum == "geoid" and amsl_m == amsl_m else shown_m
    if abs(item.height_m - meant_m) > SAME_M:
        notes.append(
            f"the height of {what} is not judged: its params say {item.height_m:g} m, and its Altitude {meant_m:g} m"
        )
        return item._replace(height_m=math.nan, is_height_open=True)
    return item


def _item_of_row(cells: Sequence[str], line: int) -> Item:
    """Return an item of a row: number, current, frame, command, four parameters, latitude, longitude, height, go on."""
    what = f"line {line}"
    if len(cells) != NUM_COLUMNS:
        raise ValueError(f"{what} has {len(cells)} values, and not {NUM_COLUMNS}")
    try:
        numbers = [number_of(f"a value of {what}", float(cell)) for cell in cells]
    except ValueError as error:
        raise ValueError(f"a value of {what} is no finite number") from error
    key, frame, command = (whole_of(f"a value of {what}", numbers[column]) for column in (0, 2, 3))
    return _item(what, line, key, command, frame, numbers[4:11])


def _item(
    what: str, number: int, key: int, command: int, frame: int, values: Sequence[float]
) -> Item:
    """Return an item of its seven values: four parameters, latitude, longitude and height."""
    *params, lat, lon, height_m = values
    datum = FRAMES.get(frame)
    if datum:
        check_place(what, lon, lat, height_m)
    return Item(number, key, command, tuple(params), lon, lat, height_m, datum)
