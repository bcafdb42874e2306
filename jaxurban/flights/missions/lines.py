"""Flights that are lines of points: KML, GPX, GeoJSON and CSV, of which few say what heights are above.

How many positions a file holds is counted apart from the lines that are read, and what they leave over is not judged.
"""

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from itertools import compress, pairwise, zip_longest
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError, fromstring

from jaxurban.errors import InputError
from jaxurban.flights.missions.parts import (
    CORNER_M,
    DATUMS,
    ENDS_IN_AIR,
    NO_HOME,
    SAME_M,
    Account,
    DamagedError,
    Datum,
    Leg,
    LonLat,
    Mission,
    Place,
    Profile,
    check_place,
    decimal_of,
    first_sentences,
    json_of,
    number_of,
    one_value,
)
from jaxurban.io.routes import ALTITUDE_PROPERTY
from jaxurban.io.tables import check_rows, is_note

OWN = "jaxurban"  # what it calls itself as the creator of GPX
OWN_HEIGHT = re.compile(r"(-?[\d.]+) m above ground")  # of its points there
OWN_DATA = "height_reference"  # that its lines in KML have
DJI_TEMPLATE = "templateType"  # element of the KML from which DJI's programs make waylines
XML_OTHERS = ("Point", "Polygon", "LinearRing", "Model", "GroundOverlay", "NetworkLink", "Tour")
KML_MODES: dict[str, Datum] = {"relativeToGround": "ground", "absolute": "geoid"}
# Parts of lines in KML that are read, or do not change where they lie.
KML_PARTS = {
    "LineString": {"coordinates", "altitudeMode", "extrude", "tessellate", "drawOrder"},
    "Track": {"coord", "altitudeMode", "extrude", "tessellate", "when", "angles", "ExtendedData"},
    "MultiTrack": {"Track", "interpolate"},
}
# Columns of AirData's logs and of Litchi's missions, which have others that do not change the way.
ABOVE_TAKEOFF, CURVE, MODE = "height_above_takeoff", "curvesize", "altitudemode"
LITCHI_MODES: dict[str, Datum] = {"0": "home", "1": "ground"}
COLUMNS = {
    "longitude": ("lon", "lon_deg", "longitude", "longitude_deg", "lng", "long"),
    "latitude": ("lat", "lat_deg", "latitude", "latitude_deg"),
    "height": (
        ALTITUDE_PROPERTY,
        "height_m",
        "alt_m",
        "altitude",
        "height",
        "alt",
        "ele",
        ABOVE_TAKEOFF,
    ),
}
UNIT = re.compile(r" ?\((m|meters|metres|ft|feet)\)")  # behind the name of a column
FOOT_M = 0.3048
# In names of columns and properties that say how others are meant, and values that say what is taken anyway.
QUALIFIER = re.compile(r"(units?|mode|frame|datum|system|command)(?![a-z])", re.IGNORECASE)
HARMLESS = ("", "m", "meter", "meters", "metre", "metres", "wgs84", "wgs 84", "epsg:4326")
HEIGHTS = ("alt", "height", "elev")  # in names of further columns of height
# What files call a coordinate reference system, and the names of the one that is read.
CRS_NAMES = ("crs", "datum", "epsg", "mapdatum", "srs", "srsname")
WGS84 = re.compile(
    r"(?:(?:urn:(?:x-)?ogc:def:crs:|https?://www\.opengis\.net/def/crs/)?(?:OGC|EPSG)[:/](?:[\d.]*[:/])?)?"
    r"(?:CRS84|4326)|WGS[ _-]?(?:19)?84",
    re.ASCII | re.IGNORECASE,
)
SAME_DEG = 1e-7  # two places that differ by more are two places
NO_LINE = "is no part of a route, track or line"


class Line(NamedTuple):
    """A line of a file, or something else that may have positions.

    Attributes:
      what: name of its kind in the file, such as ``"LineString"``.
      points: that are flown one after the other, longitude and latitude in degrees and height in metres of each; NaN
        for what the file leaves out.
      datum: what the heights are above, None where the file does not say.
      is_own: whether jaxurban wrote it, whose lines follow the ground.
      why: it is not judged, as said of "it"; empty for a line that is.
      num: how many positions it has of which no points are read.
      beside_m: the heights above the ground that the file names too, one of each point; empty where it does not.
      times: when it was at each point, as text, blank where the file leaves that out; empty where it has no times.
      datums: what each height is above, in place of ``datum``; the ways between them are straight.
      cuts_m: how far from each point the corner may be cut; empty where the file does not say it.
    """

    what: str
    points: Sequence[tuple[float, float, float]] = ()
    datum: Datum | None = None
    is_own: bool = False
    why: str = ""
    num: int = 0
    beside_m: Sequence[float] = ()
    times: Sequence[str] = ()
    datums: Sequence[Datum] = ()
    cuts_m: Sequence[float] = ()


Table = list[tuple[str, Sequence[str]]]  # columns with a title and cells, by name
Shapes = tuple[list[Line], int]  # the things of a file, and how many positions it holds


def mission_of_lines(
    name: str,
    shapes: Sequence[Line],
    num_positions: int,
    heights: Datum | None,
    home: LonLat | None,
) -> Mission:
    """Return the lines of a file as a mission: a leg from each point of a line to its next one.

    Points are counted from 1 through all lines, and a leg has the number of the point that it leads to. With a home the
    mission begins with a climb from the ground there to the height of the first point. Nothing is flown between lines.

    Args:
      name: of the file.
      shapes: the things of the file.
      num_positions: how many it holds.
      heights: what heights are above, where the file does not say it; None if only the file may say it.
      home: longitude and latitude in degrees, or None.

    Raises:
      InputError: the file holds no line of two places, or it is not clear what heights are above (see `_datum`).
      DamagedError: a point does not lie on the Earth.
    """
    lines: list[Line] = []
    others: list[Line] = []
    for shape in shapes:
        is_line = not shape.why and len(set(shape.points)) > 1
        (lines if is_line else others).append(shape)
    accounts = _others(others, num_positions - sum(len(line.points) for line in lines))
    sentences = [
        f"what it holds as {each.what} ({each.num} positions) is not judged, as it {each.why}"
        for each in accounts
    ]
    if not lines:
        why = f" ({sentences[0]})" if sentences else ""
        raise InputError(
            f"{name!r} holds no line of two places that is read{why}: give the mission's way as a line"
        )

    legs: list[Leg] = []
    last = 0  # number of the last point
    for line in lines:
        datum = _datum(name, (*line.datums, line.datum)[0], heights)
        _check_points(name, line, last + 1)
        num = len(line.points)
        last += num
        ways = _legs_of(line, datum, last, None if legs else home)
        numbers = range(len(legs), len(legs) + len(ways))
        accounts.append(Account(line.what, num, tuple(numbers)))
        legs += ways

    notes = []
    if not home:
        notes.append(f"the climb from home is not judged, as {NO_HOME}")
    is_log = bool(lines[-1].times)
    if len(lines) > 1:
        notes.append(f"it holds {len(lines)} lines, and the ways between them are not judged")
    return Mission(
        name,
        tuple(legs),
        home,
        home_elevation_m=None,
        not_judged=first_sentences(notes + sentences),
        speed_m_s=None,
        accounts=tuple(accounts),
        num_things=num_positions,
        notes=() if is_log else (ENDS_IN_AIR.format("point", last),),
    )


def _others(others: Sequence[Line], num_more: int) -> list[Account]:
    """Return what becomes of what is no line that is judged, and of more positions of a file."""
    nums: Counter[tuple[str, str]] = Counter()
    for other in others:
        nums[other.what, other.why or NO_LINE] += other.num or len(other.points)
    num_more -= nums.total()
    if num_more:
        nums["other positions", NO_LINE] = num_more
    return [Account(what, num, (), why) for (what, why), num in nums.items()]


def _check_points(name: str, line: Line, first: int) -> None:
    """Raise InputError or DamagedError unless each point of a line is a place; ``first`` is the number of its first."""
    for number, point in enumerate(line.points, first):
        what = f"point {number}"
        for part, value in zip(COLUMNS, point, strict=True):
            if math.isnan(value):
                raise InputError(
                    f"{name!r} is no way in the air, as {what} has no {part}: give each point a longitude, "
                    "latitude and height"
                )
        check_place(what, *point)


def _legs_of(line: Line, datum: Datum, last: int, home: LonLat | None) -> list[Leg]:
    """Return the legs of a line, and those beside it as variants.

    Args:
      line: whose points are places.
      datum: what its heights are above, where the line does not say it for each.
      last: the number of its last point.
      home: from where a climb leads to it, if one does.
    """
    datums = line.datums or [datum] * len(line.points)
    places = [Place(*point, each) for point, each in zip(line.points, datums, strict=True)]
    legs = []
    if home:
        over_home = Place(*home, places[0].height_m, datum)
        if line.datums:
            over_home = Place(*home, math.nan, "geoid", level_with=places[0])
        legs.append(Leg(Place(*home, 0.0, "ground"), over_home, "climb", 1))
        places.insert(0, over_home)
    profile: Profile = "both" if datum == "ground" and not line.is_own else "frame"
    ways = _ways(places, last, "straight" if line.datums else profile)
    # By the number of the point, counted from the last one.
    cuts_m = line.cuts_m or [CORNER_M] * len(places)
    legs += [way._replace(turn_m=max(CORNER_M, cuts_m[way.item - last - 1])) for way in ways]
    beside = [
        Place(lon, lat, height_m, "ground")
        for (lon, lat, _), height_m in zip(line.points, line.beside_m, strict=False)
    ]
    return legs + [leg._replace(is_variant=True) for leg in _ways(beside, last)]


def _ways(places: Sequence[Place], last: int, profile: Profile = "frame") -> list[Leg]:
    """Return the legs between places, of which the last one has the number ``last``."""
    return [
        Leg(start, end, "leg", number, profile=profile)
        for number, (start, end) in enumerate(pairwise(places), last - len(places) + 2)
        if start != end
    ]


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
    datum = heights or own
    if datum is None:
        *others, last = map(repr, DATUMS)
        raise InputError(
            f"{name!r} does not say what its heights are above: give heights as {', '.join(others)} or {last}"
        )
    if heights and own not in (None, heights) and (own, heights) != ("geoid", "ellipsoid"):
        raise InputError(
            f"{name!r} says that its heights are above the {own}: leave heights={heights!r} (--heights above=) out"
        )
    return datum


def _check_crs(path: Path, name: str, value: Any) -> None:
    """Raise InputError where what has a name names another coordinate reference system than WGS 84 by its value.

    Values of other names than `CRS_NAMES`, and blank ones, pass.
    """
    is_crs = name.rpartition("}")[2].lower() in CRS_NAMES
    text = str(value or "").strip()
    if is_crs and text and not WGS84.fullmatch(text):
        raise InputError(
            f"{path.name!r} has its positions in {text[:80]!r}: convert them to WGS 84 (EPSG:4326)"
        )


def tag_of(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def words_of(element: Element) -> str:
    """Return the text of an element; DamagedError where it holds elements beside it."""
    if len(element):
        raise DamagedError(f"a {tag_of(element)[:40]} holds elements, and not only text")
    return (element.text or "").strip()


def text_of(element: Element, *names: str) -> str:
    """Return the text of the children of a name, or of their children by more names, else an empty text.

    Raises:
      DamagedError: two of them differ, or hold elements.
    """
    elements = [element]
    for name in names:
        elements = [child for each in elements for child in each if tag_of(child) == name]
    return one_value(names[-1], map(words_of, elements)) or ""


def point_of(
    values: Sequence[Any], read: Callable[[str, Any], float] = decimal_of
) -> tuple[float, float, float]:
    """Return longitude, latitude and height, NaN for what is left out.

    Args:
      values: of the file, three at most.
      read: takes what a value is, and the value; left out, values are texts.
    """
    if len(values) > 3:
        raise DamagedError(f"a position has {len(values)} values: give longitude, latitude, height")
    lon, lat, height_m = (read("a coordinate", each) for each in (*values, None, None)[:3])
    return lon, lat, height_m


def _num_at(element: Element) -> int:
    """Return how many positions an element of KML or GPX has by itself: as its text, or as attributes.

    Raises:
      DamagedError: there are elements among the positions.
    """
    if tag_of(element) == "coordinates":
        return len(words_of(element).split())
    return tag_of(element) == "coord" or "lat" in element.attrib or "lon" in element.attrib


def _num_in(element: Element) -> int:
    """Return how many positions an element of KML or GPX holds."""
    return sum(map(_num_at, element.iter()))


def xml_root(data: bytes) -> Element:
    """Return the root of XML; DamagedError where it cannot be read, or may define words of its own."""
    if b"<!DOCTYPE" in data:
        raise DamagedError("it has a DOCTYPE, which is never read")
    try:
        return fromstring(data)
    except ParseError as error:
        line, column = error.position
        raise DamagedError(f"its XML is damaged in line {line}, column {column}") from error


def xml_lines(path: Path, data: bytes) -> Shapes:
    """Return the lines of KML or GPX, and all else that has positions or may hold some.

    Raises:
      InputError: another coordinate reference system than WGS 84, or a line of KML whose altitude mode says that it is
        not in the air, such as ``clampToGround``.
      ValueError: the file cannot be read, defines words of its own, or a coordinate is not a number.
    """
    root = xml_root(data)
    is_own = root.get("creator") == OWN
    for element in root.iter():
        is_own |= element.get("name") == OWN_DATA
        if tag_of(element) == DJI_TEMPLATE:
            raise DamagedError("it is DJI's template, which no drone flies: name a waylines.wpml")
        if tag_of(element) == "ele" and element.attrib:
            raise DamagedError("an ele has attributes: take them out if it is in metres")
        for key, value in ((element.tag, element.text), *element.items()):
            _check_crs(path, key, value)

    lines = []
    stack = [root]
    while stack:
        element = stack.pop()
        tag = tag_of(element)
        strange = {tag_of(child) for child in element} - KML_PARTS.get(tag, set())
        why = ""
        if tag in KML_PARTS and strange:
            why = f"has a part {min(strange)}, which is not understood"
        if why or tag in XML_OTHERS or _num_at(element):
            lines.append(Line(tag, why=why, num=_num_in(element)))
        elif tag in ("LineString", "Track"):
            lines.append(_kml_line(path, element, is_own))
        elif tag in ("rte", "trkseg"):
            lines.append(_gpx_line(element, is_own))
        else:
            stack += reversed(element)
    return lines, _num_in(root)


def _kml_line(path: Path, element: Element, is_own: bool) -> Line:
    """Return a LineString or a Track of KML, written by jaxurban or not; errors as of `xml_lines`."""
    # A LineString without a mode leaves the datum open.
    mode = text_of(element, "altitudeMode")
    if mode and mode not in KML_MODES:
        raise InputError(
            f"a line of {path.name!r} has the altitude mode {mode!r}, by which its heights are none in the air: "
            f"use {' or '.join(KML_MODES)}"
        )

    # A LineString is one text, "lon,lat,height lon,lat,height"; a Track has a text "lon lat height" for each point.
    texts = [values.split(",") for values in text_of(element, "coordinates").split()]
    times = [words_of(child) for child in element if tag_of(child) == "when"]
    if tag_of(element) == "Track":
        texts = [words_of(child).split() for child in element if tag_of(child) == "coord"]
    points = [point_of(values) for values in texts]
    return Line(tag_of(element), points, KML_MODES.get(mode), is_own, times=times)


def _gpx_line(element: Element, is_own: bool) -> Line:
    """Return a route or the segment of a track of GPX, written by jaxurban or not.

    Heights are those of ``ele``, and the file does not say what they are above. In files that jaxurban wrote they are
    above the zero of its terrain, which is taken as the geoid. The heights above ground in the points' descriptions
    count beside them, and alone where it had no terrain.
    """
    nodes = [child for child in element if tag_of(child) in ("rtept", "trkpt")]
    heights = [text_of(node, "ele") for node in nodes]
    described = [""] * len(nodes)
    if is_own:
        matches = [OWN_HEIGHT.fullmatch(text_of(node, "desc")) for node in nodes]
        described = [match[1] if match else "" for match in matches]
    datum: Datum | None = "geoid" if is_own else None
    if is_own and not any(heights):
        heights, described, datum = described, [], "ground"
    points = [
        point_of((node.get("lon"), node.get("lat"), height))
        for node, height in zip(nodes, heights, strict=True)
    ]
    if not any(described):
        described = []
    beside_m = [decimal_of("a height", text) for text in described]
    times = [text_of(node, "time") for node in nodes]
    return Line(tag_of(element), points, datum, is_own, beside_m=beside_m, times=times)


def _num_in_json(value: Any) -> int:
    """Return how many positions a value of JSON holds: lists of what is no list, in any ``coordinates``."""
    num = 0
    stack = [(value, False)]
    while stack:
        part, is_inside = stack.pop()
        if isinstance(part, dict):
            stack += [(each, is_inside or key == "coordinates") for key, each in part.items()]
        elif isinstance(part, list):
            num += is_inside and not all(isinstance(each, list) for each in part)
            stack += [(each, is_inside) for each in part]
    return num


def geojson_lines(path: Path, data: bytes) -> Shapes:
    """Return the lines of GeoJSON, and all other geometries.

    A point's height is its third coordinate, else the feature's property `ALTITUDE_PROPERTY`, and the file does not say
    what it is above. Routes that jaxurban wrote have ``settings``, and the heights of their points above ground in the
    property ``z_m``.

    Raises:
      InputError: the file names another coordinate reference system than WGS 84.
      ValueError: the file cannot be read, a coordinate is not a number, a point has two heights, or ``z_m`` has another
        length than its line.
    """
    whole = json_of(data)
    lines: list[Line] = []
    stack: list[tuple[Any, dict[str, Any]]] = [(whole, {})]  # with the properties of its feature
    while stack:
        value, properties = stack.pop()
        value = value or {}
        crs = value.get("crs")
        for each in crs["properties"].values() if isinstance(crs, dict) else [crs]:
            _check_crs(path, "crs", each)
        properties = value.get("properties") or properties
        inner = value.get("features", value.get("geometries"))
        if "geometry" in value:
            inner = [value["geometry"]]
        if inner is not None:
            stack += [(part, properties) for part in reversed(inner)]
        else:
            lines += _geojson_lines(value, properties)
    return lines, _num_in_json(whole)


def _geojson_lines(geometry: dict[str, Any], properties: dict[str, Any]) -> list[Line]:
    """Return the lines of a geometry of GeoJSON, one of each part, or one without points where it is none.

    Args:
      geometry: of GeoJSON.
      properties: of its feature.

    Raises:
      DamagedError: as of `geojson_lines`.
    """
    what = str(geometry.get("type", "a feature without geometry"))[:40]
    odd = [name for name, value in properties.items() if _is_odd(name, value)]
    if odd and "settings" not in properties:
        why = f"has the property {odd[0]!r}, which is not understood"
        return [Line(what, why=why, num=_num_in_json(geometry))]
    parts = geometry.get("coordinates")
    if what not in ("LineString", "MultiLineString") or not parts:
        return [Line(what, num=_num_in_json(geometry))]
    if what == "LineString":
        parts = [parts]

    # The points of each part, with the heights of a route of jaxurban's, if it is one.
    above_ground_m = properties.get("z_m") if "settings" in properties else None
    stated = [value for name, value in properties.items() if name.lower() in COLUMNS["height"]]
    height_m = one_value("the height of a feature", stated, SAME_M)
    lines = []
    for part in parts:
        heights_m = above_ground_m or [height_m] * len(part)
        if len(heights_m) != len(part):
            raise DamagedError(f"z_m has {len(heights_m)} heights for {len(part)} positions")
        points = []
        for values, height_m in zip(part, heights_m, strict=True):
            lon, lat, _ = point_of(values, number_of)
            said = one_value("the height of a position", (height_m, *values[2:]), SAME_M)
            points.append((lon, lat, number_of("a height", said)))
        is_own = bool(above_ground_m)
        lines.append(Line(what, points, "ground" if is_own else None, is_own))
    return lines


def _is_odd(name: str, value: Any) -> bool:
    """Return whether a column or property says that others are meant in another way than they are taken."""
    return bool(QUALIFIER.search(name)) and str(value).strip().lower() not in HARMLESS


def csv_lines(path: Path, data: bytes) -> Shapes:
    """Return the rows of a table as one line; it does not say what its heights are above, but for the following ones.

    The columns of longitude, latitude and height have one of their names in `COLUMNS`, in capitals or not, and maybe a
    unit behind it (`UNIT`). Where two have one, they must agree to a centimetre.

    Of a log of AirData the height above the take-off counts, of a mission of Litchi's the altitude by its mode, and how
    far from each point the corner may be cut; their other columns do not change the way.

    Raises:
      InputError: the table lacks one of the three, has two that differ, or names another CRS than WGS 84; as of
        `check_rows`.
      ValueError: the table cannot be read, or a row holds what is no number.
    """
    table = _table_of(path.name, data)
    names = [name for name, _ in table]
    curves, modes = _named(table, [CURVE]), _named(table, [MODE])
    if ABOVE_TAKEOFF in names:
        table = _of_app(path, table, ABOVE_TAKEOFF)
    elif curves:
        table = _of_app(path, table, "altitude")
    _check_columns(path, table)
    values = [_quantity(path, table, quantity) for quantity in COLUMNS]
    line = Line("table", list(zip(*values, strict=True)))
    if ABOVE_TAKEOFF in names:
        line = line._replace(datum="home")
    elif curves:
        line = line._replace(datums=_datums(modes), cuts_m=one_value(CURVE, map(_metres, curves)))
    return [line], len(line.points)


def _table_of(name: str, data: bytes) -> Table:
    """Return the columns of a table, of a file of a name, a title and cells each; errors as of `csv_lines`.

    Their names lack the unit, and the number that pandas adds to one that is there twice.
    """
    text = io.StringIO(data.decode("utf-8-sig"), newline=None)
    header, *rows = filter(None, csv.reader(text, strict=True))
    if re.search(r"[;\t]", header[0]):
        raise DamagedError("commas must be between its values, and points in its numbers")
    check_rows(io.BytesIO(data), name)
    rows = [row for row in rows if not is_note(row)]
    names = [re.sub(r"\.\d+$", "", UNIT.sub("", title.strip().lower())) for title in header]
    if CURVE in names:
        _check_filled(name, header, rows)
    return [*zip(names, zip_longest(header, *rows, fillvalue=""), strict=False)]


def _check_filled(name: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise InputError where a row of a mission of Litchi, a file of a name, lacks a value or has one more.

    Litchi writes every value, so that those beside such a place may belong to another column.
    """
    for number, row in enumerate(rows, start=1):
        cells = compress(row, map(str.strip, header))  # below a title
        if len(row) != len(rows[-1]) or not all(map(str.strip, cells)):
            raise InputError(
                f"row {number} of {name!r} has {len(row)} values, blank ones among them, for {len(header)} columns: "
                "others may be shifted, so mend that row, or remove it"
            )


def _named(table: Table, known: Collection[str]) -> list[Sequence[str]]:
    """Return the columns of some names."""
    return [column for name, column in table if name in known]


def _of_app(path: Path, table: Table, height: str) -> Table:
    """Return the columns of AirData or Litchi that change the way; InputError where that of heights lacks a unit."""
    if any(not UNIT.search(title.lower()) for title, *_ in _named(table, [height])):
        raise InputError(
            f"{path.name!r} does not say the unit of {height}: call that column '{height}(m)' or '{height}(feet)'"
        )
    flown = (*COLUMNS["longitude"], *COLUMNS["latitude"], height)
    return [(name if name in flown else "", column) for name, column in table]


def _check_columns(path: Path, table: Table) -> None:
    """Raise InputError where a column says that others are meant in another way than they are taken."""
    for name, (title, *cells) in table:
        for cell in set(cells):
            _check_crs(path, name, cell)
            if _is_odd(name, cell):
                raise InputError(
                    f"{path.name!r} has the column {title!r}, which is not read: "
                    "take it out if it does not change the way"
                )


def _quantity(path: Path, table: Table, quantity: str) -> list[float]:
    """Return the numbers of a key of `COLUMNS`, of several columns those of the first; errors as of `csv_lines`."""
    names = {name for name, _ in table}
    known = names.intersection(COLUMNS[quantity])
    if not known:
        raise InputError(
            f"{path.name!r} has no column of {quantity}: call it {COLUMNS[quantity][0]}"
        )
    most = SAME_DEG
    if quantity == "height":
        known |= {name for name in names if any(word in name for word in HEIGHTS)}
        most = SAME_M
    columns = _named(table, known)
    numbers, *others = map(_metres, columns)
    if others:
        titles = " and ".join(repr(title) for title, *_ in columns)
        what = f"one quantity, in its columns {titles}"
        numbers = [one_value(what, row, most) for row in zip(numbers, *others, strict=True)]
    return numbers


def _datums(modes: Sequence[Sequence[str]]) -> list[Datum]:
    """Return what Litchi's heights are above, by the columns of their mode."""
    cells = one_value(MODE, [[cell.strip() for cell in column[1:]] for column in modes]) or []
    if not set(cells) <= LITCHI_MODES.keys():
        raise DamagedError(
            f"a value of {MODE} is neither 0, above the take-off, nor 1, above the ground"
        )
    return [LITCHI_MODES[cell] for cell in cells]


def _metres(column: Sequence[str]) -> list[float]:
    """Return the numbers of a column, a title and cells, in metres if its title names a unit of these."""
    title, *cells = column
    unit_m = FOOT_M if "(f" in title.lower() else 1.0
    return [decimal_of(f"a {title}", cell) * unit_m for cell in cells]
