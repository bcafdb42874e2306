"""Simplified paths, judged by Shapely and brute force: the fewest legs in a tolerance, clear of closed cells."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label
from shapely import LineString, box, distance, hausdorff_distance, points, prepare, union_all

from jaxurban.kernels.line.segment_cost import is_clear
from jaxurban.planners.astar import volume_astar
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.planners.simplify import CLEAR_M, REACH, fewest_legs, simplify_path
from tests.free_space import Obstacles
from tests.planners.test_portfolio import check_simplified

SIDE_M = 5.0


def closed_squares(is_free, grown):
    """The union of the cells that are not free and of a frame around the map, grown on all sides; prepared."""
    rows, cols = np.nonzero(~np.pad(is_free, 1))
    squares = union_all(box(cols - 1 - grown, rows - 1 - grown, cols + grown, rows + grown))
    prepare(squares)
    return squares


def city(seed, shape=(40, 40), share_free=0.72):
    """Free cells in blobs, as streets and blocks are, and start and goal in the largest part."""
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.normal(size=shape), 1.2)
    is_free = noise > np.quantile(noise, 1 - share_free)
    islands, _ = label(is_free)
    cells = np.argwhere(islands == np.argmax(np.bincount(islands[is_free])))
    start, goal = (tuple(int(v) for v in cells[k]) for k in (0, -1))
    return rng, is_free, start, goal


def test_a_segment_is_clear_where_it_meets_no_grown_square():
    num = [0, 0]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        is_free = rng.random((9, 12)) < 0.8
        margin = rng.choice([0.004, 0.05, 0.3])
        squares = closed_squares(is_free, margin)
        for _ in range(300):
            ends = rng.uniform(0, [12, 9], (2, 2))
            if rng.random() < 0.3:
                ends[1, rng.integers(2)] = ends[0, rng.integers(2)]
            if rng.random() < 0.3:
                ends = np.floor(ends) + 0.5
            line = LineString(ends)
            if 0 < distance(line, squares) < 1e-9:
                continue
            is_met = bool(squares.intersects(line))
            num[is_met] += 1
            assert is_clear(is_free, *ends.ravel(), margin) == (not is_met)
            assert is_clear(is_free, *ends[::-1].ravel(), margin) == (not is_met)
    assert min(num) > 150


def fewest_by_brute_force(is_free, xy, tolerance, margin):
    """Legs and sum of squares of the best way over every pair of points, each leg tested by Shapely."""
    squares = closed_squares(is_free, margin)
    best = [(0, 0.0)] + [(len(xy), np.inf)] * (len(xy) - 1)
    for j in range(1, len(xy)):
        for i in range(j):
            leg = LineString(xy[[i, j]])
            if j > i + 1 and (
                distance(points(xy[i : j + 1]), leg).max() > tolerance or squares.intersects(leg)
            ):
                continue
            best[j] = min(best[j], (best[i][0] + 1, best[i][1] + leg.length**2))
    return best[-1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "staircase", "loops"])
def test_no_way_over_the_points_has_fewer_legs_or_more_even_ones(kind):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        is_free = rng.random((30, 30)) < 0.97
        if kind == "walk":
            xy = np.cumsum(rng.normal([0.5, 0.3], 0.5, (35, 2)), axis=0) + 2
        elif kind == "staircase":
            xy = np.cumsum(np.vstack([[0, 0], np.eye(2)[rng.integers(0, 2, 30)]]), axis=0) + 2.5
        else:
            turn = np.linspace(0, 9, 40)
            xy = (
                15
                + np.stack([np.cos(turn), np.sin(turn)], axis=1) * np.linspace(0.2, 10, 40)[:, None]
            )
        xy = np.clip(xy, 0.1, 29.9)
        tolerance = rng.uniform(0.2, 2.0)
        kept = fewest_legs(is_free, xy, tolerance, 0.01)
        number, squares = fewest_by_brute_force(is_free, xy, tolerance, 0.01)
        assert len(kept) - 1 == number
        assert np.sum(np.diff(xy[kept], axis=0) ** 2) == pytest.approx(squares, rel=1e-9)


def test_a_path_that_grazes_corners_is_moved_off_them_by_no_more_than_the_tolerance():
    is_free = np.ones((20, 30), bool)
    is_free[:10, 10:15] = False  # the shortest way round runs through this block's corners
    problem = Problem(
        np.zeros((1, 20, 30)), is_free, (5, 2), (5, 25), SIDE_M, 1.0, CostModel("line")
    )
    grazing = np.array([[2.5, 5.5], [10.0, 10.0], [15.0, 10.0], [25.5, 5.5]]) * SIDE_M
    path = Path(Status.FEASIBLE, grazing, problem.cost_of(grazing), 0.0, 0, 0.0, "drawn")
    assert path.cost < np.inf
    for tolerance_m in (0.2, 1.0):
        assert check_simplified(problem, path, Obstacles(is_free, SIDE_M), tolerance_m)
    tight = simplify_path(problem, path, 0.01)  # too little to leave the corners
    assert "pass nearer than 2 cm to a closed cell, as the planned path does" in tight.note
    assert hausdorff_distance(LineString(tight.points_m), LineString(grazing), densify=0.02) <= 0.01


def test_a_step_between_two_obstacles_that_touch_stays_as_it_was_planned_and_is_told():
    is_free = np.ones((12, 12), bool)
    is_free[np.arange(12), 11 - np.arange(12)] = False
    problem = Problem(
        np.zeros((1, 12, 12)), is_free, (1, 1), (10, 10), SIDE_M, 1.0, CostModel(diagonal="always")
    )
    path = find_planner("astar-dist")(problem, budget_s=10.0, seed=0)
    simple = simplify_path(problem, path, 2.0)
    assert simple.cost < np.inf
    assert "1 of its legs pass nearer" in simple.note
    assert len(simple.points_m) <= 4


def volume(seed, kind="line"):
    rng, low, start, goal = city(seed, (24, 24), 0.6)
    _, high, *_ = city(seed + 100, (24, 24), 0.8)
    is_free = np.stack([low, low | high, np.ones_like(low)])
    weights, model = [0.05, 1.0, 0.001, 0.001], CostModel(kind, 4.0)
    costs, levels_m = rng.random((1, *is_free.shape)), [20.0, 40.0, 90.0]
    return Problem(costs, is_free, (0, *start), (0, *goal), SIDE_M, weights, model, levels_m)


def test_a_leg_spans_so_many_points_at_most():
    xy = np.stack([np.linspace(0.5, 29.5, REACH + 2), np.full(REACH + 2, 0.5)], axis=1)
    for num, num_legs in ((REACH + 1, 1), (REACH + 2, 2)):
        assert len(fewest_legs(np.ones((30, 30), bool), xy[:num], 0.2, 0.01)) - 1 == num_legs


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_through_a_volume_each_level_is_simplified_on_its_own_cells(kind):
    num_levels = set()
    for seed in range(5):
        problem = volume(seed, kind)
        path = volume_astar(problem)
        simple = simplify_path(problem, path, 2.5)
        assert len(simple.points_m) <= len(path.points_m)
        assert simple.cost == problem.cost_of(simple.points_m) < np.inf
        is_level = np.diff(simple.points_m[:, 2]) == 0
        for (a, b), level_leg in zip(pairwise(simple.points_m), is_level, strict=True):
            if level_leg:
                level = int(np.searchsorted(problem.levels_m, a[2]))
                assert not Obstacles(problem.is_free[level], SIDE_M).is_near(
                    [a[:2], b[:2]], CLEAR_M * (1 - 1e-6)
                )
        legs = [[*pairwise(found.points_m.tolist())] for found in (path, simple)]
        climbs, kept = ([(a, b) for a, b in of_one if a[2] != b[2]] for of_one in legs)
        assert kept == climbs
        num_levels.add(len(np.unique(path.points_m[:, 2])))
    assert max(num_levels) > 1


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_a_leg_of_any_direction_costs_on_a_level_what_it_costs_on_one_altitude(kind):
    rng = np.random.default_rng(2)
    cost, is_free = rng.random((2, 20, 20)), rng.random((20, 20)) < 0.95
    model = CostModel(kind, 4.0)
    flat = Problem(
        cost[1][None], is_free, *[tuple(np.argwhere(is_free)[0])] * 2, SIDE_M, 0.3, model
    )
    start, both = (1, *flat.start), np.stack([is_free] * 2)
    stacked = Problem(
        cost[None], both, start, start, SIDE_M, [0.3, 1.0, 0.0, 0.0], model, [20.0, 50.0]
    )
    num_valid = 0
    for _ in range(200):
        xy_m = rng.uniform(1, 99, (rng.integers(1, 5), 2))
        expected = flat.features(xy_m)
        found = stacked.features(np.column_stack([xy_m, np.full(len(xy_m), 50.0)]))
        assert found.is_valid == expected.is_valid
        np.testing.assert_allclose(found.phi[:2], expected.phi, rtol=1e-12)
        num_valid += found.is_valid
        if found.is_valid:
            np.testing.assert_allclose(found.mean_costs, expected.mean_costs, rtol=1e-12)
    assert num_valid > 40
