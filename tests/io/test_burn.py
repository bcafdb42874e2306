"""Burning: which cells an outline covers, by centres and by any shared area, and what hangs over which."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import shapely
from affine import Affine
from rasterio.features import rasterize
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.city import read_buildings
from jaxurban.cities.osm import read_osm
from jaxurban.io.burn import burn
from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface, rasterise
from jaxurban.io.zone import cell_boxes, touched_cells
from jaxurban.metrics.visibility import visibility
from jaxurban.settings import SLABS, TO_GROUND
from jaxurban.world.extent import polygonal
from jaxurban.world.footprints import HeightOrigin
from jaxurban.world.surface import PER_CELL, obstacles_on
from tests.hanging_city import CRS, DECK, SIDE_M, X_M, Y_M, city
from tests.made_files import line, osm, write_vector

OUTER = (900_000, 110_000, 40, 40)  # first row and column, rows, columns
BORDERS = ju.Grid(CRS, 1.0, 0, 0, 40, 40)


def burnt(polygons, values, grid):
    """Return what is burnt by centres, and by touch."""
    polygons, values = np.array(polygons, object), np.asarray(values, float)
    return burn(polygons, values, grid, 0.0, "float32")


def check_touched(polygons, values, grid):
    """Assert that every cell has the height of the highest polygon that shares area with it, slivers aside."""
    polygons, values = np.array(polygons, object), np.asarray(values, np.float32)
    _, touched = burnt(polygons, values, grid)
    boxes = cell_boxes(grid, np.indices(grid.shape).reshape(2, -1).T, 1)
    polygon, cell = shapely.STRtree(boxes).query(polygons, predicate="intersects")
    area_m2 = shapely.area(shapely.intersection(polygons[polygon], boxes[cell]))
    sliver_m2 = (
        1e-6 * grid.resolution_m**2
    )  # a cut thinner than the rounding of corners onto borders
    least, most = np.zeros(touched.size, np.float32), np.zeros(touched.size, np.float32)
    np.maximum.at(least, cell[area_m2 > sliver_m2], values[polygon[area_m2 > sliver_m2]])
    np.maximum.at(most, cell, values[polygon])
    assert np.all(least <= touched.ravel())
    assert np.all(touched.ravel() <= most)


def test_every_cell_that_shares_area_with_an_outline_is_touched():
    rng = np.random.default_rng(1)
    grid = ju.Grid(CRS, 2.5, *OUTER)
    polygons = []
    for _ in range(60):
        centre_m = np.array(grid.bounds_m[:2]) + rng.uniform(-10, 110, 2)
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
        polygon = shapely.Polygon(
            centre_m + rng.uniform(0.5, 25) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        )
        if rng.random() < 0.3:
            polygon = polygon.difference(shapely.centroid(polygon).buffer(3.0))
        if rng.random() < 0.3:
            polygon = shapely.union(polygon, shapely.box(*centre_m, *(centre_m + 0.01)))
        polygons += [polygon] * (not polygon.is_empty)
    values = rng.uniform(3, 90, len(polygons))
    check_touched(polygons, values, grid)
    by_gdal = gdal(
        np.array(polygons), values, grid, 0.0, "float32", all_touched=True
    )  # no corner lies on a border
    np.testing.assert_array_equal(burnt(polygons, values, grid)[1], by_gdal)
    np.testing.assert_array_equal(touched_cells(shapely.union_all(polygons), grid), by_gdal > 0)


def test_an_outline_that_ends_on_borders_of_cells_touches_no_cell_beyond_them():
    grid = ju.Grid(CRS, 5.0, *OUTER)
    x_m, y_m = grid.x_min_m, grid.y_min_m
    centre, touched = burnt([shapely.box(x_m + 10, y_m + 15, x_m + 35, y_m + 40)], [9.0], grid)
    np.testing.assert_array_equal(centre, touched)
    assert (touched > 0).sum() == 25


def test_a_wall_thinner_than_a_cell_is_touched_all_along_and_leaves_no_gap_at_corners():
    grid = ju.Grid(CRS, 5.0, *OUTER)
    middle_m = np.array([grid.x_min_m, grid.y_min_m]) + 100.0
    for degrees in range(0, 91, 10):
        along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        wall = shapely.LineString([middle_m - 80 * along, middle_m + 80 * along]).buffer(
            0.1, cap_style="flat"
        )
        centre, touched = burnt([wall], [30.0], grid)
        check_touched([wall], [30.0], grid)
        assert (centre > 0).sum() < (touched > 0).sum()
        assert label(touched > 0)[1] == 1  # cells side by side


def with_ties(rng, num=30):
    """Return polygons, some of several parts or with holes, whose corners lie on borders and centres of cells."""

    def corners(count):
        return rng.integers(-4, 84, (count, 2)) / 2.0

    def box():
        ends = corners(2)
        return shapely.box(*ends.min(axis=0), *ends.max(axis=0))

    made = []
    while len(made) < num:
        sharp = shapely.make_valid(shapely.Polygon(corners(rng.integers(3, 9))), method="structure")
        low, size = corners(1)[0], rng.integers(2, 20, 2) / 2.0
        yard = shapely.box(*low, *(low + size))
        holed = shapely.difference(
            shapely.union_all([shapely.box(*(low - 2), *(low + size + 2.5)), box()]), yard
        )
        cut = shapely.difference(
            *(shapely.convex_hull(shapely.multipoints(corners(5))) for _ in range(2))
        )
        made += [shape for shape in (sharp, holed, cut, shapely.reverse(holed)) if shape.area > 0]
    made = np.array([polygonal(shape) for shape in made], object)
    assert len(np.unique(shapely.get_type_id(made))) == 2
    assert shapely.get_num_interior_rings(made).any()
    return made


def gdal(polygons, values, grid, fill, dtype, **how):
    """Return what GDAL burns, the highest value last."""
    order = np.argsort(values, kind="stable")
    to_cells = np.array([grid.first_col, grid.first_row])
    in_cells = shapely.transform(polygons[order], lambda xy_m: xy_m / grid.resolution_m - to_cells)
    shapes = list(zip(in_cells, values[order].tolist(), strict=True))
    return rasterize(shapes, grid.shape, fill=fill, transform=Affine.identity(), dtype=dtype, **how)


def test_borders_through_centres_fall_as_gdal_has_them():
    """GDAL is asked with row 0 in the south, as grids have it: it gives centres on borders to one side."""
    for polygon in with_ties(np.random.default_rng(2), 200):
        alone = np.array([polygon]), np.ones(1), BORDERS, 0, "int32"
        np.testing.assert_array_equal(burn(*alone)[0], gdal(*alone))


@pytest.mark.parametrize(("fill", "dtype"), [(-1, "int32"), (0.0, "float32")])
def test_the_highest_value_wins_in_any_order(fill, dtype):
    rng = np.random.default_rng(3)
    polygons = with_ties(rng)
    values = (
        rng.permutation(len(polygons)) if dtype == "int32" else rng.uniform(3, 90, len(polygons))
    )
    expected = gdal(polygons, values, BORDERS, fill, dtype)
    for order in (np.arange(len(polygons)), rng.permutation(len(polygons))):
        centre, touched = burn(polygons[order], values[order], BORDERS, fill, dtype)
        np.testing.assert_array_equal(centre, expected)
        assert centre.dtype == touched.dtype == dtype
        assert np.all(touched >= centre)


@pytest.mark.parametrize("resolution_m", [5.0, 0.7])
def test_tiles_burnt_by_threads_at_once_are_the_whole_even_on_ties(resolution_m):
    rng = np.random.default_rng(4)
    polygons = shapely.transform(
        with_ties(rng), lambda xy: (xy + np.array(OUTER[1::-1])) * resolution_m
    )
    values = rng.uniform(3, 90, len(polygons))
    boxes_m = shapely.bounds(polygons).T
    whole, corners = (
        ju.Grid(CRS, resolution_m, *OUTER),
        itertools.product(range(0, 40, 10), range(0, 40, 8)),
    )
    tiles = [
        ju.Grid(CRS, resolution_m, OUTER[0] + row, OUTER[1] + col, 10, 8) for row, col in corners
    ]

    def burn_tile(tile):
        return burn(polygons, values, tile, 0.0, "float32", boxes_m=boxes_m)

    expected = burn_tile(whole)
    with ThreadPoolExecutor(4) as threads:
        for tile, found in zip(tiles, threads.map(burn_tile, tiles), strict=True):
            for part, layer in zip(found, expected, strict=True):
                np.testing.assert_array_equal(part, layer[tile.window_in(whole)])


def test_a_centre_in_a_hole_is_not_held_and_an_outline_far_larger_than_the_grid_is():
    grid = ju.Grid(CRS, 1.0, 900_000, 110_000, 6, 6)
    wide = shapely.box(0, 0, 1e6, 1e7).difference(shapely.box(110_002, 900_001, 110_004, 900_005))
    centre, touched = burnt([wide], [7.0], grid)
    expected = np.full((6, 6), 7.0)
    expected[1:5, 2:4] = 0.0
    np.testing.assert_array_equal(centre, expected)
    np.testing.assert_array_equal(touched, expected)


def test_empty_and_missing_polygons_and_those_elsewhere_leave_the_fill():
    grid = ju.Grid(CRS, 5.0, *OUTER)
    for polygons in ([], [None, shapely.Polygon()], [shapely.box(0, 0, 1, 1)]):
        assert (
            burn(np.array(polygons, object), np.ones(len(polygons)), grid, -1, "int32")[0] == -1
        ).all()


@pytest.mark.slow
@pytest.mark.data
def test_every_roof_of_lower_manhattan_lies_in_the_cells_of_gdal_and_in_all_that_it_shares_area_with(
    data_dir,
):
    found = read_buildings(ju.Buildings(data_dir / "osm/lower-manhattan.osm.pbf"), CRS).buildings
    for resolution_m in (5.0, 2.0, 5 / 3):
        grid = ju.Grid.from_bounds((-74.02, 40.70, -73.98, 40.73), resolution_m, CRS)
        outlines = found.polygons, found.height_m, grid, 0.0, "float32"
        np.testing.assert_array_equal(burn(*outlines)[0], gdal(*outlines))
    for resolution_m in (5.0, 2.0):
        grid = ju.Grid.from_bounds((-74.014, 40.703, -74.006, 40.709), resolution_m, CRS)
        check_touched(found.polygons, found.height_m, grid)


GRID = ju.Grid(CRS, 2.0, int(Y_M / 2), int(X_M / 2), int(SIDE_M / 2), int(SIDE_M / 2))


def cell_of(x_m: float, y_m: float) -> tuple[int, int]:
    return int(y_m // 2), int(x_m // 2)


@pytest.fixture(scope="module")
def rasters():
    return rasterise(city(), GRID)


def test_without_what_hangs_the_rasters_are_the_same_to_the_bit():
    whole = city()
    standing = replace(whole, buildings=whole.buildings.take(whole.buildings.min_height_m == 0))
    slabs, plain = rasterise(standing, GRID), rasterise(replace(standing, hanging=TO_GROUND), GRID)
    assert plain.slabs is None
    assert len(slabs.slabs.row) == 0
    np.testing.assert_array_equal(slabs.roof_m, plain.roof_m)
    np.testing.assert_array_equal(slabs.roof_touched_m, plain.roof_touched_m)


def test_a_part_that_rests_on_a_roof_raises_it(rasters):
    assert [rasters.roof_m[cell_of(x_m, 270)] for x_m in (115, 103, 95)] == [55, 15, 0]


def test_slabs_as_if_they_reached_the_ground_are_the_roofs_without_slabs(rasters):
    to_ground = rasterise(city(TO_GROUND), GRID)
    np.testing.assert_array_equal(rasters.slabs.raised(rasters.roof_m, GRID), to_ground.roof_m)
    np.testing.assert_array_equal(rasters.roof_touched_m, to_ground.roof_touched_m)
    assert [made.roof_m[cell_of(300, 202)] for made in (rasters, to_ground)] == [0, 13.5]


def test_touched_slabs_as_if_they_reached_the_ground_are_no_lower_than_the_touched_roofs():
    touched = rasterise(city(), GRID, all_touched=True)
    raised_m = touched.slabs.raised(touched.roof_m, GRID)
    to_ground_m = rasterise(city(TO_GROUND), GRID, all_touched=True).roof_m
    assert np.all(raised_m >= to_ground_m)
    assert (
        np.sum(raised_m != to_ground_m) <= 1
    )  # a corner that enters a cell by less than outlines are snapped


def test_two_slabs_over_a_cell_stay_two(rasters):
    slabs, cells = rasters.slabs.over_cells(GRID)
    here = np.all(np.transpose(cells) == cell_of(240, 340), axis=1)
    assert sorted(zip(slabs.floor_m[here], slabs.top_m[here], strict=True)) == [(6, 8), (40, 44)]
    assert rasters.slabs.lowest_floors(GRID)[cell_of(240, 340)] == 6


def test_subcells_hold_the_area_of_a_deck(rasters):
    of_deck = rasters.slabs.floor_m == 12
    assert of_deck.sum() * (2.0 / PER_CELL) ** 2 == pytest.approx(DECK.area, rel=0.01)


@pytest.mark.parametrize("with_terrain", [False, True])
def test_a_part_of_a_grid_holds_the_slabs_of_the_whole(with_terrain):
    whole, part = (
        city(with_terrain=with_terrain),
        ju.Grid(CRS, 2.0, GRID.first_row + 60, GRID.first_col, 50, 77),
    )
    large, small = rasterise(whole, GRID), rasterise(whole, part)
    row, col = (
        large.slabs.row // PER_CELL - part.first_row,
        large.slabs.col // PER_CELL - part.first_col,
    )
    inside = (row >= 0) & (row < 50) & (col < 77)
    expected = large.slabs.take(inside)
    assert len(expected.row) > 1000
    for name, one, other in zip(expected._fields, expected, small.slabs, strict=True):
        np.testing.assert_array_equal(one, other, name)
    np.testing.assert_array_equal(large.roof_m[60:110, :77], small.roof_m)


BRIDGES = {  # their tags, from where to where they hang in metres, and whether that is a guess
    "given": ({"min_height": "6", "height": "7.5"}, (6, 7.5), False),
    "underside": ({"min_height": "6"}, (6, 7), False),
    "top": ({"height": "41"}, (40, 41), False),
    "layer": ({"layer": "2"}, (10, 11), True),
    "nothing": ({}, (5, 6), True),
    "upside down": ({"min_height": "9", "height": "7"}, (9, 10), False),
}


def test_decks_of_bridges_hang_by_their_tags_or_by_their_layer(tmp_path):
    tags, spans_m, guessed = zip(*BRIDGES.values(), strict=True)
    rows = [
        *({"man_made": "bridge"} | each for each in tags),
        {"building": "yes", "height": 20},
        {"man_made": "pier"},
    ]
    shapes = [shapely.box(X_M + 40 * i, Y_M, X_M + 40 * i + 30, Y_M + 8) for i in range(len(rows))]
    path = write_vector(tmp_path / "city.gpkg", shapes, CRS, **pd.DataFrame(rows))
    assert read_buildings(ju.Buildings(path), CRS).buildings.height_m.tolist() == [20]
    decks = read_buildings(ju.Buildings(path, hanging=SLABS), CRS).buildings
    assert list(zip(decks.min_height_m, decks.height_m, strict=True)) == [*spans_m, (0, 20)]
    assert [origin == HeightOrigin.LAYER for origin in decks.origin] == [*guessed, False]
    assert decks.is_guessed.tolist() == [*guessed, False]


def test_an_osm_file_gives_bridges_only_where_slabs_are_asked(tmp_path):
    kinds = {"man_made": "bridge", "layer": "1"}, {"man_made": "pier"}, {"building": "yes"}
    squares = [shapely.box(-74 + i, 40, -74 + i + 1e-3, 40.001).exterior.coords for i in range(3)]
    path = tmp_path / "city.osm"
    path.write_text(osm(*(line(1 + i, squares[i], **kinds[i]) for i in range(3))))
    for hanging, floors_m, kinds in ((SLABS, [0, 5], []), (TO_GROUND, [0], ["bridge"])):
        file = ju.Buildings(path, hanging=hanging)
        buildings, structures, *_ = to_buildings(file, read_osm(path), "EPSG:32618")
        assert sorted(buildings.min_height_m.tolist()) == floors_m
        assert structures.kinds.tolist() == kinds


def test_an_outline_stays_as_a_podium_under_hanging_parts_where_no_part_stands(tmp_path):
    """A tower of 75 m of which a part from 20 m up and one from the ground are mapped: its lobby is no air."""
    x_m, y_m = X_M + 100, Y_M + 100
    lobby, standing = (
        shapely.box(x_m, y_m, x_m + 40, y_m + 60),
        shapely.box(x_m + 40, y_m, x_m + 60, y_m + 60),
    )
    top, beside = (shapely.box(x, y_m + 10, x + 10, y_m + 20) for x in (x_m + 10, x_m + 200))
    tower = {
        shapely.union(lobby, standing): {"building": "yes", "height": "75"},
        lobby: {"building:part": "yes", "height": "75", "min_height": "20"},
        top: {"building:part": "yes", "height": "90", "min_height": "75"},
        standing: {"building:part": "yes", "height": "30"},
        beside: {"building": "yes", "height": "12"},
    }
    path = write_vector(tmp_path / "city.gpkg", tower, CRS, **pd.DataFrame(tower.values()))
    for hanging, count in ((SLABS, 1), (TO_GROUND, None)):
        source = read_buildings(ju.Buildings(path, hanging=hanging), CRS)
        assert source.read_issues["outlines_replaced_by_parts"] == 1
        assert source.read_issues.get("outlines_kept_as_podiums") == count
        extent_m = (X_M, Y_M, X_M + SIDE_M, Y_M + SIDE_M)
        surface = build_surface(City(CRS, extent_m, source.buildings, hanging=hanging), GRID, GRID)
        low, high = np.asarray(obstacles_on(surface, [2.0, 60.0]))
        assert low[50:80, 50:80].all()  # 60 m from 100 m on, in cells of 2 m
        assert high.sum() == lobby.area / 4
        words = np.asarray(
            visibility(surface, np.zeros(1), np.array([0.1]), [2.0])
        )  # north, through the lobby
        assert words[0, 0][cell_of(120, 90)] == 0
