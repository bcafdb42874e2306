"""CityGML 1.0 to 3.0, an object at a time: elements are known by their names without prefixes, declared or not."""

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from jaxurban.cities.bodies import NO_LEVEL, TAGS, UNREAD, CityObject, Face, bodies_of
from jaxurban.cities.estimates import METHODS
from jaxurban.errors import InputError
from jaxurban.io.files import pieces_of

FACES = {"Polygon", "PolygonPatch", "Triangle", "Rectangle"}
POSITIONS = {"pos", "posList", "coordinates"}
VALUES = {"measuredHeight": "height", "storeysAboveGround": "levels"}
# What is not needed of a unit, such as urn:ogc:def:uom:UCUM::[ft_i], and EPSG's metre: numbers alone are in metres.
BESIDE_UNIT = re.compile(r".*[:#/]|\W|_.*|9001")
OTHER_FILE = re.compile(r"[^#]+#.*|[^#:]+|.*\.(gml|xml)")  # codes have URLs
is_member = lru_cache(re.compile("(cityObject|group)Member|(m|featureM)embers?").fullmatch)
lod_of = lru_cache(re.compile(r"lod(\d)(?!Implicit).*").fullmatch)
is_label = lru_cache(
    re.compile("(Outer)?(Roof|Wall|Ground|Closure|Floor|Ceiling)Surface").fullmatch
)
# Nothing stands by boxes, looks, addresses, metadata, lines where walls meet the ground, points and templates alone.
is_beside = lru_cache(
    re.compile(
        "Envelope|Box|[aA]ppearance.*|[aA]ddress|metaData.*|lod.TerrainIntersection.*|Point|"
        "relative(GML)?Geometry"
    ).fullmatch
)
# Other names with a capital are objects, unless a level of detail holds them.
is_shape = lru_cache(
    re.compile(
        "[a-z].*|(Multi|Composite).*|"
        ".*(Surface|Solid|Curve|String|Point|Geometry|Complex|Shell|Tin|Door|Window|Opening)"
    ).fullmatch
)
STRAIGHT = re.compile("(?!coordinates)[a-z].*|.*Ring|LineString.*|(Composite)?Curve|Point")


def read_citygml(path: Path, crs_names: set[str]) -> Iterator[dict[str, Any]]:
    """Return the bodies of a file of CityGML (see `bodies_of`).

    Args:
      path: the file, unpacked.
      crs_names: gets what the file calls its CRS.

    Raises:
      InputError: it needs other files, has bent edges, or a DOCTYPE; the message lacks its name.
      ExpatError, ValueError, LookupError: a file that cannot be read.
    """
    model = _Model(crs_names)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = _refuse
    parser.StartElementHandler = model.start
    parser.EndElementHandler = model.end
    parser.CharacterDataHandler = model.builder.data
    for piece in pieces_of(path):
        parser.Parse(piece)
    parser.Parse(b"", True)
    model.objects.append(model.object_of(model.builder.close()))  # with what no member holds
    model.draw_links(path.stat().st_size)
    return bodies_of(model.objects)


class _Model:
    """What of a file is read so far."""

    def __init__(self, crs_names: set[str]) -> None:
        """Begin without an object; ``crs_names`` as of `read_citygml`."""
        self.crs_names = crs_names
        self.builder = TreeBuilder()  # of what is read, but members that are objects by now
        self.objects: list[CityObject] = []  # that stand by themselves
        self.linked: set[CityObject] = set()  # with links, which are faces without rings
        self.elements: dict[Any, list[Face]] = {}  # the faces in each, by its id

    def start(self, name: str, attributes: dict[str, str]) -> None:
        """Open an element, without prefixes.

        Raises:
          InputError: a link to another file.
        """
        own = {key.rpartition(":")[2]: text for key, text in attributes.items()}
        if "href" in own and OTHER_FILE.fullmatch(own["href"]):
            raise InputError(
                f"refers to {own['href']!r}, and no other file is opened: write what is there into this one"
            )
        self.builder.start(name.rpartition(":")[2], own)

    def end(self, name: str) -> None:
        """Close an element; what a member holds is kept as objects alone."""
        element = self.builder.end(name.rpartition(":")[2])
        self.crs_names.add(element.get("srsName", ""))
        if is_member(element.tag):
            self.objects += map(self.object_of, element)
            element.clear()

    def object_of(self, element: Element) -> CityObject:
        """Return the object of an element."""
        one = CityObject(element.tag)
        self._fill(one, element, NO_LEVEL, None)
        return one

    def _fill(self, one: CityObject, element: Element, lod: float, label: str | None) -> None:
        """Give an object what an element holds, and keep the faces of each child by its id.

        Args:
          one: the object, which gets faces, pieces and attributes.
          element: its own, or one in it.
          lod, label: of the faces in the element, as of `Face`.
        """
        for child in element:
            if is_beside(child.tag):
                continue
            num_before = len(one.faces)
            self._add(one, child, lod, label)
            self.elements[child.get("id")] = one.faces[num_before:]

    def _add(self, one: CityObject, child: Element, lod: float, label: str | None) -> None:
        """Give an object what one child is: an attribute, a link, a face, what holds further ones, or another object.

        Args:
          one, lod, label: as of `_fill`.
          child: of the element.

        Raises:
          InputError: as of `_numbers`.
        """
        name = child.tag
        has_lod = lod_of(name)
        inner_lod = float(has_lod[1]) if has_lod else lod
        if name.endswith("Attribute") and child.get("name", "").lower() in METHODS:
            one.origin = child.findtext("value")
        elif name in VALUES:
            setattr(one, VALUES[name], _with_unit(child))
        elif "href" in child.attrib and inner_lod != NO_LEVEL:
            one.faces.append(Face(inner_lod, child.attrib["href"][1:], []))
            self.linked.add(one)
        elif name in FACES:
            one.draw(lod, label, map(_vertices, child))
        elif name in POSITIONS:
            one.faces.append(Face(lod, UNREAD, [_vertices(child)]))
        elif lod != NO_LEVEL or is_shape(name):
            self._fill(one, child, inner_lod, name if is_label(name) else label)
        else:
            others = self.objects if name in TAGS else one.pieces
            others.append(self.object_of(child))

    def draw_links(self, most: int) -> None:
        """Put faces in the place of links to them.

        Args:
          most: faces and links, so that links to links, or to themselves, come to an end.

        Raises:
          KeyError: a link to what the file does not hold.
          InputError: there are more.
        """
        for one in self.linked:
            for face in one.faces:  # which grow by what links lead to
                most -= 1
                if most < 0:
                    raise InputError("draws faces over and over by links: write them out")
                if not face.rings:
                    held = self.elements[face.label]
                    one.faces += [Face(face.lod, *inner[1:]) for inner in held]
            one.faces = [face for face in one.faces if face.rings]


def _numbers(element: Element) -> list[float]:
    """Return the numbers of all positions in an element, in the order of its curves.

    Raises:
      InputError: an edge that is not straight, or that is a link, or ``coordinates``.
    """
    if "href" in element.attrib or not STRAIGHT.fullmatch(element.tag):
        raise InputError(
            f"has edges in {element.tag!r}, which is not read: write straight ones, as posList, into each face"
        )
    if element.tag in POSITIONS:
        return [*map(float, str(element.text).split())]
    return [number for child in element for number in _numbers(child)]


def _vertices(element: Element) -> np.ndarray:
    """Return the vertices in an element, ``[V, 3]``; with z 0 if they have none, as only so they are closed."""
    numbers = _numbers(element)
    if numbers[:2] == numbers[-2:] and numbers[:3] != numbers[-3:]:
        return np.insert(np.reshape(numbers, (-1, 2)), 2, 0.0, axis=1)
    return np.reshape(numbers, (-1, 3))


def _with_unit(element: Element) -> str:
    """Return the text of a length, then the unit of its attribute as `parse_height_m` reads it."""
    unit = BESIDE_UNIT.sub("", element.get("uom", ""))
    return f"{element.text or ''} {unit}"


def _refuse(*_: Any) -> None:
    """Refuse a DOCTYPE, whose entities may grow without end or name other files."""
    raise InputError("has a DOCTYPE, which is never read: remove it")
