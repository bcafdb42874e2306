"""check: flights as autopilots fly them, over the ground of the files; a tower where 1.1.0 did not look."""

import json
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.city import City
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.raster import Raster
from tests.made_maps import made_maps

CELL_M, SIDE_M, PIXEL_M = 10.0, 600.0, 2.0
HOME = (100.0, 300.0)  # metres from the southwest corner, as all places here


def ground_m(x_m, y_m):
    """Return a valley across the way east, 40 m deep and 150 m wide."""
    del y_m
    return 60.0 - 40.0 * np.exp(-(((x_m - 300.0) / 75.0) ** 2))


class World(NamedTuple):
    """Maps and the city that they are of, which holds one tower."""

    maps: ju.MetricMaps
    city: City

    def lonlat(self, x_m, y_m) -> list[float]:
        corner = self.maps.grid.bounds_m[:2]
        return [float(value) for value in self.maps.grid.lonlat_of_xy(*np.add(corner, (x_m, y_m)))]

    def plan(self, *items, firmware=3, **more) -> str:
        """Return a .plan that takes off at home to 30 m, of items (command, frame, place, height, four parameters)."""
        lon, lat = self.lonlat(*HOME)
        rows = [(22, 3, HOME, 30.0, ()), *items]
        listed = []
        for number, (command, frame, place, height_m, params) in enumerate(rows, 1):
            east, north = (0, 0) if place is None else self.lonlat(*place)
            values = [*params, *[0, 0, 0, None][len(params) :], north, east, height_m]
            ids = {"type": "SimpleItem", "doJumpId": number, "command": command, "frame": frame}
            listed.append({**ids, "params": values, "autoContinue": True})
        mission = {"version": 2, "firmwareType": firmware, "vehicleType": 2, "items": listed}
        mission |= {"plannedHomePosition": [lat, lon, 0.0]}
        return json.dumps({"fileType": "Plan", "version": 1, "mission": mission} | more)


def world(*towers, terrain=None) -> World:
    """Return a world of towers (centre x and y, width, height) on level ground, or on that of a function."""
    maps = made_maps(60, 60, (0.5, 200.0))
    ds = maps.ds.drop_vars("terrain", errors="ignore")
    grid = maps.grid
    corner_m = np.array(grid.bounds_m[:2])
    raster = None
    if terrain is not None:
        centres_m = (np.arange(60) + 0.5) * CELL_M
        cells_m = terrain(*np.meshgrid(centres_m, centres_m))
        ds = ds.assign(terrain=(("y", "x"), cells_m.astype(np.float32)))
        fine_m = (np.arange(-50, 350) + 0.5) * PIXEL_M
        pixels_m = terrain(*np.meshgrid(fine_m, fine_m))[::-1]
        west, north = np.add(corner_m, (-50 * PIXEL_M, 350 * PIXEL_M))
        transform = (PIXEL_M, 0.0, west, 0.0, -PIXEL_M, north)
        raster = Raster(pixels_m.astype(np.float32), transform, grid.crs)
    outlines = [
        shapely.box(
            *np.add(corner_m, (x - w / 2, y - w / 2)), *np.add(corner_m, (x + w / 2, y + w / 2))
        )
        for x, y, w, _ in towers
    ]
    num = len(outlines)
    origin = np.full(num, HeightOrigin.HEIGHT, np.uint8)
    heights_m = np.array([height for *_, height in towers], float)
    buildings = Footprints(
        np.array(outlines, object), heights_m, np.zeros(num), origin, np.zeros(num, bool)
    )
    extent_m = (*corner_m, *(corner_m + SIDE_M))
    return World(replace(maps, ds=ds), City(grid.crs, extent_m, buildings, terrain=raster))


def checked(scene: World, tmp_path, content: str, name="m.plan", **more):
    (tmp_path / name).write_text(content)
    return ju.check(scene.maps, tmp_path / name, sources=scene.city, **more)


WAYPOINT, TURNS, RETURN, JUMP = 16, 18, 20, 177


@pytest.mark.parametrize("firmware", [3, 0])
def test_the_way_out_from_the_edge_of_a_circle_is_judged(tmp_path, firmware):
    # From home east to a circle around 300, 300; ArduPilot leaves it at 240, 300, and north from there.
    scene = world((240.0, 400.0, 12.0, 60.0))
    items = [
        (TURNS, 3, (300.0, 300.0), 40.0, (2, 0, 60, None)),
        (WAYPOINT, 3, (240.0, 500.0), 40.0, ()),
    ]
    assert checked(scene, tmp_path, scene.plan(*items, firmware=firmware)).state == "findings"
    assert checked(scene, tmp_path, scene.plan(*items, firmware=12)).state == "clean"


def test_around_a_tower_ardupilot_circles_and_does_not_enter_it(tmp_path):
    scene = world((300.0, 300.0, 20.0, 90.0))
    items = [
        (TURNS, 3, (300.0, 300.0), 40.0, (1, 0, 60, None)),
        (WAYPOINT, 3, (240.0, 500.0), 40.0, ()),
    ]
    assert checked(scene, tmp_path, scene.plan(*items)).state == "clean"
    assert checked(scene, tmp_path, scene.plan(*items, firmware=12)).state == "findings"


def test_a_leg_to_a_height_above_the_ground_follows_the_ground_from_its_start(tmp_path):
    scene = world((300.0, 300.0, 10.0, 40.0), terrain=ground_m)
    across = (WAYPOINT, 10, (500.0, 300.0), 30.0, ())
    assert checked(scene, tmp_path, scene.plan(across)).state == "findings"
    level = (WAYPOINT, 3, (500.0, 300.0), 30.0, ())
    assert checked(scene, tmp_path, scene.plan(level)).state == "clean"


def test_heights_above_terrain_that_are_not_known_above_the_sea_are_flown_straight(tmp_path):
    scene = world((10.0, 10.0, 5.0, 5.0), terrain=ridge_m)
    plan = json.loads(scene.plan((WAYPOINT, 0, (500.0, 300.0), None, ())))
    plan["mission"]["items"][1] |= {
        "AltitudeMode": 3,
        "Altitude": 30.0,
        "AMSLAltAboveTerrain": None,
    }
    result = checked(scene, tmp_path, json.dumps(plan))
    assert set(result.findings["kind"]) == {"terrain"}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["kml", "geojson"])
def test_lines_above_the_ground_are_judged_straight_and_along_the_ground(tmp_path, suffix):
    def line(scene):
        ends = [[*scene.lonlat(100.0, 300.0), 30.0], [*scene.lonlat(500.0, 300.0), 30.0]]
        if suffix == "geojson":
            return json.dumps({"type": "LineString", "coordinates": ends})
        texts = " ".join(",".join(map(str, end)) for end in ends)
        mode = "<altitudeMode>relativeToGround</altitudeMode>"
        return f"<kml><LineString>{mode}<coordinates>{texts}</coordinates></LineString></kml>"

    options = {"heights": None if suffix == "kml" else "ground"}

    def kinds(scene):
        result = checked(scene, tmp_path, line(scene), f"m.{suffix}", **options)
        return set(result.findings["kind"])

    assert kinds(world((300.0, 300.0, 10.0, 40.0), terrain=ground_m)) == {"building"}
    assert kinds(world((9.0, 9.0, 5.0, 5.0), terrain=lambda x, y: 70.0 - ground_m(x, y))) == {
        "terrain"
    }
    assert kinds(world((9.0, 9.0, 5.0, 5.0), terrain=ground_m)) == set()


def test_a_jump_at_another_height_is_judged_there(tmp_path):
    scene = world((300.0, 300.0, 10.0, 50.0))
    jump = (JUMP, 2, None, 0.0, (2, 1, 0, 0))
    items = [
        (WAYPOINT, 3, (200.0, 300.0), None, ()),
        (WAYPOINT, 3, (200.0, 400.0), 80.0, ()),
        (WAYPOINT, 3, (400.0, 400.0), 80.0, ()),
        (WAYPOINT, 3, (400.0, 300.0), 30.0, ()),
    ]
    assert checked(scene, tmp_path, scene.plan(*items)).state == "clean"
    assert checked(scene, tmp_path, scene.plan(*items, jump)).state == "findings"


def test_a_tower_beneath_a_return_that_rises_less_near_home_is_found(tmp_path):
    scene = world((112.0, 300.0, 6.0, 85.0))
    items = [(WAYPOINT, 3, (125.0, 300.0), 30.0, ()), (RETURN, 2, None, 0.0, ())]
    away = [(WAYPOINT, 3, (100.0, 330.0), 30.0, ()), (WAYPOINT, 3, (125.0, 330.0), 30.0, ())]
    plan = scene.plan(*away, *items)
    assert checked(scene, tmp_path, plan, return_altitude_m=100.0).state == "findings"
    px4 = scene.plan(*away, *items, firmware=12)
    assert checked(scene, tmp_path, px4, return_altitude_m=100.0).state == "clean"


@pytest.mark.parametrize(("hold_s", "state"), [(0, "not-judged"), (5, "clean")])
def test_a_wall_inside_of_a_corner_that_is_cut_is_not_judged(tmp_path, hold_s, state):
    scene = world((299.0, 301.0, 1.0, 60.0))
    corner = (WAYPOINT, 3, (300.0, 300.0), 30.0, (hold_s, 0, 0, None))
    plan = scene.plan(corner, (WAYPOINT, 3, (300.0, 500.0), 30.0, ()))
    result = checked(scene, tmp_path, plan)
    assert result.state == state, result
    assert all("corners that autopilots cut" in text for text in result.not_judged)


def ridge_m(x_m, y_m):
    return 70.0 - ground_m(x_m, y_m)


LAND, LOITER_TO_ALT = 21, 31


def test_a_landing_is_flown_to_in_its_own_frame(tmp_path):
    # Level at 40 m above the sea into the ridge of 50 m; or 30 m above the ground of the valley, through the tower.
    ridge = world((9.0, 9.0, 5.0, 5.0), terrain=ridge_m)
    items = [(WAYPOINT, 10, (150.0, 300.0), 20.0, ()), (LAND, 3, (500.0, 300.0), 0.0, ())]
    kinds = set(checked(ridge, tmp_path, ridge.plan(*items)).findings["kind"])
    assert kinds == {"terrain"}
    valley = world((300.0, 300.0, 10.0, 40.0), terrain=ground_m)
    items = [(WAYPOINT, 3, (150.0, 300.0), 30.0, ()), (LAND, 10, (500.0, 300.0), 0.0, ())]
    assert checked(valley, tmp_path, valley.plan(*items)).state == "findings"
    assert checked(valley, tmp_path, valley.plan(*items, firmware=12)).state == "clean"


@pytest.mark.parametrize(("firmware", "state"), [(3, "clean"), (12, "findings"), (0, "findings")])
def test_px4_flies_level_to_where_it_climbs_in_a_loiter(tmp_path, firmware, state):
    scene = world((250.0, 300.0, 10.0, 50.0))
    climb = (LOITER_TO_ALT, 3, (300.0, 300.0), 150.0, (0, 0, 0, None))
    assert checked(scene, tmp_path, scene.plan(climb, firmware=firmware)).state == state


@pytest.mark.parametrize(("firmware", "state"), [(3, "findings"), (12, "clean"), (0, "findings")])
def test_a_place_of_a_take_off_counts_where_the_autopilot_reads_it(tmp_path, firmware, state):
    scene = world((200.0, 300.0, 10.0, 50.0))
    onward = (WAYPOINT, 3, (300.0, 300.0), 30.0, ())
    plan = json.loads(scene.plan(onward, firmware=firmware))
    east, north = scene.lonlat(200.0, 400.0)
    plan["mission"]["items"][0]["params"][4:6] = [north, east]
    assert checked(scene, tmp_path, json.dumps(plan)).state == state


@pytest.mark.parametrize(("firmware", "state"), [(3, "findings"), (12, "clean"), (0, "findings")])
def test_a_height_of_zero_is_its_own_for_ardupilot(tmp_path, firmware, state):
    # It sinks to the ground before the house whose floor is at 20 m, or flies on at 30 m through that.
    scene = world((250.0, 300.0, 10.0, 50.0))
    buildings = replace(scene.city.buildings, min_height_m=np.array([20.0]))
    scene = scene._replace(city=replace(scene.city, buildings=buildings, hanging="slabs"))
    items = [
        (WAYPOINT, 3, (x_m, y_m), z_m, ())
        for x_m, y_m, z_m in ((110, 310, 30), (125, 300, 0), (400, 300, 0))
    ]
    assert checked(scene, tmp_path, scene.plan(*items, firmware=firmware)).state == state


@pytest.mark.parametrize(("firmware", "state"), [(3, "clean"), (12, "not-judged")])
def test_px4_cuts_corners_by_the_radius_that_an_item_accepts(tmp_path, firmware, state):
    scene = world((285.0, 315.0, 6.0, 60.0))
    items = [
        (WAYPOINT, 3, (300.0, 300.0), 30.0, (0, 40, 0, None)),
        (WAYPOINT, 3, (300.0, 500.0), 30.0, ()),
    ]
    assert checked(scene, tmp_path, scene.plan(*items, firmware=firmware)).state == state


def test_a_radius_that_ardupilot_rounds_is_not_judged(tmp_path):
    scene = world((9.0, 9.0, 5.0, 5.0))
    circle = (TURNS, 3, (300.0, 300.0), 60.0, (1, 0, 30.5, None))
    result = checked(scene, tmp_path, scene.plan(circle))
    assert (result.state, "rounds down" in result.not_judged[0]) == ("not-judged", True)


def bumpy_m(x_m, y_m):
    """Return ground with a bump of 6 m that cells of 10 m do not show."""
    return 3.0 * np.cos(np.pi * x_m / CELL_M) * np.cos(np.pi * y_m / CELL_M) + 0.04 * x_m


def test_buildings_stand_on_the_ground_of_the_file_and_not_of_the_cells(tmp_path):
    # Between the centres of cells the ground is up to 3 m higher than these.
    scene = world((300.0, 300.0, 1.5, 40.0), terrain=bumpy_m)
    level_m = float(bumpy_m(300.0, 300.0)) + 39.0
    ends = [[*scene.lonlat(x_m, 300.0), level_m] for x_m in (250.0, 350.0)]
    content = json.dumps({"type": "LineString", "coordinates": ends})
    options = {"heights": "geoid", "home": tuple(scene.lonlat(250.0, 300.0))}
    result = checked(scene, tmp_path, content, "m.geojson", **options)
    assert result.findings["what"].str.contains("through a building").any()
    over = json.dumps(
        {"type": "LineString", "coordinates": [[*end[:2], level_m + 5.0] for end in ends]}
    )
    assert checked(scene, tmp_path, over, "m.geojson", **options).state == "clean"


def test_where_the_files_are_gone_what_the_ground_may_be_off_counts(tmp_path):
    slope = world(terrain=lambda x_m, y_m: 0.5 * x_m + 0.0 * y_m)
    touched = np.zeros(slope.maps.ds["roof_touched"].shape, np.float32)
    touched[30, 30] = 40.0
    ds = slope.maps.ds.assign(roof_touched=(("y", "x"), touched))
    maps = replace(slope.maps, ds=ds)

    def state(over_m):
        top_m = 0.5 * 305.0 + 40.0 + over_m
        ends = [[*slope.lonlat(305.0, y_m), top_m] for y_m in (250.0, 350.0)]
        (tmp_path / "m.geojson").write_text(json.dumps({"type": "LineString", "coordinates": ends}))
        home = tuple(slope.lonlat(305.0, 250.0))
        return ju.check(maps, tmp_path / "m.geojson", heights="geoid", home=home)

    assert state(2.0).state == "findings"
    unsure = state(6.0)
    assert (unsure.state, len(unsure.not_judged)) == ("not-judged", 1)
    assert "than the ground is known, by up to 7.5 m" in unsure.not_judged[0]
    assert state(12.0).state == "clean"


def test_a_clearance_that_holds_too_many_buildings_is_refused(tmp_path, monkeypatch):
    scene = world(*((x_m, 400.0, 2.0, 5.0) for x_m in range(100, 500, 4)))
    plan = scene.plan((WAYPOINT, 3, (500.0, 300.0), 60.0, ()))
    monkeypatch.setattr("jaxurban.flights.contacts.MOST_PAIRS", 20_000)
    assert (
        checked(scene, tmp_path, plan, constraints=ju.Constraints(clearance_m=5.0)).state == "clean"
    )
    with pytest.raises(ju.InputError, match=r"150 m is too far: \d+ outlines are as near"):
        checked(scene, tmp_path, plan, constraints=ju.Constraints(clearance_m=150.0))


def test_the_line_over_people_holds_legs_whose_height_is_open(tmp_path):
    scene = world((9.0, 9.0, 5.0, 5.0))
    items = [(WAYPOINT, 3, (500.0, 300.0), 30.0, ()), (RETURN, 2, None, 0.0, ())]
    flight = checked(scene, tmp_path, scene.plan(*items)).flight
    over_m = np.linalg.norm(np.diff(flight.line_m[:, :2], axis=0), axis=1).sum()
    assert over_m == pytest.approx(800.0, abs=1.0)
    assert flight.line_m[:, 2].max() == pytest.approx(30.0)
    assert any("height is open" in text for text in flight.off_line)


def test_a_return_comes_down_from_the_height_at_which_it_flies(tmp_path):
    scene = world((9.0, 9.0, 5.0, 5.0), terrain=lambda x_m, y_m: 60.0 + 0.0 * (x_m + y_m))
    items = [(WAYPOINT, 3, (500.0, 300.0), 30.0, ()), (RETURN, 2, None, 0.0, ())]
    result = checked(scene, tmp_path, scene.plan(*items), return_altitude_m=50.0)
    assert result.flight.steps.z_m.max() == pytest.approx(50.0, abs=0.1)


@pytest.mark.slow
def test_only_a_return_from_a_known_height_is_answered_by_a_return_altitude(tmp_path):
    scene = world((10.0, 10.0, 5.0, 5.0))
    level = (WAYPOINT, 3, (500.0, 300.0), 30.0, ())
    open_climb = (22, 3, HOME, None, ())
    moved = (179, 0, (300.0, 300.0), 0.0, ())
    home = (RETURN, 2, None, 0.0, ())
    for items, is_asked in (
        ([level, home], True),
        ([moved, level, home], False),
        ([(21, 3, None, 0.0, ()), open_climb], False),
        ([(21, 3, None, 0.0, ()), open_climb, home], False),
    ):
        for altitude_m in (None, 60.0):
            result = checked(scene, tmp_path, scene.plan(*items), return_altitude_m=altitude_m)
            said = " ".join(result.not_judged)
            assert ("--return-altitude" in said) == (is_asked and altitude_m is None)
            assert ("that the file leaves open" in said) == (not is_asked or altitude_m is None)
            assert "--home)" not in said


@pytest.mark.parametrize("end", [(17, 3, (300.0, 300.0), 30.0, ()), (JUMP, 2, None, 0, (2, -1))])
def test_no_finding_is_made_in_what_is_never_flown(tmp_path, end):
    scene = world((500.0, 300.0, 20.0, 60.0))
    way = (WAYPOINT, 3, (300.0, 300.0), 30.0, ())
    into = (WAYPOINT, 3, (550.0, 300.0), 30.0, ())
    assert checked(scene, tmp_path, scene.plan(way, into)).state == "findings"
    result = checked(scene, tmp_path, scene.plan(way, end, into))
    assert (result.state, len(result.not_judged)) == ("not-judged", 1)
