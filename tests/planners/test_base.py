"""What a problem accepts and refuses."""

import numpy as np
import pytest

from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import PLANNERS, find_planner

FREE = np.array([[True, True, True], [True, False, True]])
LAYERS = np.ones((2, 2, 3))


def make(
    costs=LAYERS, is_free=FREE, start=(0, 0), goal=(0, 2), resolution_m=1.0, weights=1.0, **options
):
    return Problem(costs, is_free, start, goal, resolution_m, weights, **options)


def test_costs_inside_obstacles_may_be_anything_and_arguments_stay_writable():
    layers, is_free = np.where(FREE, LAYERS, np.nan), FREE.copy()
    assert make(layers, is_free).cost[0, 0] == 2
    layers[0, 0, 0] = 7
    is_free[0, 0] = False


def test_a_problem_between_other_cells_or_under_other_weights_shares_what_does_not_depend_on_them():
    problem = make()
    other = problem.between((1, 0), (1, 2))
    assert (problem.start, other.start, other.goal) == ((0, 0), (1, 0), (1, 2))
    assert other.cost is problem.cost
    weighed = problem.with_weights(np.array([0.5, 2.0, 0.0]))
    assert weighed.moves is problem.moves
    np.testing.assert_array_equal(weighed.cost, 2 * LAYERS[0])
    assert (weighed.distance_weight, weighed.start, weighed.goal) == (
        0.5,
        problem.start,
        problem.goal,
    )


def test_planners_by_name_run_with_their_own_heuristic():
    ran = {name: find_planner(name)(make(), budget_s=0.2, seed=0).heuristic for name in PLANNERS}
    off_grid = {"bitstar-dist": "euclidean", "bitstar-plus": "plus", "theta-star": "plus"}
    assert ran == {
        "ptp": "none",
        "astar": "tiles",
        "astar-dist": "euclidean",
        "astar-plus": "tiles",
        **off_grid,
    }
    path = find_planner("astar-plus", "octile")(make(), budget_s=0.2, seed=3)
    assert (path.planner, path.heuristic, path.backend) == ("astar-plus", "octile", "numba")


def test_every_status_has_a_sentence_and_an_exit_code():
    without_path = {Status.NO_PATH: 3, Status.OVER_EXPOSURE: 3, Status.BLOCKED: 3}
    without_path |= {Status.BUDGET_EMPTY: 4, Status.UNDECIDED: 4}
    for status in Status:
        assert (status.exit_code, status.has_path) == (
            without_path.get(status, 0),
            status not in without_path,
        )
    assert all(status.sentence.endswith(".") for status in Status)


def test_a_cost_model_is_read_back_from_its_settings_and_takes_no_others():
    model = CostModel("line", 2, 4, "always")
    assert model.settings == {
        "cost_model": "line",
        "reference_length_m": 2,
        "connectivity": 4,
        "diagonal": "always",
    }
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
