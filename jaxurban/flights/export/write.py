"""Planned paths as files for other programs: the format is chosen by the file's suffix.

GeoJSON (RFC 7946): a FeatureCollection of one LineString a path.
Coordinates are longitude and latitude only, since a third one would be a height above the ellipsoid; the altitudes
above ground and all else that is known of the path are properties (``altitude_m``, ``z_m`` of each point, ``cost``,
``metrics`` ..., with the numbers of these two as ``cost_gps``, ``mean_gps`` ... too; ``cautions`` as sentences;
``height_reference`` says what the heights count from; over terrain, ``ground_m`` is the elevation below each). With a
report its facts are properties too, and its ``segments`` as a list. Of several paths each has a ``name``.

GPX 1.1: of each path a route of its waypoints, with its facts in words. ``ele`` of a point is its elevation, that of
the ground below it in the terrain file and the height above it: so it counts from that file's zero, whatever its
vertical datum is, which the route's description says. Over maps without terrain the ground's elevation is not known,
and points have none; their height above ground is in words either way.

KML: of each path a LineString at its altitude above ground (``relativeToGround``), and all known of it as data, JSON
where it is no text. Over maps with terrain its points are those of `waypoints`, as programs draw straight lines from
one to the next.

A further format is a function such as `to_geojson`, and a line in `FORMATS`, which checks, messages and the viewer
read.
"""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from jaxurban.checks import one_of
from jaxurban.errors import GuessWarning, InputError, warn
from jaxurban.flights.export.base import (
    DECIMALS,
    Z_DECIMALS,
    Encode,
    Format,
    Named,
    description_of,
    facts_of,
    positions,
    upward,
    waypoints,
)
from jaxurban.flights.export.qgc_plan import END_NOTES, to_qgc_plan
from jaxurban.flights.missions.parts import BOTH
from jaxurban.io.files import write_whole
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.route_report import RouteReport
from jaxurban.paths.suffixes import MISSION, check_route_file
from jaxurban.settings import FlownBy, MissionEnd

GROUND_REFERENCE = (
    "ground_m is in metres above the zero of the terrain file, whatever its vertical datum is"
)


def to_geojson(routes: Named, report: RouteReport | None) -> bytes:
    """Return paths as GeoJSON in UTF-8, a feature for each path.

    Args:
      routes: the paths with their names, ``""`` for one without.
      report: of the one path, whose facts become properties too; or None.
    """
    features = []
    for name, route, facts in facts_of(routes, report, is_flown=False):
        # A GIS takes nested properties for text, so that each number gets a property of its own too.
        for layer, cost in facts["cost_by_layer"].items():
            facts[f"cost_{layer}"] = cost
        for metric, mean in facts["metrics"].items():
            facts[f"mean_{metric}"] = mean
        facts["z_m"] = upward(route.z_m).tolist()
        ground = route.ground
        if ground is not None:
            elevation_m = np.interp(np.arange(len(route.z_m)), ground.at, ground.elevation_m)
            facts["ground_m"] = np.round(elevation_m, Z_DECIMALS).tolist()
            facts["ground_reference"] = GROUND_REFERENCE
        if name:
            facts = {"name": name, **facts}
        geometry = {"type": "LineString", "coordinates": positions(route.lonlat)}
        features.append({"type": "Feature", "properties": facts, "geometry": geometry})
    collection = {"type": "FeatureCollection", "features": features}
    return (json.dumps(collection, allow_nan=False) + "\n").encode()


def elevation_note(route: PlannedPath) -> str:
    """Return what the elevations of a ``.gpx`` count from, or why there are none."""
    if route.ground is None:
        return "These maps hold no terrain, so points have no elevation: their heights above ground are in words."
    return "Elevations are in metres above the zero of the terrain file, whatever its vertical datum is."


def to_gpx(routes: Named, report: RouteReport | None) -> bytes:
    """Return paths as routes of GPX 1.1, XML in UTF-8. Points are waypoints, with an elevation only over terrain.

    Args:
      routes: the paths with their names, ``""`` for one without.
      report: of the one path, for its description; or None.
    """
    root = Element(
        "gpx", xmlns="http://www.topografix.com/GPX/1/1", version="1.1", creator="jaxurban"
    )
    for name, route, facts in facts_of(routes, report):
        element = SubElement(root, "rte")
        along = waypoints(route)
        SubElement(element, "name").text = name or _title(route, facts)
        SubElement(element, "desc").text = description_of(facts, elevation_note(route))
        for index, (lon, lat) in enumerate(along.lonlat):
            degrees = {"lat": f"{lat:.{DECIMALS}f}", "lon": f"{lon:.{DECIMALS}f}"}
            point = SubElement(element, "rtept", degrees)
            z_m = along.z_m[index]
            if along.ground_m is not None:
                elevation_m = upward(along.ground_m[index] + z_m)
                SubElement(point, "ele").text = f"{elevation_m:.{Z_DECIMALS}f}"
            SubElement(point, "name").text = str(index + 1)
            SubElement(point, "desc").text = f"{upward(z_m):.{Z_DECIMALS}f} m above ground"
    return _encoded(root)


def to_kml(routes: Named, report: RouteReport | None) -> bytes:
    """Return paths as lines of KML, XML in UTF-8, with all that is known of them as data.

    Args:
      routes: the paths with their names, ``""`` for one without.
      report: of the one path, for its data; or None.
    """
    root = Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = SubElement(root, "Document")
    for name, route, facts in facts_of(routes, report):
        placemark = SubElement(document, "Placemark")
        SubElement(placemark, "name").text = name or _title(route, facts)
        SubElement(placemark, "description").text = description_of(facts)
        del facts["cautions"]  # the description holds them
        data = SubElement(placemark, "ExtendedData")
        for key, value in facts.items():
            text = value if isinstance(value, str) else json.dumps(value)
            SubElement(SubElement(data, "Data", name=key), "value").text = text
        points = route if route.ground is None else waypoints(route)
        places = positions(np.column_stack([points.lonlat, upward(points.z_m)]))
        line = SubElement(placemark, "LineString")
        SubElement(line, "altitudeMode").text = "relativeToGround"
        SubElement(line, "coordinates").text = " ".join(
            f"{lon:.{DECIMALS}f},{lat:.{DECIMALS}f},{z_m:.{Z_DECIMALS}f}"
            for lon, lat, z_m in places
        )
    return _encoded(root)


def _title(route: PlannedPath, facts: Mapping[str, Any]) -> str:
    """Return the name of a path that has none: planner and altitude."""
    return f"{facts['planner']}, {route.altitude_m:g} m above ground"


def _encoded(root: Element) -> bytes:
    """Return an XML document, which is indented in place, as UTF-8."""
    indent(root)
    return tostring(root, encoding="utf-8", xml_declaration=True)


FORMATS = {
    ".geojson": Format(to_geojson, "GeoJSON"),
    ".kml": Format(to_kml, "KML"),
    ".gpx": Format(to_gpx, "GPX", is_of_waypoints=True),
    MISSION: Format(to_qgc_plan, "QGroundControl", is_of_waypoints=True),
}
WAYPOINTS = tuple(suffix for suffix, each in FORMATS.items() if each.is_of_waypoints)


def write_files(
    route: PlannedPath,
    files: Sequence[Path],
    report: RouteReport | None,
    *,
    end: MissionEnd | None,
    autopilot: FlownBy | None,
) -> None:
    """Write a path to files of any formats (`PlannedPath.save`, which says what is taken and refused)."""
    missions = [file for file in files if file.suffix.lower() == MISSION]
    if not missions and (end is not None or autopilot is not None):
        check_is_mission(files[0])  # raises InputError, as no file is a mission
    for file in files:
        encoder_of(file)  # raises InputError, before any is written
    for caution in route.cautions:
        if caution.kind == "unknown heights":
            warn(caution, GuessWarning)
    for file in files:
        if file not in missions:
            write_path(route, file, report)
    # Missions come last, since they may be refused.
    for file in missions:
        write_path(route, file, report, end=end, autopilot=autopilot)


def write_path(
    route: PlannedPath | Sequence[PlannedPath | None],
    file: str | Path,
    report: RouteReport | None = None,
    *,
    names: Sequence[str] = ("",),
    end: MissionEnd | None = None,
    autopilot: FlownBy | None = None,
) -> bool:
    """Write paths in the format that the file's suffix names; return False, writing nothing, if there is no path.

    `FORMATS` names the modules that say what each file holds. The file appears whole or not at all; an older one is
    replaced.

    Args:
      route: from `plan`, or several; a result without a path is left out.
      file: where to; each format needs a call of its own.
      report: from `jaxurban.explain`; its speed becomes the cruise speed of a ``.plan``. Of one path only.
      names: of several paths, one for each.
      end: how the mission in a ``.plan`` ends: ``"land"`` at the goal (so also if it is left out), ``"return"`` to
        launch as the autopilot does it, or ``"none"``.
      autopilot: which one a ``.plan`` is for, ``"px4"`` if left out, or ``"ardupilot"``.

    Raises:
      InputError: another suffix, an end or an autopilot of a format without, several paths in a format of one, a
        ``.plan`` that its own check finds fault with, or a folder that does not exist or cannot be written to.
    """
    # The format.
    file = Path(file)
    encode = encoder_of(file)
    if end is not None or autopilot is not None:
        check_is_mission(file)
        ending: MissionEnd = "land" if end is None else one_of("end", end, END_NOTES)
        flyer: FlownBy = "px4" if autopilot is None else one_of("autopilot", autopilot, BOTH)
        encode = partial(to_qgc_plan, end=ending, autopilot=flyer)

    # The paths and their names.
    routes = route if isinstance(route, Sequence) else [route]
    named = zip(names, routes, strict=True)
    reached = [(name, path) for name, path in named if path and path.status.has_path]
    if reached:
        try:
            data = encode(reached, report)
        except InputError as error:
            kept = f"; the older {file.name} stays as it is" if file.exists() else ""
            raise InputError(f"{error}{kept}") from error
        write_whole(file, data)
    return bool(reached)


def check_is_mission(file: Path) -> None:
    """Raise InputError unless a file's format says how the flight ends, and which autopilot flies it."""
    if file.suffix.lower() != MISSION:
        raise InputError(
            f"only a {MISSION} says how the flight ends and which autopilot flies it, and {str(file)!r} is none: leave "
            "end and autopilot out"
        )


def encoder_of(file: Path) -> Encode:
    """Return the function that writes the format of a file, by its suffix; errors as of `check_route_file`."""
    check_route_file(file)
    return FORMATS[file.suffix.lower()].encode
