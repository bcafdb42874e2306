"""Building outlines from OpenStreetMap files, assembled by pyosmium."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import osmium
import shapely
from osmium.filter import IdFilter, KeyFilter

from jaxurban.errors import InputError
from jaxurban.grid import WGS84, Bounds
from jaxurban.io.outlines import Outlines

TAGS = {
    "building": ("building",),
    "part": ("building:part",),
    "height": ("height",),
    "levels": ("building:levels", "levels"),
    "roof_levels": ("roof:levels",),
    "min_height": ("min_height",),
    "min_level": ("building:min_level",),
    "location": ("location",),
    "layer": ("layer",),
}
_AREA_RELATIONS = ("multipolygon", "boundary")  # what libosmium makes areas of


def read_osm(path: str | Path, file_format: str) -> Outlines:
    """Return the areas tagged ``building`` or ``building:part`` of an OSM file, ways and multipolygon relations.

    Coordinates are longitude and latitude; ``boxes`` are the file header's. Areas that
    libosmium cannot assemble (rings that cross themselves) are rebuilt from their lines, each loop filled.
    Nodes and ways with negative ids (an editor's, not yet uploaded) are unknown to pyosmium: their nodes are missing.

    Faults: ``open_ways`` (not closed), ``ways_with_missing_nodes`` (nodes that the file does not hold),
    ``degenerate_ways`` (closed and complete, but no area: fewer than three corners), ``relations_incomplete``
    (members or their nodes missing), ``polygons_repaired`` (rebuilt here).

    Args:
      path: the file.
      file_format: ``"pbf"`` or ``"osm"`` (XML).

    Raises:
      InputError: the file cannot be read to its end.
    """
    try:
        return _read(path, osmium.io.File(str(path), file_format), nodes_may_follow=file_format == "osm")
    except (RuntimeError, ValueError, OSError, osmium.InvalidLocationError) as error:
        reason = " ".join(str(error).split())  # some libraries' messages have several lines
        raise InputError(
            f"{str(path)!r} cannot be read as OpenStreetMap data ({reason}): it is damaged, cut short or "
            "of another kind; fetch it again, or put it in order with `osmium sort`"
        ) from error


def _read(path: str | Path, file: osmium.io.File, *, nodes_may_follow: bool) -> Outlines:
    columns: dict[str, list[str | None]] = {name: [] for name in TAGS}
    shapes: list[str | None] = []  # WKB in hexadecimal, None where libosmium gave up
    broken: dict[int, tuple[bool, int]] = {}  # of those, place in `shapes`: whether it is a way, and its id
    open_ways, missing, ways, areas, relations = set(), set(), set(), set(), {}
    to_wkb = osmium.geom.WKBFactory()
    has_key = KeyFilter("building", "building:part")
    for item in _open(file, nodes_may_follow).with_areas(has_key).with_filter(has_key):
        if isinstance(item, osmium.osm.Area):
            areas.add((item.from_way(), item.orig_id()))
            for name, keys in TAGS.items():
                columns[name].append(next((item.tags[key] for key in keys if key in item.tags), None))
            if item.num_rings()[0] == 0:
                broken[len(shapes)] = (item.from_way(), item.orig_id())
                shapes.append(None)
            else:
                shapes.append(to_wkb.create_multipolygon(item))
        elif isinstance(item, osmium.osm.Way):
            ways.add(item.id)
            if not item.is_closed():
                open_ways.add(item.id)
            if not all(node.location.valid() for node in item.nodes):
                missing.add(item.id)
        elif isinstance(item, osmium.osm.Relation) and item.tags.get("type") in _AREA_RELATIONS:
            relations[item.id] = [member.ref for member in item.members if member.type == "w"]

    polygons = shapely.from_wkb(np.array(shapes, object))
    lines_of = {place: [i] if is_way else relations[i] for place, (is_way, i) in broken.items()}
    lines = _read_lines(_open(file, nodes_may_follow), {i for ids in lines_of.values() for i in ids}) if broken else {}
    for place, ids in lines_of.items():
        polygons[place] = shapely.build_area(shapely.union_all([lines[i] for i in ids if i in lines]))
    return Outlines(
        polygons=polygons,
        tags={name: np.array(column, object) for name, column in columns.items()},
        crs=WGS84,
        boxes=_xml_boxes(path) if nodes_may_follow else _header_box(file),
        faults={
            "open_ways": len(open_ways),
            "ways_with_missing_nodes": len(missing),
            "degenerate_ways": sum((True, i) not in areas for i in ways - open_ways - missing),
            "relations_incomplete": sum((False, i) not in areas for i in relations),
            "polygons_repaired": sum(not polygons[place].is_empty for place in broken),
        },
    )


def open_osm(path: str | Path) -> osmium.FileProcessor:
    """Return a processor of an OSM file, PBF or XML by its name, that knows every node's place."""
    is_xml = str(path).lower().endswith(".osm")
    return _open(osmium.io.File(str(path), "osm" if is_xml else "pbf"), nodes_may_follow=is_xml)


def _open(file: osmium.io.File, nodes_may_follow: bool) -> osmium.FileProcessor:
    """Return a processor that knows every node's place when a way comes by, even if the nodes follow the ways."""
    locations: Any = osmium.index.create_map("flex_mem")  # Any: the package's own annotation says str
    if nodes_may_follow:  # so the Overpass API writes XML; PBF is sorted
        with osmium.io.Reader(file, osmium.osm.NODE) as reader:
            osmium.apply(reader, osmium.NodeLocationsForWays(locations))
    return osmium.FileProcessor(file).with_locations(locations)


def _read_lines(processor: osmium.FileProcessor, ids: set[int]) -> dict[int, shapely.LineString]:
    """Return the lines of the ways with these ids, in longitude and latitude, without nodes that are missing."""
    lines = {}
    for way in processor.with_filter(IdFilter(ids)):
        if isinstance(way, osmium.osm.Way):  # nodes may bear the same numbers
            points = [(node.lon, node.lat) for node in way.nodes if node.location.valid()]
            lines[way.id] = shapely.LineString(points if len(points) > 1 else [])
    return lines


def _header_box(file: osmium.io.File) -> tuple[Bounds, ...]:
    with osmium.io.Reader(file, osmium.osm.NOTHING) as reader:
        box = reader.header().box()
    if not box.valid():
        return ()
    return ((box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat),)


def _xml_boxes(path: str | Path) -> tuple[Bounds, ...]:
    """Return the boxes that an XML file declares; pyosmium gives the first one only."""
    boxes = []
    with open(path, "rb") as file:
        for _, element in ElementTree.iterparse(file, events=("start",)):
            if element.tag == "bounds":
                west, south, east, north = (
                    float(element.get(name, "")) for name in ("minlon", "minlat", "maxlon", "maxlat")
                )
                boxes.append((west, south, east, north))
            elif element.tag in ("node", "way", "relation"):
                break
    return tuple(boxes)
