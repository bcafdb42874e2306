"""Missions of MAVLink's items from files: QGroundControl's ``.plan``, and rows of ``QGC WPL 110`` and ``120``."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from jaxurban.errors import InputError
from jaxurban.flights.missions.fence import read_geofence
from jaxurban.flights.missions.flight import (
    FRAMES,
    HAS_HEIGHT,
    JUMP,
    LOITER_TURNS,
    PLACED,
    SPLINE,
    WAYPOINT,
    FlownItems,
    Item,
)
from jaxurban.flights.missions.parts import (
    AUTOPILOTS,
    Autopilot,
    DamagedError,
    Datum,
    LonLat,
    Mission,
    check_place,
    decimal_of,
    first_sentences,
    flyers,
    json_of,
    number_of,
    one_value,
    whole_of,
)
from jaxurban.public import listed
from jaxurban.settings import FlownBy

# FeasibilityChecker.cpp (checkHorizontalDistanceToFirstWaypoint; up to 1.13 MIS_DIST_WPS, too) and mission_base.cpp
# (do_need_move_to_item) of PX4, and its issue 18239. ArduPilot stays, so a file with it was written for that.
ZERO_PLACE = (
    "PX4 takes 0, 0 for a place, and refuses the mission or flies there; here items that have it ({}) stay where the "
    "vehicle is."
)
# mavlink_mission.cpp of PX4 (parse_mavlink_mission_item): neither these frames nor these commands are accepted.
REFUSED = (
    "PX4 refuses the mission for items {}: it takes no height above the terrain (frames 10 and 11), no circle of so "
    "many turns (18) and no spline (82)."
)
HEADER = "QGC WPL 110"
OF_PARROT = "QGC WPL 120"  # with the same columns
NUM_COLUMNS = 12
FIRMWARES: dict[Any, FlownBy] = {3: "ardupilot", 12: "px4"}  # by the number of MAV_AUTOPILOT
SURVEYS = ("survey", "CorridorScan")  # complex items that hold the simple ones that are flown
# Numbers of MAV_TYPE: multicopters (0: a generic vehicle), and names of some that are none.
MULTICOPTERS = (None, 0, 2, 13, 14, 15, 29, 35, 43)
VEHICLES = dict.fromkeys(range(19, 26), "a VTOL aeroplane")
VEHICLES |= {1: "an aeroplane", 4: "a helicopter", 10: "a rover", 11: "a boat", 12: "a submarine"}
# QGroundControl's AltitudeMode, and what heights are above by it; None where it does not say it. The last of these
# makes metres above the geoid of metres above ground.
RELATIVE, ABSOLUTE, CALCULATED = 1, 2, 3
ALTITUDE_MODES: dict[Any, Datum | None] = {
    None: None,
    0: None,
    RELATIVE: "home",
    ABSOLUTE: "geoid",
    CALCULATED: "geoid",
    4: "ground",
    5: None,
}
SAME_M = 0.1
LOWEST_M, HIGHEST_M = -500.0, 9000.0  # that ground lies at, above the geoid
NANS = ("nan", "-nan", "NaN")  # as C and .NET write a value that is left open
# Versions that are known, and parts that are read, that jaxurban adds, or that matter only once a fence is breached;
# others that hold something are named.
KNOWN = (
    ("version", 1, ("mission", "settings", "geoFence", "rallyPoints")),
    ("version of its mission", 2, ("items", "plannedHomePosition")),
    ("version of its geofence", 2, ("version", "polygons", "circles", "breachReturn")),
)
Home = tuple[LonLat | None, float | None]  # its place, and its elevation above the geoid


def read_plan(
    data: bytes,
    name: str,
    home: LonLat | None,
    return_altitude_m: float,
    autopilot: FlownBy | None = None,
) -> Mission:
    """Return the mission of a plan of QGroundControl.

    Args:
      data: the bytes of the file, JSON.
      name: of the file, for messages.
      home: longitude and latitude in degrees in place of the plan's; None takes the plan's.
      return_altitude_m: metres above home, NaN where it is not known.
      autopilot: which flies it, None as the plan says.

    Raises:
      InputError: the plan holds no item, or leads nowhere, it is a file of fences or rally points, or another autopilot
        flies it.
      DamagedError: it is no plan, or an item cannot be read.
    """
    plan = _object(json_of(data), "it")
    kind = plan.get("fileType")
    if kind not in (None, "Plan"):
        raise InputError(
            f"{name!r} is of the type {str(kind)[:40]!r}, which holds no mission: save the whole plan (fileType 'Plan')"
        )
    mission = _object(plan.get("mission"), "its mission")
    rows = mission.get("items")
    if not isinstance(rows, list):
        raise DamagedError("its items are no list")
    rows = [item for row in rows for item in _unfolded(row)]
    items = [_item_of_plan(row, number) for number, row in enumerate(rows, 1)]
    _check_jumps(items, "item")
    named: Autopilot = FIRMWARES.get(mission.get("firmwareType"), "unknown")
    flown_by = flyer_of(name, named, autopilot)

    # The plan's home is a list of latitude, longitude and elevation, of which some or all may be missing.
    position = (*(mission.get("plannedHomePosition") or ()), None, None, None)[:3]
    lat, lon, elevation_m = (number_of("plannedHomePosition", value) for value in position)
    start = home_of(home, lon, lat, elevation_m)

    notes = []
    if kind is None:
        notes.append(
            "it does not say that it is a plan (fileType), and is judged as if it were one"
        )
    geofence = _object(plan.get("geoFence") or {"version": 2}, "its geoFence")
    for (what, known, parts), whole in zip(KNOWN, (plan, mission, geofence), strict=True):
        version = whole.get("version")
        if version is True or version != known:
            notes.append(f"its {what} is {str(version)[:40]}, and only {known} is understood")
        is_fence = whole is geofence  # of which a number may be a limit too
        held = [
            key
            for key, value in whole.items()
            if value and (is_fence or isinstance(value, dict | list))
        ]
        notes += [f"its part {key[:40]!r} is not judged" for key in held if key not in parts]
    zones, damaged = read_geofence(geofence, name)
    notes += damaged
    if geofence.get("breachReturn"):
        notes.append("its breachReturn point is not judged")
    rally = _object(plan.get("rallyPoints") or {}, "its rallyPoints")
    if any(value for key, value in rally.items() if key != "version"):
        notes.append("its rally points are not judged")
    vehicle = mission.get("vehicleType")
    speed = "hoverSpeed"
    if vehicle not in MULTICOPTERS:
        speed = "cruiseSpeed"
        what = VEHICLES.get(vehicle, "no multicopter")
        notes.append(
            f"the vehicle is {what} (vehicleType {str(vehicle)[:40]}), and only multicopters are judged"
        )
    speed_m_s = number_of("its speed", mission.get(speed))

    flown = mission_of(name, items, len(rows), start, notes, flown_by, return_altitude_m, speed_m_s)
    return replace(flown, zones=zones)


def read_waypoints(
    data: bytes,
    name: str,
    home: LonLat | None,
    return_altitude_m: float,
    autopilot: FlownBy | None,
) -> Mission:
    """Return the mission of a file of ``QGC WPL 110``, or of Parrot's ``QGC WPL 120``, which has the same columns.

    Row 0 is home if it is a waypoint, as ArduPilot's ground stations write it, and as QGroundControl reads it for PX4,
    too (``MissionController.cc``, ``_loadTextMissionFile``). Otherwise it is the first item, and the file names no
    home. Parrot's drones fly to row 0, unless it is above the sea. The file does not say which autopilot flies it.

    Args:
      data: the bytes of the file, text.
      name: of the file, for messages.
      home: longitude and latitude in degrees in place of the file's; None takes the file's.
      return_altitude_m: metres above home, NaN where it is not known.
      autopilot: which flies it, None where that is not known.

    Raises:
      InputError: it is no such file, holds no item, or leads nowhere.
      DamagedError: a row cannot be read.
    """
    texts = [text.strip() for text in data.decode("utf-8-sig", "replace").splitlines()]
    lines = {number: text for number, text in enumerate(texts, 1) if text[:1] not in ("", "#")}
    header = next(iter(lines.values()), "")
    if header not in (HEADER, OF_PARROT):
        raise InputError(
            f"{name!r} does not begin with {HEADER!r}: save the mission again, as .waypoints or .plan"
        )
    items = [_item_of_row(text.split(), number) for number, text in list(lines.items())[1:]]
    _check_jumps(items, "line")
    rows = [line.strip()[:1] for line in data.splitlines()]
    num_rows = sum(row not in (b"", b"#") for row in rows) - 1  # but the header

    start: Home = (home, None)
    first_key = items[0].key or 0 if items else 0
    is_first_home = items and items[0].key == 0 and items[0].command in (0, WAYPOINT)
    if is_first_home and (header == HEADER or items[0].datum == "geoid"):
        first = items.pop(0)
        first_key = 1
        num_rows -= 1
        elevation_m = first.height_m if first.datum == "geoid" else math.nan
        start = home_of(home, first.lon, first.lat, elevation_m)
    is_ordered = [item.key for item in items] == list(range(first_key, first_key + len(items)))
    notes = [] if is_ordered else ["its rows are not numbered in their order, so jumps may differ"]
    numbered = [item._replace(number=number) for number, item in enumerate(items, 1)]

    flown_by = autopilot or "unknown"
    return mission_of(name, numbered, num_rows, start, notes, flown_by, return_altitude_m)


def flyer_of(name: str, named: Autopilot, asked: FlownBy | None) -> Autopilot:
    """Return which autopilot flies a mission: that which its file names, or else which its user names.

    Raises:
      InputError: they name two.
    """
    if asked in (None, named):
        return named
    if named == "unknown":
        return asked
    raise InputError(
        f"{name!r} is a mission for {AUTOPILOTS[named]}, by what it says itself: "
        f"leave autopilot={asked!r} (--autopilot) out"
    )


def mission_of(
    name: str,
    items: Sequence[Item],
    num_rows: int,
    start: Home,
    notes: Sequence[str],
    autopilot: Autopilot,
    return_altitude_m: float,
    speed_m_s: float = math.nan,
) -> Mission:
    """Return the mission of items as they are flown, by each autopilot that may fly them.

    Args:
      name: of the file.
      items: in the order of the file.
      num_rows: how many items the file holds, counted apart from them.
      start: home and its elevation.
      notes: sentences on what else of the file is not judged.
      autopilot, return_altitude_m: as of `Mission`.
      speed_m_s: that the file plans with where no item sets a speed; NaN or 0 where it has none.

    Raises:
      InputError: there is no item, or none that leads anywhere.
    """
    if not items:
        raise InputError(f"{name!r} holds no items: give a mission that has some")
    planned_m_s = speed_m_s if speed_m_s > 0 else None
    placed = [item for item in items if item.command in PLACED]
    zeros = [str(item.number) for item in placed if (item.lon, item.lat) == (0, 0)]
    refused = [str(item.number) for item in items if _is_refused(item)]
    missions = []
    for flyer in flyers(autopilot):
        flown = FlownItems(items, start[0], return_altitude_m, flyer)
        if autopilot in ("px4", "unknown"):
            said = {ZERO_PLACE: zeros, REFUSED: refused}
            flown.notes += [text.format(listed(named)) for text, named in said.items() if named]
        sentences = first_sentences([*flown.not_judged, *notes])
        if not flown.legs and not sentences:
            raise InputError(f"{name!r} leads nowhere: give a mission that has waypoints")
        mission = Mission(
            name,
            tuple(flown.legs),
            *start,
            sentences,
            flown.speed_m_s or planned_m_s,
            accounts=tuple(flown.accounts),
            num_things=num_rows,
            autopilot=autopilot,
            return_altitude_m=return_altitude_m,
            notes=tuple(flown.notes),
        )
        missions.append(mission)
    first, last = missions[0], missions[-1]
    is_one_way = (first.legs, first.not_judged) == (last.legs, last.not_judged)
    return first if is_one_way else replace(first, other=last)


def _is_refused(item: Item) -> bool:
    """Return whether PX4 refuses a mission with an item, by its frame or its command."""
    is_over_terrain = item.datum == "ground" and not item.is_straight
    return is_over_terrain or item.command in (LOITER_TURNS, SPLINE)


def _check_jumps(items: Sequence[Item], what: str) -> None:
    """Raise DamagedError where a jump names the key of two items, which messages call by ``what``."""
    num_of: Counter[float | None] = Counter(item.key for item in items)
    for item in items:
        if item.command == JUMP and num_of[item.params[0]] > 1:
            raise DamagedError(
                f"{what} {item.number} jumps to the number {item.params[0]:g}, which {num_of[item.params[0]]} of them "
                "have: give each its own"
            )


def _object(value: Any, what: str) -> dict[str, Any]:
    """Return a JSON object; DamagedError, which begins with ``what``, of any other value."""
    if not isinstance(value, dict):
        raise DamagedError(f"{what} is no JSON object")
    return value


def home_of(home: LonLat | None, lon: float, lat: float, elevation_m: float) -> Home:
    """Return home in degrees and its elevation in metres, None for either of them that is not known.

    A ``home`` that the user gives counts in place of the file's, whose numbers are checked all the same.

    Ground stations write 0 for what is not set: home at 0, 0 or NaN is not known, nor is an elevation of 0 or NaN, nor
    one without a home.

    Raises:
      DamagedError: home does not lie on the Earth, or where no ground is.
    """
    if not LOWEST_M <= elevation_m <= HIGHEST_M and not math.isnan(elevation_m):
        raise DamagedError(
            f"home is {elevation_m:,.1f} m above the sea, where no ground is: give metres; are these centimetres?"
        )
    check_place("home", lon, lat)
    if home or math.isnan(lon + lat) or (lon, lat) == (0, 0):
        return home, None
    has_elevation = abs(elevation_m) > 0  # False of NaN
    return (lon, lat), elevation_m if has_elevation else None


def _unfolded(row: Any) -> list[Any]:
    """Return the items that a survey or a corridor scan holds, by which it is flown; of any other item itself.

    They get the height and the altitude mode that the survey names for all of them.
    """
    if not isinstance(row, dict) or row.get("complexItemType") not in SURVEYS:
        return [row]
    survey = row.get("TransectStyleComplexItem", {})
    camera = survey.get("CameraCalc", {})
    mode = camera.get("DistanceMode")
    if "DistanceToSurfaceRelative" in camera:  # before QGroundControl 4.2
        mode = RELATIVE if camera["DistanceToSurfaceRelative"] else ABSOLUTE
        mode = CALCULATED if survey.get("FollowTerrain") else mode
    said = {"AltitudeMode": mode, "Altitude": camera.get("DistanceToSurface")}
    return [said | item for item in survey.get("Items") or []] or [row]


def _item_of_plan(value: Any, number: int) -> Item:
    """Return an item of a plan from its JSON value.

    QGroundControl flies at the item's ``Altitude`` in its ``AltitudeMode``, and other programs at its seventh parameter
    in its frame, so both must be the same. Only where QGroundControl calculates heights above the geoid from heights
    above ground do they differ: then the seventh parameter counts, or, where it is null because the terrain is not
    known, the ``Altitude`` above ground, to which the way is straight all the same.

    Args:
      value: the JSON value.
      number: of the item, by which messages name it.

    Returns:
      The item; a ``ComplexItem`` becomes one of command -1, which says what it is.

    Raises:
      DamagedError: it is no item, or its two heights differ by more than `SAME_M`, or in what they are above.
    """
    what = f"item {number}"
    row = _object(value, what)
    key = None
    if row.get("doJumpId") is not None:
        key = whole_of(f"doJumpId of {what}", row["doJumpId"])
    if row.get("type") != "SimpleItem":
        kind = str(row.get("complexItemType") or row.get("type") or "")[:40]
        what = f"a {kind} (ComplexItem)"
        if not kind.isidentifier():
            what = "an item without a known type"
        if kind in SURVEYS:
            what = "a survey without its waypoints (open and save it in QGroundControl)"
        return Item(number, key, command=-1, what=what)

    params = row.get("params")
    if not isinstance(params, list) or len(params) != 7:
        raise DamagedError(f"{what} has no list of seven params")
    values = [number_of(f"a parameter of {what}", param) for param in params]
    command, frame = (whole_of(f"{part} of {what}", row.get(part)) for part in ("command", "frame"))
    goes_on = row.get("autoContinue") != 0
    item = _item(what, number, key, command, frame, values, goes_on)

    # Its two heights: the parameter's in the frame, and the one that QGroundControl shows.
    mode = row.get("AltitudeMode")
    if command in PLACED:
        shown = ALTITUDE_MODES.get(mode, f"AltitudeMode {mode}")
        zeros = f"what {what} is above, by its frame and by its AltitudeMode"
        one_value(zeros, (item.datum, shown))
    height = f"the height of {what}"
    if mode == CALCULATED and item.datum == "geoid":
        one_value(height, (params[6], row.get("AMSLAltAboveTerrain")), SAME_M)
        if math.isnan(item.height_m):
            shown_m = number_of(f"Altitude of {what}", row.get("Altitude"))
            return item._replace(height_m=shown_m, datum="ground", is_straight=True)
    elif command in HAS_HEIGHT:
        one_value(height, (item.height_m, row.get("Altitude")), SAME_M)
    return item


def _item_of_row(cells: Sequence[str], line: int) -> Item:
    """Return the item of a row, whose cells are: key, is it the current one, frame, command, seven values, go on.

    Args:
      cells: texts, `NUM_COLUMNS` of them; the seven values are as of `_item`.
      line: number of the row's line in the file, from 1.

    Raises:
      DamagedError: another number of cells, or one that is not a number.
    """
    what = f"line {line}"
    if len(cells) != NUM_COLUMNS:
        raise DamagedError(f"{what} has {len(cells)} values, and not {NUM_COLUMNS}")
    texts = ["" if cell in NANS else cell for cell in cells]
    numbers = [decimal_of(f"a value of {what}", text) for text in texts]
    # Column 1, whether it is the current item, is not looked at.
    key, frame, command = (whole_of(f"a value of {what}", numbers[column]) for column in (0, 2, 3))
    goes_on = numbers[-1] != 0
    return _item(what, line, key, command, frame, numbers[4:11], goes_on)


def _item(
    what: str,
    number: int,
    key: int | None,
    command: int,
    frame: int,
    values: Sequence[float],
    goes_on: bool,
) -> Item:
    """Return an item of MAVLink.

    Args:
      what: begins the message of an error.
      number, key, command, goes_on: as of `Item`.
      frame: number of MAVLink's frame; in frames that `FRAMES` lacks the place is not checked, and ``datum`` is None.
      values: four parameters, latitude and longitude in degrees, and height in metres.

    Raises:
      DamagedError: the place does not lie on the Earth.
    """
    *params, lat, lon, height_m = values
    datum = FRAMES.get(frame)
    if datum:
        check_place(what, lon, lat, height_m)
    return Item(number, key, command, tuple(params), lon, lat, height_m, datum, goes_on=goes_on)
