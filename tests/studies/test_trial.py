"""One instance under its planners: rows against `plan`, and whatever may go wrong as a row."""

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.paths.rows import solve_instance
from jaxurban.planners.any_angle import ptp
from jaxurban.planners.base import Path, Status
from jaxurban.planners.registry import PLANNERS, PlannerEntry
from jaxurban.studies.montecarlo.sampling import sample_instances
from jaxurban.studies.montecarlo.trial import Benchmark, row_columns
from tests.made_maps import made_maps

WEIGHTED = [(name, "weighted") for name in ("ptp", "astar-dist", "astar-plus")]
NO_CLOCKS = {"elapsed_s": 0, "setup_s": 0}
FEW_SAMPLES = Benchmark(study=ju.studies.Study(budget_iterations=300))


@pytest.fixture(scope="module")
def maps():
    return made_maps()


@pytest.fixture(scope="module")
def instances(maps):
    table = sample_instances(maps, 12, altitudes_m=[20.0])
    return table[table.is_connected].to_dict("records")


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_rows_say_what_plan_says(maps, instances, cost_model):
    settings = Benchmark(cost_model=ju.CostModel(cost_model))
    for instance in instances[:4]:
        on = settings.cost_map(maps, 20.0, None, instance["time_of_day"])
        for (planner, _), row in zip(WEIGHTED, solve_instance(settings, on, instance, WEIGHTED), strict=True):
            query = {
                "start_xy_m": (instance["start_x_m"], instance["start_y_m"]),
                "goal_xy_m": (instance["goal_x_m"], instance["goal_y_m"]),
                "altitude_m": 20.0,
                "time_of_day": instance["time_of_day"],
                "planner": planner,
                "weights": ju.Weights(
                    **{n: instance[f"w_{n}"] for n in ("distance", "gps", "lidar", "population", "risk")}
                ),
            }
            planned = {model: ju.plan(maps, **query, cost_model=model) for model in {cost_model, "cell", "line"}}
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
            if planner == "ptp":  # the same path under either model
                assert row["cost_cell"] == pytest.approx(planned["cell"].cost, rel=1e-12)
                assert row["cost_line"] == pytest.approx(planned["line"].cost, rel=1e-12)


def test_the_shortest_path_is_no_longer_and_no_cheaper_than_the_cheapest(maps, instances):
    runs = [("astar-dist", "weighted"), ("astar-dist", "distance")]
    for instance in instances:
        cheapest, shortest = solve_instance(Benchmark(), Benchmark().cost_map(maps, 20.0, None, None), instance, runs)
        assert cheapest["cost"] <= shortest["cost"] * (1 + 1e-12)
        assert shortest["length_m"] <= cheapest["length_m"] * (1 + 1e-12)
        assert shortest["search_cost"] == pytest.approx(shortest["length_m"])


def test_an_iteration_budget_repeats_exactly_but_for_the_time(maps, instances):
    runs = [("bitstar-dist", "weighted"), ("bitstar-plus", "weighted")]
    first, again = (
        solve_instance(FEW_SAMPLES, FEW_SAMPLES.cost_map(maps, 20.0, None, None), instances[0], runs) for _ in range(2)
    )
    for one, other in zip(first, again, strict=True):
        assert one | NO_CLOCKS == other | NO_CLOCKS
        assert one["num_samples"] <= 300
    assert any(row["num_samples"] == 300 for row in first)


def test_a_row_does_not_depend_on_what_was_asked_before(maps, instances):
    runs = [
        ("astar-plus", "distance"),
        ("astar-dist", "weighted"),
        ("astar-plus", "weighted"),
    ]
    used = FEW_SAMPLES.cost_map(maps, 20.0, None, None)
    for _ in range(20):
        solve_instance(FEW_SAMPLES, used, instances[0], runs)
    for again, first in zip(
        solve_instance(FEW_SAMPLES, used, instances[0], runs),
        solve_instance(FEW_SAMPLES, FEW_SAMPLES.cost_map(maps, 20.0, None, None), instances[0], runs),
        strict=True,
    ):
        assert again | NO_CLOCKS == first | NO_CLOCKS


def crashing(problem, *, budget_s, seed):
    raise RuntimeError("out of ideas")


def cheating(problem, *, budget_s, seed):
    found = ptp(problem)
    corners = np.array([[0.0, 0.0], [problem.is_free.shape[1], problem.is_free.shape[0]]]) * problem.resolution_m
    return Path(Status.FEASIBLE, corners, 1.0, 0.0, 1, found.elapsed_s, "cheating")


def test_a_planner_that_crashes_or_cheats_is_a_row_and_the_next_one_is_asked(maps, instances, monkeypatch):
    monkeypatch.setitem(PLANNERS, "crashing", PlannerEntry(crashing, ""))
    monkeypatch.setitem(PLANNERS, "cheating", PlannerEntry(cheating, ""))
    runs = [(name, "weighted") for name in ("crashing", "cheating", "astar-dist")]
    rows = solve_instance(Benchmark(), Benchmark().cost_map(maps, 20.0, None, None), instances[0], runs)
    assert [row["status"] for row in rows] == ["crashed", "invalid", "optimal"]
    assert rows[0]["note"] == "RuntimeError: out of ideas"
    assert rows[1]["cost"] is None
    assert all(set(row) == set(row_columns()) for row in rows)


def test_a_start_in_an_obstacle_or_off_the_map_is_a_row(maps, instances):
    row, col = np.argwhere(~maps.is_free(20.0))[0]
    x_m, y_m = (float(value) for value in maps.grid.xy_of_cell(row, col))
    on = Benchmark().cost_map(maps, 20.0, None, None)
    for place, word in (((x_m, y_m), "obstacle"), ((0.0, 0.0), "outside")):
        query = instances[0] | {"start_x_m": place[0], "start_y_m": place[1]}
        (found,) = solve_instance(Benchmark(), on, query, [("ptp", "weighted")])
        assert found["status"] == "bad-input"
        assert word in found["note"]


def test_a_pair_that_no_path_joins_is_a_row_without_numbers(maps, instances):
    walled = made_maps()
    row, col = (int(v) for v in walled.grid.cell_of_xy(instances[0]["goal_x_m"], instances[0]["goal_y_m"]))
    walled.ds["obstacle"][0, max(0, row - 1) : row + 2, max(0, col - 1) : col + 2] = 1
    walled.ds["obstacle"][0, row, col] = 0
    (found,) = solve_instance(
        Benchmark(),
        Benchmark().cost_map(walled, 20.0, None, None),
        instances[0],
        [("astar-plus", "weighted")],
    )
    assert found["status"] == "no-path"
    assert found["cost"] is None
    assert found["lower_bound"] is None  # infinite: JSON has no such number
