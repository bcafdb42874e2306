"""Routes of one map under another: against sums by hand, and against what was built into the maps."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.studies.map_comparison import MapVerdict
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
        "| altitude_m | routes | changed | closed | regret % | median % | length_m | apart_m |"
        in report
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


@pytest.mark.slow
def test_what_is_flown_is_summed_by_hand_beside_the_shortest_route(maps, found):
    """A route's exposure is its cost without its length's; metres without a fix are those in cells of infinite HDOP."""
    here, there = maps
    for row in found.routes[found.routes.altitude_m == 20].head(12).itertuples():
        path = ju.cost_map(here, 20.0).plan(*ends(row))
        short = ju.cost_map(here, 20.0, objective="distance").plan(*ends(row))
        assert row.exposure == pytest.approx(row.cost - 0.1 * row.length_m, rel=1e-9)
        assert row.shortest_length_m == pytest.approx(short.length_m, rel=1e-9)
        assert row.shortest_length_m <= row.length_m + 1e-6
        assert row.shortest_exposure >= row.exposure - 1e-6
        assert row.shortest_cost >= row.cost - 1e-6
        for maps_of, route, no_fix_m in (
            (here, path, row.no_fix_m),
            (there, path, row.there_no_fix_m),
            (here, short, row.shortest_no_fix_m),
        ):
            cut = crossed_cells(route.search.points_m, maps_of.grid.resolution_m)
            lost = ~np.isfinite(maps_of.m("hdop", 20.0)[cut.row, cut.col])
            if not np.isnan(no_fix_m):
                assert no_fix_m == pytest.approx(cut.length_m @ lost, abs=1e-6)
    (verdict,) = (each for each in found.decided.verdicts if each.kind.name.startswith("LESS"))
    less = 100 * (1 - found.routes.exposure / found.routes.shortest_exposure)
    assert verdict.size == pytest.approx(less.mean())
    assert verdict.low <= verdict.size <= verdict.high
    more_m = (found.routes.length_m - found.routes.shortest_length_m).mean()
    assert f"{more_m:.1f} m of way" in verdict.sentence
    assert verdict.sentence in found.report.text
    assert "| 20 | distance alone | A | A |" in found.report.text


@pytest.mark.slow
def test_a_folder_of_other_weights_is_refused_by_the_weights_that_differ(maps, found, tmp_path):
    found.save(tmp_path)
    weights = ju.Weights(gps=2.0, risk=0.5).to_dict()
    other = maps[0].with_recorded(maps[0].recorded | {"weights": weights})
    again = ju.studies.compare(other, maps[1], routes=NUM, seed=3, progress=False)
    with pytest.raises(ju.InputError) as refused:
        again.save(tmp_path)
    assert "(its weights.gps is 1.0, now 2.0; its weights.risk is 1.0, now 0.5)" in str(
        refused.value
    )


def test_a_table_of_routes_gives_the_same_pairs_and_wider_maps_come_next_with_it(maps, found):
    routes = found.routes.drop(columns=["pair", "status"])
    again = ju.studies.compare(*maps, routes=routes, progress=False)
    pd.testing.assert_frame_equal(
        again.routes.drop(columns="pair"), found.routes.drop(columns="pair")
    )
    pairs = [each.routes.pair.drop_duplicates().tolist() for each in (again, found)]
    assert pairs[0] == list(range(NUM))
    assert len(pairs[1]) == NUM
    pinned = found.routes.assign(at_edge=1.0, regret=0.0, is_changed=0.0)
    named = replace(found, names=("a", "b"), routes=pinned, routes_file="out/tables/routes.csv")
    assert named.decided.next_command.endswith(
        " --resolution 10 --routes out/tables/routes.csv -o b_wider_routes"
    )
    unwritten = replace(named, routes_file="")
    assert f" --routes {NUM} -o b_wider_routes" in unwritten.decided.next_command
    inside = replace(named, routes=pinned.assign(at_edge=0.0))
    assert MapVerdict.ONE_TIME in [each.kind for each in inside.decided.verdicts]
    assert "--set 'gps.times=[\"" in inside.decided.next_command
    assert inside.decided.next_command.endswith(" -o b_times_routes")
    with pytest.raises(ju.InputError, match="altitude"):
        ju.studies.compare(*maps, routes=routes.drop(columns="altitude_m"), progress=False)
    with pytest.raises(ju.InputError, match="lack the columns start_lon"):
        ju.studies.compare(*maps, routes=routes[["altitude_m"]], progress=False)
