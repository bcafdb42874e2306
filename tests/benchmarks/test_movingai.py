"""A study as a public benchmark: its files are read back, its page is enough to solve it, and its command makes it."""

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from benchmarks import movingai
from benchmarks.movingai import check_exportable, export_benchmark, write_map, write_scenarios
from jaxurban.planners import base
from jaxurban.planners.astar import astar
from tests.cli_runs import TOWN, run
from tests.made_maps import made_maps
from tests.movingai import GridProblem, read_map, read_scenarios
from tests.studies.routes_made import run_study


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("public")
    made_maps(60, 70).save(folder / "alpha")
    return run_study("study", [folder / "alpha"], folder)


def test_a_map_is_written_north_first_and_read_back(tmp_path):
    is_free = np.array([[True, True, False], [True, False, False]])
    write_map(is_free, tmp_path / "a.map")
    assert (tmp_path / "a.map").read_text() == "type octile\nheight 2\nwidth 3\nmap\n.@@\n..@\n"
    np.testing.assert_array_equal(read_map(tmp_path / "a.map"), is_free)


def test_problems_are_sorted_by_length_and_read_back(tmp_path):
    problems = [GridProblem((0, 0), (1, 2), 9.5), GridProblem((1, 1), (0, 1), 1.0)]
    cells = [(*start, *goal, length) for start, goal, length in problems]
    table = pd.DataFrame(
        cells, columns=["start_row", "start_col", "goal_row", "goal_col", "length"]
    )
    write_scenarios(table, (2, 3), "a.map", tmp_path / "a.map.scen")
    lines = (tmp_path / "a.map.scen").read_text().splitlines()
    assert lines[0] == "version 1"
    assert lines[1].split("\t") == ["0", "a.map", "3", "2", "1", "0", "1", "1", "1.00000000"]
    assert lines[2].startswith("2\t")
    assert read_scenarios(tmp_path / "a.map.scen") == problems[::-1]


@pytest.mark.slow
def test_the_benchmark_can_be_solved_by_its_page_alone(study, tmp_path):
    counts = export_benchmark(
        study.maps, study.instances, study.rows, tmp_path, study.settings, "made-city"
    )
    assert counts["weighted"] == 24
    solved = 0
    for file in (tmp_path / "movingai").glob("*.map"):
        is_free = read_map(file)
        for start, goal, length in read_scenarios(file.with_suffix(".map.scen")):
            found = astar(
                base.Problem(np.zeros((1, *is_free.shape)), is_free, start, goal, 1.0, 1.0)
            )
            assert found.cost == pytest.approx(length, abs=1e-6)
            solved += 1
    assert solved == counts["shortest"] > 0
    instances = pd.read_parquet(tmp_path / "instances.parquet")
    proven = instances[instances.grid_optimum.notna()]
    assert len(proven) == counts["proven"] > 0
    for row in proven.iloc[::5].itertuples():
        with np.load(
            tmp_path / "costs" / f"made-city_{row.altitude_m:g}m_{row.time_of_day}.npz"
        ) as kept:
            weights = np.array([getattr(row, f"w_{name}") for name in kept["names"]])
            corner_m, side_m = (
                np.array([kept["y_min_m"], kept["x_min_m"]]),
                float(kept["resolution_m"]),
            )
            ends_m = np.array([[row.start_y_m, row.start_x_m], [row.goal_y_m, row.goal_x_m]])
            start, goal = map(tuple, ((ends_m - corner_m) // side_m).astype(int).tolist())
            layers = weights[:, None, None] * kept["costs"].astype(np.float64)
            problem = base.Problem(
                layers, kept["is_free"], start, goal, side_m, row.w_distance, "line"
            )
        assert astar(problem).cost == pytest.approx(row.grid_optimum, rel=1e-9)
        assert row.best_known <= row.grid_optimum * (1 + 1e-12)


@pytest.mark.parametrize(
    ("cost_model", "constraints", "words"),
    [
        (ju.CostModel(connectivity=4), ju.Constraints(), "not 4 and 'both-free'"),
        (ju.CostModel(diagonal="always"), ju.Constraints(), "not 8 and 'always'"),
        (ju.CostModel(), ju.Constraints.read(require="gps>=0.1"), "study without --require"),
    ],
)
def test_what_the_format_cannot_say_is_refused(cost_model, constraints, words):
    with pytest.raises(ju.InputError, match=words):
        check_exportable(cost_model, constraints)


@pytest.mark.slow
def test_the_command_exports_the_study_of_a_folder(tmp_path, capsys):
    scenario, out = tmp_path / "town.toml", tmp_path / "out"
    scenario.write_text(TOWN + '[study]\ninstances = 4\nplanners = ["ptp", "astar-plus"]\n')
    assert run(capsys, "study", scenario, "-o", out, "--workers", 1)[0] == 0
    rows = pd.read_parquet(out / "study" / "rows.parquet")
    assert movingai.main([str(scenario), str(out), "-o", str(tmp_path / "b")]) == 0
    assert "8 weighted" in capsys.readouterr().out
    assert len(pd.read_parquet(tmp_path / "b" / "instances.parquet")) == 8
    pd.testing.assert_frame_equal(pd.read_parquet(out / "study" / "rows.parquet"), rows)
    assert movingai.main([str(scenario), str(tmp_path), "-o", str(tmp_path / "c")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
