"""simplify: what it says, what it costs, and that missions of tens come out of paths of hundreds and stay sound."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely

import jaxurban as ju
from benchmarks.random_routes import READERS
from jaxurban.io.zone import Zone
from jaxurban.planners.base import Status
from jaxurban.typing import CostMap
from tests.cli_runs import run
from tests.free_space import Obstacles
from tests.made_maps import made_maps
from tests.volumes import WEIGHTS, options_of

ALTITUDE_M = 20.0


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps(120, 140, (20.0, 60.0), 5.0)


def ends_of(maps):
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    return ju.XY(*maps.grid.xy_of_cell(*free[10])), ju.XY(*maps.grid.xy_of_cell(*free[-10]))


def obstacles(on: CostMap) -> Obstacles:
    return Obstacles(on.is_free, on.grid.resolution_m, on.grid.x_min_m, on.grid.y_min_m)


def written_m(on, file) -> np.ndarray:
    """The places that a mission names, in the maps' CRS."""
    return np.column_stack(on.grid.xy_of_lonlat(*READERS[".plan"](file)[:, :2].T))


@pytest.mark.slow
@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize("planner", ["astar-plus", "theta-star"])
def test_a_mission_of_tens_comes_out_of_a_path_of_hundreds_and_no_leg_of_the_file_enters_a_closed_cell(
    maps, planner, refine, tmp_path
):
    on = ju.cost_map(maps, ALTITUDE_M, weights=WEIGHTS, cost_model="line")
    path = on.plan(*ends_of(maps), planner=planner, refine=refine, budget_s=20.0)
    simple = ju.simplify(path, on, 2.5)
    assert len(simple.xy_m) < (
        70 if refine else 50
    )  # a refined path bends beside walls, where it stays
    if planner == "astar-plus" and not refine:
        assert len(path.xy_m) > 120
    assert simple.length_m == pytest.approx(shapely.LineString(simple.xy_m).length)
    assert simple.cost == pytest.approx(sum(simple.cost_by_layer.values()))
    assert simple.cost == pytest.approx(ju.explain(simple, maps).totals["cost"], rel=1e-9)
    assert simple.cautions == ju.cautions(simple, maps) != path.cautions
    np.testing.assert_allclose(simple.lonlat[[0, -1]], path.lonlat[[0, -1]])
    assert (simple.settings["simplify_m"], simple.zones) == (2.5, path.zones)
    assert (
        shapely.hausdorff_distance(shapely.LineString(path.xy_m), shapely.LineString(simple.xy_m))
        <= 2.5
    )
    flown_m = written_m(on, simple.save(tmp_path / "path.plan"))
    assert len(flown_m) <= len(simple.xy_m)
    assert obstacles(on).crossed_m(flown_m) == 0.0
    assert not obstacles(on).is_pinched(flown_m)


def test_over_terrain_the_file_follows_the_ground_and_still_enters_no_closed_cell(maps, tmp_path):
    x_m, y_m = np.meshgrid(maps.grid.x_m - maps.grid.x_min_m, maps.grid.y_m - maps.grid.y_min_m)
    hill_m = (60.0 + 40.0 * np.sin(x_m / 90.0) * np.cos(y_m / 120.0)).astype(np.float32)
    hilly = ju.MetricMaps(maps.ds.assign(terrain=(("y", "x"), hill_m)))
    on = ju.cost_map(hilly, ALTITUDE_M, weights=WEIGHTS, cost_model="line")
    simple = ju.simplify(on.plan(*ends_of(maps)), on, 2.5)
    flown_m = written_m(on, simple.save(tmp_path / "path.plan"))
    assert len(flown_m) > len(simple.xy_m)
    assert obstacles(on).crossed_m(flown_m) == 0.0


def test_the_message_tells_tolerance_waypoints_and_how_the_cost_changed(maps):
    on = ju.cost_map(maps, ALTITUDE_M, weights=WEIGHTS)
    path = on.plan(*ends_of(maps))
    simple = ju.simplify(path, on, 3.0)
    said = simple.to_dict()["message"]
    assert f"Simplified to 3 m: {len(simple.xy_m)} of {len(path.xy_m)} waypoints, at most " in said
    assert f"the weighted cost is {simple.cost:.3f}, before {path.cost:.3f}." in said
    assert (path.status, simple.status) == (Status.OPTIMAL, Status.FEASIBLE)
    assert simple.to_dict()["num_points"] == len(simple.xy_m)
    assert len(ju.simplify(path, on, 30.0).xy_m) <= len(simple.xy_m)


def test_no_leg_comes_nearer_to_a_wall_than_3_m_or_than_the_path_itself(maps):
    """By Shapely, from the squares of what stands; where the path keeps a clearance, legs need not keep more."""
    row, col = np.nonzero(maps.m("roof_touched") >= ALTITUDE_M)
    x_m, y_m = maps.grid.xy_of_cell(row, col)
    standing = shapely.union_all(shapely.box(x_m - 2.5, y_m - 2.5, x_m + 2.5, y_m + 2.5))
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    own_m, mission_m = [], []
    on = ju.cost_map(maps, ALTITUDE_M, weights=WEIGHTS)
    for start, goal in np.random.default_rng(3).choice(free, (12, 2)):
        ends = [ju.XY(*maps.grid.xy_of_cell(*cell)) for cell in (start, goal)]
        path = on.plan(*ends, planner="astar-plus")
        if path.status.has_path:
            for route, distances_m in ((path, own_m), (ju.simplify(path, on, 2.5), mission_m)):
                distances_m.append(shapely.distance(shapely.LineString(route.xy_m), standing))
    assert len(own_m) > 5
    assert min(own_m) < 3.0
    assert np.all(np.array(mission_m) >= np.minimum(3.0, own_m) - 1e-6)


def test_a_path_around_a_no_fly_zone_and_within_bounds_stays_so_and_its_mission_is_fenced(
    maps, tmp_path
):
    start, goal = ends_of(maps)
    zone = Zone(
        "park", shapely.LineString([start[:2], goal[:2]]).centroid.buffer(60.0), maps.grid.crs
    )
    limits = replace(ju.Constraints.read(require="lidar>=0.3"), zones=(zone,))
    on = ju.cost_map(maps, ALTITUDE_M, constraints=limits, weights=WEIGHTS)
    path = on.plan(start, goal, snap=True)
    assert path.status.has_path
    simple = ju.simplify(path, on, 20.0)
    line = shapely.LineString(simple.xy_m)
    assert not line.intersects(zone.polygon)
    crossed = maps.grid.cell_of_xy(*shapely.get_coordinates(line.segmentize(0.5)).T)
    assert np.all(maps.m("lidar", ALTITUDE_M)[crossed] >= 0.3)
    assert obstacles(on).crossed_m(simple.xy_m) == 0.0
    mission = json.loads(simple.save(tmp_path / "path.plan").read_text())
    assert len(mission["geoFence"]["polygons"]) == 1


def test_a_path_between_levels_keeps_its_climbs_and_its_report(maps):
    on = ju.cost_map(
        maps, ju.Levels(level_step_m=20.0, climb_cost=0.01), weights=WEIGHTS, cost_model="line"
    )
    path = on.plan(*ends_of(maps))
    simple = ju.simplify(path, on, 2.5)
    assert len(simple.xy_m) < len(path.xy_m) / 2
    assert simple.z_m.max() == path.z_m.max()
    assert simple.cost == pytest.approx(sum(simple.cost_by_layer.values()))
    assert simple.cost == pytest.approx(ju.explain(simple, maps).totals["cost"], rel=1e-9)
    assert simple.cost_by_layer["climb"] == pytest.approx(path.cost_by_layer["climb"])


@pytest.mark.slow
def test_the_command_simplifies_missions_unless_told_otherwise_and_says_so(maps, tmp_path, capsys):
    maps.save(tmp_path / "maps")
    start, goal = (place[:2] for place in ends_of(maps))
    # With a clearance above 3 m legs may leave the path; without one, those beside walls may not.
    query = (
        tmp_path / "maps",
        *options_of(maps, start, goal),
        "--snap",
        "--rules",
        "clearance_m=4",
    )
    plan, line = tmp_path / "path.plan", tmp_path / "path.geojson"
    files = ("-o", plan, "-o", line, "-o", tmp_path / "path.gpx")

    def num_waypoints(*options):
        code, out, err = run(capsys, "plan", *query, *files, "--json", *options)
        assert code == 0
        items = json.loads(plan.read_text())["mission"]["items"]
        coordinates = json.loads(line.read_text())["features"][0]["geometry"]["coordinates"]
        return (
            sum(item["command"] in (16, 22) for item in items),
            len(coordinates),
            json.loads(out),
            err,
        )

    few, all_points, facts, err = num_waypoints()
    assert few < 60 < all_points == facts["num_points"]
    said = ("Simplified to 2.5 m", "--simplify 0 keeps every turn", "a landing at the goal")
    assert all(words in err for words in said)
    *_, simplified, _ = num_waypoints("--simplify", 2.5)
    of_file = {*simplified["cautions"]} - {*facts["cautions"]}
    assert of_file
    assert all(f"{plan}: {sentence}" in err for sentence in of_file)
    every, same_points, _, err = num_waypoints("--simplify", 0)
    assert every > few
    assert same_points == all_points
    assert "Simplified" not in err
    coarse, same_few, facts, _ = num_waypoints("--simplify", 8, "--mission", "return")
    assert coarse == same_few == facts["num_points"] <= few
    assert facts["settings"]["simplify_m"] == 8
    assert json.loads(plan.read_text())["mission"]["items"][-1]["command"] == 20
