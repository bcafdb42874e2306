"""Cells crossed by polylines, against closed forms, Shapely and hand counts."""

import numpy as np
import pytest
import shapely

from jaxurban.kernels.line.traversal import crossed_cells, is_free_way


def cells(points_m, resolution_m=1.0):
    crossings = crossed_cells(np.array(points_m, float), resolution_m)
    return list(zip(crossings.row.tolist(), crossings.col.tolist(), strict=True))


@pytest.mark.parametrize("resolution_m", [1.0, 0.1, 5.0, 2.7])
def test_crossed_cells_and_lengths_equal_shapely_intersections(resolution_m):
    rng = np.random.default_rng(3)
    num = 8
    corners = np.arange(num) * resolution_m
    boxes = shapely.box(
        *np.meshgrid(corners, corners), *(np.array(np.meshgrid(corners, corners)) + resolution_m)
    )
    for _ in range(40):
        points_m = rng.uniform(0, num * resolution_m, (4, 2))
        crossings = crossed_cells(points_m, resolution_m)
        for s in range(3):
            expected = shapely.length(
                shapely.intersection(shapely.LineString(points_m[s : s + 2]), boxes)
            )
            found = np.zeros((num, num))
            of_segment = crossings.segment == s
            np.add.at(
                found,
                (crossings.row[of_segment], crossings.col[of_segment]),
                crossings.length_m[of_segment],
            )
            np.testing.assert_allclose(found, expected, atol=1e-9 * resolution_m)


@pytest.mark.parametrize("resolution_m", [1.0, 0.1, 0.3, 5.0, 7.7])
@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_diagonal_through_corners_crosses_only_the_cells_on_it(resolution_m, rows, cols):
    steps = np.arange(200)
    start = np.array([1000, 300])
    expected = [(300 + rows * int(k), 1000 + cols * int(k)) for k in steps]
    centres_m = (start + np.outer(steps, [cols, rows]) + 0.5) * resolution_m
    assert cells(centres_m[[0, -1]], resolution_m) == expected
    assert list(dict.fromkeys(cells(centres_m, resolution_m))) == expected
    step = crossed_cells(centres_m[:2], resolution_m)
    np.testing.assert_allclose(step.length_m, [np.sqrt(0.5) * resolution_m] * 2)


CROSSED = {
    "a knight's step": ([[0.5, 0.5], [2.5, 1.5]], [(0, 0), (0, 1), (1, 1), (1, 2)]),
    "along a border: north": ([[0.0, 2.0], [3.0, 2.0]], [(2, 0), (2, 1), (2, 2)]),
    "along a border: east": ([[2.0, 0.0], [2.0, 3.0]], [(0, 2), (1, 2), (2, 2)]),
    "a border that is touched": ([[0.5, 0.5], [1.0, 0.75], [0.5, 0.9]], [(0, 0), (0, 0)]),
    "a border that is touched from the east": (
        [[1.5, 0.5], [1.0, 0.75], [1.5, 0.9]],
        [(0, 1), (0, 1)],
    ),
    "beyond the map": ([[0.5, 0.5], [-1.5, 0.5]], [(0, 0), (0, -1), (0, -2)]),
    "a point": ([[2.5, 1.5]], [(1, 2)]),
    "a point three times": ([[2.5, 1.5]] * 3, [(1, 2)]),
}


@pytest.mark.parametrize(("points", "expected"), CROSSED.values(), ids=CROSSED)
def test_cells_are_crossed_in_the_order_of_the_way(points, expected):
    assert cells(points) == expected
    assert cells(points[::-1]) == expected[::-1]


def test_a_border_that_rounding_moved_is_still_the_border():
    below = np.nextafter(0.3, 0)
    assert cells([[0.05, below], [0.25, below]], 0.1) == [(3, 0), (3, 1), (3, 2)]


WALL = np.array(
    [[1, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 1]], bool
)  # row 0, in the south, comes first
CORNERS = {  # of WALL: blocked cells northwest and southeast of (1, 1); southwest and northeast none; (3, 3) likewise
    "between two": ([[0.5, 0.5], [1.5, 1.5]], False),
    "the other way": ([[1.5, 1.5], [0.5, 0.5]], False),
    "at a vertex": ([[0.5, 0.5], [1, 1], [1.2, 1.9]], False),
    "at a vertex met twice": ([[0.5, 0.5], [1, 1], [1, 1], [1 + 5e-10, 1], [1.5, 1.5]], False),
    "at a vertex moved by rounding": ([[0.5, 0.5], [1 - 9e-10, 1 + 9e-10], [1.2, 1.9]], False),
    "bent at a vertex, past one": ([[2.5, 2.5], [2, 2], [2.5, 1.5]], True),
    "touched and left again": ([[0.3, 0.5], [1, 1], [0.5, 0.3]], True),
    "begun at the corner": ([[1, 1], [0.5, 0.5]], True),
    "ended at the corner": ([[1.5, 1.2], [1, 1]], True),
    "a step of no length on it": ([[1, 1], [1, 1]], True),
    "near it, through a blocked sliver": ([[0.5, 0.5], [1.5, 1.5 + 1e-7]], False),
    "past one blocked cell": ([[2.5, 3.5], [3.5, 2.5]], False),
    "past one, the other free": ([[1.5, 3.5], [2.5, 2.5]], True),
    "by a piece shorter than the tolerance": (
        [[2.9, 2.9], [3 - 4e-10, 3 - 4e-10], [3 + 4e-10, 3.1]],
        False,
    ),
    "a whole path shorter than the tolerance": (
        [[3 - 4e-10, 3 - 4e-10], [3 + 4e-10, 3 + 4e-10]],
        True,
    ),
}


@pytest.mark.parametrize(("points", "is_free"), CORNERS.values(), ids=CORNERS.keys())
def test_two_blocked_cells_that_touch_at_a_corner_leave_no_gap(points, is_free):
    points = np.array(points, float)
    for resolution_m in (1.0, 5.0, 0.1):
        assert (
            is_free_way(crossed_cells(points * resolution_m, resolution_m), WALL, False) is is_free
        )


@pytest.mark.parametrize(
    ("blocked", "is_free"),
    [
        ((), True),
        (((1, 2),), True),
        (((2, 2),), False),
        (((1, 2), (2, 2)), False),
        (((1, 1), (2, 3)), False),
    ],
)
@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
def test_along_a_border_the_cell_north_or_east_decides_and_between_two_blocked_there_is_no_way(
    blocked, is_free, axes
):
    free = np.ones((5, 5), bool)
    for row, col in blocked:
        free[(row, col) if axes == (0, 1) else (col, row)] = False
    along = np.array([[0.5, 2.0], [4.5, 2.0]])[:, axes]  # on the border y = 2, or x = 2
    for points in (along, along[::-1]):
        assert is_free_way(crossed_cells(points, 1.0), free, False) is is_free


def test_a_bend_on_a_corner_between_borders_passes_it():
    free = np.ones((3, 3), bool)
    free[1, 1] = free[0, 0] = False  # they touch at (1, 1)
    bend = np.array([[0.5, 1.0], [1.0, 1.0], [1.0, 0.5]])  # north of the one, then east of it
    for points in (bend, bend[::-1]):
        crossings = crossed_cells(points, 1.0)
        assert not is_free_way(crossings, free, False)
        assert is_free_way(crossings, free, True)
    free[1, 1] = True
    assert is_free_way(crossings, free, False)


@pytest.mark.slow
def test_a_way_is_free_where_a_thin_tube_around_it_joins_its_ends_inside_free_cells():
    rng = np.random.default_rng(5)
    seen = {True: 0, False: 0, "corner": 0}
    while min(seen.values()) < 25:
        free = (np.indices((4, 4)).sum(axis=0) % 2 == 0) ^ (rng.random((4, 4)) < 0.3)
        inside = shapely.union_all(
            [shapely.box(c, r, c + 1, r + 1) for r, c in np.argwhere(free)]
        ).buffer(-1e-6)
        for _ in range(20):
            # All on quarters, the ends inside cells: many segments run through corners, and bend there.
            ends = rng.integers(0, 4, (2, 2)) + rng.integers(1, 4, (2, 2)) / 4
            vertex = ends.mean(axis=0).round() + rng.integers(-1, 2, 2) / 4
            points = np.array([ends[0], vertex, ends[1]])
            tube = shapely.intersection(shapely.LineString(points).buffer(1e-3), inside)
            parts = shapely.get_parts(tube)
            expected = bool(
                np.any(
                    np.all([shapely.dwithin(parts, shapely.Point(p), 1e-5) for p in points], axis=0)
                )
            )
            crossings = crossed_cells(points, 1.0)
            assert is_free_way(crossings, free, False) is expected
            seen[expected] += 1
            seen["corner"] += not expected and is_free_way(crossings, free, True)
