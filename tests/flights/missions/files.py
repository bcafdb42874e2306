"""Missions as files: a writer of each format, apart from those of jaxurban."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.flights.missions.flights import JUMP, LOITER_TURNS, WAYPOINT, XY, Datum, Firmware, Item
from tests.flights.missions.worlds import World

FRAMES: dict[Datum, tuple[int, int]] = {"geoid": (0, 5), "home": (3, 6), "ground": (10, 11)}
ALTITUDE_MODES: dict[Datum, int] = {"home": 1, "geoid": 2, "ground": 4}
CALCULATED, ABSOLUTE = 3, 0  # an AltitudeMode, and a frame
AUTOPILOTS: dict[Firmware, int] = {"ardupilot": 3, "px4": 12, "other": 0}
KML = '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>'
Json = dict[str, Any]
Lines = Sequence[np.ndarray]  # ``[N, 3]`` x, y and height each


def _rounded(world: World, xy_m: XY) -> list[float]:
    """Return longitude and latitude as programs write them."""
    return [round(degrees, 8) for degrees in world.lonlat(*xy_m)]


def _params(item: Item) -> list[float]:
    """Return the first four parameters of an item."""
    if item.command == JUMP:
        return [item.to + 1, item.repeats, 0, 0]
    if item.command == LOITER_TURNS:
        return [2, 0, item.radius_m, 0]
    return [item.hold_s if item.command == WAYPOINT else 0, 0, 0, 0]


def plan(world: World, items: Sequence[Item], firmware: Firmware, home_m: XY) -> Json:
    """Return a plan of QGroundControl as its JSON object."""
    rows = []
    for number, item in enumerate(items):
        lon, lat = _rounded(world, item.xy_m) if item.xy_m else (0, 0)
        has_height = not math.isnan(item.height_m)
        shown_m = flown_m = item.height_m if has_height else None
        frame, mode = FRAMES[item.datum][number % 2], ALTITUDE_MODES[item.datum]
        if item.is_calculated:
            frame, mode, flown_m = ABSOLUTE, CALCULATED, None
        elif item.datum == "geoid" and number % 2 and item.xy_m and has_height:
            mode = CALCULATED
            shown_m = round(item.height_m - float(world.ground_m(*item.xy_m)), 2)
        row = {
            "type": "SimpleItem",
            "autoContinue": True,
            "doJumpId": number + 1,
            "command": item.command,
            "frame": frame,
            "params": [*_params(item), lat, lon, flown_m],
            "Altitude": shown_m,
            "AltitudeMode": mode,
            "AMSLAltAboveTerrain": None,
        }
        rows.append(row)
    lon, lat = _rounded(world, home_m)
    mission = {
        "version": 2,
        "firmwareType": AUTOPILOTS[firmware],
        "vehicleType": 2,
        "cruiseSpeed": 15,
        "hoverSpeed": 5,
        "globalPlanAltitudeMode": 1,
        "items": rows,
        "plannedHomePosition": [lat, lon, round(float(world.ground_m(*home_m)), 2)],
    }
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": mission,
    }


def waypoints(world: World, items: Sequence[Item], home_m: XY) -> list[list[str]]:
    """Return the rows of ``QGC WPL 110``, row 0 being home."""
    rows = []
    home = Item(WAYPOINT, home_m, round(float(world.ground_m(*home_m)), 2), "geoid")
    for number, item in enumerate([home, *items]):
        lon, lat = _rounded(world, item.xy_m) if item.xy_m else (0, 0)
        frame = FRAMES[item.datum][number % 2]
        values = [*_params(item), lat, lon, item.height_m]
        rows.append(
            [str(each) for each in (number, int(number == 0), frame, item.command, *values, 1)]
        )
    return rows


def waypoints_text(rows: Sequence[Sequence[str]]) -> str:
    """Return the text of rows."""
    return "\n".join(["QGC WPL 110", *("\t".join(row) for row in rows)]) + "\n"


def placed(world: World, line: np.ndarray) -> list[list[float]]:
    """Return longitude, latitude and height of the points of a line."""
    return [
        [*_rounded(world, (x_m, y_m)), round(height_m, 2)] for x_m, y_m, height_m in line.tolist()
    ]


def kml_line(
    world: World, line: np.ndarray, mode: str = "", tag: str = "LineString", more: str = ""
) -> str:
    """Return a line of KML; ``tag`` may be ``gx:Track`` too, ``more`` stands in it."""
    points = placed(world, line)
    if tag == "gx:Track":
        inner = "".join(f"<gx:coord>{' '.join(map(str, point))}</gx:coord>" for point in points)
    else:
        inner = (
            f"<coordinates>{' '.join(','.join(map(str, point)) for point in points)}</coordinates>"
        )
    mode = mode and f"<altitudeMode>{mode}</altitudeMode>"
    return f"<Placemark><{tag}>{mode}{more}{inner}</{tag}></Placemark>"


def kml(*placemarks: str) -> str:
    """Return the text of KML."""
    return f"{KML}{''.join(placemarks)}</Document></kml>"


def gpx(world: World, lines: Lines, is_track: bool, above_m: Sequence[float] | None = None) -> str:
    """Return the text of GPX; with ``above_m``, heights above the ground in descriptions, it is one of jaxurban's."""
    point_tag, line_tag = ("trkpt", "trkseg") if is_track else ("rtept", "rte")
    parts = []
    for line in lines:
        points = []
        for number, (lon, lat, height_m) in enumerate(placed(world, line)):
            about = "" if above_m is None else f"<desc>{above_m[number]:.1f} m above ground</desc>"
            point = (
                f'<{point_tag} lon="{lon}" lat="{lat}"><ele>{height_m}</ele>{about}</{point_tag}>'
            )
            points.append(point)
        part = f"<{line_tag}>{''.join(points)}</{line_tag}>"
        parts.append(f"<trk>{part}</trk>" if is_track else part)
    creator = "another" if above_m is None else "jaxurban"
    space = 'xmlns="http://www.topografix.com/GPX/1/1"'
    return f'<gpx version="1.1" creator="{creator}" {space}>{"".join(parts)}</gpx>'


def geojson(world: World, lines: Lines, has_property: bool = False) -> Json:
    """Return lines as GeoJSON; level lines may have their height as a property."""
    features = []
    for line in lines:
        points: list[list[float]] = placed(world, line)
        about: Json = {"name": "way"}
        if has_property and len({height_m for *_, height_m in points}) == 1:
            about["altitude_m"] = points[0][2]
            points = [point[:2] for point in points]
        features.append(feature(points, about))
    return {"type": "FeatureCollection", "features": features}


def feature(points: Sequence[Sequence[float]], about: Json) -> Json:
    """Return a line as a feature of GeoJSON."""
    shape = {"type": "LineString", "coordinates": points}
    return {"type": "Feature", "properties": about, "geometry": shape}


def csv(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return the text of a table."""
    return "\n".join(",".join(map(str, row)) for row in (names, *rows)) + "\n"


def to_json(value: Json) -> str:
    """Return the text of a JSON object."""
    return json.dumps(value, indent=1)
