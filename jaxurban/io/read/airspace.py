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
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from pyproj import Geod

from jaxurban.errors import InputError, check_file, finite
from jaxurban.io.read.heights import is_blank
from jaxurban.io.read.vector import open_layers
from jaxurban.io.read.zone import DAY, Period, Told, Zone, warn, warn_of, whole_outline

# Properties that are read, in any case and with or without "_", "-", " " and ":". All are metres above ground.
FLOOR_NAMES = ("floor_m", "floor_m_agl", "lower_limit_m", "min_altitude_m", "minimumAltitude", "minAltitude")
CEILING_NAMES = ("ceiling_m", "ceiling_m_agl", "upper_limit_m", "max_altitude_m", "maximumAltitude", "maxAltitude")
NAME_NAMES = ("name", "title", "designator", "identifier", "id")
HEIGHT_WORDS = ("floor", "ceiling", "lower", "upper", "altitude", "height")
KML_PROPERTIES = ("altitudemode", "extrude")  # what GDAL calls these tags
# Properties that tell the unit or the zero of heights, by plain name: "uomDimensions", "lowerVerticalReference" ...
UNIT_NAME = re.compile(r"^(uom|units?)|(uom|units?|datum)$|(vertical|altitude|height|limit|lower|upper).*ref")
UNITS_READ = ("m", "metre", "metres", "meter", "meters", "agl", "sfc", "gnd", "ground", "surface", "abovegroundlevel")
ON_THE_GROUND = "relativetoground"
ROLE = "no-fly"
GEOZONE_SUFFIXES = (".json", ".geojson")
OPEN = "NO_RESTRICTION"  # a zone that tells, and closes nothing
ON_APPROVAL = ("REQ_AUTHORISATION", "REQ_AUTHORIZATION", "CONDITIONAL")
METRES = {"M": 1.0, "FT": 0.3048}
DAYS = ("MON", "TUE", "WED", "THU", "FRI", "SAT", "SUN")
MIDNIGHT = re.compile(r"(^|T)24:00(?=(:00)?[^:])")  # an end
NO_LIMITS = "have limits that are not metres or feet above ground, and reach on to every altitude there"
CORNERS = 64  # of a circle: with what follows its polygon is at most 0.3 % wider
WIDER = 1e-3  # of a circle's radius, for edges that are straight in degrees
MOST_M = 300_000.0  # radius of a circle whose edges are as good as straight in degrees
GEOD = Geod(ellps="WGS84")
Json = Mapping[str, Any]
BROKEN = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, shapely.errors.ShapelyError)
Facts = Mapping[str, tuple[str, Any]]  # a feature's filled properties: plain name -> name in the file, and value


def read_zones(path: str | Path) -> tuple[Zone, ...]:
    """Return the no-fly zones of a file: GeoJSON, KML, GeoPackage, Shapefile, FlatGeobuf, GeoParquet; ED-269, ED-318.

    A file of geographical zones of ED-269 or ED-318 is read as these say (`read_geozones`); of every other vector file
    every layer (every folder of a KML file) is read; features that are not polygons are left out with a warning.
    Floor and ceiling are the properties named in `FLOOR_NAMES` and `CEILING_NAMES`, metres above ground; where
    several are filled, the lowest floor and the highest ceiling count, and where all are empty, the zone has none.
    Other properties that sound like heights are ignored with a warning, and so are all heights of a zone one of
    whose properties tells another unit or another zero than the ground. In KML, an extruded polygon
    ``relativeToGround`` reaches from the ground to its highest corner, if every corner is above 0; any other
    ``altitudeMode`` closes all altitudes. Outlines that cross themselves are mended so that all they enclose
    is closed.

    Raises:
      InputError: a file that is missing, cannot be read, has no CRS or no polygon, a polygon without area, or
        a floor or ceiling that is not a number, or the wrong way round.
    """
    if Path(path).is_dir():
        raise InputError(f"{str(path)!r} is a folder: name each file of no-fly zones in it")
    if (geozones := read_geozones(path)) is not None:
        return geozones
    file = Path(path).name
    zones: list[Zone] = []
    told: Told = defaultdict(list)
    num_others = 0
    for frame in open_layers(path, ROLE):
        num_others += sum(not _is_all_area(shape) for shape in frame.geometry)
        areas = frame[shapely.get_dimensions(frame.geometry.to_numpy()) == 2]  # -1 where there is none
        crs = areas.crs.to_wkt()
        properties = areas.drop(columns=areas.geometry.name)
        _tell_ignored(properties, file)
        for shape, row in zip(areas.geometry, properties.to_dict("records"), strict=True):
            facts = {_plain(name): (str(name), value) for name, value in row.items() if not is_blank(value)}
            names = [str(facts[name][1]).strip() for name in NAME_NAMES if name in facts]
            name = next(iter(names), f"polygon {len(zones) + 1}")
            label = f"{name!r} of {file!r}"
            if not np.isfinite(shapely.get_coordinates(shape)).all():
                raise InputError(f"the no-fly zone {label} has a corner that is not a number: mend the file")
            whole = whole_outline(shapely.force_2d(shape), name, told, is_lonlat=areas.crs.is_geographic)
            zones.append(Zone(name, whole, crs, *_heights(facts, shape, label), file))
    warn_of(told, file)
    if not zones:
        raise InputError(f"the {ROLE} file {str(path)!r} holds no polygons: give a file of polygons")
    if num_others:
        warn(f"{num_others} feature(s) of {file!r} are not polygons and close nothing: draw them as polygons")
    return tuple(zones)


def _is_all_area(shape: shapely.Geometry | None) -> bool:
    return shape is not None and bool(np.all(shapely.get_dimensions(shapely.get_parts(shape)) == 2))


def _plain(name: object) -> str:
    """Return a property's name without case and separators."""
    return re.sub(r"[_\-\s:.]", "", str(name)).lower()


def _heights(facts: Facts, shape: shapely.Geometry, label: str) -> tuple[float, float]:
    """Return floor and ceiling of a polygon, infinite where it has none."""
    floors, ceilings = (
        [
            finite(f"{name} of the no-fly zone {label}", value, "metres above ground")
            for name, value in (facts[key] for key in map(_plain, wanted) if key in facts)
        ]
        for wanted in (FLOOR_NAMES, CEILING_NAMES)
    )
    if strange := (floors or ceilings) and _strange_unit(facts):
        warn(f"{label} has heights in {strange!r}, so it is closed at all altitudes: give metres above ground")
        floors = ceilings = []
    elif not floors and not ceilings:
        ceilings = _extruded(facts, shape, label)
    return min(floors, default=-np.inf), max(ceilings, default=np.inf)


def _tell_ignored(properties: pd.DataFrame, file: str) -> None:
    """Warn of filled properties that sound like heights and are not read."""
    read = {*map(_plain, FLOOR_NAMES), *map(_plain, CEILING_NAMES), *KML_PROPERTIES}
    ignored = [
        str(column)
        for column in properties
        if (name := _plain(column)) not in read
        and not UNIT_NAME.search(name)
        and any(word in name for word in HEIGHT_WORDS)
        and not all(map(is_blank, properties[column]))
    ]
    if ignored:
        warn(
            f"{', '.join(map(repr, ignored))} of {file!r} not read: floors and ceilings are {', '.join(FLOOR_NAMES)} "
            f"and {', '.join(CEILING_NAMES)}, metres above ground, and a zone without is closed at all altitudes"
        )


def _strange_unit(facts: Facts) -> str:
    """Return what a property says of units or zero levels other than metres and the ground, else ""."""
    said = (str(value) for name, (_, value) in facts.items() if UNIT_NAME.search(name))
    return next((text for text in said if _plain(text) not in UNITS_READ), "")


def _extruded(facts: Facts, shape: shapely.Geometry, label: str) -> list[float]:
    """Return the ceiling of a KML prism that stands on the ground, if the polygon is one."""
    corners_m = shapely.get_coordinates(shape, include_z=True)[:, 2]
    if not np.any(corners_m > 0) or "altitudemode" not in facts:  # not KML, or clamped to the ground
        return []
    is_extruded = "extrude" in facts and facts["extrude"][1] == 1
    if _plain(facts["altitudemode"][1]) == ON_THE_GROUND and is_extruded and np.all(corners_m > 0):
        return [float(corners_m.max())]
    warn(
        f"{label} is closed at all altitudes: of KML's heights only those of polygons that are extruded "
        "and relativeToGround are read"
    )
    return []


def read_geozones(path: str | Path) -> tuple[Zone, ...] | None:
    """Return the zones of a file of ED-269 or ED-318; None where it is another.

    Closed are zones of every restriction but ``NO_RESTRICTION``; those that hold on conditions or until someone
    authorises a flight too, which a warning says. Circles become polygons around them. Limits above the ground are read
    in metres and feet; one above the sea or the ellipsoid is none, since the ground's height is not known here, so that
    the zone reaches on to every altitude at that end. Times are kept as `Period`; where one cannot be read, as sunrise,
    the zone is taken to be in force on each of its days, or always.

    Raises:
      InputError: a zone without an outline that can be read, without area or with limits that are no numbers or the
        wrong way round, or no zone at all.
    """
    features = _features(Path(path))
    if features is None:
        return None
    file, zones = Path(path).name, []
    told: Told = defaultdict(list)
    for number, feature in enumerate(features, start=1):
        facts = feature["properties"] if isinstance(feature.get("properties"), dict) else feature
        name = _name(facts, number)
        restriction = str(facts.get("restriction", facts.get("type", ""))).upper()
        if restriction == OPEN:
            told["restrict nothing, and are left out"].append(name)
            continue
        if restriction in ON_APPROVAL:
            told["need an authorisation or hold on conditions, and are closed"].append(name)
        label = f"{name!r} of {file!r}"
        periods = _periods(facts, name, told)
        for volume, shape in _volumes(feature, label):
            floor_m, ceiling_m = _limits(volume, label, name, told)
            shape = whole_outline(shape, name, told, is_lonlat=True)
            zones.append(Zone(name, shape, "EPSG:4326", floor_m, ceiling_m, file, periods))
    warn_of(told, file)
    if not zones:
        raise InputError(f"the no-fly file {str(path)!r} holds no zone that restricts flights: give another file")
    return tuple(zones)


def _features(path: Path) -> list[Json] | None:
    """Return the zones of a file, None where it is no file of ED-269 or ED-318."""
    if path.suffix.lower() not in GEOZONE_SUFFIXES:
        return None
    try:
        check_file(path)
        whole = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return None  # the reader of vector files says what is wrong with it
    listed = whole.get("features", whole.get("UASZoneList")) if isinstance(whole, dict) else None
    if not isinstance(listed, list) or not all(isinstance(feature, dict) for feature in listed):
        return None
    return listed if any(map(_is_geozone, listed)) else None


def _is_geozone(feature: Json) -> bool:
    geometry, facts = feature.get("geometry"), feature.get("properties")
    if isinstance(geometry, list):
        return any(isinstance(volume, dict) and "horizontalProjection" in volume for volume in geometry)
    if not isinstance(facts, dict) or not isinstance(geometry, dict):
        return False
    return "limitedApplicability" in facts or any("layer" in part or "extent" in part for part in _parts(geometry))


def _name(facts: Json, number: int) -> str:
    """Return a zone's name, in ED-318 a list of texts, or its identifier."""
    name = facts.get("name")
    if isinstance(name, list):
        name = next((text.get("text") for text in name if isinstance(text, dict) and text.get("text")), None)
    return str(name or facts.get("identifier") or f"zone {number}").strip()


def _parts(geometry: Json) -> list[Json]:
    """Return the geometries of one of GeoJSON, those of a collection one by one."""
    parts = geometry.get("geometries") if geometry.get("type") == "GeometryCollection" else [geometry]
    return [part for part in parts if isinstance(part, dict)] if isinstance(parts, list) else []


def _volumes(feature: Json, label: str) -> Iterator[tuple[Json, shapely.Geometry]]:
    """Yield the limits of each volume of a zone, and its outline in longitude and latitude.

    Raises:
      InputError: an outline that is none.
    """
    geometry = feature.get("geometry")
    ed269 = isinstance(geometry, list)
    volumes = geometry if isinstance(geometry, list) else _parts(geometry) if isinstance(geometry, dict) else []
    if not volumes:
        raise InputError(f"the no-fly zone {label} has no geometry: mend the file")
    for volume in volumes:
        try:
            limits = volume if ed269 else {**(volume.get("layer") or {})}
            yield limits, _outline(volume["horizontalProjection"] if ed269 else volume, limits)
        except BROKEN as error:
            why = str(error) if isinstance(error, ValueError) else "a part is missing, or is of another kind"
            raise InputError(f"the outline of the no-fly zone {label} cannot be read ({why}): mend the file") from error


def _outline(shape: Json, limits: Json) -> shapely.Geometry:
    """Return the outline of a projection of ED-269, or of a geometry of ED-318."""
    kind = str(shape["type"]).lower()
    if kind == "circle":
        return _circle(shape["center"], float(shape["radius"]) * METRES[str(limits["uomDimensions"]).upper()])
    if kind == "point":
        return _circle(shape["coordinates"], float(shape["extent"]["radius"]))  # in metres, whatever its layer
    polygons = shape["coordinates"] if kind == "multipolygon" else [shape["coordinates"]]
    rings = [[[_place(corner) for corner in ring] for ring in polygon] for polygon in polygons]
    shapes = [shapely.Polygon(shell, holes) for shell, *holes in rings]
    return shapes[0] if len(shapes) == 1 else shapely.union_all(shapes)


def _place(corner: Sequence[Any]) -> tuple[float, float]:
    """Return longitude and latitude.

    Raises:
      ValueError: they are none.
    """
    lon, lat = float(corner[0]), float(corner[1])
    if not (-180 <= lon <= 180 and -90 <= lat <= 90):
        raise ValueError(f"{lon:g}, {lat:g} is no longitude and latitude")
    return lon, lat


def _circle(centre: Sequence[Any], radius_m: float) -> shapely.Geometry:
    """Return a polygon that holds all of a circle: its edges touch one that is a little wider."""
    lon, lat = _place(centre)
    if not 0 < radius_m <= MOST_M or abs(lat) > 85:
        raise ValueError(f"a circle of {radius_m:g} m around {lon:g}, {lat:g}: at most {MOST_M:g} m, not at a pole")
    azimuth_deg = np.arange(CORNERS) * (360 / CORNERS)
    away_m = np.full(CORNERS, radius_m * (1 + WIDER) / math.cos(math.pi / CORNERS))
    lons, lats, _ = GEOD.fwd(np.full(CORNERS, lon), np.full(CORNERS, lat), azimuth_deg, away_m)
    around = lon + (lons - lon + 180) % 360 - 180  # in one piece where it lies across the antimeridian
    return shapely.Polygon(np.column_stack([around, lats]))


def _limits(volume: Json, label: str, name: str, told: Told) -> tuple[float, float]:
    """Return floor and ceiling of a volume in metres above ground, infinite where it has none that can be used."""
    is_ed269 = "uomDimensions" in volume or "lowerLimit" in volume or "upperLimit" in volume
    keys = ("Limit", "VerticalReference") if is_ed269 else ("", "Reference")
    unit = METRES.get(str(volume.get("uomDimensions", volume.get("uom", ""))).upper())
    limits = []
    for end, none in (("lower", -math.inf), ("upper", math.inf)):
        value, zero = volume.get(f"{end}{keys[0]}"), str(volume.get(f"{end}{keys[1]}") or "").upper()
        if value is None:
            limits.append(none)
        elif zero != "AGL" or unit is None:
            told[NO_LIMITS].append(name)
            limits.append(none)
        else:
            limits.append(finite(f"the {end} limit of the no-fly zone {label}", value, "metres or feet") * unit)
    return limits[0], limits[1]


def _periods(facts: Json, name: str, told: Told) -> tuple[Period, ...]:
    """Return when a zone is in force, nothing for always."""
    given = facts.get("applicability", facts.get("limitedApplicability"))
    periods: list[Period] = []
    for when in given if isinstance(given, list) else [given]:
        if not isinstance(when, dict) or str(when.get("permanent", "NO")).upper() == "YES":
            return ()
        try:
            start, end = (_time(when.get(key)) for key in ("startDateTime", "endDateTime"))
            schedule = when.get("schedule") or []
            periods += [Period(start, end, *_days(daily)) for daily in schedule] or [Period(start, end)]
        except (ValueError, TypeError, AttributeError, KeyError):
            told["have times that cannot be read, and are taken to be in force always"].append(name)
            return ()
    return tuple(periods)


def _time(text: str | None) -> datetime | None:
    """Return a date and time with its offset.

    Raises:
      ValueError: it is none, or has no offset.
    """
    if text is None:
        return None
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError("no offset")
    return moment


def _days(daily: Json) -> tuple[frozenset[int], tuple[timedelta, timedelta] | None]:
    """Return the days and hours of a schedule; hours told by the sun as those of the whole day before, at and after."""
    given = daily.get("day") or ["ANY"]
    names = [str(day).upper() for day in (given if isinstance(given, list) else [given])]
    days = frozenset() if "ANY" in names else frozenset(DAYS.index(day) for day in names)
    if daily.get("startEvent") or daily.get("endEvent"):
        return days, (-DAY / 2, DAY + DAY / 2)  # sunrise and the like, in whatever part of the world
    if daily.get("startTime") is None and daily.get("endTime") is None:
        return days, None
    return days, (_clock(daily["startTime"]), _clock(MIDNIGHT.sub(r"\g<1>00:00", str(daily["endTime"]))))


def _clock(text: str) -> timedelta:
    """Return a time of day as time after midnight UTC.

    Raises:
      ValueError: it is none, or has no offset.
    """
    clock = time.fromisoformat(str(text).strip().rpartition("T")[2])
    if (offset := clock.utcoffset()) is None:
        raise ValueError("no offset")
    return timedelta(hours=clock.hour, minutes=clock.minute, seconds=clock.second) - offset
