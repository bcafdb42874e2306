"""docs/validation_receiver.md: what it says of Shinjuku is what comes out, and the command keeps what was promised."""

import json
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from benchmarks import receiver
from jaxurban.io.read.receiver import read_receiver_log
from jaxurban.kernels.dop import unit_vectors
from jaxurban.report.receiver import with_interval
from jaxurban.scenario.changes import changed
from jaxurban.studies.receiver import prediction
from jaxurban.studies.receiver.track import Track
from tests.cli_runs import run
from tests.embree_scene import CityScene
from tests.receiver_logs import found

REACH_M = 2500.0  # beyond it nothing of 334 m shadows a street from 10 degrees


@pytest.fixture
def tokyo(data_dir) -> Path:
    missing = [file.name for file in (receiver.LOG, receiver.BUILDINGS, receiver.GPS) if not file.exists()]
    if missing:
        pytest.skip(f"UrbanNav and PLATEAU are not part of jaxurban, and {missing[0]} is not in {receiver.DATA}")
    return receiver.LOG


def test_the_page_tells_scores_and_changes_of_any_log():
    page = receiver.page(found(), [(receiver.Change("nothing"), found())])
    (row,) = found().main.query("witness == 'num_tracked'").to_dict("records")
    told = with_interval(row, "spearman")
    assert page.count(told) >= 4
    assert "| nothing | 4.7 |" in page
    assert "+0.000 (+0.000 to +0.000)" in page
    assert "{" not in page


def test_every_change_is_one_of_a_scenario_that_can_be_read():
    whole = ju.Scenario.from_dict(receiver.SETTINGS)
    for change in receiver.CHANGES:
        of = ju.Scenario.from_dict(changed(receiver.SETTINGS, change.settings, ju.Scenario))
        assert (of != whole) == bool(change.settings), change.name


@pytest.mark.data
@pytest.mark.slow
def test_the_command_tells_streets_of_shinjuku_apart_and_a_shifted_city_does_not(tokyo, tmp_path, capsys):
    (tmp_path / "shinjuku.toml").write_text(ju.Scenario.from_dict(receiver.SETTINGS).to_toml())
    began_s = time.process_time()
    code, _, err = run(capsys, "validate", tmp_path / "shinjuku.toml", tokyo, "-o", tmp_path / "out")
    spent_s = time.process_time() - began_s
    assert code == 0, err
    scores = json.loads((tmp_path / "out/validation.json").read_text())["scores"]
    (row,) = [
        each
        for each in scores
        if (each["witness"], each["prediction"], each["piece_m"]) == ("num_tracked", "num_visible", 25.0)
    ]
    assert row["spearman"] > 0.53
    assert row["auc"] > 0.70
    assert row["spearman_shifted"] < 0.25 < row["spearman_low"]
    assert spent_s < 90.0


@pytest.mark.data
@pytest.mark.slow
def test_lines_of_sight_from_the_track_are_those_through_exact_outlines(tokyo):
    settings = ju.ReceiverSettings()
    scenario, log = ju.Scenario.from_dict(receiver.SETTINGS), read_receiver_log(tokyo)
    grid = prediction.region_of(scenario, None)
    track = Track.of(log, grid, settings.sky_step_s)
    task = prediction.task_at(scenario, track.sky_times, grid, settings)
    made = prediction.predict(task, track, (), lambda *_, **__: None)
    buildings = task.city.buildings
    x_min, y_min, x_max, y_max = buildings.boxes_m
    near = (x_max > track.x_m.min() - REACH_M) & (x_min < track.x_m.max() + REACH_M)
    near &= (y_max > track.y_m.min() - REACH_M) & (y_min < track.y_m.max() + REACH_M)
    scene = CityScene(buildings.polygons[near], buildings.height_m[near])
    exact = np.zeros_like(made.is_above)
    antenna_m = np.column_stack([track.x_m, track.y_m, np.full(len(track.sky), settings.antenna_height_m)])
    for t in range(len(track.sky_times)):
        epochs = track.sky == t
        for s, toward in zip(task.satellites_at(t), unit_vectors(*task.angles(t)), strict=True):
            rays = np.broadcast_to(toward, (epochs.sum(), 3))
            exact[epochs, s] = np.isinf(scene.distance_m(antenna_m[epochs], rays))
    known = ~np.isnan(made.values["num_visible"][0])
    is_line = made.is_above & known[:, None]
    assert (made.is_seen[0] == exact)[is_line].mean() > 0.98
    told = pd.DataFrame({"piece": track.cut(25.0), "tracked": log.epochs.num_tracked})[known]
    told = told.assign(ours=made.values["num_visible"][0][known], exact=(exact & is_line).sum(axis=1)[known])
    ranks = told.groupby("piece").median().rank().corr()["tracked"]
    assert ranks.exact == pytest.approx(0.555, abs=0.005)
    assert abs(ranks.exact - ranks.ours) < 0.02


@pytest.mark.data
@pytest.mark.slow
def test_the_page_is_what_comes_out(tokyo):
    of_changes = [(change, receiver.validated(change)) for change in receiver.CHANGES]
    assert receiver.PAGE.read_text(encoding="utf-8") == receiver.page(receiver.validated(), of_changes)
