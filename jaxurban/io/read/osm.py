"""OpenStreetMap files: building outlines, assembled by pyosmium, those of a box cut out of an extract; water and parks.

Water and parks are what the strata of a study need beside the maps.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import osmium
import shapely
from numpy.lib.stride_tricks import sliding_window_view
from osmium.filter import IdFilter, KeyFilter, TagFilter

from jaxurban.errors import readable, warn
from jaxurban.io.read.columns import tags_of
from jaxurban.io.read.issues import ReadIssue
from jaxurban.io.read.outlines import DECK, Outlines
from jaxurban.world.grid import WGS84, Bounds, transformer
from jaxurban.world.land_cover import LandCover

TAGS = (  # that say something of buildings, as `COLUMNS` sorts them
    "building",
    "building:part",
    "height",
    "building:levels",
    "levels",
    "roof:levels",
    "min_height",
    "building:min_level",
    "location",
    "layer",
    "man_made",
)
OSM_SUFFIXES = (".pbf", ".osm")
OSM_CREDIT = "© OpenStreetMap contributors"  # asked for by the ODbL
HAS_BUILDING = KeyFilter("building", "building:part")
HAS_BUILDING_OR_DECK = KeyFilter("building", "building:part", "man_made")
WATER = (
    ("natural", "water"),
    ("waterway", "riverbank"),
    ("waterway", "dock"),
    ("landuse", "reservoir"),
)
PARK = (
    *(("leisure", value) for value in ("park", "nature_reserve", "golf_course")),
    *(("landuse", value) for value in ("cemetery", "forest", "recreation_ground")),
)
COAST = ("natural", "coastline")
MIXED = 0.2  # share of the shore on a face's other side, above which land and sea were not parted
GAP_M = 500.0  # a coast that ends nearer than this to the region's border was cut there
_AREA_RELATIONS = ("multipolygon", "boundary")  # what libosmium makes areas of


def read_osm(path: str | Path, *, has_decks: bool = False) -> Outlines:
    """Return the areas tagged ``building`` or ``building:part`` of an OSM file, ways and multipolygon relations.

    Coordinates are longitude and latitude; the box is the file header's (of several the first). Areas that
    libosmium cannot assemble (rings that cross themselves) are rebuilt from their lines, each loop filled.
    Nodes and ways with negative ids (an editor's, not yet uploaded) are unknown to pyosmium: their nodes are missing.

    Args:
      path: the file.
      has_decks: with the areas tagged ``man_made=bridge`` too.

    Raises:
      InputError: the file cannot be read to its end.
    """
    remedy = "it is damaged, cut short or of another kind; fetch it again, or put it in order with `osmium sort`"
    with readable(path, "OpenStreetMap data", remedy, RuntimeError, osmium.InvalidLocationError):
        return _read(path, has_decks)


def _read(path: str | Path, has_decks: bool) -> Outlines:
    """Return the outlines of an OSM file; arguments as of `read_osm`, errors as pyosmium raises them.

    An area is an outline that libosmium makes of a closed way, or of the ways of a relation.
    """
    # Areas, an entry of each list for each, and the ids of the ways and relations that the file has.
    areas: list[tuple[bool, int]] = []  # whether it is of a way, and the id of way or relation
    shapes = []  # WKB in hexadecimal, None where libosmium could not make it
    tags = []
    ways = set()
    open_ways = set()
    missing = set()  # ways that lack nodes
    relations = {}  # for each relation its ways
    to_wkb = osmium.geom.WKBFactory()
    chosen = HAS_BUILDING_OR_DECK if has_decks else HAS_BUILDING
    for item in open_osm(path).with_areas(chosen).with_filter(chosen):
        if has_decks and not _is_building_or_deck(item.tags):
            continue
        if isinstance(item, osmium.osm.Area):
            areas.append((item.from_way(), item.orig_id()))
            tags.append([item.tags.get(tag) for tag in TAGS])
            is_assembled = item.num_rings()[0] > 0
            shapes.append(to_wkb.create_multipolygon(item) if is_assembled else None)
        elif isinstance(item, osmium.osm.Way):
            ways.add(item.id)
            if not item.is_closed():
                open_ways.add(item.id)
            if not all(node.location.valid() for node in item.nodes):
                missing.add(item.id)
        elif isinstance(item, osmium.osm.Relation) and item.tags.get("type") in _AREA_RELATIONS:
            relations[item.id] = _ways_of(item)

    # Areas that libosmium could not assemble are built from the lines of their ways, as far as the file has them.
    polygons = shapely.from_wkb(np.array(shapes, object))
    broken = np.flatnonzero(shapely.is_missing(polygons))
    ways_of = {}
    for index in broken:
        is_way, item_id = areas[index]
        ways_of[index] = [item_id] if is_way else relations[item_id]
    lines = _read_lines(path, set().union(*ways_of.values())) if ways_of else {}
    for index, ids in ways_of.items():
        known = [lines[way_id] for way_id in ids if way_id in lines]
        polygons[index] = shapely.build_area(shapely.union_all(known))

    # The outlines. Ways and relations that made no area are counted by what is wrong with them.
    of_ways = {item_id for is_way, item_id in areas if is_way}
    of_relations = {item_id for is_way, item_id in areas if not is_way}
    columns = np.array(tags, object).reshape(-1, len(TAGS)).T
    box = header_box(path)
    return Outlines(
        polygons=polygons,
        tags=tags_of(dict(zip(TAGS, columns, strict=True))),
        crs=WGS84,
        boxes=() if box is None else (box,),
        attribution=OSM_CREDIT,
        issues={
            ReadIssue.OPEN_WAYS: len(open_ways),
            ReadIssue.WAYS_WITH_MISSING_NODES: len(missing),
            ReadIssue.DEGENERATE_WAYS: len(ways - open_ways - missing - of_ways),
            ReadIssue.RELATIONS_INCOMPLETE: len(relations.keys() - of_relations),
            ReadIssue.POLYGONS_REPAIRED: int(np.sum(~shapely.is_empty(polygons[broken]))),
        },
    )


def _is_building_or_deck(tags: Any) -> bool:
    """Return whether an object with these tags is a building, a part of one, or the deck of a bridge."""
    return "building" in tags or "building:part" in tags or tags.get("man_made") == DECK


def format_of(path: str | Path) -> str:
    """Return pyosmium's name of the format that a file's name ends in."""
    return "osm" if str(path).lower().endswith(".osm") else "pbf"


def _file(path: str | Path) -> osmium.io.File:
    """Return a file for pyosmium, whose format its name says."""
    return osmium.io.File(str(path), format_of(path))


def open_osm(path: str | Path) -> osmium.FileProcessor:
    """Return a processor that knows every node's place when a way comes by, even if the nodes follow the ways.

    In XML, as the Overpass API writes it, they may; its nodes are read before. PBF files are sorted.
    """
    file = _file(path)
    # Any: the package's own annotation says str.
    locations: Any = osmium.index.create_map("flex_mem")
    if format_of(path) == "osm":
        with osmium.io.Reader(file, osmium.osm.NODE) as reader:
            osmium.apply(reader, osmium.NodeLocationsForWays(locations))
    return osmium.FileProcessor(file).with_locations(locations)


def _ways_of(relation: osmium.osm.Relation) -> list[int]:
    """Return the ids of the ways in a relation."""
    return [member.ref for member in relation.members if member.type == "w"]


def _read_lines(path: str | Path, ids: set[int]) -> dict[int, shapely.Geometry]:
    """Return the lines of the ways with these ids, by id, in longitude and latitude, without nodes that are missing.

    A way with less than two nodes has an empty line; one that the file lacks has none. Of what a way passes several
    times it has one line.
    """
    lines = {}
    for way in open_osm(path).with_filter(IdFilter(ids)):
        if isinstance(way, osmium.osm.Way):  # nodes may bear the same numbers
            points = [(node.lon, node.lat) for node in way.nodes if node.location.valid()]
            sides = {tuple(sorted(side)) for side in pairwise(points) if side[0] != side[1]}
            lines[way.id] = shapely.LineString(points if len(points) > 1 else [])
            if len(sides) < len(points) - 1:
                lines[way.id] = shapely.MultiLineString(sorted(sides))
    return lines


def header_box(path: str | Path) -> Bounds | None:
    """Return west, south, east, north in degrees of an OSM file by its header, None where the header does not say.

    Raises:
      InputError: the file cannot be read.
    """
    with (
        readable(path, "OpenStreetMap data", "fetch it again", RuntimeError),
        osmium.io.Reader(_file(path), osmium.osm.NOTHING) as reader,
    ):
        box = reader.header().box()
    if not box.valid():
        return None
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def cut_buildings(source: Path, target: Path, box: Bounds) -> None:
    """Write the ways and relations of buildings and decks that have a node in a box, with all that they refer to.

    Args:
      source: a PBF file, nodes before ways before relations.
      target: the PBF file to write; an old one is replaced.
      box: west, south, east, north in degrees.
    """
    file = _file(source)

    # The member ways of a building relation need not bear the tag themselves.
    ways_of = {relation.id: _ways_of(relation) for relation in _relations(file)}
    members = set().union(*ways_of.values())
    near = {way.id for way in _ways_in(file, IdFilter(members), box)} if members else set()

    with osmium.BackReferenceWriter(
        _file(target), ref_src=file, overwrite=True, remove_tags=False
    ) as writer:
        for way in _ways_in(file, HAS_BUILDING_OR_DECK, box):
            if _is_building_or_deck(way.tags):
                writer.add(way)
        for relation in _relations(file):
            if not near.isdisjoint(ways_of[relation.id]):
                writer.add(relation)


def _relations(file: osmium.io.File) -> Iterator[osmium.osm.Relation]:
    """Yield the relations of buildings and decks in a file."""
    for item in osmium.FileProcessor(file, osmium.osm.RELATION).with_filter(HAS_BUILDING_OR_DECK):
        if isinstance(item, osmium.osm.Relation) and _is_building_or_deck(item.tags):
            yield item


def _ways_in(
    file: osmium.io.File, chosen: IdFilter | KeyFilter, box: Bounds
) -> Iterator[osmium.osm.Way]:
    """Yield the ways of a file that pass a filter and have a node in a box.

    Args:
      file: sorted, with nodes before ways.
      chosen: the filter.
      box: west, south, east, north in degrees.
    """
    west, south, east, north = box
    processor = osmium.FileProcessor(file, osmium.osm.NODE | osmium.osm.WAY).with_locations()
    for item in processor.with_filter(chosen):
        if isinstance(item, osmium.osm.Way):
            places = (node.location for node in item.nodes if node.location.valid())
            if any(west <= place.lon <= east and south <= place.lat <= north for place in places):
                yield item


def read_land_cover(path: str | Path, crs: str, bounds_m: Bounds) -> LandCover:
    """Return the water and the parks of an OSM file within a box.

    Water is what is tagged so, and the sea: OSM draws its coast as lines with the land on their left, which are joined
    and cut out of the box here. Parks are parks, nature reserves, golf courses, cemeteries, forests and recreation
    grounds. Areas that cannot be assembled are left out.

    Args:
      path: ``.osm.pbf`` or ``.osm``.
      crs: projected CRS of the result, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box in that CRS.

    Raises:
      InputError: the file cannot be read to its end.
    """
    remedy = "fetch it again, or name another file in [study] land_cover"
    with readable(path, "OpenStreetMap data", remedy, RuntimeError):
        rows, coast = areas_and_coast(path)
    box = shapely.box(*bounds_m)

    def joined(kind: str) -> shapely.Geometry:
        """Return all areas of a kind in the box as one, in ``crs``."""
        shapes = [shapely.from_wkb(shape) for own_kind, _, shape in rows if own_kind == kind]
        whole = shapely.union_all(shapely.make_valid(projected(shapes, crs)))
        return shapely.intersection(whole, box)

    wet = sea(list(projected(coast, crs)), box)
    return LandCover(water=shapely.union(joined("water"), wet), park=joined("park"))


def areas_and_coast(
    path: str | Path,
) -> tuple[list[tuple[str, str, str]], list[shapely.LineString]]:
    """Return the waters and parks of an OSM file, and the lines of its coast, in longitude and latitude.

    Returns:
      A row for each area: its kind (``water`` or ``park``), its name (empty without one) and its hexadecimal WKB; and
      the runs of the coast's ways, see `runs_of`. Areas that cannot be assembled are left out.
    """
    rows: list[tuple[str, str, str]] = []
    coast = []
    to_wkb = osmium.geom.WKBFactory()
    areas = TagFilter(*WATER, *PARK)
    for item in open_osm(path).with_areas(areas).with_filter(TagFilter(*WATER, *PARK, COAST)):
        if (
            isinstance(item, osmium.osm.Area)
            and item.num_rings()[0]
            and has_tag(item, WATER + PARK)
        ):
            kind = "water" if has_tag(item, WATER) else "park"
            rows.append((kind, item.tags.get("name") or "", to_wkb.create_multipolygon(item)))
        elif isinstance(item, osmium.osm.Way) and has_tag(item, (COAST,)):
            coast += runs_of(item)
    return rows, coast


def projected(shapes: list[shapely.Geometry], crs: str) -> np.ndarray:
    """Return shapes in longitude and latitude as an array of them in a projected CRS."""
    return shapely.transform(
        np.array(shapes, object), transformer(WGS84, crs).transform, interleaved=False
    )


def has_tag(item: osmium.osm.OSMObject, tags: tuple[tuple[str, str], ...]) -> bool:
    """Return whether an object has one of these keys with its value."""
    return any(item.tags.get(key) == value for key, value in tags)


def runs_of(way: osmium.osm.Way) -> list[shapely.LineString]:
    """Return the lines of a way in longitude and latitude: one, or several between nodes that the file lacks.

    Nodes that stand alone between missing ones are left out.
    """
    runs: list[list[tuple[float, float]]] = [[]]
    for node in way.nodes:
        if node.location.valid():
            runs[-1].append((node.lon, node.lat))
        else:
            runs.append([])
    return [shapely.LineString(points) for points in runs if len(points) > 1]


def sea(coast: list[shapely.LineString], box: shapely.Polygon) -> shapely.Geometry:
    """Return the part of a box on the right of coast lines, which have the land on their left.

    A line that ends inside the box, less than `GAP_M` from its border, is led on to the border, as extracts are cut in
    this way. A box that no line cuts is all sea or all land, by the side of the nearest line on which its centre lies.

    Args:
      coast: lines in a projected CRS in metres; without any there is no sea.
      box: in the same CRS.

    Returns:
      A polygon or several; an empty polygon where there is no sea.

    Warns:
      UserWarning: the lines have a gap, so that land and sea cannot be distinguished.
    """
    if not coast:
        return shapely.Polygon()

    # Cut the box along the coast into faces, each of which is sea or land.
    whole = shapely.get_parts(shapely.line_merge(shapely.union_all(coast), directed=True))
    ends = shapely.get_parts(shapely.boundary(whole))  # rings have none
    is_near = shapely.distance(box.exterior, ends) < GAP_M
    near = ends[shapely.contains_properly(box, ends) & is_near]
    bridges = shapely.shortest_line(near, box.exterior)
    # With the box's border, so that `polygonize` sees one network.
    network = shapely.union_all([*shapely.intersection(whole, box), *bridges, box.exterior])
    faces = shapely.get_parts(shapely.polygonize([network]))
    faces = faces[shapely.contains(box, shapely.point_on_surface(faces))]

    # The coast's straight segments: `segments` is [N, 2 (x, y), 2 (from, to)]. Those that have a length are kept, and
    # `right` is the direction [N, 2] to their right.
    points = [shapely.get_coordinates(line) for line in coast]
    segments = np.concatenate([sliding_window_view(line, 2, axis=0) for line in points])
    start, end = np.moveaxis(segments, -1, 0)
    is_long = (start != end).any(axis=1)
    start = start[is_long]
    end = end[is_long]
    length_m = np.hypot(*(end - start).T)
    right = (end - start)[:, ::-1] * [1, -1] / length_m[:, None]

    # How much of each face's shore has it on its right, the water's side, and on its left, the land's: a segment counts
    # for the face that lies half a metre beside its middle.
    tree = shapely.STRtree(faces)
    shore_m = np.zeros((2, len(faces)))
    for row, side in enumerate((1.0, -1.0)):
        beside = shapely.points((start + end) / 2 + 0.5 * side * right)
        point, face = tree.query(beside, predicate="within")
        np.add.at(shore_m[row], face, length_m[point])
    wet_m, dry_m = shore_m

    # Without coast in the box, the side of the nearest segment on which the middle of the box lies.
    if not shore_m.any():
        middle = box.centroid
        lines = shapely.linestrings(np.stack([start, end], axis=1))
        nearest = np.argmin(shapely.distance(lines, middle))
        from_shore = shapely.get_coordinates(middle)[0] - start[nearest]
        return box if right[nearest] @ from_shore > 0 else shapely.Polygon()

    # A face that has much shore of both kinds shows a gap in the lines.
    if (np.minimum(wet_m, dry_m) > MIXED * np.maximum(wet_m, dry_m)).any():
        warn(
            "the coast lines have a gap: what lies beside it is taken for what most of its shore says, land or sea; "
            "fetch an extract with complete ways, or name another file in [study] land_cover",
        )
    return shapely.union_all(faces[wet_m > dry_m])
