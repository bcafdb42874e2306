"""No-fly zones from files: GeoJSON, KML and other vector files, and the geographical zones of ED-269 and ED-318."""

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError, finite
from jaxurban.io.read.ed269 import read_geozones
from jaxurban.io.read.heights import is_blank
from jaxurban.io.read.vector import open_layers
from jaxurban.io.read.zone import Told, Zone, warn, warn_of, whole_outline

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
