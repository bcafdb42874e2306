"""Planning between levels: which they are, what climbs cost, files with altitudes."""

import json

import numpy as np
import pytest
import shapely

import jaxurban as ju
from benchmarks.random_routes import READERS
from jaxurban.io.zone import Zone
from jaxurban.planners.base import Status
from jaxurban.typing import PlannedPath
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.volumes import WEIGHTS, ends_at, options_of, plan_volume


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return ju.build_maps(
        ju.demo_city(1_000, 1_000), resolution_m=20.0, altitudes_m=(20.0, 60.0, 100.0)
    )


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    return ends_at(maps, *np.argwhere(ju.Constraints().is_free(maps, 20.0))[[3, -3]])


def test_levels_are_the_altitudes_within_the_bounds_and_steps_between():
    held = (60.0, 20.0, 122.0)
    np.testing.assert_array_equal(ju.Levels().of(held), [20, 60, 122])
    np.testing.assert_array_equal(ju.Levels(30.0, 122.0).of(held), [60, 122])
    np.testing.assert_array_equal(ju.Levels(30.0, 110.0, 25.0).of(held), [30, 55, 60, 80, 105, 110])
    np.testing.assert_array_equal(ju.Levels(10.0, 70.0, 10.0).of(held), [20, 30, 40, 50, 60, 70])
    np.testing.assert_array_equal(ju.Levels(50.0, 50.0, 10.0).of(held), [50])


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_single_altitude_equals_2d(maps, cost_model):
    settings = {"weights": WEIGHTS, "cost_model": cost_model, "time_of_day": "night"}
    flat, volume = (
        ju.cost_map(maps, at, **settings) for at in (20.0, ju.Levels(max_altitude_m=20.0))
    )
    for pair in np.random.default_rng(0).choice(np.argwhere(flat.is_free), (25, 2)):
        places = [ju.XY(*maps.grid.xy_of_cell(*cell)) for cell in pair]
        expected, path = flat.plan(*places), volume.plan(*places)
        assert path.cost == pytest.approx(expected.cost, rel=1e-9)
        assert path.status is expected.status
        assert set(path.z_m) <= {20.0}


def test_the_volume_is_never_dearer_than_any_of_its_levels_and_keeps_its_bounds(maps, ends):
    settings = {"weights": WEIGHTS, "cost_model": "line"}
    free, dear = (
        plan_volume(maps, **ends, level_step_m=10.0, climb_cost=c, **settings)
        for c in (0.01, 100.0)
    )
    low = ju.plan(maps, **ends, altitude_m=20.0, **settings)
    assert free.cost <= low.cost * (1 + 1e-12)
    assert dear.cost == pytest.approx(low.cost, rel=1e-9)
    assert free.cost_by_layer["climb"] == pytest.approx(
        0.01 * np.maximum(np.diff(free.z_m), 0).sum()
    )
    bounds = {
        "min_altitude_m": 30.0,
        "max_altitude_m": 70.0,
        "level_step_m": 8.0,
        "climb_cost": 0.0,
    }
    path = plan_volume(maps, **ends, **bounds, weights=WEIGHTS)
    assert path.z_m[0] == path.z_m.min() == 30.0
    assert path.z_m.max() <= 70.0


def test_a_metre_of_climb_costs_a_metre_of_flight_unless_told_otherwise_and_the_shortest_path_leaves_it_out(
    maps, ends
):
    path = plan_volume(maps, **ends, goal_altitude_m=60.0, max_altitude_m=60.0, weights=WEIGHTS)
    assert path.cost_by_layer["climb"] == pytest.approx(
        0.2 * np.maximum(np.diff(path.z_m), 0).sum()
    )
    assert path.cost_by_layer["descent"] == 0.0
    shortest = plan_volume(maps, **ends, objective="distance", climb_cost=1000.0)
    assert shortest.search.cost == pytest.approx(shortest.length_m)
    assert (
        shortest.length_m <= ju.plan(maps, **ends, altitude_m=20.0, objective="distance").length_m
    )
    assert shortest.cost == pytest.approx(sum(shortest.cost_by_layer.values()))
    free = dict.fromkeys(WEIGHTS.to_dict(), 0.0)
    climbs = plan_volume(maps, weights=free, climb_cost=5.0, **ends, goal_altitude_m=60.0)
    assert climbs.cost == 5.0 * 40.0  # climbing alone can be what costs


def test_start_left_on_a_roof_begins_at_the_lowest_free_level_over_it(maps, ends):
    cell = np.argwhere(~maps.is_free(20.0) & maps.is_free(60.0))[0]
    there = ends | {"start": ju.XY(*maps.grid.xy_of_cell(*cell))}
    assert plan_volume(maps, **there).z_m[0] == 60.0
    with pytest.raises(ju.InputError, match=r"at 20 m; the lowest free level there is 60 m"):
        plan_volume(maps, **there, start_altitude_m=20.0)
    with pytest.raises(
        ju.InputError, match=r"every level from 20 to 20 m; the lowest free altitude there is 60 m"
    ):
        plan_volume(maps, **there, max_altitude_m=20.0)
    moved = plan_volume(maps, **there, max_altitude_m=20.0, snap=True)
    assert moved.z_m[0] == 20.0
    assert moved.snap_distance_m[0] >= 20.0


def test_start_under_the_goal_goes_straight_up_and_is_written(maps, ends, tmp_path):
    here = ends | {"goal": ends["start"]}
    up = plan_volume(maps, **here, goal_altitude_m=60.0, objective="distance")
    assert up.length_m == pytest.approx(40.0)
    for suffix, read in READERS.items():
        assert (
            read(up.save(tmp_path / f"up{suffix}"))[:, 2].tolist()
            == up.z_m.tolist()
            == [20.0, 60.0]
        )


def test_files_hold_every_points_altitude(maps, ends, tmp_path):
    path = plan_volume(
        maps, **ends, goal_altitude_m=60.0, level_step_m=10.0, climb_cost=0.01, weights=WEIGHTS
    )
    assert len(np.unique(path.z_m)) > 2
    lonlatz = np.column_stack([path.lonlat, path.z_m])
    for suffix in (".geojson", ".kml"):
        found = READERS[suffix](path.save(tmp_path / f"path{suffix}"))
        assert np.all(np.abs(found - lonlatz) <= (1e-7, 1e-7, 0.005))


def test_the_command_line_plans_through_the_volume(maps, ends, tmp_path, capsys):
    maps.save(tmp_path)
    options = ("--volume", "max_altitude_m=60,level_step_m=10,climb_cost=0.01", "--json")
    code, out, _ = run(capsys, "plan", tmp_path, *options_of(maps, **ends), *options)
    facts = json.loads(out)
    assert (code, facts["planner"], facts["z_m"][0], facts["z_m"][-1]) == (
        0,
        "astar-volume",
        20.0,
        20.0,
    )
    assert len(facts["z_m"]) == len(facts["lonlat"])
    assert (facts["settings"]["levels_m"], facts["settings"]["climb_cost"]) == (
        [20, 30, 40, 50, 60],
        0.01,
    )


def test_a_volume_flies_over_a_zone_with_a_ceiling_and_around_one_without():
    maps = made_maps(altitudes_m=(20.0, 60.0, 90.0))
    (low_x, low_y), (high_x, high_y) = (maps.grid.xy_of_cell(*cell) for cell in ((0, 45), (79, 50)))
    wall = shapely.box(low_x, low_y - 100, high_x, high_y + 100)
    free = np.argwhere(maps.is_free(20.0))
    ends = ends_at(maps, *(free[free[:, 1] == col][0] for col in (5, 95)))

    def planned(ceiling_m: float, **changed) -> PlannedPath:
        constraints = ju.Constraints((Zone("wall", wall, maps.grid.crs, 0.0, ceiling_m, "made"),))
        given = ends | {"start_altitude_m": 20.0, "goal_altitude_m": 20.0} | changed
        return plan_volume(maps, constraints=constraints, **given)

    over = planned(70.0)
    above = (over.xy_m[:, 0] > low_x) & (over.xy_m[:, 0] < high_x)
    assert above.any()
    assert np.all(over.z_m[above] == 90.0)
    around = planned(np.inf)
    assert around.status is Status.NO_PATH
    assert (
        "Constraints were on (1 no-fly zone, vertical clearance of 3 m): they close"
        in around.to_dict()["message"]
    )
    with pytest.raises(
        ju.InputError, match=r"closed by the no-fly zone 'wall'.*lowest free level there is 90 m"
    ):
        planned(70.0, start=ju.XY(*maps.grid.xy_of_cell(40, 47)), start_altitude_m=60.0)
