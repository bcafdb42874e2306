"""jaxurban tune: what it writes, how it resumes, and what it refuses."""

import json
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.io.store import write_zarr
from jaxurban.paths.plan import cost_map
from jaxurban.studies.demonstrations import optimal_demonstrations
from tests.cli_runs import assert_one_sentence, run
from tests.studies.routes_made import HIDDEN, made_queries, small_maps, write_geojson

NUM, BOTH = 16, ("maps", "routes.geojson")
FILE = Path(__file__)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tune")
    maps = small_maps()
    write_zarr(maps.ds, folder / "maps")
    write_geojson(folder / "routes.geojson", optimal_demonstrations(made_queries(cost_map(maps, 20.0), NUM), HIDDEN))
    return folder


def tune(capsys, made, *options):
    return run(capsys, "tune", made / "maps", made / "routes.geojson", *options)


def facts_of(capsys, made, *options) -> dict:
    code, out, err = tune(capsys, made, *options, "--json")
    assert code == 0, err
    return json.loads(out)


def assert_refused(ended, *words) -> None:
    code, out, err = ended
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)


@pytest.mark.slow
def test_a_fit_is_written_as_tables_pictures_and_a_report(made, tmp_path, capsys):
    out = tmp_path / "out"
    facts = facts_of(capsys, made, "-o", out, "--bootstrap", 20)
    assert sum(facts["weights"].values()) == pytest.approx(1)
    assert facts["mean_regret"] < 1e-3
    for table in ("weights", "examples", "learning_curve"):
        assert len(pd.read_parquet(out / f"{table}.parquet")) == len(pd.read_csv(out / f"{table}.csv")) > 0
    report = (out / "report.md").read_text()
    assert report.count("\n## ") >= 7
    assert report.count("© a made city") == 1
    for figure in ("weights", "routes_1"):
        assert (out / "figures" / f"{figure}.png").is_file()
        assert f"(figures/{figure}.png)" in report
    stored = tomllib.loads((out / "weights.toml").read_text())["weights"]
    assert ju.Weights.parse(facts["weights_option"]).to_dict() == stored
    assert stored == pytest.approx(facts["weights"], rel=1e-4, abs=1e-12)
    assert [*pd.read_csv(out / "weights.csv")["name"]] == ["distance", "gps", "lidar", "population", "risk"]

    again = facts_of(capsys, made, "-o", out, "--bootstrap", 20)
    assert (again["weights"], again["interval"]) == (facts["weights"], facts["interval"])
    assert_refused(tune(capsys, made, "-o", out, "--seed", 1), "another file or folder", "--overwrite")


@pytest.mark.slow
def test_targets_are_reported_met_or_missed(made, tmp_path, capsys):
    options = ("--wish", "mean_gps>=0.999", "--wish", "detour<=0.3", "--metrics", "gps", "--rounds", 1)
    facts = facts_of(capsys, made, "-o", tmp_path / "out", *options)
    assert not facts["is_met"]
    assert "misses mean_gps >= 0.999 (reached " in facts["message"]
    assert (tmp_path / "out" / "figures" / "routes_1.png").is_file()
    report = (tmp_path / "out" / "report.md").read_text()
    assert (report.count(facts["message"]), report.count("© a made city")) == (1, 1)
    assert len(pd.read_csv(tmp_path / "out" / "targets.csv")) == 2


@pytest.mark.parametrize(
    ("sources", "options", "words"),
    [
        (BOTH, ("--altitude", 13), ("13", "from 20 to 60 m")),
        (BOTH, ("--wish", "mean_gsp>=1"), ("mean_gps",)),
        (BOTH, ("--wish", "mean_gps>=0.8", "--bootstrap", 3), ("--bootstrap",)),
        (BOTH, ("--metrics", "gsp"), ("gsp", "gps")),
        (BOTH, ("--resolution", 7), ("7",)),
        (BOTH, ("--budget", -1), ("budget_s",)),
        (BOTH, ("--sample", 3), ("choose one of both",)),
        (BOTH, ("--hold-out", 1), ("hold_out",)),
        (BOTH, ("-o", FILE), ("it is a file",)),
        (("maps",), ("--sample", 6, "--metrics", "gps"), ("name the weights of the pilot",)),
        (("maps",), ("--sample", 6, "--pilot", "distance=0,gps=0"), ("every weight of the pilot is 0",)),
        (("maps",), (), ("name files of routes", "--sample")),
    ],
)
def test_bad_input_is_one_sentence_and_exit_two(made, tmp_path, capsys, sources, options, words):
    sources = [made / name for name in sources]
    assert_refused(run(capsys, "tune", *sources, "-o", tmp_path / "out", *options), *words)


@pytest.mark.slow
def test_a_fit_replaces_no_file_that_it_did_not_make(made, tmp_path, capsys):
    fit = ("-o", tmp_path, "--rounds", 1, "--wish", "mean_gps>=0.9", "--metrics", "gps")
    (tmp_path / "report.md").write_text("mine")
    told = ("report.md", "not from `jaxurban tune`", "choose another folder")
    assert_refused(tune(capsys, made, *fit, "--overwrite"), *told)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("report.md", "mine")]
    (tmp_path / "report.md").unlink()
    assert tune(capsys, made, *fit)[0] == 0
    (tmp_path / "notes.txt").write_text("mine")
    assert tune(capsys, made, *fit, "--overwrite")[0] == 0
    (tmp_path / "weights.toml").write_text("mine")
    assert_refused(tune(capsys, made, *fit, "--overwrite"), "weights.toml", "is not as `jaxurban tune` wrote it")
    assert [(tmp_path / name).read_text() for name in ("notes.txt", "weights.toml")] == ["mine", "mine"]


@pytest.mark.slow
def test_ctrl_c_keeps_the_searches_and_the_same_command_ends_alike(made, tmp_path, capsys):
    main = [sys.executable, "-c", "from jaxurban.cli.main import main; main()"]
    arguments = ["tune", made / "maps", made / "routes.geojson", "--bootstrap", 0, "-o", tmp_path / "out"]
    process = subprocess.Popen([*main, *map(str, arguments)], stderr=subprocess.PIPE, text=True)
    state = tmp_path / "out" / "fit-state.parquet"
    deadline = time.monotonic() + 120
    while not state.exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert state.exists()
    resumed, whole = (facts_of(capsys, made, "--bootstrap", 0, "-o", tmp_path / name) for name in ("out", "whole"))
    assert resumed["weights"] == whole["weights"]


@pytest.mark.slow
def test_cities_are_fitted_together_and_judged_by_routes_held_out(made, tmp_path, capsys):
    write_zarr(small_maps().ds, tmp_path / "second")
    queries = made_queries(cost_map(small_maps(), 20.0), 12, seed=1)
    write_geojson(tmp_path / "second.geojson", optimal_demonstrations(queries, HIDDEN))
    options = ("--hold-out", 0.25, "--by-city", "--bootstrap", 8)
    second = (tmp_path / "second", tmp_path / "second.geojson")
    facts = facts_of(capsys, made, *second, "-o", tmp_path / "out", *options, "--rounds", 14)
    assert [row["fit"] for row in facts["fits"]] == ["all", "only maps", "only second"]
    assert facts["fits"][0]["held_out_regret"] < 1e-3
    report = (tmp_path / "out" / "report.md").read_text()
    for words in ("## Fits compared", "7 of 28 routes were held out", "| only second |"):
        assert words in report
    assert len(pd.read_csv(tmp_path / "out" / "examples.csv")) == 21
    assert [*pd.read_csv(tmp_path / "out" / "fits.csv")["fit"]] == [row["fit"] for row in facts["fits"]]


@pytest.mark.slow
def test_sampled_instances_are_flown_by_the_pilot(made, tmp_path, capsys):
    options = ("--sample", 6, "--metrics", "gps", "--pilot", "distance=0.02,gps=1", "--bootstrap", 0, "--json")
    code, out, err = run(capsys, "tune", made / "maps", "-o", tmp_path / "out", *options)
    assert code == 0, err
    assert json.loads(out)["mean_regret"] < 1e-4
    assert "6 instances sampled with seed 0" in (tmp_path / "out" / "report.md").read_text()
