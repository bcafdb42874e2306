"""Cells crossed by polylines, against closed forms, Shapely and hand counts."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.kernels.traversal import crossed_cells


def cells(points_m, resolution_m=1.0):
    crossings = crossed_cells(np.array(points_m, float), resolution_m)
    return list(zip(crossings.row.tolist(), crossings.col.tolist(), strict=True))


@pytest.mark.parametrize("resolution_m", [1.0, 0.1, 5.0, 2.7])
def test_crossed_cells_and_lengths_equal_shapely_intersections(resolution_m):
    rng = np.random.default_rng(3)
    num = 8
    corners = np.arange(num) * resolution_m
    boxes = shapely.box(*np.meshgrid(corners, corners), *(np.array(np.meshgrid(corners, corners)) + resolution_m))
    for _ in range(40):
        points_m = rng.uniform(0, num * resolution_m, (4, 2))
        crossings = crossed_cells(points_m, resolution_m)
        for s in range(3):
            expected = shapely.length(shapely.intersection(shapely.LineString(points_m[s : s + 2]), boxes))
            found = np.zeros((num, num))
            of_segment = crossings.segment == s
            np.add.at(found, (crossings.row[of_segment], crossings.col[of_segment]), crossings.length_m[of_segment])
            np.testing.assert_allclose(found, expected, atol=1e-9 * resolution_m)


@pytest.mark.parametrize("resolution_m", [1.0, 0.1, 0.3, 5.0, 7.7])
@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_diagonal_through_corners_crosses_only_the_cells_on_it(resolution_m, rows, cols):
    steps = np.arange(200)
    start = np.array([1000, 300])
    expected = [(300 + rows * int(k), 1000 + cols * int(k)) for k in steps]
    centres_m = (start + np.outer(steps, [cols, rows]) + 0.5) * resolution_m
    assert cells(centres_m[[0, -1]], resolution_m) == expected
    stepwise = cells(centres_m, resolution_m)
    assert list(dict.fromkeys(stepwise)) == expected


def test_lengths_of_a_diagonal_step_are_half_in_each_cell():
    crossings = crossed_cells(np.array([[0.5, 0.5], [1.5, 1.5]]) * 5, 5.0)
    np.testing.assert_allclose(crossings.length_m, [np.sqrt(0.5) * 5] * 2)


def test_a_knight_step_crosses_corner_free_cells_in_order():
    assert cells([[0.5, 0.5], [2.5, 1.5]]) == [(0, 0), (0, 1), (1, 1), (1, 2)]
    assert cells([[2.5, 1.5], [0.5, 0.5]]) == [(1, 2), (1, 1), (0, 1), (0, 0)]


@pytest.mark.parametrize("direction", [1, -1])
def test_a_run_along_a_border_belongs_north_and_east(direction):
    assert cells([[0.0, 2.0], [3.0, 2.0]][::direction]) == [(2, 0), (2, 1), (2, 2)][::direction]
    assert cells([[2.0, 0.0], [2.0, 3.0]][::direction]) == [(0, 2), (1, 2), (2, 2)][::direction]


def test_a_border_that_rounding_moved_is_still_the_border():
    below = np.nextafter(0.3, 0)
    assert cells([[0.05, below], [0.25, below]], 0.1) == [(3, 0), (3, 1), (3, 2)]


def test_a_vertex_on_a_border_touches_without_crossing():
    assert cells([[0.5, 0.5], [1.0, 0.75], [0.5, 0.9]]) == [(0, 0), (0, 0)]
    assert cells([[1.5, 0.5], [1.0, 0.75], [1.5, 0.9]]) == [(0, 1), (0, 1)]


def test_paths_beyond_the_map_have_negative_cells():
    assert cells([[0.5, 0.5], [-1.5, 0.5]]) == [(0, 0), (0, -1), (0, -2)]


def test_a_path_of_no_length_lies_in_one_cell():
    for points in ([[2.5, 1.5]], [[2.5, 1.5]] * 3):
        crossings = crossed_cells(np.array(points), 1.0)
        assert (crossings.row.tolist(), crossings.col.tolist(), crossings.length_m.tolist()) == ([1], [2], [0.0])


@pytest.mark.parametrize("points", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[np.nan, 1.0]], [[np.inf, 1.0], [0, 0]]])
def test_points_that_are_no_path_are_refused(points):
    with pytest.raises(InputError, match="points_m"):
        crossed_cells(np.array(points, float), 1.0)
