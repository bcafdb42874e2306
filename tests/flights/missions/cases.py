"""Random missions of each kind, as the file of one of the formats, with what is flown of it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from tests.flights.missions import files
from tests.flights.missions.draw import FORMATS, HIGH_M, LOW_M, Case, Draw, items_case, items_of
from tests.flights.missions.flights import (
    JUMP,
    LAND,
    LOITER_TIME,
    LOITER_TURNS,
    RETURN,
    SPEED,
    TAKEOFF,
    WAYPOINT,
    Datum,
    Item,
    fly_lines,
    height_in,
)
from tests.flights.missions.worlds import GEOID_M


def simple(draw: Draw, kind: str) -> Case:
    """Return a mission of waypoints, from a take-off to a landing."""
    places = draw.places_m(2, 4)
    items = items_of(draw, places, kind == "mixed", kind == "mixed")
    items.insert(1, Item(SPEED))
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def open_heights(draw: Draw, kind: str) -> Case:
    """Return a mission some of whose waypoints leave their height open."""
    places = draw.places_m(4, 7)
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    items = [
        replace(item, height_m=math.nan) if number > 1 and draw.is_so(0.5) else item
        for number, item in enumerate(items)
    ]
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def jumps(draw: Draw, kind: str) -> Case:
    """Return a mission with a jump back or on, past waypoints that may leave their height open."""
    if draw.is_so(0.3):
        return _lower_again(draw, kind)
    places = draw.places_m(4, 6)
    items = items_of(draw, places, draw.is_so(0.3), has_calculated=False)
    to = int(draw.rng.integers(1, len(items) - 1))
    if draw.is_so(0.6):
        items[to] = replace(items[to], height_m=math.nan)
    at = int(draw.rng.integers(1, len(items) + 1))
    moved = to + (to >= at)
    items.insert(at, Item(JUMP, to=moved, repeats=int(draw.one_of(1, 1, 2, 0))))
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def _lower_again(draw: Draw, kind: str) -> Case:
    """Return a mission that flies over a house, comes down beside it, and jumps back to where it flew, now as low."""
    start_m, aside_m, end_m = draw.around()
    datum, low_m = draw.datum(), float(draw.one_of(*LOW_M))
    flown = ((start_m, HIGH_M), (end_m, HIGH_M), (aside_m, HIGH_M), (start_m, low_m))
    items = [draw.item(WAYPOINT, xy_m, datum, start_m, above_m) for xy_m, above_m in flown]
    items[0] = replace(items[0], command=TAKEOFF)
    items[1] = replace(items[1], height_m=math.nan)
    return items_case(draw, kind, [*items, Item(JUMP, to=1), Item(LAND)], start_m)


def loiters(draw: Draw, kind: str) -> Case:
    """Return a mission with a circle, and sometimes a stay."""
    places = draw.places_m(4, 6)
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    number = int(draw.rng.integers(1, len(items) - 1))
    circle = replace(
        items[number], command=LOITER_TURNS, radius_m=float(draw.one_of(12, 25, 40, 60)), hold_s=0.0
    )
    items[number] = circle
    if draw.is_so(0.15):  # begun in its centre
        items.insert(number, replace(circle, command=WAYPOINT))
    if draw.is_so(0.3):
        items[-1] = replace(items[-1], command=LOITER_TIME, hold_s=0.0)
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def returns(draw: Draw, kind: str) -> Case:
    """Return a mission that returns home, from afar or over a house, and at a height that is mostly named."""
    options: dict[str, Any] = draw.clearances()
    if draw.is_so(0.8):
        options["return_altitude_m"] = float(draw.one_of(20, 60, 100))
    if draw.is_so(0.5):
        places = draw.places_m(2, 4)
        items = items_of(draw, places, is_mixed=False, has_calculated=False)
    else:
        options["clearance_m"] = 0.0  # the way round a wall is near it
        places, low_m = draw.around(), float(draw.one_of(*LOW_M))
        datum = draw.datum(("home", "home", "ground", "geoid"))
        items = [draw.item(WAYPOINT, xy_m, datum, places[0], low_m) for xy_m in places]
        items[0] = replace(items[0], command=TAKEOFF)
    return items_case(draw, kind, [*items, Item(RETURN)], places[0], options=options)


def skims(draw: Draw, kind: str) -> Case:
    """Return a mission level over the roof of a house, a little higher or lower than the clearance asks for."""
    ends_m, above_m = draw.through_house()
    options: dict[str, Any] = draw.clearances()
    middle_m = np.mean(ends_m, axis=0)
    over_m = 2 * above_m + options["vertical_clearance_m"] + draw.rng.uniform(-3, 4)
    z_m = float(draw.world.ground_m(*middle_m)) + over_m
    items = []
    for number, xy_m in enumerate(ends_m):
        each_m = z_m - float(draw.world.ground_m(*xy_m))
        command = WAYPOINT if number else TAKEOFF
        items.append(draw.item(command, xy_m, draw.one_of("home", "geoid"), ends_m[0], each_m))
    return items_case(draw, kind, [*items, Item(LAND)], ends_m[0], options=options)


def through(draw: Draw, kind: str) -> Case:
    """Return a mission level through a thing that stands, between a take-off and a landing."""
    ends_m, above_m = draw.through_thing()
    datum = draw.datum()
    items = [
        draw.item(command, xy_m, datum, ends_m[0], above_m)
        for command, xy_m in zip((TAKEOFF, WAYPOINT), ends_m, strict=True)
    ]
    return items_case(draw, kind, [*items, Item(LAND)], ends_m[0])


def corners(draw: Draw, kind: str) -> Case:
    """Return a mission round the corner of a house, which it clears by a metre only if it does not cut it."""
    house = draw.house()
    ring_m = np.array(draw.world.outlines[house].exterior.coords)[:-1]
    sides_m = np.stack([ring_m[1] - ring_m[0], ring_m[-1] - ring_m[0]])
    sides_m /= np.linalg.norm(sides_m, axis=1)[:, None]
    outward = -sides_m.sum(axis=0)
    corner_m = ring_m[0] + outward / np.linalg.norm(outward)
    places = [
        tuple(np.round(each, 2).tolist())
        for each in (corner_m + 20 * sides_m[0], corner_m, corner_m + 20 * sides_m[1])
    ]
    datum, above_m = draw.datum(), draw.world.top_m[house] * 0.4
    items = [
        draw.item(WAYPOINT if number else TAKEOFF, xy_m, datum, places[0], above_m)
        for number, xy_m in enumerate(places)
    ]
    options = {"clearance_m": 0.0, "vertical_clearance_m": 0.0}
    return items_case(draw, kind, [*items, Item(LAND)], places[0], options=options)


def lines(draw: Draw, kind: str) -> Case:
    """Return lines of points, with heights above anything."""
    suffix = draw.one_of(*FORMATS[2:])
    datums: tuple[Datum, ...] = ("home", "ground")
    if draw.world.terrain_m is not None:
        datums = ("home", "ground", "geoid", "ellipsoid")
    datum = draw.datum(datums)
    num_lines = 2 if suffix != ".csv" and draw.is_so(0.1) else 1
    drawn = [_line(draw) for _ in range(num_lines)]
    first_m = (float(drawn[0][0, 0]), float(drawn[0][0, 1]))
    home_m = draw.place_m(first_m) if draw.is_so(0.3) else first_m
    for line in drawn:
        line[:, 2] = [
            height_in(draw.world, datum, (x_m, y_m), z_m, home_m) for x_m, y_m, z_m in line.tolist()
        ]
    options: dict[str, Any] = draw.clearances() | {"heights": datum}
    if datum == "ellipsoid":
        options["geoid_m"] = GEOID_M
    has_home = datum == "home" or draw.is_so(0.9)
    if has_home:
        options["home"] = draw.world.lonlat(*home_m)
    text = _lines_text(draw, suffix, drawn, options)
    flown = fly_lines(draw.world, drawn, datum, home_m if has_home else None)
    return Case(kind, draw.world, suffix, text, datum, flown, options)


def _line(draw: Draw) -> np.ndarray:
    """Return a line of points with heights above the ground."""
    places = draw.places_m(2, 4)
    above_m = [draw.above_m()] * len(places)
    if draw.is_so(0.5):
        above_m = [draw.above_m() for _ in places]
    return np.column_stack([places, above_m])


def _lines_text(draw: Draw, suffix: str, drawn: list[np.ndarray], options: dict[str, Any]) -> str:
    """Return the text of lines; where the file says what heights are above, the option does not."""
    world = draw.world
    if suffix == ".kml":
        modes = {"ground": "relativeToGround", "geoid": "absolute", "ellipsoid": "absolute"}
        mode = modes.get(options["heights"], "") if draw.is_so(0.7) else ""
        if mode and options["heights"] != "ellipsoid":
            del options["heights"]
        tag = draw.one_of("LineString", "gx:Track")
        return files.kml(*(files.kml_line(world, line, mode, tag) for line in drawn))
    if suffix == ".gpx":
        return files.gpx(world, drawn, is_track=draw.is_so(0.5))
    if suffix == ".geojson":
        return files.to_json(files.geojson(world, drawn, has_property=draw.is_so(0.5)))
    names = draw.one_of(
        ("lon", "lat", "altitude_m"), ("longitude", "latitude", "alt"), ("Lng", "Lat", "Height")
    )
    return files.csv(names, files.placed(world, drawn[0]))


MAKERS = {
    "mixed": simple,
    "lines": lines,
    "jump": jumps,
    "loiter": loiters,
    "return": returns,
    "skim": skims,
    "corner": corners,
    "thing": through,
    "open": open_heights,
}


def plain(draw: Draw, kind: str) -> Case:
    """Return a mission of simple items or lines, whose reading nobody disputes."""
    return draw.one_of(simple, lines)(draw, kind)
