"""No-fly zones from files: GeoJSON, KML and other vector files, and the geographical zones of ED-269 and ED-318.

ED-269 ("Minimum Operational Performance Standard for Geofencing", 2020): an object whose ``features`` (in some files
``UASZoneList``) are zones with a ``restriction``, an ``applicability`` in time, and in ``geometry`` one volume or
several, each with limits in ``uomDimensions`` (M or FT) above ``AGL`` or ``AMSL`` and a ``horizontalProjection``, a
Polygon or a Circle. ED-318 (2024): GeoJSON whose properties hold ``type`` and ``limitedApplicability``, and whose
geometries hold a ``layer`` (limits) and, for a circle around a Point, an ``extent``.

In doubt a zone is closed higher, lower, wider and longer than it may be meant, never less, and a warning says so.
`uas-standards` 4.4 would refuse a whole file for one zone without a country, with hours of sunrise or with heights
above the ellipsoid, and cut a ceiling of 36.5 m to 36.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyogrio
import shapely

from jaxurban import wings
from jaxurban.checks import finite
from jaxurban.errors import IgnoredZoneWarning, InputError, readable, warn
from jaxurban.flights.missions.parts import GEOD, circle_around
from jaxurban.io.broken import BROKEN
from jaxurban.io.sniff import FLOWN, HEAD_BYTES, in_own_words, sniff, unpacked
from jaxurban.io.tables import is_blank
from jaxurban.io.zone import TURN, Zone, made_valid
from jaxurban.public import listed

# Properties that are read, in any case and with or without "_", "-", " " and ":". All are metres above ground.
FLOOR_NAMES = (
    "floor_m",
    "floor_m_agl",
    "lower_limit_m",
    "min_altitude_m",
    "minimumAltitude",
    "minAltitude",
)
CEILING_NAMES = (
    "ceiling_m",
    "ceiling_m_agl",
    "upper_limit_m",
    "max_altitude_m",
    "maximumAltitude",
    "maxAltitude",
)
NAME_NAMES = ("name", "title", "designator", "identifier", "id")
# By plain name: properties of heights, of their unit or zero ("uomDimensions", "lowerVerticalReference" ...), units and
# zeros that are read, and properties of what is closed around a polygon.
HEIGHT_NAME = re.compile("floor|ceiling|lower|upper|altitude|height")
UNIT_NAME = re.compile(
    r"^(uom|units?)|(uom|units?|datum)$|(vertical|altitude|height|limit|lower|upper).*ref"
)
UNIT_READ = re.compile("m|met(re|er)s?|agl|sfc|gnd|ground|surface|abovegroundlevel")
# Values, and names, of another unit or another zero, under whatever name they stand.
OTHER_UNIT = re.compile(
    r"(a?msl|ft|feet|foot|fl|std|qnh|qfe|pressure|wgs84|hae|ellipsoid(al)?|nhn|nn|navd88|egm\d*|absolute)\d*"
)
BUFFER_NAME = re.compile(
    "buffer|puffer|margin|offset|expand|setback|safetydistance|standoff|clearance|tampon|abstand|padding|"
    "inflat|dilat|separation|keepout"
)
RADIUS_NAME = re.compile("radius(m|km|nm|ft)?")
RADIUS_UNITS_M = np.array([1.0, 1000.0, 1852.0, 0.3048])
DRAWN = 0.1  # a polygon is drawn as wide as its radius says, but for so much
ROLE = "no-fly"
GEOZONE_FORMATS = (".geojson", ".geojsonl")  # of `sniff`
GEOZONE = re.compile(
    rb'"(horizontalProjection|limitedApplicability|(lower|upper)Reference)"|"extent"\s*:\s*\{'
)
OF_HEIGHTS = re.compile("|".join(FLOOR_NAMES + CEILING_NAMES).encode(), re.IGNORECASE)
OPEN = "NO_RESTRICTION"  # a zone that informs, and closes nothing
ON_APPROVAL = {"REQ_AUTHORISATION", "REQ_AUTHORIZATION", "CONDITIONAL"}
CLOSED = {"PROHIBITED"} | ON_APPROVAL
METRES = {"M": 1.0, "FT": 0.3048}
CORNERS = 64  # of a circle: with what follows its polygon is at most 0.3 % wider
WIDER = 1e-3  # of a circle's radius, for edges that are straight in degrees
MOST_M = 300_000.0  # radius of a circle whose edges are as good as straight in degrees
NOWHERE = shapely.Polygon()
# What is true of a zone, and what is said of it as it is read.
REMARKS = {
    "no_area": "are points, lines, collections or empty, so that what they close is not known (draw them as polygons)",
    "not_read": "are not read, so that what they close is not known (write each as a feature of its own)",
    "buffer": "name a buffer, which is not read, so that what they close around it is not known (draw it too)",
    "no_restriction": "restrict nothing, and are left out",
    "on_approval": "need an authorisation or hold on conditions, and are closed",
    "limits": "have limits in a unit or above a zero that is not read, and reach on to every altitude there "
    "(give metres above ground)",
    "hours": "have days or hours, which are not read, and are closed from their first to their last time",
    "times": "have times that cannot be read or end before they begin, and are taken to be in force always",
    "crossing": "have outlines that cross themselves, and close all that these enclose",
    "all_around": "have edges of more than 180 degrees of longitude, and are closed all around the Earth (cut them at "
    "the antimeridian)",
}
# One for each feature of GeoJSON or KML, and one for each list of coordinates. GDAL passes over what is not where it
# belongs, or in another file, and reads one shape of a Placemark, and one outer ring of a Polygon.
FEATURE = re.compile(
    rb'"type"\s*:\s*"Feature"|<(?:[\w.-]+:)?(?:Placemark|GroundOverlay|PhotoOverlay|NetworkLink)\b'
)
OUTLINE = re.compile(rb'"coordinates"\s*:\s*\[|<(?:[\w.-]+:)?(?:coordinates|Track|LatLonBox)\b')
CIRCLE = re.compile(rb'"type"\s*:\s*"circle"', re.IGNORECASE)  # of ED-269
MODEL, SQLITE = b"<Model", b"SQLite format 3"
SHAPE_NAMES = ("geometry", "geometries", "geom", "wkt", "wkb", "shape")
Json = Mapping[str, Any]
Remarks = list[str]  # of one zone, keys of `REMARKS`


def is_of_zones(path: Path) -> bool:
    """Return whether a file begins as one of zones, which other outlines do not: by names of limits that are read."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return bool(GEOZONE.search(head) or OF_HEIGHTS.search(head))


def read_zones(path: str | Path) -> tuple[Zone, ...]:
    """Return the no-fly zones of a file: GeoJSON, KML, GeoPackage, Shapefile, FlatGeobuf, GeoParquet; ED-269, ED-318.

    Everything that the file holds is in them: a zone that is not closed is open, as the file says, or unknown.

    Of a vector file every layer (every folder of a KML file) is read; what is no polygon is an unknown zone. Floor and
    ceiling are the properties named in `FLOOR_NAMES` and `CEILING_NAMES`, metres above ground; where several are
    filled, the lowest floor and the highest ceiling count, and where all are empty, the zone has none. All heights of a
    zone are ignored with a warning where another property sounds like one, or names another unit or another zero than
    the ground. Heights of corners are not read.

    Of ED-269 and ED-318 zones of every restriction but ``NO_RESTRICTION`` are closed; those that hold on conditions or
    until someone authorises a flight too, which a warning says. Circles become polygons around them. Limits above the
    ground are read in metres and feet; one above the sea or the ellipsoid is none, since the ground's height is not
    known here, so that the zone reaches on to every altitude at that end. A zone is in force from the first to the last
    of its times, on every day and at every hour between them, and always where one cannot be read.

    Outlines that cross themselves are repaired so that all they enclose is closed.

    Raises:
      InputError: a file that is missing, cannot be read, has no CRS or no zone that restricts flights, an outline that
        cannot be read or has no area, or a floor or ceiling that is not a number, or the wrong way round.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{str(path)!r} is a folder: name each file of no-fly zones in it")
    kind = sniff(path)
    if kind in FLOWN:
        raise InputError(
            f"{str(path)!r} is a mission, and no file of zones: name one of polygons, in GeoJSON or KML"
        )
    with readable(path, "a file of zones", "fetch it again"), unpacked(path) as plain:
        content = plain.read_bytes()
    features = _geozones(content) if kind in GEOZONE_FORMATS else None
    if features is None:
        zones = _of_vector_file(path, content, kind)
    else:
        zones = _of_geozones(features, path.name)
        read = json.dumps([feature.get("geometry") for feature in features]).encode()
        num_more = sum(
            len(outline.findall(content)) - len(outline.findall(read))
            for outline in (OUTLINE, CIRCLE)
        )
        zones += _not_read(num_more, path.name)

    for remark, sentence in REMARKS.items():
        labels = list(dict.fromkeys(repr(zone.name) for zone in zones if remark in zone.remarks))
        if labels:
            what = f"zones of {path.name!r} that {sentence}: {len(labels)} ({listed(labels)})"
            warn(what, IgnoredZoneWarning)
    if all(zone.state != "closed" for zone in zones):
        raise InputError(
            f"the {ROLE} file {str(path)!r} holds no polygons that restrict flights: draw a polygon around what "
            "is closed, or leave the file out"
        )
    return tuple(zones)


def _of_vector_file(path: Path, content: bytes, kind: str) -> list[Zone]:
    """Return the zones of a file that GDAL or pyarrow reads: of each feature its polygons, and if there is more, that.

    What GDAL passes over in silence is one unknown zone.

    Args:
      path: of the file.
      content: its bytes, unpacked.
      kind: its format (`sniff`).

    Warns:
      IgnoredZoneWarning: properties of heights that are not read.

    Raises:
      InputError: a file that cannot be read, or a zone with an invalid corner, floor or ceiling.
    """
    file = path.name
    if MODEL in content:
        raise InputError(
            f"the {ROLE} file {str(path)!r} holds a model in three dimensions, which GDAL cannot read: draw a polygon "
            "around it instead"
        )
    zones: list[Zone] = []
    num_read = num_outlines = num_beside = 0
    for frame in wings.open_layers(path, ROLE):
        crs = frame.crs.to_wkt()
        properties = frame.drop(columns=frame.geometry.name)
        _warn_of_ignored(properties, file)
        num_beside += sum(_num_shapes(*column) for column in properties.items())
        num_outlines += _num_outlines(frame.geometry.to_numpy(), kind)

        # Of each row: its filled properties by plain name, its own name, its shape and its heights.
        for row in frame.to_dict("records"):
            shape = row.pop(frame.geometry.name)
            num_read += 1
            facts = {_plain(name): value for name, value in row.items() if not is_blank(value)}
            name = _name(facts, f"feature {num_read}")
            if not np.isfinite(shapely.get_coordinates(shape)).all():
                raise InputError(
                    f"the no-fly zone {name!r} of {file!r} has a corner that is not a number: mend it"
                )
            remarks: Remarks = []
            limits_m = _heights(facts, f"{name!r} of {file!r}", remarks)
            shape = shapely.force_2d(shape or NOWHERE)
            if shapely.get_dimensions(shape) == 2 and not shape.is_empty:
                whole = _whole(shape, remarks, is_lonlat=frame.crs.is_geographic)
                zones.append(Zone(name, whole, crs, *limits_m, file, remarks=tuple(remarks)))
            why = ""
            if shape.is_empty or "Polygon" not in shape.geom_type:
                why = "no_area"
            elif _is_wider(facts, shape, frame.crs.is_geographic):
                why = "buffer"
            if why:
                zones.append(
                    Zone(name, shape, crs, *limits_m, file, state="unknown", remarks=(why,))
                )

    num_more = len(OUTLINE.findall(content)) - num_outlines
    num_lost = max(num_beside, num_more, _num_features(content) - num_read)
    return zones + _not_read(num_lost + _num_without_shape(content), file)


def _not_read(num: int, file: str) -> list[Zone]:
    """Return a zone that stands for so many things of a file, none without one."""
    zone = Zone(f"{num} more", NOWHERE, source=file, state="unknown", remarks=("not_read",))
    return [zone] if num > 0 else []


def _num_features(content: bytes) -> int:
    """Return how many features a file of GeoJSON or KML holds, 0 of any other file."""
    num = len(FEATURE.findall(content))
    with suppress(*BROKEN, RecursionError):
        num = max(num, len(json.loads(content)["features"]))  # what is no feature among them
    return num


def _num_outlines(shapes: np.ndarray, kind: str) -> int:
    """Return how many lists of coordinates the shapes of a file were read from: one of each ring in KML.

    In GeoJSON a shape of several parts has one, and each shape of a collection its own.
    """
    is_one = shapely.get_type_id(shapes) != shapely.GeometryType.GEOMETRYCOLLECTION
    is_one &= kind != ".kml"
    parts = shapely.get_parts(shapely.get_parts(shapes[~is_one]))
    return int(is_one.sum() + len(parts) + shapely.get_num_interior_rings(parts).sum())


def _num_shapes(name: object, values: pd.Series) -> int:
    """Return how many shapes a column beside the geometry holds; bytes were read as text."""
    is_named = _plain(name) in SHAPE_NAMES
    holds_them = values.dtype == "geometry" or values.astype(str).str.startswith("\"b'").any()
    return values.count() if is_named or holds_them else 0


def _num_without_shape(content: bytes) -> int:
    """Return how many rows a GeoPackage holds in tables without shapes, but for the styles of QGIS."""
    if not content.startswith(SQLITE):
        return 0
    with in_own_words():  # of what has no name, as its name does not end as it should
        names = [name for name, shapes in pyogrio.list_layers(content) if shapes is None]
        tables = [name for name in names if name != "layer_styles"]
        return sum(pyogrio.read_info(content, layer=name)["features"] for name in tables)


def _plain(name: object) -> str:
    """Return a property's name without case and separators."""
    return re.sub(r"[_\-\s:.]", "", str(name)).lower()


def _heights(facts: Json, label: str, remarks: Remarks) -> tuple[float, float]:
    """Return floor and ceiling of a polygon in metres above ground, infinite where it has none.

    Of several floors the lowest counts, of several ceilings the highest. Where a property sounds like a height and is
    not read, or names another unit or another zero than the ground, both are infinite.

    Args:
      facts: its filled properties by plain name.
      label: its name and file, for messages.
      remarks: get that a property of a height is not read.

    Raises:
      InputError: a height that is not a number.
    """
    floors_m, ceilings_m = (
        [
            finite(f"{name} of the no-fly zone {label}", facts[_plain(name)], "metres above ground")
            for name in names
            if _plain(name) in facts
        ]
        for names in (FLOOR_NAMES, CEILING_NAMES)
    )
    if (floors_m or ceilings_m) and _has_other_unit(facts):
        remarks.append("limits")
        return -math.inf, math.inf
    if any(map(_is_ignored, facts)):
        remarks.append("other_limits")  # of which `_warn_of_ignored` says more
        return -math.inf, math.inf
    return min(floors_m, default=-math.inf), max(ceilings_m, default=math.inf)


def _has_other_unit(facts: Json) -> bool:
    """Return whether a property of a polygon, by plain name, names another unit or another zero than it is read in."""
    for name, value in facts.items():
        text = _plain(value)
        if UNIT_NAME.search(name) and not UNIT_READ.fullmatch(text):
            return True
        is_name = name in map(_plain, NAME_NAMES)
        if not is_name and (OTHER_UNIT.fullmatch(text) or OTHER_UNIT.fullmatch(name)):
            return True
    return False


def _is_wider(facts: Json, shape: shapely.Geometry, is_lonlat: bool) -> bool:
    """Return whether a polygon closes more than it draws: by a buffer, or by a radius that it is not drawn with.

    Args:
      facts: its properties by plain name.
      shape: the polygon.
      is_lonlat: whether coordinates are longitude and latitude in degrees, else metres.
    """
    if any(map(BUFFER_NAME.search, facts)):
        return True
    radii = [value for name, value in facts.items() if RADIUS_NAME.fullmatch(name)]
    if not radii:
        return False
    x, y = shapely.get_coordinates(shape).T
    if is_lonlat:
        centre = shapely.centroid(shape)
        _, _, away_m = GEOD.inv(np.full_like(x, centre.x), np.full_like(y, centre.y), x, y)
    else:
        away_m = shapely.distance(shapely.centroid(shape), shapely.points(x, y))
    drawn_m = np.max(away_m)
    for radius in pd.to_numeric(pd.Series(radii), errors="coerce"):
        is_drawn = np.abs(radius * RADIUS_UNITS_M - drawn_m) <= DRAWN * drawn_m
        if not is_drawn.any():
            return True
    return False


def _warn_of_ignored(properties: pd.DataFrame, file: str) -> None:
    """Warn of properties of the zones of a file that sound like heights, are filled in some row and are not read."""
    filled = [name for name in properties if not all(map(is_blank, properties[name]))]
    ignored = [repr(name) for name in filled if _is_ignored(_plain(name))]
    if ignored:
        warn(
            f"{', '.join(ignored)} of {file!r} not read: floors and ceilings are {', '.join(FLOOR_NAMES)} "
            f"and {', '.join(CEILING_NAMES)}, metres above ground, and a zone with others, or without, is closed at "
            "all altitudes",
            IgnoredZoneWarning,
        )


def _is_ignored(name: str) -> bool:
    """Return whether a property, by its plain name, sounds like a height and is not read."""
    is_height = HEIGHT_NAME.search(name) and not UNIT_NAME.search(name)
    return bool(is_height) and name not in map(_plain, FLOOR_NAMES + CEILING_NAMES)


def _of_geozones(features: Sequence[Json], file: str) -> list[Zone]:
    """Return the zones of a file of ED-269 or ED-318: one for each volume of each feature, or for one that is open.

    Args:
      features: as JSON holds them.
      file: its name.

    Raises:
      InputError: an outline that cannot be read, or a limit that is not a number.
    """
    zones = []
    for number, feature in enumerate(features, start=1):
        facts = feature["properties"] if isinstance(feature.get("properties"), dict) else feature
        name = _name(facts, f"zone {number}")
        restrictions = {str(facts.get(key)).upper() for key in ("restriction", "type")}
        if OPEN in restrictions and restrictions.isdisjoint(CLOSED):
            zones.append(
                Zone(name, NOWHERE, source=file, state="open", remarks=("no_restriction",))
            )
            continue
        of_feature: Remarks = [] if restrictions.isdisjoint(ON_APPROVAL) else ["on_approval"]
        start, end = _times(facts, of_feature)

        # The volumes of the zone: limits and outline of each.
        label = f"{name!r} of {file!r}"
        try:
            geometry = feature["geometry"]
            if isinstance(geometry, list):  # ED-269
                shapes = [{**part["horizontalProjection"], "layer": part} for part in geometry]
            else:
                is_whole = geometry["type"] != "GeometryCollection"
                parts = [geometry] if is_whole else geometry["geometries"]
                shapes = [{"layer": None, **part} for part in parts]
            if not shapes:
                raise ValueError("it has no volume")
            if not all(isinstance(shape["layer"], dict | None) for shape in shapes):
                raise ValueError("its layer is no object")
            volumes = [(shape["layer"] or {}, _outline(shape)) for shape in shapes]
            is_wider = any(
                str(shape["type"]).lower() != "point" and "extent" in shape for shape in shapes
            )
        except BROKEN as error:
            is_said = isinstance(error, ValueError)
            why = str(error) if is_said else "a part is missing, or is of another kind"
            raise InputError(
                f"the outline of the no-fly zone {label} cannot be read ({why}): mend the file"
            ) from error

        layers = [layer for layer, _ in volumes]
        for layer, outline in volumes:
            remarks = [*of_feature]
            whole = _whole(outline, remarks, is_lonlat=True)
            limits_m = _limits(layer, label, remarks)
            once = tuple(dict.fromkeys(remarks))
            zones.append(Zone(name, whole, "EPSG:4326", *limits_m, file, start, end, remarks=once))
        names = [_plain(key) for part in (feature, facts, *shapes, *layers) for key in part]
        if is_wider or any(map(BUFFER_NAME.search, names)):
            zones.append(Zone(name, NOWHERE, source=file, state="unknown", remarks=("buffer",)))
    return zones


def _geozones(content: bytes) -> list[Json] | None:
    """Return the features of a file of ED-269 or ED-318 as JSON holds them, None of any other file.

    Such a file is JSON, and known by the words that only these formats have; one that cannot be read is left to
    the reader of vector files.
    """
    try:
        whole = json.loads(content) if GEOZONE.search(content) else {}
        features = [*whole.get("features", ()), *whole.get("UASZoneList", ())]
    except (ValueError, RecursionError, AttributeError, TypeError):
        return None  # the reader of vector files says what is wrong with it
    is_listed = features and all(isinstance(feature, dict) for feature in features)
    return features if is_listed else None


def _name(facts: Json, other: str) -> str:
    """Return a zone's name by the first of `NAME_NAMES` that is filled, else another one.

    In ED-318 the name is a list of objects with texts in several languages, of which the first counts.
    """
    for key in NAME_NAMES:
        name = facts.get(key)
        if isinstance(name, list):
            texts = (item.get("text") for item in name if isinstance(item, dict))
            name = next(filter(None, texts), None)
        if not is_blank(name):
            return str(name).strip()
    return other


def _outline(shape: Json) -> shapely.Geometry:
    """Return the outline of a volume in longitude and latitude: polygons, or one around a circle.

    The volume is a geometry of ED-318 with its ``layer``, or is made to be like one.

    Raises:
      An error of `BROKEN`: a part is missing, is of another kind or is no place on the Earth.
    """
    kind = str(shape["type"]).lower()
    if kind == "circle":  # of ED-269
        unit_m = METRES[str(shape["layer"]["uomDimensions"]).upper()]
        return _circle(shape["center"], float(shape["radius"]) * unit_m)
    if kind == "point":
        # In metres, whatever the unit of its layer.
        return _circle(shape["coordinates"], float(shape["extent"]["radius"]))
    polygons = shape["coordinates"] if kind == "multipolygon" else [shape["coordinates"]]
    parts = []
    for polygon in polygons:
        shell, *holes = [list(map(_place, ring)) for ring in polygon]
        parts.append(shapely.Polygon(shell, holes))
    return shapely.union_all(parts)


def _place(corner: Sequence[Any]) -> tuple[float, float]:
    """Return longitude and latitude.

    Raises:
      ValueError: they are none.
    """
    lon = float(corner[0])
    lat = float(corner[1])
    if not (-180 <= lon <= 180 and -90 <= lat <= 90):
        raise ValueError(f"{lon:g}, {lat:g} is no longitude and latitude")
    return lon, lat


def _circle(centre: Sequence[Any], radius_m: float) -> shapely.Geometry:
    """Return a polygon in longitude and latitude that holds all of a circle; its longitudes may pass 180 degrees.

    The edges touch a circle that is wider by `WIDER`, as they are straight in degrees and the Earth is not.

    Args:
      centre: longitude and latitude in degrees.
      radius_m: up to `MOST_M`.

    Raises:
      ValueError: another radius, no place, or a pole too near.
    """
    lon, lat = _place(centre)
    if not 0 < radius_m <= MOST_M or abs(lat) > 85:
        raise ValueError(
            f"a circle of {radius_m:g} m around {lon:g}, {lat:g}: at most {MOST_M:g} m, not at a pole"
        )
    azimuth_deg = np.arange(CORNERS) * (360 / CORNERS)
    away_m = radius_m * (1 + WIDER) / math.cos(math.pi / CORNERS)
    lons, lats = circle_around(lon, lat, away_m, azimuth_deg)
    # In one piece where it lies across the antimeridian.
    around = lon + (lons - lon + 180) % 360 - 180
    return shapely.Polygon(np.column_stack([around, lats]))


def _limits(layer: Json, label: str, remarks: Remarks) -> tuple[float, float]:
    """Return floor and ceiling of a volume in metres above ground, infinite where it has none that can be used.

    Args:
      layer: the limits, under the keys of ED-269 or ED-318.
      label: name and file of the zone, for messages.
      remarks: get that a limit is not above ground, or in an unknown unit.

    Raises:
      InputError: a limit above ground that is not a number.
    """
    units = _words(layer, "uomDimensions", "uom")
    unit_m = METRES.get(units.pop()) if len(units) == 1 else None
    limits_m = {"lower": -math.inf, "upper": math.inf}
    for end in limits_m:
        keys = [key for key in (f"{end}Limit", end) if layer.get(key) is not None]
        if not keys:
            continue
        zeros = _words(layer, f"{end}VerticalReference", f"{end}Reference")
        if zeros != {"AGL"} or unit_m is None or len(keys) > 1:
            remarks.append("limits")
            continue
        what = f"the {end} limit of the no-fly zone {label}"
        limits_m[end] = finite(what, layer[keys[0]], "metres or feet") * unit_m
    return limits_m["lower"], limits_m["upper"]


def _words(facts: Json, *keys: str) -> set[str]:
    """Return the different words, in capitals, that stand under some keys."""
    return {str(facts[key]).upper() for key in keys if key in facts}


def _times(facts: Json, remarks: Remarks) -> tuple[datetime | None, datetime | None]:
    """Return the first and the last time at which a zone is in force, None for an end that is open.

    Both are None where a period is permanent, where there is no period, and where a time cannot be read.

    Args:
      facts: of the zone, under the keys of ED-269 or ED-318.
      remarks: get that times cannot be read, or that periods have days or hours.
    """
    periods = [
        period
        for key in ("applicability", "limitedApplicability")
        for period in facts.get(key) or ()
    ]
    try:
        permanent = {str(period.get("permanent")).upper() for period in periods}
        if not periods or permanent & {"YES", "TRUE"}:
            return None, None
        starts = [_time(period.get("startDateTime")) for period in periods]
        ends = [_time(period.get("endDateTime")) for period in periods]
        for begin, stop in zip(starts, ends, strict=True):
            if begin and stop and stop < begin:
                raise ValueError("it ends before it begins")
    except BROKEN:
        remarks.append("times")
        return None, None
    if any(period.get("schedule") for period in periods):
        remarks.append("hours")
    start = None if None in starts else min(filter(None, starts))
    end = None if None in ends else max(filter(None, ends))
    return start, end


def _time(text: str | None) -> datetime | None:
    """Return the date and time that a text of ISO 8601 names, None without a text.

    Raises:
      ValueError: it is no date and time, or has no offset from UTC.
    """
    if not text:
        return None
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError("no offset")
    return moment


def _whole(shape: shapely.Geometry, remarks: Remarks, *, is_lonlat: bool) -> shapely.Geometry:
    """Return valid polygons that close all that the outline of a zone may mean.

    A file may mean by an edge from 179.9 to -179.9 degrees what lies between them across the antimeridian, or all the
    rest of the way round: such a zone is closed all around the Earth. An edge that goes all the way round has but one
    meaning.

    Args:
      shape: the outline.
      remarks: get why more is closed than the outline draws.
      is_lonlat: whether coordinates are longitude and latitude in degrees.
    """
    # Outlines that cross themselves.
    if not shape.is_valid or shape.geom_type not in ("Polygon", "MultiPolygon"):
        polygons = made_valid(shape)
        if not shape.is_valid and not polygons.is_empty:
            remarks.append("crossing")
        shape = polygons

    # Edges that may lie across the antimeridian: how many degrees of longitude each edge of an outer ring spans.
    rings = [shapely.get_coordinates(part.exterior)[:, 0] for part in shapely.get_parts(shape)]
    spans = np.concatenate([np.abs(np.diff(lon)) for lon in rings] or [[]])
    if is_lonlat and np.any((spans > TURN / 2) & (spans < TURN)):
        remarks.append("all_around")
        _, south, _, north = shape.bounds
        shape = shapely.box(-TURN / 2, south, TURN / 2, north)
    return shape
