"""jaxurban tune: what it writes, how it resumes, and what it refuses."""

import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.paths.plan import cost_map
from jaxurban.studies.demonstrations import optimal_demonstrations
from tests.cli_runs import assert_one_sentence, run
from tests.studies.routes_made import HIDDEN, made_queries, small_maps, write_geojson

FILE = Path(__file__)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Path]:
    """A folder of maps, and a file of routes on them."""
    folder, maps = tmp_path_factory.mktemp("tune"), small_maps()
    maps.save(folder / "maps")
    routes = optimal_demonstrations(made_queries(cost_map(maps, 20.0), 16), HIDDEN)
    return folder / "maps", write_geojson(folder / "routes.geojson", routes)


def facts_of(capsys, *arguments) -> dict:
    code, out, err = run(capsys, "tune", *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def assert_refused(ended, *words) -> None:
    code, out, err = ended
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)


@pytest.mark.slow
def test_a_fit_is_written_as_tables_pictures_and_a_report(made, tmp_path, capsys):
    out = tmp_path / "out"
    facts = facts_of(capsys, *made, "-o", out, "--fit", "bootstrap=20")
    assert sum(facts["weights"].values()) == pytest.approx(1)
    assert facts["mean_regret"] < 1e-3
    for table in ("weights", "examples", "learning_curve"):
        assert (
            len(pd.read_parquet(out / f"{table}.parquet"))
            == len(pd.read_csv(out / f"{table}.csv"))
            > 0
        )
    report = (out / "report.md").read_text()
    for line, name in zip(
        report.splitlines()[2:5], ("Decided", "Not decided", "Next"), strict=True
    ):
        assert line.startswith(f"- **{name}**: ")
    assert report.splitlines()[6] == f"**{facts['message']}**"
    parts = [line.removeprefix("## ") for line in report.splitlines() if line.startswith("## ")]
    assert parts[:2] == ["Fitted weights", "Routes under the weights"]
    assert parts[2:] == ["How sure", "How to use the weights", "Files"]
    assert "4 further routes were held out" in report
    assert "routes.geojson` over the maps in" in report
    assert ": 12 fitted, 4 held out." in report
    examples = pd.read_csv(out / "examples.csv")
    assert examples.is_held_out.sum() == 4
    assert examples.regret.max() < 1e-3
    assert "interval by bootstrap over 4 pairs of ends" in report
    assert report.count("© a made city") == 1
    for figure in ("weights", "routes_1"):
        assert (out / "figures" / f"{figure}.png").is_file()
        assert f"(figures/{figure}.png)" in report
    assert f"--weights {facts['weights_option']}" in report
    option = ju.Weights.parse(facts["weights_option"]).to_dict()
    assert option == pytest.approx(facts["weights"], rel=1e-4, abs=1e-12)
    assert [*pd.read_csv(out / "weights.csv")["name"]] == [
        "distance",
        "gps",
        "lidar",
        "population",
        "risk",
    ]

    code, _, err = run(capsys, *shlex.split(facts["decided"]["lines"]["next"])[1:])
    assert code == 0, err
    again = facts_of(capsys, *made, "-o", out, "--fit", "bootstrap=20")
    assert (again["weights"], again["decided"]) == (facts["weights"], facts["decided"])
    assert_refused(
        run(capsys, "tune", *made, "-o", out, "--fit", "bootstrap=20,seed=1"),
        "its seed is 0, now 1",
        "--overwrite",
    )
    (out / "weights.csv").write_text("mine")
    refused = run(capsys, "tune", *made, "-o", out, "--fit", "bootstrap=20", "--overwrite")
    assert_refused(refused, "weights.csv", "is not as `jaxurban tune` wrote it")


@pytest.mark.slow
def test_targets_are_reported_met_or_missed(made, tmp_path, capsys):
    options = (
        "--wish",
        "mean_gps>=0.999",
        "--wish",
        "detour<=0.3",
        "--metrics",
        "gps",
        "--fit",
        "max_rounds=1",
    )
    facts = facts_of(capsys, *made, "-o", tmp_path / "out", *options)
    assert not facts["is_met"]
    assert "misses mean_gps >= 0.999 (reached " in facts["message"]
    assert (tmp_path / "out" / "figures" / "routes_1.png").is_file()
    report = (tmp_path / "out" / "report.md").read_text()
    assert (report.count(facts["message"]), report.count("© a made city")) == (1, 1)
    assert len(pd.read_csv(tmp_path / "out" / "targets.csv")) == 2
    tested = pd.read_csv(tmp_path / "out" / "tested.csv").set_index("what")
    assert [*tested.index] == ["mean_gps >= 0.999", "detour <= 0.3", "length_m"]
    assert np.all(tested.largest.abs() >= tested.change.abs())
    assert np.all(tested.largest.abs() >= tested["median"].abs())
    first = facts["decided"]["lines"]["not decided"]  # as so few pairs have no interval
    assert first.startswith("whether mean_gps >= 0.999 holds on other routes is open: ")
    assert "Means over 4 routes, of which the fit saw none" in report
    assert "as given" not in report


@pytest.mark.slow
@pytest.mark.parametrize(
    ("num_sources", "options", "words"),
    [
        (2, ("--altitude", 13), ("13", "from 20 to 60 m")),
        (2, ("--wish", "mean_gsp>=1"), ("mean_gps",)),
        (2, ("--wish", "mean_gps>=0.8", "--fit", "bootstrap=3"), ("--fit bootstrap",)),
        (2, ("--metrics", "gsp"), ("gsp", "gps")),
        (2, ("--resolution", 7), ("7",)),
        (2, ("--fit", "budget_s=-1"), ("budget_s",)),
        (2, ("--sample", 3), ("choose one of both",)),
        (2, ("--fit", "hold_out=1"), ("hold_out",)),
        (2, ("-o", FILE), ("cannot write to the output folder",)),
        (1, ("--sample", 6, "--metrics", "gps"), ("name the weights of the pilot",)),
        (1, ("--sample", 6, "--pilot", "distance=0,gps=0"), ("every weight of the pilot is 0",)),
        (1, (), ("name files of routes", "instances.parquet", "--sample")),
        (2, ("--pilot", "gps=1"), ("are lines", "--pilot")),
    ],
)
def test_bad_input_is_one_sentence_and_exit_two(
    made, tmp_path, capsys, num_sources, options, words
):
    assert_refused(
        run(capsys, "tune", *made[:num_sources], "-o", tmp_path / "out", *options), *words
    )


@pytest.mark.slow
def test_cities_are_fitted_together_and_judged_by_routes_held_out(made, tmp_path, capsys):
    small_maps().save(tmp_path / "second")
    queries = made_queries(cost_map(small_maps(), 20.0), 12, seed=1)
    write_geojson(tmp_path / "second.geojson", optimal_demonstrations(queries, HIDDEN))
    options = ("--fit", "hold_out=0.25,bootstrap=8,max_rounds=14")
    second = (tmp_path / "second", tmp_path / "second.geojson")
    facts = facts_of(capsys, *made, *second, "-o", tmp_path / "out", *options)
    first = facts["decided"]["verdicts"][0]
    assert (first["kind"], first["n"]) == ("untested", 7)  # 6 degrees of freedom of two cities
    assert first["size"] < 0.1
    report = (tmp_path / "out" / "report.md").read_text()
    assert "7 further routes were held out" in report
    is_held_out = pd.read_csv(tmp_path / "out" / "examples.csv").is_held_out
    assert (len(is_held_out), is_held_out.sum()) == (28, 7)


@pytest.mark.slow
def test_sampled_instances_are_flown_by_the_pilot_by_day_and_by_night(tmp_path, capsys):
    ju.MetricMaps(small_maps().ds.assign_attrs(pop_norm_per_km2=[1e4, 3e4])).save(tmp_path / "maps")
    options = (
        "--sample",
        6,
        "--pilot",
        "distance=0.02,gps=1,population=1",
        "--fit",
        "seed=1,bootstrap=0",
    )
    assert (
        facts_of(capsys, tmp_path / "maps", "-o", tmp_path / "out", *options)["mean_regret"] < 1e-4
    )
    assert {*pd.read_csv(tmp_path / "out" / "examples.csv")["time_of_day"]} == {"day", "night"}
    assert "6 instances sampled with seed 1" in (tmp_path / "out" / "report.md").read_text()

    # The pairs that were drawn are taken again as they are.
    drawn = tmp_path / "out" / "instances.parquet"
    again = facts_of(capsys, tmp_path / "maps", drawn, "-o", tmp_path / "again", *options[2:])
    first = pd.read_csv(tmp_path / "out" / "examples.csv")
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "again" / "examples.csv"), first)
    assert again["num_plans"] > 0


@pytest.mark.slow
def test_the_instances_of_a_study_are_fitted_and_their_ends_take_a_wish(tmp_path, capsys):
    maps, out = tmp_path / "city", tmp_path / "out"
    small_maps().save(maps)
    planned = ju.studies.Study(planners=["ptp"], weights=[HIDDEN], altitudes_m=[20.0])
    ju.studies.study(maps, maps / "study", 16, settings=planned, progress=False)
    file = maps / "study" / "instances.parquet"
    facts = facts_of(capsys, maps, file, "-o", out, "--fit", "bootstrap=0")
    assert facts["mean_regret"] < 1e-3
    assert f"`{file}` over the maps in `{maps}`" in (out / "report.md").read_text()
    wish = ("--wish", "mean_gps>=0.5", "--metrics", "gps", "--fit", "max_rounds=1")
    wished = facts_of(capsys, maps, file, "-o", tmp_path / "c", *wish)
    assert len(wished["outcomes"]) == 1

    # Further routes that are drawn are of the altitude and the time of day of these.
    by_day = tmp_path / "day.parquet"
    pd.read_parquet(file).query("time_of_day == 'day'").to_parquet(by_day)
    wished = facts_of(capsys, maps, by_day, "-o", tmp_path / "d", *wish)
    command = wished["decided"]["lines"]["next"]
    assert " --altitude 20.0 --time " in command
    assert " --time-of-day day --sample " in command
