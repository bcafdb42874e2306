"""A vehicle: what of it is enforced, what it is told by, and where its speed and power go."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.scenario import Scenario
from tests.made_maps import made_maps
from tests.paths.volumes import plan_volume

ALTITUDE_M = 20.0
REGION = {"region": {"bounds": (-74.02, 40.70, -73.98, 40.73)}, "buildings": {"source": "synthetic"}}


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    return {"start_xy_m": maps.grid.xy_of_cell(*free[500]), "goal_xy_m": maps.grid.xy_of_cell(*free[-500])}


def of(**vehicle: float) -> ju.Constraints:
    return ju.Constraints(vehicle=ju.Vehicle(**vehicle))


def test_its_radius_is_kept_beside_the_clearance(maps):
    both = ju.Constraints(clearance_m=8.0, vehicle=ju.Vehicle(radius_m=4.0))
    assert np.array_equal(both.closed(maps, ALTITUDE_M), ju.Constraints(clearance_m=12.0).closed(maps, ALTITUDE_M))
    kept_m = both.leg_margin_m(10.0), ju.Constraints(clearance_m=8.0).leg_margin_m(10.0)  # both close the cells beside
    assert kept_m == pytest.approx((2.05, 0.0))
    assert str(both) == "clearance of 8 m, vehicle's radius of 4 m, vertical clearance of 3 m"


def test_its_speed_and_power_are_those_of_report_and_mission_unless_others_are_given(maps, ends, tmp_path):
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=of(speed_m_s=8.0, power_w=180.0))
    totals = ju.explain(path, maps).totals
    assert totals["time_s"] == pytest.approx(path.length_m / 8.0)
    assert totals["energy_wh"] == pytest.approx(path.length_m / 8.0 * 180.0 / 3600)
    assert ju.explain(path, maps, speed_m_s=4.0).totals["time_s"] == pytest.approx(path.length_m / 4.0)
    mission = json.loads(path.save(tmp_path / "route.plan").read_text())["mission"]
    assert mission["cruiseSpeed"] == 8.0
    plain = ju.plan(maps, **ends, altitude_m=ALTITUDE_M)
    assert np.array_equal(plain.xy_m, path.xy_m)  # they close nothing
    assert "time_s" not in ju.explain(plain, maps).totals


def test_climbs_and_descents_that_are_too_steep_are_told_and_take_their_time(maps, ends):
    limits = {"speed_m_s": 10.0, "max_climb_m_s": 2.0, "max_descent_m_s": 1.0}
    climb = {"start_altitude_m": 20.0, "goal_altitude_m": 60.0, "constraints": of(**limits)}
    up = plan_volume(maps, **ends, **climb)
    moved = np.diff(np.column_stack([up.xy_m, up.z_m]), axis=0)
    air_m = np.linalg.norm(moved, axis=1)
    (said,) = (each for each in ju.cautions(up, maps) if each.startswith("Vehicle"))
    num = int((10.0 * moved[:, 2] / air_m > 2.0).sum())
    assert said.startswith(f"Vehicle: legs that would need more than 2 m/s of climb at 10 m/s: {num};")
    at_least_s = np.maximum.reduce([air_m / 10.0, moved[:, 2] / 2.0, -moved[:, 2] / 1.0])
    report = ju.explain(up, maps)
    assert report.totals["time_s"] == pytest.approx(at_least_s.sum(), rel=1e-9)
    assert report.segments["time_s"].sum() == pytest.approx(report.totals["time_s"], rel=1e-9)
    turned = {"start_xy_m": ends["goal_xy_m"], "goal_xy_m": ends["start_xy_m"]}
    down = plan_volume(maps, **turned, start_altitude_m=60.0, goal_altitude_m=20.0, constraints=of(**limits))
    (said,) = (each for each in ju.cautions(down, maps) if each.startswith("Vehicle"))
    assert "more than 1 m/s of descent" in said
    gentle = climb | {"constraints": of(**limits | {"max_climb_m_s": 10.0})}
    assert not [each for each in ju.cautions(plan_volume(maps, **ends, **gentle), maps) if "climb" in each]


def test_turns_that_are_too_sharp_are_counted_by_heading(maps, ends):
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=of(max_turn_deg=60.0))
    grid = maps.grid
    headings_deg = np.radians([0.0, 0.0, 59.0, 120.0, 185.0, -175.0])  # 0, 59, 61, 65 and 0 degrees (mod 360) of turn
    steps = 10.0 * np.column_stack([np.cos(headings_deg), np.sin(headings_deg)])
    xy_m = np.cumsum([(grid.x_m[50], grid.y_m[40]), *steps], axis=0)
    bent = replace(path, xy_m=xy_m, z_m=np.full(len(xy_m), ALTITUDE_M))
    (said,) = (each for each in ju.cautions(bent, maps) if each.startswith("Vehicle"))
    assert said == ("Vehicle: turns sharper than 60 degrees: 2; the sharpest, of 65 degrees, is 40 m along the route.")
    straight = replace(bent, xy_m=xy_m[:3], z_m=bent.z_m[:3])
    assert not [each for each in ju.cautions(straight, maps) if each.startswith("Vehicle")]


def test_a_scenario_says_it_in_one_table_and_writes_it_back():
    table = {"radius_m": 0.4, "max_climb_m_s": 3, "speed_m_s": 10, "power_w": 180.0}
    scenario = Scenario.from_dict(REGION | {"vehicle": table})
    assert scenario.vehicle == ju.Vehicle(**table)
    assert "max_turn_deg" not in scenario.to_toml()
    with pytest.raises(InputError, match="radius_m"):
        Scenario.from_dict(REGION | {"vehicle": {"radius_cm": 40}})
    with pytest.raises(InputError, match=r"vehicle.*max_climb_m_s must be a positive number"):
        Scenario.from_dict(REGION | {"vehicle": {"max_climb_m_s": 0}})


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"radius_m": -0.1}, "radius_m must be 0 or a positive number of metres"),
        ({"speed_m_s": 0.0}, "speed_m_s must be a positive number of metres per second"),
        ({"max_turn_deg": 181.0}, "max_turn_deg must be at most 180 degrees"),
        ({"power_w": 100.0}, "give the speed"),
        ({"max_descent_m_s": "slow"}, "max_descent_m_s must be a number or None"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        ju.Vehicle(**wrong)
    assert asdict(ju.Vehicle())["radius_m"] == 0
