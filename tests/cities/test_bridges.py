"""Bridges: strips with a guess and a bound by layer, structure, length and water, wherever they are mapped."""

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, box

from jaxurban.cities.bridges import LANE_M, SHOULDERS_M
from jaxurban.cities.vector import read_vector
from tests.cities.test_stands import AREA, stand
from tests.made_files import UTM, write_vector

ROAD = LineString([(0, 0), (200, 0)])
LONG = LineString([(0, 0), (400, 0)])
RIVER = LineString([(100, -50), (100, 50)])
WATER = {"waterway": "river", "building": ""}


def bridge(tags, shape=ROAD, *others):
    """Return the kind, the guess and the bound of the first of what stands of a way of traffic and more."""
    _, structures, _ = stand((shape, tags), *others)
    return structures.kinds[0], structures.height_m[0], structures.upper_m[0]


@pytest.mark.parametrize(
    ("tags", "height_m", "upper_m"),
    [
        ({"highway": "motorway", "bridge": "yes"}, 5.5, 22),
        ({"highway": "trunk", "bridge": "yes", "layer": "3"}, 16.5, 46),
        ({"railway": "rail", "bridge": "yes", "layer": "-1"}, 5.5, 22),
        ({"highway": "path", "bridge": "boardwalk"}, 5.5, 22),
        ({"waterway": "canal", "bridge": "aqueduct"}, 5.5, 100),
        ({"railway": "rail", "bridge": "viaduct"}, 5.5, 100),
        ({"railway": "rail", "bridge": "yes;viaduct"}, 5.5, 100),
        ({"highway": "trunk", "bridge": "yes", "bridge:structure": "through_arch"}, 5.5, 100),
        ({"highway": "trunk", "bridge": "yes", "bridge:structure": "extradosed"}, 5.5, 100),
        ({"highway": "footway", "abandoned:bridge": "yes"}, 5.5, 22),
        ({"highway": "footway", "layer": "1", "removed:man_made": "mast"}, 5.5, 22),
        ({"highway": "service", "bridge": "yes", "bridge:structure": "arch"}, 5.5, 100),
        ({"highway": "service", "bridge": "yes", "bridge:movable": "swing"}, 5.5, 100),
        ({"highway": "service", "bridge": "movable"}, 5.5, 100),
        (
            {"highway": "footway", "bridge": "yes", "bridge:structure": "simple-suspension"},
            5.5,
            350,
        ),
        ({"highway": "motorway", "bridge": "cable-stayed", "layer": "2"}, 11, 350),
        ({"bridge": "yes"}, 5.5, 22),
        # A height is that of the deck alone.
        ({"highway": "trunk", "bridge": "suspension", "height": "41"}, 41, 350),
        ({"highway": "service", "bridge": "yes", "height": "30"}, 30, 30),
        # What lies on a layer above the ground is raised, whether it says that it is a bridge or not.
        ({"highway": "footway", "layer": "2"}, 11, 34),
        ({"railway": "platform", "layer": "1"}, 5.5, 22),
        ({"highway": "corridor", "bridge": "yes", "indoor": "yes"}, 5.5, 22),
    ],
)
def test_a_bridge_stands_as_high_as_its_layers_and_is_bounded_by_its_structure(
    tags, height_m, upper_m
):
    dry = Point(0, 900).buffer(5), WATER
    assert bridge(tags, ROAD, dry) == ("bridge", height_m, upper_m)


@pytest.mark.parametrize(
    "tags",
    [
        {"highway": "motorway", "bridge": "no"},
        {"highway": "motorway", "layer": "0"},
        {"highway": "motorway", "layer": "-2"},
        {"highway": "corridor", "layer": "1", "indoor": "yes"},
        {"building": "no", "layer": "3"},
    ],
)
def test_what_is_level_with_the_ground_or_within_a_building_is_no_bridge(tags):
    assert len(stand((ROAD, tags))[1]) == 0


def test_a_stop_on_a_raised_way_is_part_of_it():
    assert stand((Point(5, 5), {"railway": "stop", "layer": "1"}))[2] == {"not_standing": 1}


def test_a_way_is_a_strip_as_wide_as_its_lanes_or_as_it_says():
    for more, width_m in (
        ({}, 2 * LANE_M + SHOULDERS_M),
        ({"lanes": "4"}, 4 * LANE_M + SHOULDERS_M),
        ({"width": "20"}, 20.0),
    ):
        _, structures, _ = stand((ROAD, {"highway": "primary", "bridge": "yes", **more}))
        area_m2 = 200 * width_m + np.pi * width_m**2 / 4
        assert shapely.area(structures.polygons) == pytest.approx([area_m2], rel=0.01)


def test_a_long_bridge_over_water_may_hang_on_towers():
    yes = {"highway": "primary", "bridge": "yes"}
    assert bridge(yes, LONG, (RIVER, WATER))[2] == 350
    assert (
        bridge(yes, LONG, (box(90, -10, 110, 10), {"natural": "water", "building": ""}))[2] == 350
    )
    assert bridge(yes, ROAD, (RIVER, WATER))[2] == 22
    assert bridge(yes, LONG, (shapely.transform(RIVER, lambda x: x + 900), WATER))[2] == 22
    # Ways that join are one bridge, and a file that knows no water does not know what a bridge crosses.
    rest = LineString([(200, 0), (400, 0)]), yes
    assert bridge(yes, ROAD, rest, (RIVER, WATER))[2] == 350
    assert bridge(yes, LONG)[2] == 350
    assert bridge(yes, ROAD)[2] == 22


def test_an_area_of_a_bridge_stands_under_its_bound_too():
    assert bridge(
        {"highway": "pedestrian", "area": "yes", "bridge": "yes", "building": ""}, AREA
    ) == (
        "bridge",
        5.5,
        22,
    )


def test_a_table_of_ways_keeps_those_of_traffic_that_are_raised(tmp_path):
    file = write_vector(
        tmp_path / "ways.gpkg",
        [ROAD, ROAD, ROAD, ROAD],
        UTM,
        highway=["primary", None, "primary", None],
        railway=[None, "rail", None, None],
        layer=[1, 2, None, 3],
    )
    assert read_vector(file, None, None).column("layer").tolist() == [1, 2]
