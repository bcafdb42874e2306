"""What stands in a random city, what its file says of it, and how: buildings, structures, and things that are nothing.

Of jaxurban nothing is imported here. Places are metres from the city's southwest corner, and the ground is flat.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.affinity import rotate, translate

SIDE_M, SLOT_M = 360.0, 60.0  # of a city, and of a square in which one thing stands
UNKNOWN_M = 40.0  # no flight so low over what stands with a height that nobody knows may be clean
LINE_M = 0.3  # beside what a file has of a wall
Tags = dict[str, Any]


class Prism(NamedTuple):
    """An upright prism: its outline, and the heights above the ground that it reaches from and to."""

    outline: shapely.Geometry
    top_m: float
    floor_m: float = -math.inf


class Record(NamedTuple):
    """An entry of a file.

    Attributes:
      shape: a Polygon, Point or LineString, or a MultiPolygon of the faces of a solid.
      tags: by OpenStreetMap's names, or by the columns of a table of the file's style.
      how: of OpenStreetMap, what is special about how it is drawn.
    """

    shape: shapely.Geometry
    tags: Tags
    how: str = ""


class Thing(NamedTuple):
    """Something that was planted.

    Attributes:
      edit: how the file holds it.
      records: of the file.
      core: what surely stands; empty of what is nothing.
      hull: what may be taken to stand. Between both a flight is not judged here.
      is_known: the file says how high all of the core is.
    """

    edit: str
    records: tuple[Record, ...]
    core: tuple[Prism, ...] = ()
    hull: tuple[Prism, ...] = ()
    is_known: bool = False


class Draw:
    """Draws things into one slot of a city."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.centre_m = (0.0, 0.0)

    def one_of(self, *values: Any) -> Any:
        """Return one of some values."""
        return values[self.rng.integers(len(values))]

    def uniform(self, low: float, high: float) -> float:
        """Return a number between two, with one decimal."""
        return round(float(self.rng.uniform(low, high)), 1)

    def box(self, low_m: float = 12.0, high_m: float = 28.0) -> shapely.Polygon:
        """Return a turned rectangle in the slot."""
        width_m, depth_m = self.uniform(low_m, high_m), self.uniform(low_m, high_m)
        return self.placed(shapely.box(-width_m / 2, -depth_m / 2, width_m / 2, depth_m / 2))

    def placed(self, *shapes: shapely.Geometry) -> Any:
        """Return shapes about the origin turned and moved into the slot, together."""
        angle = self.rng.uniform(0, 90)
        moved = [translate(rotate(shape, angle, (0, 0)), *self.centre_m) for shape in shapes]
        return moved if len(moved) > 1 else moved[0]


Maker = Callable[[Draw], tuple[Any, ...]]
EDITS: dict[str, tuple[Maker, frozenset[str]]] = {}  # and what a style must offer to hold each


def edit(*needs: str) -> Callable[[Maker], Maker]:
    """Register a maker, which returns a thing's fields but for its edit: records, core, hull and is_known."""

    def register(maker: Maker) -> Maker:
        EDITS[maker.__name__.replace("_", " ").strip()] = maker, frozenset(needs)
        return maker

    return register


def plant(draw: Draw, name: str) -> Thing:
    """Return a thing of an edit."""
    return Thing(name, *EDITS[name][0](draw))


def stands(shape: shapely.Geometry, height_m: float, tags: Tags, how: str = "") -> tuple[Any, ...]:
    """Return the fields of a thing that stands with a height that its file says."""
    prisms = (Prism(shape, height_m),)
    return (Record(shape, tags, how),), prisms, prisms, True


def unknown(
    shape: shapely.Geometry,
    tags: Tags,
    how: str = "",
    core: shapely.Geometry | None = None,
    hull: shapely.Geometry | None = None,
    top_m: float = UNKNOWN_M,
    most_m: float = math.inf,
) -> tuple[Any, ...]:
    """Return the fields of a thing that stands, and of which not all is known."""
    core = (Prism(shape if core is None else core, top_m),)
    return (Record(shape, tags, how),), core, (Prism(hull or shape, most_m),), False


def nothing(*records: Record) -> tuple[Any, ...]:
    """Return the fields of a thing that is no obstacle."""
    return (records,)


def text(height_m: float) -> str:
    """Return a height as people write it."""
    return f"{height_m:g}"


@edit()
def plain(draw):
    height_m = draw.one_of(6.0, 12.0, 25.0, 40.0, 90.0)
    return stands(draw.box(), height_m, {"building": "yes", "height": text(height_m)})


# How OpenStreetMap draws it.


@edit("xml")
def relation(draw):
    """Tags on a relation, its outline bare."""
    height_m = draw.uniform(25, 90)
    tags = {"type": "building", "building": "yes", "height": text(height_m)}
    return stands(draw.box(), height_m, tags, "relation")


@edit("xml")
def ring_of_ways(draw):
    height_m = draw.uniform(25, 90)
    tags = {"type": "multipolygon", "building": "yes", "height": text(height_m)}
    return stands(draw.box(), height_m, tags, "halves")


@edit("xml")
def negative_ids(draw):
    height_m = draw.uniform(12, 90)
    how = draw.one_of("negative", "negative nodes")
    return stands(draw.box(), height_m, {"building": "yes", "height": text(height_m)}, how)


def lacking(draw, how: str, left: slice, **more: str) -> tuple[Any, ...]:
    """Return a building of which the file lacks something: what is left are some corners of its ring."""
    shape, height_m = draw.box(), draw.uniform(25, 90)
    tags = {"building": "yes", "height": text(height_m)} | more
    line = shapely.LineString(np.array(shape.exterior.coords)[left])
    core = line.buffer(LINE_M, cap_style="flat")
    return unknown(shape, tags, how, core, shape.buffer(30), height_m, height_m)


@edit("xml")
def open_ring(draw):
    return lacking(draw, "open", slice(0, 4))


@edit("xml")
def missing_node(draw):
    return lacking(draw, "missing node", slice(0, 3))


@edit("xml")
def missing_member(draw):
    return lacking(draw, "missing member", slice(0, 3), type="multipolygon")


# What tags say.


@edit("tags")
def layer_below(draw):
    height_m = draw.uniform(12, 40)
    tags = {"building": "retail", "height": text(height_m), "layer": draw.one_of("-1", "-2")}
    return stands(draw.box(), height_m, tags)


@edit("tags")
def area_with_height(draw):
    kind = draw.one_of(
        *("chimney", "tower", "mast", "storage_tank", "silo"),
        *("water_tower", "crane", "gasometer"),
    )
    height_m = draw.uniform(18, 150)
    shape = draw.one_of(draw.box(6, 16), draw.placed(shapely.Point(0, 0).buffer(9)))
    return stands(shape, height_m, {"man_made": kind, "height": text(height_m)})


@edit("tags")
def area_without_height(draw):
    kind = draw.one_of("chimney", "tower", "mast", "silo", "water_tower", "crane", "gasometer")
    return unknown(draw.box(6, 16), {"man_made": kind}, top_m=15.0)


REACH_M = {"chimney": 25.0, "tower": 25.0, "mast": 40.0, "water_tower": 25.0, "crane": 80.0}


@edit("tags", "points")
def point_with_height(draw):
    kind, height_m = draw.one_of(*REACH_M), draw.uniform(30, 150)
    place = draw.placed(shapely.Point(0, 0))
    about = {"man_made": kind, "height": text(height_m)}
    core, hull = Prism(place.buffer(0.5), height_m), Prism(place.buffer(REACH_M[kind]), height_m)
    return (Record(place, about),), (core,), (hull,), True


@edit("tags", "points")
def point_without_height(draw):
    kind, place = draw.one_of(*REACH_M), draw.placed(shapely.Point(0, 0))
    hull = place.buffer(REACH_M[kind])
    return unknown(place, {"man_made": kind}, "", place.buffer(0.5), hull, top_m=15.0)


@edit("tags", "points")
def power_tower(draw):
    place, height_m = draw.placed(shapely.Point(0, 0)), draw.uniform(25, 60)
    about = {"power": "tower", "height": text(height_m)}
    return unknown(place, about, "", place.buffer(0.5), place.buffer(25), height_m)


@edit("tags", "points", "long names")
def wind_turbine(draw):
    place, height_m = draw.placed(shapely.Point(0, 0)), draw.uniform(80, 150)
    about = {"power": "generator", "generator:source": "wind", "height": text(height_m)}
    return unknown(place, about, "", place.buffer(0.5), place.buffer(100), height_m)


@edit("tags")
def unheard_of(draw):
    height_m = draw.uniform(15, 60)
    about = draw.one_of({"man_made": "frobnicator"}, {"building": "frobnicator"})
    shape = draw.box()
    return unknown(shape, about | {"height": text(height_m)}, top_m=height_m, most_m=height_m)


@edit("tags")
def height_in_words(draw):
    words, least_m = draw.one_of(("30-40", 40.0), (">30", 30.0), ("about 30", 30.0), ("+30", 30.0))
    return unknown(draw.box(), {"building": "yes", "height": words}, top_m=least_m)


@edit("tags")
def height_of_no_use(draw):
    words = draw.one_of("0", "-1", "unknown", "tall")
    return unknown(draw.box(), {"building": "yes", "height": words}, top_m=8.0)


@edit("tags", "long names")
def only_levels(draw):
    levels = draw.one_of(3, 5, 12)
    tags = {"building": "apartments", "building:levels": str(levels)}
    return unknown(draw.box(), tags, top_m=2.5 * levels)


@edit("tags")
def ruins(draw):
    kind, height_m = draw.one_of("ruins", "construction", "roof"), draw.uniform(8, 20)
    tags = {"building": kind, "height": text(height_m)}
    return unknown(draw.box(), tags, top_m=height_m, most_m=height_m)


def strips(draw, *parts_m: tuple[float, float]) -> tuple[shapely.Polygon, list[shapely.Polygon]]:
    """Return an outline of 36 m by 24 m, and strips across it that reach from and to."""
    boxes = [shapely.box(low - 18, -12, high - 18, 12) for low, high in parts_m]
    outline, *parts = draw.placed(shapely.box(-18, -12, 18, 12), *boxes)
    return outline, parts


THIRDS, TOPS_M = ((0, 12), (12, 24), (24, 36)), (15.0, 90.0, 15.0)


@edit("tags", "long names")
def only_parts(draw):
    _, parts = strips(draw, *THIRDS)
    records = [
        Record(part, {"building:part": "yes", "height": text(top_m)})
        for part, top_m in zip(parts, TOPS_M, strict=True)
    ]
    prisms = tuple(map(Prism, parts, TOPS_M))
    return tuple(records), prisms, prisms, True


@edit("tags", "long names")
def partly_in_parts(draw):
    """A church: the outline has its tower's height, and the rest beside tower and nave is not known."""
    outline, parts = strips(draw, (0, 8), (8, 21))
    rest = outline - shapely.union_all(parts)
    records = [Record(outline, {"building": "church", "height": "80"})]
    tops_m = (80.0, 15.0)
    for part, top_m in zip(parts, tops_m, strict=True):
        records.append(Record(part, {"building:part": "yes", "height": text(top_m)}))
    core = (*map(Prism, parts, tops_m), Prism(rest, 8.0))
    return tuple(records), core, (Prism(outline, 80.0),), False


# Nothing.


@edit("tags", "long names")
def underground(draw):
    about = draw.one_of(
        {"building": "yes", "location": "underground"},
        {"building": "retail", "level": "-1"},
        {"building:part": "yes", "level": "-1", "indoor": "room"},
        {"building": "yes", "building:levels": "0", "building:levels:underground": "2"},
        {"building": "parking", "parking": "underground"},
    )
    return nothing(Record(draw.box(), about))


@edit("tags", "long names")
def razed(draw):
    before = draw.one_of("demolished", "razed", "proposed", "was", "removed")
    return nothing(Record(draw.box(), {f"{before}:building": "yes", "height": "30"}))


@edit("tags")
def flat(draw):
    about = draw.one_of(
        *({"man_made": "pier"}, {"leisure": "park"}, {"amenity": "parking"}, {"building": "no"}),
        *({"man_made": "tunnel", "layer": "-1"}, {"landuse": "residential"}),
    )
    return nothing(Record(draw.box(), about))


@edit("tags", "points")
def no_obstacle(draw):
    place, line = draw.placed(shapely.Point(0, 0), shapely.LineString([(-20, 0), (20, 0)]))
    return nothing(
        draw.one_of(
            Record(place, {"man_made": "survey_point"}),
            Record(place, {"amenity": "bench"}),
            Record(line, {"man_made": "pier"}),
            Record(line, {"highway": "primary", "tunnel": "yes", "layer": "-1"}),
        )
    )


# Solids as faces, whose heights are in their third coordinate and in a column.


def upright(ring: shapely.Polygon, low_m: float, high_m: float) -> list[shapely.Polygon]:
    """Return the walls over a ring's sides."""
    places = list(ring.exterior.coords)
    return [
        shapely.Polygon([(*a, low_m), (*b, low_m), (*b, high_m), (*a, high_m)])
        for a, b in pairwise(places)
    ]


def lifted(shape: shapely.Polygon, height_m: float) -> shapely.Polygon:
    """Return a flat face at a height."""
    return shapely.force_3d(shape, height_m)


def solid(faces: list[shapely.Polygon], core: list[Prism], hull: Prism) -> tuple[Any, ...]:
    """Return the fields of a solid."""
    record = Record(shapely.MultiPolygon(faces), {"measuredHeight": hull.top_m})
    return (record,), tuple(core), (hull,), True


@edit("faces")
def block(draw):
    shape, top_m = draw.box(), draw.uniform(12, 60)
    faces = [lifted(shape, 0), *upright(shape, 0, top_m), lifted(shape, top_m)]
    return solid(faces, [Prism(shape, top_m)], Prism(shape, top_m))


@edit("faces")
def podium(draw):
    base, tower = draw.placed(shapely.box(-20, -20, 20, 20), shapely.box(-10, -8, 10, 12))
    low_m, top_m = draw.uniform(8, 14), draw.uniform(40, 90)
    faces = [lifted(base, 0), *upright(base, 0, low_m), lifted(base - tower, low_m)]
    faces += [*upright(tower, low_m, top_m), lifted(tower, top_m)]
    return solid(faces, [Prism(base, low_m), Prism(tower, top_m)], Prism(base, top_m))


@edit("faces")
def eaves(draw):
    walls, roof = draw.placed(shapely.box(-10, -10, 10, 10), shapely.box(-10.5, -10.5, 10.5, 10.5))
    eaves_m = draw.uniform(10, 25)
    faces = [lifted(walls, 0), *upright(walls, 0, eaves_m), lifted(roof, eaves_m)]
    return solid(faces, [Prism(walls, eaves_m)], Prism(roof, eaves_m))


@edit("faces")
def dormer(draw):
    walls, dormer = draw.placed(shapely.box(-10, -7, 10, 8), shapely.box(-3, -9, 3, -5))
    eaves_m = draw.uniform(9, 18)
    top_m = eaves_m + 3
    faces = [lifted(walls, 0), *upright(walls, 0, eaves_m), lifted(walls, eaves_m)]
    faces += [*upright(dormer, eaves_m, top_m), lifted(dormer, top_m)]
    core = [Prism(walls, eaves_m), Prism(dormer, top_m, eaves_m)]
    return solid(faces, core, Prism(walls | dormer, top_m))


# Overture Maps: buildings and their parts in one file, by its columns.


@edit("overture")
def overture_plain(draw):
    height_m = draw.uniform(8, 90)
    return stands(draw.box(), height_m, {"height": height_m})


@edit("overture")
def overture_parts(draw):
    outline, parts = strips(draw, *THIRDS)
    name = f"b{draw.rng.integers(10**6)}"
    records = [Record(outline, {"id": name, "height": 90.0, "has_parts": True})]
    for part, top_m in zip(parts, TOPS_M, strict=True):
        about = {"type": "building_part", "building_id": name, "height": top_m}
        records.append(Record(part, about))
    prisms = tuple(map(Prism, parts, TOPS_M))
    return tuple(records), prisms, prisms, True


@edit("overture")
def overture_floors(draw):
    floors = draw.one_of(3, 8)
    return unknown(draw.box(), {"num_floors": floors}, top_m=2.5 * floors)


@edit("overture")
def overture_below(draw):
    return nothing(Record(draw.box(), {"height": 12.0, "is_underground": True}))


# Official footprints, whose heights are in columns of their own: "height" is what the style names so.


@edit("column")
def column(draw):
    height_m = draw.uniform(12, 120)
    return stands(draw.box(), height_m, {"height": height_m})


@edit("column")
def column_left_open(draw):
    return unknown(draw.box(), {}, top_m=8.0)
