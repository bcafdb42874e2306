"""The command validate: what it writes, its JSON without NaN, and its errors."""

import json

import pandas as pd
import pytest

import jaxurban as ju
from tests.cli_runs import assert_one_sentence, run
from tests.receivers.receiver_logs import SCENARIO, scenario
from tests.satellite_logs import heard


@pytest.mark.slow
def test_the_command_writes_a_folder_of_its_own(tmp_path, capsys):
    toml = tmp_path / "town.toml"
    toml.write_text(scenario().to_toml())
    heard().to_csv(tmp_path / "log.csv", index=False)
    out = tmp_path / "out"
    code, told, err = run(capsys, "validate", toml, tmp_path / "log.csv", "-o", out, "--json")
    assert code == 0, err
    told = json.loads(told, parse_constant=pytest.fail)
    scores = pd.read_parquet(out / "tables/scores.parquet")
    assert [row["auc"] for row in told["scores"]] == scores.auc.tolist()
    rows = pd.read_parquet(out / "tables/satellites.parquet")
    assert len(rows) == told["summary"]["rows"]
    assert (rows.state == "unknown").sum() > 0
    assert len(pd.read_csv(out / "tables/epochs.csv")) == told["summary"]["epochs"]
    assert "figures/margin.png" in (out / "report.md").read_text()
    assert (out / "figures/margin.png").stat().st_size > 5000
    again = (
        "validate",
        toml,
        tmp_path / "log.csv",
        "-o",
        out,
        "--antenna-height",
        "3",
    )
    code, _, err = run(capsys, *again)
    assert code == 2
    assert_one_sentence(err, "holds another run", "--overwrite")
    assert run(capsys, *again, "--overwrite")[0] == 0


def test_a_log_that_cannot_be_used_ends_the_command_with_one_sentence(tmp_path, capsys):
    toml, log = tmp_path / "town.toml", tmp_path / "log.csv"
    toml.write_text(ju.Scenario.from_dict(SCENARIO).to_toml())
    log.write_text("utc,lon_deg,lat_deg\n2020-04-27T16:00:00Z,-73.9,40.7\n")
    code, out, err = run(capsys, "validate", toml, log, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert_one_sentence(err, "satellite and cn0_dbhz")
    assert not (tmp_path / "out" / "report.md").exists()
