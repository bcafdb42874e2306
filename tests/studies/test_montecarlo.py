"""The study of planners: rows against `plan`, what is kept and taken up again, its report, export and command."""

import json
import os
from dataclasses import replace
from pathlib import Path

import dask
import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.maps.executors import cluster_client
from jaxurban.paths.rows import InstanceRuns, MapsFolder, solve_instance, solve_on
from jaxurban.planners import base
from jaxurban.planners.registry import PLANNERS, PlannerEntry
from jaxurban.studies.montecarlo.sampling import weight_columns
from jaxurban.studies.montecarlo.trial import DISTANCE, Benchmark, row_columns
from jaxurban.studies.reports.montecarlo import benchmark_report
from tests.cli_runs import TOWN, run
from tests.studies.routes_made import STUDY, same_rows, walled

WEIGHTED = [(name, "weighted") for name in ("ptp", "astar-dist", "astar-plus")]
AS_USUAL = Benchmark()
FEW_SAMPLES = Benchmark(study=ju.studies.Study(budget_iterations=300))
ONE = replace(STUDY, planners=["ptp"], distance_only=())


@pytest.fixture(scope="module")
def one(folders):
    """Return how a study of one planner is run."""
    return lambda out, num, **change: ju.studies.study(
        folders[0], out, num, settings=replace(ONE, **change)
    )


def test_no_path_beats_the_proven_optimum_of_its_own_grid(study):
    cost = study.table.pivot(
        index=["instance", "altitude_m"], columns=["planner", "objective"], values="cost"
    )
    np.testing.assert_allclose(
        cost["astar-dist", "weighted"], cost["astar-plus", "weighted"], rtol=1e-12
    )
    assert (cost["astar-dist", DISTANCE] >= cost["astar-dist", "weighted"] * (1 - 1e-12)).all()
    both = study.table[study.table.planner == "astar-dist"].set_index(["instance", "altitude_m"])
    shortest, cheapest = (both[both.objective == objective] for objective in (DISTANCE, "weighted"))
    assert (shortest.length_m <= cheapest.length_m.reindex(shortest.index) * (1 + 1e-12)).all()
    np.testing.assert_allclose(shortest.search_cost, shortest.length_m)


def test_maps_in_memory_give_the_same_rows_of_as_many_samples_as_the_budget(alpha, study, tmp_path):
    found = ju.studies.study(
        alpha, tmp_path, 3, settings=replace(STUDY, planners=["ptp", "bitstar-plus"])
    )
    kept = study.rows[
        (study.rows.instance < 3) & study.rows.planner.isin(["ptp", "bitstar-plus", "astar-dist"])
    ]
    kept = kept[(kept.planner != "astar-dist") | (kept.objective == DISTANCE)]
    same_rows(found.rows, kept.reset_index(drop=True))
    assert found.rows.num_samples.max() == STUDY.budget_iterations


def test_planners_and_instances_may_be_added_and_nothing_is_run_twice(one, tmp_path):
    first = one(tmp_path, 2).rows
    both = one(tmp_path, 2, planners=["ptp", "astar-dist"]).rows
    pd.testing.assert_frame_equal(
        both[both.planner == "ptp"].reset_index(drop=True), first
    )  # times and all
    assert len(both) == 2 * len(first)
    longer = one(tmp_path, 3, budget_s=9.0).rows.query(
        "planner == 'ptp'"
    )  # samples are counted, not seconds
    assert longer.groupby("altitude_m").instance.apply(list).tolist() == [[0, 1, 2]] * 2
    pd.testing.assert_frame_equal(longer[longer.instance < 2].reset_index(drop=True), first)


def test_another_study_takes_the_folder_where_it_is_asked_to(folders, one, tmp_path):
    one(tmp_path, 1)
    found = ju.studies.study(
        folders[0], tmp_path, 1, settings=ONE, cost_model="cell", overwrite=True
    )
    assert ju.CostModel.of(found.settings.cost_model).kind == "cell"


def test_instances_of_a_file_are_joined_as_these_maps_have_it(alpha, one, study, tmp_path):
    instances = study.instances.assign(is_connected=~study.instances.is_connected).drop(
        columns="distance_m"
    )
    instances.loc[0, ["start_x_m", "start_y_m"]] = alpha.grid.xy_of_cell(
        *np.argwhere(~alpha.is_free(20.0))[0]
    )
    instances.loc[1, "goal_x_m"] = 1e12
    found = one(tmp_path, instances)
    assert found.instances.is_connected.tolist() == [None, None, *study.instances.is_connected[2:]]
    ends_m = (study.instances[[f"{end}_x_m", f"{end}_y_m"]].to_numpy() for end in ("start", "goal"))
    np.testing.assert_allclose(
        found.instances.distance_m[2:], np.hypot(*np.subtract(*ends_m).T)[2:]
    )
    bad = found.rows.set_index(["instance", "altitude_m"]).status == "bad-input"
    assert bad[bad].index.tolist() == [(0, 20.0), (1, 20.0)]


def test_a_study_whose_instances_were_changed_is_refused(one, tmp_path):
    """Nobody knows then what its rows are of; one that lacks an instance may even look like a shorter study."""
    rows = one(tmp_path, 2).rows
    file = tmp_path / "instances.parquet"
    pd.read_parquet(file)[1:].to_parquet(file)
    for number in (2, 3):
        with pytest.raises(
            ju.InputError,
            match=r"instances.parquet' is not as the study wrote it: choose another folder",
        ):
            one(tmp_path, number)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "rows.parquet"), rows)
    assert len(pd.read_parquet(file)) == 3


@pytest.mark.slow
def test_a_planner_that_kills_its_worker_costs_its_own_rows_alone(folders, study):
    from distributed import WorkerPlugin

    class Killer(WorkerPlugin):
        def setup(self, worker):
            from jaxurban.planners.registry import PLANNERS, PlannerEntry

            PLANNERS["killer"] = PlannerEntry(lambda problem, **limits: os._exit(1), "")

    runs = (("ptp", "weighted"), ("killer", "weighted"), ("astar-dist", "weighted"))
    tasks = [InstanceRuns(instance, runs) for instance in study.instances[:2].to_dict("records")]
    impatient = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.deploy.lost-worker-timeout": "1s",
    }
    with (
        dask.config.set(impatient),
        cluster_client(2) as client,
    ):
        client.register_plugin(Killer())
        job = Benchmark(study=replace(STUDY, budget_iterations=100))
        found = list(solve_on(client, tasks, {None: MapsFolder(folders[0])}, job))
    rows = {(row["instance"], row["planner"]): row for rows in found for row in rows}
    assert len(rows) == sum(map(len, found)) == 6
    for (_, planner), row in rows.items():
        assert (row["status"] == "crashed") == (planner == "killer")
    # A restarted worker may get a task before it has got the plugin, and then knows no such planner.
    assert any("killed again and again" in row["note"] for row in rows.values())


@pytest.mark.slow
def test_the_report_holds_every_table_figure_and_sentence(study, tmp_path):
    report = study.save(tmp_path)[-1].read_text()
    assert "Weights: those of each route (`instances.parquet`). Obstacles: touched." in report
    same = study.instances.assign(w_distance=0.25)
    same.loc[:, same.columns.str.startswith("w_")] = same.filter(like="w_").iloc[0].to_numpy()
    told = benchmark_report(replace(study, instances=same)).text
    assert f" Weights: distance 0.25, gps {same.w_gps.iloc[0]:g}, " in told
    for name in ("ranks", "pairs", "success", "times", "objectives"):
        assert (tmp_path / "tables" / f"{name}.csv").is_file()
    for title in ("Ranks", "Cost"):
        assert f"## {title}" in report
    for picture in (tmp_path / "figures").glob("*.png"):
        assert f"figures/{picture.name}" in report
    assert len(list((tmp_path / "figures").glob("*.png"))) == 1
    assert "nan" not in report
    assert report.count("© a made city") == 1
    rows = study.rows[study.rows.objective == "weighted"]
    solvers = rows[rows.status.isin([each.value for each in base.Status if each.has_path])]
    by_pair = solvers.groupby(["instance", "altitude_m"]).planner.nunique()
    all_solve = by_pair[by_pair == rows.planner.nunique()].index.get_level_values("instance")
    assert f"All planners solve {all_solve.nunique()} of the instances" in report
    assert all_solve.nunique() > 0
    verdicts = pd.read_csv(tmp_path / "tables" / "verdicts.csv").sentence.tolist()
    assert verdicts == [each.sentence for each in study.decided.verdicts]


def unsolved(study, where, status):
    """Return a study whose rows at these places hold no path."""
    rows = study.rows.copy()
    rows.loc[where, rows.columns.str.match("cost|gap|length|detour|m_|search_cost")] = np.nan
    rows.loc[where, "status"] = status
    return replace(study, rows=rows)


def test_a_study_without_a_path_has_its_report(study, tmp_path):
    report = unsolved(study, study.rows.planner.notna(), "no-path").save(tmp_path)[-1].read_text()
    assert "## Ranks" not in report
    assert not (tmp_path / "figures" / "costs.png").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planners", "altitudes_m"), [(["ptp"], [20.0]), (STUDY.planners, [20.0, 60.0])]
)
def test_planners_that_solve_no_joined_pair_at_an_altitude_are_drawn(
    study, tmp_path, planners, altitudes_m
):
    where = study.rows.planner.isin(planners) & study.rows.altitude_m.isin(altitudes_m)
    report = unsolved(study, where, "failed").save(tmp_path)[-1].read_text()
    drawn = {f"figures/{picture.name}" for picture in (tmp_path / "figures").glob("*.png")}
    assert drawn == {f"figures/{name}.png" for name in ("border", "costs") if f"/{name}." in report}
    assert ("figures/costs.png" in drawn) == (planners == ["ptp"])


@pytest.mark.slow
def test_the_command_makes_maps_study_and_report_and_reruns_a_file(tmp_path, capsys):
    scenario = tmp_path / "town.toml"
    scenario.write_text(TOWN + '[study]\ninstances = 4\nplanners = ["ptp", "astar-plus"]\n')
    out = tmp_path / "out"
    code, text, err = run(
        capsys,
        "study",
        scenario,
        "-o",
        out,
        "--workers",
        1,
        "--json",
    )
    assert code == 0, err
    told = json.loads(text)
    assert told["num_rows"] == 4 * 2 * 3
    assert Path(told["report"]).is_file()
    instances = out / "study" / "instances.parquet"
    other = tmp_path / "other"
    code, _, err = run(
        capsys, "study", scenario, "-o", other, "--workers", 1, "--instances", instances
    )
    assert code == 0, err
    same_rows(*(pd.read_parquet(folder / "study" / "rows.parquet") for folder in (out, other)))


@pytest.fixture(scope="module")
def instances(alpha):
    table = ju.studies.sample_instances(alpha, 12, altitudes_m=[20.0])
    return table[table.is_connected].to_dict("records")


def rows_of(maps, instance, runs, settings=AS_USUAL, time_of_day=None):
    return solve_instance(
        settings, settings.cost_map(maps, 20.0, None, time_of_day), instance, runs
    )


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_rows_say_what_plan_says(alpha, instances, cost_model):
    settings = Benchmark(cost_model=ju.CostModel(cost_model))
    for instance in instances[:4]:
        rows = rows_of(alpha, instance, WEIGHTED, settings, instance["time_of_day"])
        ends = {
            end: ju.XY(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")
        }
        weights = ju.Weights(
            **{name.removeprefix("w_"): instance[name] for name in weight_columns(())}
        )
        how = ends | {
            "altitude_m": 20.0,
            "time_of_day": instance["time_of_day"],
            "weights": weights,
        }
        for (planner, _), row in zip(WEIGHTED, rows, strict=True):
            told = ju.plan(alpha, **how, planner=planner, cost_model=cost_model)
            assert row["status"] == told.status.value
            assert row["num_expanded"] == told.search.num_expanded
            if not told.status.has_path:
                assert row["cost"] is None
                continue
            assert row["cost"] == pytest.approx(told.cost, rel=1e-12)
            assert row["length_m"] == pytest.approx(told.length_m)
            assert row["detour"] == pytest.approx(told.length_m / instance["distance_m"])
            assert {name: row[f"m_{name}"] for name in told.metrics} == pytest.approx(
                dict(told.metrics), abs=1e-6
            )


def test_a_row_does_not_depend_on_what_was_asked_before(alpha, instances):
    runs = [("astar-plus", "distance"), ("astar-dist", "weighted"), ("astar-plus", "weighted")]
    used = FEW_SAMPLES.cost_map(alpha, 20.0, None, None)
    for _ in range(21):
        rows = solve_instance(FEW_SAMPLES, used, instances[0], runs)
    same_rows(*map(pd.DataFrame, (rows, rows_of(alpha, instances[0], runs, FEW_SAMPLES))))


def crashing(problem, *, budget_s, seed):
    raise RuntimeError("out of ideas")


def cheating(problem, *, budget_s, seed):
    corners = (
        np.array([[0.0, 0.0], [problem.is_free.shape[1], problem.is_free.shape[0]]])
        * problem.resolution_m
    )
    return base.Path(base.Status.FEASIBLE, corners, 1.0, 0.0, 1, 0.0, "cheating")


def test_a_planner_that_crashes_or_cheats_is_a_row_and_the_next_one_is_asked(
    alpha, instances, monkeypatch
):
    monkeypatch.setitem(PLANNERS, "crashing", PlannerEntry(crashing, ""))
    monkeypatch.setitem(PLANNERS, "cheating", PlannerEntry(cheating, ""))
    runs = [(name, "weighted") for name in ("crashing", "cheating", "astar-dist")]
    rows = rows_of(alpha, instances[0], runs)
    assert [row["status"] for row in rows] == ["crashed", "invalid", "optimal"]
    assert rows[0]["note"] == "RuntimeError: out of ideas"
    assert rows[1]["cost"] is None
    assert all(set(row) == set(row_columns()) for row in rows)


def test_a_pair_that_no_path_joins_is_a_row_without_numbers(alpha, instances):
    row, col = map(int, alpha.grid.cell_of_xy(instances[0]["goal_x_m"], instances[0]["goal_y_m"]))
    around = walled(alpha, slice(max(0, row - 1), row + 2), slice(max(0, col - 1), col + 2))
    around.ds["obstacle"][:, row, col] = 0
    (found,) = rows_of(around, instances[0], [("astar-plus", "weighted")])
    assert found["status"] == "no-path"
    assert found["cost"] is None
    assert found["lower_bound"] is None  # infinite: JSON has no such number
