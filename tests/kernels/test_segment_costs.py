"""Segments costed in bulk: against Shapely's intersections, the compiled edge costs, and cases done by hand."""

import jax
import numpy as np
import pytest
from shapely import LineString, box

from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost, segment_costs

SHAPE = (9, 12)
NUM_SEGMENTS = 200
CELL_COST = np.where(np.random.default_rng(1).random(SHAPE) < 0.9, np.random.default_rng(2).random(SHAPE), np.inf)


def costs_of(start, end, is_line=True, cell_cost=CELL_COST, per_side=0.3, passes_corners=False):
    """Costs of segments, filled up to a fixed number so that all tests share what is compiled."""
    padded = np.full((2, NUM_SEGMENTS, 2), 0.5)
    padded[0, : len(start)], padded[1, : len(end)] = start, end
    with jax.enable_x64(True):
        found = segment_costs(cell_cost, *padded, per_side, is_line, passes_corners)
        return np.asarray(found)[: len(start)]


def random_segments(seed):
    """Half of them between cell centres, whose borders and corners they hit exactly."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0, SHAPE[::-1], (2, NUM_SEGMENTS, 2))
    ends[:, ::2] = np.floor(ends[:, ::2]) + 0.5
    return ends


def test_line_costs_are_cell_costs_times_lengths_in_cells_by_shapely():
    start, end = random_segments(3)
    for k, cost in enumerate(costs_of(start, end)):
        segment = LineString([start[k], end[k]])
        inside = np.array(
            [[segment.intersection(box(c, r, c + 1, r + 1)).length for c in range(SHAPE[1])] for r in range(SHAPE[0])]
        )
        is_crossed = inside > 1e-8
        expected = 0.3 * segment.length + (CELL_COST[is_crossed] * inside[is_crossed]).sum()
        assert cost == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("is_line", [True, False])
def test_bulk_costs_equal_those_of_the_compiled_search(is_line):
    start, end = random_segments(4)
    cost_grid = CostGrid(CELL_COST, 0.3, is_line, False)
    expected = [segment_cost(cost_grid, *a, *b, np.inf) for a, b in zip(start, end, strict=True)]
    assert 20 < np.isfinite(expected).sum() < NUM_SEGMENTS - 20
    np.testing.assert_allclose(costs_of(start, end, is_line), expected, rtol=1e-12)


def test_a_corner_touched_on_one_side_is_free_one_cut_or_touched_on_both_is_not():
    cell_cost = np.zeros(SHAPE)
    cell_cost[3, 4] = np.inf  # its southwest corner is at x = 4, y = 3
    start, end = np.array([[3.5, 3.5], [3.5, 3.5]]), np.array([[4.5, 2.5], [4.5, 2.5 + 1e-6]])
    for is_line in (True, False):
        cell_cost[2, 3] = 0.0
        costs = costs_of(start, end, is_line, cell_cost=cell_cost, per_side=1.0)
        np.testing.assert_allclose(costs, [np.sqrt(2), np.inf])
        cell_cost[2, 3] = np.inf  # the cell on the other side
        costs = costs_of(start, end, is_line, cell_cost=cell_cost, per_side=1.0)
        np.testing.assert_allclose(costs, [np.inf, np.inf])
        costs = costs_of(start, end, is_line, cell_cost=cell_cost, per_side=1.0, passes_corners=True)
        np.testing.assert_allclose(costs, [np.sqrt(2), np.inf])


def test_no_length_costs_nothing_and_no_way_leads_off_the_map():
    start = np.array([[2.5, 2.5], [0.5, 4.5], [0.5, 4.5]])
    end = np.array([[2.5, 2.5], [-3.5, 4.5], [0.5, 60.5]])
    for is_line in (True, False):
        np.testing.assert_array_equal(
            costs_of(start, end, is_line, cell_cost=np.zeros(SHAPE), per_side=1.0), [0.0, np.inf, np.inf]
        )


def test_long_segments_cost_what_they_do_in_the_compiled_search():
    """Many cuts of a direction, many of them at corners."""
    rng = np.random.default_rng(5)
    cell_cost = np.where(rng.random((150, 400)) < 0.999, rng.random((150, 400)), np.inf)
    start, end = rng.uniform(0, cell_cost.shape[::-1], (2, NUM_SEGMENTS, 2))
    start[::2], end[::2] = np.floor(start[::2]) + 0.5, np.floor(end[::2]) + 0.5
    assert np.abs(end - start).max() > 256
    for is_line in (True, False):
        cost_grid = CostGrid(cell_cost, 0.3, is_line, False)
        expected = [segment_cost(cost_grid, *a, *b, np.inf) for a, b in zip(start, end, strict=True)]
        assert 40 < np.isfinite(expected).sum() < NUM_SEGMENTS
        np.testing.assert_allclose(costs_of(start, end, is_line, cell_cost), expected, rtol=1e-12)
