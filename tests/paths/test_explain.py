"""The report of a route, cut at cell borders, and its profile: facts that anyone can recompute from the maps."""

import itertools
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import StepPatch

import jaxurban as ju
from jaxurban.draw.profile import NO_FIX_COLOUR
from jaxurban.io.zone import cell_boxes
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.variables import GROUP_COLOURS
from jaxurban.paths.explain import with_return_altitude
from jaxurban.paths.profile import clearance_m, cut_evenly, nearest_level_m
from jaxurban.paths.steps import between
from jaxurban.planners.cost import path_states
from jaxurban.plot import plot_profile, save_profile
from jaxurban.typing import PlannedPath, RouteReport
from jaxurban.world.kinds import CODES
from tests.cli_runs import run
from tests.made_maps import missing_inside
from tests.volumes import WEIGHTS, options_of

pytestmark = pytest.mark.usefixtures("without_layout")
ALTITUDE_M = 20.0
MODELS = (("cell", "line"), (4.0,), (4, 8), ("both-free", "always"))
OBSTACLES = np.random.default_rng(3).random((30, 40)) < 0.08
RES = 5.0


def route(maps, ends, **settings) -> PlannedPath:
    return ju.plan(
        maps,
        **ends,
        **({"altitude_m": ALTITUDE_M, "weights": WEIGHTS, "time_of_day": "night"} | settings),
    )


def of_one_place(maps, ends, **settings) -> PlannedPath:
    return route(maps, {"start": ends["start"], "goal": ends["start"]}, **settings)


def outlines(maps, is_wall) -> shapely.Geometry:
    return shapely.union_all(cell_boxes(maps.grid, np.argwhere(is_wall), 1))


def assert_costs_of(path, report) -> None:
    """Check that totals and the sum of segments are the path's costs, layer by layer."""
    expected = {"cost": path.cost, "length_m": path.length_m}
    expected |= {f"cost_of_{name}": value for name, value in path.cost_by_layer.items()}
    for totals in (report.totals, report.segments.sum()):
        assert {name: totals[name] for name in expected} == pytest.approx(
            expected, rel=1e-9, abs=1e-9
        )


@pytest.fixture(scope="module")
def planned(maps, ends) -> PlannedPath:
    return route(maps, ends)


@pytest.fixture(scope="module")
def report(planned, maps) -> RouteReport:
    return ju.explain(planned, maps, speed_m_s=12.5, swath_m=8.0)


@pytest.mark.parametrize("above_m", [0.0, 3.0, 12.0])
def test_the_return_altitude_keeps_the_clearance_of_the_plan_also_where_it_is_none(
    maps, ends, above_m
):
    path = route(maps, ends, constraints=ju.Constraints(vertical_clearance_m=above_m))
    kept = ju.return_altitude(maps, ju.XY(*path.xy_m[0]), vertical_clearance_m=above_m)
    report = with_return_altitude(ju.explain(path, maps), path, maps)
    least_m = report.totals["return_altitude_m"]
    assert least_m in kept.altitude_m
    if above_m == 0:
        default = route(maps, ends)
        report = with_return_altitude(ju.explain(default, maps), default, maps)
        assert least_m <= report.totals["return_altitude_m"] - 3.0 + 0.01


@pytest.mark.parametrize("cost_model", ["cell", "line"])
@pytest.mark.parametrize("planner", ["ptp", "astar-plus", "bitstar-plus"])
def test_segments_add_up_to_the_paths_cost_layer_by_layer(maps, ends, planner, cost_model):
    if planner == "ptp":
        maps = ju.MetricMaps(
            maps.ds.assign({name: maps.ds[name] * 0 for name in ("obstacle", "roof_touched")})
        )
    path = route(maps, ends, planner=planner, cost_model=cost_model, budget_s=0.3)
    for num_segments in (1, 10):
        report = ju.explain(path, maps, num_segments=num_segments)
        assert len(report.segments) == num_segments
        assert_costs_of(path, report)
        for name, mean in path.metrics.items():
            assert report.totals[f"mean_{name}"] == pytest.approx(mean, rel=1e-9)
            weighted = report.segments[f"mean_{name}"] @ report.segments["length_m"] / path.length_m
            assert weighted == pytest.approx(mean, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [ju.CostModel(*parts) for parts in itertools.product(*MODELS)], ids=str
)
def test_a_route_between_levels_has_the_cost_that_plan_told(maps, ends, model):
    levels = ju.Levels(level_step_m=15.0, climb_cost=0.3, descent_cost=0.05)
    tops = {
        name: xy_m._replace(altitude_m=60.0 if name == "start" else 35.0)
        for name, xy_m in ends.items()
    }
    path = route(maps, tops, altitude_m=levels, cost_model=model)
    assert {20.0, 60.0} != set(path.z_m.tolist())
    assert_costs_of(path, ju.explain(path, maps))


def test_what_is_along_the_route_is_what_shapely_finds_in_its_cells(maps, planned, report):
    line = shapely.LineString(planned.xy_m)
    cells = np.unique(maps.grid.cell_of_xy(*planned.xy_m.T), axis=1)
    length_m = shapely.length(shapely.intersection(cell_boxes(maps.grid, cells.T, 1), line))
    without_m = length_m[np.isinf(maps.m("hdop", ALTITUDE_M)[tuple(cells)])].sum()
    assert without_m > 0
    without = report.totals["no_fix_m"], report.segments["no_fix_m"].sum()
    assert without == pytest.approx((without_m, without_m))
    density = maps.m("density", time_of_day="night").astype(float)
    assert report.totals["people_overflown"] == pytest.approx(
        density[tuple(cells)] / 1e6 @ length_m * 8.0
    )


@pytest.mark.parametrize("z_m", [ALTITUDE_M, 29.0, 31.0])
def test_clearance_is_that_of_shapely_to_the_walls_that_reach_up_there(maps, ends, z_m):
    planned = route(maps, ends, altitude_m=z_m)
    report, line = ju.explain(planned, maps), shapely.LineString(planned.xy_m)
    walls = outlines(maps, maps.m("roof") >= z_m)
    assert report.totals["nearest_wall_m"] == pytest.approx(line.distance(walls), abs=1e-6)
    profile = report.profile
    middles = shapely.points(*maps.grid.xy_of_lonlat(profile["lon"], profile["lat"]))
    farther_m = shapely.distance(middles, walls) - profile["nearest_wall_m"]
    assert farther_m.between(-0.01, (profile["to_m"] - profile["from_m"]) / 2 + 0.01).all()


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
    edges_m = np.append(report.segments["from_m"], planned.length_m)
    assert edges_m[0] == 0
    np.testing.assert_allclose(report.segments["to_m"], edges_m[1:])


def test_the_report_says_which_stretch_costs_the_most_and_for_which_layer(planned, maps, report):
    costs = report.segments.filter(like="cost_of_").drop(columns="cost_of_distance")
    most = costs.sum(axis=1) + report.segments["cost_of_distance"]
    number = most.idxmax()
    assert re.match(
        rf"The most expensive stretch is segment {number}, from {report.segments.from_m[number]:.0f} to .* m: "
        rf"{most[number] / most.sum():.0%} of the cost on .*% of the length; beside its length it pays most for "
        rf"{costs.loc[number].idxmax().removeprefix('cost_of_')} ",
        report.why,
    )
    for text in (report.table(), repr(report), report._repr_html_(), report.to_dict()["why"]):
        assert report.why in text
    assert len(repr(report).splitlines()) < 50
    assert "array" not in repr(report)
    alone = ju.explain(
        route(
            maps,
            {"start": ju.XY(*planned.xy_m[0]), "goal": ju.XY(*planned.xy_m[-1])},
            weights=dict.fromkeys(maps.metrics, 0.0),
        ),
        maps,
    )
    assert alone.why.endswith("of the length, all of it for its length.")


def test_a_route_of_one_place_costs_nothing_and_still_tells_where_it_is(maps, ends):
    path = of_one_place(maps, ends)
    report = ju.explain(path, maps, speed_m_s=10.0)
    assert (report.totals["cost"], report.totals["length_m"], report.totals["time_s"]) == (
        0.0,
        0.0,
        0.0,
    )
    assert report.totals["mean_gps"] == pytest.approx(path.metrics["gps"])
    assert "segment" in report.table()
    assert report.why == ""
    assert json.loads(json.dumps(report.to_dict()))["segments"] == []


def test_what_the_maps_do_not_hold_is_left_out(maps, planned):
    without_walls = {name: maps.ds[name] * 0 for name in ("obstacle", "roof", "roof_touched")}
    bare = ju.MetricMaps(maps.ds.drop_vars(["density", "hdop"]).assign(without_walls))
    report = ju.explain(planned, bare)
    assert not {"people_overflown", "no_fix_m"} & set(report.totals)
    assert math.isinf(report.totals["nearest_wall_m"])
    assert report.to_dict()["nearest_wall_m"] is None
    assert "none" in report.table()


def test_the_report_is_json_ready_and_its_table_holds_every_segment(report):
    facts = report.to_dict()
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts
    lines = report.table().splitlines()
    numbers = [int(line[:7]) for line in lines if line[:7].strip().isdigit()]
    assert numbers == [segment["segment"] for segment in facts["segments"]] == list(range(1, 11))
    assert any(line.startswith("people overflown") and "(strip of 8 m)" in line for line in lines)


@pytest.mark.slow
def test_the_command_line_prints_writes_and_draws_the_report_at_any_altitude(
    folder, maps, ends, tmp_path, capsys
):
    arguments = (
        "plan",
        folder,
        *options_of(maps, **ends, altitude_m=35),
        "--report",
        "speed_m_s=12,power_w=300",
    )
    code, out, err = run(
        capsys, *arguments, "--profile", tmp_path / "p.png", "-o", tmp_path / "p.geojson"
    )
    assert (code, "people overflown" in out, "segment" in out) == (0, True, True)
    assert f"wrote {tmp_path / 'p.png'}" in err
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    (route,) = json.loads((tmp_path / "p.geojson").read_text())["features"]
    assert len(route["properties"]["segments"]) == 10
    facts = json.loads(run(capsys, *arguments, "--json")[1])
    assert facts["report"]["cost"] == pytest.approx(facts["cost"])
    assert facts["report"]["energy_wh"] == pytest.approx(300 * facts["length_m"] / 12 / 3600)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_climb_is_costed_at_the_levels_it_joins(maps, ends, cost_model):
    flat = of_one_place(maps, ends, cost_model=cost_model)
    xy_m = flat.xy_m[[0, 0, 0]] + [[0, 0], [0, 0], [10, 0]]
    settings = flat.settings | {"levels_m": [20.0, 60.0], "climb_cost": 0.3, "descent_cost": 0.05}
    climbing = replace(flat, xy_m=xy_m, z_m=np.array([20.0, 60.0, 60.0]), settings=settings)
    totals = ju.explain(climbing, maps, speed_m_s=5.0).totals
    row, col = map(int, maps.grid.cell_of_xy(*xy_m[0]))
    low, high, beside = (
        1 - float(maps.m("lidar", z)[row, at])
        for z, at in ((20.0, col), (60.0, col), (60.0, col + 1))
    )
    by_hand = high + beside if cost_model == "cell" else (20 * low + 25 * high + 5 * beside) / 5.0
    expected = {"length_m": 50.0, "time_s": 10.0, "cost_of_climb": 0.3 * 40, "cost_of_descent": 0.0}
    expected |= {"cost_of_lidar": 2.0 * by_hand, "cost_of_distance": 0.2 * 50.0}
    assert {name: totals[name] for name in expected} == pytest.approx(expected)


def test_over_an_obstacle_of_the_map_below_every_number_is_known(maps):
    maps = missing_inside(maps, risk_threshold_m=50.0, risk_distance="slice")
    start, goal = (
        maps.grid.xy_of_cell(*cell) for cell in np.argwhere(maps.m("roof") == 30.0)[[0, -1]]
    )
    planned = ju.plan(maps, ju.XY(*start), ju.XY(*goal), altitude_m=35.0)
    profile = ju.explain(planned, maps).profile
    assert (profile["roof_m"] == 30.0).any()
    assert np.isfinite(profile[["gps", "lidar", "risk", "walls_outside_m", "nearest_wall_m"]]).all(
        axis=None
    )


def straight_walk(seed: int, num: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (40 * RES, 30 * RES), (num, 2))


def test_a_climb_is_longer_in_the_air_than_over_the_ground():
    path_points_m = [[2.5, 2.5, 20.0], [32.5, 42.5, 20.0], [32.5, 42.5, 60.0], [62.5, 42.5, 20.0]]
    crossings = crossed_cells(np.array(path_points_m), RES)
    ends_m = between(
        np.stack([path_points_m[:-1], path_points_m[1:]], axis=1)[crossings.segment],
        crossings.shares,
    )
    np.testing.assert_allclose(ends_m[1:, 0], ends_m[:-1, 1])
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(ends_m, axis=1)[:, 0], axis=1), crossings.length_m, atol=1e-9
    )
    over_m = np.hypot(*np.diff(ends_m[:, :, :2], axis=1)[:, 0].T)
    assert over_m.sum() == pytest.approx(50 + 0 + 30)
    assert crossings.length_m.sum() == pytest.approx(50 + 40 + 50)
    straight_up = over_m == 0
    assert np.stack([crossings.row, crossings.col], axis=1)[straight_up].tolist() == [[8, 6]] * 2
    np.testing.assert_allclose(ends_m[straight_up][0], [[32.5, 42.5, 20], [32.5, 42.5, 40]])


@pytest.mark.parametrize("points", [[[12.5, 7.5]], [[12.5, 7.5], [12.5, 7.5]]])
def test_a_route_of_one_place_is_one_crossing_of_no_length(points):
    crossings = crossed_cells(np.array(points), RES)
    assert [crossings.row.tolist(), crossings.col.tolist(), crossings.length_m.tolist()] == [
        [1],
        [2],
        [0],
    ]
    assert cut_evenly(np.array(points[:1]), 10).size == 0


def test_segments_are_equal_up_to_a_step():
    states_m = path_states(straight_walk(2), RES)
    segment = cut_evenly(states_m, 7)
    length_m = np.bincount(segment, np.linalg.norm(np.diff(states_m, axis=0), axis=1))
    assert np.array_equal(np.unique(segment), np.arange(7))
    assert np.all(np.diff(segment) >= 0)
    assert np.ptp(length_m) <= 2 * RES
    assert np.array_equal(cut_evenly(states_m[:4], 10), [0, 1, 2])


def test_clearance_is_the_distance_that_shapely_measures_however_far_an_obstacle_is():
    rows, cols = np.nonzero(OBSTACLES) * np.array(RES)
    walls = shapely.union_all(shapely.box(cols, rows, cols + RES, rows + RES))
    free = np.argwhere(~OBSTACLES)[:, ::-1] * RES + RES / 2
    walk = straight_walk(4)
    for lines in (np.stack([walk[:-1], walk[1:]], axis=1), np.stack([free, free], axis=1)):
        by_shapely = shapely.distance(shapely.linestrings(lines), walls)
        np.testing.assert_allclose(clearance_m(lines, OBSTACLES, RES), by_shapely, atol=1e-9)
    one = np.zeros((30, 400), bool)
    one[10, 399] = True
    line = np.array([[[2.5, 52.5], [7.5, 52.5]]])
    assert clearance_m(line, one, RES)[0] == pytest.approx(399 * RES - 7.5)
    assert np.isinf(clearance_m(line, np.zeros_like(one), RES)[0])


def test_the_lower_of_two_altitudes_as_near_is_taken():
    assert nearest_level_m(np.array([20.0, 40.0, 41.0, 500.0]), (60.0, 20.0)).tolist() == [
        20,
        20,
        60,
        60,
    ]


def steps(panel) -> dict[str, StepPatch]:
    return {patch.get_label(): patch for patch in panel.patches if isinstance(patch, StepPatch)}


def test_the_curves_are_the_values_of_the_report_by_distance_under_altitude_and_time_of_day(
    maps, planned, report
):
    figure = plot_profile(planned, maps, report)
    heights, metrics, people, walls = figure.axes
    heading = f", 20 m above ground, {planned.settings['time_of_day']}, cost "
    assert any(heading in text.get_text() for text in figure.texts)
    edges_km = np.append(report.profile["from_m"], report.profile["to_m"].iloc[-1]) / 1000
    for panel, label, name in (
        (heights, "roofs beneath", "roof_m"),
        (metrics, "GPS quality", "gps"),
        (people, "Population", "population"),
        (walls, "nearest obstacle", "nearest_wall_m"),
    ):
        drawn = steps(panel)[label].get_data()
        np.testing.assert_array_equal(drawn.values, report.profile[name])
        np.testing.assert_array_equal(drawn.edges, edges_km)
    assert to_hex(steps(metrics)["GPS quality"].get_edgecolor()) == METRICS["gps"].colour
    assert heights.get_ylim()[1] > 20.0
    assert [panel.get_ylabel().replace("\n", " ") for panel in figure.axes[:4]] == [
        "(a) height above ground (m)",
        "(b) metric m (1 is best)",
        "(c) metric m (1 is worst)",
        "(d) distance (m), logarithmic above 10 m",
    ]
    assert walls.get_xlabel() == "distance flown (km)"
    assert all(panel.get_legend() for panel in (heights, metrics, people, walls))


def test_stretches_without_a_fix_are_shaded_over_their_whole_length(maps, planned, report):
    figure = plot_profile(planned, maps, report)
    widths = [
        p.get_width()
        for p in figure.axes[1].patches
        if p.get_facecolor()[:3] == to_rgb(NO_FIX_COLOUR)
    ]
    assert sum(widths) * 1000 == pytest.approx(report.totals["no_fix_m"])
    assert widths[0] > 0
    assert "no fix" in [text.get_text() for text in figure.axes[1].get_legend().get_texts()]


@pytest.mark.slow
@pytest.mark.usefixtures("laid_out")
def test_a_profile_without_walls_or_of_one_place_is_drawn(maps, ends, planned, tmp_path):
    save_profile(
        planned, ju.MetricMaps(maps.ds.assign(obstacle=maps.ds["obstacle"] * 0)), tmp_path / "a.png"
    )
    save_profile(of_one_place(maps, ends), maps, tmp_path / "b.png")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_what_is_beneath_is_drawn_and_named_by_its_group(maps, ends):
    kind = np.zeros(maps.grid.shape, np.uint8)
    kind[maps.m("roof_touched") > 0] = CODES["building"]
    kind[:, 30:50] = CODES["tree"]
    kind[:, 50:60] = CODES["turbine"]
    ds = maps.ds.copy(deep=True).assign(roof_kind=(("y", "x"), kind))
    ds["roof_touched"][:, 30:50] = 11.0
    ds["roof_touched"][:, 50:60] = 0.0
    wooded = ju.MetricMaps(ds)
    path = ju.plan(wooded, **ends, altitude_m=60.0)
    report = ju.explain(path, wooded)
    names = report.profile["roof_kind"]
    row, col = maps.grid.cell_of_lonlat(report.profile["lon"], report.profile["lat"])
    of_code = {0: "", **{code: name for name, code in CODES.items()}}
    assert names.tolist() == [of_code[code] for code in kind[row, col]]
    assert {"tree", "turbine"} < {*names}
    drawn = steps(plot_profile(path, wooded, report).axes[0])
    assert "roofs beneath" not in drawn
    assert "other structures" not in drawn  # of no height
    trees = drawn["trees"]
    assert to_hex(trees.get_facecolor()) == GROUP_COLOURS["trees"]
    np.testing.assert_array_equal(
        trees.get_data().values, report.profile["roof_m"].where(names == "tree", 0.0)
    )
    assert "roof_kind" not in ju.explain(ju.plan(maps, **ends, altitude_m=60.0), maps).profile


def test_roofs_of_guessed_height_and_stretches_above_every_obstacle_are_told_apart(
    maps, planned, report
):
    is_first = report.profile.index < 5
    clear_m = report.profile["nearest_wall_m"].mask(is_first, np.inf)
    profile = report.profile.assign(roof_m=12.0, roof_guessed=is_first, nearest_wall_m=clear_m)
    heights, *_, walls = plot_profile(planned, maps, replace(report, profile=profile)).axes
    guessed = steps(heights)["of guessed height"]
    assert guessed.get_hatch()
    np.testing.assert_array_equal(guessed.get_data().values, np.where(is_first, 12.0, 0.0))
    assert "of guessed height" not in steps(plot_profile(planned, maps, report).axes[0])
    np.testing.assert_array_equal(
        steps(walls)["nearest obstacle"].get_data().values, clear_m.where(~is_first)
    )
    assert "gaps: above every obstacle" in [
        text.get_text() for text in walls.get_legend().get_texts()
    ]
    assert not walls.texts
