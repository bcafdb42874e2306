"""Constraints: what they close, that no planner's path goes there, and what they say when they are in the way."""

import itertools
import json
import warnings

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import IgnoredZoneWarning, InputError
from jaxurban.io.read.zone import Zone, cell_boxes
from jaxurban.io.store import write_zarr
from jaxurban.paths.constraints import Bound
from jaxurban.planners.base import Status
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps, missing_inside

ALTITUDE_M = 20.0


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    return {"start_xy_m": maps.grid.xy_of_cell(*free[10]), "goal_xy_m": maps.grid.xy_of_cell(*free[-10])}


def zone_of_cells(maps, row, col, size, name="park", **heights) -> Zone:
    """A square that touches exactly ``size`` x ``size`` cells."""
    (box,) = cell_boxes(maps.grid, np.array([[row, col]]), size)
    return Zone(name, box.buffer(-1.0, join_style="mitre"), maps.grid.crs, **heights)


def test_constraints_close_what_their_zones_touch_and_their_bounds_forbid(maps):
    zone = zone_of_cells(maps, 40, 30, 20, ceiling_m=30.0)
    constraints = ju.Constraints((zone,), (Bound("gps", ">=", 0.5), Bound("density", "<", 30_000)))
    by_hand = np.zeros(maps.grid.shape, bool)
    by_hand[40:60, 30:50] = True
    low = by_hand | (maps.m("gps", 20.0) < 0.5) | (maps.m("density", 20.0, time_of_day="night") >= 30_000)
    high = (maps.m("gps", 60.0) < 0.5) | (maps.m("density", 60.0, time_of_day="night") >= 30_000)
    assert np.array_equal(constraints.closed(maps, 20.0, time_of_day="night"), low)
    assert np.array_equal(constraints.closed(maps, 60.0, time_of_day="night"), high)


def test_a_zone_closes_from_its_floor_to_its_ceiling_both_included(maps):
    constraints = ju.Constraints(
        (zone_of_cells(maps, 40, 30, 5, floor_m=30.0, ceiling_m=50.0),), vertical_clearance_m=0.0
    )
    for altitude_m, is_closed in ((29.9, False), (30.0, True), (50.0, True), (50.1, False)):
        assert constraints.closed(maps, altitude_m).any() == is_closed
    counts = [closed.sum() for closed in constraints.closed(maps, [20.0, 30.0, 55.0, 60.0])]
    assert counts == [0, 25, 0, 0]
    counts = [closed.sum() for closed in constraints.closed(maps, [20.0, 25.0, 55.0, 60.0])]
    assert counts == [0, 25, 0, 0]  # between 25 and 55 m: no climb passes it


def test_between_two_altitudes_a_bound_must_hold_at_both_or_above_a_wall(maps):
    bound = Bound("lidar", ">=", 0.4)
    low, high = (maps.m("lidar", z_m) >= 0.4 for z_m in (20.0, 60.0))
    by_hand = (low | (maps.m("obstacle", 20.0) == 1)) & high
    assert np.array_equal(bound.is_kept(maps, 35.0), by_hand)
    assert np.array_equal(bound.is_kept(maps, 60.0), high)
    with pytest.raises(InputError, match="no maps for altitude 61"):
        bound.is_kept(maps, 61.0)


def test_where_there_are_no_data_no_bound_holds(maps):
    has_data = maps.ds["has_data"].copy()
    has_data[:5] = False
    holey = ju.MetricMaps(maps.ds.assign(has_data=has_data))
    assert (
        ju.Constraints.read(require="roof>=0", vertical_clearance_m=0.0).closed(holey, ALTITUDE_M).sum()
        == 5 * maps.grid.num_cols
    )


@pytest.mark.parametrize("require", ["lidar>=0.3", "num_visible>=4"])
@pytest.mark.parametrize("planner", ["ptp", "astar-dist", "astar-plus", "bitstar-plus"])
def test_no_planner_enters_a_zone_or_breaks_a_bound(maps, ends, planner, require):
    (start, goal) = (shapely.Point(ends[name]) for name in ("start_xy_m", "goal_xy_m"))
    middle = shapely.LineString([start, goal]).interpolate(0.5, normalized=True)
    outline = middle.buffer(120.0, quad_segs=3)
    constraints = ju.Constraints((Zone("heliport", outline, maps.grid.crs),), (Bound.parse(require),))
    path = ju.plan(
        maps,
        **ends,
        altitude_m=ALTITUDE_M,
        planner=planner,
        constraints=constraints,
        snap=500.0,
        cost_model="line",
        budget_s=0.5,
    )
    assert path.status.has_path == (planner != "ptp")
    if path.status.has_path:
        line = shapely.LineString(path.xy_m)
        assert not line.intersects(outline)
        rows, cols = np.nonzero(~ju.Constraints((), constraints.bounds).closed(maps, ALTITUDE_M))
        kept = shapely.union_all(cell_boxes(maps.grid, np.column_stack([rows, cols]), 1))
        assert kept.buffer(1e-6).covers(line)


def test_constraints_that_close_nothing_change_nothing(maps, ends):
    far = Zone("far", shapely.box(10, 10, 11, 11))
    high = zone_of_cells(maps, 0, 0, 80, floor_m=500.0)
    plain = ju.plan(maps, **ends, altitude_m=ALTITUDE_M)
    limited = ju.plan(
        maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints((far, high), (Bound("gps", ">=", 0.0),))
    )
    assert limited.cost == plain.cost
    assert limited.settings["limits"]["require"] == ["gps>=0"]
    assert limited.settings["limits"]["no_fly"][1].items() >= {"name": "park", "floor_m": 500.0}.items()
    assert json.loads(json.dumps(limited.to_dict())) == limited.to_dict()


def test_a_start_within_a_limit_is_told_which_and_where_to_go(maps, ends):
    row, col = (int(value) for value in maps.grid.cell_of_xy(*ends["start_xy_m"]))
    gps = float(maps.m("gps", ALTITUDE_M)[row, col])
    zone = zone_of_cells(maps, row, col, 3, name="Heliport", ceiling_m=100.0)
    constraints = ju.Constraints((zone,), (Bound("gps", ">=", gps + 0.01),))
    with pytest.raises(InputError) as caught:
        ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=constraints)
    for words in (
        "the no-fly zone 'Heliport' (from the ground to 100 m)",
        f"the bound gps>={gps + 0.01:g}",
        "nearest free",
    ):
        assert words in str(caught.value)
    moved = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints((zone,)), snap=True)
    assert not shapely.LineString(moved.xy_m).intersects(zone.polygon)


def test_without_a_path_the_constraints_are_named(maps, ends):
    rows = (int(maps.grid.cell_of_xy(*ends[name])[0]) for name in ("start_xy_m", "goal_xy_m"))
    wall = shapely.box(maps.grid.x_min_m, 0, maps.grid.x_max_m, 10).buffer(-1, join_style="mitre")
    zone = Zone("wall", shapely.affinity.translate(wall, 0, maps.grid.y_m[sum(rows) // 2]), maps.grid.crs)
    zone = Zone("wall", zone.polygon.buffer(20.0, join_style="mitre"), maps.grid.crs)
    path = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints((zone,)))
    assert path.status is Status.NO_PATH
    assert "Constraints were on (1 no-fly zone, vertical clearance of 3 m): they close" in path.to_dict()["message"]


def test_constraints_that_close_everything_are_refused(maps, ends):
    with pytest.raises(
        InputError, match=r"no cell is free at this altitude: .* loosen the constraints \(hdop<=0.1, vertical clear"
    ):
        ju.plan(maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints.read(require="hdop<=0.1"), snap=True)


def test_a_bound_holds_where_the_map_says_just_that_value(maps):
    values = maps.m("lidar", ALTITUDE_M)
    value = values[values > 0.3].min()
    assert not np.any(ju.Constraints.read(require=f"lidar>={value}").closed(maps, ALTITUDE_M) & (values == value))


def test_bounds_are_read_from_texts():
    expected = ju.Constraints((), (Bound("gps", ">=", 0.3), Bound("num_visible", ">", 4.0)))
    assert ju.Constraints.read(require=["gps>=0.3", " num_visible > 4"]) == expected
    assert str(expected) == "gps>=0.3, num_visible>4, vertical clearance of 3 m"
    assert str(ju.Constraints.read(vertical_clearance_m=0.0)) == ""


@pytest.mark.parametrize(
    ("require", "words"),
    [
        ("gps=>0.3", "comparison '=>': use >=, <=, >, <"),
        ("gps==0.3", "comparison '=='"),
        ("gps>=much", "must read name"),
        ("0.3", "must read name"),
        ("gps>=nan", "finite number"),
        ("hdop<=inf", "finite number"),
        ("gps>=30", "lies in 0 to 1"),
    ],
)
def test_a_bound_that_cannot_be_read_is_refused_in_one_sentence(require, words):
    with pytest.raises(InputError, match=words) as caught:
        ju.Constraints.read(require=require)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("require", "words"), [("gpz>0.3", "did you mean 'gps'"), ("gps_epoch_mean>0", "do not hold")])
def test_a_bound_on_a_map_that_is_not_there_names_those_that_are(maps, require, words):
    with pytest.raises(InputError, match=words):
        ju.Constraints.read(require=require).closed(maps, ALTITUDE_M)


def test_a_file_for_another_place_is_told(maps):
    far = Zone("far", shapely.box(10, 10, 11, 11), source="far.kml")
    with pytest.warns(IgnoredZoneWarning, match="no zone of 'far.kml' lies in the maps' region"):
        assert not ju.Constraints((far,), vertical_clearance_m=0.0).closed(maps, ALTITUDE_M).any()


def test_the_command_line_takes_files_and_bounds(maps, ends, tmp_path, capsys):
    write_zarr(maps.ds, tmp_path / "maps")
    square = zone_of_cells(maps, 45, 35, 10)
    corners = np.column_stack(maps.grid.lonlat_of_xy(*shapely.get_coordinates(square.polygon).T)).tolist()
    shape = {"type": "Polygon", "coordinates": [corners]}
    feature = {"type": "Feature", "properties": {"name": "park", "height": 9}, "geometry": shape}
    (tmp_path / "zones.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    places = itertools.chain.from_iterable(
        (f"--{name}", "{},{}".format(*maps.grid.lonlat_of_xy(*ends[f"{name}_xy_m"]))) for name in ("start", "goal")
    )
    warnings.simplefilter("default", IgnoredZoneWarning)
    arguments = ("plan", tmp_path / "maps", *places, "--altitude", 20, "--json", "--snap")
    constraints = ("--no-fly", tmp_path / "zones.geojson", "--require", "num_visible>=4", "--require", "risk>0.1")
    code, out, err = run(capsys, *arguments, *constraints)
    facts = json.loads(out)
    assert code == 0
    assert "warning: 'height' of 'zones.geojson' not read" in err
    assert [zone["name"] for zone in facts["settings"]["limits"]["no_fly"]] == ["park"]
    assert not shapely.LineString(facts["xy_m"]).intersects(square.polygon)
    for wrong, words in (
        (("--no-fly", tmp_path / "none.kml"), ("none.kml", "does not exist")),
        (("--require", "gps"), ("gps>=0.3",)),
    ):
        code, out, err = run(capsys, *arguments, *wrong)
        assert (code, out) == (2, "")
        assert_one_sentence(err, *words)


def test_over_an_obstacle_of_the_map_below_the_upper_maps_value_breaks_a_bound(maps):
    maps = missing_inside(maps)
    gps = np.where(maps.m("roof") == 30.0, maps.m("gps", 60.0), np.nan)
    row, col = np.argwhere(gps == np.nanmin(gps))[0]
    reasons = ju.Constraints.read(require="gps>=0.99").reasons(maps, 35.0, (row, col))
    assert reasons == ["the bound gps>=0.99"]
