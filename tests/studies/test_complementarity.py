"""Complementarity of GPS and lidar, on maps made so that the answer is known."""

import numpy as np
import pytest

from jaxurban.studies.montecarlo.complementarity import complementarity, findings, verdict
from tests.made_maps import made_maps


@pytest.fixture
def maps():
    """Maps where GPS is poor in the west, lidar good there; higher up less of both."""
    made = made_maps(300, 240)
    rng = np.random.default_rng(5)
    for level, share in enumerate((0.5, 0.2)):
        is_west = np.arange(240) < share * 240
        shape = (300, 240)
        made.ds["gps"][0, level] = np.where(is_west, 0.3, 0.9) + rng.uniform(-0.1, 0.1, shape)
        made.ds["lidar"][level] = np.where(is_west, 0.8, 0.1 - 0.05 * level) + rng.uniform(0, 0.05, shape)
    return made


def test_numbers_are_those_of_numpy_over_the_free_cells(maps):
    found = complementarity(maps).set_index("altitude_m")
    for altitude_m in maps.altitudes_m:
        is_free = maps.is_free(altitude_m, "centre")
        gps, lidar = (maps.m(name, altitude_m)[is_free].astype(float) for name in ("gps", "lidar"))
        row = found.loc[altitude_m]
        assert row.gps == pytest.approx(gps.mean())
        assert row.correlation == pytest.approx(np.corrcoef(gps, lidar)[0, 1])
        assert row.correlation_low <= row.correlation <= row.correlation_high
        assert row.lidar_where_gps_poor == pytest.approx(lidar[gps < 0.5].mean())
        assert row.difference == pytest.approx(lidar[gps < 0.5].mean() - lidar[gps >= 0.5].mean())
        assert row.either_serves == pytest.approx(((gps >= 0.5) | (lidar >= 0.5)).mean())


def test_maps_made_to_complement_each_other_hold_the_finding(maps):
    table = complementarity(maps)
    rises, coexists, falls = findings(table)
    assert rises.holds
    assert coexists.holds
    step = table.step.iloc[1]
    assert step == pytest.approx(table.correlation.iloc[1] - table.correlation.iloc[0])
    assert table.step_low.iloc[1] <= step <= table.step_high.iloc[1]
    # The third claim needs every step's interval on one side of 0.
    assert falls.holds is (True if table.step_high.iloc[1] < 0 else False if table.step_low.iloc[1] > 0 else None)
    in_part = "complement each other is borne out in part only:"
    assert ("complement each other holds:" if falls.holds else in_part) in verdict(table)


def test_one_claim_of_three_is_not_called_the_finding(maps):
    maps.ds["lidar"][:] = maps.ds["lidar"].values * 0.5  # GPS gets better and lidar worse, and lidar is never good
    table = complementarity(maps)
    held = [each.holds for each in findings(table)]
    assert 0 < held.count(True) < 3
    assert "holds:" not in verdict(table)
    assert f"in part only: of its three claims {held.count(True)} hold" in verdict(table)


def test_maps_made_to_agree_refute_it(maps):
    maps.ds["lidar"][:] = maps.ds["gps"][0].values
    table = complementarity(maps)
    assert [each.holds for each in findings(table)] == [False, False, None]
    assert "is not borne out as far as these maps can tell" in verdict(table)


def test_a_correlation_that_rises_refutes_the_third_claim(maps):
    rng = np.random.default_rng(2)
    maps.ds["lidar"][1] = np.clip(maps.ds["gps"][0, 1].values - 0.2 + rng.uniform(0, 0.05, (300, 240)), 0, 1)
    table = complementarity(maps)
    assert findings(table)[2].holds is False
    assert table.step_low.iloc[1] > 0


def test_lidar_that_is_better_but_not_good_does_not_fill_the_gap(maps):
    maps.ds["lidar"][:] = maps.ds["lidar"].values * 0.5  # 0.4 where GPS is poor, 0.05 elsewhere
    table = complementarity(maps)
    assert (table.difference_low > 0).all()
    assert findings(table)[1].holds is False


def test_altitudes_can_be_chosen(maps):
    assert complementarity(maps, altitudes_m=[60]).altitude_m.tolist() == [60.0]


def test_a_few_tiles_give_no_interval_and_no_verdict():
    table = complementarity(made_maps(100, 90))
    assert table.correlation.notna().all()
    assert table.correlation_low.isna().all()
    assert findings(table)[2].holds is None


def test_nothing_is_said_of_a_sky_without_buildings(maps):
    maps.ds["gps"][:] = 0.95
    maps.ds["lidar"][:] = 0.0
    table = complementarity(maps)
    assert table.correlation.isna().all()
    assert table.lidar_where_gps_poor.isna().all()
    assert [each.holds for each in findings(table)[1:]] == [None, None]


def test_an_altitude_without_an_interval_is_passed_over(maps):
    table = complementarity(maps)
    table.loc[1, ["difference_low", "difference_high"]] = np.nan
    assert findings(table)[1].holds
    table.loc[0, "difference_low"] = -0.1
    assert findings(table)[1].holds is None
