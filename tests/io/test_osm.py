"""OpenStreetMap files: what is assembled, what is counted, what is refused."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.heights import is_given
from jaxurban.io.read.osm import read_osm
from jaxurban.io.read.outlines import to_buildings
from jaxurban.settings import Buildings
from tests.io.made_files import LAT, LON, SQUARE, node, osm, relation, way

SIDE = 0.001  # degrees, of the square whose corners are nodes 1 to 4


def square(first, x=0, y=0, side=1):
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    places = [(LON + (x + side * a) * SIDE, LAT + (y + side * b) * SIDE) for a, b in corners]
    return "".join(node(first + i, *place) for i, place in enumerate(places))


@pytest.fixture
def read(tmp_path):
    """Read the outlines of OSM elements in XML."""

    def read_elements(*elements, boxes=()):
        (tmp_path / "city.osm").write_text(osm(*elements, boxes=boxes))
        return read_osm(tmp_path / "city.osm", "osm")

    return read_elements


def test_a_closed_way_is_an_area_with_its_tags_also_before_its_nodes(read):
    tags = {"building": "yes", "building:levels": "5", "roof:levels": "1"}
    elements = square(1), way(9, [1, 2, 3, 4, 1], **tags)
    for outlines in (read(*elements), read(*reversed(elements))):  # the Overpass API writes ways before nodes
        assert shapely.area(shapely.symmetric_difference(outlines.polygons[0], SQUARE)) < 1e-9 * SQUARE.area
        assert outlines.column("levels").tolist() == ["5"]
        assert outlines.column("roof_levels").tolist() == ["1"]
        assert outlines.column("height").tolist() == [None]
        assert not any(outlines.issues.values())


COURT = (
    *(square(1, side=4), square(5, x=1, y=1), way(11, [1, 2, 3]), way(12, [3, 4, 1]), way(13, [5, 6, 7, 8, 5])),
    relation(20, [(11, "outer"), (12, "outer"), (13, "inner")], building="yes"),
)
CASES = {
    "a relation has its court": (COURT, [15], {}),
    "no tag of a building": ([way(9, [1, 2, 3, 4, 1], leisure="park")], [], {}),
    "open ways": ([way(9, [1, 2, 3, 4], building="yes"), way(10, [1, 2, 3], highway="path")], [], {"open_ways": 1}),
    "a missing node": ([way(9, [1, 2, 99, 3, 4, 1], building="yes")], [], {"ways_with_missing_nodes": 1}),
    "two corners": ([way(9, [1, 2, 1], **{"building:part": "yes"})], [], {"degenerate_ways": 1}),
    "a missing member": (
        [way(11, [1, 2, 3]), relation(20, [(11, "outer"), (12, "outer")], building="yes")],
        [],
        {"relations_incomplete": 1},
    ),
    "a relation that only groups parts": (
        [way(11, [1, 2, 3, 4, 1], building="yes"), relation(20, [(11, "outline")], type="building", building="yes")],
        [1],
        {},
    ),
    "a way that crosses itself": ([way(9, [1, 3, 2, 4, 1], building="yes")], [0.5], {"polygons_repaired": 1}),
    "a ring of a relation that crosses itself": (
        [way(11, [1, 3, 2, 4, 1]), relation(20, [(11, "outer")], building="yes")],
        [0.5],
        {"polygons_repaired": 1},
    ),
}


@pytest.mark.parametrize(("elements", "squares", "issues"), CASES.values(), ids=CASES)
def test_areas_are_assembled_and_what_makes_none_is_counted(read, elements, squares, issues):
    outlines = read(*([] if elements is COURT else [square(1)]), *elements)
    assert shapely.area(outlines.polygons) == pytest.approx(np.array(squares) * SIDE**2)
    assert {name: count for name, count in outlines.issues.items() if count} == issues


def test_an_area_that_cannot_be_rebuilt_is_an_empty_place(read):
    outlines = read(square(1), way(9, [1, 2, 1, 2, 1], building="yes"))
    assert len(outlines.polygons) == 1
    with pytest.raises(InputError, match="holds no building"):
        to_buildings(Buildings("city.osm"), outlines, "EPSG:32618")


def test_the_header_gives_the_first_box(read):
    boxes = [(-74.1, 40.6, -73.9, 40.8), (-73.8, 40.5, -73.7, 40.9)]
    assert [read(square(1), boxes=boxes[:num]).boxes for num in range(3)] == [(), (boxes[0],), (boxes[0],)]


# From the data's README, but for the number of outlines replaced, which is kept as a record of what was seen.
FILES = {
    "lower-manhattan": (
        "EPSG:32618",
        {"building_areas": 9938, "with_height": 9395, "levels_only": 146, "parts": 3135},
        {"open_ways": 70, "ways_with_missing_nodes": 0, "outlines_replaced_by_parts": 328},
    ),
    "boston-back-bay": (
        "EPSG:32619",
        {"building_areas": 4028, "with_height": 66, "levels_only": 558},
        {"open_ways": 0, "ways_with_missing_nodes": 0, "outlines_replaced_by_parts": 35},
    ),
    "helsinki": (
        "EPSG:32635",
        {"building_areas": 446, "with_height": 16},
        {"open_ways": 0, "ways_with_missing_nodes": 54, "outlines_replaced_by_parts": 10},
    ),
}


@pytest.mark.data
@pytest.mark.parametrize("name", FILES)
def test_counts_of_a_real_file_agree_with_its_readme(data_dir, name):
    crs, counts, issues = FILES[name]
    path = data_dir / "osm" / f"{name}.osm.pbf"
    outlines = read_osm(path, "pbf")
    buildings, _, found = to_buildings(Buildings(path), outlines, crs)
    building, part, height, levels = (is_given(outlines.column(n)) for n in ("building", "part", "height", "levels"))
    tagged = {"building_areas": building, "with_height": building & height, "levels_only": building & ~height & levels}
    tagged["parts"] = part & ~building
    assert {kind: int(tagged[kind].sum()) for kind in counts} == counts
    assert issues.items() <= found.items()
    assert found["heights_unusable"] == 0
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
    (tmp_path / "cut.osm.pbf").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut\.osm\.pbf.*cut short"):
        read_osm(tmp_path / "cut.osm.pbf", "pbf")
