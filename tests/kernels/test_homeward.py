"""The highest cell on straight lines home, against the convex hulls of cells and home by Shapely."""

import numpy as np
import pytest
import shapely

from jaxurban.kernels.line.homeward import highest_homeward

SHAPES = ((17, 23), (30, 12), (24, 24))
PLACES = {
    "anywhere": lambda at: at,
    "a corner": np.floor,
    "a centre": lambda at: np.floor(at) + 0.5,
    "a side": lambda at: np.where([True, False], np.floor(at), at),
    "the grid's corner": lambda at: 0 * at,
}
TOPS = {
    "all differ": lambda values: values,
    "few heights": lambda values: np.round(3 * values),
    "towers": lambda values: np.where(values > 0.9, values, 0),
    "unknown": lambda values: np.where(values > 0.98, np.inf, values),
}


def by_hulls(top_m: np.ndarray, home: np.ndarray) -> np.ndarray:
    """The highest cell that the convex hull of each cell's square and home touches."""
    row, col = np.indices(top_m.shape)
    squares = shapely.box(col, row, col + 1, row + 1).ravel()
    hulls = shapely.convex_hull(shapely.union(squares, shapely.Point(home[::-1])))
    hull, touched = shapely.STRtree(squares).query(hulls, predicate="intersects")
    highest_m = np.full(top_m.size, -np.inf, np.float32)
    np.maximum.at(highest_m, hull, top_m.ravel()[touched])
    return highest_m.reshape(top_m.shape)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("tops", TOPS)
def test_highest_cell_homeward_is_that_of_the_hulls_that_cells_make_with_home(place, tops):
    rng = np.random.default_rng([len(place), len(tops)])
    for shape in SHAPES:
        top_m = TOPS[tops](rng.random(shape)).astype(np.float32)
        home = PLACES[place](rng.random(2) * shape)
        found_m = highest_homeward(top_m, tuple(map(float, home)))
        np.testing.assert_array_equal(found_m, by_hulls(top_m, home))


def test_a_tower_is_behind_home_or_on_the_way():
    top_m = np.zeros((9, 9), np.float32)
    top_m[4, 6] = 50.0
    found_m = highest_homeward(top_m, (4.5, 4.5))
    assert (found_m[:, :4] == 0).all()
    assert found_m[4, 8] == 50
