"""Least return altitudes of items, against the check's own judging of the way home and points every 20 cm of it."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.flights.item_returns import return_lines
from jaxurban.flights.missions.parts import Leg, Mission, Place
from jaxurban.io.city import City
from jaxurban.public import listed
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.raster import Raster
from tests.made_maps import made_maps

SIDE_M, NUM = 600.0, 60
CLEAR_M, ABOVE_M = 6.0, 3.0
LIMITS = ju.Constraints(clearance_m=CLEAR_M, vertical_clearance_m=ABOVE_M)
GUESS_M, BOUND_M = 20.0, 55.0


def scene_of(hills: bool, guessed: int = 0, bound_m: float = BOUND_M) -> tuple[ju.MetricMaps, City]:
    """Return maps of 600 m and their city: 49 turned houses, the first ones of guessed height, on hills or not."""
    rng = np.random.default_rng(65)
    maps = made_maps(NUM, NUM, (0.5, 400.0))
    grid = maps.grid
    row, col = np.indices(grid.shape)
    hills_m = (30 + 12 * np.sin(row / 9) + 8 * np.cos(col / 7) + 0.3 * row).astype(np.float32)
    corner_m = np.array([grid.x_min_m, grid.y_min_m])
    outlines = []
    for centre_m in np.stack(np.meshgrid(*[np.arange(60, 600, 80)] * 2), axis=-1).reshape(-1, 2):
        width_m, depth_m = rng.uniform(12, 30, 2)
        box = shapely.box(-width_m / 2, -depth_m / 2, width_m / 2, depth_m / 2)
        turned = shapely.affinity.rotate(box, rng.uniform(0, 90), origin=(0, 0))
        outlines.append(shapely.affinity.translate(turned, *(centre_m + corner_m)))
    num = len(outlines)
    height_m = rng.choice([12.0, 25.0, 40.0, 90.0], num)
    origin = np.full(num, HeightOrigin.HEIGHT, np.uint8)
    origin[:guessed], height_m[:guessed] = HeightOrigin.DEFAULT, GUESS_M
    parts = np.zeros(num, bool)
    limit_m = np.full(num, bound_m)
    buildings = Footprints(
        np.array(outlines), height_m, np.zeros(num), origin, parts, limit_m=limit_m
    )
    terrain = None
    if hills:
        maps = replace(maps, ds=maps.ds.assign(terrain=(("y", "x"), hills_m)))
        north_m = corner_m[1] + SIDE_M
        transform = (grid.resolution_m, 0.0, grid.x_min_m, 0.0, -grid.resolution_m, north_m)
        terrain = Raster(hills_m[::-1], transform, grid.crs)
    extent_m = (*corner_m, *(corner_m + SIDE_M))
    return maps, City(grid.crs, extent_m, buildings, terrain=terrain)


def ways_home(home: Place, places: list[Place], heights_m) -> Mission:
    """Return the straight, level ways home from above places, at heights above home: item 1 is of the first place."""
    legs = []
    for number, (at, height_m) in enumerate(zip(places, heights_m, strict=True), start=1):
        level = Place(*home[:2], height_m, "home")
        legs.append(Leg(level._replace(lon=at.lon, lat=at.lat), level, "leg", number))
    return Mission("ways home", tuple(legs), home[:2], None, (), None)


def mission_over(home: Place, places: list[Place]) -> Mission:
    """Return a mission with a leg from home to each place: item 1 leads to the first."""
    legs = tuple(Leg(home, place, "leg", number) for number, place in enumerate(places, start=1))
    return Mission("all", legs, home[:2], None, (), None)


def places_of(maps, seed: int, num: int) -> list[Place]:
    """Return random places on the maps, 20 m above home, the first of them home itself, on the ground."""
    rng = np.random.default_rng(seed)
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    lonlat = maps.grid.lonlat_at(corner_m + rng.uniform(30, SIDE_M - 30, (num, 2)))
    return [Place(lon, lat, 20.0, "home") for lon, lat in lonlat.tolist()]


def judged(maps, city, mission: Mission):
    return ju.check(maps, mission, sources=city, constraints=LIMITS)


@pytest.mark.slow
@pytest.mark.parametrize("hills", [False, True])
def test_at_the_least_altitude_nothing_is_found_and_a_little_lower_something_is(hills):
    maps, city = scene_of(hills)
    home, *places = places_of(maps, 7, 121)
    table = judged(maps, city, mission_over(home, places)).return_altitudes
    assert table["item"].tolist() == list(range(1, 121))
    assert (table["way_m"] >= table["least_m"]).all()
    assert hills or table["way_m"].equals(table["least_m"])  # each leg begins at home

    at_least = judged(maps, city, ways_home(home, places, table["least_m"]))
    assert at_least.state == "clean", at_least.lines
    steps = at_least.flight.steps
    lowest_m = np.full(len(places), np.inf)
    np.minimum.at(lowest_m, steps.leg, steps.z_m.min(axis=1))
    assert lowest_m.min() >= ABOVE_M - 1e-6

    # Those that are lower meet a building; or the ground decides, which is cleared by the vertical clearance; or an
    # outline that is as far as the clearance in plan, of which a check lets pass what files may take from it.
    # Over hills the highest ground of cells counts, which exceeds that below a line by up to 10 m.
    by_m = 10.0 if hills else 0.1
    lower = judged(maps, city, ways_home(home, places, table["least_m"] - by_m)).findings
    assert set(lower["kind"]) == ({"building", "terrain"} if hills else {"building"})
    is_met = table["item"].isin(lower["item"])
    lines = shapely.linestrings(at_least.flight.lines_m)
    apart_m = shapely.distance(lines[:, None], city.buildings.polygons)
    is_at_clearance = (np.abs(apart_m - CLEAR_M) <= 0.05).any(axis=1)
    is_on_ground = lowest_m <= ABOVE_M + (by_m if hills else 1e-6)
    assert (is_met | is_on_ground | is_at_clearance).all()
    assert is_met.mean() > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("hills", [False, True])
def test_the_way_to_an_item_needs_what_places_along_it_need(hills):
    """Each metre of legs that do not lead through home is flown to alone, and judged from there."""
    maps, city = scene_of(hills)
    rng = np.random.default_rng(3)
    num_more = 0
    for seed in range(6):
        home, begin, end = places_of(maps, seed, 3)
        legs = (Leg(begin, end, "leg", 1),)
        mission = Mission("x", legs, home[:2], None, (), None)
        row = judged(maps, city, mission).return_altitudes.iloc[0]
        shares = np.sort(rng.uniform(size=300))[:, None]
        lonlat = np.array(begin[:2]) + shares * (np.array(end[:2]) - np.array(begin[:2]))
        along = [Place(lon, lat, 20.0, "home") for lon, lat in [*lonlat.tolist(), end[:2]]]
        alone_m = judged(maps, city, mission_over(home, along)).return_altitudes["least_m"]
        assert judged(maps, city, ways_home(home, along, alone_m.to_numpy())).state == "clean"
        assert row["way_m"] >= alone_m.max() - 1e-6
        assert row["way_m"] <= alone_m.max() + (6.0 if hills else 1e-6)
        num_more += row["way_m"] > row["least_m"] + 1
    assert num_more >= 3


@pytest.mark.slow
def test_by_cells_the_way_home_clears_what_the_ground_may_be_off_too():
    maps, _ = scene_of(hills=True)
    home, *places = places_of(maps, 17, 41)
    by_cells = judged(maps, None, mission_over(home, places))
    assert "which may be off by" in by_cells.outlines
    least_m = by_cells.return_altitudes["least_m"]
    assert judged(maps, None, ways_home(home, places, least_m)).state == "clean"
    assert judged(maps, None, ways_home(home, places, least_m - 10.0)).state != "clean"


@pytest.mark.slow
def test_points_along_the_way_home_clear_every_outline_by_the_clearances():
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 11, 61)
    table = judged(maps, city, mission_over(home, places)).return_altitudes
    home_m = np.array(maps.grid.xy_of_lonlat(*home[:2]))
    for place, least_m in zip(places, table["least_m"], strict=True):
        place_m = np.array(maps.grid.xy_of_lonlat(*place[:2]))
        shares = np.linspace(0, 1, int(math.dist(home_m, place_m) / 0.2))[:, None]
        points = shapely.points(home_m + shares * (place_m - home_m))
        apart_m = shapely.distance(points[:, None], city.buildings.polygons[None, :]).min(axis=0)
        tops_m = city.buildings.height_m[apart_m <= CLEAR_M - 0.01]
        highest_m = max(0.0, tops_m.max(initial=0.0))
        unsure_m = city.buildings.height_m[np.abs(apart_m - CLEAR_M) <= 0.01]
        assert least_m == pytest.approx(highest_m + ABOVE_M) or len(unsure_m)


@pytest.mark.slow
def test_a_guessed_roof_is_cleared_by_its_bound_and_without_one_nothing_is_known():
    for bound_m, is_known in ((BOUND_M, True), (math.inf, False)):
        maps, city = scene_of(hills=False, guessed=49, bound_m=bound_m)
        home, *places = places_of(maps, 3, 16)
        result = judged(maps, city, mission_over(home, places))
        table = result.return_altitudes
        crosses = table[~(table["least_m"] == ABOVE_M)]
        assert len(crosses) > 10
        if is_known:
            assert set(crosses["least_m"].round(6)) == {BOUND_M + ABOVE_M}
            assert result.return_lines[0] == "A return at 58 m clears all."
            ways = ways_home(home, places, [BOUND_M + ABOVE_M + 0.01] * len(places))
            assert judged(maps, city, ways).state == "clean"
        else:
            assert crosses["least_m"].isna().all()
            assert result.return_lines[0].startswith(
                f"No return altitude is known from item {crosses['item'].iloc[0]} on"
            )


@pytest.mark.slow
def test_a_line_that_leaves_the_maps_has_no_altitude():
    maps, city = scene_of(hills=True)
    inside, home = places_of(maps, 5, 2)
    lon, lat = maps.grid.lonlat_of_xy(maps.grid.x_min_m - 200, maps.grid.y_min_m + 300)
    outside = Place(float(lon), float(lat), 20.0, "home")
    nowhere = Place(106.0, -40.0, 20.0, "home")
    for at_home, there, is_known in (
        (home, inside, True),
        (home, outside, False),
        (outside, inside, False),
        (home, nowhere, False),
    ):
        legs = (Leg(at_home, there, "leg", 1),)
        result = judged(maps, city, Mission("x", legs, at_home[:2], 0.0, (), None))
        table = result.return_altitudes
        assert (table["way_m"].notna().all() and len(table) == 1) == is_known
        assert is_known or any("No return" in text or "outside" in text for text in result.lines)
        # In cells without data it leaves them, too.
        has_data = maps.ds["has_data"].copy(data=np.zeros(maps.grid.shape, bool))
        empty = replace(maps, ds=maps.ds.assign(has_data=has_data))
        assert judged(empty, city, result.flight.mission).return_altitudes["least_m"].isna().all()


def test_home_on_a_roof_counts_heights_from_there():
    maps, city = scene_of(hills=False)
    home, place, *_ = places_of(maps, 9, 2)
    mission = Mission("x", (Leg(home, place, "leg", 1),), home[:2], None, (), None)
    on_ground = judged(maps, city, mission).return_altitudes.iloc[0]
    on_roof = ju.check(
        maps,
        mission,
        sources=city,
        constraints=LIMITS,
        home_above_ground_m=10.0,
    ).return_altitudes.iloc[0]
    assert on_roof["least_m"] == pytest.approx(on_ground["least_m"] - 10.0)
    assert on_roof["own_m"] == on_ground["own_m"] == 20.0


def test_heights_above_the_ground_and_the_sea_are_brought_to_home():
    maps, city = scene_of(hills=True)
    home, place = places_of(maps, 13, 2)
    legs = tuple(
        Leg(home, place._replace(datum=datum), "leg", number)
        for number, datum in enumerate(("home", "ground", "geoid"))
    )
    result = judged(maps, city, Mission("x", legs, home[:2], None, (), None))
    ground = result.flight.ground
    home_m, place_m = (ground.at_lonlat(*each[:2]) for each in (home, place))
    own_m = result.return_altitudes["own_m"].tolist()
    assert own_m == pytest.approx([20.0, 20.0 + place_m - home_m, 20.0 - home_m])


def plan_of(folder, home: Place, places: list[Place], firmware: int) -> str:
    """Return the file of a plan from a take-off at home over places, at their heights above home."""
    file = folder / "mission.plan"
    rows = [(22, home.lon, home.lat, 20.0), *((16, *place[:3]) for place in places)]
    items = [
        {
            "type": "SimpleItem",
            "command": command,
            "frame": 3,
            "params": [0, 0, 0, None, lat, lon, m],
        }
        for command, lon, lat, m in rows
    ]
    mission = {"version": 2, "firmwareType": firmware, "items": items}
    mission["plannedHomePosition"] = [home.lat, home.lon, None]
    file.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    return str(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("firmware", "names"),
    [
        (3, ["RTL_ALT "]),
        (12, ["RTL_RETURN_ALT"]),
        (0, ["RTL_ALT ", "RTL_RETURN_ALT", "nav_rth_altitude"]),
    ],
)
def test_a_plan_is_told_what_to_type_by_its_firmware(tmp_path, firmware, names):
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 15, 5)
    file = plan_of(tmp_path, home, places, firmware)
    result = ju.check(maps, file, sources=city, return_altitude_m=10.0)
    low = result.return_altitudes.query("own_m < way_m")
    most_m = math.ceil(low["way_m"].max())
    first, *typed = result.return_lines
    item = low["item"].iloc[0]
    assert first == f"A return at 10 m fails from item {item} on; {most_m} m clears all."
    assert len(typed) == len(names)
    for line, name in zip(typed, names, strict=True):
        assert f" {name}" in line
    assert all(f"return: {line}" in result.lines for line in result.return_lines)
    assert result.to_dict()["return_lines"] == result.return_lines
    json.dumps(result.to_dict(), allow_nan=False)

    open_height = ju.check(maps, file, sources=city)
    assert open_height.return_lines[0] == f"A return at {most_m} m clears all."
    enough = ju.check(maps, file, sources=city, return_altitude_m=float(most_m))
    assert enough.return_lines[0] == f"A return at {most_m} m clears all."


def test_a_flight_above_all_may_return_at_its_own_height(tmp_path):
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 15, 5)
    high = [place._replace(height_m=150.0) for place in places]
    result = ju.check(maps, plan_of(tmp_path, home, high, 12), sources=city)
    lines = return_lines(result.return_altitudes[1:], result.flight, 120)
    assert lines == ["A return clears all at the height that the flight has, wherever it begins."]


@pytest.mark.slow
def test_a_named_altitude_is_answered_where_every_return_that_fails_is_beyond_the_ceiling():
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 7, 30)
    result = judged(maps, city, mission_over(home, places))
    table = result.return_altitudes.assign(least_m=[200.0, *[1.0] * (len(places) - 1)])
    for named_m, answer in (
        (150.0, f"fails from item {table['item'][0]} on"),
        (250.0, "clears it"),
    ):
        mission = replace(result.flight.mission, return_altitude_m=named_m)
        beyond, line = return_lines(table, replace(result.flight, mission=mission), 120)
        assert f"from the ways to item {table['item'][0]}, which need up to 200 m" in beyond
        assert f"; one at {named_m:g} m {answer}" in line


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["leg", "climb", "land"])
def test_a_straight_descent_or_landing_away_from_home_needs_what_its_place_needs(kind):
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 7, 30)
    table = judged(maps, city, mission_over(home, places)).return_altitudes
    high = places[table["least_m"].argmax()]._replace(height_m=150.0)
    above_home = high._replace(lon=home.lon, lat=home.lat)
    legs = (
        Leg(home._replace(height_m=0.0), above_home, "climb", 1),
        Leg(above_home, high, "leg", 2),
        Leg(high, high._replace(height_m=5.0), kind, 3),
    )
    result = judged(maps, city, Mission("x", legs, home[:2], None, (), None))
    assert result.return_altitudes["item"].tolist() == [2, 3]
    low = result.return_altitudes.iloc[1]
    assert low["own_m"] == pytest.approx(5.0)
    assert low["least_m"] == table["least_m"].max() > 40.0
    assert result.return_lines[0] == f"A return at {math.ceil(low['least_m'])} m clears all."


@pytest.mark.slow
def test_what_is_not_judged_is_not_said_to_be_cleared():
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 7, 30)
    outside = places[-1]._replace(lon=places[-1].lon + 0.1)
    for ends, not_judged in ((places, ("item 9 is not read",)), ([*places, outside], ())):
        mission = replace(mission_over(home, ends), not_judged=not_judged)
        lines = judged(maps, city, mission).return_lines
        assert lines[0].startswith("No return altitude is known") == (outside in ends)
        (line,) = (line for line in lines if "clears" in line)
        assert line.endswith(" m clears all that is judged.")
    high = [place._replace(height_m=150.0) for place in places]
    mission = replace(
        mission_over(high[0]._replace(lon=home.lon, lat=home.lat), high), not_judged=("x",)
    )
    assert judged(maps, city, mission).return_lines == [
        "A return clears all that is judged at the height that the flight has, wherever it begins."
    ]


def test_where_the_cone_alone_fails_the_altitude_is_said_to_be_one_of_a_level_flight(tmp_path):
    maps, city = scene_of(hills=False)
    house = city.buildings.polygons[np.argmax(city.buildings.height_m)]
    west_m, south_m, east_m, north_m = house.bounds
    at = [maps.grid.lonlat_of_xy(x, (south_m + north_m) / 2) for x in (west_m - 3, east_m + 3)]
    home, place = (Place(float(lon), float(lat), 5.0, "home") for lon, lat in at)
    file = plan_of(tmp_path, home, [place], 3)
    lines = ju.check(maps, file, sources=city, return_altitude_m=300.0).return_lines
    assert lines[0] == "A return at 300 m fails from item 2 on; flown level, 93 m clears all."
    assert lines[1].endswith("below the 93.0 m needed: set RTL_CONE_SLOPE = 0.")


def test_no_return_above_the_ceiling_is_typed_and_the_ways_that_need_it_are_named(tmp_path):
    """A way needs more than the ceiling by brute force: the highest roof near points along the ways home."""
    maps, city = scene_of(hills=False)
    home, *places = places_of(maps, 15, 12)
    file = plan_of(tmp_path, home, places, 12)
    ceiling_m = 50
    result = ju.check(maps, file, sources=city, return_altitude_m=10.0, ceiling_m=ceiling_m)
    home_m = np.array(maps.grid.xy_of_lonlat(*home[:2]))
    beyond = []
    for item, pair in enumerate(pairwise(places), start=3):
        ends_m = [np.array(maps.grid.xy_of_lonlat(*each[:2])) for each in pair]
        fan = shapely.Polygon([home_m, *ends_m])
        roofs_m = city.buildings.height_m[shapely.intersects(fan, city.buildings.polygons)]
        if roofs_m.max(initial=0.0) + 3.0 > ceiling_m:
            beyond.append(item)
    first, second, typed = result.return_lines
    assert first.startswith(
        "No return up to the ceiling, 50 m above the ground at home, clears all"
    )
    named = first.split(" to items ")[1].split(", which need up to 93 m")[0]
    numbers = set(result.return_altitudes.query("way_m > 50")["item"])
    assert numbers - {2} == set(beyond)
    assert named == listed([str(item) for item in sorted(numbers)])
    assert first.endswith("set a rally point there, or return along the way flown.")
    assert second.endswith("; 43 m clears all from elsewhere.")
    assert typed.startswith("PX4: RTL_RETURN_ALT = 43 (m)")

    # From a roof the ceiling is as much nearer.
    on_roof = ju.check(
        maps, file, sources=city, return_altitude_m=10.0, ceiling_m=50, home_above_ground_m=10.0
    )
    assert "RTL_RETURN_ALT = 33 " in on_roof.return_lines[-1]
    too_low = ju.check(maps, file, sources=city, ceiling_m=14)
    assert not any("RTL_RETURN_ALT" in line for line in too_low.return_lines)


def test_a_mission_without_home_has_no_row():
    maps, city = scene_of(hills=False)
    first, second = (place._replace(datum="ground") for place in places_of(maps, 15, 2))
    mission = Mission("x", (Leg(first, second, "leg", 1),), None, None, (), None)
    result = judged(maps, city, mission)
    assert (len(result.return_altitudes), result.return_lines) == (0, [])
