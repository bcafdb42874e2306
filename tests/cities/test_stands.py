"""What of a file's features stands: buildings, other structures, the unknown, and what is left out and why."""

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, box

import jaxurban as ju
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.columns import tags_of
from jaxurban.cities.kinds import Nothing
from jaxurban.cities.osm import read_osm
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.rules import BY_VALUE, KINDS, OF_AREAS, RULES
from jaxurban.world.footprints import HeightOrigin
from tests.made_files import line, node, osm, relation, way

UTM = "EPSG:32618"
AREA = box(0, 0, 10, 10)
WAY = LineString([(0, 0), (30, 0)])
PLACE = Point(5, 5)
YARD = box(0, 0, 12, 12)
COMPANIONS = {"artwork_type": {"tourism": "artwork"}}  # keys that come with others
# The octagon around a circle of a radius of 1: its area, and how far its corners lie.
CROWN = 8 * np.tan(np.pi / 8)
WIDE = 1 / np.cos(np.pi / 8)


def stand(*features, **rules):
    """Return buildings, structures and what was counted, of features: a shape in metres and its tags each."""
    names = {"building", *(name for _, tags in features for name in tags)}
    columns = {
        name: np.array([tags.get(name) for _, tags in features], object) for name in sorted(names)
    }
    shapes = np.array([shape for shape, _ in features], object)
    outlines = Outlines(shapes, tags_of(columns), UTM, ((0.0, 0.0, 1.0, 1.0),), {})
    file = ju.Buildings("city.osm", **{"default_height_m": 10.0} | rules)
    buildings, structures, _, issues, _ = to_buildings(file, outlines, UTM)
    return buildings, structures, {name: count for name, count in issues.items() if count}


@pytest.mark.parametrize(
    ("shape", "tags", "kind", "height_m", "upper_m", "area_m2"),
    [
        (AREA, {"man_made": "chimney", "height": "180"}, "chimney", 180, 180, 100),
        (AREA, {"man_made": "storage_tank", "height": "18 m"}, "tank", 18, 18, 100),
        (AREA, {"man_made": "tower"}, "tower", 30, np.inf, 100),
        (AREA, {"man_made": "storage_tank"}, "tank", 10, 30, 100),
        (PLACE, {"man_made": "crane", "height": "60"}, "crane", 60, 60, np.pi * 25),
        (PLACE, {"man_made": "silo", "diameter": "8"}, "tank", 20, np.inf, np.pi * 16),
        (PLACE, {"man_made": "pipeline", "diameter": "400"}, "unknown", 0, 50, np.pi),
        (PLACE, {"man_made": "silo", "diameter": "0"}, "tank", 20, np.inf, np.pi * 100),
        (PLACE, {"power": "tower"}, "pylon", 30, 100, np.pi * 16),
        (
            PLACE,
            {"power": "generator", "height:hub": "90", "rotor:diameter": "100"},
            "turbine",
            140,
            140,
            np.pi * 2500,
        ),
        (WAY, {"man_made": "gantry", "height": "8"}, "canopy", 8, 8, 60 + np.pi),
        # What no table knows stands with a height, and is unknown where it has an area alone.
        (AREA, {"man_made": "monument_of_a_kind", "height": "40"}, "structure", 40, 40, 100),
        (AREA, {"man_made": "monument_of_a_kind"}, "unknown", 0, 50, 100),
        (PLACE, {"man_made": "thing"}, "unknown", 0, 50, np.pi),
        (WAY, {"power": "thing"}, "unknown", 0, 50, 60 + np.pi),
        (WAY, {"man_made": "beam"}, "canopy", 6, 15, 60 + np.pi),
        # A wheel is half as wide as it is high, and as wide as others where its height is not known.
        (
            PLACE,
            {"attraction": "big_wheel", "height": "135"},
            "structure",
            135,
            135,
            np.pi * 67.5**2,
        ),
        (PLACE, {"attraction": "drop_tower"}, "unknown", 0, 200, np.pi * 900),
        (AREA, {"roller_coaster": "track"}, "unknown", 0, 200, 100),
        (PLACE, {"historic": "monument"}, "unknown", 0, 60, np.pi * 25),
        (PLACE, {"historic": "maritime", "height": "7 units"}, "unknown", 0, np.inf, np.pi),
        (WAY, {"historic": "citywalls"}, "unknown", 0, 30, 120 + np.pi * 4),
        (AREA, {"barrier": "wall"}, "unknown", 0, 10, 80 - 4 + np.pi),  # around a yard
        (WAY, {"barrier": "retaining_wall", "height": "8"}, "structure", 8, 8, 60 + np.pi),
        (WAY, {"barrier": "kerb;thing"}, "unknown", 0, 50, 60 + np.pi),
        (WAY, {"telecom": "line"}, "wire", 10, 30, 60 + np.pi),
        (PLACE, {"telecom": "antenna", "communication": "line"}, "wire", 10, 50, np.pi),
        (WAY, {"man_made": "pipeline", "location": "overhead"}, "unknown", 0, 50, 60 + np.pi),
        (WAY, {"location": "overhead"}, "unknown", 0, 30, 120 + np.pi * 4),
        (PLACE, {"location": "overhead", "man_made": "surveillance"}, "unknown", 0, 15, np.pi),
        (PLACE, {"highway": "street_lamp"}, "unknown", 0, 15, np.pi),
        (PLACE, {"highway": "street_lamp", "height": "9"}, "structure", 9, 9, np.pi),
        (PLACE, {"pipeline": "substation"}, "unknown", 0, 50, np.pi),
        # What is not in use stands, whatever its key.
        (PLACE, {"disused:attraction": "big_wheel"}, "unknown", 0, 200, np.pi * 900),
        (WAY, {"abandoned:barrier": "city_wall"}, "unknown", 0, 30, 120 + np.pi * 4),
        (PLACE, {"disused:bridge:support": "pylon"}, "unknown", 0, 350, np.pi * 25),
        (AREA, {"abandoned:historic": "castle"}, "unknown", 0, 50, 100),
        (PLACE, {"disused:railway": "water_tower"}, "mast", 30, np.inf, np.pi * 25),
        (AREA, {"abandoned:leisure": "stadium"}, "unknown", 0, 150, 100),
        (AREA, {"abandoned:military": "bunker"}, "unknown", 0, 100, 180 + np.pi * 4),
        (AREA, {"disused:shop": "supermarket"}, "unknown", 0, 100, 180 + np.pi * 4),
        # Towers of ski jumps, and what carries antennas.
        (WAY, {"piste:type": "ski_jump"}, "unknown", 0, 150, 300 + np.pi * 25),
        (PLACE, {"communication:mobile_phone": "yes"}, "unknown", 0, 100, np.pi * 25),
        # Not a form of the land; a height in words; a generator, of wind perhaps; a shaft, and a booth.
        (PLACE, {"natural": "arch", "height": "25"}, "structure", 25, 25, np.pi),
        (PLACE, {"tourism": "artwork", "height": "tall"}, "unknown", 0, 50, np.pi),
        (PLACE, {"power": "generator"}, "unknown", 0, np.inf, np.pi * 2500),
        (PLACE, {"power": "generator", "height": "9"}, "structure", 9, 9, np.pi),
        (
            PLACE,
            {"power": "generator", "generator:type": "horizontal_axis"},
            "turbine",
            100,
            np.inf,
            np.pi * 2500,
        ),
        (PLACE, {"man_made": "mineshaft"}, "unknown", 0, 50, np.pi),
        (PLACE, {"barrier": "toll_booth"}, "unknown", 0, 50, np.pi),
        (WAY, {"natural": "cliff"}, "unknown", 0, 50, 60 + np.pi),
        (PLACE, {"bridge:support": "pylon"}, "unknown", 0, 350, np.pi * 25),
        (PLACE, {"historic": "memorial", "height": "25"}, "structure", 25, 25, np.pi),
        (PLACE, {"man_made": "cross", "height": "34"}, "structure", 34, 34, np.pi),
        (PLACE, {"man_made": "cross", "height": "34 units"}, "unknown", 0, np.inf, np.pi),
        (AREA, {"disused:man_made": "chimney"}, "chimney", 30, np.inf, 100),
        (
            AREA,
            {"was:building": "yes", "man_made": "chimney", "height": "60"},
            "chimney",
            60,
            60,
            100,
        ),
        (PLACE, {"man_made": "thing;mast"}, "mast", 20, np.inf, np.pi),
        (PLACE, {"tower:type": "communication"}, "mast", 30, np.inf, np.pi * 25),
        (
            PLACE,
            {"power": "generator", "generator:source": "wind"},
            "turbine",
            100,
            np.inf,
            np.pi * 2500,
        ),
        (AREA, {"man_made": "gasometer", "height": "40", "barrier": "fence"}, "tank", 40, 40, 100),
        (AREA, {"man_made": "works", "height": "12"}, "structure", 12, 12, 100),
        # A fence around a yard stands on its border.
        (WAY, {"barrier": "fence", "height": "30"}, "structure", 30, 30, 60 + np.pi),
        (AREA, {"barrier": "fence", "height": "30"}, "structure", 30, 30, 80 - 4 + np.pi),
        (AREA, {"man_made": "bridge"}, "bridge", 5.5, 100, 100),
        (
            LineString([(90, 0), (0, 0), (0, 10), (90, 10)]),  # the border of one that is cut off
            {"man_made": "bridge"},
            "bridge",
            5.5,
            100,
            900,
        ),
        # Crowns, octagons around a circle: as wide as they say, else 0.8 times as wide as the tree is
        # high; a trunk's diameter is none.
        (
            PLACE,
            {"natural": "tree", "height": "20", "diameter_crown": "6"},
            "tree",
            20,
            20,
            CROWN * 9,
        ),
        (PLACE, {"natural": "tree", "height": "20", "diameter": "90"}, "tree", 20, 20, CROWN * 64),
        (PLACE, {"natural": "tree"}, "tree", 7, 35, CROWN * 2.8**2),
        (WAY, {"natural": "tree_row", "height": "10"}, "tree", 10, 10, 30 * WIDE * 8 + CROWN * 16),
        (AREA, {"natural": "wood"}, "wood", 20, 45, 100),
        (AREA, {"landuse": "forest", "height": "12"}, "wood", 12, 12, 100),
        (LineString([(0, 0), (10, 0), (10, 10)]), {"landuse": "forest"}, "wood", 20, 45, 50),
        (WAY, {"power": "line"}, "wire", 30, 100, 30 * 30 + np.pi * 225),
        (WAY, {"power": "minor_line", "height": "9", "min_height": "8"}, "wire", 9, 9, 132.6),
        (WAY, {"aerialway": "gondola"}, "cableway", 30, np.inf, 300 + np.pi * 25),
        (PLACE, {"kind": "Wood"}, "wood", 20, 45, np.pi * 100),
        (AREA, {"type": "crane"}, "crane", 30, np.inf, 100),
        # A building that is not whole: the hull of what is known of it.
        (LineString([(0, 0), (10, 0), (10, 10)]), {"building": "yes"}, "unknown", 0, 100, 130.8),
        (PLACE, {"building": "garage"}, "unknown", 0, 25, np.pi * 4),
        # Its levels bound it as they bound a whole one.
        (WAY, {"building": "yes", "building:levels": "7"}, "structure", 21, 52, 120 + np.pi * 4),
    ],
)
def test_structures_stand_with_a_height_or_an_upper_bound(
    shape, tags, kind, height_m, upper_m, area_m2
):
    buildings, structures, _ = stand((shape, tags))
    assert len(buildings) == 0
    assert structures.kinds.tolist() == [kind]
    assert structures.height_m.tolist() == pytest.approx([height_m])
    assert structures.upper_m.tolist() == pytest.approx([upper_m])
    assert shapely.area(structures.polygons) == pytest.approx([area_m2], rel=0.02)
    is_known = upper_m == height_m
    assert structures.is_guessed.tolist() == [not is_known]


@pytest.mark.parametrize(
    ("tags", "reason"),
    [
        ({"building": "no"}, "not_buildings"),
        ({"building": "yes", "location": "underground"}, "underground"),
        ({"building:part": "yes", "level": "-1"}, "underground"),
        ({"building:part": "yes", "level": "-2;-1"}, "underground"),
        ({"building": "yes", "building:levels": "0", "building:levels:underground": "2"},
         "underground"),
        ({"building": "parking", "parking": "underground"}, "underground"),
        ({"man_made": "pipeline", "height": "8", "location": "underground"}, "underground"),
        ({"demolished:building": "yes", "height": "40"}, "razed"),
        ({"demolished:man_made": "chimney", "height": "40"}, "razed"),
        ({"waterway": "waterfall", "height": "40"}, "not_standing"),
        ({"building": "razed"}, "razed"),
        ({"proposed:building": "yes"}, "planned"),
        ({"man_made": "pier"}, "not_standing"),
        ({"man_made": "surveillance", "height": "5"}, "not_standing"),
        ({"power": "plant"}, "not_standing"),
        ({"barrier": "wall", "height": "2"}, "not_standing"),
        *(({"natural": kind, "height": "20", "building": ""}, "not_standing") for kind in ("peak", "ridge")),
        ({"barrier": "kerb", "height": "low", "building": ""}, "not_standing"),
        ({"power": "generator", "generator:source": "solar"}, "not_standing"),
        ({"removed:man_made": "tower"}, "razed"),
        *(({"barrier": kind}, "not_standing") for kind in ("kerb", "fence", "door", "hedge")),
        *(({"historic": kind}, "not_standing") for kind in ("memorial", "district")),
        ({"attraction": "maze"}, "not_standing"),
        ({"bridge": "no", "barrier": "kerb"}, "not_standing"),
        ({"highway": "street_lamp", "height": "4"}, "not_standing"),
        ({"indoor": "yes", "attraction": "dark_ride", "building": ""}, "not_buildings"),
        ({"natural": "scrub", "height": "4"}, "not_standing"),
        ({"power": "line", "location": "underground"}, "underground"),
    ],
)  # fmt: skip
def test_what_does_not_stand_is_counted_by_its_reason(tags, reason):
    buildings, structures, issues = stand((AREA, tags))
    assert (len(buildings), len(structures)) == (0, 0)
    assert issues == {reason: 1}


def test_what_no_table_knows_is_unknown_under_the_name_that_the_file_gives_it():
    things = {"man_made": "thing"}, {"barrier": "city_wall"}, {"historic": "yes", "man_made": "no"}
    _, structures, issues = stand(*((PLACE, tags) for tags in things))
    names = ["man_made=thing", "barrier=city_wall", "historic=yes"]
    assert structures.named.tolist() == structures.label.tolist() == names
    assert issues == {"unknown_extent": 3}
    assert structures.joined(structures).named.tolist() == 2 * names


@pytest.mark.parametrize("key", KINDS)
def test_a_value_of_a_key_that_is_in_no_row_is_never_nothing(key):
    names = (key, key[:10], key, key, key[:10])  # also as Shapefiles cut it
    for name, value in zip(names, ("yes", "yes", "never_heard_of", "1", "Yes;no"), strict=True):
        _, structures, _ = stand((PLACE, {name: value}))
        assert len(structures) == 1
        assert structures.upper_m[0] >= 10


def test_water_is_neither_counted_nor_does_it_stand():
    for tags in ({"natural": "water"}, {"natural": "coastline"}, {"waterway": "river"}):
        _, structures, issues = stand((AREA, {"building": "", **tags}))
        assert (len(structures), issues) == (0, {})


def test_what_a_building_is_beside_that_bounds_its_height():
    tags = {"building": "yes", "man_made": "chimney"}, {"building": "yes", "bridge:support": "pier"}
    buildings, *_ = stand(*((box(20 * i, 0, 20 * i + 9, 9), each) for i, each in enumerate(tags)))
    assert buildings.upper_m.tolist() == [np.inf, 350]


def test_around_a_mast_that_guys_hold_it_is_unknown_as_far_as_they_reach():
    mast = {"man_made": "mast", "height": "120", "tower:construction": "guyed_tube"}
    _, structures, _ = stand((PLACE, mast))
    assert structures.named.tolist() == ["mast", "guys"]
    assert structures.height_m.tolist() == [120, 0]
    assert structures.upper_m.tolist() == [120, 120]
    assert shapely.area(structures.polygons[1]) == pytest.approx(np.pi * 96**2, rel=0.02)


@pytest.mark.parametrize(
    "tags",
    [
        {"building": "yes", "layer": "-1"},  # orders, as under a viaduct
        {"building": "yes", "level": "-1;0;1"},
        {"building": "yes", "level": "-1-3"},
        {"building": "apartments", "parking": "underground"},
        {
            "building": "yes",
            "building:levels": "0",
            "building:levels:underground": "1",
            "roof:levels": "2",
        },
        {"building": "yes", "man_made": "no", "power": "3.1"},
        {"building": "ruins"},
        {"abandoned:building": "yes"},
        {"building": "yes", "man_made": "tower"},
        {"building": "yes", "demolished:building": "yes"},
        {"building": "yes", "parking": "underground", "height": "20"},
    ],
)
def test_what_may_stand_stands(tags):
    buildings, structures, issues = stand((AREA, tags))
    assert (len(buildings), len(structures), issues) == (1, 0, {})


def test_a_roof_of_guessed_height_has_an_upper_bound_by_levels_or_by_its_kind():
    kinds = ({"building": "yes"}, {"building": "house"}, {"building": "yes", "height": "9"})
    levels = {"building": "yes", "building:levels": "5"}
    hanging = {"building:part": "yes", "building:levels": "1", "min_height": "30"}
    features = [(box(20 * i, 0, 20 * i + 10, 10), tags) for i, tags in enumerate(kinds)]
    features += [(box(80, 0, 90, 10), levels), (box(100, 0, 110, 10), hanging)]
    buildings, *_ = stand(*features)
    assert buildings.height_m.tolist() == [10, 10, 9, 15, 33]
    # The part on 30 m has one level of at most 6 m, and 10 m on it.
    assert buildings.upper_m.tolist() == [100, 25, 9, 40, 46]


def test_an_outline_with_the_height_of_its_tower_ends_beside_its_parts():
    church = (box(0, 0, 60, 60), {"building": "church", "height": "80"})
    tower = (box(0, 0, 10, 10), {"building:part": "yes", "height": "80"})
    nave = (box(10, 0, 50, 60), {"building:part": "yes", "height": "15"})
    buildings, *_ = stand(church, tower, nave)
    assert buildings.height_m.tolist() == [15, 80, 15]
    assert buildings.upper_m.tolist() == [80, 80, 15]
    assert buildings.origin[0] == HeightOrigin.BESIDE_PARTS
    assert shapely.area(buildings.polygons).tolist() == [3600 - 100 - 2400, 100, 2400]
    # Higher than every part of it an outline is believed.
    higher, *_ = stand((church[0], church[1] | {"height": "90"}), tower, nave)
    assert higher.height_m.tolist() == [90, 80, 15]


@pytest.mark.parametrize(
    ("tags", "height_m", "upper_m"),
    [
        ({"height": "1,776 ft"}, 541.3248, 541.3248),
        ({"height": "180 \u043c"}, 180, 180),
        ({"building:height": "200"}, 200, 200),
        ({"est_height": "200"}, 200, 300),
        *(({"height": text}, 10, np.inf) for text in ("180 m AGL", "1500", "inf", "9999")),
        *(({"height": text}, 10, 100) for text in ("-1", "0", "NaN", "", "tall")),
    ],
)
def test_a_height_that_is_given_is_read_or_bounds_nothing(tags, height_m, upper_m):
    buildings, *_ = stand((AREA, {"building": "yes", **tags}))
    assert buildings.height_m.tolist() == pytest.approx([height_m])
    assert buildings.upper_m.tolist() == pytest.approx([upper_m])


def test_a_building_numbered_0_stands_and_a_flag_of_0_says_no():
    ids, *_ = stand((AREA, {"building": 0}), (AREA, {"building": 7}))
    flags, *_ = stand((AREA, {"building": 0}), (AREA, {"building": 1}))
    assert (len(ids), len(flags)) == (2, 1)


def test_a_strip_that_parts_leave_of_their_outline_stands():
    outline = (box(0, 0, 100, 100), {"building": "yes", "height": "50"})
    for width_m, areas_m2 in ((9, [900, 9100]), (1, [9900])):
        part = (box(0, width_m, 100, 100), {"building:part": "yes", "height": "50"})
        buildings, *_ = stand(outline, part)
        assert shapely.area(buildings.polygons).tolist() == areas_m2


def test_a_point_within_a_building_may_stand_on_its_roof():
    roof = (AREA, {"building": "yes", "height": "60"})
    _, mast, _ = stand(roof, (PLACE, {"man_made": "mast", "height": "20"}))
    assert (mast.height_m, mast.upper_m, mast.is_guessed) == (20, 80, True)


def test_a_tree_within_a_building_stands_in_its_yard():
    _, tree, _ = stand((AREA, {"building": "yes", "height": "60"}), (PLACE, {"natural": "tree"}))
    assert (tree.height_m, tree.upper_m) == (7, 35)


def test_a_wire_is_a_curtain_up_to_the_higher_of_its_two_supports():
    line = LineString([(0, 0), (300, 0), (600, 0), (600, 300), (600, 1000)])
    towers = [
        (Point(0, 0), {"power": "tower", "height": "40"}),
        (Point(300, 0), {"power": "tower", "height": "55"}),
        (Point(600, 0), {"power": "pole"}),
        (Point(600, 1000), {"power": "tower"}),
    ]
    _, structures, issues = stand((line, {"power": "line"}), *towers)
    spans = structures.take(structures.kinds == "wire")
    # Between the pole and a vertex without a support; and so long that nothing bounds its towers.
    assert spans.height_m.tolist() == [55, 55, 30, 30]
    assert spans.upper_m.tolist() == [55, 55, 100, np.inf]
    assert spans.is_guessed.tolist() == [False, True, True, True]
    for span, ends in zip(
        spans.polygons, zip(line.coords, line.coords[1:], strict=False), strict=True
    ):
        assert span.equals_exact(LineString(ends).buffer(15, quad_segs=8), 1e-6)
    assert issues == {"unknown_height": 5}
    # What is unknown beside a vertex carries nothing.
    _, structures, _ = stand((line, {"power": "line"}), (Point(0, 0), {"highway": "street_lamp"}))
    assert structures.height_m[structures.kinds == "wire"].tolist() == [30] * 4
    # A line with a height of its own keeps it.
    _, structures, _ = stand((line, {"power": "line", "height": "50"}), *towers)
    assert structures.height_m[structures.kinds == "wire"].tolist() == [50] * 4


def test_a_point_within_a_building_names_it():
    house = (AREA, {"building": "yes", "height": "12"})
    _, structures, _ = stand(house, (PLACE, {"building": "yes"}))
    assert len(structures) == 0
    _, structures, _ = stand(house, (Point(50, 50), {"building": "yes"}))
    assert structures.kinds.tolist() == ["unknown"]


def test_water_that_is_said_to_be_historic_or_made_is_water():
    lagoon = {"natural": "water", "historic": "yes", "man_made": "yes"}
    assert not len(stand((AREA, lagoon))[1])
    assert len(stand((AREA, lagoon | {"man_made": "never_heard_of"}))[1]) == 1
    assert len(stand((PLACE, lagoon))[1]) == 1


def test_a_level_below_the_ground_says_nothing_of_what_is_no_building_or_has_a_height():
    mast, (building, *_) = (
        stand((PLACE, {"man_made": "mast", "level": "-1"})),
        stand((AREA, {"building": "yes", "height": "30", "level": "-1"})),
    )
    assert mast[1].kinds.tolist() == ["mast"]
    assert building.height_m.tolist() == [30]


def test_an_unknown_barrier_fills_its_area_and_its_border_is_as_thick_as_a_line():
    _, structures, _ = stand((AREA, {"barrier": "never_heard_of"}))
    reach = shapely.buffer(AREA, 1.0)
    assert shapely.area(structures.polygons) == pytest.approx([reach.area], rel=0.01)


@pytest.mark.parametrize(
    ("shape", "tags", "kind", "height_m", "upper_m"),
    [
        # What another key names a building: a class guesses its height, or its levels do.
        (YARD, {"amenity": "parking", "parking": "multi-storey"}, "building", 10, 100),
        (YARD, {"amenity": "parking", "parking": "multi-storey", "parking:levels": "5"}, "building", 15, 40),
        (YARD, {"shop": "mall", "building:levels": "6"}, "building", 18, 46),
        (YARD, {"aeroway": "terminal"}, "building", 10, 100),
        (YARD, {"aeroway": "hangar", "height": "18"}, "building", 18, 18),
        (YARD, {"disused:aeroway": "hangar", "height": "18"}, "building", 18, 18),
        (YARD, {"railway": "signal_box"}, "building", 10, 100),
        (PLACE, {"aeroway": "hangar"}, "unknown", 0, 100),
        # Premises, of which the building may be a part, by their size.
        (YARD, {"amenity": "place_of_worship"}, "unknown", 0, 100),
        (box(0, 0, 20, 20), {"amenity": "place_of_worship"}, "unknown", 0, np.inf),
        (YARD, {"amenity": "place_of_worship", "height": "25"}, "structure", 25, 25),
        (YARD, {"shop": "supermarket"}, "unknown", 0, 100),
        (YARD, {"tourism": "Hotel"}, "unknown", 0, 100),
        (YARD, {"amenity": "fuel"}, "unknown", 0, 25),
        (YARD, {"leisure": "stadium"}, "unknown", 0, 150),
        (YARD, {"leisure": "bleachers"}, "unknown", 0, 25),
        # Over streets and rails.
        (WAY, {"highway": "gantry"}, "canopy", 6, 20),
        (PLACE, {"highway": "toll_gantry"}, "canopy", 6, 20),
        (WAY, {"railway": "signal_bridge"}, "canopy", 6, 20),
        (WAY, {"railway": "monorail"}, "bridge", 5.5, 100),
        (WAY, {"railway": "rail", "viaduct": "yes"}, "bridge", 5.5, 100),
        (PLACE, {"railway": "signal", "railway:signal:shunting:height": "dwarf"}, "unknown", 0, 15),
        # What stands by itself.
        (PLACE, {"advertising": "billboard"}, "unknown", 0, 50),
        (PLACE, {"advertising": "totem"}, "unknown", 0, 50),
        (PLACE, {"advertising": "column"}, "unknown", 0, 15),
        (PLACE, {"tourism": "artwork", "artwork_type": "statue"}, "unknown", 0, 60),
        (PLACE, {"tourism": "artwork"}, "unknown", 0, 50),
        (PLACE, {"historic": "memorial", "memorial": "obelisk"}, "unknown", 0, 60),
        (PLACE, {"historic": "memorial", "memorial": "war_memorial"}, "unknown", 0, 30),
        (PLACE, {"seamark:type": "light_minor"}, "unknown", 0, 30),
        (PLACE, {"seamark:type": "light_major"}, "unknown", 0, 150),
        (PLACE, {"seamark:type": "light_major", "seamark:light:height": "40"}, "structure", 40, 150),
        (PLACE, {"seamark:type": "crane"}, "crane", 30, np.inf),
        (PLACE, {"aeroway": "windsock"}, "pole", 10, 30),
        (AREA, {"aeroway": "control_tower"}, "tower", 30, np.inf),
        (PLACE, {"emergency": "siren"}, "unknown", 0, 30),
        (PLACE, {"amenity": "hunting_stand"}, "unknown", 0, 15),
        (WAY, {"waterway": "dam"}, "unknown", 0, 350),
        (PLACE, {"waterway": "lock_gate"}, "unknown", 0, 30),
    ],
)  # fmt: skip
def test_what_other_keys_than_building_name_stands_by_its_value(
    shape, tags, kind, height_m, upper_m
):
    buildings, structures, _ = stand((shape, tags))
    (stands,) = [each for each in (buildings, structures) if len(each)]
    assert stands.kinds.tolist() == [kind]
    assert stands.height_m.tolist() == pytest.approx([height_m])
    assert stands.upper_m.tolist() == pytest.approx([upper_m])


@pytest.mark.parametrize(
    ("shape", "tags", "reason"),
    [
        *((AREA, {"amenity": ground}, "not_standing") for ground in ("school", "university", "hospital", "parking")),
        *((AREA, {"leisure": ground}, "not_standing") for ground in ("pitch", "park", "playground", "garden")),
        (AREA, {"amenity": "parking", "parking": "surface"}, "not_standing"),
        (AREA, {"amenity": "parking", "parking": "street_side"}, "not_standing"),
        (AREA, {"amenity": "parking", "parking": "underground"}, "underground"),
        (AREA, {"amenity": "parking", "parking": "underground", "parking:levels": "3"}, "underground"),
        (AREA, {"tourism": "attraction"}, "not_standing"),
        (AREA, {"aeroway": "apron"}, "not_standing"),
        (AREA, {"demolished:building": "yes", "building:levels": "4"}, "razed"),
        (AREA, {"building": "no", "building:levels": "4"}, "not_buildings"),
        # A point of premises names a place in a building.
        *((PLACE, {"amenity": place}, "not_standing") for place in ("restaurant", "place_of_worship", "bench")),
        (PLACE, {"shop": "bakery"}, "not_buildings"),
        (PLACE, {"tourism": "artwork", "artwork_type": "mural"}, "not_standing"),
        (PLACE, {"historic": "memorial", "memorial": "plaque"}, "not_standing"),
        (PLACE, {"advertising": "poster_box"}, "not_standing"),
        (WAY, {"railway": "monorail", "tunnel": "yes"}, "underground"),
        (WAY, {"railway": "platform"}, "not_standing"),
    ],
)  # fmt: skip
def test_grounds_places_and_low_things_are_nothing_by_their_names(shape, tags, reason):
    buildings, structures, issues = stand((shape, {"building": "", **tags}))
    assert (len(buildings), len(structures)) == (0, 0)
    assert issues == {reason: 1}


@pytest.mark.parametrize(
    "tags",
    [
        {"amenity": "place_of_worship"},
        {"aeroway": "terminal"},
        {"shop": "mall"},
        {"leisure": "stadium"},
    ],
)
def test_what_holds_a_building_or_lies_in_one_is_its_ground_or_a_place_in_it(tags):
    house = {"building": "yes", "height": "12"}
    for shape in (box(-2, -2, 11, 11), box(2, 2, 8, 8), AREA):
        buildings, structures, _ = stand((AREA, house), (shape, tags))
        assert (buildings.height_m.tolist(), len(structures)) == ([12], 0)
    beside = stand((AREA, house), (box(10, 0, 20, 10), tags))
    assert len(beside[0]) + len(beside[1]) == 2


def test_a_house_makes_the_ground_of_premises_and_none_of_a_terminal_that_it_fills_a_sixth_of():
    house = AREA, {"building": "yes", "height": "12"}
    around = box(-10, -10, 15, 15)
    for tags, num in (
        ({"shop": "mall"}, 1),
        ({"aeroway": "terminal"}, 2),
        ({"leisure": "stadium"}, 2),
    ):
        assert sum(map(len, stand(house, (around, tags))[:2])) == num


@pytest.mark.parametrize(
    ("tags", "upper_m"),
    [
        ({"leisure": "stadium", "historic": "yes"}, 150),
        ({"waterway": "dam", "historic": "yes"}, 350),
        ({"waterway": "dam", "man_made": "yes"}, 350),
        ({"historic": "castle", "barrier": "wall"}, 50),
        ({"natural": "cliff", "barrier": "wall"}, 50),
        ({"seamark:type": "landmark", "historic": "yes"}, np.inf),
        ({"memorial": "statue", "tourism": "artwork"}, 60),
        ({"memorial": "statue", "artwork_type": "sculpture"}, 60),
        ({"memorial": "stele;statue"}, 60),
        ({"roller_coaster": "track", "barrier": "wall"}, 200),
        ({"amenity": "place_of_worship", "barrier": "wall"}, 100),
    ],
)
def test_more_tags_never_lower_a_bound(tags, upper_m):
    """The bound is the highest of the rules that hold, whichever decides on the kind."""
    _, structures, _ = stand((AREA, {"building": "", **tags}))
    assert structures.upper_m.max() == upper_m


@pytest.mark.parametrize(
    "tags",
    [
        {"leisure": "stadium"},
        {"parking": "multi-storey"},
        {"aeroway": "terminal"},
        {"shop": "mall"},
    ],
)
def test_what_holds_a_kiosk_or_lies_over_a_cellar_stands(tags):
    kiosk = (box(2, 2, 5, 5), {"building": "kiosk"})
    in_the_middle = (box(48, 48, 52, 52), {"building": "kiosk"})
    cellar = (box(-20, -20, 120, 120), {"building": "garage", "location": "underground"})
    for beside in (kiosk, in_the_middle, cellar):
        buildings, structures, _ = stand((box(0, 0, 100, 100), tags), beside)
        assert max(shapely.area(buildings.joined(structures).polygons)) >= 9_000


@pytest.mark.parametrize("height", ["?", "n/a", "-", "very tall", "forty m", "-5", "NaN", "None"])
@pytest.mark.parametrize(
    "tags", [{"leisure": "stadium"}, {"historic": "castle"}, {"highway": "street_lamp"}]
)
def test_a_height_that_says_nothing_takes_nothing_away(tags, height):
    _, plain, _ = stand((AREA, {"building": "", **tags}))
    _, structures, _ = stand((AREA, {"building": "", "height": height, **tags}))
    assert structures.named.tolist() == plain.named.tolist()
    assert structures.upper_m >= plain.upper_m


def test_what_is_no_building_by_its_tag_stands_by_its_height_and_by_other_tags():
    _, structures, _ = stand((AREA, {"building": "no", "height": "30"}))
    assert structures.height_m.tolist() == [30]
    _, structures, _ = stand((AREA, {"building": "no", "leisure": "stadium"}))
    assert structures.named.tolist() == ["leisure=stadium"]


def test_openstreetmap_keeps_what_else_a_building_or_what_is_none_is_called(tmp_path):
    tags = {"building": "no", "man_made": "tower"}, {"building": "hut", "historic": "tower"}
    things = [node(i, 8.5 + i / 100, 47.3, **about) for i, about in enumerate(tags)]
    (tmp_path / "city.osm").write_text(osm(*things))
    structures = to_buildings(ju.Buildings("city.osm"), read_osm(tmp_path / "city.osm"), UTM)[1]
    assert sorted(structures.upper_m) == [60, np.inf]


def test_a_hub_alone_does_not_say_how_high_blades_reach():
    _, structures, _ = stand((PLACE, {"power": "generator", "height:hub": "80"}))
    assert (structures.height_m.tolist(), structures.upper_m.tolist()) == ([80], [np.inf])
    assert structures.is_guessed.all()


def test_a_tram_that_is_called_a_pub_is_no_outline(tmp_path):
    ends = [node(i, 8.5 + i / 100, 47.3) for i in range(3)]
    ways = way(1, [0, 1, 2], amenity="pub"), way(2, [0, 1, 2, 0], amenity="pub", area="no")
    (tmp_path / "city.osm").write_text(osm(*ends, *ways))
    assert len(read_osm(tmp_path / "city.osm").polygons) == 0


def test_a_lamp_on_a_high_mast_may_reach_higher_than_one_on_a_pole(tmp_path):
    mounts = [{"lamp_mount": "high_mast"}, {}]
    lamps = [node(i, 8.5 + i / 100, 47.3, highway="street_lamp", **mounts[i]) for i in (0, 1)]
    (tmp_path / "city.osm").write_text(osm(*lamps))
    structures = to_buildings(ju.Buildings("city.osm"), read_osm(tmp_path / "city.osm"), UTM)[1]
    assert structures.upper_m.tolist() == [50, 15]


def test_a_stadium_that_is_a_point_keeps_flights_farther_away_than_a_lamp():
    _, structures, _ = stand((PLACE, {"building": "", "leisure": "stadium"}))
    x_min, _, x_max, _ = structures.polygons[0].bounds
    assert x_max - x_min == pytest.approx(200.0, rel=1e-3)


def test_an_extract_that_cuts_the_outline_of_a_lone_theatre_leaves_its_walls_unknown(tmp_path):
    corners = node(1, 8.5, 47.3), node(2, 8.501, 47.3)  # and not the third
    (tmp_path / "city.osm").write_text(osm(*corners, way(1, [1, 2, 3, 1], amenity="theatre")))
    outlines = read_osm(tmp_path / "city.osm")
    assert shapely.covers(outlines.polygons[0], LineString([(8.5, 47.3), (8.501, 47.3)]))
    structures = to_buildings(ju.Buildings("city.osm"), outlines, UTM)[1]
    assert structures.named.tolist() == ["amenity=theatre"]
    assert structures.upper_m.tolist() == [np.inf]


def test_a_relation_of_which_an_extract_lacks_a_way_is_unknown_where_the_others_are(tmp_path):
    corners = node(1, 8.5, 47.3), node(2, 8.501, 47.3), node(3, 8.501, 47.301)
    members = [(1, "outer"), (9, "outer")]
    whole = relation(5, members, amenity="theatre")
    (tmp_path / "city.osm").write_text(osm(*corners, way(1, [1, 2, 3]), whole))
    outlines = read_osm(tmp_path / "city.osm")
    structures = to_buildings(ju.Buildings("city.osm"), outlines, UTM)[1]
    assert structures.named.tolist() == ["amenity=theatre"]
    assert shapely.covers(outlines.polygons[0], LineString([(8.5, 47.3), (8.501, 47.301)]))


@pytest.mark.parametrize("artwork", [{"artwork_type": "kinetic"}, {}])
def test_art_of_a_type_that_is_not_listed_is_unknown_as_that_of_none_is(artwork):
    _, structures, _ = stand((PLACE, {"building": "", "tourism": "artwork", **artwork}))
    assert structures.upper_m.tolist() == [50]


def test_a_table_that_names_no_buildings_holds_some_whatever_they_are_used_for():
    uses = np.array(["school", "place_of_worship", "parking"], object)
    shapes = np.array([box(20 * i, 0, 20 * i + 9, 9) for i in range(3)], object)
    outlines = Outlines(shapes, tags_of({"amenity": uses}), UTM, ((0.0, 0.0, 1.0, 1.0),), {})
    buildings, structures, *_ = to_buildings(ju.Buildings("uses.gpkg"), outlines, UTM)
    assert (len(buildings), len(structures)) == (3, 0)


def test_a_file_of_openstreetmap_is_read_for_every_value_that_stands(tmp_path):
    tags = [(key, value, name) for key, rules in BY_VALUE.items() for value, name in rules.items()]
    stands = [row for row in tags if not isinstance(RULES[row[2]], Nothing)]
    points = [row for row in stands if OF_AREAS not in row[2]]
    assert len(stands) > len(points) + 100 > 200
    elements, wanted = [], []
    for number, (key, value, _) in enumerate(points, 1):
        elements.append(node(number, 8.5, 47.3, **COMPANIONS.get(key, {}), **{key: value}))
        wanted.append(("Point", key, value))
    for number, (key, value, _) in enumerate(stands, 1):
        west, north = 8.5 + number / 1000, 47.4
        ring = [(west, north), (west + 1e-4, north), (west, north + 1e-4), (west, north)]
        elements.append(line(number, ring, **COMPANIONS.get(key, {}), **{key: value}))
        wanted.append(("Polygon", key, value))
    (tmp_path / "city.osm").write_text(osm(*elements))
    outlines = read_osm(tmp_path / "city.osm")
    shapes = [shape.geom_type.removeprefix("Multi") for shape in outlines.polygons]
    shapes = ["Polygon" if shape == "LineString" else shape for shape in shapes]
    of_keys = {key: outlines.texts(key) for key in BY_VALUE}
    read = {(shape, key, of_keys[key][i]) for i, shape in enumerate(shapes) for key in BY_VALUE}
    assert {*wanted} <= read


@pytest.mark.parametrize(
    ("layer", "is_read"), [("1", 1), ("+1", 1), (" 1", 1), ("0", 0), ("-1", 0)]
)
def test_a_way_above_the_ground_is_read_however_its_layer_is_written(tmp_path, layer, is_read):
    way = line(1, [(8.5, 47.3), (8.501, 47.3)], highway="primary", layer=layer)
    (tmp_path / "city.osm").write_text(osm(way))
    assert len(read_osm(tmp_path / "city.osm").polygons) == is_read


def test_a_site_of_points_alone_stands_where_these_are(tmp_path):
    site = '<member type="node" ref="1" role=""/><tag k="type" v="site"/><tag k="tourism" v="artwork"/>'
    relation = f'<relation id="1" version="1">{site}</relation>'
    (tmp_path / "city.osm").write_text(osm(node(1, 8.5, 47.3), relation))
    outlines = read_osm(tmp_path / "city.osm")
    assert [shape.wkt for shape in outlines.polygons] == ["MULTIPOINT ((8.5 47.3))"]
