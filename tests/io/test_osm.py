"""OpenStreetMap files: what is assembled, what is counted, what is refused."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.heights import is_given
from jaxurban.io.read.osm import read_osm
from jaxurban.io.read.outlines import to_buildings
from jaxurban.settings import Buildings

LON, LAT, SIDE = -74.0, 40.7, 0.001  # degrees
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))


def node(number, x, y):
    return f'<node id="{number}" version="1" lon="{LON + x * SIDE:.7f}" lat="{LAT + y * SIDE:.7f}"/>'


def square(first, x=0.0, y=0.0, side=1.0):
    return "".join(node(first + i, x + a * side, y + b * side) for i, (a, b) in enumerate(CORNERS))


def tags(values):
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in values.items())


def way(number, nodes, **values):
    refs = "".join(f'<nd ref="{ref}"/>' for ref in nodes)
    return f'<way id="{number}" version="1">{refs}{tags(values)}</way>'


def relation(number, members, **values):
    refs = "".join(f'<member type="way" ref="{ref}" role="{role}"/>' for ref, role in members)
    return f'<relation id="{number}" version="1">{refs}{tags({"type": "multipolygon", **values})}</relation>'


@pytest.fixture
def read(tmp_path):
    """Read the outlines of OSM elements in XML."""

    def read_elements(*elements):
        path = tmp_path / "city.osm"
        path.write_text('<?xml version="1.0"?><osm version="0.6">' + "".join(elements) + "</osm>")
        return read_osm(path, "osm")

    return read_elements


SQUARE = shapely.box(LON, LAT, LON + SIDE, LAT + SIDE)


def test_a_closed_way_is_an_area_with_its_tags(read):
    outlines = read(square(1), way(9, [1, 2, 3, 4, 1], building="yes", **{"building:levels": "5", "roof:levels": "1"}))
    assert shapely.area(shapely.symmetric_difference(outlines.polygons[0], SQUARE)) < 1e-9 * SQUARE.area
    assert outlines.column("levels").tolist() == ["5"]
    assert outlines.column("roof_levels").tolist() == ["1"]
    assert outlines.column("height").tolist() == [None]
    assert not any(outlines.issues.values())


def test_a_way_before_its_nodes_is_read_as_well(read):
    """The Overpass API writes ways before nodes."""
    assert len(read(way(9, [1, 2, 3, 4, 1], building="yes"), square(1)).polygons) == 1


def test_a_multipolygon_relation_has_its_court(read):
    outlines = read(
        square(1, side=4),
        square(5, x=1, y=1),
        way(11, [1, 2, 3]),
        way(12, [3, 4, 1]),
        way(13, [5, 6, 7, 8, 5]),
        relation(20, [(11, "outer"), (12, "outer"), (13, "inner")], building="yes", height="12"),
    )
    assert shapely.area(outlines.polygons) == pytest.approx([15 * SIDE**2])
    assert outlines.column("height").tolist() == ["12"]


def test_areas_without_a_building_tag_are_left_out(read):
    assert len(read(square(1), way(9, [1, 2, 3, 4, 1], leisure="park")).polygons) == 0


def test_an_open_building_way_is_counted(read):
    outlines = read(square(1), way(9, [1, 2, 3, 4], building="yes"), way(10, [1, 2, 3], highway="path"))
    assert len(outlines.polygons) == 0
    assert outlines.issues["open_ways"] == 1


def test_a_way_with_missing_nodes_is_counted_and_makes_no_area(read):
    outlines = read(square(1), way(9, [1, 2, 99, 3, 4, 1], building="yes"))
    assert len(outlines.polygons) == 0
    assert outlines.issues["ways_with_missing_nodes"] == 1


def test_a_closed_way_of_two_corners_is_counted(read):
    outlines = read(square(1), way(9, [1, 2, 1], **{"building:part": "yes"}))
    assert len(outlines.polygons) == 0
    assert outlines.issues["degenerate_ways"] == 1


def test_a_relation_with_a_missing_member_is_counted(read):
    outlines = read(square(1), way(11, [1, 2, 3]), relation(20, [(11, "outer"), (12, "outer")], building="yes"))
    assert len(outlines.polygons) == 0
    assert outlines.issues["relations_incomplete"] == 1


def test_a_relation_that_only_groups_parts_is_no_fault(read):
    group = relation(20, [(11, "outline")], type="building", building="yes")
    outlines = read(square(1), way(11, [1, 2, 3, 4, 1], building="yes"), group)
    assert outlines.issues["relations_incomplete"] == 0


def test_a_way_that_crosses_itself_is_rebuilt_from_its_loops(read):
    outlines = read(square(1), way(9, [1, 3, 2, 4, 1], building="yes"))
    assert shapely.area(outlines.polygons) == pytest.approx([SIDE**2 / 2])
    assert outlines.issues["polygons_repaired"] == 1


def test_a_relation_whose_outer_ring_crosses_itself_is_rebuilt(read):
    outlines = read(square(1), way(11, [1, 3, 2, 4, 1]), relation(20, [(11, "outer")], building="yes"))
    assert shapely.area(outlines.polygons) == pytest.approx([SIDE**2 / 2])


def test_an_area_that_cannot_be_rebuilt_is_an_empty_place(read):
    outlines = read(square(1), way(9, [1, 2, 1, 2, 1], building="yes"))
    assert len(outlines.polygons) == 1
    with pytest.raises(InputError, match="holds no building"):
        to_buildings(Buildings("city.osm"), outlines, "EPSG:32618")


def test_the_header_gives_the_boxes(read):
    boxes = [(-74.1, 40.6, -73.9, 40.8), (-73.8, 40.5, -73.7, 40.9)]
    bounds = [f'<bounds minlat="{b}" minlon="{a}" maxlat="{d}" maxlon="{c}"/>' for a, b, c, d in boxes]
    assert read(bounds[0], square(1)).boxes == (boxes[0],)
    assert read(*bounds, square(1)).boxes == (boxes[0],)
    assert read(square(1)).boxes == ()


@pytest.mark.parametrize(
    ("content", "file_format"),
    [
        (b"", "pbf"),
        (b"", "osm"),
        (b"no map at all", "pbf"),
        (bytes(200), "pbf"),
        (b'{"type": "FeatureCollection"}', "osm"),
        (b'<?xml version="1.0"?><gpx></gpx>', "osm"),
        (b'<?xml version="1.0"?><osm version="0.6"><node id="1"', "osm"),
        (b'<?xml version="1.0"?><osm version="0.6"><node id="1" lat="x" lon="0"/></osm>', "osm"),
        (b'<?xml version="1.0"?><osm version="0.6"><node id="x" lat="0" lon="0"/></osm>', "osm"),
    ],
)
def test_a_file_of_another_kind_is_refused_by_name(tmp_path, content, file_format):
    path = tmp_path / "city.osm.pbf"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"city\.osm\.pbf.*cannot be read as OpenStreetMap data"):
        read_osm(path, file_format)


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
    path = tmp_path / "cut.osm.pbf"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut\.osm\.pbf.*cut short"):
        read_osm(path, "pbf")
