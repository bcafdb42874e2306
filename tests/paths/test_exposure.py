"""Budgets of exposure over maps: what is printed is the integral, and no way round them exceeds one."""

import json
import re

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.planners.base import Status
from tests.cli_runs import run
from tests.volumes import options_of

Z_M, DISTANCE = 20.0, {"distance": 1.0, "gps": 0.0, "lidar": 0.0, "population": 0.0, "risk": 0.0}


@pytest.fixture(scope="module")
def on(maps):
    return ju.cost_map(maps, Z_M, weights=DISTANCE)


def by_hand(path, on, name):
    """Return (1 / l0) x integral of c ds of a path, cell by cell."""
    cut = crossed_cells(path.search.points_m, on.grid.resolution_m)
    cost = on.maps.costs(Z_M)[name]
    return float(np.sum(cut.length_m * cost[cut.row, cut.col]) / on.cost_model.reference_length_m)


def test_exposures_are_integrals_and_budgets_are_kept_at_the_least_length(on, ends):
    free, safe = (
        on.plan(**ends),
        on.with_weights({**DISTANCE, "distance": 1e-6, "risk": 1.0}).plan(**ends),
    )
    for path in (free, safe):
        assert {*path.exposure_by_layer} == {*on.names}
        assert path.exposure_by_layer["risk"] == pytest.approx(by_hand(path, on, "risk"), rel=1e-6)
    most = (free.exposure_by_layer["risk"] + 2 * safe.exposure_by_layer["risk"]) / 3
    path = on.plan(**ends, exposure={"risk": most})
    assert path.exposure_by_layer["risk"] <= most * (1 + 1e-9) < free.exposure_by_layer["risk"]
    assert free.cost < path.cost <= safe.length_m * (1 + 1e-9)
    assert free.cost <= path.search.lower_bound <= path.cost
    assert path.settings["exposure"] == {"risk": most}
    assert on.plan(**ends, exposure={"risk": 1e9}).cost == free.cost


def test_a_path_is_not_simplified_beyond_its_budget(on, ends):
    kept = []
    for name in on.names:
        least = (
            on.with_weights({**DISTANCE, "distance": 1e-6, name: 1.0})
            .plan(**ends)
            .exposure_by_layer[name]
        )
        path = on.plan(**ends, exposure={name: least * 1.0001})
        simpler = ju.simplify(path, on, 300.0)
        assert simpler.exposure_by_layer[name] <= least * 1.0001 * (1 + 1e-9)
        if "which would exceed the budget" in simpler.message:
            np.testing.assert_array_equal(simpler.xy_m, path.xy_m)
            kept.append(name)
    assert kept


def test_the_least_exposure_is_said_under_weights_of_zero_too(on, ends):
    path = on.with_weights(dict.fromkeys(DISTANCE, 0.0)).plan(**ends, exposure={"gps": 0.001})
    assert path.status is Status.OVER_EXPOSURE
    assert re.search(r"any path has is [\d.]+ to gps.* All weights are zero", path.message)


def test_a_volume_keeps_budgets_too(maps, ends):
    volume = ju.cost_map(maps, ju.Levels(), weights=DISTANCE)
    free = volume.plan(**ends).exposure_by_layer["gps"]
    path = volume.plan(**ends, exposure={"gps": 0.9 * free})
    assert path.exposure_by_layer["gps"] <= 0.9 * free
    assert path.search.lower_bound <= path.cost


def test_a_volume_says_that_it_ended_where_budgets_keep_each_alone_but_not_together(maps, ends):
    volume = ju.cost_map(maps, ju.Levels(), weights=DISTANCE)
    least = {
        name: volume.with_weights({**DISTANCE, "distance": 1e-6, name: 1.0})
        .plan(**ends)
        .exposure_by_layer[name]
        * 1.01
        for name in volume.names
    }
    path = volume.plan(**ends, exposure=least, budget_s=60.0)
    assert (path.status, path.status.exit_code) == (Status.UNDECIDED, 4)
    assert "more time changes nothing" in path.message
    assert "budget_s" not in path.message
    assert path.search.elapsed_s < 60.0


def test_the_command_prints_the_exposure_and_ends_with_3_where_no_path_keeps_the_budget(
    maps, folder, ends, capsys
):
    given = ("plan", folder, *options_of(maps, **ends))
    code, out, _ = run(capsys, *given, "--exposure", "gps<=1000", "--exposure", "risk <= 1000")
    assert code == 0
    assert re.search(r"^gps +\d+\.\d{3} +\d+\.\d{3} +\d\.\d{3}$", out, re.MULTILINE)
    code, out, _ = run(capsys, *given, "--exposure", "gps<=0.001", "--json")
    facts = json.loads(out)
    assert (code, facts["status"]) == (3, Status.OVER_EXPOSURE.value)
    assert "least exposure that any path has is" in facts["message"]
