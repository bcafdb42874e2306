"""The report of a route: facts that anyone can recompute from the maps."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.planners.base import Status
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps, missing_inside

ALTITUDE_M = 20.0
MODELS = (("cell", "line"), (4.0,), (4, 8), ("both-free", "always"))
WEIGHTS = ju.Weights(distance=0.2, gps=0.5, lidar=2.0, population=3.0, risk=1.5)


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    return {"start_xy_m": maps.grid.xy_of_cell(*free[10]), "goal_xy_m": maps.grid.xy_of_cell(*free[-10])}


def route(maps, ends, **settings) -> ju.PlannedPath:
    return ju.plan(maps, **ends, **({"altitude_m": ALTITUDE_M, "weights": WEIGHTS, "time_of_day": "night"} | settings))


@pytest.fixture(scope="module")
def planned(maps, ends) -> ju.PlannedPath:
    return route(maps, ends)


@pytest.fixture(scope="module")
def report(planned, maps) -> ju.RouteReport:
    return ju.explain(planned, maps, speed_m_s=12.5, power_w=300.0, swath_m=8.0)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
@pytest.mark.parametrize("planner", ["ptp", "astar-plus", "bitstar-plus"])
@pytest.mark.parametrize("num_segments", [1, 10])
def test_segments_add_up_to_the_paths_cost_layer_by_layer(maps, ends, planner, cost_model, num_segments):
    altitude_m = 60.0 if planner == "ptp" else ALTITUDE_M
    open_maps = maps
    if planner == "ptp":
        open_maps = ju.MetricMaps(maps.ds.assign({name: maps.ds[name] * 0 for name in ("obstacle", "roof_touched")}))
    path = route(open_maps, ends, planner=planner, cost_model=cost_model, altitude_m=altitude_m, budget_s=0.3)
    report = ju.explain(path, open_maps, num_segments=num_segments)
    assert len(report.segments) == num_segments
    for totals in (report.totals, report.segments.sum()):
        assert totals["cost"] == pytest.approx(path.cost, rel=1e-9)
        assert totals["length_m"] == pytest.approx(path.length_m, rel=1e-9)
        for name, value in path.cost_by_layer.items():
            assert totals[f"cost_of_{name}"] == pytest.approx(value, rel=1e-9, abs=1e-9)
    for name, mean in path.metrics.items():
        assert report.totals[f"mean_{name}"] == pytest.approx(mean, rel=1e-9)
        weighted = report.segments[f"mean_{name}"] @ report.segments["length_m"] / path.length_m
        assert weighted == pytest.approx(mean, rel=1e-9)


def test_what_is_along_the_route_is_what_shapely_finds_in_its_cells(maps, planned, report):
    line, grid = shapely.LineString(planned.xy_m), maps.grid
    few_m = people = 0.0
    visible, density = maps.m("num_visible", ALTITUDE_M), maps.m("density", time_of_day="night").astype(float)
    for row, col in set(zip(*map(np.ndarray.tolist, grid.cell_of_xy(*planned.xy_m.T)), strict=True)):
        x_m, y_m = grid.xy_of_cell(row, col)
        cell = shapely.box(*(np.array([x_m, y_m, x_m, y_m]) + np.array([-5, -5, 5, 5])))
        length_m = line.intersection(cell).length
        few_m += length_m * (visible[row, col] < 4)
        people += density[row, col] / 1e6 * length_m * 8.0
    assert few_m > 0
    assert report.totals["under_4_satellites_m"] == pytest.approx(few_m)
    assert report.totals["people_overflown"] == pytest.approx(people)


def test_people_over_an_even_density_are_density_times_strip(maps, planned):
    even = ju.MetricMaps(maps.ds.assign(density=maps.ds["density"] * 0 + 10_000))
    for swath_m in (5.0, 40.0):
        report = ju.explain(planned, even, swath_m=swath_m)
        assert report.totals["people_overflown"] == pytest.approx(0.01 * planned.length_m * swath_m)


def test_time_is_length_over_speed_and_energy_power_over_time(planned, report, maps):
    assert report.totals["time_s"] == pytest.approx(planned.length_m / 12.5)
    assert report.totals["energy_wh"] == pytest.approx(300 * planned.length_m / 12.5 / 3600)
    assert report.segments["time_s"].sum() == pytest.approx(report.totals["time_s"])
    assert "time_s" not in ju.explain(planned, maps).totals


def test_clearance_is_that_of_shapely(maps, planned, report):
    row, col = np.nonzero(maps.m("obstacle", ALTITUDE_M))
    x_m, y_m = maps.grid.xy_of_cell(row, col)
    walls = shapely.union_all(shapely.box(x_m - 5, y_m - 5, x_m + 5, y_m + 5))
    line = shapely.LineString(planned.xy_m)
    assert report.totals["nearest_wall_m"] == pytest.approx(line.distance(walls), abs=1e-6)
    place = report.profile.loc[report.profile["nearest_wall_m"].idxmin()]
    at = shapely.Point(maps.grid.xy_of_lonlat(place["lon"], place["lat"]))
    assert at.distance(walls) == pytest.approx(line.distance(walls), abs=5.0)


def test_the_profile_holds_the_maps_values_along_the_route(maps, planned, report):
    line, profile = shapely.LineString(planned.xy_m), report.profile
    x_m, y_m = maps.grid.xy_of_lonlat(profile["lon"], profile["lat"])
    along_m = (profile["from_m"] + profile["to_m"]) / 2
    assert shapely.distance(shapely.points(x_m, y_m), line.interpolate(along_m)).max() < 0.01
    for name in maps.metrics:
        shown = maps.m(name, ALTITUDE_M, time_of_day="night")
        np.testing.assert_array_equal(profile[name], shown[maps.grid.cell_of_xy(x_m, y_m)])
    assert report.segments["min_gps"].min() == profile["gps"].min()


def test_segments_follow_each_other_along_the_route(planned, report):
    assert report.segments["from_m"].iloc[0] == 0
    np.testing.assert_allclose(report.segments["from_m"].iloc[1:], report.segments["to_m"].iloc[:-1])
    assert report.segments["to_m"].iloc[-1] == pytest.approx(planned.length_m)
    np.testing.assert_allclose(report.lines[0][0], planned.lonlat[0], atol=1e-9)
    np.testing.assert_allclose(report.lines[-1][-1], planned.lonlat[-1], atol=1e-9)
    for before, after in zip(report.lines[:-1], report.lines[1:], strict=True):
        assert np.array_equal(before[-1], after[0])


def test_a_route_of_one_place_costs_nothing_and_still_tells_where_it_is(maps, ends):
    here = {"start_xy_m": ends["start_xy_m"], "goal_xy_m": ends["start_xy_m"]}
    path = route(maps, here)
    report = ju.explain(path, maps, speed_m_s=10.0)
    assert (report.totals["cost"], report.totals["length_m"], report.totals["time_s"]) == (0.0, 0.0, 0.0)
    assert report.totals["mean_gps"] == pytest.approx(path.metrics["gps"])
    assert len(report.segments) == 0
    assert "segment" in report.table()
    assert json.loads(json.dumps(report.to_dict()))["segments"] == []


def test_what_the_maps_do_not_hold_is_left_out(maps, planned):
    without_walls = {name: maps.ds[name] * 0 for name in ("obstacle", "roof", "roof_touched")}
    bare = ju.MetricMaps(maps.ds.drop_vars(["density", "num_visible", "hdop"]).assign(without_walls))
    report = ju.explain(planned, bare)
    assert not {"people_overflown", "under_4_satellites_m"} & set(report.totals)
    assert math.isinf(report.totals["nearest_wall_m"])
    assert report.to_dict()["nearest_wall_m"] is None
    assert "none" in report.table()


def test_the_report_is_json_ready_and_its_table_holds_every_segment(report):
    facts = report.to_dict()
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts
    assert [segment["segment"] for segment in facts["segments"]] == list(range(1, 11))
    lines = report.table().splitlines()
    assert sum(line[:7].strip().isdigit() for line in lines) == 10
    assert any(line.startswith("people overflown") and "(strip of 8 m)" in line for line in lines)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"speed_m_s": 0.0}, "speed_m_s must be a positive number of metres per second, got 0.0"),
        ({"speed_m_s": math.nan}, "speed_m_s"),
        ({"power_w": 200.0}, "give the speed"),
        ({"swath_m": -1.0}, "swath_m"),
        ({"num_segments": 0}, "num_segments"),
    ],
)
def test_wrong_arguments_are_named(maps, planned, changed, words):
    with pytest.raises(InputError, match=words):
        ju.explain(planned, maps, **changed)


def test_other_maps_and_a_missing_path_are_refused(maps, ends, planned):
    with pytest.raises(InputError, match=r"got MetricMaps: call explain\(planned, maps\)"):
        ju.explain(maps, planned)
    with pytest.raises(InputError, match="these maps are 20 m"):
        ju.explain(planned, made_maps(40, 50, resolution_m=20.0))
    blocked = route(maps, ends, planner="ptp")
    assert blocked.status is Status.BLOCKED
    with pytest.raises(InputError, match="there is no path to explain"):
        ju.explain(blocked, maps)


def test_the_command_line_prints_writes_and_draws_the_report(maps, ends, tmp_path, capsys):
    write_zarr(maps.ds, tmp_path / "maps")
    lonlat = {name: "{},{}".format(*maps.grid.lonlat_of_xy(*xy_m)) for name, xy_m in ends.items()}
    arguments = ("plan", tmp_path / "maps", "--start", lonlat["start_xy_m"], "--goal", lonlat["goal_xy_m"])
    arguments += ("--altitude", 20, "--speed", 12, "--power", 300)
    files = ("--profile", tmp_path / "p.png", "-o", tmp_path / "p.geojson")
    code, out, err = run(capsys, *arguments, "--report", *files)
    assert (code, "people overflown" in out, "segment" in out) == (0, True, True)
    assert f"wrote {tmp_path / 'p.png'}" in err
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    assert len(json.loads((tmp_path / "p.geojson").read_text())["features"]) == 11
    code, out, _ = run(capsys, *arguments, "--report", "--json")
    facts = json.loads(out)
    assert facts["report"]["cost"] == pytest.approx(facts["cost"])
    assert facts["report"]["energy_wh"] == pytest.approx(300 * facts["length_m"] / 12 / 3600)
    for wrong, words in (
        (("--profile", "p.jpg"), ("end its name in .png",)),
        (("--profile", tmp_path / "none" / "p.png"), ("folder that is there",)),
        (("--swath", 0), ("swath_m",)),
    ):
        code, out, err = run(capsys, *arguments, *wrong)
        assert (code, out) == (2, "")
        assert_one_sentence(err, *words)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_climb_is_costed_at_the_levels_it_joins(maps, ends, cost_model):
    flat = route(maps, {"start_xy_m": ends["start_xy_m"], "goal_xy_m": ends["start_xy_m"]}, cost_model=cost_model)
    xy_m = flat.xy_m[[0, 0, 0]] + [[0, 0], [0, 0], [10, 0]]
    settings = flat.settings | {"levels_m": [20.0, 60.0], "climb_cost": 0.3, "descent_cost": 0.05}
    z_m = np.array([20.0, 60.0, 60.0])
    climbing = replace(flat, xy_m=xy_m, z_m=z_m, settings=settings)
    totals = ju.explain(climbing, maps, speed_m_s=5.0).totals
    row, col = (int(value) for value in maps.grid.cell_of_xy(*xy_m[0]))
    low, high, beside = (
        1 - float(maps.m("lidar", z)[row, at]) for z, at in ((20.0, col), (60.0, col), (60.0, col + 1))
    )
    by_hand = high + beside if cost_model == "cell" else (20 * low + 25 * high + 5 * beside) / 5.0
    assert totals["length_m"] == pytest.approx(50.0)
    assert totals["time_s"] == pytest.approx(10.0)
    assert totals["cost_of_climb"] == pytest.approx(0.3 * 40)
    assert totals["cost_of_descent"] == 0.0
    assert totals["cost_of_lidar"] == pytest.approx(2.0 * by_hand)
    assert totals["cost_of_distance"] == pytest.approx(0.2 * 50.0)


def test_between_two_altitudes_the_maps_are_linear_and_walls_stand_to_their_roofs(maps, ends):
    flat = route(maps, {"start_xy_m": ends["start_xy_m"], "goal_xy_m": ends["start_xy_m"]})
    between = replace(flat, z_m=np.array([31.0]), settings=flat.settings | {"levels_m": [31.0]})
    report = ju.explain(between, maps)
    cell = tuple(int(value) for value in maps.grid.cell_of_xy(*flat.xy_m[0]))
    low, high = (float(maps.m("gps", z)[cell]) for z in (20.0, 60.0))
    assert report.totals["mean_gps"] == pytest.approx(low + (31 - 20) / 40 * (high - low), rel=1e-6)
    row, col = np.nonzero(maps.m("roof") >= 31.0)
    x_m, y_m = maps.grid.xy_of_cell(row, col)
    walls = shapely.union_all(shapely.box(x_m - 5, y_m - 5, x_m + 5, y_m + 5))
    assert report.totals["nearest_wall_m"] == pytest.approx(shapely.Point(flat.xy_m[0]).distance(walls), abs=1e-6)


@pytest.mark.parametrize("model", [ju.CostModel(*parts) for parts in itertools.product(*MODELS)], ids=str)
def test_a_route_between_levels_has_the_cost_that_plan_told(maps, ends, model):
    levels = ju.Levels(level_step_m=15.0, climb_cost=0.3, descent_cost=0.05)
    tops = {name: (*xy_m, 60.0 if name == "start_xy_m" else 35.0) for name, xy_m in ends.items()}
    path = route(maps, tops, altitude_m=levels, cost_model=model)
    report = ju.explain(path, maps)
    assert {20.0, 60.0} != set(path.z_m.tolist())
    for totals in (report.totals, report.segments.sum()):
        for name, value in path.cost_by_layer.items():
            assert totals[f"cost_of_{name}"] == pytest.approx(value, rel=1e-9, abs=1e-9)
        assert totals["cost"] == pytest.approx(path.cost, rel=1e-9)


def test_over_an_obstacle_of_the_map_below_every_number_is_known(maps):
    maps = missing_inside(maps, risk_threshold_m=50.0, risk_distance="slice")
    start, goal = (maps.grid.xy_of_cell(*cell) for cell in np.argwhere(maps.m("roof") == 30.0)[[0, -1]])
    planned = ju.plan(maps, start_xy_m=start, goal_xy_m=goal, altitude_m=35.0)
    profile = ju.explain(planned, maps).profile
    assert (profile["roof_m"] == 30.0).any()
    assert np.isfinite(profile[["gps", "lidar", "risk", "walls_outside_m", "nearest_wall_m"]]).all(axis=None)
