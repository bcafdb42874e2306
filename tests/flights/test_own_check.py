"""Missions are judged before they are written: none that is written meets a roof, against places every 20 cm."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cli.main import main
from jaxurban.io.zone import Zone
from jaxurban.maps.run import run_scenario
from tests.volumes import ends_at

ALTITUDE_M = 60.0
TAKEOFF, WAYPOINT, LAND = 22, 16, 21
ON_OUTLINE_M = 0.05
FILES = ("x.kml", "x.gpx", "x.geojson")


@pytest.fixture(scope="module")
def city() -> ju.City:
    return ju.demo_city(1_000, 1_000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maps of a synthetic town in a folder, whose run names what they were made of."""
    folder = tmp_path_factory.mktemp("own") / "maps"
    region = {
        "bounds": [-73.974, 40.778, -73.968, 40.782],
        "resolution_m": 5.0,
        "altitudes_m": [20.0, ALTITUDE_M],
    }
    settings = {"region": region, "buildings": {"source": "synthetic"}}
    run_scenario(ju.Scenario.from_dict(settings), folder)
    return folder


def flown_m(maps, file) -> np.ndarray:
    """Return ``[N, 3]`` x, y and height above level ground every 20 cm along a mission, by its file alone."""
    plan = json.loads(file.read_text())
    lat, lon, _ = plan["mission"]["plannedHomePosition"]
    places = [(lon, lat, 0.0)]
    for item in plan["mission"]["items"]:
        if item["command"] in (TAKEOFF, WAYPOINT, LAND):
            lat, lon, height_m = item["params"][4:]
            if item["command"] == LAND:
                places.append((lon, lat, places[-1][2]))
            places.append((lon, lat, height_m))
    lons, lats, z_m = np.array(places).T
    corners_m = np.column_stack([*maps.grid.xy_of_lonlat(lons, lats), z_m])
    parts = []
    for begin_m, end_m in pairwise(corners_m):
        num = int(np.linalg.norm(end_m - begin_m) / 0.2) + 2
        parts.append(np.linspace(begin_m, end_m, num))
    return np.concatenate(parts)


def is_inside(city: ju.City, flown: np.ndarray) -> np.ndarray:
    """Return ``[N]`` whether each place is in a building, or below the ground."""
    standing = city.standing
    place, building = shapely.STRtree(standing.polygons).query(
        shapely.points(flown[:, :2]), predicate="intersects"
    )
    is_hit = flown[:, 2] < -ON_OUTLINE_M
    is_hit[place[flown[place, 2] < standing.height_m[building] - ON_OUTLINE_M]] = True
    return is_hit


def is_roof(maps) -> np.ndarray:
    """Return ``[Y, X]`` whether a cell lies under the flight, with a roof that its middle is in."""
    return maps.is_free(ALTITUDE_M) & (maps.m("roof") > 0)


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["astar-plus", "theta-star"])
def test_what_is_written_meets_no_roof_and_what_is_refused_does(town, city, tmp_path, planner):
    rng = np.random.default_rng(4)
    on = ju.cost_map(town, ALTITUDE_M)
    roofs, free = np.argwhere(is_roof(town)), np.argwhere(on.free_space.to_ground(0))
    file = tmp_path / "x.plan"
    for k in range(16):
        cells = [rng.choice(roofs if bit else free) for bit in (k & 1, k & 2)]
        path = on.plan(**ends_at(town, *cells), planner=planner)
        file.unlink(missing_ok=True)
        if k & 3:  # an end is over a roof
            with pytest.raises(
                ju.InputError, match=r"own check \(cells of 10 m\) finds that it flies"
            ):
                path.save(tmp_path / "x.kml", file)
            assert not file.exists()
            continue
        path.save(tmp_path / "x.kml", file)
        assert not is_inside(city, flown_m(town, file)).any()
        result = ju.check(town, file, sources=city)
        assert result.findings.empty, result


def test_ends_on_the_ground_are_where_all_below_is_free(town, tmp_path):
    box_m = np.add(np.tile(town.grid.bounds_m[:2], 2), [200, 200, 500, 500])
    low = Zone("low", shapely.box(*box_m), town.grid.crs, 5.0, 30.0)
    limits = ju.Constraints(zones=(low,), bounds=ju.Constraints.read(require="gps>=0.5").bounds)
    is_free = limits.is_free_to_ground(town, 600.0)
    expected = town.m("roof_touched") == 0
    for z_m in town.altitudes_m:
        expected &= replace(limits, zones=()).is_free(town, z_m)
    x_m, y_m = np.meshgrid(town.grid.x_m, town.grid.y_m)
    half_m = town.grid.resolution_m / 2
    cells = shapely.box(x_m - half_m, y_m - half_m, x_m + half_m, y_m + half_m)
    expected &= ~shapely.intersects(cells, low.on(town.grid))
    assert (is_free == expected).all()
    assert 0 < is_free.sum() < limits.is_free(town, 600.0).sum()

    # A mission that takes off through the zone is refused, one beside it is not.
    under = np.argwhere(shapely.contains(low.on(town.grid), cells) & (town.m("roof_touched") == 0))
    away = np.argwhere(is_free)[-10]
    on = ju.cost_map(town, 600.0, constraints=ju.Constraints(zones=(low,)))
    with pytest.raises(ju.InputError, match=r"enters the no-fly zone.*moved to free ground"):
        on.plan(**ends_at(town, under[0], away)).save(tmp_path / "x.plan")
    on.plan(**ends_at(town, np.argwhere(is_free)[3], away)).save(tmp_path / "x.plan")


def test_snapping_to_the_ground_takes_the_nearest_cell_that_is_free_below(town):
    on = ju.cost_map(town, ALTITUDE_M)
    free = np.argwhere(on.free_space.to_ground(0))
    roof = np.argwhere(is_roof(town))[7]
    ends = ends_at(town, roof, free[-10])
    with pytest.raises(ju.InputError, match="start is over a roof, or what else closes the way up"):
        on.plan(**ends, on_ground=True)
    path = on.plan(**ends, snap=True, on_ground=True)
    nearest_m = np.hypot(*(free - roof).T).min() * town.grid.resolution_m
    assert path.snap_distance_m[0] == pytest.approx(nearest_m)
    assert "The start was not free down to the ground: it was moved" in path.message
    assert on.plan(**ends, snap=True).snap_distance_m[0] == pytest.approx(0.0)
    (many,) = ju.plan_many(
        town,
        [(ends["start"], ends["goal"])],
        altitude_m=ALTITUDE_M,
        snap=True,
        on_ground=True,
        progress=False,
    )
    assert (many.xy_m == path.xy_m).all()


@pytest.mark.slow
def test_a_flight_from_a_roof_has_its_heights_from_there(town, city, tmp_path, monkeypatch):
    # A mission of another tool, whose home is on the roof.
    on = ju.cost_map(town, ALTITUDE_M)
    roof, goal = np.argwhere(is_roof(town))[7], np.argwhere(on.free_space.to_ground(0))[-10]
    path, file = on.plan(**ends_at(town, roof, goal)), tmp_path / "x.plan"
    with monkeypatch.context() as patched:
        patched.setattr("jaxurban.flights.export.qgc_plan.check_own", lambda *_: "")
        path.save(file)
    roof_m = float(town.m("roof")[tuple(roof)])
    plan = json.loads(file.read_text())
    for item in plan["mission"]["items"]:
        item["params"][6] -= roof_m
        item["Altitude"] -= roof_m
    file.write_text(json.dumps(plan))
    result = ju.check(town, file, sources=city, home_above_ground_m=roof_m)
    assert result.state == "clean", result
    assert result.flight.steps.z_m[0, 0] == pytest.approx(roof_m)

    # It is judged as it stands: from the ground it would start in the house, and fly lower.
    for wrong_m in (None, 0.0, roof_m - 1.0):
        wrong = ju.check(town, file, sources=city, home_above_ground_m=wrong_m)
        assert "building" in set(wrong.findings["kind"]), wrong
    for wrong_m in (roof_m + 0.1, roof_m + 1.0, roof_m + 30.0):  # judged higher than it is flown
        wrong = ju.check(town, file, sources=city, home_above_ground_m=wrong_m)
        assert any("the flight may be lower than judged" in text for text in wrong.not_judged)
        assert wrong.state != "clean"
    lon, lat = map(float, town.grid.lonlat_of_cell(*goal))
    plan["mission"]["plannedHomePosition"][:2] = lat, lon
    (tmp_path / "moved.plan").write_text(json.dumps(plan))
    moved = ju.check(town, tmp_path / "moved.plan", sources=city, home_above_ground_m=roof_m)
    assert moved.state != "clean"
    with pytest.raises(ju.InputError, match="the mission has none"):
        ju.check(town, path, sources=city, home_above_ground_m=3.0)


def test_a_mission_says_how_it_was_checked(town, tmp_path):
    cells = np.argwhere(ju.cost_map(town, ALTITUDE_M).free_space.to_ground(0))[[10, -10]]
    path = ju.plan(town, **ends_at(town, *cells), altitude_m=ALTITUDE_M)
    for route, words in (
        (path, "Checked by cells of 10 m"),
        (replace(path, maps=None), "not checked"),
    ):
        route.save(tmp_path / "x.plan")
        assert words in json.loads((tmp_path / "x.plan").read_text())["note"]


@pytest.mark.slow
def test_the_command_moves_ends_to_the_ground_and_keeps_other_files(folder, tmp_path, capsys):
    maps = ju.open_maps(folder)
    roof, goal = np.argwhere(is_roof(maps))[50], np.argwhere(maps.m("roof_touched") == 0)[-10]
    start, goal = (maps.grid.lonlat_of_cell(*cell) for cell in (roof, goal))
    out = [option for name in (*FILES, "x.plan") for option in ("-o", str(tmp_path / name))]
    words = ["plan", str(folder), "--altitude", str(ALTITUDE_M)]
    for name, (lon, lat) in (("--start", start), ("--goal", goal)):
        words += [name, f"{lon:.8f},{lat:.8f}"]

    def ended(*options: str) -> tuple[int, dict]:
        """Return how the command ends, and its JSON."""
        for name in (*FILES, "x.plan"):
            (tmp_path / name).unlink(missing_ok=True)
        with pytest.raises(SystemExit) as ending:
            main([*words, *out, *options, "--json"])
        return ending.value.code, json.loads(capsys.readouterr().out)

    def is_checked() -> int:
        """Return how the check of the mission ends."""
        with pytest.raises(SystemExit) as ending:
            main(["check", str(folder), str(tmp_path / "x.plan")])
        capsys.readouterr()
        return ending.value.code

    for options in ((), ("--snap", "--ends-in-air")):
        code, facts = ended(*options)
        assert code == facts["exit_code"] == 2
        assert "(exact outlines) finds that it flies through" in facts["message"]
        assert "let its ends be moved to free ground (--snap)" in facts["message"]
        assert all((tmp_path / name).exists() for name in FILES)
        assert not (tmp_path / "x.plan").exists()
    code, facts = ended("--snap")
    assert code == 0
    assert 0 < facts["snap_distance_m"]["start"] <= 50
    assert is_checked() in (0, 6)


def test_the_remedy_of_a_refused_mission_works(town, city, tmp_path):
    on = ju.cost_map(town, ALTITUDE_M)
    roofs, file = np.argwhere(is_roof(town)), tmp_path / "x.plan"
    ends = ends_at(town, roofs[7], roofs[-7])
    file.write_text("older")
    with pytest.raises(ju.InputError, match=r"snap=True.*the older x\.plan stays as it is"):
        on.plan(**ends).save(file)
    assert file.read_text() == "older"
    on.plan(**ends, snap=True, on_ground=True).save(file)
    assert ju.check(town, file, sources=city).findings.empty
    path = on.plan(**ends, snap=True, on_ground="goal")
    assert path.snap_distance_m[0] == pytest.approx(0.0)
    with pytest.raises(ju.InputError, match="on_ground"):
        on.plan(**ends, on_ground="start")


def test_what_is_of_unknown_height_is_not_taken_off_through(town, tmp_path):
    on = ju.cost_map(town, 600.0)
    cells = np.argwhere(on.free_space.to_ground(0))[[10, -10]]
    unknown = np.zeros(town.grid.shape, np.float32)
    unknown[tuple(cells[0])] = 100.0
    names = ("roof_limit", "roof_guessed")
    layers = {
        name: (("y", "x"), unknown if name == "roof_limit" else unknown > 0) for name in names
    }
    path = on.plan(**ends_at(town, *cells))
    path.save(tmp_path / "known.plan")
    guessed = replace(path, maps=ju.MetricMaps(town.ds.assign(layers)))
    with pytest.raises(
        ju.InputError, match=r"unknown height as it takes off.*moved to free ground"
    ):
        guessed.save(tmp_path / "x.plan")
