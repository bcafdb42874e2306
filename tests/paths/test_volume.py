"""plan_volume: levels over metric maps, costs that anyone can recompute, files with altitudes."""

import itertools
import json
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import psutil
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.zone import Zone
from jaxurban.maps.levels import Levels
from jaxurban.paths.export.write import write_path
from jaxurban.planners.base import Status
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps
from tests.paths.volumes import plan_volume

ALTITUDES_M = (20.0, 60.0, 100.0)
WEIGHTS = ju.Weights(distance=0.2, gps=0.5, lidar=2.0, population=3.0, risk=1.5)


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return ju.build_maps(ju.demo_city(1_000, 1_000), resolution_m=20.0, altitudes_m=ALTITUDES_M)


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    free = np.argwhere(ju.Constraints().is_free(maps, 20.0))
    return {"start_xy_m": centre(maps, free[3]), "goal_xy_m": centre(maps, free[-3])}


@pytest.fixture(scope="module")
def path(maps, ends) -> ju.PlannedPath:
    """A path that climbs and descends."""
    path = plan_volume(maps, **ends, goal_altitude_m=60.0, level_step_m=10.0, climb_cost=0.01, weights=WEIGHTS)
    assert len(np.unique(path.z_m)) > 2
    return path


def centre(maps, cell) -> tuple[float, float]:
    return float(maps.grid.x_m[cell[1]]), float(maps.grid.y_m[cell[0]])


def cells_of(maps, path):
    return maps.grid.cell_of_xy(path.xy_m[:, 0], path.xy_m[:, 1])


def test_levels_are_the_altitudes_within_the_bounds_and_steps_between():
    held = (60.0, 20.0, 122.0)
    np.testing.assert_array_equal(Levels().of(held), [20, 60, 122])
    np.testing.assert_array_equal(Levels(30.0, 122.0).of(held), [60, 122])
    np.testing.assert_array_equal(Levels(30.0, 110.0, 25.0).of(held), [30, 55, 60, 80, 105, 110])
    np.testing.assert_array_equal(Levels(10.0, 70.0, 10.0).of(held), [20, 30, 40, 50, 60, 70])
    np.testing.assert_array_equal(Levels(50.0, 50.0, 10.0).of(held), [50])


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_single_altitude_equals_2d(maps, cost_model):
    rng = np.random.default_rng(0)
    settings = {"weights": WEIGHTS, "cost_model": cost_model, "time_of_day": "night"}
    flat = ju.cost_map(maps, 20.0, **settings)
    free = np.argwhere(flat.is_free)
    volume = ju.cost_map(maps, Levels(max_altitude_m=20.0), **settings)
    for _ in range(25):
        start, goal = (centre(maps, free[k]) for k in rng.choice(len(free), 2))
        expected = flat.plan(ju.XY(*start), ju.XY(*goal))
        path = volume.plan(ju.XY(*start), ju.XY(*goal))
        assert path.cost == pytest.approx(expected.cost, rel=1e-9)
        assert path.status is expected.status
        if expected.status.has_path:
            assert set(path.cost_by_layer) == set(expected.cost_by_layer) | {"climb", "descent"}
        assert set(path.z_m) <= {20.0}


def test_cell_cost_is_the_sum_over_the_nodes_entered(maps, ends):
    path = plan_volume(
        maps,
        **ends,
        goal_altitude_m=100.0,
        climb_cost=0.3,
        descent_cost=0.1,
        weights=WEIGHTS,
        cost_model="cell",
        time_of_day="night",
    )
    rows, cols = cells_of(maps, path)
    rise_m = np.diff(path.z_m)
    length_m = np.linalg.norm(np.diff(np.column_stack([path.xy_m, path.z_m]), axis=0), axis=1).sum()
    by_hand = 0.2 * length_m + 0.3 * rise_m[rise_m > 0].sum() - 0.1 * rise_m[rise_m < 0].sum()
    for z_m, row, col in zip(path.z_m[1:], rows[1:], cols[1:], strict=True):
        for name, cost in maps.costs(z_m, time_of_day="night").items():
            by_hand += getattr(WEIGHTS, name) * float(cost[row, col])
    assert path.status is Status.OPTIMAL
    assert path.cost == pytest.approx(by_hand, rel=1e-9)
    assert path.search.cost == pytest.approx(by_hand, rel=1e-9)
    assert sum(path.cost_by_layer.values()) == pytest.approx(path.cost)
    assert path.length_m == pytest.approx(length_m)
    assert (path.z_m[0], path.z_m[-1], path.altitude_m) == (20.0, 100.0, 20.0)


def test_the_volume_is_never_dearer_than_any_of_its_levels(maps, ends):
    settings = {"weights": WEIGHTS, "cost_model": "line"}
    free = plan_volume(maps, **ends, level_step_m=10.0, climb_cost=0.01, **settings)
    low = ju.plan(maps, **ends, altitude_m=20.0, **settings)
    dear = plan_volume(maps, **ends, level_step_m=10.0, climb_cost=100.0, **settings)
    assert free.cost <= low.cost * (1 + 1e-12)
    assert dear.cost == pytest.approx(low.cost, rel=1e-9)
    assert free.cost_by_layer["climb"] == pytest.approx(0.01 * np.maximum(np.diff(free.z_m), 0).sum())


def test_paths_keep_their_bounds_and_fly_above_every_roof(maps, ends):
    path = plan_volume(
        maps, **ends, min_altitude_m=30.0, max_altitude_m=70.0, level_step_m=8.0, climb_cost=0.0, weights=WEIGHTS
    )
    assert path.z_m.min() >= 30.0
    assert path.z_m.max() <= 70.0
    assert path.z_m[0] == 30.0
    # Over the cells of both ends of a step, and the cells beside a diagonal one, the lower end is above the roof.
    rows, cols = cells_of(maps, path)
    low_m = np.minimum(path.z_m[:-1], path.z_m[1:])
    roof_m = maps.m("roof_touched")
    for row, col in ((rows[:-1], cols[:-1]), (rows[1:], cols[1:]), (rows[:-1], cols[1:]), (rows[1:], cols[:-1])):
        assert np.all(roof_m[row, col] < low_m)


def test_metrics_between_altitudes_run_linearly_but_not_out_of_buildings(maps):
    volume = ju.cost_map(maps, Levels(30.0, 30.0, 10.0), time_of_day="night")
    np.testing.assert_array_equal(volume.altitudes_m, [30])
    between = {name: costs[0] for name, costs in zip(volume.names, volume.costs, strict=True)}
    low, high = (maps.m("gps", z_m) for z_m in (20.0, 60.0))
    is_free = maps.is_free(20.0, "centre")
    np.testing.assert_allclose(1 - between["gps"][is_free], (0.75 * low + 0.25 * high)[is_free], rtol=1e-5)
    np.testing.assert_allclose(1 - between["gps"][~is_free], np.nan_to_num(high)[~is_free], rtol=1e-5)
    np.testing.assert_array_equal(between["population"], maps.m("population", time_of_day="night"))
    for rule, roof_m in (("centre", maps.m("roof")), ("touched", maps.m("roof_touched"))):
        for z_m in (30.0, 60.0):
            np.testing.assert_array_equal(maps.is_free(z_m, rule), roof_m < z_m)


def test_the_shortest_path_leaves_climb_and_descent_out(maps, ends):
    shortest = plan_volume(maps, **ends, objective="distance", climb_cost=1000.0)
    around = ju.plan(maps, **ends, altitude_m=20.0, objective="distance")
    assert shortest.search.cost == pytest.approx(shortest.length_m)
    assert shortest.length_m <= around.length_m
    assert shortest.cost == pytest.approx(sum(shortest.cost_by_layer.values()))


def test_with_all_weights_zero_the_shortest_path_is_given_and_said_so(maps, ends):
    nothing = ju.Weights(distance=0.0, gps=0.0, lidar=0.0, population=0.0, risk=0.0)
    path = plan_volume(maps, **ends, weights=nothing)
    assert path.cost == 0.0
    assert path.search.cost == pytest.approx(path.length_m)
    assert "All weights are zero" in path.to_dict()["message"]


def test_a_metre_of_climb_costs_a_metre_of_flight_unless_told_otherwise(maps, ends):
    path = plan_volume(maps, **ends, goal_altitude_m=60.0, max_altitude_m=60.0, weights=WEIGHTS)
    climbed_m = np.maximum(np.diff(path.z_m), 0).sum()
    assert path.cost_by_layer["climb"] == pytest.approx(0.2 * climbed_m)
    assert path.cost_by_layer["descent"] == 0.0


def test_start_left_on_a_roof_begins_at_the_lowest_free_level_over_it(maps, ends):
    on_roof = centre(maps, np.argwhere(~maps.is_free(20.0) & maps.is_free(60.0))[0])
    path = plan_volume(maps, start_xy_m=on_roof, goal_xy_m=ends["goal_xy_m"])
    assert path.z_m[0] == 60.0
    with pytest.raises(InputError, match=r"at 20 m; the lowest free level there is 60 m"):
        plan_volume(maps, start_xy_m=on_roof, goal_xy_m=ends["goal_xy_m"], start_altitude_m=20.0)
    with pytest.raises(InputError, match=r"every level from 20 to 20 m; the lowest free altitude there is 60 m"):
        plan_volume(maps, start_xy_m=on_roof, goal_xy_m=ends["goal_xy_m"], max_altitude_m=20.0)
    moved = plan_volume(maps, start_xy_m=on_roof, goal_xy_m=ends["goal_xy_m"], max_altitude_m=20.0, snap=True)
    assert moved.z_m[0] == 20.0
    assert moved.snap_distance_m[0] >= 20.0


def test_start_under_the_goal_goes_straight_up_and_is_written(maps, ends, tmp_path):
    up = plan_volume(
        maps, start_xy_m=ends["start_xy_m"], goal_xy_m=ends["start_xy_m"], goal_altitude_m=60.0, objective="distance"
    )
    assert up.length_m == pytest.approx(40.0)
    np.testing.assert_array_equal(up.z_m, [20.0, 60.0])
    for suffix in (".geojson", ".kml", ".plan"):
        assert write_path(up, tmp_path / f"up{suffix}")
    items = json.loads((tmp_path / "up.plan").read_text())["mission"]["items"]
    assert [item["Altitude"] for item in items] == [20.0, 60.0, 0.0]
    still = plan_volume(maps, start_xy_m=ends["start_xy_m"], goal_xy_m=ends["start_xy_m"])
    assert (still.cost, still.length_m, len(still.z_m)) == (0.0, 0.0, 1)


def test_geojson_holds_every_points_altitude(path, tmp_path):
    write_path(path, tmp_path / "path.geojson")
    (feature,) = json.loads((tmp_path / "path.geojson").read_text())["features"]
    np.testing.assert_allclose(feature["properties"]["z_m"], path.z_m, atol=0.005)
    assert len(feature["geometry"]["coordinates"]) == len(path.z_m)
    assert feature["properties"]["settings"]["levels_m"] == list(range(20, 101, 10))


def test_kml_holds_every_points_altitude(path, tmp_path):
    write_path(path, tmp_path / "path.kml")
    line = ElementTree.parse(tmp_path / "path.kml").getroot().findtext(".//{*}LineString/{*}coordinates")
    points = np.array([[float(value) for value in point.split(",")] for point in line.split()])
    np.testing.assert_allclose(points[:, 2], path.z_m, atol=0.005)
    np.testing.assert_allclose(points[:, :2], path.lonlat, atol=1e-7)


def test_waypoints_of_a_plan_keep_the_path_and_its_altitudes(path, tmp_path):
    write_path(path, tmp_path / "path.plan", end="none")
    items = json.loads((tmp_path / "path.plan").read_text())["mission"]["items"]
    flown = np.array([[*item["params"][5:3:-1], item["Altitude"]] for item in items])
    assert len(flown) < len(path.z_m)
    # Every waypoint is a point of the path, in order, and between two of them the path is straight.
    lonlatz = np.column_stack([path.lonlat, path.z_m])
    kept = [int(np.abs(lonlatz - point).max(axis=1).argmin()) for point in flown]
    np.testing.assert_allclose(lonlatz[kept], flown, atol=1e-6)
    assert kept == sorted(kept)
    xyz = np.column_stack([path.xy_m, path.z_m])
    for first, last in itertools.pairwise(kept):
        along = np.linspace(0, 1, last - first + 1)[:, None]
        np.testing.assert_allclose(xyz[first] * (1 - along) + xyz[last] * along, xyz[first : last + 1], atol=0.05)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"min_altitude_m": 80.0, "max_altitude_m": 40.0}, "hold no altitude from 80 to 40 m"),
        ({"min_altitude_m": 70.0, "max_altitude_m": 90.0}, "hold no altitude from 70 to 90 m, only 20, 60, 100 m"),
        ({"min_altitude_m": 120.0, "max_altitude_m": 150.0, "level_step_m": 5.0}, "hold no altitude from 120 to 150 m"),
        ({"level_step_m": 0.0}, "level_step_m"),
        ({"level_step_m": 1e-9}, "10000 levels"),
        ({"goal_altitude_m": 30.0}, "goal altitude 30 m is none of the levels 20, 60, 100 m"),
        ({"climb_cost": -1.0}, "climb_cost"),
        ({"descent_cost": float("nan")}, "descent_cost"),
        ({"weights": ju.Weights(gps=-1.0)}, "weight gps"),
        ({"heuristic": "plsu"}, "did you mean 'plus'"),
        ({"start": (-73.97, 40.78)}, "not both"),
        ({"planner": "ptp"}, "does not fly in a volume"),
        ({"refine": True}, "leave it out"),
    ],
)
def test_wrong_arguments_are_named(maps, ends, changed, words):
    with pytest.raises(InputError, match=words):
        plan_volume(maps, **(ends | changed))


def test_too_little_memory_is_told_before_it_runs_out(maps, ends, monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=100_000))
    with pytest.raises(InputError, match=r"volume of 3 levels of 5.* x 5.* cells .* choose a longer level_step_m"):
        plan_volume(maps, **ends)


def test_the_command_line_plans_through_the_volume(maps, ends, tmp_path, capsys):
    maps.save(tmp_path)
    start, goal = (maps.grid.lonlat_of_xy(*ends[f"{name}_xy_m"]) for name in ("start", "goal"))
    places = ["plan", tmp_path, f"--start={start[0]},{start[1]}", f"--goal={goal[0]},{goal[1]}", "--altitude", 20]
    options = ["--volume", "--max-altitude", 60, "--level-step", 10, "--climb-cost", 0.01, "--weights", "lidar=2"]
    code, out, _ = run(capsys, *places, *options, "--json", "-o", tmp_path / "path.kml")
    facts = json.loads(out)
    assert (code, facts["planner"], facts["z_m"][0], facts["z_m"][-1]) == (0, "astar-volume", 20.0, 20.0)
    assert len(facts["z_m"]) == len(facts["lonlat"])
    assert facts["settings"]["levels_m"] == [20, 30, 40, 50, 60]
    assert facts["settings"]["climb_cost"] == 0.01
    assert (tmp_path / "path.kml").is_file()
    code, _, err = run(capsys, *places, "--climb-cost", 1)
    assert code == 2
    assert_one_sentence(err, "--climb-cost", "--volume")
    code, _, err = run(capsys, *places, "--volume", "--planner", "ptp")
    assert code == 2
    assert_one_sentence(err, "choose one of astar-volume")


def test_a_volume_flies_over_a_zone_with_a_ceiling_and_around_one_without():
    maps = made_maps(altitudes_m=(20.0, 60.0, 90.0))
    grid = maps.grid
    low_x, low_y = grid.xy_of_cell(0, 45)
    high_x, high_y = grid.xy_of_cell(grid.num_rows - 1, 50)
    wall = shapely.box(low_x, low_y - 100, high_x, high_y + 100)
    free = np.argwhere(maps.is_free(20.0))
    start, goal = (tuple(free[free[:, 1] == col][0]) for col in (5, 95))
    ends = {"start_xy_m": centre(maps, start), "goal_xy_m": centre(maps, goal), "start_altitude_m": 20.0}

    def planned(ceiling_m: float) -> ju.PlannedPath:
        constraints = ju.Constraints((Zone("wall", wall, grid.crs, 0.0, ceiling_m, "made"),))
        return plan_volume(maps, goal_altitude_m=20.0, constraints=constraints, **ends)

    over = planned(70.0)
    above = (over.xy_m[:, 0] > low_x) & (over.xy_m[:, 0] < high_x)
    assert above.any()
    assert np.all(over.z_m[above] == 90.0)
    assert planned(np.inf).status is Status.NO_PATH
    middle = centre(maps, (grid.num_rows // 2, 47))
    constraints = ju.Constraints((Zone("wall", wall, grid.crs, 0.0, 70.0, "made"),))
    with pytest.raises(InputError, match=r"closed by the no-fly zone 'wall'.*lowest free level there is 90 m"):
        plan_volume(maps, constraints=constraints, **(ends | {"start_xy_m": middle, "start_altitude_m": 60.0}))


def test_climbing_alone_can_be_what_costs(maps, ends):
    free = ju.Weights(**dict.fromkeys(ju.Weights().to_dict(), 0.0))
    level = plan_volume(maps, weights=free, climb_cost=5.0, **ends)
    assert level.cost == 5.0 * max(0.0, level.z_m[-1] - level.z_m[0])
