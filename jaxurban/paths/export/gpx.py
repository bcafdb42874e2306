"""GPX 1.1: of each path a route of its waypoints, with its facts in words.

``ele`` of a point is its elevation, that of the ground below it in the terrain file and the height above it: so it
counts from that file's zero, whatever its vertical datum is, which the route's description says. Over maps without
terrain the ground's elevation is not known, and points have none; their height above ground is in words either way.
"""

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from jaxurban.paths.export.base import DECIMALS, Z_DECIMALS, Named, description_of, facts_of, upward
from jaxurban.paths.export.waypoints import waypoints

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath

NAMESPACE = "http://www.topografix.com/GPX/1/1"


def elevation_note(route: "PlannedPath") -> str:
    """Return what the elevations of a ``.gpx`` count from, or why there are none."""
    if route.ground is None:
        return "These maps hold no terrain, so points have no elevation: their heights above ground are in words."
    return "Elevations are in metres above the zero of the terrain file, whatever its vertical datum is."


def to_gpx(routes: Named, report: "RouteReport | None") -> bytes:
    """Return paths as routes of GPX 1.1."""
    root = ElementTree.Element("gpx", xmlns=NAMESPACE, version="1.1", creator="jaxurban")
    for name, route in routes:
        _add_route(root, name, route, facts_of(route, report, is_alone=len(routes) == 1)[0])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_route(root: ElementTree.Element, name: str, route: "PlannedPath", facts: dict[str, Any]) -> None:
    element, along = ElementTree.SubElement(root, "rte"), waypoints(route)
    title = name or f"{facts['planner']}, {route.altitude_m:g} m above ground"
    ElementTree.SubElement(element, "name").text = title
    ElementTree.SubElement(element, "desc").text = description_of(facts, elevation_note(route))
    for number, ((lon, lat), z_m) in enumerate(zip(along.lonlat, along.z_m, strict=True)):
        point = ElementTree.SubElement(element, "rtept", lat=f"{lat:.{DECIMALS}f}", lon=f"{lon:.{DECIMALS}f}")
        if along.ground_m is not None:
            ElementTree.SubElement(point, "ele").text = f"{upward(along.ground_m[number] + z_m):.{Z_DECIMALS}f}"
        ElementTree.SubElement(point, "name").text = str(number + 1)
        ElementTree.SubElement(point, "desc").text = f"{upward(z_m):.{Z_DECIMALS}f} m above ground"
