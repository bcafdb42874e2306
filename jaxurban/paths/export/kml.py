"""KML: of each path a LineString at its altitude above ground (``relativeToGround``), and all known of it as data.

Over maps with terrain its points are those of `waypoints`, as programs draw straight lines from one to the next.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from jaxurban.paths.export.base import DECIMALS, Z_DECIMALS, Named, description_of, facts_of, positions, upward
from jaxurban.paths.export.waypoints import waypoints

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath


def to_kml(routes: Named, report: "RouteReport | None") -> bytes:
    """Return paths as KML."""
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    for name, route in routes:
        _add_placemark(document, name, route, facts_of(route, report, is_alone=len(routes) == 1)[0])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_placemark(document: ElementTree.Element, name: str, route: "PlannedPath", facts: dict[str, Any]) -> None:
    placemark = ElementTree.SubElement(document, "Placemark")
    title = name or f"{facts['planner']}, {route.altitude_m:g} m above ground"
    ElementTree.SubElement(placemark, "name").text = title
    ElementTree.SubElement(placemark, "description").text = description_of(facts)
    del facts["cautions"]
    data = ElementTree.SubElement(placemark, "ExtendedData")
    for name, value in _flat(facts):
        ElementTree.SubElement(ElementTree.SubElement(data, "Data", name=name), "value").text = str(value)
    along = route if route.ground is None else waypoints(route)
    line = ElementTree.SubElement(placemark, "LineString")
    ElementTree.SubElement(line, "altitudeMode").text = "relativeToGround"
    ElementTree.SubElement(line, "coordinates").text = " ".join(
        f"{lon:.{DECIMALS}f},{lat:.{DECIMALS}f},{z_m:.{Z_DECIMALS}f}"
        for lon, lat, z_m in positions(np.column_stack([along.lonlat, upward(along.z_m)]))
    )


def _flat(facts: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return nested facts as dotted names with plain values, those without a value left out."""
    pairs: list[tuple[str, Any]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{name}.")
        elif value is not None:
            pairs.append((prefix + name, value))
    return pairs
