"""docs/validation_receiver.md: what it says of Shinjuku is what comes out, and the command keeps what was promised."""

import json
import time
from pathlib import Path

import pytest

import jaxurban as ju
from benchmarks import receiver
from jaxurban.report.receiver import with_interval
from jaxurban.scenario.changes import changed
from tests.cli_runs import run
from tests.receiver_logs import found


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
def test_the_page_is_what_comes_out(tokyo):
    of_changes = [(change, receiver.validated(change)) for change in receiver.CHANGES]
    assert receiver.PAGE.read_text(encoding="utf-8") == receiver.page(receiver.validated(), of_changes)
