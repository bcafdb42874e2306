"""Tables of a study on rows made up so that every number can be worked out by hand; GPS and lidar on made maps."""

import numpy as np
import pandas as pd
import pytest

from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.trial import row_columns
from tests.made_maps import made_maps

CHEAP, DEAR, LINE = "astar-plus", "bitstar-dist", "ptp"


def row(instance: int, planner: str, cost: float | None, *, objective="weighted", status="", **facts) -> dict:
    told = {"status": status or ("feasible" if cost else "blocked"), "cost": cost, "elapsed_s": 0.1, "length_m": 100.0}
    told |= {"planner": planner, "objective": objective, "m_gps": 0.5, "m_risk": 0.5, "num_expanded": 1}
    return dict.fromkeys(row_columns()) | {"altitude_m": 20.0, "instance": instance} | told | facts


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    rows = []
    for k in range(10):
        rows += [row(k, CHEAP, 10.0, status="optimal", elapsed_s=1.0), row(k, DEAR, 12.0 if k else None)]
        rows += [row(k, LINE, 10.2 if k < 4 else None, elapsed_s=0.001)]
        rows += [row(k, CHEAP, 15.0, objective="distance", length_m=80.0, m_gps=0.25)]
    rows += [row(10, name, None, status="no-path") for name in (CHEAP, DEAR, LINE)]
    rows += [row(11, CHEAP, None, status="crashed"), row(11, DEAR, 7.0), row(11, LINE, None)]
    instances = pd.DataFrame({"instance": range(12), "altitude_m": 20.0, "range": ["short"] * 6 + ["long"] * 6})
    return analysis.joined(pd.DataFrame(rows), instances)


def test_a_pair_is_joined_unless_no_path_was_proven_and_ratios_are_to_the_cheapest_of_any_planner(table):
    assert set(table[~table.is_joined].instance) == {10}
    first = table[(table.instance == 1) & (table.objective == "weighted")].set_index("planner").ratio
    assert first.to_dict() == pytest.approx({CHEAP: 1.0, DEAR: 1.2, LINE: 1.02})
    assert table[table.status == "blocked"].ratio.isna().all()


def test_a_path_that_costs_nothing_is_the_best():
    rows = pd.DataFrame([row(0, CHEAP, 0.0, status="optimal"), row(0, DEAR, 1.0)])
    instances = pd.DataFrame({"instance": [0], "altitude_m": 20.0})
    found = analysis.joined(rows, instances)
    assert found.ratio[0] == 1.0
    assert np.isnan(found.ratio[1])
    assert (found.range == "any").all()


def test_success_counts_paths_pairs_and_crashes(table):
    found = analysis.success(table).set_index(["planner", "range"])
    cheap = found.loc[(CHEAP, "long")]
    assert (cheap.pairs, cheap.paths, cheap.joined, cheap.crashed) == (6, 4, 5, 1)
    assert cheap.share_joined == pytest.approx(4 / 5)
    assert cheap.proven == pytest.approx(4 / 6)
    assert found.loc[(LINE, "short")].share == pytest.approx(4 / 6)


def test_costs_and_times_are_by_planner_and_altitude(table):
    cost = analysis.costs(table).set_index("planner")
    assert cost.loc[DEAR, "median"] == pytest.approx(1.2)
    assert cost.loc[DEAR, "best_share"] == pytest.approx(1 / 10)  # where it alone found a path
    assert cost.loc[LINE, "best_share"] == 0
    time = analysis.times(table).set_index("planner")
    assert time.loc[CHEAP, "runs"] == 12
    assert time.loc[LINE, "p95_s"] == pytest.approx(0.1, rel=0.5)


def test_pairs_of_planners_are_compared_where_both_found_a_path(table):
    found = analysis.paired(table).set_index(["first", "second"])
    one = found.loc[(CHEAP, DEAR)]
    assert (one.both, one.only_first, one.only_second) == (9, 1, 1)
    assert one.cost_ratio == pytest.approx(10 / 12)
    assert one.low == one.high == pytest.approx(10 / 12)  # every pair says the same
    assert one.first_cheaper == 1
    assert one.time_ratio == pytest.approx(10)


def test_shortest_paths_are_set_against_the_cheapest(table):
    (found,) = analysis.objectives(table).to_dict("records")
    assert (found["planner"], found["pairs"]) == (CHEAP, 10)
    assert found["cost_ratio"] == pytest.approx(1.5)
    assert found["length_ratio"] == pytest.approx(0.8)
    assert found["m_gps_change"] == pytest.approx(-0.25)
    assert "m_lidar_change" not in found


def test_metrics_are_compared_on_what_all_frequent_planners_solved(table):
    found = analysis.usage(table)
    assert LINE not in set(found.planner)  # answers 4 of 11
    assert set(found.instances) == {9}
    by = found.set_index(["planner", "objective"]).m_gps
    assert by[CHEAP, "distance"] == 0.25
    assert by[CHEAP, "weighted"] == 0.5


def test_the_planner_to_choose_answers_reliably_and_costs_least(table):
    found = analysis.choices(table).set_index("range")
    assert found.index.tolist() == ["short", "long"]
    short = found.loc["short"]
    assert (short.reliable, short.cheapest, short.fastest_near_best) == (CHEAP, CHEAP, CHEAP)
    assert short.straight_enough == pytest.approx(4 / 6)
    long = found.loc["long"]
    assert (long.joined_pairs, long.reliable, long.cheapest, long.fastest_near_best) == (5, DEAR, DEAR, "none")


def test_complementarity_is_numpys_over_the_free_cells_of_the_altitudes_that_are_chosen():
    maps = made_maps(300, 240)
    assert analysis.complementarity(maps, altitudes_m=[60]).altitude_m.tolist() == [60.0]
    for row in analysis.complementarity(maps).itertuples():
        is_free = maps.is_free(row.altitude_m, "centre")
        gps, lidar = (maps.m(name, row.altitude_m)[is_free].astype(float) for name in ("gps", "lidar"))
        assert row.gps == pytest.approx(gps.mean())
        assert row.correlation == pytest.approx(np.corrcoef(gps, lidar)[0, 1])
        assert row.correlation_low <= row.correlation <= row.correlation_high
        assert row.lidar_where_gps_poor == pytest.approx(lidar[gps < 0.5].mean())
        assert row.lidar_where_gps_good == pytest.approx(lidar[gps >= 0.5].mean())
        assert row.either_serves == pytest.approx(((gps >= 0.5) | (lidar >= 0.5)).mean())


def test_a_few_tiles_give_no_interval_and_a_sky_without_buildings_no_correlation():
    maps = made_maps(100, 90)
    few = analysis.complementarity(maps)
    assert few.correlation.notna().all()
    assert few.correlation_low.isna().all()
    maps.ds["gps"][:] = 0.95
    maps.ds["lidar"][:] = 0.0
    assert analysis.complementarity(maps)[["correlation", "lidar_where_gps_poor"]].isna().all(axis=None)
