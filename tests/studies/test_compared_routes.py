"""Routes of one map under another: against sums by hand, and against what was built into the maps."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.kernels.line.traversal import crossed_cells
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps
from tests.studies.test_map_comparison import changed_from

NUM = 30


@pytest.fixture(scope="module")
def maps():
    a = made_maps()
    return a, changed_from(a)


@pytest.fixture(scope="module")
def found(maps):
    return ju.studies.compare(*maps, routes=NUM, seed=3, progress=False)


def ends(row):
    return ju.XY(row.start_x_m, row.start_y_m), ju.XY(row.goal_x_m, row.goal_y_m)


@pytest.mark.slow
def test_costs_and_regrets_are_sums_by_hand(maps, found):
    (here, there), num_closed, num_open = maps, 0, 0
    for row in found.routes.groupby("altitude_m").head(24).itertuples():
        z_m = row.altitude_m
        path = ju.cost_map(here, z_m).plan(*ends(row))
        assert path.status.value == row.status == "optimal"
        assert path.cost == pytest.approx(row.cost, rel=1e-9)
        for over, no_fix_m in ((here, row.no_fix_m), (there, row.no_fix_there_m)):
            assert no_fix_m == pytest.approx(ju.explain(path, over).totals["no_fix_m"], abs=1e-6)
        cut = crossed_cells(path.search.points_m, there.grid.resolution_m)
        cell, is_free = (cut.row, cut.col), there.is_free(z_m)
        assert row.is_closed == 1 or is_free[cell].all()
        weights, model = ju.Weights().to_dict(), ju.CostModel()
        per_m = weights["distance"] + sum(
            weights[name] * cost[cell] / model.reference_length_m
            for name, cost in there.costs(z_m).items()
        )
        if np.isnan(row.cost_there):
            num_closed += 1
            assert row.is_closed == row.is_changed == 1
            continue
        num_open += 1
        assert row.is_closed == 0
        assert row.cost_there == pytest.approx(np.sum(cut.length_m * per_m), rel=1e-6)
        best = ju.cost_map(there, z_m).plan(*ends(row)).cost
        assert row.best_there == pytest.approx(best, rel=1e-9)
        assert row.regret == pytest.approx(max(row.cost_there / best - 1, 0), abs=1e-9)
        assert row.is_changed == (row.regret > 1e-4)
    assert num_open > 20
    assert num_closed > 0


def test_the_verdict_counts_routes_that_cost_more_or_are_closed(maps, found):
    (verdict,) = (each for each in found.decided.verdicts if each.kind.name == "ROUTES")
    routes = found.routes[found.routes.cost.notna()]
    is_changed = (routes.regret > 1e-4) | (routes.is_closed == 1)
    assert "are closed on B or cost over 0.01 % more there than B's own" in verdict.sentence
    assert verdict.n == len(routes)
    assert verdict.facts["count"] == is_changed.sum() > 0
    assert verdict.size == pytest.approx(100 * is_changed.mean())
    assert verdict.low <= verdict.size <= verdict.high
    assert verdict.facts["apart_m"] == routes.apart_m[is_changed].max() > 10
    assert verdict.facts["closed"] == (routes.is_closed == 1).sum() > 0
    assert verdict.facts["lost"] == (routes.status_there != "optimal").sum()
    for z_m, each in is_changed.groupby(routes.altitude_m):
        assert f"{each.sum()} of {NUM} at {z_m:g} m" in verdict.sentence
    same = ju.studies.compare(maps[0], maps[0], routes=NUM, progress=False).decided
    assert f"0 of A's {2 * NUM} routes, 0.0 % (0.0 to 9.5)" in same.facts["decided"]


def test_routes_whose_end_or_way_b_closes_have_no_way_there(maps):
    ds = maps[0].ds.copy(deep=True)
    ds["obstacle"].values[0, 30:] = 1  # the north at 20 m
    b = ju.MetricMaps(ds)
    found = ju.studies.compare(maps[0], b, routes=12, progress=False)
    is_inside = found.routes[["start_y_m", "goal_y_m"]].max(axis=1) > maps[0].grid.y_m[29] + 5
    is_lost = is_inside & (found.routes.altitude_m == 20)
    assert (found.routes.best_there.isna() >= is_lost).all()
    (verdict,) = (each for each in found.decided.verdicts if each.kind.name == "ROUTES")
    assert verdict.facts["lost"] == found.routes.best_there.isna().sum() >= is_lost.sum() > 0
    assert verdict.facts["closed"] >= verdict.facts["lost"]


@pytest.mark.slow
def test_the_same_seed_draws_the_same_pairs_and_no_map_has_regrets_under_itself(maps, found):
    again = ju.studies.compare(*maps, routes=NUM, seed=3, progress=False)
    pd.testing.assert_frame_equal(again.routes, found.routes)
    same = ju.studies.compare(maps[0], maps[0], routes=NUM, progress=False)
    assert same.routes[["is_closed", "regret", "apart_m"]].max().max() < 1e-9
    assert not same.routes[["start_x_m", "goal_x_m"]].equals(
        found.routes[["start_x_m", "goal_x_m"]]
    )


@pytest.mark.slow
def test_the_command_reports_routes_and_writes_every_route(maps, tmp_path, capsys):
    folders = [made.save(tmp_path / name) for made, name in zip(maps, "ab", strict=True)]
    code, out, _ = run(
        capsys, "compare", *folders, "-o", tmp_path / "out", "--routes", 12, "--seed", 3, "--json"
    )
    assert code == 0
    again = run(capsys, "compare", *folders, "-o", tmp_path / "out", "--routes", 11, "--seed", 3)
    assert again[0] == 2
    assert_one_sentence(again[2].splitlines()[-1], "its routes is 12, now 11")
    assert len(json.loads(out)["routes"]) == 2 * 12
    assert len(pd.read_csv(tmp_path / "out/tables/routes.csv")) == 2 * 12
    report = (tmp_path / "out/report.md").read_text()
    assert (
        "| altitude_m | routes | changed | closed | regret % | median % | length_m | no_fix_m | no_fix_there_m | "
        "apart_m |" in report
    )


def test_the_report_has_the_regret_of_each_altitude_and_the_rules_of_the_routes(found):
    table = found.report.fields["tables"]["routes"].set_index("altitude_m")
    for z_m, each in found.routes.groupby("altitude_m"):
        row = table.loc[z_m]
        assert row["regret %"] == pytest.approx(100 * each.regret.mean())
        assert row["median %"] == pytest.approx(100 * each.regret.median())
        assert 0 <= row["regret %_low"] <= row["regret %"] <= row["regret %_high"]
    rules = "cost model: line"
    assert f"those of A's scenario ({rules}" in found.report.text
    assert "weights: distance 0.1, gps 1, lidar 1, population 1, risk 1" in found.report.text
