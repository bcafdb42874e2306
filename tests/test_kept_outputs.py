"""What is made of three small scenes is what is kept, and a difference is told; faults can be made."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from tests import faults
from tests.kept_outputs import __main__ as net


@pytest.mark.parametrize(
    "scene",
    [pytest.param(each, marks=[pytest.mark.slow] * (each != "town")) for each in net.SCENES],
)
def test_maps_routes_studies_and_fits_are_what_is_kept(scene, tmp_path):
    assert [row for row in net.compared(scene, tmp_path) if not row.is_same] == [], net.RENEWING


def verdicts(rows):
    return {row.what: row.is_same for row in rows}


def test_a_map_that_differs_by_more_than_a_processor_makes_it_is_told():
    old, _ = net.kept("synthetic")
    new = {name: values.copy() for name, values in old.items()}
    assert all(verdicts(net.judge_maps(old, new)).values())
    new["lidar"][0, 0, 0] += 1 / (16 * 360)  # a beam of one cell
    is_judged = old["gdop"] < net.GDOP_JUDGED
    new["gdop"][~is_judged] *= 2
    new["hdop"][is_judged] *= 1 + 1e-4
    new["num_visible"].flat[:3] += 1
    del new["roof"]
    assert [row.what for row in net.judge_maps(old, new) if not row.is_same] == [
        "hdop",
        "lidar",
        "roof",
    ]
    new["obstacle"] = ~old["obstacle"]
    assert not verdicts(net.judge_maps(old, new))["obstacle"]


@pytest.mark.parametrize(
    ("after", "is_same"),
    [
        ({"status": "optimal", "cost": 100.0 + 1e-8, "gps": 0.5 + 1e-7}, True),
        ({"status": "optimal", "cost": 100.0 + 1e-6, "gps": 0.5}, False),
        ({"status": "no-path", "cost": 100.0, "gps": 0.5}, False),
        ({"status": "optimal", "cost": None, "gps": 0.5}, False),
        ({"status": "optimal", "cost": 100.0}, False),
        ({}, False),
    ],
)
def test_a_route_that_costs_another_sum_is_told(after, is_same):
    before = {"status": "optimal", "cost": 100.0, "gps": 0.5}
    assert verdicts(net.judge_numbers({"route": before}, {"route": after} if after else {})) == {
        "route": is_same
    }
    assert np.isinf(net.share("optimal", "no-path"))


def test_what_is_kept_stays_small():
    assert (
        sum(file.stat().st_size for file in Path(net.HERE).rglob("*") if file.suffix != ".pyc")
        < 500_000
    )


def test_most_of_the_faults_can_still_be_made_and_each_is_one_line_of_python():
    num_made = 0
    for line in faults.KEPT.read_text(encoding="utf-8").splitlines():
        fault = json.loads(line)
        file = faults.ROOT / fault["file"]
        text = file.read_text(encoding="utf-8") if file.exists() else ""
        if made := faults.with_fault(text, fault):
            ast.parse(made)
            pairs = zip(text.splitlines(), made.splitlines(), strict=True)
            assert sum(old != new for old, new in pairs) == 1, fault
            num_made += 1
    assert num_made >= 20, (
        "code of too many faults is gone: draw anew (python -m tests.faults draw)"
    )
