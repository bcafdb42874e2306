"""Constraints and vehicles: what they close, how far an end there is moved, what is said, where speed and power go."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import IgnoredZoneWarning
from jaxurban.io.zone import Zone, cell_boxes
from jaxurban.paths.constraints import Bound
from jaxurban.planners.base import Status
from jaxurban.studies.queries import make_queries
from tests.cli_runs import run
from tests.made_maps import made_maps, missing_inside
from tests.volumes import REGION, ends_at, options_of, plan_volume, with_roofs

ALTITUDE_M, SIDE = 20.0, 30
START_CELL, GOAL_CELL = (15, 6), (15, 27)


def zone_of_cells(maps, row, col, size, name="park", **heights) -> Zone:
    """A square that touches exactly ``size`` x ``size`` cells."""
    (box,) = cell_boxes(maps.grid, np.array([[row, col]]), size)
    return Zone(name, box.buffer(-1.0, join_style="mitre"), maps.grid.crs, **heights)


def test_constraints_close_what_their_zones_touch_and_their_bounds_forbid(maps):
    zone = zone_of_cells(maps, 40, 30, 20, ceiling_m=30.0)
    constraints = ju.Constraints((zone,), (Bound("gps", ">=", 0.5), Bound("density", "<", 30_000)))
    for z_m in (20.0, 60.0):
        by_hand = (maps.m("gps", z_m) < 0.5) | (
            maps.m("density", z_m, time_of_day="night") >= 30_000
        )
        by_hand[40:60, 30:50] |= z_m == 20.0
        assert np.array_equal(constraints.closed(maps, z_m, time_of_day="night"), by_hand)


def test_a_zone_closes_from_its_floor_to_its_ceiling_both_included(maps):
    zone = zone_of_cells(maps, 40, 30, 5, floor_m=30.0, ceiling_m=50.0)
    constraints = ju.Constraints((zone,), vertical_clearance_m=0.0)
    for altitude_m, is_closed in ((29.9, False), (30.0, True), (50.0, True), (50.1, False)):
        assert constraints.closed(maps, altitude_m).any() == is_closed
    for between_m in (30.0, 25.0):  # from 25 to 55 m no climb passes it
        counts = [
            closed.sum() for closed in constraints.closed(maps, [20.0, between_m, 55.0, 60.0])
        ]
        assert counts == [0, 25, 0, 0]


def test_a_zone_that_ends_below_the_ground_is_refused(maps):
    for ceiling_m in (-9999.0, 0.0):
        with pytest.raises(ju.InputError, match="the ceiling above 0"):
            zone_of_cells(maps, 40, 30, 5, ceiling_m=ceiling_m)


def test_between_two_altitudes_a_bound_must_hold_at_both_or_above_a_wall(maps):
    bound = Bound("lidar", ">=", 0.4)
    low, high = (maps.m("lidar", z_m) >= 0.4 for z_m in (20.0, 60.0))
    by_hand = (low | (maps.m("obstacle", 20.0) == 1)) & high
    assert np.array_equal(bound.is_kept(maps, 35.0), by_hand)
    assert np.array_equal(bound.is_kept(maps, 60.0), high)


def test_where_there_are_no_data_no_bound_holds(maps):
    has_data = maps.ds["has_data"].copy()
    has_data[:5] = False
    holey = ju.MetricMaps(maps.ds.assign(has_data=has_data))
    constraints = ju.Constraints.read(require="roof>=0", vertical_clearance_m=0.0)
    assert constraints.closed(holey, ALTITUDE_M).sum() == 5 * maps.grid.num_cols


@pytest.mark.slow
@pytest.mark.parametrize("require", ["lidar>=0.3", "num_visible>=4"])
@pytest.mark.parametrize("planner", ["ptp", "astar-dist", "astar-plus", "bitstar-plus"])
def test_no_planner_enters_a_zone_or_breaks_a_bound(maps, ends, planner, require):
    outline = shapely.LineString([xy_m[:2] for xy_m in ends.values()]).centroid.buffer(
        120.0, quad_segs=3
    )
    constraints = ju.Constraints(
        (Zone("heliport", outline, maps.grid.crs),), (Bound.parse(require),)
    )
    how = {"planner": planner, "cost_model": "line", "budget_s": 0.3, "snap": 500.0}
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=constraints, **how)
    assert path.status.has_path == (planner != "ptp")
    if path.status.has_path:
        line = shapely.LineString(path.xy_m)
        assert not line.intersects(outline)
        cells = np.argwhere(~ju.Constraints((), constraints.bounds).closed(maps, ALTITUDE_M))
        kept = shapely.union_all(cell_boxes(maps.grid, cells, 1))
        assert kept.buffer(1e-6).covers(line)


def test_zones_with_swapped_coordinates_are_refused_by_plans_and_checks(maps, ends):
    lon, lat = maps.grid.centre_lonlat
    swapped = Zone(
        "yard", shapely.box(lat - 0.001, lon - 0.001, lat + 0.001, lon + 0.001), source="z.geojson"
    )
    constraints = ju.Constraints((swapped,))
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M)
    for judge in (
        lambda: ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=constraints),
        lambda: ju.check(maps, path, constraints=constraints),
    ):
        with pytest.raises(ju.InputError, match=r"of 'z\.geojson' look swapped"):
            judge()


def test_constraints_that_close_nothing_change_nothing(maps, ends):
    far = Zone("far", shapely.box(10, 10, 11, 11), source="far.kml")
    high = zone_of_cells(maps, 0, 0, 80, floor_m=500.0)
    constraints = ju.Constraints((far, high), (Bound("gps", ">=", 0.0),))
    with pytest.warns(IgnoredZoneWarning, match="no zone of 'far.kml' lies in the maps' region"):
        assert not ju.Constraints((far,), vertical_clearance_m=0.0).closed(maps, ALTITUDE_M).any()
    limited = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=constraints)
    assert limited.cost == ju.plan(maps, **ends, altitude_m=ALTITUDE_M).cost
    assert limited.settings["limits"]["require"] == ["gps>=0"]
    assert (
        limited.settings["limits"]["no_fly"][1].items()
        >= {"name": "park", "floor_m": 500.0}.items()
    )
    assert json.loads(json.dumps(limited.to_dict())) == limited.to_dict()


def test_a_start_within_a_limit_is_told_which_and_where_to_go(maps, ends):
    row, col = (int(value) for value in maps.grid.cell_of_xy(*ends["start"][:2]))
    gps = float(maps.m("gps", ALTITUDE_M)[row, col])
    zone = zone_of_cells(maps, row, col, 3, name="Heliport", ceiling_m=100.0)
    constraints = ju.Constraints((zone,), (Bound("gps", ">=", gps + 0.01),))
    told = rf"the no-fly zone 'Heliport' \(from the ground to 100 m\).*the bound gps>={gps + 0.01:g}.*nearest free"
    with pytest.raises(ju.InputError, match=told):
        ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=constraints)
    moved = ju.plan(
        maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints((zone,)), snap=True
    )
    assert not shapely.LineString(moved.xy_m).intersects(zone.polygon)


def test_a_bound_holds_where_the_map_says_just_that_value(maps):
    values = maps.m("lidar", ALTITUDE_M)
    value = values[values > 0.3].min()
    assert not np.any(
        ju.Constraints.read(require=f"lidar>={value}").closed(maps, ALTITUDE_M) & (values == value)
    )


def test_bounds_are_read_from_texts():
    expected = ju.Constraints((), (Bound("gps", ">=", 0.3), Bound("num_visible", ">", 4.0)))
    assert ju.Constraints.read(require=["gps>=0.3", " num_visible > 4"]) == expected
    assert str(expected) == "gps>=0.3, num_visible>4, vertical clearance of 3 m"
    assert str(ju.Constraints.read(vertical_clearance_m=0.0)) == ""


def test_the_command_line_takes_files_and_bounds(folder, maps, ends, tmp_path, capsys):
    square = zone_of_cells(maps, 45, 35, 10)
    shape = shapely.geometry.mapping(
        shapely.transform(square.polygon, maps.grid.lonlat_of_xy, interleaved=False)
    )
    feature = {"type": "Feature", "properties": {"name": "park", "height": 9}, "geometry": shape}
    (tmp_path / "zones.geojson").write_text(json.dumps(feature))
    warnings.simplefilter("default", IgnoredZoneWarning)
    options = (
        "--no-fly",
        tmp_path / "zones.geojson",
        "--require",
        "num_visible>=4",
        "--require",
        "risk>0.1",
    )
    code, out, err = run(
        capsys, "plan", folder, *options_of(maps, **ends), *options, "--json", "--snap"
    )
    facts = json.loads(out)
    assert code == 0
    assert "warning: 'height' of 'zones.geojson' not read" in err
    assert [zone["name"] for zone in facts["settings"]["limits"]["no_fly"]] == ["park"]
    assert not shapely.LineString(facts["xy_m"]).intersects(square.polygon)


def test_over_an_obstacle_of_the_map_below_the_upper_maps_value_breaks_a_bound(maps):
    maps = missing_inside(maps)
    gps = np.where(maps.m("roof") == 30.0, maps.m("gps", 60.0), np.nan)
    row, col = np.argwhere(gps == np.nanmin(gps))[0]
    reasons = ju.Constraints.read(require="gps>=0.99").reasons(maps, 35.0, (row, col))
    assert reasons == ["the bound gps>=0.99"]


def of(**vehicle: float) -> ju.Constraints:
    return ju.Constraints(vehicle=ju.Vehicle(**vehicle))


def test_a_clearance_leaves_room_beside_legs_and_is_said(maps):
    limits = ju.Constraints(clearance_m=12.0)
    kept_m = (
        limits.leg_margin_m(10.0),
        ju.Constraints(clearance_m=8.0).leg_margin_m(10.0),
    )  # both close the cells beside
    assert kept_m == pytest.approx((2.05, 0.0))
    assert str(limits) == "clearance of 12 m, vertical clearance of 3 m"


def test_its_speed_and_power_are_those_of_report_and_mission_unless_others_are_given(
    maps, ends, tmp_path
):
    path = ju.plan(
        maps, **ends, altitude_m=ALTITUDE_M, constraints=of(speed_m_s=8.0, power_w=180.0)
    )
    totals = ju.explain(path, maps).totals
    assert totals["time_s"] == pytest.approx(path.length_m / 8.0)
    assert totals["energy_wh"] == pytest.approx(path.length_m / 8.0 * 180.0 / 3600)
    assert ju.explain(path, maps, speed_m_s=4.0).totals["time_s"] == pytest.approx(
        path.length_m / 4.0
    )
    mission = json.loads(path.save(tmp_path / "route.plan").read_text())["mission"]
    assert mission["cruiseSpeed"] == 8.0
    plain = ju.plan(maps, **ends, altitude_m=ALTITUDE_M)
    assert np.array_equal(plain.xy_m, path.xy_m)  # they close nothing
    assert "time_s" not in ju.explain(plain, maps).totals


def told(path, maps) -> list[str]:
    return [each for each in ju.cautions(path, maps) if each.startswith("Vehicle")]


def test_climbs_and_descents_that_are_too_steep_are_told_and_take_their_time(maps, ends):
    def flown(ends, low_m, high_m, **limits):
        limits = {"speed_m_s": 10.0, "max_climb_m_s": 2.0, "max_descent_m_s": 1.0} | limits
        return plan_volume(
            maps, **ends, start_altitude_m=low_m, goal_altitude_m=high_m, constraints=of(**limits)
        )

    up = flown(ends, 20.0, 60.0)
    moved = np.diff(np.column_stack([up.xy_m, up.z_m]), axis=0)
    air_m = np.linalg.norm(moved, axis=1)
    num = int((10.0 * moved[:, 2] / air_m > 2.0).sum())
    (said,) = told(up, maps)
    assert said.startswith(
        f"Vehicle: legs that would need more than 2 m/s of climb at 10 m/s: {num};"
    )
    at_least_s = np.maximum.reduce([air_m / 10.0, moved[:, 2] / 2.0, -moved[:, 2] / 1.0])
    report = ju.explain(up, maps)
    assert report.totals["time_s"] == pytest.approx(at_least_s.sum(), rel=1e-9)
    assert report.segments["time_s"].sum() == pytest.approx(report.totals["time_s"], rel=1e-9)
    turned = dict(zip(ends, reversed(ends.values()), strict=True))
    (said,) = told(flown(turned, 60.0, 20.0), maps)
    assert "more than 1 m/s of descent" in said
    assert told(flown(ends, 20.0, 60.0, max_climb_m_s=10.0), maps) == []


def test_turns_that_are_too_sharp_are_counted_by_heading(maps, ends):
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=of(max_turn_deg=60.0))
    grid = maps.grid
    headings = np.radians(
        [0.0, 0.0, 59.0, 120.0, 185.0, -175.0]
    )  # 0, 59, 61, 65 and 0 degrees (mod 360) of turn
    steps = 10.0 * np.column_stack([np.cos(headings), np.sin(headings)])
    xy_m = np.cumsum([(grid.x_m[50], grid.y_m[40]), *steps], axis=0)
    bent = replace(path, xy_m=xy_m, z_m=np.full(len(xy_m), ALTITUDE_M))
    sharpest = "Vehicle: turns sharper than 60 degrees: 2; the sharpest, of 65 degrees, is 40 m along the route."
    assert told(bent, maps) == [sharpest]
    assert told(replace(bent, xy_m=xy_m[:3], z_m=bent.z_m[:3]), maps) == []


def test_a_scenario_says_it_in_one_table_and_writes_it_back():
    table = {"max_climb_m_s": 3, "speed_m_s": 10, "power_w": 180.0}
    scenario = ju.Scenario.from_dict(REGION | {"vehicle": table})
    assert scenario.vehicle == ju.Vehicle(**table)
    assert "max_turn_deg" not in scenario.to_toml()


@pytest.fixture(scope="module")
def block() -> ju.MetricMaps:
    """One block of 13 x 13 cells of 10 m: the start is in its middle, the goal outside."""
    roof_m = np.zeros((SIDE, SIDE))
    roof_m[9:22, 0:13] = 30.0
    return with_roofs(made_maps(SIDE, SIDE), roof_m)


@pytest.fixture(scope="module")
def inside(block) -> dict:
    return ends_at(block, START_CELL, GOAL_CELL)


def snapped(way, maps, ends, snap) -> float:
    """Return how far one way of planning moves the start."""
    pairs = [tuple(tuple(map(float, maps.grid.lonlat_of_xy(*xy_m[:2]))) for xy_m in ends.values())]
    if way == "study":
        (query,) = make_queries(ju.cost_map(maps, ALTITUDE_M), pairs, snap=snap)
        return 10.0 * np.hypot(*np.subtract(query.start, maps.grid.cell_of_xy(*ends["start"][:2])))
    path = {
        "plan": lambda: ju.plan(maps, **ends, altitude_m=ALTITUDE_M, snap=snap),
        "volume": lambda: plan_volume(maps, **ends, start_altitude_m=20.0, snap=snap),
        "many": lambda: ju.plan_many(maps, pairs, altitude_m=ALTITUDE_M, snap=snap),
    }[way]()
    if way == "many":
        (row,), (path,) = path.rows, path
        if path is None:
            raise ju.InputError(row["message"])
    return path.snap_distance_m[0]


@pytest.mark.parametrize("way", ["plan", "volume", "many", "study"])
def test_a_place_is_moved_by_at_most_50_m_or_as_far_as_is_said(way, block, inside):
    for snap, cap in ((True, "50 m"), (69.0, "69 m")):
        told = rf"70 m away, farther than it may be moved \({cap}\).*snap=7[01]"
        with pytest.raises(ju.InputError, match=told):
            snapped(way, block, inside, snap)
    assert snapped(way, block, inside, 75.0) == pytest.approx(70.0, abs=0.01)
    near = ends_at(block, (15, 10), GOAL_CELL)
    assert snapped(way, block, near, True) == pytest.approx(30.0, abs=0.01)


def test_the_free_cell_nearest_to_the_place_itself_is_taken(block, inside):
    corner_m = np.array(
        block.grid.xy_of_cell(21, 12)
    )  # whose two free neighbours are as near to its middle
    for aside, cell in (((4.0, 0.0), (21, 13)), ((0.0, 4.0), (22, 12))):
        path = ju.plan(
            block,
            **(inside | {"start": ju.XY(*(corner_m + aside))}),
            altitude_m=ALTITUDE_M,
            snap=True,
        )
        assert tuple(map(int, block.grid.cell_of_xy(*path.xy_m[0]))) == cell
        assert path.snap_distance_m[0] == pytest.approx(6.0)
    for as_far_m in (70.0, np.inf):
        just_as_far = ju.plan(block, **inside, altitude_m=ALTITUDE_M, snap=as_far_m)
        assert just_as_far.snap_distance_m[0] == 70.0


@pytest.mark.slow
def test_how_far_is_told_in_text_json_and_files(block, inside, tmp_path, capsys):
    block.save(tmp_path / "maps")
    arguments = ("plan", tmp_path / "maps", *options_of(block, **inside))
    files = [tmp_path / f"path{suffix}" for suffix in (".geojson", ".kml", ".plan")]
    code, out, _ = run(
        capsys, *arguments, "--snap", 80, *(part for file in files for part in ("-o", file))
    )
    told = "The start was not free: it was moved 70.0 m, to a free cell."
    of_mission = told.replace("free:", "free down to the ground:").replace(
        "cell.", "cell over the ground."
    )
    assert code == 0
    assert of_mission in out
    assert all(of_mission in file.read_text() for file in files)
    (feature,) = json.loads(files[0].read_text())["features"]
    assert feature["properties"]["snap_distance_m"]["start"] == pytest.approx(70.0, abs=0.01)
    facts = json.loads(run(capsys, *arguments, "--snap", 80, "--json")[1])
    assert told in facts["message"]
    assert facts["snap_distance_m"] == pytest.approx({"start": 70.0, "goal": 0.0}, abs=0.01)


@pytest.fixture(scope="module")
def with_court(block) -> ju.MetricMaps:
    """The block with a court of 3 x 2 cells east of the start's middle: 20 m from it, the street 70 m."""
    roof_m = block.m("roof").copy()
    roof_m[14:17, 8:10] = 0
    return with_roofs(block, roof_m)


@pytest.mark.parametrize("way", ["plan", "many", "study"])
def test_a_court_that_is_closed_in_is_passed_for_the_nearest_cell_joined_to_the_other_end(
    way, with_court, inside
):
    assert snapped(way, with_court, inside, 75.0) == pytest.approx(70.0, abs=0.01)
    assert snapped(way, with_court, inside, 25.0) == pytest.approx(
        20.0, abs=0.01
    )  # no such cell within reach
    backward = dict(zip(inside, reversed(inside.values()), strict=True))
    path = ju.plan(with_court, **backward, altitude_m=ALTITUDE_M, snap=75.0)
    assert path.status.has_path
    assert path.snap_distance_m == pytest.approx((0.0, 70.0), abs=0.01)
    assert (
        "The goal was not free: it was moved 70.0 m, to a free cell." in path.to_dict()["message"]
    )


def test_two_ends_in_the_block_move_to_cells_that_are_joined(with_court):
    """Together they move the least: both into the court, although the street is as near to the second one."""
    near, far = (
        ju.plan(
            with_court, **ends_at(with_court, (15, 7), goal), altitude_m=ALTITUDE_M, snap=True
        ).snap_distance_m
        for goal in ((15, 11), (9, 12))
    )
    assert near == pytest.approx((10.0, 20.0), abs=0.01)
    assert far[0] == pytest.approx(10.0)


def test_no_path_names_the_pocket_and_the_nearest_cell_that_is_joined(with_court, inside):
    message = ju.plan(with_court, **inside, altitude_m=ALTITUDE_M, snap=25.0).to_dict()["message"]
    pocket = "The start lies in a pocket of 6 free cells, and the nearest cell that is joined to the goal is 50 m"
    assert pocket in message


@pytest.mark.parametrize("turn", [False, True])
def test_a_free_place_in_a_pocket_is_moved_out_of_it_only_where_snapping_is_on(with_court, turn):
    ends = ends_at(with_court, (15, 9), GOAL_CELL)
    if turn:
        ends = dict(zip(ends, reversed(ends.values()), strict=True))
    stays = ju.plan(with_court, **ends, altitude_m=ALTITUDE_M)
    assert stays.status is Status.NO_PATH
    assert stays.snap_distance_m == pytest.approx((0.0, 0.0), abs=0.01)
    path = ju.plan(with_court, **ends, altitude_m=ALTITUDE_M, snap=True)
    assert path.status.has_path
    assert path.snap_distance_m[turn] == pytest.approx(40.0)
    assert path.snap_distance_m[not turn] == pytest.approx(0.0, abs=0.01)
    name = "goal" if turn else "start"
    assert f"The {name} lay in a pocket: it was moved 40.0 m, to a free cell." in path.message


def test_what_closes_the_way_comes_first_and_nothing_is_searched(with_court, inside):
    path = ju.plan(with_court, **inside, altitude_m=ALTITUDE_M, snap=25.0)
    lon, lat = with_court.grid.lonlat_of_cell(15, 10)  # the wall east of the court
    ends_there = f"ends at {lon:.6f},{lat:.6f}, which is inside an obstacle (or where there are no data) at 20 m"
    assert path.message.startswith(
        f"{path.search.sentence} The start lies in a pocket of 6 free cells"
    )
    assert f"{ends_there}. Start and goal are joined at 60 m." in path.message
    assert (path.status, path.search.num_expanded) == (Status.NO_PATH, 0)


def test_a_corner_between_two_closed_cells_ends_the_way_too(block):
    roof_m = np.zeros((SIDE, SIDE))
    roof_m[5, :6] = roof_m[:6, 5] = 30.0
    roof_m[5, 5] = 0.0
    maps = with_roofs(block, roof_m)
    path = ju.plan(maps, **ends_at(maps, (4, 4), (20, 20)), altitude_m=ALTITUDE_M)
    lon, lat = maps.grid.lonlat_of_cell(5, 4)
    beside = maps.grid.lonlat_of_cell(4, 5)
    assert any(
        f"the way there ends at {x:.6f},{y:.6f}" in path.message for x, y in ((lon, lat), beside)
    )


def test_a_free_place_says_nothing_of_snapping(block, tmp_path):
    path = ju.plan(block, **ends_at(block, (3, 3), GOAL_CELL), altitude_m=20.0, snap=True)
    assert "not free" not in path.to_dict()["message"]
    assert "not free" not in path.save(tmp_path / "path.kml").read_text()
