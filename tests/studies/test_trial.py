"""One instance under its planners: rows against `plan`, and whatever may go wrong as a row."""

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.metrics.weights import Weights
from jaxurban.paths.rows import solve_instance
from jaxurban.planners.any_angle import ptp
from jaxurban.planners.base import Path, Status
from jaxurban.planners.registry import PLANNERS, PlannerEntry
from jaxurban.studies.montecarlo.sampling import sample_instances, weight_columns
from jaxurban.studies.montecarlo.trial import Benchmark, row_columns

WEIGHTED = [(name, "weighted") for name in ("ptp", "astar-dist", "astar-plus")]
NO_CLOCKS = {"elapsed_s": 0, "setup_s": 0}
FEW_SAMPLES = Benchmark(study=ju.studies.Study(budget_iterations=300))


@pytest.fixture(scope="module")
def instances(alpha):
    table = sample_instances(alpha, 12, altitudes_m=[20.0])
    return table[table.is_connected].to_dict("records")


def rows_of(maps, instance, runs, settings=None, time_of_day=None):
    settings = settings or Benchmark()
    on = settings.cost_map(maps, 20.0, None, time_of_day)
    return solve_instance(settings, on, instance, runs)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_rows_say_what_plan_says(alpha, instances, cost_model):
    settings = Benchmark(cost_model=ju.CostModel(cost_model))
    for instance in instances[:4]:
        rows = rows_of(alpha, instance, WEIGHTED, settings, instance["time_of_day"])
        ends = {f"{end}_xy_m": (instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")}
        weights = Weights(**{name.removeprefix("w_"): instance[name] for name in weight_columns(())})
        how = ends | {"altitude_m": 20.0, "time_of_day": instance["time_of_day"], "weights": weights}
        for (planner, _), row in zip(WEIGHTED, rows, strict=True):
            models = {cost_model, "cell", "line"} if planner == "ptp" else {cost_model}
            planned = {model: ju.plan(alpha, **how, planner=planner, cost_model=model) for model in models}
            told = planned[cost_model]
            assert row["status"] == told.status.value
            assert row["num_expanded"] == told.search.num_expanded
            if not told.status.has_path:
                assert row["cost"] is None
                continue
            assert row["cost"] == row[f"cost_{cost_model}"] == pytest.approx(told.cost, rel=1e-12)
            assert row["length_m"] == pytest.approx(told.length_m)
            assert row["detour"] == pytest.approx(told.length_m / instance["distance_m"])
            assert {name: row[f"m_{name}"] for name in told.metrics} == pytest.approx(dict(told.metrics), abs=1e-6)
            for model, path in planned.items():  # that of ptp is the same path under either
                assert row[f"cost_{model}"] == pytest.approx(path.cost, rel=1e-12)


def test_the_shortest_path_is_no_longer_and_no_cheaper_than_the_cheapest(alpha, instances):
    for instance in instances:
        cheapest, shortest = rows_of(alpha, instance, [("astar-dist", "weighted"), ("astar-dist", "distance")])
        assert cheapest["cost"] <= shortest["cost"] * (1 + 1e-12)
        assert shortest["length_m"] <= cheapest["length_m"] * (1 + 1e-12)
        assert shortest["search_cost"] == pytest.approx(shortest["length_m"])


def test_an_iteration_budget_repeats_exactly_but_for_the_time(alpha, instances):
    runs = [("bitstar-dist", "weighted"), ("bitstar-plus", "weighted")]
    first, again = (rows_of(alpha, instances[0], runs, FEW_SAMPLES) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one | NO_CLOCKS == other | NO_CLOCKS
        assert one["num_samples"] <= 300
    assert any(row["num_samples"] == 300 for row in first)


def test_a_row_does_not_depend_on_what_was_asked_before(alpha, instances):
    runs = [("astar-plus", "distance"), ("astar-dist", "weighted"), ("astar-plus", "weighted")]
    used = FEW_SAMPLES.cost_map(alpha, 20.0, None, None)
    for _ in range(21):
        rows = solve_instance(FEW_SAMPLES, used, instances[0], runs)
    for again, first in zip(rows, rows_of(alpha, instances[0], runs, FEW_SAMPLES), strict=True):
        assert again | NO_CLOCKS == first | NO_CLOCKS


def crashing(problem, *, budget_s, seed):
    raise RuntimeError("out of ideas")


def cheating(problem, *, budget_s, seed):
    found = ptp(problem)
    corners = np.array([[0.0, 0.0], [problem.is_free.shape[1], problem.is_free.shape[0]]]) * problem.resolution_m
    return Path(Status.FEASIBLE, corners, 1.0, 0.0, 1, found.elapsed_s, "cheating")


def test_a_planner_that_crashes_or_cheats_is_a_row_and_the_next_one_is_asked(alpha, instances, monkeypatch):
    monkeypatch.setitem(PLANNERS, "crashing", PlannerEntry(crashing, ""))
    monkeypatch.setitem(PLANNERS, "cheating", PlannerEntry(cheating, ""))
    runs = [(name, "weighted") for name in ("crashing", "cheating", "astar-dist")]
    rows = rows_of(alpha, instances[0], runs)
    assert [row["status"] for row in rows] == ["crashed", "invalid", "optimal"]
    assert rows[0]["note"] == "RuntimeError: out of ideas"
    assert rows[1]["cost"] is None
    assert all(set(row) == set(row_columns()) for row in rows)


def test_a_start_in_an_obstacle_or_off_the_map_is_a_row(alpha, instances):
    wall = tuple(map(float, alpha.grid.xy_of_cell(*np.argwhere(~alpha.is_free(20.0))[0])))
    for (x_m, y_m), word in ((wall, "obstacle"), ((0.0, 0.0), "outside")):
        (found,) = rows_of(alpha, instances[0] | {"start_x_m": x_m, "start_y_m": y_m}, [("ptp", "weighted")])
        assert found["status"] == "bad-input"
        assert word in found["note"]


def test_a_pair_that_no_path_joins_is_a_row_without_numbers(alpha, instances):
    obstacle = alpha.ds["obstacle"].copy(deep=True)
    row, col = (int(v) for v in alpha.grid.cell_of_xy(instances[0]["goal_x_m"], instances[0]["goal_y_m"]))
    obstacle[0, max(0, row - 1) : row + 2, max(0, col - 1) : col + 2] = 1
    obstacle[0, row, col] = 0
    walled = ju.MetricMaps(alpha.ds.assign(obstacle=obstacle))
    (found,) = rows_of(walled, instances[0], [("astar-plus", "weighted")])
    assert found["status"] == "no-path"
    assert found["cost"] is None
    assert found["lower_bound"] is None  # infinite: JSON has no such number
