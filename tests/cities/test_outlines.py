"""Outlines: what is assembled from OpenStreetMap, which stand, and how high, and what is counted and refused."""

import math

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.heights import ROUGH, is_given, parse_count, parse_length_m
from jaxurban.cities.osm import read_osm
from jaxurban.cities.outlines import Outlines
from jaxurban.world.footprints import HeightOrigin
from tests.made_files import (
    LAT,
    LON,
    SQUARE,
    UTM,
    WGS84,
    X,
    Y,
    box,
    node,
    osm,
    refused,
    relation,
    way,
    write_features,
)

# Spellings from https://wiki.openstreetmap.org/wiki/Key:height; feet and inches by their definition (0.3048, 0.0254 m).
SPELLINGS = {
    0.0: ("0",),
    0.5: (".5",),
    3.6576: ("12'", "10-12 ft"),
    3.81: ("12'6\"", "12' 6", "12′6″", "12’6”", "12'6''", "12 ft 6 in", "12'-6\""),
    5.0: ("3;5", "unknown;5"),
    6.096: ("3 m; 20 ft",),
    7.0: ("7 metres", "7 meter"),
    3.0: ("+3",),
    12.0: ("12", "10-12", "12 - 10 m"),
    12.192: ("40 ft", "40ft", "40 feet"),
    12.5: ("12.5 m", "12,5"),
    30.0: ("~30", "ca. 30 m", ">30", "≥ 30", "about 30", "approx 30", "approx. 30 m", "20 to 30"),
    228.6: ("228.6M",),
    241.0: (" 241m ",),
    1230.5: ("1 230.5", "1\u2009230,5 m"),
    math.nan: (
        "",
        "high",
        "-5",
        "1e2",
        "12 km",
        "12 6",
        "5 storeys",
        "inf",
        "nan",
        '6"',
        ";",
        "10-",
    ),
}


@pytest.mark.parametrize(
    ("text", "length_m"), [(text, m) for m, texts in SPELLINGS.items() for text in texts]
)
def test_a_spelling_gives_its_length_in_metres(text, length_m):
    assert parse_length_m(text) == pytest.approx(length_m, abs=1e-12, nan_ok=True)


def test_what_is_rough_by_its_own_words_is_known():
    rough = ("~30", "ca. 30", "about 30 ft", ">30", "+30", "30-40", "3; 4-5")
    exact = ("30", "30 m", "12'6\"", "3;5", "1 230", "-5", "high")
    found = [ROUGH.search(text) is not None for text in rough + exact]
    assert found == [True] * len(rough) + [False] * len(exact)


def test_numbers_alone_are_in_the_unit_of_their_column():
    lengths_m = [parse_length_m(text, 0.3048) for text in ("100", "80-100", "100 m", "100 ft")]
    assert lengths_m == pytest.approx([30.48, 30.48, 100, 30.48], abs=1e-12)


def test_levels_are_bare_numbers():
    assert [parse_count(text) for text in ("5", "2.5", "2,5", "1;4", "~3")] == [5, 2.5, 2.5, 4, 3]
    assert all(math.isnan(parse_count(text)) for text in ("5 m", "5'", "3-4", "-1", "many"))


FILE = ju.Buildings("city.osm", default_height_m=10)


def stand(polygons, boxes=(), crs=UTM, **columns):
    """Return the buildings of outlines, the declared boxes, and what was counted beside the reader's own count."""
    tags = {name: np.array(values, object) for name, values in columns.items()}
    outlines = Outlines(np.array(polygons, object), tags, crs, boxes, {"open_ways": 7})
    buildings, _, boxes_m, issues, _ = to_buildings(FILE, outlines, UTM)
    assert issues.pop("open_ways") == 7
    return buildings, boxes_m, {name: count for name, count in issues.items() if count}


def over(*parts, height="50", part_height="30", **columns):
    """An outline of 10 x 10 m and parts."""
    num = len(parts)
    kinds = {"building": ["yes"] + [None] * num, "part": [None] + ["yes"] * num}
    return (
        {"polygons": [box(0, 0, 10, 10), *parts], "height": [height] + [part_height] * num}
        | kinds
        | columns
    )


def on_one_square(num, **columns):
    return {"polygons": [box(0, 0, 1, 1)] * num} | columns


NO_HEIGHTS = ("0", "-3", "tall", "1001", "9999 ft", 0, -1.0, 5000.0)
ROOFS = {"levels": ["4", "0", None, "4"], "roof_levels": ["1", "1", "2", "?"]}


@pytest.mark.parametrize(
    ("tags", "height_m", "issues"),
    [
        ({"height": ["20", None, None], "levels": ["3", "3", None]}, [20, 9, 10], {}),
        ({"height": ["828"]}, [828], {}),  # of the highest known building
        *(
            ({"height": [bad], "levels": ["4"]}, [12], {"heights_unusable": 1})
            for bad in NO_HEIGHTS
        ),
        *(({"levels": [bad]}, [10], {"levels_unusable": 1}) for bad in ("0", "-1", "some", "400")),
        (ROOFS, [15, 3, 10, 12], {"levels_unusable": 1}),
        (
            {"height": [12, np.float32(7.5), None, math.nan, "  ", [3]]},
            [12, 7.5, *[10] * 4],
            {"heights_unusable": 1},
        ),
    ],
)
def test_what_cannot_be_used_falls_to_levels_or_the_default_and_is_counted(tags, height_m, issues):
    buildings, _, found = stand(**on_one_square(len(height_m), **tags))
    np.testing.assert_allclose(buildings.height_m, height_m)
    assert found == issues


UNDERSIDES = {"min_height": ["5", "x", None, "0"], "min_level": ["1", "2", "2", None]}
WHOLE, WEST, EAST = box(0, 0, 10, 10), box(0, 0, 5, 10), box(5, 0, 10, 10)
REPLACED = {"outlines_replaced_by_parts": 1}
OF_TWO = {
    "building": ["yes", "yes", None],
    "part": [None, None, "yes"],
    "height": ["40", "60", None],
}
NO = {
    "building": ["no", "yes", "no", "false", None],
    "part": [None, "no", "yes", None, None],
    "height": list("12345"),
}
LAYERS = {
    "building": ["yes"] * 6,
    "location": ["underground", "indoor", None, None, None, None],
    "layer": [None, None, "-1", "2", "0", "ground"],
    "height": list("123456"),
}
CASES = {
    "covered to nine tenths": (over(WEST, box(5, 0, 9, 10)), [], [30, 30], REPLACED),
    "covered less": (over(WEST, box(5, 0, 8.9, 10)), [50], [30, 30], {}),
    "parts that overlap count once": (over(box(0, 0, 6, 10), box(0, 0, 6, 10)), [50], [30, 30], {}),
    # A podium of 100 x 100 m around a tower of 10 x 10 m that is mapped as a building of its own.
    "a neighbour's part": (
        over(box(-50, -50, 50, 50), height="200", part_height="10"),
        [200],
        [10],
        {},
    ),
    "a part in a tunnel": (
        over(WHOLE, location=[None, "underground"]),
        [50],
        [],
        {"underground": 1},
    ),
    "a layer orders": (over(WHOLE, layer=["1", "-1"]), [], [30], REPLACED),
    "an outline that is a part too": (
        on_one_square(2, building=["yes", "yes"], part=["yes", None], height=["8", "9"]),
        *([], [8], REPLACED),
    ),
    "tagged no": (
        NO | {"polygons": [box(2 * i, 0, 2 * i + 1, 1) for i in range(5)]},
        [2],
        [3],
        {"not_standing": 3},
    ),
    "underground, and other layers": (
        on_one_square(6, **LAYERS),
        [2, 3, 4, 5, 6],
        [],
        {"underground": 1},
    ),
    "no column says what is a building": (on_one_square(2, height=["1", None]), [1, 10], [], {}),
    "parts without height take their outline's": (
        over(WEST, EAST, part_height=None),
        *([], [50, 50], REPLACED | {"parts_given_outline_height": 2}),
    ),
    "a part takes the highest of its outlines": (
        OF_TWO | {"polygons": [WHOLE, box(0, 0, 20, 20), box(1, 1, 9, 5)]},
        *([40, 60], [60], {"parts_given_outline_height": 1}),
    ),
    "neither part nor outline has a height": (
        over(WHOLE, height=None, part_height=None),
        [],
        [10],
        REPLACED,
    ),
}


@pytest.mark.parametrize(("columns", "outlines_m", "parts_m", "issues"), CASES.values(), ids=CASES)
def test_outlines_give_way_to_parts_that_cover_them_and_what_is_no_building_is_left_out(
    columns, outlines_m, parts_m, issues
):
    buildings, _, found = stand(**columns)
    assert buildings.height_m[~buildings.is_part].tolist() == outlines_m
    assert buildings.height_m[buildings.is_part].tolist() == parts_m
    assert found == issues


def test_the_height_that_a_part_takes_from_its_outline_has_its_origin():
    origins = [
        stand(**over(WHOLE, height=of, part_height=None))[0].origin.tolist() for of in ("50", None)
    ]
    assert origins == [[HeightOrigin.HEIGHT], [HeightOrigin.DEFAULT]]


@pytest.mark.parametrize(
    ("columns", "min_height_m", "height_m", "issues"),
    [
        (over(WHOLE, min_height=[None, "12"]), [12], [30], REPLACED | {"parts_hanging": 1}),
        # An estimated roof is raised above its underside; an underside above a tagged roof is a fault.
        (
            on_one_square(2, levels=[None, "2"], min_height=["18", "20"]),
            [18, 20],
            [28, 26],
            {"parts_hanging": 2},
        ),
        (
            on_one_square(4, **UNDERSIDES),
            [5, 6, 6, 0],
            [10] * 4,
            {"min_heights_unusable": 1, "parts_hanging": 3},
        ),
        (
            on_one_square(2, height=["5", "5"], min_height=["5", "9"]),
            [0, 0],
            [5, 5],
            {"min_heights_above_roof": 2},
        ),
    ],
)
def test_undersides_are_kept_below_roofs(columns, min_height_m, height_m, issues):
    buildings, _, found = stand(**columns)
    assert (buildings.min_height_m.tolist(), buildings.height_m.tolist()) == (
        min_height_m,
        height_m,
    )
    assert found == issues


def test_a_bow_tie_is_repaired_and_a_line_is_unknown():
    bow_tie = shapely.Polygon([(X, Y), (X + 10, Y + 10), (X + 10, Y), (X, Y + 10)])
    line = shapely.Polygon([(X, Y), (X + 10, Y), (X, Y), (X, Y)])
    buildings, _, issues = stand(
        [bow_tie, line, None, shapely.Polygon(), shapely.force_3d(box(0, 0, 1, 1), 99.0)]
    )
    assert shapely.is_valid(buildings.polygons).all()
    assert not shapely.has_z(buildings.polygons).any()
    assert shapely.area(buildings.polygons) == pytest.approx([50, 1])
    assert issues == {"polygons_repaired": 1, "polygons_dropped": 2, "unknown_extent": 1}


def test_outlines_that_the_crs_cannot_hold_are_left_out_and_counted():
    buildings, _, issues = stand([SQUARE, shapely.box(15, 0, 16, 1)], crs=WGS84)
    assert (len(buildings), issues) == (1, {"outside_crs": 1})


def test_the_boxes_that_a_file_declares_come_in_the_citys_crs_and_without_buildings_are_an_empty_city():
    declared = (X, Y, X + 9, Y + 9)
    assert stand([box(1, 2, 3, 4)], [declared])[1] == [pytest.approx(declared)]
    assert stand([box(1, 2, 3, 4)])[1] == []
    buildings, boxes_m, _ = stand([], [declared])
    assert (len(buildings), boxes_m) == (0, [pytest.approx(declared)])
    with pytest.raises(ju.InputError, match=r"city\.osm.*holds no building"):
        stand([])


SIDE = 0.001  # degrees, of the square whose corners are nodes 1 to 4


def corners_of(first, x=0, y=0, side=1):
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    places = [(LON + (x + side * a) * SIDE, LAT + (y + side * b) * SIDE) for a, b in corners]
    return "".join(node(first + i, *place) for i, place in enumerate(places))


def read(tmp_path, *elements, boxes=()):
    """Return the outlines of OSM elements in XML."""
    (tmp_path / "city.osm").write_text(osm(*elements, boxes=boxes))
    return read_osm(tmp_path / "city.osm")


def test_a_closed_way_is_an_area_with_its_tags_also_before_its_nodes(tmp_path):
    tags = {"building": "yes", "building:levels": "5", "roof:levels": "1"}
    elements = corners_of(1), way(9, [1, 2, 3, 4, 1], **tags)
    for either in (elements, reversed(elements)):  # the Overpass API writes ways before nodes
        outlines = read(tmp_path, *either)
        assert (
            shapely.area(shapely.symmetric_difference(outlines.polygons[0], SQUARE))
            < 1e-9 * SQUARE.area
        )
        assert outlines.column("levels").tolist() == ["5"]
        assert outlines.column("roof_levels").tolist() == ["1"]
        assert outlines.column("height").tolist() == [None]
        assert not any(outlines.issues.values())


def test_what_may_stand_is_read_in_any_case_in_lists_and_of_a_site(tmp_path):
    things = (
        {"highway": "Street_Lamp"},
        {"highway": "crossing;street_lamp"},
        {"natural": "Cliff"},
        {"location": "underground;overhead"},
        {"est_height": "30"},
    )
    read_things = [node(10 + i, LON, LAT, **tags) for i, tags in enumerate(things)]
    site = way(9, [1, 2, 3, 4, 1]), relation(8, [(9, "")], type="site", historic="castle")
    others = node(20, LON, LAT, highway="crossing"), node(21, LON, LAT, natural="water_tap")
    outlines = read(tmp_path, corners_of(1), *read_things, *others, *site)
    assert len(outlines.polygons) == len(things) + 1
    castle = outlines.polygons[outlines.texts("historic") == "castle"]
    assert shapely.area(castle) == pytest.approx([SQUARE.area])


@pytest.mark.parametrize("value", ["gantry", "Gantry", "crossing;gantry"])
def test_a_gantry_is_read_of_a_way_in_any_case_and_in_lists(tmp_path, value):
    corners = [node(30 + i, LON + 1e-4 * i, LAT) for i in range(2)]
    lines = way(50, [30, 31], highway=value), way(51, [31, 30], highway="residential")
    outlines = read(tmp_path, corners_of(1), *corners, *lines)
    assert outlines.texts("highway").tolist().count(value.lower()) == 1
    assert "residential" not in outlines.texts("highway")


def test_relations_of_any_type_stand_by_their_tags_as_their_members_lie(tmp_path):
    deck = way(9, [1, 2, 3, 4, 1]), relation(20, [(9, "outline")], type="bridge", man_made="bridge")
    wires = way(11, [1, 3]), relation(21, [(11, "")], type="power", power="line")
    outlines = read(tmp_path, corners_of(1), *deck, *wires)
    assert shapely.area(outlines.polygons).tolist() == pytest.approx([SQUARE.area, 0])
    assert outlines.texts("power").tolist() == ["", "line"]


def test_nodes_are_found_in_any_order_of_their_numbers_and_between_ways(tmp_path):
    numbers = [10_100, 7, 30, 102, 90_000, 5, 2_000]
    elements = []
    for place, number in enumerate(numbers):
        ring = [number, number + 1, number + 2, number + 3, number]
        corners = corners_of(number, x=2 * place)
        elements += [corners, way(place + 1, ring, building="yes")]
    outlines = read(tmp_path, *elements)
    assert len(outlines.polygons) == len(numbers)
    assert shapely.area(outlines.polygons) == pytest.approx(outlines.polygons[0].area)
    assert not any(outlines.issues.values())


COURT = (
    *(
        corners_of(1, side=4),
        corners_of(5, x=1, y=1),
        way(11, [1, 2, 3]),
        way(12, [3, 4, 1]),
        way(13, [5, 6, 7, 8, 5]),
    ),
    relation(20, [(11, "outer"), (12, "outer"), (13, "inner")], building="yes"),
)
AREAS = {
    "a relation has its court": (COURT, [15], {}),
    "no tag of a building": ([way(9, [1, 2, 3, 4, 1], craft="unheard_of")], [], {}),
    "open ways": (
        [way(9, [1, 2, 3, 4], building="yes"), way(10, [1, 2, 3], highway="path")],
        [0],
        {"open_ways": 1},
    ),
    "a missing node": (
        [way(9, [1, 2, 99, 3, 4, 1], building="yes")],
        [0],
        {"ways_with_missing_nodes": 1},
    ),
    "two corners": ([way(9, [1, 2, 1], **{"building:part": "yes"})], [], {"degenerate_ways": 1}),
    "a missing member": (
        [way(11, [1, 2, 3]), relation(20, [(11, "outer"), (12, "outer")], building="yes")],
        [0],
        {"relations_incomplete": 1},
    ),
    "a wood with a missing member": (
        [
            way(11, [1, 2, 3, 4, 1]),
            relation(20, [(11, "outer"), (12, "outer")], natural="wood"),
        ],
        [0],
        {},
    ),
    "a relation that only groups parts": (
        [
            way(11, [1, 2, 3, 4, 1], building="yes"),
            relation(20, [(11, "outline")], type="building", building="yes"),
        ],
        [1],
        {},
    ),
    "a relation whose outline has no role": (
        [
            way(11, [1, 2, 3, 4, 1]),
            relation(20, [(11, "")], type="building", building="yes"),
        ],
        [1],
        {"polygons_repaired": 1},
    ),
    "a relation of a relation": (
        [
            way(11, [1, 2, 3, 4, 1]),
            relation(20, [(11, "outer")]),
            relation(21, [(20, "outline")], type="building", building="yes").replace(
                'member type="way"', 'member type="relation"'
            ),
        ],
        [1],
        {"relations_incomplete": 1, "polygons_repaired": 1},
    ),
    "a closed way that is no area": (
        [way(9, [1, 2, 3, 4, 1], building="yes", area="no")],
        [0],
        {},
    ),
    "a way that crosses itself": (
        [way(9, [1, 3, 2, 4, 1], building="yes")],
        [0.5],
        {"polygons_repaired": 1},
    ),
    "a ring of a relation that crosses itself": (
        [way(11, [1, 3, 2, 4, 1]), relation(20, [(11, "outer")], building="yes")],
        [0.5],
        {"polygons_repaired": 1},
    ),
}


@pytest.mark.parametrize(("elements", "squares", "issues"), AREAS.values(), ids=AREAS)
def test_areas_are_assembled_and_what_makes_none_is_counted(tmp_path, elements, squares, issues):
    outlines = read(tmp_path, *([] if elements is COURT else [corners_of(1)]), *elements)
    assert shapely.area(outlines.polygons) == pytest.approx(np.array(squares) * SIDE**2)
    assert {name: count for name, count in outlines.issues.items() if count} == issues


def test_an_area_that_cannot_be_rebuilt_is_of_unknown_extent(tmp_path):
    outlines = read(tmp_path, corners_of(1), way(9, [1, 2, 1, 2, 1], building="yes"))
    assert len(outlines.polygons) == 1
    buildings, structures, *_ = to_buildings(ju.Buildings("city.osm"), outlines, "EPSG:32618")
    assert (len(buildings), structures.kinds.tolist()) == (0, ["unknown"])


def test_the_header_gives_the_first_box(tmp_path):
    boxes = [(-74.1, 40.6, -73.9, 40.8), (-73.8, 40.5, -73.7, 40.9)]
    found = [read(tmp_path, corners_of(1), boxes=boxes[:num]).boxes for num in range(3)]
    assert found == [(), (boxes[0],), (boxes[0],)]


# From the data's README, but for the number of outlines replaced, which is kept as a record of what was seen.
FILES = {  # CRS; buildings, those with a height, with levels only, parts, as far as said; and what was counted
    # Of Lower Manhattan's 9,938 buildings three are lines.
    "lower-manhattan": ("EPSG:32618", [9935, 9393, 145, 3135], (70, 0, 328)),
    "boston-back-bay": ("EPSG:32619", [4028, 66, 558], (0, 0, 36)),
    "helsinki": ("EPSG:32635", [446, 16], (0, 54, 10)),
}


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_counts_of_a_real_file_agree_with_its_readme(data_dir, name):
    crs, known, issues = FILES[name]
    path = data_dir / "osm" / f"{name}.osm.pbf"
    outlines = read_osm(path)
    buildings, _, _, found, _ = to_buildings(ju.Buildings(path), outlines, crs)
    areas = outlines.take(shapely.get_dimensions(outlines.polygons) == 2)
    building, part, height, levels = (
        is_given(areas.column(n)) for n in ("building", "part", "height", "levels")
    )
    areas = (building, building & height, building & ~height & levels, part & ~building)
    assert [area.sum() for area in areas][: len(known)] == known
    counted = (
        "open_ways",
        "ways_with_missing_nodes",
        "outlines_replaced_by_parts",
        "heights_unusable",
    )
    assert [found[each] for each in counted] == [*issues, 0]
    assert shapely.is_valid(buildings.polygons).all()
    assert np.all(buildings.height_m > buildings.min_height_m)
    if name == "lower-manhattan":  # One World Trade Center: spire and tower
        assert outlines.boxes[0] == pytest.approx((-74.031, 40.695, -73.968, 40.730), abs=1e-6)
        spire = buildings.polygons[np.argmax(buildings.height_m)]
        near = buildings.take(shapely.dwithin(buildings.polygons, spire.centroid, 40.0))
        assert near.height_m.max() == 541.0
        assert 417.0 in near.height_m


@pytest.mark.data
@pytest.mark.parametrize("share", [0.001, 0.3, 0.7, 0.999])
def test_a_pbf_that_is_cut_short_is_refused(data_dir, tmp_path, share):
    whole = (data_dir / "osm" / "helsinki.osm.pbf").read_bytes()
    refused(read_osm, tmp_path / "cut.osm.pbf", whole[: int(share * len(whole))], "cut short")


def test_a_way_that_goes_round_many_times_is_the_area_of_one_round(tmp_path):
    crossed = [1, 3, 2, 4]  # libosmium makes no area of it
    once = read(tmp_path, corners_of(1), way(9, [*crossed, 1], building="yes"))
    often = read(tmp_path, corners_of(1), way(9, [*crossed * 3000, 1], building="yes"))
    assert shapely.equals(once.polygons[0], often.polygons[0])
    assert once.polygons[0].area > 0


def test_an_outline_with_a_vertex_that_is_no_number_is_of_unknown_extent():
    is_second = np.arange(len(SQUARE.exterior.coords))[:, None] == 1
    bad = shapely.transform(SQUARE, lambda lonlat: np.where(is_second, np.nan, lonlat))
    polygons = np.array([SQUARE, bad])
    outlines = Outlines(polygons, {}, "EPSG:4326", (), "")
    buildings, unknown, *_ = to_buildings(ju.Buildings("city.osm"), outlines, "EPSG:32618")
    assert (len(buildings), unknown.kinds.tolist()) == (1, ["unknown"])
    (whole,) = buildings.polygons
    (hull,) = unknown.polygons
    assert shapely.area(hull & whole) == pytest.approx(whole.area / 2, rel=0.2)


def test_an_outline_with_a_place_that_is_no_number_is_counted_as_left_out(tmp_path):
    ring = [[LON, LAT], [LON + 0.001, None], [LON + 0.001, LAT + 0.001], [LON, LAT]]
    lost = {"type": "Polygon", "coordinates": [ring]}
    near = shapely.box(LON, LAT, LON + 0.001, LAT + 0.001)
    file = write_features(tmp_path / "town.geojson", (near, {"height": 9}), (lost, {"height": 80}))
    city = ju.City.from_files(file, bounds=near.bounds)
    assert (len(city.buildings), city.read_issues["polygons_dropped"]) == (1, 1)
