"""GPX 1.1 and KML.

GPX: of each path a route of its waypoints, with its facts in words. ``ele`` of a point is its elevation, that of the
ground below it in the terrain file and the height above it: so it counts from that file's zero, whatever its vertical
datum is, which the route's description says. Over maps without terrain the ground's elevation is not known, and points
have none; their height above ground is in words either way.

KML: of each path a LineString at its altitude above ground (``relativeToGround``), and all known of it as data. Over
maps with terrain its points are those of `waypoints`, as programs draw straight lines from one to the next.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from jaxurban.paths.export.base import DECIMALS, Z_DECIMALS, Named, description_of, facts_of, positions, upward
from jaxurban.paths.export.waypoints import waypoints

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath


def elevation_note(route: "PlannedPath") -> str:
    """Return what the elevations of a ``.gpx`` count from, or why there are none."""
    if route.ground is None:
        return "These maps hold no terrain, so points have no elevation: their heights above ground are in words."
    return "Elevations are in metres above the zero of the terrain file, whatever its vertical datum is."


def to_gpx(routes: Named, report: "RouteReport | None") -> bytes:
    """Return paths as routes of GPX 1.1."""
    root = Element("gpx", xmlns="http://www.topografix.com/GPX/1/1", version="1.1", creator="jaxurban")
    for name, route in routes:
        facts, _ = facts_of(route, report, is_alone=len(routes) == 1)
        element, along = SubElement(root, "rte"), waypoints(route)
        SubElement(element, "name").text = name or _title(route, facts)
        SubElement(element, "desc").text = description_of(facts, elevation_note(route))
        for number, ((lon, lat), z_m) in enumerate(zip(along.lonlat, along.z_m, strict=True)):
            point = SubElement(element, "rtept", lat=f"{lat:.{DECIMALS}f}", lon=f"{lon:.{DECIMALS}f}")
            if along.ground_m is not None:
                SubElement(point, "ele").text = f"{upward(along.ground_m[number] + z_m):.{Z_DECIMALS}f}"
            SubElement(point, "name").text = str(number + 1)
            SubElement(point, "desc").text = f"{upward(z_m):.{Z_DECIMALS}f} m above ground"
    return _encoded(root)


def to_kml(routes: Named, report: "RouteReport | None") -> bytes:
    """Return paths as KML."""
    root = Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = SubElement(root, "Document")
    for name, route in routes:
        facts, _ = facts_of(route, report, is_alone=len(routes) == 1)
        placemark = SubElement(document, "Placemark")
        SubElement(placemark, "name").text = name or _title(route, facts)
        SubElement(placemark, "description").text = description_of(facts)
        del facts["cautions"]
        data = SubElement(placemark, "ExtendedData")
        for key, value in _flat(facts):
            SubElement(SubElement(data, "Data", name=key), "value").text = str(value)
        along = route if route.ground is None else waypoints(route)
        line = SubElement(placemark, "LineString")
        SubElement(line, "altitudeMode").text = "relativeToGround"
        SubElement(line, "coordinates").text = " ".join(
            f"{lon:.{DECIMALS}f},{lat:.{DECIMALS}f},{z_m:.{Z_DECIMALS}f}"
            for lon, lat, z_m in positions(np.column_stack([along.lonlat, upward(along.z_m)]))
        )
    return _encoded(root)


def _title(route: "PlannedPath", facts: Mapping[str, Any]) -> str:
    return f"{facts['planner']}, {route.altitude_m:g} m above ground"


def _encoded(root: Element) -> bytes:
    indent(root)
    return tostring(root, encoding="utf-8", xml_declaration=True)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return nested facts as dotted names with plain values, those without a value left out."""
    pairs: list[tuple[str, Any]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{name}.")
        elif value is not None:
            pairs.append((prefix + name, value))
    return pairs
