"""docs/evidence/receiver.md says what its command finds, which keeps what the page promises."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from benchmarks import tokyo_receiver as receiver
from benchmarks.receiver import counts
from benchmarks.receiver.counts import CountSettings, read_counts, seen_along, with_interval
from jaxurban.kernels.dop import unit_vectors
from jaxurban.maps.run import scenario_grid
from jaxurban.receivers.sight import Sight
from jaxurban.receivers.validation.drive import drive_track
from tests.benchmarks.count_logs import found
from tests.benchmarks.made_evidence import made_evidence
from tests.embree_scene import CityScene

REACH_M = 2500.0  # beyond it nothing of 334 m shadows a street from 10 degrees


@pytest.fixture
def tokyo(data_dir) -> Path:
    needed = [log for _, log in receiver.TRACKS.values()]
    for settings, _ in receiver.TRACKS.values():
        needed += map(Path, [settings["buildings"]["source"], *settings["gps"]["orbits"]])
    if missing := [file.name for file in needed if not file.exists()]:
        pytest.skip(
            f"the logs and PLATEAU are not part of jaxurban, and {missing[0]} is not in {receiver.DATA}"
        )
    return receiver.TRACKS["Shinjuku"][1]


def test_the_page_has_the_scores_of_every_sky_and_track():
    other = replace(made_evidence(), rivals=made_evidence().rivals.assign(log_loss=0.321))
    page = receiver.page(
        {"some roofs": made_evidence(), "others": other}, {"one": found(), "other": found()}
    )
    (row,) = found().main.query("witness == 'num_tracked'").to_dict("records")
    assert page.count(f"| {with_interval(row, 'within')} | {row['spearman']:.2f} |") == 2
    assert f"\n**{made_evidence().verdict}**\n" in page
    assert "| all judged | 342 (96 %) | 0.842 (0.811 to 0.873) |" in page
    assert "| displaced cities, most |  | 0.622 | 0.522 |" in page
    assert "| margin and elevation | 0.550 | 0.000 (-0.031 to 0.047) | 0.321 |" in page
    assert "| 6 blocks of 100 m | 0.010 (-0.030 to 0.050) | 0.010 (-0.030 to 0.050) |" in page
    assert "{" not in page


@pytest.mark.data
@pytest.mark.slow
def test_lines_of_sight_from_the_track_are_those_through_exact_outlines(tokyo):
    settings = CountSettings()
    scenario, log = ju.Scenario.from_dict(receiver.SHINJUKU), read_counts(tokyo)
    grid = scenario_grid(scenario)
    track = drive_track("a log", log, grid, settings.sky_step_s)
    task = Sight.of_scenario(scenario, grid).task(track.sky_times, settings.antenna_height_m, None)
    made = counts.predict(task, track, lambda *_, **__: None)
    is_seen, known = seen_along(task, track, lambda *_, **__: None)
    buildings = task.city.buildings
    around = shapely.MultiPoint(np.column_stack([track.x_m, track.y_m])).envelope.buffer(REACH_M)
    near = shapely.intersects(buildings.polygons, around)
    scene = CityScene(buildings.polygons[near], buildings.height_m[near])
    exact = np.zeros((len(track.sky), len(task.sky.names)), bool)
    is_above = task.sky.is_in_view[track.sky]
    antenna_m = np.column_stack(
        [track.x_m, track.y_m, np.full(len(track.sky), settings.antenna_height_m)]
    )
    for t in range(len(track.sky_times)):
        epochs = track.sky == t
        in_view = task.in_view(t)
        for s, toward in zip(in_view.numbers, unit_vectors(*in_view.angles), strict=True):
            rays = np.broadcast_to(toward, (epochs.sum(), 3))
            exact[epochs, s] = np.isinf(scene.distance_m(antenna_m[epochs], rays))
    np.testing.assert_array_equal(is_seen.sum(axis=1)[known], made["num_visible"][known])
    is_line = is_above & known[:, None]
    assert (is_seen == exact)[is_line].mean() > 0.98
    told = pd.DataFrame({"piece": track.along_m // 25.0, "tracked": log.num_tracked})[known]
    told = told.assign(ours=made["num_visible"][known], exact=(exact & is_line).sum(axis=1)[known])
    ranks = told.groupby("piece").median().rank().corr()["tracked"]
    assert ranks.exact == pytest.approx(0.555, abs=0.005)
    assert abs(ranks.exact - ranks.ours) < 0.02


@pytest.mark.data
@pytest.mark.slow
def test_what_the_page_says_of_shinjuku_and_of_near_roofs_is_what_its_command_finds(tokyo):
    page = receiver.PAGE.read_text(encoding="utf-8")
    track = receiver.counted_on("Shinjuku")
    (row,) = track.main.query("witness == 'num_tracked'").to_dict("records")
    assert row["within"] > 0.40
    assert row["within_shifts_95"] < row["within_low"]
    assert receiver.tracks_table({"Shinjuku": track}).splitlines()[-1] in page

    sky = receiver.evidence_on("near roofs")
    score = sky.of.score()
    assert score.auc > 0.87
    assert score.within > 0.85
    assert sky.displaced.auc.max() < score.auc_low
    assert sky.displaced.within.max() < score.within_low
    assert sky.verdict in page
    assert receiver.peak_of(sky) in page
    for cells_of in (receiver.scores_of, receiver.rivals_of, receiver.gains_of):
        for name, cells in cells_of(sky).items():
            assert f"\n| {name} | {' | '.join(cells)} |" in page
