"""Missions of MAVLink's items from files: QGroundControl's ``.plan``, and the rows of ``QGC WPL 110``."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
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

HEADER = "QGC WPL 110"
NUM_COLUMNS = 12
ARDUPILOT = 3  # MAV_AUTOPILOT
PLANES = (1, *range(19, 26))  # MAV_TYPE: fixed wing, and VTOL of every kind
# QGroundControl's AltitudeMode: it makes metres above the geoid of metres above ground.
CALCULATED = 3
BESIDE = {"geoFence": "geofence is", "rallyPoints": "rally points are"}
SAME_M = 0.1
Home = tuple[LonLat | None, float | None]  # its place, and its elevation above the geoid


def read_plan(data: bytes, name: str, home: LonLat | None, return_altitude_m: float) -> Mission:
    """Return the mission of a plan of QGroundControl.

    Raises:
      InputError, ValueError: it is none, holds no item, or an item cannot be read.
    """
    plan = _object(json.loads(data), "it")
    mission = _object(plan.get("mission"), "its mission")
    listed = mission.get("items")
    if not isinstance(listed, list):
        raise ValueError("its items are no list")
    items = [_item_of_plan(row, number) for number, row in enumerate(listed, 1)]
    if mission.get("firmwareType") == ARDUPILOT:
        items = [_without_place(item) for item in items]
    position = (*(mission.get("plannedHomePosition") or ()), None, None, None)[:3]
    lat, lon, elevation_m = (number_of("plannedHomePosition", each) for each in position)
    notes = []
    for part, words in BESIDE.items():
        values = (plan.get(part) or {}).values()
        if any(isinstance(value, list) and value for value in values):
            notes.append(f"its {words} not judged")
    is_plane = mission.get("vehicleType") in PLANES
    if is_plane:
        notes.append("the vehicle is an aeroplane, whose turns and glide path are not judged")
    speed_m_s = number_of("its speed", mission.get("cruiseSpeed" if is_plane else "hoverSpeed"))
    own = _home(lon, lat, elevation_m)
    return _flown(name, items, home, own, return_altitude_m, notes, speed_m_s)


def read_waypoints(
    data: bytes, name: str, home: LonLat | None, return_altitude_m: float
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
    own: Home = (None, None)
    if items and items[0].key == 0 and items[0].command in (0, WAYPOINT):
        first = items.pop(0)
        is_above_geoid = first.datum == "geoid"
        own = _home(first.lon, first.lat, first.height_m if is_above_geoid else math.nan)
        items = [_without_place(item) for item in items]
    numbered = [item._replace(number=number) for number, item in enumerate(items, 1)]
    return _flown(name, numbered, home, own, return_altitude_m, [], math.nan)


def _flown(
    name: str,
    items: Sequence[Item],
    home: LonLat | None,
    own: Home,
    return_altitude_m: float,
    notes: Sequence[str],
    speed_m_s: float,
) -> Mission:
    """Return the mission of items, from the home that is given, else from its own.

    Raises:
      InputError: there is none, or none that leads anywhere.
    """
    if not items:
        raise InputError(f"{name!r} holds no items: give a mission that has some")
    start: Home = (home, None) if home else own
    flight = Flight(items, start[0], return_altitude_m)
    sentences = shortened([*flight.not_judged, *notes])
    if not flight.legs and not sentences:
        raise InputError(f"{name!r} leads nowhere: give a mission that has waypoints")
    first_m_s = flight.speed_m_s or (speed_m_s if speed_m_s > 0 else None)
    return Mission(name, tuple(flight.legs), *start, sentences, first_m_s)


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


def _item_of_plan(value: Any, number: int) -> Item:
    """Return an item of a plan.

    QGroundControl flies at its ``Altitude``, and other programs at its seventh parameter: both must be the same, but
    for heights above ground of which QGroundControl calculates those above the geoid, where it knows the terrain.
    """
    what = f"item {number}"
    row = _object(value, what)
    key = whole_of(f"doJumpId of {what}", row.get("doJumpId", number))
    if row.get("type") != "SimpleItem":
        kind = str(row.get("complexItemType"))[:40]
        kind = kind if kind.isidentifier() else "strange item"
        return Item(number, key, -1, what=f"a {kind} (ComplexItem)")
    params = row.get("params")
    if not isinstance(params, list) or len(params) != 7:
        raise ValueError(f"{what} has no list of seven params")
    values = [number_of(f"a parameter of {what}", param) for param in params]
    command, frame = (whole_of(f"{part} of {what}", row.get(part)) for part in ("command", "frame"))
    item = _item(what, number, key, command, frame, values)
    shown_m = number_of(f"Altitude of {what}", row.get("Altitude"))
    if row.get("AltitudeMode") == CALCULATED and item.datum == "geoid":
        is_open = math.isnan(item.height_m)
        return item._replace(height_m=shown_m, datum="ground") if is_open else item
    if command in HAS_HEIGHT and abs(item.height_m - shown_m) > SAME_M:
        raise ValueError(
            f"{what} has params of {item.height_m:g} m and an Altitude of {shown_m:g} m"
        )
    return item


def _float(text: str) -> float | str:
    with suppress(ValueError):
        return float(text)
    return text


def _item_of_row(cells: Sequence[str], line: int) -> Item:
    """Return an item of a row: number, current, frame, command, four parameters, latitude, longitude, height, go on."""
    what = f"line {line}"
    if len(cells) != NUM_COLUMNS:
        raise ValueError(f"{what} has {len(cells)} values, and not {NUM_COLUMNS}")
    numbers = [number_of(f"a value of {what}", _float(cell)) for cell in cells]
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
