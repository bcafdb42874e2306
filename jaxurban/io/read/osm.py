"""OpenStreetMap files: building outlines, assembled by pyosmium, those of a box cut out of an extract; water and parks.

Water and parks are what the strata of a study need beside the maps.
"""

from collections.abc import Iterator
from contextlib import suppress
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
from jaxurban.io.read.kinds import KINDS, NOT_BUILT, STANDING
from jaxurban.io.read.osm_plain import plain_osm
from jaxurban.io.read.outlines import Outlines
from jaxurban.io.read.sniff import in_own_words, sniff, unpacked
from jaxurban.world.footprints import BUILDING
from jaxurban.world.grid import WGS84, Bounds, transformer
from jaxurban.world.land_cover import LandCover

BUILDINGS = ("building", "building:part")  # keys
MAYBE = (  # keys of what may stand
    *(*BUILDINGS, "height", "tower:type", *KINDS),
    *(f"{life}:{key}" for life in STANDING for key in ("building", *KINDS)),
    *(f"{life}:building" for life in NOT_BUILT),
)
OF_BUILDINGS = (  # what `COLUMNS` sorts, of buildings
    *(*BUILDINGS, "height", "building:levels", "levels", "roof:levels", "min_height"),
    *("building:min_level", "building:levels:underground", "location", "layer", "level"),
    *("parking", "man_made", "building:height", "est_height"),
)
OF_OTHERS = (
    *("barrier", "natural", "waterway", "diameter", "width", "rotor:diameter", "height:hub"),
    *("generator:source", "generator:method"),
    *(f"{life}:{key}" for life in NOT_BUILT for key in KINDS),
)
TAGS = {*OF_BUILDINGS, *MAYBE, *OF_OTHERS}
Key = tuple[str, int]  # "n", "w" or "r", and an id
OSM_SUFFIXES = (".pbf", ".osm", ".osm.json")  # of `sniff`
OSM_CREDIT = "© OpenStreetMap contributors"  # asked for by the ODbL
MAY_STAND = KeyFilter(*MAYBE)
MAY_STAND_OR_TYPE = KeyFilter(*MAYBE, "type")  # of relations
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
_OUTER = ("outline", "outer")  # of members of a relation of the type building


def read_osm(path: str | Path) -> Outlines:
    """Return what may stand of an OSM file: areas, lines and points with a key of `MAYBE`, with their tags.

    Coordinates are longitude and latitude; the box is the file header's (of several the first). Areas that
    libosmium cannot assemble (rings that cross themselves) are rebuilt from their lines, each loop filled; where
    these do not close, the lines are given as far as the file has them. Outlines of relations of the type building
    have the relations' tags beside their own. What pyosmium cannot read itself is read as `plain_osm` writes it.

    Args:
      path: the file: PBF, XML or JSON of the Overpass API, packed or not, of an editor too.

    Raises:
      InputError: the file cannot be read to its end.
    """
    remedy = "fetch it again, or put it in order with `osmium sort`"
    with plain_osm(path, remedy) as plain:
        return _read(plain)


def _read(path: str | Path) -> Outlines:
    """Return the outlines of an OSM file; arguments as of `read_osm`, errors as pyosmium raises them."""
    # By kind and id: the tags of what may stand, and its shape as WKB in hexadecimal.
    tags: dict[Key, dict[str, str]] = {}
    shapes: dict[Key, str] = {}
    areas = set()  # whether libosmium could assemble them or not
    closed, open_ways, missing = set[Key](), set[Key](), set[Key]()  # the last lack nodes
    lines: dict[int, shapely.Geometry] = {}  # of ways
    ways_of: dict[Key, list[int]] = {}  # of what has no shape
    of_members: dict[Key, dict[str, str]] = {}  # what relations of buildings say of their outlines
    to_wkb = osmium.geom.WKBFactory()
    processor = open_osm(path).with_areas(MAY_STAND).with_filter(MAY_STAND_OR_TYPE)

    def keep_line(way: Any) -> None:
        """Keep the line of a way, and whether it lacks nodes."""
        points = _points_of(way, processor.node_location_storage)
        lines[way.id] = _line_of(points)
        if len(points) < len(way.nodes):
            missing.add(("w", way.id))

    item: Any
    for item in processor:
        key = item.type_str(), item.id
        if item.is_area():
            key = "w" if item.from_way() else "r", item.orig_id()
            areas.add(key)
            if item.num_rings()[0] > 0:
                shapes[key] = to_wkb.create_multipolygon(item)
        elif item.is_node():
            shapes[key] = to_wkb.create_point(item)
        elif item.is_way():
            if item.is_closed():  # its area has its tags
                closed.add(key)
                continue
            open_ways.add(key)
            keep_line(item)
        else:
            of_type = item.tags.get("type")
            if of_type == BUILDING:
                members = [(each.type, each.ref) for each in item.members]
                outer = [(each.type, each.ref) for each in item.members if each.role in _OUTER]
                of_members |= dict.fromkeys(outer or members, _tags_of(item))
            if of_type not in _AREA_RELATIONS:
                continue
            may_stand = _may_stand(item.tags)
            # A bare one may be the outline in a relation of a building.
            if may_stand or len(item.tags) == 1:
                ways_of[key] = _ways_of(item)
            if not may_stand:
                continue
        tags[key] = _tags_of(item)

    # The lines of what else is no area. An `IdFilter` of them would take 4 MiB for each range of ids.
    lost = closed - areas
    no_shape = (tags.keys() | lost | of_members.keys()) - shapes.keys()
    ways_of |= {key: [key[1]] for key in no_shape if key[0] == "w"}
    ids = {way for key in no_shape for way in ways_of.get(key, ())} - lines.keys()
    for item in osmium.FileProcessor(_file(path), osmium.osm.WAY) if ids else ():
        if item.id in ids:
            keep_line(item)
            if ("w", item.id) in lost:
                tags["w", item.id] = _tags_of(item)

    # Outlines have what their relation says beside their own tags.
    for key, of_relation in of_members.items():
        own = tags.get(key, {})
        if "building:part" not in own:
            tags[key] = {"building": "yes"} | of_relation | own

    # What is no area is built from its lines; what does not close is these lines.
    degenerate = {
        key
        for key in lost - missing - of_members.keys()
        if shapely.build_area(lines[key[1]]).is_empty
    }
    num_repaired = 0
    for key in sorted(ways_of.keys() & tags.keys() - shapes.keys() - degenerate):
        known = [lines[way] for way in ways_of[key] if way in lines]
        shape = known[0] if len(known) == 1 else shapely.union_all(known)
        if key in areas or key in of_members:
            built = shapely.build_area(shapely.union_all(known))
            num_repaired += not built.is_empty
            shape = shape if built.is_empty else built
        if not shape.is_empty or key in areas:
            shapes[key] = shape.wkb_hex

    # Buildings that made no area are counted by what is wrong with them.
    names = {"building"}.union(*map(tags.__getitem__, shapes))
    columns = {name: np.full(len(shapes), None, object) for name in names}
    for index, key in enumerate(shapes):
        for name, value in tags[key].items():
            columns[name][index] = value
    buildings = {key for key in tags.keys() - areas if not tags[key].keys().isdisjoint(BUILDINGS)}
    box = header_box(path)
    return Outlines(
        polygons=shapely.from_wkb(np.array([*map(bytes.fromhex, shapes.values())], object)),
        tags=tags_of(columns),
        crs=WGS84,
        boxes=() if box is None else (box,),
        attribution=OSM_CREDIT,
        issues={
            ReadIssue.OPEN_WAYS: len(open_ways & buildings),
            ReadIssue.WAYS_WITH_MISSING_NODES: len(missing & buildings),
            ReadIssue.DEGENERATE_WAYS: len(degenerate & buildings),
            ReadIssue.RELATIONS_INCOMPLETE: sum(kind == "r" for kind, _ in buildings),
            ReadIssue.POLYGONS_REPAIRED: num_repaired,
        },
    )


def _tags_of(item: Any) -> dict[str, str]:
    """Return the tags of an object that say what stands."""
    if "building" in item.tags:  # with many others
        get = item.tags.get
        return {name: value for name in OF_BUILDINGS if (value := get(name)) is not None}
    return {name: value for name, value in item.tags if name in TAGS}


def _may_stand(tags: Any) -> bool:
    """Return whether an object with these tags may stand."""
    return any(key in tags for key in MAYBE)


def _points_of(way: osmium.osm.Way, places: Any) -> list[tuple[float, float]]:
    """Return longitude and latitude of the nodes of a way, those left out that a store of places lacks."""
    points = []
    for node in way.nodes:
        with suppress(KeyError):
            place = places.get(node.ref)
            points.append((place.lon, place.lat))
    return points


def _line_of(points: list[tuple[float, float]]) -> shapely.Geometry:
    """Return the line of points: a point of one, or empty; of a line that comes to a place again each side once."""
    if len(points) == 1:
        return shapely.Point(points)
    if len({*points}) < len(points) - 1:
        sides = {tuple(sorted(side)) for side in pairwise(points) if side[0] != side[1]}
        return shapely.MultiLineString(sorted(sides))
    return shapely.LineString(points)


def is_osm(path: str | Path) -> bool:
    """Return whether a file is one of OpenStreetMap by its name or its content."""
    is_named = str(path).lower().endswith(OSM_SUFFIXES)
    return is_named or (Path(path).is_file() and sniff(path) in OSM_SUFFIXES)


def format_of(path: str | Path) -> str:
    """Return pyosmium's name of the format of a file that it can read, by the content."""
    return "pbf" if sniff(path) == ".pbf" else "osm"


def _file(path: str | Path) -> osmium.io.File:
    """Return a file for pyosmium, whose format its content says."""
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


def header_box(path: str | Path) -> Bounds | None:
    """Return west, south, east, north in degrees of an OSM file by its header, None where the header does not say.

    JSON has no header.

    Raises:
      InputError: the file cannot be read.
    """
    if sniff(path) == ".osm.json":
        return None
    with (
        readable(path, "OpenStreetMap data", "fetch it again"),
        in_own_words(RuntimeError),
        unpacked(path) as plain,
        osmium.io.Reader(_file(plain), osmium.osm.NOTHING) as reader,
    ):
        box = reader.header().box()
    if not box.valid():
        return None
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def cut_buildings(source: Path, target: Path, box: Bounds) -> None:
    """Write what may stand and has a node in a box, with all that it refers to.

    Args:
      source: a PBF file, nodes before ways before relations.
      target: the PBF file to write; an old one is replaced.
      box: west, south, east, north in degrees.
    """
    # The member ways of a building relation need not bear the tag themselves.
    file = _file(source)
    of_relations: Any = osmium.FileProcessor(file, osmium.osm.RELATION)
    ways_of = {
        relation.id: {*_ways_of(relation)}
        for relation in of_relations.with_filter(MAY_STAND_OR_TYPE)
        if relation.tags.get("type") == BUILDING or _may_stand(relation.tags)
    }
    members = set[int]().union(*ways_of.values())
    near = {item.id for item in _in_box(file, IdFilter(members), box) if item.is_way()}
    to_cut = {relation for relation, ways in ways_of.items() if not near.isdisjoint(ways)}
    with osmium.BackReferenceWriter(
        osmium.io.File(str(target), "pbf"), ref_src=file, overwrite=True, remove_tags=False
    ) as writer:
        for item in _in_box(file, MAY_STAND, box):
            writer.add(item)
        for relation in of_relations.with_filter(IdFilter(to_cut)):
            writer.add(relation)


def _in_box(file: osmium.io.File, chosen: IdFilter | KeyFilter, box: Bounds) -> Iterator[Any]:
    """Yield the nodes and ways of a file that pass a filter and lie or have a node in a box.

    Args:
      file: sorted, with nodes before ways.
      chosen: the filter.
      box: west, south, east, north in degrees.
    """
    west, south, east, north = box
    processor = osmium.FileProcessor(file, osmium.osm.NODE | osmium.osm.WAY).with_locations()
    item: Any
    for item in processor.with_filter(chosen):
        nodes = item.nodes if item.is_way() else [item]
        places = (node.location for node in nodes if node.location.valid())
        if any(west <= place.lon <= east and south <= place.lat <= north for place in places):
            yield item


def read_land_cover(path: str | Path, crs: str, bounds_m: Bounds) -> LandCover:
    """Return the water and the parks of an OSM file within a box.

    Water is what is tagged so, and the sea: OSM draws its coast as lines with the land on their left, which are joined
    and cut out of the box here. Parks are parks, nature reserves, golf courses, cemeteries, forests and recreation
    grounds. Areas that cannot be assembled are left out.

    Args:
      path: as of `read_osm`.
      crs: projected CRS of the result, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box in that CRS.

    Raises:
      InputError: the file cannot be read to its end.
    """
    remedy = "fetch it again, or name another file in [study] land_cover"
    with plain_osm(path, remedy) as plain:
        rows, coast = areas_and_coast(plain)
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
    item: Any
    for item in open_osm(path).with_areas(areas).with_filter(TagFilter(*WATER, *PARK, COAST)):
        if item.is_area() and item.num_rings()[0] and has_tag(item, WATER + PARK):
            kind = "water" if has_tag(item, WATER) else "park"
            rows.append((kind, item.tags.get("name") or "", to_wkb.create_multipolygon(item)))
        elif item.is_way() and has_tag(item, (COAST,)):
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
