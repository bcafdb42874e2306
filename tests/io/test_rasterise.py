"""Burning: which cells an outline covers, by their centres and by any area that they share with it."""

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.read.buildings import BuildingFile, read_buildings
from jaxurban.io.read.rasterise import burn, widen

CRS = "EPSG:32618"
OUTER = (900_000, 110_000, 40, 40)  # first row and column, rows, columns
INNER = (900_007, 110_013, 20, 17)


def burnt(polygons, values, grid):
    """Return what is burnt by centres, and by touch."""
    polygons, values = np.array(polygons, object), np.asarray(values, float)
    centre = burn(polygons, values, grid, 0.0, "float32")
    return centre, widen(centre, polygons, values, grid)


def shared_area_m2(polygons, grid):
    """Return polygon, cell and area of every pair of a polygon and a cell of the grid that meet."""
    rows, cols = (index.ravel() for index in np.indices(grid.shape))
    x_m, y_m = grid.x_min_m + cols * grid.resolution_m, grid.y_min_m + rows * grid.resolution_m
    boxes = shapely.box(x_m, y_m, x_m + grid.resolution_m, y_m + grid.resolution_m)
    polygon, cell = shapely.STRtree(boxes).query(polygons, predicate="intersects")
    return polygon, cell, shapely.area(shapely.intersection(polygons[polygon], boxes[cell]))


def check_touched(polygons, values, grid):
    """Assert that every cell has the height of the highest polygon that shares area with it, slivers aside."""
    polygons, values = np.array(polygons, object), np.asarray(values, np.float32)
    _, touched = burnt(polygons, values, grid)
    polygon, cell, area_m2 = shared_area_m2(polygons, grid)
    sliver_m2 = 1e-6 * grid.resolution_m**2  # a cut thinner than the rounding of corners onto borders
    least, most = np.zeros(touched.size, np.float32), np.zeros(touched.size, np.float32)
    np.maximum.at(least, cell[area_m2 > sliver_m2], values[polygon[area_m2 > sliver_m2]])
    np.maximum.at(most, cell, values[polygon])
    assert np.all(least <= touched.ravel())
    assert np.all(touched.ravel() <= most)


def test_every_cell_that_shares_area_with_an_outline_is_touched():
    rng = np.random.default_rng(1)
    grid = ju.Grid(CRS, 2.5, *OUTER)
    corner_m = np.array([grid.x_min_m, grid.y_min_m])
    polygons = []
    for _ in range(60):
        centre_m, angles = corner_m + rng.uniform(-10, 110, 2), np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
        shape = centre_m + rng.uniform(0.5, 25) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        polygon = shapely.Polygon(shape)
        if rng.random() < 0.3:
            polygon = polygon.difference(shapely.centroid(polygon).buffer(3.0))
        if rng.random() < 0.3:
            polygon = shapely.union(polygon, shapely.box(*centre_m, *(centre_m + 0.01)))
        polygons.append(polygon)
    check_touched(polygons, rng.uniform(3, 90, len(polygons)), grid)


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
        wall = shapely.LineString([middle_m - 80 * along, middle_m + 80 * along]).buffer(0.1, cap_style="flat")
        centre, touched = burnt([wall], [30.0], grid)
        check_touched([wall], [30.0], grid)
        assert (centre > 0).sum() < (touched > 0).sum()
        is_blocked = touched > 0
        pinched = is_blocked[:-1, :-1] & is_blocked[1:, 1:] & ~is_blocked[1:, :-1] & ~is_blocked[:-1, 1:]
        pinched |= ~is_blocked[:-1, :-1] & ~is_blocked[1:, 1:] & is_blocked[1:, :-1] & is_blocked[:-1, 1:]
        assert pinched.sum() == 0


@pytest.mark.parametrize("resolution_m", [5.0, 0.7])
def test_burning_a_part_equals_the_crop_even_on_cell_borders(resolution_m):
    rng = np.random.default_rng(0)
    outer, inner = ju.Grid(CRS, resolution_m, *OUTER), ju.Grid(CRS, resolution_m, *INNER)
    for _ in range(40):
        cells = rng.integers(0, 80, (4, 2)) / 2.0  # vertices on cell borders and centres
        polygon = shapely.convex_hull(shapely.multipoints((cells + np.array([110_000, 900_000])) * resolution_m))
        if polygon.area > 0:
            for whole, part in zip(burnt([polygon], [1.0], outer), burnt([polygon], [1.0], inner), strict=True):
                np.testing.assert_array_equal(part, whole[inner.window_in(outer)])


@pytest.mark.slow
@pytest.mark.data
def test_every_cell_that_a_building_of_lower_manhattan_shares_area_with_is_touched(data_dir):
    buildings = read_buildings(BuildingFile(data_dir / "osm/lower-manhattan.osm.pbf"), CRS).buildings
    for resolution_m in (5.0, 2.0):
        grid = ju.Grid.from_bounds((-74.014, 40.703, -74.006, 40.709), resolution_m, CRS)
        check_touched(buildings.polygons, buildings.height_m, grid)
