"""Anytime A*: its certified gap against the true one by SciPy's Dijkstra, its budget, and its end."""

import itertools

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.planners.anytime import LANDMARK_INFLATION, LEAST_INFLATION, astar_anytime, first_inflation
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost_model import CostModel
from tests.planners.test_astar import exact_cost_to_go, random_problem
from tests.planners.test_landmarks import city

ROUNDING = 1e-11  # of a cost summed in another order


@pytest.mark.parametrize("heuristic", ["octile", "plus", "tiles", "landmarks", "exact", "none"])
@pytest.mark.parametrize(("cost_model", "inflation"), list(itertools.product(["cell", "line"], [None, 1.0, 5.0])))
def test_the_certified_gap_is_never_below_the_true_one_and_shrinks_to_nothing(cost_model, inflation, heuristic):
    for seed in range(4):
        problem = city(seed, cost_model=cost_model)
        optimum = exact_cost_to_go(problem)[problem.start]
        path = astar_anytime(problem, heuristic=heuristic, inflation=inflation)
        assert path.status is Status.OPTIMAL
        assert path.cost == path.lower_bound == pytest.approx(optimum, rel=1e-12)
        assert path.gap == 0
        assert problem.cost_of(path.points_m) == path.cost
        costs, bounds = np.array([cost for _, _, cost in path.history]), np.array(path.bounds)
        assert np.all(bounds <= optimum * (1 + ROUNDING))
        assert np.all(costs >= optimum * (1 - ROUNDING))
        gaps = costs / bounds - 1
        assert np.all(np.diff(gaps) <= 0)
        assert gaps[-1] == 0
        if inflation is not None:
            assert gaps[0] <= inflation - 1 + ROUNDING
        assert (path.history[-1][1], costs[-1]) == (path.num_expanded, path.cost)


def test_random_maps_of_every_kind_end_at_the_optimum_or_the_proof_that_there_is_no_path():
    ends = set()
    for seed in range(24):
        variant = (["cell", "line"][seed % 2], ["both-free", "always"][seed // 2 % 2], [8, 4][seed // 4 % 2])
        problem = random_problem(seed, *variant)
        optimum = exact_cost_to_go(problem)[problem.start]
        path = astar_anytime(problem, inflation=3.0)
        ends.add(path.status)
        assert path.status is (Status.OPTIMAL if np.isfinite(optimum) else Status.NO_PATH)
        assert path.cost == pytest.approx(optimum, rel=1e-12)
        assert path.lower_bound == path.cost
        assert len(path.history) == len(path.bounds)
    assert ends == {Status.OPTIMAL, Status.NO_PATH}


def test_a_first_path_comes_early_and_is_good():
    problem = city(shape=(200, 220), cost_model="cell")
    plain = astar(problem)
    path = astar_anytime(problem)
    _, num_expanded, cost = path.history[0]
    assert num_expanded < 0.4 * plain.num_expanded
    assert cost < 1.1 * plain.cost


def test_a_budget_that_ends_leaves_the_best_path_and_a_bound(monkeypatch):
    monkeypatch.setattr("jaxurban.planners.search.grid.CHUNK", 100)
    problem = city(shape=(90, 100))
    optimum = astar(problem).cost
    clock = iter(np.arange(0, 1e6, 0.01))
    monkeypatch.setattr("time.perf_counter", lambda: float(next(clock)))
    statuses = set()
    for budget_s in (0.001, 0.1, 0.3, 0.5, 0.7):
        path = astar_anytime(problem, budget_s=budget_s)
        statuses.add(path.status)
        assert path.lower_bound <= optimum <= path.cost * (1 + ROUNDING)
        if path.status is Status.BUDGET_FEASIBLE:
            assert problem.cost_of(path.points_m) == path.cost
            assert path.gap == pytest.approx(path.cost / path.lower_bound - 1)
            assert path.bounds[-1] == path.lower_bound
    assert statuses == {Status.BUDGET_EMPTY, Status.BUDGET_FEASIBLE}


def test_the_first_inflation_brings_the_bound_up_to_what_paths_pay():
    def problem(cost, distance_weight, **options):
        layers = np.full((1, 5, 6), float(cost))
        return Problem(
            layers, np.ones((5, 6), bool), (0, 0), (4, 5), 2.0, distance_weight, **{"cost_model": "cell"} | options
        )

    assert first_inflation("landmarks", problem(1, 1.0)) == LANDMARK_INFLATION
    assert first_inflation("octile", problem(0, 1.0)) == LEAST_INFLATION
    assert first_inflation("octile", problem(4, 1.0)) == pytest.approx(1 + 0.65 * 4 / 2)
    assert first_inflation("plus", problem(4, 1.0)) == LEAST_INFLATION  # it counts an even cost in full
    line = problem(4, 1.0, cost_model=CostModel("line", 4.0))
    assert first_inflation("octile", line) == pytest.approx(1 + 0.65 * (4 * 2 / 4) / 2)
    assert first_inflation("octile", problem(4, 0.0)) == LEAST_INFLATION


def test_no_weight_on_distance_and_free_cells_still_end():
    path = astar_anytime(Problem(np.zeros((1, 9, 9)), np.ones((9, 9), bool), (0, 0), (8, 8), 1.0, 0.0))
    assert (path.cost, path.gap, path.status) == (0, 0, Status.OPTIMAL)
    assert "costs nothing" in path.note
    path = astar_anytime(random_problem(3, "cell", "both-free", 8).between((0, 1), (0, 1)))
    assert (path.cost, len(path.points_m)) == (0, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heuristic": "plus-printed"}, "astar-anytime takes no heuristic 'plus-printed': choose one of auto, none"),
        ({"inflation": 0.5}, "inflation must be a finite number of at least 1, got 0.5"),
        ({"inflation": np.nan}, "inflation must be a finite number"),
        ({"budget_s": 0}, "budget_s must be a positive number of seconds"),
    ],
)
def test_wrong_arguments_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        astar_anytime(city(), **options)


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
