"""The cost of a path: closed forms and validity; and every walker of segments finds what the evaluation does."""

import itertools
from functools import cache

import jax
import numpy as np
import pytest

from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost
from jaxurban.kernels.line.segment_costs import segment_costs
from jaxurban.planners.astar import volume_astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel, path_states
from tests.planners.problems import costed

CELL = CostModel("cell")
FREE = np.ones((6, 8), bool)
LAYERS = np.random.default_rng(1).random((2, 6, 8))


def centre_m(row, col, resolution_m=5.0):
    return [(col + 0.5) * resolution_m, (row + 0.5) * resolution_m]


STEPPED_INTO = {
    "neighbours": ([[7.5, 7.5], [12.5, 7.5], [17.5, 12.5]], [(1, 2), (2, 3)]),
    "a state every 5 m": ([[7.5, 7.5], [32.5, 7.5]], [(1, 2), (1, 3), (1, 4), (1, 5), (1, 6)]),
    "a border, from the cell that it was reached through": (
        [[7.5, 7.5], [10, 7.5], [7.5, 9]],
        [(1, 1), (1, 1)],
    ),
}


@pytest.mark.parametrize(("points_m", "cells"), STEPPED_INTO.values(), ids=STEPPED_INTO)
def test_cell_model_counts_the_cells_of_states_every_resolution_step(points_m, cells):
    cost = costed(np.array(points_m), LAYERS, FREE, 5.0, 0.1, CELL)
    np.testing.assert_allclose(cost.per_layer, sum(LAYERS[:, *cell] for cell in cells))
    assert cost.length_m == pytest.approx(np.hypot(*np.diff(points_m, axis=0).T).sum())
    assert cost.total == pytest.approx(0.1 * cost.length_m + cost.per_layer.sum())


def test_cell_model_samples_an_oblique_segment_every_resolution_step():
    oblique = np.array([centre_m(0, 0), centre_m(3, 4)])  # 25 m long: five steps of 5 m
    states = path_states(oblique, 5.0)
    np.testing.assert_allclose(np.hypot(*np.diff(states, axis=0).T), 5.0)
    cols, rows = np.floor(states[1:] / 5).astype(int).T
    cost = costed(oblique, LAYERS, FREE, 5.0, 0.0, CELL)
    np.testing.assert_allclose(cost.per_layer, LAYERS[:, rows, cols].sum(axis=1))


def test_line_model_integrates_the_layers_along_the_path_however_it_is_cut():
    points = np.array([[1.0, 2.0], [33.0, 21.0], [38.0, 3.0]])
    cost = costed(points, LAYERS, FREE, 5.0, 0.2, CostModel("line", 2.5))
    along = (np.arange(200_000) + 0.5) / 200_000
    integral = np.zeros(2)
    for start, end in itertools.pairwise(points):
        cells = np.floor((start + along[:, None] * (end - start)) / 5).astype(int)
        integral += LAYERS[:, cells[:, 1], cells[:, 0]].mean(axis=1) * np.hypot(*(end - start))
    np.testing.assert_allclose(cost.per_layer, integral / 2.5, rtol=1e-4)
    assert cost.total == pytest.approx(0.2 * cost.length_m + cost.per_layer.sum())
    fine = np.concatenate([np.linspace(*points[:2], 38), np.linspace(*points[1:], 7)])
    for cut in (fine, points[::-1]):
        other = costed(cut, LAYERS, FREE, 5.0, 0.2, CostModel("line", 2.5))
        assert other.total == pytest.approx(cost.total, rel=1e-12)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_path_is_valid_where_every_crossed_cell_is_free(cost_model):
    is_free = FREE.copy()
    is_free[[2, 1], [1, 5]] = False
    layers = np.where(is_free, LAYERS, np.nan)

    def at(*points):
        return costed(np.array(points), layers, is_free, 5.0, 1.0, CostModel(cost_model))

    assert np.isfinite(
        at(centre_m(1, 1), centre_m(2, 2)).total
    )  # touches the blocked cell at its corner
    grazing = at([7.5, 7.5], [12.5, 12.6])
    assert (grazing.is_valid, grazing.total, grazing.per_layer.tolist()) == (
        False,
        np.inf,
        [np.inf, np.inf],
    )
    assert grazing.length_m == pytest.approx(np.hypot(5, 5.1))
    assert not at(centre_m(0, 0), [-1.0, 2.0]).is_valid
    assert at(
        centre_m(0, 7), [39.0, 30.0]
    ).is_valid  # ends on the map's northern border, from within
    assert not at(
        [36.0, 30.0], [39.0, 30.0]
    ).is_valid  # runs along it, which the floor rule puts outside
    assert not at(centre_m(1, 5)).is_valid
    for points in ([centre_m(2, 2)], [centre_m(2, 2)] * 2):
        still = at(*points)
        assert (still.is_valid, still.total, still.length_m, still.per_layer.tolist()) == (
            True,
            0,
            0,
            [0, 0],
        )


def test_a_diagonal_wall_through_all_levels_closes_a_volume_and_a_path_through_it_costs_infinity():
    wall = ~np.eye(9, dtype=bool)

    def problem(diagonal, upper=wall):
        is_free, model = np.stack([wall, upper]), CostModel(diagonal=diagonal)
        weights = [1.0, 1.0, 0.0, 0.0]
        return Problem(
            np.ones((1, 2, 9, 9)), is_free, (0, 6, 3), (0, 3, 6), 5.0, weights, model, [20.0, 30.0]
        )

    assert volume_astar(problem("both-free")).status is Status.NO_PATH
    through = volume_astar(problem("always"))
    assert problem("always").cost_of(through.points_m) == through.cost < np.inf
    assert problem("both-free").cost_of(through.points_m) == np.inf
    over = volume_astar(problem("both-free", np.ones_like(wall)))
    assert over.cost > through.cost
    assert over.points_m[:, 2].max() == 30.0


SHAPE = (10, 12)
NUM_SEGMENTS = 1200
OFFSETS = (0.0, 1e-12, 1e-9, 1e-7)  # of a segment from a corner, in cell sides
DIRECTIONS = np.array([(1, 1), (1, -1), (2, 1), (1, 3), (3, -2), (5, 4)])


def pinched_map(seed):
    """A checkerboard with cells turned over: about every third corner has two blocked cells that touch there."""
    rng = np.random.default_rng(seed)
    return (np.indices(SHAPE).sum(axis=0) % 2 == 0) ^ (rng.random(SHAPE) < 0.3)


@cache
def segments_by_corners(seed):
    """Segments ``[E, 2, 2]`` through corners, or by them at an offset, with ends inside cells; some lie anywhere."""
    rng = np.random.default_rng(seed)
    corner = rng.integers(2, np.array(SHAPE[::-1]) - 1, (NUM_SEGMENTS, 2)).astype(float)
    along = rng.choice(DIRECTIONS, NUM_SEGMENTS) * rng.choice([-1, 1], (NUM_SEGMENTS, 1))
    along = along / np.hypot(*along.T)[:, None]
    is_any = rng.random(NUM_SEGMENTS) < 0.2
    angle = rng.uniform(0, 2 * np.pi, NUM_SEGMENTS)
    along[is_any] = np.stack([np.cos(angle), np.sin(angle)], axis=1)[is_any]
    offset = rng.choice(OFFSETS, NUM_SEGMENTS) * rng.choice([-1, 1], NUM_SEGMENTS)
    corner += offset[:, None] * rng.choice([(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)], NUM_SEGMENTS)
    ends = np.stack(
        [corner - rng.uniform(0.05, 0.8, (NUM_SEGMENTS, 1)) * along, corner + 0.37 * along], axis=1
    )
    ends[::2, 1] = corner[::2] + rng.uniform(0.05, 1.4, (len(corner[::2]), 1)) * along[::2]
    ends[:100] = (
        rng.integers(0, 10, (100, 2, 2)) + 0.5
    )  # between centres, off the map, and of no length
    ends[:10, 1] += rng.choice([-60.0, 60.0], (10, 2))
    ends[10:20] = np.argwhere(pinched_map(seed))[:10, None, ::-1] + 0.5
    ends[100:200] = rng.uniform(0, 1, (100, 2, 2)) * SHAPE[::-1]
    return ends


@cache
def by_evaluation(seed, cost_model, diagonal):
    """What the evaluation of paths says that segments by corners cost."""
    is_free, layers = pinched_map(seed), np.random.default_rng(seed).random((1, *SHAPE))
    start, model = (
        tuple(map(int, np.argwhere(is_free)[0])),
        CostModel(cost_model, 1.0, diagonal=diagonal),
    )
    problem = Problem(layers, is_free, start, start, 1.0, 0.3, model)
    return np.array([problem.cost_of(ends) for ends in segments_by_corners(seed)])


def bulk_costs(cell_cost, segments, is_line, passes_corners):
    with jax.enable_x64(True):
        return segment_costs(
            cell_cost, segments[:, 0], segments[:, 1], 0.3, passes_corners, is_line=is_line
        )


def compiled_costs(cell_cost, segments, is_line, passes_corners):
    cost_grid = CostGrid(cell_cost, 0.3, is_line, passes_corners)
    costs = [segment_cost(cost_grid, *a, *b, np.inf) for a, b in segments]
    for (a, b), cost in zip(segments, costs, strict=True):  # what is dearer than asked for is none
        if 0 < cost < np.inf:
            assert segment_cost(cost_grid, *a, *b, cost * (1 - 1e-9)) == np.inf
            assert segment_cost(cost_grid, *a, *b, cost * 1.001 + 1e-9) in (cost, np.inf)
    return costs


@pytest.mark.slow
@pytest.mark.parametrize("diagonal", ["both-free", "always"])
@pytest.mark.parametrize("cost_model", ["line", "cell"])
@pytest.mark.parametrize("walk", [bulk_costs, compiled_costs])
def test_every_walker_finds_the_way_free_where_the_evaluation_does(walk, cost_model, diagonal):
    num_pinched = 0
    for seed in range(2):
        expected, segments = by_evaluation(seed, cost_model, diagonal), segments_by_corners(seed)
        cell_cost = np.where(pinched_map(seed), np.random.default_rng(seed).random(SHAPE), np.inf)
        found = walk(cell_cost, segments, cost_model == "line", diagonal == "always")
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        num_pinched += (
            np.isinf(expected) & np.isfinite(by_evaluation(seed, cost_model, "always"))
        ).sum()
        assert 0.05 * NUM_SEGMENTS < np.isfinite(expected).sum() < 0.9 * NUM_SEGMENTS
    assert num_pinched > (100 if diagonal == "both-free" else -1)


def test_a_segment_with_an_end_on_a_border_is_never_taken_where_the_evaluation_finds_no_way():
    rng = np.random.default_rng(2)
    taken = 0
    for seed in range(4):
        is_free = pinched_map(seed)
        cost_grid = CostGrid(np.where(is_free, 0.0, np.inf), 1.0, True, False)
        # Polylines of three points on halves: corners, middles of borders and of cells.
        for points in rng.integers(2, 18, (600, 1, 2)) / 2 + rng.integers(-1, 2, (600, 3, 2)) / 2:
            costs = [segment_cost(cost_grid, *a, *b, np.inf) for a, b in itertools.pairwise(points)]
            if np.isfinite(costs).all():
                taken += 1
                assert costed(
                    points, np.zeros((1, *SHAPE)), is_free, 1.0, 1.0, CostModel()
                ).is_valid
    assert taken > 100


@pytest.mark.slow
def test_long_segments_cost_in_bulk_what_they_do_in_the_compiled_search():
    """Many cuts of a direction, many of them at corners."""
    rng = np.random.default_rng(5)
    cell_cost = np.where(rng.random((150, 400)) < 0.999, rng.random((150, 400)), np.inf)
    segments = rng.uniform(0, cell_cost.shape[::-1], (200, 2, 2))
    segments[::2] = np.floor(segments[::2]) + 0.5
    assert np.abs(np.diff(segments, axis=1)).max() > 256
    for is_line in (True, False):
        expected = compiled_costs(cell_cost, segments, is_line, False)
        assert 40 < np.isfinite(expected).sum() < 200
        np.testing.assert_allclose(
            bulk_costs(cell_cost, segments, is_line, False), expected, rtol=1e-12
        )
