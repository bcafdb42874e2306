"""Grid: snapping, cells and coordinates, edges; and tiles that hold each cell once and hand shadows on."""

import math

import numpy as np
import pyproj
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from jaxurban.errors import InputError
from jaxurban.maps.tiled import QUADRANTS, Tiling
from jaxurban.world.grid import Grid, tile_shape, utm_crs

LOWER_MANHATTAN = (-74.02, 40.70, -73.98, 40.73)
NO_CRS = (
    "EPSG:4326",
    "EPSG:2263",
    "nonsense",
    "EPSG:2048",
    "EPSG:3857",
)  # which must be projected, in metres


def test_default_crs_is_the_utm_zone_of_the_centre():
    assert Grid.from_bounds(LOWER_MANHATTAN, 5.0).crs == "EPSG:32618"
    assert utm_crs(151.2, -33.9) == "EPSG:32756"


def test_grid_covers_the_densified_projected_box():
    grid = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    ring = shapely.box(*LOWER_MANHATTAN).exterior.segmentize(1e-4)
    x_m, y_m = grid.xy_of_lonlat(*np.transpose(ring.coords))
    assert grid.contains_xy(x_m, y_m).all()
    assert grid.x_min_m > x_m.min() - 5.0
    assert grid.y_max_m < y_m.max() + 5.0


def test_nested_grids_share_one_box_whose_borders_are_multiples_of_the_coarsest_resolution():
    nested = {
        r: Grid.from_bounds(LOWER_MANHATTAN, r, nest_with_m=(2.0, 5.0, 10.0)).bounds_m
        for r in (2.0, 5.0, 10.0)
    }
    assert len(set(nested.values())) == 1
    assert all(border_m % 10.0 == 0.0 for border_m in nested[2.0])
    grid = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    assert (
        Grid.from_bounds(LOWER_MANHATTAN, 5.0, grid.crs, nest_with_m=(5.0,)) == grid
    )  # snapped again


def test_cell_to_lonlat_and_back_is_the_same_cell():
    grid = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    cells = np.random.default_rng(0).integers(0, grid.shape, (5000, 2)).T
    np.testing.assert_array_equal(grid.cell_of_lonlat(*grid.lonlat_of_cell(*cells)), cells)


def test_the_centre_of_one_cell_is_two_numbers_and_of_several_two_arrays():
    grid = Grid.from_bounds((-74.02, 40.70, -73.98, 40.73), 20.0)
    one = grid.lonlat_of_cell(2, np.int64(3))
    assert all(isinstance(value, float) for value in one)
    several = grid.lonlat_of_cell([2, 3], [3, 3])
    assert [values.shape for values in several] == [(2,), (2,)]
    assert [values[0] for values in several] == list(one)


def test_west_border_belongs_to_the_grid_and_east_border_does_not():
    grid = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    assert grid.cell_of_xy(grid.x_min_m, grid.y_min_m) == (0, 0)
    with pytest.raises(InputError, match="outside the region"):
        grid.cell_of_xy(grid.x_max_m, grid.y_min_m)
    assert not grid.contains_xy(math.nan, grid.y_min_m)


def test_convergence_of_lower_manhattan_is_065_degrees():
    grid = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    convergence_rad = grid.convergence_rad(-74.0, 40.715)
    assert math.degrees(convergence_rad) == pytest.approx(0.652, abs=0.001)
    # A geodesic step to true north must show at minus the convergence from grid north.
    lon, lat, _ = pyproj.Geod(ellps="WGS84").fwd(-74.0, 40.715, 0.0, 100.0)
    (x0, y0), (x1, y1) = grid.xy_of_lonlat(-74.0, 40.715), grid.xy_of_lonlat(lon, lat)
    assert math.atan2(x1 - x0, y1 - y0) == pytest.approx(-convergence_rad, abs=1e-5)


def test_window_cuts_a_sub_box():
    outer = Grid.from_bounds(LOWER_MANHATTAN, 5.0)
    inner = Grid.from_bounds((-74.01, 40.71, -74.0, 40.72), 5.0)
    rows, cols = inner.window_in(outer)
    np.testing.assert_allclose(outer.x_m[cols], inner.x_m)
    np.testing.assert_allclose(outer.y_m[rows], inner.y_m)
    with pytest.raises(InputError, match="not a part"):
        outer.window_in(inner)
    assert inner.padded(1, 2, 3, 4).shape == (inner.num_rows + 6, inner.num_cols + 4)


@pytest.mark.parametrize(
    ("bounds", "how", "words"),
    [
        ((-74.0, 40.7, -74.02, 40.73), {}, "not a box"),
        ((-74.02, 40.70, -73.98), {}, "four finite numbers"),
        ((-74.02, math.nan, -73.98, 40.73), {}, "four finite numbers"),
        *((LOWER_MANHATTAN, {"crs": crs}, "EPSG:32618") for crs in NO_CRS),
        (LOWER_MANHATTAN, {"resolution_m": 3.14159265, "nest_with_m": (7.0,)}, "no common grid"),
    ],
)
def test_what_makes_no_grid_is_refused_in_one_sentence(bounds, how, words):
    with pytest.raises(InputError, match=words) as caught:
        Grid.from_bounds(bounds, **{"resolution_m": 5.0} | how)
    assert "\n" not in str(caught.value)


sizes = st.integers(1, 90)
margins = st.integers(0, 130)


def tiling(rows, cols, west, south, east, north, shape) -> Tiling:
    region = Grid("EPSG:32618", 5.0, 901_234, -117_003, rows, cols)
    return Tiling.over(region, region.padded(west, south, east, north), shape)


@pytest.mark.slow
@given(
    sizes,
    sizes,
    margins,
    margins,
    margins,
    margins,
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
)
def test_tiles_cover_the_region_once_and_the_margin(rows, cols, west, south, east, north, shape):
    tiles = tiling(rows, cols, west, south, east, north, shape)
    times_reported = np.zeros((rows, cols), int)
    for tile in tiles.region_tiles:
        times_reported[tiles.reported(tile)] += 1
        assert tiles.grid_of(tile).shape == shape
    assert (times_reported == 1).all()
    region = tiles.region
    assert tiles.row_starts[0] <= region.first_row - south
    assert tiles.row_starts[-1] >= region.first_row + rows + north
    assert tiles.col_starts[0] <= region.first_col - west
    assert tiles.col_starts[-1] >= region.first_col + cols + east
    for starts, side in ((tiles.row_starts, shape[0]), (tiles.col_starts, shape[1])):
        steps = np.diff(starts)
        assert steps.min() >= 1
        assert steps.max() <= side
        assert len(set(steps.tolist())) <= 3  # few shapes to compile for


@given(sizes, sizes, margins, st.sampled_from([*QUADRANTS]))
def test_whatever_a_tile_of_the_region_takes_up_was_handed_on(rows, cols, margin, quadrant):
    tiles = tiling(rows, cols, margin, margin, margin, margin, (30, 40))
    needed = {near for tile in tiles.region_tiles for near in tiles.upstream(tile, quadrant)}
    handed_on = {tile for tile in tiles.tiles if tiles.hands_on(tile, quadrant)}
    assert needed <= handed_on
    assert {near for tile in handed_on for near in tiles.upstream(tile, quadrant)} <= handed_on


@given(st.integers(1, 20_000), st.integers(1, 20_000), st.integers(64, 1024))
def test_tiles_waste_less_than_one_cell_a_tile_along_each_side(rows, cols, most):
    shape = tile_shape((rows, cols), most)
    for size, side in zip((rows, cols), shape, strict=True):
        num = -(-size // side)
        assert side <= most
        assert num * side - size < num
