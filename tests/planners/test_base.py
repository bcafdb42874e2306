"""What a problem accepts and refuses."""

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import STEPS, CostModel, allowed_moves

FREE = np.array([[True, True, True], [True, False, True]])
LAYERS = np.ones((2, 2, 3))


def make(costs=LAYERS, is_free=FREE, start=(0, 0), goal=(0, 2), resolution_m=1.0, weights=1.0, **options):
    return Problem(costs, is_free, start, goal, resolution_m, weights, **options)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"costs": np.where(FREE, np.nan, 0)[None]}, "costs must be finite"),
        ({"costs": np.array([-np.ones((2, 3)), 2 * np.ones((2, 3))])}, "not negative"),
        ({"costs": np.full((1, 2, 3), np.inf)}, "costs must be finite"),
        ({"start": (0, 3)}, "outside the map"),
        ({"goal": (-1, 0)}, "outside the map"),
        ({"goal": (1, 1)}, "inside an obstacle"),
        ({"resolution_m": 0.0}, "resolution_m must be a positive"),
        ({"weights": -0.1}, "weights must be"),
        ({"weights": np.nan}, "weights must be"),
        ({"cost_model": "cells"}, "kind must be 'cell' or 'line', got 'cells'"),
    ],
)
def test_a_wrong_problem_is_refused_with_a_sentence_that_names_it(changes, message):
    with pytest.raises(InputError, match=message):
        make(**changes)


def test_costs_inside_obstacles_may_be_anything():
    layers = np.where(FREE, LAYERS, np.nan)
    assert make(layers).cost[0, 0] == 2


def test_arguments_stay_writable_and_unaltered():
    layers, is_free = LAYERS.copy(), FREE.copy()
    make(layers, is_free)
    layers[0, 0, 0] = 7
    is_free[0, 0] = False


def test_between_asks_the_same_map_between_other_cells():
    problem = make()
    other = problem.between((1, 0), (1, 2))
    assert (problem.start, other.start, other.goal) == ((0, 0), (1, 0), (1, 2))
    assert other.cost is problem.cost
    with pytest.raises(InputError, match="inside an obstacle"):
        problem.between((0, 0), (1, 1))


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("needs_both_free", [True, False])
def test_allowed_moves_equal_the_rule_written_out(connectivity, needs_both_free):
    is_free = np.random.default_rng(2).random((9, 11)) < 0.6
    moves = allowed_moves(is_free, connectivity, needs_both_free)

    def free(row, col):
        return 0 <= row < 9 and 0 <= col < 11 and bool(is_free[row, col])

    for row, col in np.ndindex(9, 11):
        for k, (rows, cols) in enumerate(STEPS):
            expected = k < connectivity and free(row, col) and free(row + rows, col + cols)
            if rows and cols and needs_both_free:
                expected = expected and free(row + rows, col) and free(row, col + cols)
            assert bool(moves[row, col] >> k & 1) == expected


def test_every_status_has_a_sentence_and_an_exit_code():
    assert {status: status.exit_code for status in Status} == {
        Status.OPTIMAL: 0,
        Status.FEASIBLE: 0,
        Status.BUDGET_FEASIBLE: 0,
        Status.NO_PATH: 3,
        Status.BLOCKED: 3,
        Status.BUDGET_EMPTY: 4,
    }
    assert all(status.sentence.endswith(".") for status in Status)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cost_model": "cells"}, "cost_model must be 'cell' or 'line', got 'cells'"),
        ({"reference_length_m": np.nan}, "reference_length_m must be a positive number of metres, got nan"),
        ({"reference_length_m": "far"}, "reference_length_m must be a number"),
        ({"connectivity": 26}, "connectivity must be 4 or 8"),
        ({"diagonal": "never"}, "diagonal must be 'both-free' or 'always'"),
    ],
)
def test_a_wrong_cost_model_is_refused_with_a_sentence_that_names_it(settings, message):
    with pytest.raises(InputError, match=message):
        CostModel.from_settings(settings)


def test_a_cost_model_is_read_back_from_its_settings_and_takes_no_others():
    model = CostModel("line", 2, 4, "always")
    assert model.settings == {"cost_model": "line", "reference_length_m": 2, "connectivity": 4, "diagonal": "always"}
    assert CostModel.from_settings(model.settings | {"planner": "ptp"}) == model
    assert CostModel.from_settings({}) == CostModel.of("line") == CostModel.of(None) == CostModel()


@pytest.mark.parametrize(
    ("status", "cost", "lower_bound", "gap"),
    [
        (Status.FEASIBLE, 6.0, 4.0, 0.5),
        (Status.OPTIMAL, 6.0, 6.0, 0.0),
        (Status.OPTIMAL, 0.0, 0.0, 0.0),
        (Status.FEASIBLE, 6.0, 0.0, np.inf),
        (Status.FEASIBLE, 6.0, -np.inf, np.inf),
        (Status.NO_PATH, np.inf, np.inf, np.inf),
        (Status.BUDGET_EMPTY, np.inf, 3.0, np.inf),
    ],
)
def test_a_gap_is_what_the_path_may_cost_too_much(status, cost, lower_bound, gap):
    assert Path(status, np.empty((0, 2)), cost, lower_bound, 0, 0.0, "none").gap == gap
