"""CityGML 1.0 to 3.0, an object at a time: elements are known by their names without prefixes, declared or not."""

import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from jaxurban.io.read.bodies import PIECE, CityObject, body_of

FACES = ("Polygon", "PolygonPatch", "Triangle", "Rectangle")
VALUES = {"measuredHeight": "height", "storeysAboveGround": "levels"}
# What is not needed of a unit, such as urn:ogc:def:uom:UCUM::[ft_i], and EPSG's metre: numbers alone are in metres.
BESIDE_UNIT = re.compile(r".*[:#/]|\W|_.*|9001")
MEMBERS = ("cityObjectMember", "featureMember", "featureMembers")  # of CityGML, and of GML alone
LOD = re.compile(r"lod(\d)(?!Implicit)")  # templates have coordinates of their own
LABEL = re.compile("(Outer)?(Roof|Wall|Ground|Closure|Floor|Ceiling)Surface")


def read_citygml(path: Path, crs_names: set[str]) -> list[dict[str, Any]]:
    """Return the bodies of a file of CityGML (see `body_of`).

    Args:
      path: the file, unpacked.
      crs_names: gets what the file calls its CRS.

    Raises:
      ExpatError, ValueError, AttributeError: a file that cannot be read, or has a DOCTYPE.
    """
    bodies: list[dict[str, Any]] = []
    builder = TreeBuilder()

    def start(name: str, attributes: dict[str, str]) -> None:
        """Open an element, without its prefix."""
        builder.start(name.rpartition(":")[2], attributes)

    def end(name: str) -> None:
        """Close an element; an object is kept as its body alone."""
        element = builder.end(name.rpartition(":")[2])
        crs_names.add(element.get("srsName", ""))
        if element.tag in MEMBERS:
            bodies.extend(body_of(_object(child)) for child in element)
            element.clear()

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = _refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    with path.open("rb") as file:
        parser.ParseFile(file)
    return bodies


def _object(element: Element) -> CityObject:
    """Return the object of an element."""
    one = CityObject(element.tag)
    _fill(one, element, None, None)
    return one


def _fill(one: CityObject, element: Element, lod: float | None, label: str | None) -> None:
    """Give an object what an element within it holds.

    Args:
      one: the object.
      element: its own, or one in it.
      lod, label: of the faces in the element; without a level there are none.
    """
    for child in element:
        name = child.tag
        level = LOD.match(name)
        if PIECE.fullmatch(name):
            one.pieces.append(_object(child))
        elif name in VALUES:
            unit = BESIDE_UNIT.sub("", child.get("uom", ""))
            setattr(one, VALUES[name], f"{child.text or ''} {unit}")
        elif name in FACES and lod is not None:
            texts = [" ".join(ring.itertext()) for ring in child.iter("LinearRing")]
            one.draw(lod, label, [np.array(text.split(), float).reshape(-1, 3) for text in texts])
        elif level is not None:
            _fill(one, child, float(level[1]), label)
        else:
            _fill(one, child, lod, name if LABEL.fullmatch(name) else label)


def _refuse(*_: Any) -> None:
    """Refuse a DOCTYPE, whose entities may grow without end or name other files."""
    raise ValueError("it has a DOCTYPE, which is never read")
