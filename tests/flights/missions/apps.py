"""Random missions of DJI, Litchi, AirData and surveys of QGroundControl, with what is flown of them."""

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from tests.flights.missions import files
from tests.flights.missions.draw import Case, Draw, items_case, items_of
from tests.flights.missions.flights import (
    LAND,
    XY,
    Datum,
    Flown,
    fly_lines,
    height_in,
    straight,
    zero_m,
)
from tests.flights.missions.worlds import GEOID_M, World

NEAR_M = 50.0  # from home, within which DJI's drones may return at their own height
FOOT_M = 0.3048
STOP, CUT, CURVE = (
    "toPointAndStopWithDiscontinuityCurvature",
    "coordinateTurn",
    "toPointAndPassWithContinuityCurvature",
)
MODES: dict[str, str] = {"home": "relativeToStartPoint", "ellipsoid": "WGS84"}
HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?><kml xmlns="http://www.opengis.net/kml/2.2" '
    'xmlns:wpml="http://www.dji.com/wpmz/1.0.6"><Document>'
)


def elements(**texts: Any) -> str:
    """Return elements of WPML by their names."""
    return "".join(f"<wpml:{name}>{text}</wpml:{name}>" for name, text in texts.items())


def ends_of(world: World, line: np.ndarray, datums: list[Datum], home_m: XY) -> np.ndarray:
    """Return ``[N, 3]`` x, y and elevation of points whose heights are above datums."""
    zeros_m = [
        zero_m(world, datum, (x_m, y_m), home_m)
        for datum, (x_m, y_m, _) in zip(datums, line.tolist(), strict=True)
    ]
    return line + np.column_stack([np.zeros((len(line), 2)), zeros_m])


def fly(flown: Flown, world: World, places_m: list[Any]) -> None:
    """Fly straight through places, each x, y and elevation."""
    flown.ways += [straight(world, *pair) for pair in pairwise(places_m)]


def cut(flown: Flown, ends_m: np.ndarray, cuts_m: list[float]) -> None:
    """Note the corners of a way that may be cut, so far from each."""
    for number in range(1, len(ends_m) - 1):
        corner_m = ends_m[number]
        sides_m = ends_m[[number - 1, number + 1]] - corner_m
        lengths_m = np.linalg.norm(sides_m[:, :2], axis=1)
        if cuts_m[number] and lengths_m.min() > 2 * cuts_m[number]:
            tips_m = corner_m + sides_m * (cuts_m[number] / lengths_m)[:, None]
            flown.corners.append(np.array([corner_m, *tips_m]))


def dji(draw: Draw) -> Case:
    """Return waylines, reached safely or not, with stops and corners that are cut, and an end of each kind."""
    world = draw.world
    datums: tuple[Datum, ...] = ("home",) if world.terrain_m is None else ("home", "ellipsoid")
    datum = draw.datum(datums)
    places = draw.places_m(3, 5)
    home_m = places[0] if draw.is_so(0.5) else draw.place_m(places[0])
    above_m = draw.above_m()
    line = np.array([(*xy, height_in(world, datum, xy, above_m, home_m)) for xy in places])
    ends_m = ends_of(world, line, [datum] * len(line), home_m)
    ground_m = np.array([*home_m, float(world.ground_m(*home_m))])
    up = np.array([0.0, 0.0, 1.0])
    security_m = float(draw.one_of(1.5, 20, 60))
    fly_to = draw.one_of("safely", "safely", "pointToPoint")
    end = draw.one_of("goHome", "autoLand", "noAction", "gotoFirstWaypoint")
    return_m = float(draw.one_of(20, 60, 100))
    cuts_m = [float(draw.one_of(0, 5, 10)) for _ in places]

    flown = Flown()
    level_m = max(security_m, ends_m[0, 2] - ground_m[2])
    over_home, over_first = ground_m + level_m * up, [*ends_m[0, :2], ground_m[2] + level_m]
    climb = [ground_m, over_home, over_first]
    if fly_to == "pointToPoint" and level_m > security_m:
        climb = [ground_m, ground_m + security_m * up]
    fly(flown, world, [*climb, *ends_m])
    cut(flown, ends_m, cuts_m)
    last_m = ends_m[-1]
    if end == "gotoFirstWaypoint":
        fly(flown, world, [last_m, ends_m[0]])
    elif end == "autoLand":
        fly(flown, world, [last_m, [*last_m[:2], float(world.ground_m(*last_m[:2]))]])
    elif end == "goHome":
        own_m = last_m[2] - ground_m[2]
        is_near = np.linalg.norm(last_m[:2] - ground_m[:2]) <= NEAR_M
        for rise_m in {max(own_m, return_m), own_m if is_near else max(own_m, return_m)}:
            way_m = [last_m, [*last_m[:2], ground_m[2] + rise_m], ground_m + rise_m * up]
            fly(flown, world, [*way_m, ground_m])

    turns = [(CUT, cut_m) if cut_m else (STOP, 0) for cut_m in cuts_m]
    if draw.is_so(0.15):
        turns[1] = CURVE, 0
        flown.unknown.append("a curve that nothing bounds")
    lon, lat = world.lonlat(*home_m)
    options = draw.clearances()
    config: dict[str, Any] = {
        "flyToWaylineMode": fly_to,
        "finishAction": end,
        "takeOffSecurityHeight": security_m,
        "globalRTHHeight": return_m,
        "droneInfo": elements(droneEnumValue=77),
    }
    if draw.is_so(0.5):
        config["takeOffRefPoint"] = f"{lat:.9f},{lon:.9f},12.3"
    elif draw.is_so(0.9):
        options["home"] = (lon, lat)
    else:
        flown.unknown.append("the climb from a home that nobody names")
        options["return_altitude_m"] = return_m
        if datum == "home" or end == "goHome":
            flown.ways.clear()
            flown.corners.clear()
        else:
            flown.ways = flown.ways[-len(ends_m) :]
    if datum == "ellipsoid":
        options["geoid_m"] = GEOID_M
    marks = "".join(
        f"<Placemark><Point><coordinates>\n {lon},{lat}\n</coordinates></Point>"
        + elements(
            index=number,
            executeHeight=height_m,
            waypointTurnParam=elements(waypointTurnMode=turn, waypointTurnDampingDist=cut_m),
        )
        + "</Placemark>"
        for number, ((lon, lat, height_m), (turn, cut_m)) in enumerate(
            zip(files.placed(world, line), turns, strict=True)
        )
    )
    folder = f"<Folder>{elements(executeHeightMode=MODES[datum], waylineId=0)}{marks}</Folder>"
    text = f"{HEAD}{elements(missionConfig=elements(**config))}{folder}</Document></kml>"
    return Case("dji", world, draw.one_of(".wpml", ".kmz"), text, datum, flown, options)


def litchi(draw: Draw) -> Case:
    """Return Litchi's table with heights above the take-off or the ground by row, in metres or feet."""
    world, options = draw.world, draw.clearances()
    places = draw.places_m(3, 5)
    home_m = places[0] if draw.is_so(0.5) else draw.place_m(places[0])
    modes: list[Datum] = [draw.one_of("home", "ground")] * len(places)
    if draw.is_so(0.5):
        modes = [draw.one_of("home", "ground") for _ in places]
    above_m = draw.above_m()
    heights_m = [
        height_in(world, mode, xy_m, above_m, home_m)
        for mode, xy_m in zip(modes, places, strict=True)
    ]
    line = np.column_stack([places, heights_m])
    ends_m = ends_of(world, line, modes, home_m)
    cuts_m = [float(draw.one_of(0, 5, 10)) for _ in places]
    flown = Flown()
    ground_m = [*home_m, float(world.ground_m(*home_m))]
    if draw.is_so(0.9) or "home" in modes:
        options["home"] = world.lonlat(*home_m)
        fly(flown, world, [ground_m, [*home_m, ends_m[0, 2]], *ends_m])
    else:
        flown.unknown.append("the climb from a home that nobody names")
        fly(flown, world, list(ends_m))
    cut(flown, ends_m, cuts_m)
    unit, per_m = draw.one_of(("m", 1.0), ("ft", 1 / FOOT_M))
    gap = draw.one_of("", " ")
    names = ["latitude", "longitude", f"altitude({unit})", "heading(deg)", f"curvesize({unit})"]
    rows = [
        [lat, lon, round(height_m * per_m, 3), 12.5, cut_m * per_m, int(mode == "ground"), 0.0]
        for (lon, lat, height_m), cut_m, mode in zip(
            files.placed(world, line), cuts_m, modes, strict=True
        )
    ]
    table = [[*names, "altitudemode", "poi_altitude(m)"], *rows]
    text = "\n".join(f",{gap}".join(map(str, row)) for row in table) + "\n"
    return Case("litchi", world, ".csv", text, "mixed", flown, options)


def airdata(draw: Draw) -> Case:
    """Return a log of AirData, whose heights above the take-off count."""
    world = draw.world
    home_m, *_ = places = draw.places_m(2, 4)
    above_m = draw.above_m()
    line = np.array([(*xy_m, height_in(world, "home", xy_m, above_m, home_m)) for xy_m in places])
    unit, per_m = draw.one_of(("meters", 1.0), ("feet", 1 / FOOT_M))
    names = (
        "time(millisecond)",
        "datetime(utc)",
        "latitude",
        "longitude",
        f"height_above_takeoff({unit})",
        "altitude_above_seaLevel(feet)",
    )
    rows = [
        (number * 100, "2026-01-05 10:00:00", lat, lon, round(height_m * per_m, 3), 5.0)
        for number, (lon, lat, height_m) in enumerate(files.placed(world, line))
    ]
    options = draw.clearances() | {"home": world.lonlat(*home_m)}
    flown = fly_lines(world, [line], "home", home_m)
    return Case("airdata", world, ".csv", files.csv(names, rows), "home", flown, options)


def survey(draw: Draw) -> Case:
    """Return a plan whose waypoints are those of a survey or a corridor scan, which holds them."""
    places = draw.places_m(3, 5)
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    case = items_case(
        draw,
        "survey",
        [*items, replace(items[0], command=LAND, xy_m=None)],
        places[0],
        suffix=".plan",
    )
    plan = json.loads(case.text)
    rows = plan["mission"]["items"]
    held = {"Items": rows[1:-1], "version": 1}
    kind = draw.one_of("survey", "CorridorScan")
    complex_item = {
        "type": "ComplexItem",
        "complexItemType": kind,
        "TransectStyleComplexItem": held,
    }
    plan["mission"]["items"] = [rows[0], complex_item, rows[-1]]
    return replace(case, text=files.to_json(plan))


def app_case(draw: Draw, number: int) -> Case:
    """Return a mission of an app by its number."""
    makers = (dji, litchi, dji, survey, dji, airdata)
    return makers[number % len(makers)](draw)
