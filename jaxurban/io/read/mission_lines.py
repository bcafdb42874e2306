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
    """Points that are flown one after the other; none of what is no line.

    Attributes:
      points: longitude, latitude and height of each; a height is NaN where there is none.
      datum: what the heights are above, None where the file does not say.
    """

    points: list[tuple[float, float, float]]
    datum: Datum | None = None


def read_lines(path: Path, data: bytes, heights: Datum | None, home: LonLat | None) -> Mission:
    """Return the lines of a file as a mission, which begins at home, where one is named.

    Raises:
      InputError, ValueError: it cannot be read, holds no line, a point that is no place or has no height; or heights
        above what neither the file nor ``heights`` says, or both say otherwise.
    """
    name = path.name
    features = READERS[path.suffix.lower()](path, data)
    lines = [line for line in features if len(line.points) > 1]
    if not lines:
        raise InputError(f"{name!r} holds no line of two points: give the mission's way as a line")
    notes = list[str]()
    legs = list[Leg]()
    number = 0
    for line in lines:
        datum = _datum(name, line.datum, heights)
        before: Place | None = None
        for point in line.points:
            number += 1
            _check(f"point {number}", point)
            place = Place(*point, datum)
            if number == 1 and home:
                before = Place(*home, place.height_m, datum)
                legs.append(Leg(Place(*home, 0.0, "ground"), before, "climb", 1))
            if before and before != place:
                legs.append(Leg(before, place, "leg", number))
            before = place
    if not home:
        notes.append(f"the climb from home is not judged, as {NO_HOME}")
    if len(lines) > 1:
        notes.append(f"it holds {len(lines)} lines, and the ways between them are not judged")
    if len(features) > len(lines):
        others = len(features) - len(lines)
        notes.append(f"it holds {others} things that are no lines, which are not read")
    return Mission(name, tuple(legs), home, None, tuple(notes), None)


def _datum(name: str, own: Datum | None, heights: Datum | None) -> Datum:
    """Return what heights are above by the file and by its user, who knows better where it is the geoid by a standard.

    Raises:
      InputError: neither says it, or they contradict one another.
    """
    if own is None:
        if heights is None:
            *others, last = map(repr, DATUMS)
            raise InputError(
                f"{name!r} does not say what its heights are above: give heights as {', '.join(others)} or {last}"
            )
        return heights
    if heights in (None, own):
        return own
    if (own, heights) == ("geoid", "ellipsoid"):
        return "ellipsoid"
    raise InputError(
        f"{name!r} says that its heights are above the {own}: leave heights={heights!r} out"
    )


def _check(what: str, point: tuple[float, float, float]) -> None:
    """Raise ValueError unless a point is a place with a height."""
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
    """Return the LineStrings and tracks of KML."""
    lines = []
    for element in _xml(data).iter():
        tag = _tag(element)
        if tag in KML_OTHERS:
            lines.append(Line([]))
        if tag not in ("LineString", "Track"):
            continue
        mode = _text(element, "altitudeMode")
        if mode and mode not in KML_MODES:
            raise InputError(
                f"a line of {path.name!r} has the altitude mode {mode!r}, by which its heights are none in the air: "
                f"use {' or '.join(KML_MODES)}"
            )
        texts = [each.split(",") for each in _text(element, "coordinates").split()]
        if tag == "Track":
            texts = [(child.text or "").split() for child in element if _tag(child) == "coord"]
        lines.append(Line([_point(_floats(each)) for each in texts], KML_MODES.get(mode)))
    return lines


def gpx_lines(path: Path, data: bytes) -> list[Line]:
    """Return the routes and the segments of tracks of GPX; of jaxurban's own with the heights above ground it names."""
    root = _xml(data)
    lines = []
    for element in root.iter():
        if _tag(element) == "wpt":
            lines.append(Line([]))
        if _tag(element) not in ("rte", "trkseg"):
            continue
        points = [child for child in element if _tag(child) in ("rtept", "trkpt")]
        above_ground = [OWN_HEIGHT.fullmatch(_text(point, "desc")) for point in points]
        is_own = root.get("creator") == OWN and all(above_ground)
        texts = [_text(point, "ele") for point in points]
        if is_own:
            texts = [match[1] for match in above_ground if match]
        read = [
            _point(_floats((point.get("lon"), point.get("lat"), text)))
            for point, text in zip(points, texts, strict=True)
        ]
        lines.append(Line(read, "ground" if is_own else None))
    return lines


def geojson_lines(path: Path, data: bytes) -> list[Line]:
    """Return the lines of GeoJSON; of jaxurban's own with the heights above ground that stand beside them."""
    whole = json.loads(data)
    lines = []
    features = whole.get("features", [whole])
    is_own = any("settings" in (feature.get("properties") or {}) for feature in features)
    for feature in features:
        facts = feature.get("properties") or {}
        shape = feature.get("geometry", feature) or {}
        if is_own and facts.get(SEGMENT_PROPERTY) is not None:
            continue  # of a report: it repeats a part of the route
        kind = shape.get("type")
        parts = shape.get("coordinates")
        if kind not in ("LineString", "MultiLineString") or not parts:
            lines.append(Line([]))
            continue
        if kind == "LineString":
            parts = [parts]
        own_m = facts.get("z_m") if "settings" in facts else None
        for part in parts:
            heights_m = own_m or [facts.get(ALTITUDE_PROPERTY)] * len(part)
            points = []
            for values, height_m in zip(part, heights_m, strict=True):
                has_height = len(values) > 2 and not own_m
                points.append(_point(values if has_height else (*values[:2], height_m)))
            lines.append(Line(points, "ground" if own_m else None))
    return lines


def csv_lines(path: Path, data: bytes) -> list[Line]:
    """Return the rows of a table as one line."""
    table = read_table(path, "mission")
    names = {str(column).strip().lower(): column for column in table}
    values = []
    for what, known in COLUMNS.items():
        column = next((names[name] for name in known if name in names), None)
        if column is None:
            raise InputError(f"{path.name!r} has no column of {what}: call it {known[0]}")
        numbers = pd.to_numeric(table[column], errors="coerce").to_numpy(float)
        values.append(np.where(np.isfinite(numbers), numbers, np.nan))
    return [Line([(lon, lat, z) for lon, lat, z in np.column_stack(values).tolist()])]


READERS: dict[str, Callable[[Path, bytes], list[Line]]] = {
    ".kml": kml_lines,
    ".gpx": gpx_lines,
    ".geojson": geojson_lines,
    ".json": geojson_lines,
    ".csv": csv_lines,
}
