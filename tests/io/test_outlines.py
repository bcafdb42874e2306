"""Which outlines stand, and how high."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.outlines import Outlines, polygonal, to_buildings
from jaxurban.settings import Buildings
from jaxurban.world.city import HeightOrigin

UTM = "EPSG:32618"
X, Y = 583000.0, 4506000.0


def box(x_min, y_min, x_max, y_max):
    return shapely.box(X + x_min, Y + y_min, X + x_max, Y + y_max)


def stand(polygons, box=None, **columns):
    outlines = Outlines(
        polygons=np.array(polygons, object),
        tags={name: np.array(values, object) for name, values in columns.items()},
        crs=UTM,
        boxes=() if box is None else (box,),
        issues={"open_ways": 7},
    )
    return to_buildings(Buildings("city.osm"), outlines, UTM)


def outline_and_parts(*parts, outline_height="50", part_height="30", **columns):
    """An outline of 10 x 10 m and its parts."""
    num_parts = len(parts)
    return stand(
        [box(0, 0, 10, 10), *parts],
        building=["yes"] + [None] * num_parts,
        part=[None] + ["yes"] * num_parts,
        height=[outline_height] + [part_height] * num_parts,
        **columns,
    )


def test_an_outline_covered_to_nine_tenths_gives_way_to_its_parts():
    buildings, _, issues = outline_and_parts(box(0, 0, 5, 10), box(5, 0, 9, 10))
    assert buildings.is_part.tolist() == [True, True]
    assert buildings.height_m.tolist() == [30, 30]
    assert issues["outlines_replaced_by_parts"] == 1


def test_an_outline_covered_less_stays_beside_its_parts():
    buildings, _, issues = outline_and_parts(box(0, 0, 5, 10), box(5, 0, 8.9, 10))
    assert buildings.height_m.tolist() == [50, 30, 30]
    assert issues["outlines_replaced_by_parts"] == 0


def test_parts_that_overlap_each_other_count_once():
    buildings, _, _ = outline_and_parts(box(0, 0, 6, 10), box(0, 0, 6, 10))
    assert len(buildings) == 3


def test_a_neighbours_part_replaces_no_outline():
    """A podium of 100 x 100 m around a tower of 10 x 10 m that is mapped as a building of its own."""
    buildings, _, _ = outline_and_parts(box(-50, -50, 50, 50), outline_height="200", part_height="10")
    assert buildings.height_m.tolist() == [200, 10]


@pytest.mark.parametrize("columns", [{"location": [None, "underground"]}, {"layer": ["1", "-1"]}])
def test_a_part_below_ground_replaces_no_outline(columns):
    buildings, _, issues = outline_and_parts(box(0, 0, 10, 10), **columns)
    assert buildings.height_m.tolist() == [50]
    assert issues["underground"] == 1


def test_an_outline_that_is_tagged_as_a_part_too_stands_as_a_part():
    buildings, _, issues = stand(
        [box(0, 0, 10, 10), box(0, 0, 10, 10)], building=["yes", "yes"], part=["yes", None], height=["8", "9"]
    )
    assert buildings.height_m.tolist() == [8]
    assert buildings.is_part.tolist() == [True]
    assert issues["outlines_replaced_by_parts"] == 1


def test_what_is_tagged_no_is_left_out():
    buildings, _, issues = stand(
        [box(2 * i, 0, 2 * i + 1, 1) for i in range(5)],
        building=["no", "yes", "no", "false", None],
        part=[None, "no", "yes", None, None],
        height=["1", "2", "3", "4", "5"],
    )
    assert buildings.height_m.tolist() == [2, 3]
    assert buildings.is_part.tolist() == [False, True]
    assert issues["not_buildings"] == 3


def test_what_is_underground_is_left_out_and_other_layers_are_not():
    buildings, _, issues = stand(
        [box(0, 0, 1, 1)] * 6,
        building=["yes"] * 6,
        location=["underground", "indoor", None, None, None, None],
        layer=[None, None, "-1", "2", "0", "ground"],
        height=["1", "2", "3", "4", "5", "6"],
    )
    assert buildings.height_m.tolist() == [2, 4, 5, 6]
    assert issues["underground"] == 2


def test_without_a_building_column_every_outline_is_a_building():
    buildings, _, _ = stand([box(0, 0, 1, 1)] * 2, height=["1", None])
    assert buildings.height_m.tolist() == [1, 10]


def test_a_part_without_height_takes_its_outlines():
    buildings, _, issues = outline_and_parts(box(0, 0, 10, 5), box(0, 5, 10, 10), part_height=None)
    assert buildings.height_m.tolist() == [50, 50]
    assert buildings.origin.tolist() == [HeightOrigin.HEIGHT] * 2
    assert issues["parts_given_outline_height"] == 2


def test_a_part_takes_the_highest_of_its_outlines():
    buildings, _, _ = stand(
        [box(0, 0, 10, 10), box(0, 0, 20, 20), box(1, 1, 9, 5)],
        building=["yes", "yes", None],
        part=[None, None, "yes"],
        height=["40", "60", None],
    )
    assert buildings.height_m.tolist() == [40, 60, 60]


def test_a_part_without_height_in_an_outline_without_height_has_the_default():
    buildings, _, issues = outline_and_parts(box(0, 0, 10, 10), outline_height=None, part_height=None)
    assert buildings.height_m.tolist() == [10]
    assert buildings.origin.tolist() == [HeightOrigin.DEFAULT]
    assert issues["parts_given_outline_height"] == 0


def test_hanging_parts_are_counted_and_keep_their_underside():
    buildings, _, issues = outline_and_parts(box(0, 0, 10, 10), min_height=[None, "12"])
    assert buildings.min_height_m.tolist() == [12]
    assert buildings.height_m.tolist() == [30]
    assert issues["parts_hanging"] == 1


def test_an_estimated_roof_is_raised_above_its_underside():
    buildings, _, issues = stand([box(0, 0, 1, 1)] * 2, levels=[None, "2"], min_height=["18", "20"])
    assert buildings.height_m.tolist() == [28, 26]
    assert issues["min_heights_above_roof"] == 0


def test_an_underside_above_a_tagged_roof_is_a_fault():
    buildings, _, issues = stand([box(0, 0, 1, 1)] * 2, height=["5", "5"], min_height=["5", "9"])
    assert buildings.height_m.tolist() == [5, 5]
    assert buildings.min_height_m.tolist() == [0, 0]
    assert issues["min_heights_above_roof"] == 2
    assert issues["parts_hanging"] == 0


def test_a_bow_tie_is_repaired_and_a_line_is_dropped():
    bow_tie = shapely.Polygon([(X, Y), (X + 10, Y + 10), (X + 10, Y), (X, Y + 10)])
    line = shapely.Polygon([(X, Y), (X + 10, Y), (X, Y), (X, Y)])
    buildings, _, issues = stand([bow_tie, line, None, shapely.Polygon(), box(0, 0, 1, 1)])
    assert len(buildings) == 2
    assert shapely.is_valid(buildings.polygons).all()
    assert shapely.area(buildings.polygons[0]) == pytest.approx(50)
    assert (issues["polygons_repaired"], issues["polygons_dropped"]) == (1, 3)
    assert issues["open_ways"] == 7  # the reader's own


def test_polygonal_keeps_polygons_only():
    mixed = shapely.GeometryCollection(
        [shapely.Point(0, 0), shapely.MultiPolygon([shapely.box(0, 0, 1, 1)]), shapely.box(1, 0, 2, 1)]
    )
    assert polygonal(mixed).equals(shapely.box(0, 0, 2, 1))
    assert polygonal(shapely.Point(0, 0)).is_empty


def test_outlines_that_the_crs_cannot_hold_are_left_out_and_counted():
    outlines = Outlines(
        np.array([shapely.box(-74, 40.7, -73.9, 40.8), shapely.box(15, 0, 16, 1)]), {}, "EPSG:4326", (), {}
    )
    buildings, _, issues = to_buildings(Buildings("x"), outlines, UTM)
    assert (len(buildings), issues["outside_crs"]) == (1, 1)


def test_the_boxes_that_a_file_declares_come_in_the_citys_crs():
    assert stand([box(1, 2, 3, 4)], box=(X, Y, X + 9, Y + 9))[1] == [pytest.approx((X, Y, X + 9, Y + 9))]
    assert stand([box(1, 2, 3, 4)])[1] == []


def test_a_declared_box_without_buildings_is_an_empty_city():
    buildings, boxes_m, _ = stand([], box=(X, Y, X + 9, Y + 9))
    assert len(buildings) == 0
    assert boxes_m == [pytest.approx((X, Y, X + 9, Y + 9))]


def test_a_file_without_building_or_box_is_refused():
    with pytest.raises(InputError, match=r"city\.osm.*holds no building"):
        stand([])


def test_heights_in_z_are_ignored():
    buildings, _, _ = stand([shapely.force_3d(box(0, 0, 1, 1), 99.0)])
    assert not shapely.has_z(buildings.polygons).any()
