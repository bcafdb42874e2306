"""The cost of a path: closed forms, validity, and refinement to the integral."""

import itertools

import numpy as np
import pytest

from jaxurban.planners.cost import CostModel, path_states
from tests.planners.problems import costed

CELL = CostModel("cell")
FREE = np.ones((6, 8), bool)
LAYERS = np.random.default_rng(1).random((2, 6, 8))


def centre_m(row, col, resolution_m=5.0):
    return [(col + 0.5) * resolution_m, (row + 0.5) * resolution_m]


def test_cell_model_counts_the_cells_stepped_into():
    cost = costed(np.array([centre_m(1, 1), centre_m(1, 2), centre_m(2, 3)]), LAYERS, FREE, 5.0, 0.1, CELL)
    np.testing.assert_allclose(cost.per_layer, LAYERS[:, 1, 2] + LAYERS[:, 2, 3])
    assert cost.length_m == pytest.approx(5 + 5 * np.sqrt(2))
    assert cost.total == pytest.approx(0.1 * cost.length_m + cost.per_layer.sum())


def test_cell_model_samples_a_long_segment_every_resolution_step():
    points = np.array([centre_m(1, 1), centre_m(1, 6)])
    cost = costed(points, LAYERS, FREE, 5.0, 0.0, CELL)
    np.testing.assert_allclose(cost.per_layer, LAYERS[:, 1, 2:7].sum(axis=1))
    oblique = np.array([centre_m(0, 0), centre_m(3, 4)])  # 25 m long: five steps of 5 m
    states = path_states(oblique, 5.0)
    np.testing.assert_allclose(np.hypot(*np.diff(states, axis=0).T), 5.0)
    rows, cols = np.floor(states[1:, 1] / 5).astype(int), np.floor(states[1:, 0] / 5).astype(int)
    np.testing.assert_allclose(
        costed(oblique, LAYERS, FREE, 5.0, 0.0, CELL).per_layer, LAYERS[:, rows, cols].sum(axis=1)
    )


def test_a_state_on_a_border_counts_in_the_cell_it_came_through():
    is_free = FREE.copy()
    is_free[1, 2] = False
    cost = costed(np.array([[7.5, 7.5], [10.0, 7.5], [7.5, 9.0]]), LAYERS, is_free, 5.0, 0.0, CELL)
    assert cost.is_valid
    np.testing.assert_allclose(cost.per_layer, 2 * LAYERS[:, 1, 1])


def test_line_model_integrates_the_layers_along_the_path():
    points = np.array([[1.0, 2.0], [33.0, 21.0], [38.0, 3.0]])
    cost = costed(points, LAYERS, FREE, 5.0, 0.2, CostModel("line", 2.5))
    along = (np.arange(200_000) + 0.5) / 200_000
    integral = np.zeros(2)
    for start, end in itertools.pairwise(points):
        at = start + along[:, None] * (end - start)
        cells = np.floor(at / 5).astype(int)
        integral += LAYERS[:, cells[:, 1], cells[:, 0]].mean(axis=1) * np.hypot(*(end - start))
    np.testing.assert_allclose(cost.per_layer, integral / 2.5, rtol=1e-4)
    assert cost.total == pytest.approx(0.2 * cost.length_m + cost.per_layer.sum())


def test_line_cost_does_not_depend_on_how_a_path_is_cut():
    ends = np.array([[1.0, 2.0], [33.0, 21.0]])
    fine = ends[0] + np.linspace(0, 1, 38)[:, None] * (ends[1] - ends[0])
    costs = [costed(points, LAYERS, FREE, 5.0, 0.2, CostModel("line")).total for points in (ends, fine, ends[::-1])]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-12)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_path_is_valid_where_every_crossed_cell_is_free(cost_model):
    is_free = FREE.copy()
    is_free[2, 1] = False
    is_free[1, 5] = False
    layers = np.where(is_free, LAYERS, np.nan)

    def at(*points):
        return costed(np.array(points), layers, is_free, 5.0, 1.0, CostModel(cost_model))

    touching = at(centre_m(1, 1), centre_m(2, 2))  # touches the blocked cell at its corner
    assert touching.is_valid
    assert np.isfinite(touching.total)
    grazing = at([7.5, 7.5], [12.5, 12.6])
    assert not grazing.is_valid
    assert grazing.total == np.inf
    assert np.isinf(grazing.per_layer).all()
    assert grazing.length_m == pytest.approx(np.hypot(5, 5.1))
    assert not at(centre_m(0, 0), [-1.0, 2.0]).is_valid
    assert at(centre_m(0, 7), [39.0, 30.0]).is_valid  # ends on the map's northern border, from within
    assert not at([36.0, 30.0], [39.0, 30.0]).is_valid  # runs along it, which the floor rule puts outside
    assert not at(centre_m(1, 5)).is_valid


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_two_blocked_cells_that_touch_at_a_corner_leave_no_gap(cost_model):
    is_free = FREE.copy()
    is_free[[1, 2], [2, 1]] = False
    between = np.array([centre_m(1, 1), centre_m(2, 2)])
    in_two = np.array([centre_m(1, 1), [10.0, 10.0], centre_m(2, 2)])  # a vertex on the corner itself
    for points in (between, in_two, in_two[::-1]):
        closed = costed(points, LAYERS, is_free, 5.0, 1.0, CostModel(cost_model))
        assert not closed.is_valid
        assert closed.total == np.inf
        assert np.isinf(closed.per_layer).all()
        passed = costed(points, LAYERS, is_free, 5.0, 1.0, CostModel(cost_model, diagonal="always"))
        assert passed.is_valid
        assert np.isfinite(passed.total)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_path_of_one_point_costs_nothing(cost_model):
    for points in ([centre_m(2, 2)], [centre_m(2, 2)] * 2):
        cost = costed(np.array(points), LAYERS, FREE, 5.0, 1.0, CostModel(cost_model))
        assert cost.is_valid
        assert cost.total == cost.length_m == 0
        assert cost.per_layer.tolist() == [0, 0]
