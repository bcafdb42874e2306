"""OpenStreetMap files: what may stand of them, assembled by pyosmium."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import osmium
import shapely
from osmium.filter import EmptyTagFilter, EntityFilter, KeyFilter
from osmium.geom import use_nodes

from jaxurban.cities.columns import ROUGH, tags_of
from jaxurban.cities.kinds import NOT_BUILT, OF_LIFE, STANDING, WATERS, Nothing
from jaxurban.cities.osm_plain import plain_osm
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.rules import ALONE, BY_VALUE, KINDS, LIVES, OF_AREAS, THINGS
from jaxurban.errors import readable
from jaxurban.io.issues import ReadIssue, ReadIssues
from jaxurban.io.sniff import in_own_words, sniff, unpacked
from jaxurban.world.footprints import BUILDING
from jaxurban.world.grid import WGS84, Bounds

Values = dict[str, frozenset[str]]  # by key
BUILDINGS = ("building", "building:part")  # keys
MAYBE = (  # keys of what may stand
    *(*BUILDINGS, "building:levels", "height", "building:height", *ROUGH, *KINDS),
    *(f"{life}:{key}" for key, lives in LIVES.items() if key not in BY_VALUE for life in lives),
    *(f"{life}:building" for life in NOT_BUILT),
)
SURE = {*MAYBE} - {"barrier"}  # whatever their value is
LOW_BARRIERS = {
    value for value, name in KINDS["barrier"].items() if isinstance(THINGS[name], Nothing)
}
# Values of keys of which others do not stand; what is water says which bridges cross it.
SOME: Values = {}
# Of points, lines and what is cut the names of grounds, places and low things are left out: there are many.
OF_OUTLINES: Values = {}
OF_POINTS: Values = {}
for key, rules in BY_VALUE.items():
    alone = {value for value, name in rules.items() if name in ALONE}
    of_areas = {value for value, name in rules.items() if OF_AREAS in name}
    for tag in key, *(f"{life}:{key}" for life in LIVES.get(key, ())):
        SOME[tag] = frozenset({*rules, *WATERS.get(key, ())})
        OF_OUTLINES[tag] = SOME[tag] - alone
        OF_POINTS[tag] = OF_OUTLINES[tag] - of_areas
METHODS = ("source:height", "height:source")  # which say how a height is known
OF_ALL = ("height", "est_height", "location", "level", "layer", *METHODS)
OF_BUILDINGS = (  # what `COLUMNS` sorts, of buildings
    *(*BUILDINGS, *OF_ALL, "building:height", "building:levels", "levels", "roof:levels"),
    *("building:levels:underground", "min_height", "building:min_level", "parking"),
    *("man_made", "tower:type", "bridge:support", "aerialway", "attraction", "roller_coaster"),
)
OF_LAMPS = ("highway", "lamp_mount", "amenity", "indoor", *OF_ALL)
OF_TREES = ("natural", "diameter_crown", *OF_ALL)
TAGS = {
    *(*OF_BUILDINGS, *OF_LAMPS, *OF_TREES, *MAYBE, *SOME, "parking:levels", "lanes", "tunnel"),
    *("bridge:structure", "bridge:movable", "tower:construction", "diameter", "width"),
    *("rotor:diameter", "height:hub", "power_source"),
    *("generator:source", "generator:method", "generator:type"),
    *(f"{life}:{key}" for life in NOT_BUILT for key in OF_LIFE),
}
CUT_DEG = 2e-5  # about 2 m, around what an extract has of an outline
TO_WKB = osmium.geom.WKBFactory()
Key = tuple[str, int]  # "n", "w" or "r", and an id
Tags = dict[str, str]  # of an object
OSM_SUFFIXES = (".pbf", ".osm", ".osm.json")  # of `sniff`
OSM_CREDIT = "© OpenStreetMap contributors"  # asked for by the ODbL
# Keys of filters, which pass some that `_may_stand` leaves out. They take as long as they have keys to ask for, so the
# commonest come first, those of what is out of use last, and those that come with others are left out. Gantries are
# asked for apart, as streets have their key.
LEFT_OUT = {"highway", "artwork_type", *ROUGH[1:]}
LIFE = tuple(f"{life}:" for life in (*STANDING, *NOT_BUILT))
ASKED_FOR = dict.fromkeys(
    key for key in (*BUILDINGS, *SOME, "layer", *MAYBE) if key not in LEFT_OUT
)
KEYS = sorted(ASKED_FOR, key=lambda key: key.startswith(LIFE))
MAY_STAND = KeyFilter(*KEYS)
OF_RELATIONS = KeyFilter(*KEYS)
OF_RELATIONS.enable_for(osmium.osm.RELATION)
POINTS = KeyFilter(
    "natural", "highway", "amenity", *(key for key in KEYS if OF_POINTS.get(key, True))
)
POINTS.enable_for(osmium.osm.NODE)
NO_WAYS = EntityFilter(osmium.osm.NODE | osmium.osm.RELATION | osmium.osm.AREA)


def read_osm(path: str | Path) -> Outlines:
    """Return what may stand of an OSM file: areas, lines and points with their tags.

    Coordinates are longitude and latitude; the box is the file header's (of several the first). Areas that
    libosmium cannot assemble (rings that cross themselves) are rebuilt from their lines, each loop filled; where
    these do not close, the lines are given as far as the file has them. Outlines of relations of the type building
    have the relations' tags beside their own. What pyosmium cannot read itself is read as `plain_osm` writes it.

    Args:
      path: the file: PBF, XML or JSON of the Overpass API, packed or not, of an editor too.

    Raises:
      InputError: the file cannot be read to its end.
    """
    with plain_osm(path, "fetch it again, or put it in order with `osmium sort`") as plain:
        objects = _Objects(plain)
        box = header_box(plain)
    return Outlines(
        polygons=objects.polygons,
        tags=tags_of(objects.columns),
        crs=WGS84,
        boxes=() if box is None else (box,),
        attribution=OSM_CREDIT,
        issues=objects.issues,
    )


class _Objects:
    """What may stand of an OSM file, by kind and id; errors as pyosmium raises them.

    Attributes:
      tags: those that say what stands.
      shapes: WKB in hexadecimal, as pyosmium makes it; at first those of `lamps`, and of the stands of hunters.
      areas: what libosmium takes for areas, whether it could assemble them or not, and sites.
      closed, open_ways: ways that may stand and are no areas.
      missing: ways that lack nodes.
      degenerate: closed ways of buildings that enclose nothing.
      cut: outlines that lack nodes or ways, and would stand as areas alone.
      wanted: the ids of ways whose lines are needed.
      lines: of ways, by id.
      ways_of: the ids of the ways of what has no shape.
      of_members: what relations of the type building say of their outlines.
      num_repaired: areas that were rebuilt from their lines.
    """

    def __init__(self, path: str | Path) -> None:
        """Read a file that pyosmium can read."""
        self.tags: dict[Key, Tags] = {}
        self.lamps: dict[Key, str] = {}
        self.shapes: dict[Key, str] = {}
        self.areas, self.closed, self.open_ways, self.missing = (set[Key]() for _ in range(4))
        self.cut: set[Key] = set()
        self.wanted: set[int] = set()
        self.lines: dict[int, shapely.Geometry] = {}
        self.ways_of: dict[Key, list[int]] = {}
        self.of_members: dict[Key, Tags] = {}
        self.num_repaired = 0
        self._read_objects(path)
        self._read_lines(path)
        self.degenerate = self._degenerate()
        self._inherit_tags()
        self._build_shapes()

    def _read_objects(self, path: str | Path) -> None:
        """Read what may stand, and relations of buildings."""
        processor = open_osm(path).with_areas(self, MAY_STAND).with_filter(NO_WAYS)
        for of_it in EmptyTagFilter(), OF_RELATIONS, POINTS:
            processor = processor.with_filter(of_it)
        self.places: Any = processor.node_location_storage
        keep = {"n": self._keep_node, "a": self._keep_area, "r": self._keep_relation}
        item: Any
        for item in processor:
            keep[item.type_str()](item)
        self.shapes = self.lamps | self.shapes

    def _keep_node(self, node: Any) -> None:
        """Keep a point that may stand."""
        tags = _tags_of(node.tags)
        if not _may_stand(tags, OF_POINTS):
            return
        key = "n", node.id
        self.tags[key] = tags
        is_lamp = _is_among(tags.get("highway", ""), OF_POINTS["highway"])
        if is_lamp or _is_among(tags.get("amenity", ""), OF_POINTS["amenity"]):
            self.lamps[key] = TO_WKB.create_point(node)
        else:
            self.shapes[key] = TO_WKB.create_point(node)

    def _keep_area(self, area: Any) -> None:
        """Keep an area that may stand, whether libosmium could assemble it or not."""
        key = "w" if area.from_way() else "r", area.orig_id()
        self.areas.add(key)
        tags = _tags_of(area.tags)
        if not _may_stand(tags):
            return
        self.tags[key] = tags
        if area.num_rings()[0] > 0:
            self.shapes[key] = TO_WKB.create_multipolygon(area)

    def way(self, way: Any) -> None:
        """Keep the line of a way that is asked for, and gantries, for which pyosmium calls this too."""
        if way.id in self.wanted:
            self._keep_line(way)
        if _is_among(way.tags.get("highway", ""), SOME["highway"]):  # in any case, and in lists
            self._keep_way(way)

    def _keep_way(self, way: Any) -> None:
        """Keep a way that may stand and is no area; a closed one that lacks nodes is kept as a cut outline."""
        key = "w", way.id
        if key in self.areas:
            return
        tags = _tags_of(way.tags)
        is_closed = way.is_closed()
        may_stand = _may_stand(tags, OF_POINTS)
        if not may_stand and not (is_closed and _may_stand(tags, OF_OUTLINES)):
            return
        lacks_nodes = self._keep_line(way)
        if may_stand:
            ways = self.closed if is_closed else self.open_ways
            ways.add(key)
        elif lacks_nodes:
            self.cut.add(key)
        else:
            return
        self.tags[key] = tags
        self.ways_of[key] = [way.id]

    def relation(self, relation: Any) -> None:
        """Keep the members of a building's relation and of a bare one, for which pyosmium calls this at first."""
        tags = relation.tags
        if tags.get("type") == BUILDING:
            of_it = [*_all_of(relation.members)]
            outer = [each for each in of_it if each.role in ("outline", "outer")]
            members = [(each.type, each.ref) for each in outer or of_it]
            self.of_members |= dict.fromkeys(members, _tags_of(tags))
        elif len(tags) == 1:  # it may be the outline in a relation of a building
            self._keep_ways_of(relation)

    def _keep_ways_of(self, relation: Any) -> None:
        """Keep the ids of the ways of a relation."""
        members = _all_of(relation.members)
        self.ways_of["r", relation.id] = [each.ref for each in members if each.type == "w"]

    def _keep_relation(self, relation: Any) -> None:
        """Keep a relation that may stand itself, or of which a part may."""
        key = "r", relation.id
        tags = _tags_of(relation.tags)
        of_type = relation.tags.get("type")
        is_area = of_type == "multipolygon"
        if is_area and _may_stand(tags, OF_OUTLINES) and not _may_stand(tags, OF_POINTS):
            self.cut.add(key)
        if of_type == BUILDING or not _may_stand(tags):
            return
        self.tags[key] = tags
        self._keep_ways_of(relation)
        if of_type not in ("site", "bridge"):
            return
        self.areas.add(key)
        members = _all_of(relation.members)
        points = self._places(each.ref for each in members if each.type == "n")
        if points and not self.ways_of[key]:
            self.shapes[key] = shapely.MultiPoint(points).wkb_hex

    def _places(self, nodes: Iterable[int]) -> list[tuple[float, float]]:
        """Return the longitudes and latitudes of those nodes of some ids that are known."""
        points = []
        for node in nodes:
            with suppress(KeyError):
                place = self.places.get(node)
                points.append((place.lon, place.lat))
        return points

    def _keep_line(self, way: Any) -> bool:
        """Keep the line of a way; return whether it lacks nodes."""
        lacks_nodes = False
        try:
            line = shapely.from_wkb(bytes.fromhex(TO_WKB.create_linestring(way, use_nodes.ALL)))
        except (RuntimeError, osmium.InvalidLocationError):  # without the places of its nodes
            places = [node.location for node in _all_of(way.nodes)]
            points = [(place.lon, place.lat) for place in places if place.valid()]
            line = shapely.Point(points) if len(points) == 1 else shapely.LineString(points)
            lacks_nodes = len(points) < len(way.nodes)
        if lacks_nodes:
            self.missing.add(("w", way.id))
        self.lines[way.id] = _each_side_once(line)
        return lacks_nodes

    def _read_lines(self, path: str | Path) -> None:
        """Read ways that may stand and are no areas, and the lines of what else has no shape.

        Ways that the filter passes come to the loop; for the others pyosmium calls `way`.
        """
        self._want_lines()
        places = osmium.NodeLocationsForWays(self.places)
        places.ignore_errors()  # extracts lack nodes
        ways = osmium.FileProcessor(_file(path), osmium.osm.WAY).with_filter(places)
        item: Any
        for item in ways.with_filter(MAY_STAND).handler_for_filtered(self):
            if item.id in self.wanted:
                self._keep_line(item)
            self._keep_way(item)

    def _want_lines(self) -> None:
        """Note the ways, and those of relations, of what has no shape. An `IdFilter` takes 4 MiB a range of ids."""
        no_shape = (self.tags.keys() | self.of_members.keys()) - self.shapes.keys()
        self.ways_of |= {key: [key[1]] for key in no_shape if key[0] == "w"}
        for key in no_shape:
            self.wanted.update(self.ways_of.get(key, ()))

    def _degenerate(self) -> set[Key]:
        """Return the closed ways of buildings that enclose nothing."""
        whole = self.closed - self.missing - self.of_members.keys()
        buildings = [key for key in whole if not self.tags[key].keys().isdisjoint(BUILDINGS)]
        areas = shapely.build_area([self.lines[number] for _, number in buildings])
        return {key for key, area in zip(buildings, areas, strict=True) if area.is_empty}

    def _inherit_tags(self) -> None:
        """Give outlines what their relation says beside their own tags."""
        for key, of_relation in self.of_members.items():
            own = self.tags.get(key, {})
            if "building:part" not in own:
                self.tags[key] = {"building": "yes"} | of_relation | own

    def _build_shapes(self) -> None:
        """Build the shapes of what is no area; an area of which no line is known stands without a shape."""
        no_shape = (self.ways_of.keys() & self.tags.keys()) - self.shapes.keys() - self.degenerate
        built: dict[Key, shapely.Geometry] = {}
        for key in sorted(no_shape):
            shape = self._shape_of(key)
            if not shape.is_empty or key in self.areas:
                built[key] = shape
        self.shapes |= zip(built, shapely.to_wkb([*built.values()], hex=True), strict=True)

    def _shape_of(self, key: Key) -> shapely.Geometry:
        """Return the area that the lines of an object enclose, the hull of a cut outline, else the lines."""
        known = [self.lines[way] for way in self.ways_of[key] if way in self.lines]
        lines = known[0] if len(known) == 1 else shapely.union_all(known)
        if key in self.areas or key in self.of_members:
            area = shapely.build_area(shapely.union_all(known))
            self.num_repaired += not area.is_empty
            return lines if area.is_empty else area
        if key in self.cut:
            return shapely.buffer(shapely.convex_hull(lines), CUT_DEG)
        return lines

    @property
    def polygons(self) -> np.ndarray:
        """``[N]`` the shapes, in the order of `columns`."""
        return shapely.from_wkb([*map(bytes.fromhex, self.shapes.values())])

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """``[N]`` the tags of what has a shape, by name, None where one is missing; in the order of `polygons`."""
        missing = np.full(len(self.shapes), None, object)
        columns = defaultdict(missing.copy, building=missing.copy())
        for row, key in enumerate(self.shapes):
            for name, value in self.tags[key].items():
                columns[name][row] = value
        return columns

    @property
    def issues(self) -> ReadIssues:
        """Buildings that made no area, by what is wrong with them, and how many areas were rebuilt."""
        no_area = self.tags.keys() - self.areas
        buildings = {key for key in no_area if not self.tags[key].keys().isdisjoint(BUILDINGS)}
        return {
            ReadIssue.OPEN_WAYS: len(self.open_ways & buildings),
            ReadIssue.WAYS_WITH_MISSING_NODES: len(self.missing & buildings),
            ReadIssue.DEGENERATE_WAYS: len(self.degenerate),
            ReadIssue.RELATIONS_INCOMPLETE: sum(kind == "r" for kind, _ in buildings),
            ReadIssue.POLYGONS_REPAIRED: self.num_repaired,
        }


def _tags_of(tags: Any) -> Tags:
    """Return those tags of an object that say what stands."""
    named = {name: value for name, value in _all_of(tags) if name in TAGS}
    if named.get("natural") != "tree":
        return named
    return {name: named[name] for name in OF_TREES if name in named}  # not its trunk's diameter


def _all_of(items: Any) -> Iterator[Any]:
    """Return the items of a list of pyosmium, which takes as long to find its end as for ten of them."""
    return islice(items, len(items))


def _may_stand(tags: Tags, some: Values = SOME) -> bool:
    """Return whether an object with these tags (`_tags_of`) may stand, of some keys by their values."""
    if not tags.keys().isdisjoint(SURE) or tags.get("barrier", "kerb") not in LOW_BARRIERS:
        return True
    for key, text in tags.items():
        if key in some and _is_among(text, some[key]):
            return True
    return tags.get("layer", "0").lstrip(" +") > "0" and ("highway" in tags or "railway" in tags)


@lru_cache(maxsize=2**13)
def _is_among(text: str, values: frozenset[str]) -> bool:
    """Return whether a value, or one of a list with semicolons, is one of some, in any case."""
    return any(word.strip().lower() in values for word in text.split(";"))


def _each_side_once(line: shapely.Geometry) -> shapely.Geometry:
    """Return a line, or of one that comes to a place again each side once."""
    points = [*map(tuple, shapely.get_coordinates(line).tolist())]
    if len({*points}) < len(points) - 1:
        sides = {tuple(sorted(side)) for side in pairwise(points) if side[0] != side[1]}
        return shapely.MultiLineString(sorted(sides))
    return line


def is_osm(path: str | Path) -> bool:
    """Return whether a file is one of OpenStreetMap by its name or its content."""
    is_named = str(path).lower().endswith(OSM_SUFFIXES)
    return is_named or (Path(path).is_file() and sniff(path) in OSM_SUFFIXES)


def _file(path: str | Path) -> osmium.io.File:
    """Return a file for pyosmium, whose format its content says."""
    return osmium.io.File(str(path), "pbf" if sniff(path) == ".pbf" else "osm")


def open_osm(path: str | Path) -> osmium.FileProcessor:
    """Return a processor that knows every node's place when a way comes by, even if the nodes follow the ways.

    In XML, as the Overpass API writes it, they may, in any order; its nodes are read before. PBF files are sorted.
    """
    file = _file(path)
    locations: Any  # the package's own annotation says str
    if sniff(path) == ".pbf":
        locations = osmium.index.create_map("flex_mem")
    else:
        locations = osmium.index.create_map("sparse_mem_map")  # of nodes in any order
        with osmium.io.Reader(file, osmium.osm.NODE) as reader:
            osmium.apply(reader, osmium.NodeLocationsForWays(locations))
    return osmium.FileProcessor(file).with_locations(locations)


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
        in_own_words(),
        unpacked(path) as plain,
        osmium.io.Reader(_file(plain), osmium.osm.NOTHING) as reader,
    ):
        box = reader.header().box()
    if not box.valid():
        return None
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat
