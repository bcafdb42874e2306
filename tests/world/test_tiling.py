"""Tiling: every cell of the region in one tile, the margin covered, shadows upstream first."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxurban.errors import InputError
from jaxurban.maps.tiled import QUADRANTS, Tiling
from jaxurban.world.grid import Grid, tile_shape

sizes = st.integers(1, 90)
margins = st.integers(0, 130)


def tiling(rows, cols, west, south, east, north, shape) -> Tiling:
    region = Grid("EPSG:32618", 5.0, 901_234, -117_003, rows, cols)
    return Tiling.over(region, region.padded(west, south, east, north), shape)


@given(sizes, sizes, margins, margins, margins, margins, st.tuples(st.integers(1, 40), st.integers(1, 40)))
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


@given(sizes, sizes, margins, st.sampled_from(QUADRANTS))
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


def test_a_tile_without_cells_is_refused():
    with pytest.raises(InputError, match="at least one cell"):
        tiling(3, 3, 0, 0, 0, 0, (0, 4))
