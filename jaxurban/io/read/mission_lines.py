"""Missions that are lines of points: KML, GPX, GeoJSON and CSV, of which few say what heights are above."""

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError, TreeBuilder, XMLParser

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.read.mission_parts import (
    DATUMS,
    NO_HOME,
    Datum,
    Leg,
    LonLat,
    Mission,
    Place,
    check_place,
    number_of,
)
from jaxurban.io.read.routes import ALTITUDE_PROPERTY, SEGMENT_PROPERTY
from jaxurban.io.tables import read_table

OWN = "jaxurban"  # what it calls itself as the creator of GPX
OWN_HEIGHT = re.compile(r"(-?[\d.]+) m above ground")  # of its points there
KML_MODES: dict[str, Datum] = {"relativeToGround": "ground", "absolute": "geoid"}
KML_OTHERS = ("Point", "Polygon", "Model", "GroundOverlay", "NetworkLink")
COLUMNS = {
    "longitude": ("lon", "lon_deg", "longitude", "longitude_deg", "lng", "long"),
    "latitude": ("lat", "lat_deg", "latitude", "latitude_deg"),
    "height": (ALTITUDE_PROPERTY, "height_m", "alt_m", "altitude", "height", "alt", "ele"),
}


class Line(NamedTuple):
    """Points that are flown one after the other; a thing of a file that is no line has no points.

    Attributes:
      points: longitude and latitude in degrees and height in metres of each; NaN for what the file leaves out.
      datum: what the heights are above, None where the file does not say.
    """

    points: list[tuple[float, float, float]]
    datum: Datum | None = None


def read_lines(path: Path, data: bytes, heights: Datum | None, home: LonLat | None) -> Mission:
    """Return the lines of a file as a mission: a leg from each point of a line to its next one.

    Points are counted from 1 through all lines, and a leg has the number of the point that it leads to. With a home the
    mission begins with a climb from the ground there to the height of the first point. Nothing is flown between lines.

    Args:
      path: of the file; its suffix is a key of `READERS`.
      data: the bytes of the file.
      heights: what heights are above, where the file does not say it; None if only the file may say it.
      home: longitude and latitude in degrees, or None.

    Raises:
      InputError: the file holds no line of two points, or it is not clear what heights are above (see `_datum`).
      ValueError: the file cannot be read, or a point has no height or does not lie on the Earth.
    """
    name = path.name
    shapes = READERS[path.suffix.lower()](path, data)
    lines = [line for line in shapes if len(line.points) > 1]
    if not lines:
        raise InputError(f"{name!r} holds no line of two points: give the mission's way as a line")

    legs = []
    number = 0
    for line in lines:
        datum = _datum(name, line.datum, heights)
        previous: Place | None = None
        for point in line.points:
            number += 1
            _check(f"point {number}", point)
            place = Place(*point, datum)
            if home and number == 1:
                previous = Place(*home, place.height_m, datum)
                legs.append(Leg(Place(*home, 0.0, "ground"), previous, "climb", number))
            if previous and previous != place:
                legs.append(Leg(previous, place, "leg", number))
            previous = place

    notes = []
    if not home:
        notes.append(f"the climb from home is not judged, as {NO_HOME}")
    if len(lines) > 1:
        notes.append(f"it holds {len(lines)} lines, and the ways between them are not judged")
    num_others = len(shapes) - len(lines)
    if num_others:
        notes.append(f"it holds {num_others} things that are no lines, which are not read")
    return Mission(
        name, tuple(legs), home, home_elevation_m=None, not_judged=tuple(notes), speed_m_s=None
    )


def _datum(name: str, own: Datum | None, heights: Datum | None) -> Datum:
    """Return what the heights of a line are above.

    Where the file says the geoid, its user may say the ellipsoid: files write the geoid because their standard does.

    Args:
      name: of the file, for messages.
      own: what the heights are above by the file, None where it does not say it.
      heights: what they are above by the user, None where the user does not say it.

    Raises:
      InputError: neither says it, or they contradict each other otherwise.
    """
    if heights is not None and own in (None, heights):
        return heights
    if own is None:
        *others, last = map(repr, DATUMS)
        raise InputError(
            f"{name!r} does not say what its heights are above: give heights as {', '.join(others)} or {last}"
        )
    if heights is None:
        return own
    if (own, heights) == ("geoid", "ellipsoid"):
        return "ellipsoid"
    raise InputError(
        f"{name!r} says that its heights are above the {own}: leave heights={heights!r} out"
    )


def _check(what: str, point: tuple[float, float, float]) -> None:
    """Raise ValueError, which begins with ``what``, unless a point is a place on the Earth with a height.

    The point is longitude and latitude in degrees and height in metres, in the order of `COLUMNS`.
    """
    for part, value in zip(COLUMNS, point, strict=True):
        if math.isnan(value):
            raise ValueError(f"{what} has no {part}")
    check_place(what, *point)


class _Plain(TreeBuilder):
    """What XML holds, of a file that defines no words of its own."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """Refuse what may grow without end, or name other files."""
        raise ValueError("it has a DOCTYPE, which is never read")


def _xml(data: bytes) -> Element:
    """Return the root of an XML file; ValueError where it is damaged, or defines words of its own."""
    parser = XMLParser(target=_Plain())
    try:
        parser.feed(data)
        return parser.close()
    except ParseError as error:
        raise ValueError(str(error)) from error


def _tag(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def _text(element: Element, name: str) -> str:
    """Return the text of the first child of this name, else an empty text."""
    texts = (child.text or "" for child in element if _tag(child) == name)
    return next(texts, "").strip()


def _point(values: Sequence[Any]) -> tuple[float, float, float]:
    """Return longitude, latitude and height, NaN for what is left out."""
    lon, lat, height_m = (number_of("a coordinate", each) for each in (*values, None, None)[:3])
    return lon, lat, height_m


def _floats(texts: Iterable[str | None]) -> list[float | None]:
    return [float(text) if text else None for text in texts]


def kml_lines(path: Path, data: bytes) -> list[Line]:
    """Return the LineStrings and Tracks of KML, and a `Line` without points for everything else that has a place.

    Raises:
      InputError: a line whose altitude mode says that it is not in the air, such as ``clampToGround``.
      ValueError: the file cannot be read, or a coordinate is not a number.
    """
    lines = []
    for element in _xml(data).iter():
        tag = _tag(element)
        if tag in KML_OTHERS:
            lines.append(Line([]))
        if tag not in ("LineString", "Track"):
            continue

        # A LineString without a mode leaves the datum open.
        mode = _text(element, "altitudeMode")
        if mode and mode not in KML_MODES:
            raise InputError(
                f"a line of {path.name!r} has the altitude mode {mode!r}, by which its heights are none in the air: "
                f"use {' or '.join(KML_MODES)}"
            )

        # A LineString is one text, "lon,lat,height lon,lat,height"; a Track has a text "lon lat height" for each point.
        texts = [values.split(",") for values in _text(element, "coordinates").split()]
        if tag == "Track":
            texts = [(child.text or "").split() for child in element if _tag(child) == "coord"]
        points = [_point(_floats(values)) for values in texts]
        lines.append(Line(points, KML_MODES.get(mode)))
    return lines


def gpx_lines(path: Path, data: bytes) -> list[Line]:
    """Return the routes and the segments of tracks of GPX, and a `Line` without points for every single waypoint.

    Heights are those of ``ele``, and the file does not say what they are above. In files that jaxurban wrote they are
    the heights above ground in the points' descriptions.

    Raises:
      ValueError: the file cannot be read, or a coordinate is not a number.
    """
    root = _xml(data)
    lines = []
    for element in root.iter():
        if _tag(element) == "wpt":
            lines.append(Line([]))
        if _tag(element) not in ("rte", "trkseg"):
            continue

        # The points of a line, and their heights: above ground only if every point of jaxurban's own file says so.
        nodes = [child for child in element if _tag(child) in ("rtept", "trkpt")]
        above_ground = [OWN_HEIGHT.fullmatch(_text(node, "desc")) for node in nodes]
        is_own = root.get("creator") == OWN and all(above_ground)
        heights = [_text(node, "ele") for node in nodes]
        if is_own:
            heights = [match[1] for match in above_ground if match]
        points = [
            _point(_floats((node.get("lon"), node.get("lat"), height)))
            for node, height in zip(nodes, heights, strict=True)
        ]
        lines.append(Line(points, "ground" if is_own else None))
    return lines


def geojson_lines(path: Path, data: bytes) -> list[Line]:
    """Return the lines of GeoJSON, and a `Line` without points for every feature that is no line.

    A point's height is its third coordinate, else the feature's property `ALTITUDE_PROPERTY`, and the file does not say
    what it is above. Routes that jaxurban wrote have ``settings``, and the heights of their points above ground in the
    property ``z_m``.

    Raises:
      ValueError: the file cannot be read, a coordinate is not a number, or ``z_m`` has another length than its line.
    """
    whole = json.loads(data)
    features = whole.get("features", [whole])  # a feature or a geometry alone is one of them
    is_own = any("settings" in (feature.get("properties") or {}) for feature in features)
    lines = []
    for feature in features:
        properties = feature.get("properties") or {}
        geometry = feature.get("geometry", feature) or {}

        # What is no line gives one without points; what repeats a part of the route gives none.
        if is_own and properties.get(SEGMENT_PROPERTY) is not None:
            continue  # of a report: it repeats a part of the route
        kind = geometry.get("type")
        parts = geometry.get("coordinates")
        if kind not in ("LineString", "MultiLineString") or not parts:
            lines.append(Line([]))
            continue
        if kind == "LineString":
            parts = [parts]

        # The points of each part, with the heights of a route of jaxurban's, if it is one.
        above_ground_m = properties.get("z_m") if "settings" in properties else None
        for part in parts:
            heights_m = above_ground_m or [properties.get(ALTITUDE_PROPERTY)] * len(part)
            points = []
            for values, height_m in zip(part, heights_m, strict=True):
                has_height = len(values) > 2 and not above_ground_m
                points.append(_point(values if has_height else (*values[:2], height_m)))
            lines.append(Line(points, "ground" if above_ground_m else None))
    return lines


def csv_lines(path: Path, data: bytes) -> list[Line]:
    """Return the rows of a table as one line, NaN for what is no finite number; it does not say its heights' datum.

    The columns of longitude, latitude and height are the first of their names in `COLUMNS` that the table has.

    Raises:
      InputError: the table cannot be read, or lacks one of the three.
    """
    table = read_table(path, "mission")
    columns = {str(column).strip().lower(): column for column in table}
    values = []
    for quantity, names in COLUMNS.items():
        column = next((columns[name] for name in names if name in columns), None)
        if column is None:
            raise InputError(f"{path.name!r} has no column of {quantity}: call it {names[0]}")
        numbers = pd.to_numeric(table[column], errors="coerce").to_numpy(float)
        values.append(np.where(np.isfinite(numbers), numbers, np.nan))
    return [Line([(lon, lat, z_m) for lon, lat, z_m in np.column_stack(values).tolist()])]


READERS: dict[str, Callable[[Path, bytes], list[Line]]] = {
    ".kml": kml_lines,
    ".gpx": gpx_lines,
    ".geojson": geojson_lines,
    ".json": geojson_lines,
    ".csv": csv_lines,
}
