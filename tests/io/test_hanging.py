"""What hangs: which parts rest on roofs, which cells they take, and which areas of bridges are decks."""

from dataclasses import replace

import geopandas
import numpy as np
import pytest
import shapely

from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.osm import read_osm
from jaxurban.io.read.outlines import to_buildings
from jaxurban.io.read.rasterise import build_surface, rasterise
from jaxurban.metrics.visibility import visibility
from jaxurban.settings import Buildings
from jaxurban.world.city import SLABS, TO_GROUND, City, HeightOrigin
from jaxurban.world.grid import Grid
from jaxurban.world.surface import PER_CELL, obstacles_on
from tests.hanging_city import CRS, DECK, SIDE_M, X_M, Y_M, city
from tests.io.made_files import line, osm

GRID = Grid(CRS, 2.0, int(Y_M / 2), int(X_M / 2), int(SIDE_M / 2), int(SIDE_M / 2))


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
    assert np.sum(raised_m != to_ground_m) <= 1  # a corner that enters a cell by less than outlines are snapped


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
    whole, part = city(with_terrain=with_terrain), Grid(CRS, 2.0, GRID.first_row + 60, GRID.first_col, 50, 77)
    large, small = rasterise(whole, GRID), rasterise(whole, part)
    row, col = large.slabs.row // PER_CELL - part.first_row, large.slabs.col // PER_CELL - part.first_col
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
    rows = [{"man_made": "bridge"} | each for each in tags] + [
        {"building": "yes", "height": "20"},
        {"man_made": "pier"},
    ]
    shapes = [shapely.box(X_M + 40 * i, Y_M, X_M + 40 * i + 30, Y_M + 8) for i in range(len(rows))]
    path = tmp_path / "city.gpkg"
    geopandas.GeoDataFrame(rows, geometry=shapes, crs=CRS).to_file(path)
    assert read_buildings(Buildings(path), CRS).buildings.height_m.tolist() == [20]
    decks = read_buildings(Buildings(path, hanging=SLABS), CRS).buildings
    assert list(zip(decks.min_height_m, decks.height_m, strict=True)) == [*spans_m, (0, 20)]
    assert [origin == HeightOrigin.LAYER for origin in decks.origin] == [*guessed, False]
    assert decks.is_guessed.tolist() == [*guessed, False]


def test_an_osm_file_gives_bridges_only_where_slabs_are_asked(tmp_path):
    kinds = {"man_made": "bridge", "layer": "1"}, {"man_made": "pier"}, {"building": "yes"}
    squares = [shapely.box(-74 + i, 40, -74 + i + 1e-3, 40.001).exterior.coords for i in range(3)]
    path = tmp_path / "city.osm"
    path.write_text(osm(*(line(1 + i, squares[i], **kinds[i]) for i in range(3))))
    plain, slabs = read_osm(path), read_osm(path, has_decks=True)
    assert (len(plain.polygons), len(slabs.polygons)) == (1, 2)
    for hanging, floors_m in ((SLABS, [0, 5]), (TO_GROUND, [0])):
        buildings, _, _ = to_buildings(Buildings(path, hanging=hanging), slabs, "EPSG:32618")
        assert sorted(buildings.min_height_m.tolist()) == floors_m


def test_an_outline_stays_as_a_podium_under_hanging_parts_where_no_part_stands(tmp_path):
    """A tower of 75 m of which a part from 20 m up and one from the ground are mapped: its lobby is no air."""
    x_m, y_m = X_M + 100, Y_M + 100
    lobby, standing = shapely.box(x_m, y_m, x_m + 40, y_m + 60), shapely.box(x_m + 40, y_m, x_m + 60, y_m + 60)
    top, beside = (shapely.box(x, y_m + 10, x + 10, y_m + 20) for x in (x_m + 10, x_m + 200))
    tower = {
        shapely.union(lobby, standing): {"building": "yes", "height": "75"},
        lobby: {"building:part": "yes", "height": "75", "min_height": "20"},
        top: {"building:part": "yes", "height": "90", "min_height": "75"},
        standing: {"building:part": "yes", "height": "30"},
        beside: {"building": "yes", "height": "12"},
    }
    path = tmp_path / "city.gpkg"
    geopandas.GeoDataFrame(list(tower.values()), geometry=list(tower), crs=CRS).to_file(path)
    for hanging, count in ((SLABS, 1), (TO_GROUND, None)):
        source = read_buildings(Buildings(path, hanging=hanging), CRS)
        assert source.read_issues["outlines_replaced_by_parts"] == 1
        assert source.read_issues.get("outlines_kept_as_podiums") == count
        extent_m = (X_M, Y_M, X_M + SIDE_M, Y_M + SIDE_M)
        surface = build_surface(City(CRS, extent_m, source.buildings, hanging=hanging), GRID, GRID)
        low, high = np.asarray(obstacles_on(surface, [2.0, 60.0]))
        assert low[50:80, 50:80].all()  # 60 m from 100 m on, in cells of 2 m
        assert high.sum() == lobby.area / 4
        words = np.asarray(visibility(surface, np.zeros(1), np.array([0.1]), [2.0]))  # north, through the lobby
        assert words[0, 0][cell_of(120, 90)] == 0
