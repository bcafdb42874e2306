"""Missions that were edited or damaged: none is clean where it holds a contact by any reading, or what nobody reads."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pyproj

from tests.flights.missions import files
from tests.flights.missions.draw import HIGH_M, Case, Draw, items_case
from tests.flights.missions.flights import (
    JUMP,
    LAND,
    TAKEOFF,
    WAYPOINT,
    XY,
    Autopilot,
    Flown,
    Item,
    fly_lines,
    height_in,
)

SPLINE, UNKNOWN, TRANSITION, VTOL_TAKEOFF, VTOL_LAND = 82, 31_999, 3000, 84, 85
BODY_FRAME = 8
NAD27 = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:4267", always_xy=True)
Edit = Callable[[dict[str, Any]], None]


def _high(draw: Draw, num: int = 3) -> tuple[list[Item], XY]:
    """Return a mission far above everything, and its home."""
    places = draw.places_m(num, num)
    ways = [
        draw.item(WAYPOINT if n else TAKEOFF, xy_m, "home", places[0], HIGH_M)
        for n, xy_m in enumerate(places)
    ]
    return [*ways, Item(LAND)], places[0]


def _low(draw: Draw) -> tuple[list[Item], XY]:
    """Return a mission through a house, and its home."""
    ends_m, above_m = draw.through_house()
    ways = [
        draw.item(WAYPOINT if n else TAKEOFF, xy_m, "home", ends_m[0], above_m)
        for n, xy_m in enumerate(ends_m)
    ]
    return [*ways, Item(LAND)], ends_m[0]


def _edited(name: str, edit: Edit, unknown: str) -> Callable[[Draw], Case]:
    """Return what makes a plan far above everything in which something is edited, so that it is never clean."""

    def made(draw: Draw) -> Case:
        items, home_m = _high(draw)
        plan = files.plan(draw.world, items, draw.one_of("ardupilot", "px4", "other"), home_m)
        edit(plan)
        return Case(
            name,
            draw.world,
            ".plan",
            files.to_json(plan),
            "home",
            Flown(unknown=[unknown]),
            {},
            is_damaged=True,
        )

    return made


def _put(*keys: str | int, value: Any) -> Edit:
    """Return an edit that sets the value at keys."""

    def edit(plan: dict[str, Any]) -> None:
        at: Any = plan
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = value

    return edit


def _swap_places(plan: dict[str, Any]) -> None:
    """Write longitude before latitude."""
    for item in plan["mission"]["items"]:
        item["params"][4:6] = item["params"][5:3:-1]


def _survey(plan: dict[str, Any]) -> None:
    """Put a survey in the place of a waypoint."""
    plan["mission"]["items"][1] = {"type": "ComplexItem", "complexItemType": "survey", "version": 5}


def _vtol(plan: dict[str, Any]) -> None:
    """Fly as an aeroplane after a vertical take-off."""
    items = plan["mission"]["items"]
    items[0]["command"], items[-1]["command"] = VTOL_TAKEOFF, VTOL_LAND
    items.insert(
        1,
        items[0]
        | {"command": TRANSITION, "frame": 2, "params": [4, 0, 0, 0, 0, 0, 0], "doJumpId": 9},
    )


def _jump_nowhere(plan: dict[str, Any]) -> None:
    """Jump to an item that is not there."""
    items = plan["mission"]["items"]
    items.insert(
        2,
        items[-1] | {"command": JUMP, "frame": 2, "params": [99, 1, 0, 0, 0, 0, 0], "doJumpId": 9},
    )


def _fence(value: Any) -> Edit:
    """Return an edit that sets the polygons of the geofence."""
    return _put("geoFence", "polygons", value=value)


FENCE = {
    "inclusion": True,
    "polygon": [[40.7, -74.0], [40.71, -74.0], [40.7, -74.01]],
    "version": 1,
}
ITEM = ("mission", "items", 1)
EDITS = {
    "type of file": (_put("fileType", value="GeoFence"), "no plan"),
    "version of plan": (_put("version", value=99), "a version that nobody knows"),
    "version of mission": (_put("mission", "version", value=99), "a version that nobody knows"),
    "fence as an object": (_fence({"1": FENCE}), "a geofence"),
    "fence as a list": (_fence([FENCE]), "a geofence"),
    "spline": (_put(*ITEM, "command", value=SPLINE), "a spline"),
    "unknown command": (_put(*ITEM, "command", value=UNKNOWN), "a command that nobody knows"),
    "frame of the body": (
        _put(*ITEM, "frame", value=BODY_FRAME),
        "a frame that is none of the Earth",
    ),
    "swapped places": (_swap_places, "places off the maps"),
    "survey": (_survey, "a survey"),
    "aeroplane": (_vtol, "an aeroplane's transitions"),
    "jump to nowhere": (_jump_nowhere, "where a jump leads"),
    "no height": (_put(*ITEM[:2], 0, "params", 6, value=None), "a take-off without a height"),
    "two heights": (_put(*ITEM, "Altitude", value=HIGH_M - 60), "which height counts"),
}


def ids_twice(draw: Draw, name: str) -> Case:
    """Return a mission with a jump to an id that two items have: one in a house, and one above it."""
    (start_m, end_m), above_m = draw.through_house()
    first_m, second_m = (HIGH_M, above_m) if draw.is_so(0.5) else (above_m, HIGH_M)
    flown = (
        (start_m, HIGH_M),
        (end_m, first_m),
        (start_m, HIGH_M),
        (end_m, second_m),
        (start_m, HIGH_M),
    )
    items = [draw.item(WAYPOINT, xy_m, "home", start_m, z_m) for xy_m, z_m in flown]
    items[0] = replace(items[0], command=TAKEOFF)
    items += [Item(JUMP, to=1), Item(LAND)]
    case = items_case(
        draw,
        "ids twice",
        items,
        start_m,
        suffix=name,
        options={"vertical_clearance_m": 0.0},
        is_damaged=True,
    )
    if name == ".plan":
        plan = json.loads(case.text)
        plan["mission"]["items"][3]["doJumpId"] = 2
        text = files.to_json(plan)
    else:
        rows = files.waypoints(draw.world, items, start_m)
        rows[4][0] = "2"
        text = files.waypoints_text(rows)
    case.flown.unknown.append("where a jump leads")
    return replace(case, text=text)


def home_in_centimetres(draw: Draw, name: str) -> Case:
    """Return a mission through a house whose home's elevation is given in centimetres."""
    items, home_m = _low(draw)
    plan = files.plan(draw.world, items, "px4", home_m)
    plan["mission"]["plannedHomePosition"][2] *= 100
    flown = Autopilot(draw.world, "px4", home_m, None).fly(items)
    return Case(name, draw.world, ".plan", files.to_json(plan), "home", flown, {}, is_damaged=True)


def rows_of_waypoints(draw: Draw, name: str) -> Case:
    """Return rows one of which is longer, shorter, or has a number that no ground station writes."""
    items, home_m = _high(draw)
    rows = files.waypoints(draw.world, items, home_m)
    row = rows[2]
    if name == "long row":
        row.append("1")
    elif name == "short row":
        row.pop()
    elif name == "odd number":
        row[10] = "1_50"
    elif name == "odd digits":
        row[10] = "١٥٠"
    elif name == "aeroplane":
        rows[1][3], rows[-1][3] = str(VTOL_TAKEOFF), str(VTOL_LAND)
        rows.insert(2, [rows[2][0], "0", "2", str(TRANSITION), "4", *["0"] * 6, "1"])
    else:
        row[3] = str(SPLINE)
    flown = Flown(unknown=[f"a row of waypoints: {name}"])
    return Case(
        name,
        draw.world,
        ".waypoints",
        files.waypoints_text(rows),
        "home",
        flown,
        {},
        is_damaged=True,
    )


def _two_lines(draw: Draw) -> tuple[np.ndarray, np.ndarray, Flown, dict[str, Any]]:
    """Return a line above a house and one through it, heights above home; what is flown of the latter; the options."""
    ends_m, above_m = draw.through_house()
    both = []
    for each_m in (HIGH_M, above_m):
        heights_m = [height_in(draw.world, "home", xy_m, each_m, ends_m[0]) for xy_m in ends_m]
        both.append(np.column_stack([ends_m, heights_m]))
    options = {"heights": "home", "home": draw.world.lonlat(*ends_m[0])}
    return *both, fly_lines(draw.world, both[1:], "home", ends_m[0]), options


def csv_columns(draw: Draw, name: str) -> Case:
    """Return a table with two columns of heights, with rows longer than its header, or with places swapped."""
    high, low, flown, options = _two_lines(draw)
    high_m, low_rows = high[:, 2], files.placed(draw.world, low)
    if name in ("two columns", "two names", "columns twice"):
        heads = {
            "two columns": ("Alt", "alt"),
            "two names": ("altitude_m", "alt"),
            "columns twice": ("alt", "alt"),
        }
        pairs = [(low_m, top_m) for (*_, low_m), top_m in zip(low_rows, high_m, strict=True)]
        if draw.is_so(0.5):
            pairs = [pair[::-1] for pair in pairs]
        rows = [[*row[:2], *pair] for row, pair in zip(low_rows, pairs, strict=True)]
        text = files.csv(("lon", "lat", *heads[name]), rows)
    elif name == "long rows":
        text = files.csv(("lon", "lat", "altitude_m"), [[*row, HIGH_M] for row in low_rows])
    else:
        text = files.csv(("lat", "lon", "altitude_m"), files.placed(draw.world, high))
        flown = Flown(unknown=["places off the maps"])
    return Case(name, draw.world, ".csv", text, "home", flown, options, is_damaged=True)


def kml_parts(draw: Draw, name: str) -> Case:
    """Return a line above a house beside a ring through it, or one that an offset or other coordinates lower."""
    high, low, flown, options = _two_lines(draw)
    world = draw.world
    line = files.kml_line(world, high)
    coordinates = files.kml_line(world, low).split("<LineString>")[1].split("</LineString>")[0]
    if name == "ring":
        ring = files.kml_line(world, np.vstack([low, low[:1]]), tag="LinearRing")
        text = files.kml(line, ring)
    elif name == "offset":
        offset = f"<gx:altitudeOffset>{low[0, 2] - high[0, 2]:.2f}</gx:altitudeOffset>"
        text = files.kml(files.kml_line(world, high, more=offset))
    elif name == "coordinates twice":
        text = files.kml(line.replace("</LineString>", f"{coordinates}</LineString>"))
    else:
        inner = coordinates.removeprefix("<coordinates>").removesuffix("</coordinates>")
        text = files.kml(line.replace("</coordinates>", f"<x/> {inner}</coordinates>"))
    return Case(name, world, ".kml", text, "home", flown, options, is_damaged=True)


def geojson_parts(draw: Draw, name: str) -> Case:
    """Return a line in another datum's degrees, one called a segment, or one with two heights."""
    high, low, flown, options = _two_lines(draw)
    world = draw.world
    if name == "crs":
        value = files.geojson(world, [low])
        shape = value["features"][0]["geometry"]
        shape["coordinates"] = [
            [*NAD27.transform(lon, lat), z_m] for lon, lat, z_m in shape["coordinates"]
        ]
        value["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4267"}}
    elif name == "segment":
        value = files.geojson(world, [high, low])
        value["features"][0]["properties"] |= {"settings": {}, "z_m": high[:, 2].tolist()}
        value["features"][1]["properties"]["segment"] = 1
    else:
        value = files.geojson(world, [low])
        value["features"][0]["properties"] |= {"settings": {}, "z_m": [HIGH_M] * len(low)}
    if name != "crs":
        del options["heights"]
    return Case(
        name, world, ".geojson", files.to_json(value), "home", flown, options, is_damaged=True
    )


def gpx_heights(draw: Draw, name: str) -> Case:
    """Return a route by jaxurban whose heights were edited, so that they contradict their descriptions."""
    high, low, flown, options = _two_lines(draw)
    del options["heights"]
    line, above_m = (low, [HIGH_M] * 2) if name == "low elevations" else (high, [low[0, 2]] * 2)
    text = files.gpx(draw.world, [line], is_track=draw.is_so(0.5), above_m=above_m)
    return Case(name, draw.world, ".gpx", text, "ground", flown, options, is_damaged=True)


MADE: tuple[tuple[Callable[[Draw, str], Case], tuple[str, ...]], ...] = (
    (csv_columns, ("two columns", "two names", "columns twice", "long rows", "swapped columns")),
    (kml_parts, ("ring", "offset", "coordinates twice", "text behind")),
    (geojson_parts, ("crs", "segment", "own heights")),
    (gpx_heights, ("low elevations", "low descriptions")),
    (ids_twice, (".plan", ".waypoints")),
    (home_in_centimetres, ("home in centimetres",)),
    (
        rows_of_waypoints,
        ("aeroplane", "odd number", "odd digits", "long row", "short row", "spline"),
    ),
)
DAMAGES: tuple[Callable[[Draw], Case], ...] = (
    *(partial(make, name=name) for make, names in MADE[:-2] for name in names),
    *(_edited(name, *edit) for name, edit in EDITS.items()),
    *(partial(make, name=name) for make, names in MADE[-2:] for name in names),
)
