"""A whole study: rows that are kept, killed and taken up again, alone and with helpers, and what is made of them."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import dask
import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.maps.executors import cluster_client
from jaxurban.paths.rows import InstanceRuns, MapsFolder, solve_on
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.report.benchmark import export_benchmark
from jaxurban.report.montecarlo import report_markdown, tables_of
from jaxurban.studies.montecarlo.trial import DISTANCE, Benchmark
from tests.cli_runs import assert_one_sentence, run
from tests.logs import logged
from tests.made_maps import made_maps
from tests.movingai import read_map, read_scenarios

SETTINGS = ju.studies.Study(budget_iterations=200, seed=2)
ONE = replace(SETTINGS, planners=["ptp"], distance_only=())
NUM_ROWS = 12 * 2 * 6  # instances, altitudes, five planners and one distance-only run


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    write_zarr(made_maps().ds, folder)
    return folder


@pytest.fixture(scope="module")
def result(folder, tmp_path_factory):
    return ju.studies.study(folder, tmp_path_factory.mktemp("study"), 12, settings=SETTINGS)


def same_rows(one: pd.DataFrame, other: pd.DataFrame) -> None:
    one, other = (rows.drop(columns=["elapsed_s", "setup_s"]) for rows in (one, other))
    pd.testing.assert_frame_equal(one, other)


def test_every_planner_has_a_row_for_every_instance_once(result):
    assert len(result.rows) == NUM_ROWS
    assert not result.rows.duplicated(["instance", "altitude_m", "planner", "objective"]).any()
    assert not result.rows.status.isin(["crashed", "invalid", "bad-input"]).any()
    pd.testing.assert_frame_equal(pd.read_parquet(result.folder / "rows.parquet"), result.rows)


def test_no_path_beats_the_proven_optimum_of_its_own_grid(result):
    cost = result.table.pivot(index=["instance", "altitude_m"], columns=["planner", "objective"], values="cost")
    np.testing.assert_allclose(cost["astar-dist", "weighted"], cost["astar-plus", "weighted"], rtol=1e-12)
    assert (cost["astar-dist", DISTANCE] >= cost["astar-dist", "weighted"] * (1 - 1e-12)).all()


def test_maps_in_memory_give_the_same_rows(result, tmp_path):
    found = ju.studies.study(made_maps(), tmp_path, 3, settings=replace(SETTINGS, planners=["ptp", "bitstar-plus"]))
    kept = result.rows[(result.rows.instance < 3) & result.rows.planner.isin(["ptp", "bitstar-plus", "astar-dist"])]
    kept = kept[(kept.planner != "astar-dist") | (kept.objective == DISTANCE)]
    same_rows(found.rows, kept.reset_index(drop=True))
    with pytest.raises(InputError, match="save them"):
        ju.studies.study(made_maps(), tmp_path / "b", 1, workers=2)


def test_planners_may_be_added_and_nothing_is_run_twice(folder, tmp_path):
    first = ju.studies.study(folder, tmp_path, 2, settings=ONE).rows
    both = ju.studies.study(folder, tmp_path, 2, settings=replace(ONE, planners=["ptp", "astar-dist"])).rows
    pd.testing.assert_frame_equal(both[both.planner == "ptp"].reset_index(drop=True), first)
    assert len(both) == 2 * len(first)


def test_a_folder_keeps_one_study(folder, tmp_path):
    ju.studies.study(folder, tmp_path, 1, settings=ONE)
    cell = replace(ONE, cost_model="cell")
    with pytest.raises(InputError, match=r"its cost_model is line, now cell.*--overwrite"):
        ju.studies.study(folder, tmp_path, 1, settings=cell)
    with pytest.raises(InputError, match=r"its budget is 200 samples, now 2.0 s"):
        ju.studies.study(folder, tmp_path, 1, settings=replace(ONE, budget_iterations=None))
    with pytest.raises(InputError, match=r"instance 0 at 20 m has the w_distance .*, now 0.1"):
        ju.studies.study(
            folder, tmp_path, ju.studies.sample_instances(made_maps(), 1, weights=[ju.Weights()], seed=2), settings=ONE
        )
    ju.studies.study(folder, tmp_path, 1, settings=replace(ONE, budget_s=9.0))  # says nothing where samples are counted
    found = ju.studies.study(folder, tmp_path, 1, settings=cell, overwrite=True)
    assert (found.rows.cost.dropna() == found.rows.cost_cell.dropna()).all()


def test_a_longer_study_keeps_the_rows_of_the_shorter_one(folder, tmp_path):
    first = ju.studies.study(folder, tmp_path, 2, settings=ONE).rows
    longer = ju.studies.study(folder, tmp_path, 3, settings=ONE).rows
    assert longer.groupby("altitude_m").instance.apply(list).tolist() == [[0, 1, 2]] * 2
    pd.testing.assert_frame_equal(longer[longer.instance < 2].reset_index(drop=True), first)  # times and all
    with pytest.raises(InputError, match=r"of 6 instances.* 2 are left out now .*longer but not shorter"):
        ju.studies.study(folder, tmp_path, 2, settings=ONE)


def test_instances_of_a_file_are_joined_as_these_maps_have_it(folder, result, tmp_path):
    instances = result.instances.assign(is_connected=~result.instances.is_connected)
    wall = np.argwhere(~made_maps().is_free(20.0))[0]
    instances.loc[0, ["start_x_m", "start_y_m"]] = made_maps().grid.xy_of_cell(*wall)
    instances.loc[1, "goal_x_m"] = 1e12
    found = ju.studies.study(folder, tmp_path, instances, settings=ONE)
    assert found.instances.is_connected.tolist() == [None, None, *result.instances.is_connected[2:]]
    bad = found.rows.set_index(["instance", "altitude_m"]).status == "bad-input"
    assert bad[bad].index.tolist() == [(0, 20.0), (1, 20.0)]


def test_a_study_that_cannot_be_run_is_refused_before_it_runs(folder, result, tmp_path):
    for instances, words in (
        (lambda: result.instances.assign(start_x_m=0.0), "instance 0 at 20 m, whose start .* outside"),
        (lambda: result.instances.assign(instance=-3), "row 1: instance must be a whole number >= 0, got -3"),
        (lambda: replace(SETTINGS, planners=[]), "name at least one planner"),
        (lambda: ju.studies.sample_instances(made_maps(), 1, altitudes_m=[60, 60]), "none twice, got 60, 60"),
    ):
        with pytest.raises(InputError, match=words):
            ju.studies.study(folder, tmp_path / "out", instances(), settings=SETTINGS)
    assert not (tmp_path / "out").exists()


def test_instances_for_other_maps_are_refused(folder, result, tmp_path):
    for change, word in (
        ({"crs": "EPSG:25830"}, "EPSG:25830"),
        ({"altitude_m": result.instances.altitude_m + 13.0}, "altitude_m 33"),
        ({"time_of_day": "dusk"}, "dusk"),
    ):
        with pytest.raises(InputError, match=word):
            ju.studies.study(folder, tmp_path, result.instances.assign(**change))


KILLED = """
import sys, jaxurban as ju
from pathlib import Path
if __name__ == "__main__":
    settings = ju.studies.Study(budget_iterations=200, seed=2)
    ju.studies.study(sys.argv[1], sys.argv[2], 12, settings=settings, workers=int(sys.argv[3]))
"""


def study_elsewhere(folder: Path, out: Path, script: Path, workers: int) -> subprocess.Popen:
    script.write_text(KILLED)
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(root)}
    return subprocess.Popen([sys.executable, script, folder, out, str(workers)], env=environment, cwd=script.parent)


@pytest.mark.slow
def test_a_killed_study_goes_on_with_no_row_lost_or_doubled(folder, result, tmp_path):
    out = tmp_path / "out"
    job = study_elsewhere(folder, out, tmp_path / "job.py", workers=1)
    while len(list((out / "parts").glob("*.json"))) < 3:
        assert job.poll() is None
        time.sleep(0.005)
    job.send_signal(signal.SIGKILL)
    job.wait()
    kept = [row for part in (out / "parts").glob("*.json") for row in json.loads(part.read_text())["rows"]]
    assert 0 < len(kept) < NUM_ROWS
    found = ju.studies.study(folder, out, 12, settings=SETTINGS).rows
    same_rows(found, result.rows)
    times = found.set_index(["instance", "altitude_m", "planner", "objective"]).elapsed_s
    for row in kept:  # what was done before is not done again
        assert times[row["instance"], row["altitude_m"], row["planner"], row["objective"]] == row["elapsed_s"]


@pytest.mark.slow
def test_damaged_rows_are_set_aside_and_made_again(folder, result, tmp_path):
    out = shutil.copytree(result.folder, tmp_path / "out")
    data = (out / "rows.parquet").read_bytes()
    (out / "rows.parquet").write_bytes(data[:100] + bytes([data[100] ^ 1]) + data[101:])
    with logged() as warned:
        found = ju.studies.study(folder, out, 12, settings=SETTINGS).rows
    assert any("rows.parquet' was changed since `jaxurban study` wrote it: it is" in each for each in warned)
    same_rows(found, result.rows)


def test_a_study_whose_instances_were_changed_is_refused(folder, tmp_path):
    """Nobody knows then what its rows are of; one that lacks an instance may even look like a shorter study."""
    rows = ju.studies.study(folder, tmp_path, 2, settings=ONE).rows
    file = tmp_path / "instances.parquet"
    pd.read_parquet(file)[1:].to_parquet(file)
    for number in (2, 3):
        with pytest.raises(InputError, match=r"instances are lost \(.*instances.parquet' is not as it was written\)"):
            ju.studies.study(folder, tmp_path, number, settings=ONE)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "rows.parquet"), rows)
    assert len(pd.read_parquet(file)) == 3


@pytest.mark.slow
def test_two_workers_give_the_rows_of_one(folder, result, tmp_path):
    job = study_elsewhere(folder, tmp_path / "out", tmp_path / "job.py", workers=2)
    assert job.wait(timeout=300) == 0
    same_rows(pd.read_parquet(tmp_path / "out" / "rows.parquet"), result.rows)


@pytest.mark.slow
def test_a_planner_that_kills_its_worker_costs_its_own_rows_alone(folder, result):
    from distributed import WorkerPlugin

    class Killer(WorkerPlugin):
        def setup(self, worker):
            from jaxurban.planners.registry import PLANNERS, PlannerEntry

            PLANNERS["killer"] = PlannerEntry(lambda problem, **limits: os._exit(1), "")

    runs = (("ptp", "weighted"), ("killer", "weighted"), ("astar-dist", "weighted"))
    tasks = [InstanceRuns(instance, runs) for instance in result.instances[:2].to_dict("records")]
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), cluster_client(2) as client:
        client.register_plugin(Killer())
        found = list(
            solve_on(
                client, tasks, {None: MapsFolder(folder)}, Benchmark(study=replace(SETTINGS, budget_iterations=100))
            )
        )
    rows = {(row["instance"], row["planner"]): row for rows in found for row in rows}
    assert len(rows) == sum(map(len, found)) == 6
    for (_, planner), row in rows.items():
        assert (row["status"] == "crashed") == (planner == "killer")
    # A restarted worker may get a task before it has got the plugin, and then knows no such planner.
    assert any("killed again and again" in row["note"] for row in rows.values())


def test_the_report_holds_every_table_figure_and_sentence(result, tmp_path):
    report = result.save(tmp_path)[-1].read_text()
    assert "Weights: those of each route (`instances.parquet`). Obstacles: touched." in report
    same = result.instances.assign(w_distance=0.25)
    same.loc[:, same.columns.str.startswith("w_")] = same.filter(like="w_").iloc[0].to_numpy()
    told = report_markdown(replace(result, instances=same), tables_of(result))
    assert f" Weights: distance 0.25, gps {same.w_gps.iloc[0]:g}, " in told
    for name in ("choices", "success", "costs", "paired", "times", "usage", "objectives", "complementarity"):
        assert (tmp_path / "tables" / f"{name}.csv").is_file()
    for title in ("Which planner, when", "Cost", "Planners two by two", "GPS and lidar"):
        assert f"## {title}" in report
    for picture in (tmp_path / "figures").glob("*.png"):
        assert f"figures/{picture.name}" in report
    assert len(list((tmp_path / "figures").glob("*.png"))) == 3
    assert "nan" not in report
    assert report.count("© a made city") == 1


def test_a_study_without_a_path_has_its_report(result, tmp_path):
    of_paths = result.rows.columns[result.rows.columns.str.match("cost|gap|length|detour|m_|search_cost")]
    nothing = dict.fromkeys(of_paths, np.nan) | {"status": "no-path"}
    without = replace(result, rows=result.rows[result.rows.planner == "ptp"].assign(**nothing))
    report = without.save(tmp_path)[-1].read_text()
    assert "## GPS and lidar" in report
    assert not (tmp_path / "figures" / "costs.png").exists()


def test_the_benchmark_can_be_solved_by_its_page_alone(result, tmp_path):
    counts = export_benchmark(result.maps, result.instances, result.rows, tmp_path, result.settings, "made-city")
    assert counts["weighted"] == 24
    solved = 0
    for file in (tmp_path / "movingai").glob("*.map"):
        is_free = read_map(file)
        for start, goal, length in read_scenarios(file.with_suffix(".map.scen")):
            found = astar(Problem(np.zeros((1, *is_free.shape)), is_free, start, goal, 1.0, 1.0))
            assert found.cost == pytest.approx(length, abs=1e-6)
            solved += 1
    assert solved == counts["shortest"] > 0
    instances = pd.read_parquet(tmp_path / "instances.parquet")
    proven = instances[instances.grid_optimum.notna()]
    assert len(proven) == counts["proven"] > 0
    for row in proven.iloc[::5].itertuples():
        with np.load(tmp_path / "costs" / f"made-city_{row.altitude_m:g}m_{row.time_of_day}.npz") as kept:
            weights = np.array([getattr(row, f"w_{name}") for name in kept["names"]])
            ends = [
                (int((y - kept["y_min_m"]) // kept["resolution_m"]), int((x - kept["x_min_m"]) // kept["resolution_m"]))
                for x, y in ((row.start_x_m, row.start_y_m), (row.goal_x_m, row.goal_y_m))
            ]
            layers = weights[:, None, None] * kept["costs"].astype(np.float64)
            problem = Problem(
                layers, kept["is_free"], ends[0], ends[1], float(kept["resolution_m"]), row.w_distance, "line"
            )
        assert astar(problem).cost == pytest.approx(row.grid_optimum, rel=1e-9)
        assert row.best_known <= row.grid_optimum * (1 + 1e-12)


@pytest.mark.slow
def test_the_command_makes_maps_study_and_report_and_reruns_a_file(tmp_path, capsys):
    scenario = tmp_path / "small-city.toml"
    scenario.write_text(
        """
        [region]
        bounds = [-74.0, 40.755, -73.99, 40.762]
        resolution_m = 20.0
        altitudes_m = [20, 60]
        [buildings]
        source = "synthetic"
        [study]
        instances = 4
        planners = ["ptp", "astar-plus"]
        """
    )
    out = tmp_path / "out"
    code, text, err = run(capsys, "study", scenario, "-o", out, "--workers", 1, "--json", "--benchmark", tmp_path / "b")
    assert code == 0, err
    told = json.loads(text)
    assert told["num_rows"] == 4 * 2 * 3
    assert Path(told["report"]).is_file()
    assert told["benchmark"]["weighted"] == 8
    instances = tmp_path / "b" / "instances.csv"
    other = tmp_path / "other"
    code, _, err = run(capsys, "study", scenario, "-o", other, "--workers", 1, "--instances", instances)
    assert code == 0, err
    first, again = (pd.read_parquet(folder / "study" / "rows.parquet") for folder in (out, other))
    same_rows(first, again)
    code, _, err = run(capsys, "study", scenario, "-o", out, "--workers", 2, "--cluster", "tcp://nowhere:1")
    assert code == 2
    assert_one_sentence(err, "--workers", "--cluster")
