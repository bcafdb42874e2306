"""What both studies share: rows that are complete, kept through a kill, the same from one worker and from two."""

import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from tests.studies.routes_made import run_study, same_rows

KEY = ["instance", "altitude_m"]
WHERE = {"study": "", "weight_study": "routes/"}  # rows lie in a study's folder
CALL = "import sys; from tests.studies.routes_made import run_study; run_study(sys.argv[1], sys.argv[2:4], sys.argv[4])"


@pytest.fixture(params=WHERE)
def kept(request, folders):
    """Return a study's name, what it gave, how it is run in another folder, and the columns that name a row."""
    result = request.getfixturevalue(request.param)
    key = KEY + (["planner", "objective"] if request.param == "study" else ["city"])
    return request.param, result, partial(run_study, request.param, folders), key


def test_every_run_has_a_row_once_and_the_file_holds_them(kept):
    name, result, _, key = kept
    assert len(result.rows) == (12 * 2 * 6 if name == "study" else 2 * 9 * 2)  # five planners and one distance-only run
    assert not result.rows.duplicated(key).any()
    assert not result.rows.status.isin(["crashed", "invalid", "bad-input"]).any()
    same_rows(pd.read_parquet(result.folder / WHERE[name] / "rows.parquet"), result.rows)


@pytest.mark.slow
def test_a_killed_study_goes_on_with_no_row_lost_or_doubled(kept, folders, tmp_path):
    name, result, again, key = kept
    out = tmp_path / "out"
    parts = out / WHERE[name] / "parts"
    job = subprocess.Popen([sys.executable, "-c", CALL, name, *folders, out], cwd=Path(__file__).parents[2])
    while len(list(parts.glob("*.json"))) < 3:
        assert job.poll() is None
        time.sleep(0.005)
    job.send_signal(signal.SIGKILL)
    job.wait()
    rows = [row for part in parts.glob("*.json") for row in json.loads(part.read_text())["rows"]]
    assert 0 < len(rows) < len(result.rows)
    found = again(out).rows
    same_rows(found, result.rows)
    times = found.set_index(key).elapsed_s
    for row in rows:  # what was done before is not done again
        assert times[tuple(row[column] for column in key)] == row["elapsed_s"]


@pytest.mark.slow
def test_two_workers_give_the_rows_of_one(kept, tmp_path):
    _, result, again, _ = kept
    same_rows(again(tmp_path, workers=2).rows, result.rows)
