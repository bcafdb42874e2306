"""Missions that other tools made: each height above what it is above, and nothing that is not understood."""

import json
import time

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.flights.export.write import FORMATS, write_path
from jaxurban.flights.missions.mission import read_mission
from jaxurban.flights.missions.parts import Leg, Place
from jaxurban.world.grid import Grid
from tests.made_files import refused
from tests.mavlink import mission_reader
from tests.volumes import made_path

LON, LAT = 8.5456, 47.3977  # home
STEP = 0.001
GRID = Grid("EPSG:32618", 5.0, 901_000, 116_600, 400, 400)
NO_HOME = "the climb from home is not judged, as the file names no home"
TAKEOFF, WAYPOINT, LAND, RETURN, JUMP, SPLINE = 22, 16, 21, 20, 177, 82
SURVEY = {"type": "ComplexItem", "complexItemType": "survey", "polygon": []}


def item(command=WAYPOINT, *, at=None, z_m=50.0, frame=3, params=(0, 0, 0, None), **more):
    """Return an item, ``at`` steps east of home, or where the vehicle is."""
    lon, lat = (0, 0) if at is None else (round(LON + at * STEP, 7), LAT)
    values = [*params, lat, lon, z_m]
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "frame": frame,
        "params": values,
    } | more


def plan_of(items, **mission):
    numbered = [{"doJumpId": number} | each for number, each in enumerate(items, 1)]
    home = {"plannedHomePosition": [LAT, LON, 488.0]}
    whole = {"version": 2, "firmwareType": 12, "vehicleType": 2, "hoverSpeed": 5, "items": numbered}
    beside = {
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return {"fileType": "Plan", "version": 1, "mission": whole | home | mission} | beside


@pytest.fixture
def read(tmp_path):
    """Return a reader of a mission of items, or of a text under a name."""

    def reading(content, name="mission.plan", *, mission=None, **options):
        if isinstance(content, list):
            content = json.dumps(plan_of(content, **(mission or {})))
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_mission(file, **options)

    return reading


def here(at, height_m, datum="home"):
    return Place(round(LON + at * STEP, 7), LAT, height_m, datum)


def kinds(mission):
    return [(leg.kind, leg.item) for leg in mission.legs]


def waypoints_of(*rows):
    """Return ``QGC WPL 110`` of rows of command, frame, first parameters and place, home first."""
    lines = [
        "\t".join(map(str, (seq, int(seq == 0), frame, command, *params, lat, lon, z_m, 1)))
        for seq, (command, frame, params, lat, lon, z_m) in enumerate(rows)
    ]
    return "\r\n".join(["QGC WPL 110", *lines, ""])


BOX = [item(TAKEOFF, at=0, z_m=30), item(at=1), item(at=2), item(LAND, at=3, z_m=0)]
NONE = (0, 0, 0, 0)


def test_a_plan_climbs_straight_up_flies_its_waypoints_and_comes_down(read):
    mission = read(BOX, mission={"hoverSpeed": 6})
    assert mission.legs == (
        Leg(here(0, 0.0, "ground"), here(0, 30.0), "climb", 1),
        Leg(here(0, 30.0), here(1, 50.0), "leg", 2),
        Leg(here(1, 50.0), here(2, 50.0), "leg", 3),
        Leg(here(2, 50.0), here(3, 50.0), "leg", 4),
        Leg(here(3, 50.0), here(3, 0.0, "ground"), "land", 4),
    )
    assert (mission.home, mission.home_elevation_m) == ((LON, LAT), 488.0)
    assert (mission.name, mission.not_judged, mission.speed_m_s) == ("mission.plan", (), 6.0)


@pytest.mark.parametrize(
    ("frame", "datum"),
    [(0, "geoid"), (5, "geoid"), (3, "home"), (6, "home"), (10, "ground"), (11, "ground")],
)
def test_each_frame_names_what_its_height_is_above(read, frame, datum):
    mission = read([item(TAKEOFF, at=0), item(at=1, z_m=540, frame=frame)])
    assert mission.legs[-1].end == here(1, 540.0, datum)
    assert mission.legs[-1].start == here(0, 50.0)  # of the take-off, whose frame is another


def test_what_qgroundcontrol_calculates_above_terrain_is_above_the_geoid(read):
    calculated = {"AltitudeMode": 3, "Altitude": 16.0}
    known = item(at=1, z_m=499.0, frame=0, AMSLAltAboveTerrain=499.0, **calculated)
    unknown = item(at=2, z_m=None, frame=0, AMSLAltAboveTerrain=None, **calculated)
    mission = read([item(TAKEOFF, at=0), known, unknown])
    assert [leg.end for leg in mission.legs[1:]] == [
        here(1, 499.0, "geoid"),
        here(2, 16.0, "ground"),
    ]


def test_items_and_places_are_those_that_mavsdk_reads(read, tmp_path):
    items = [
        item(TAKEOFF, at=0, z_m=30),
        item(at=1, z_m=540.25, frame=0),
        item(at=2, z_m=45.5, frame=10),
        item(at=3, z_m=60),
    ]
    mission = read(items)
    with mission_reader() as reader:
        raw = reader.missions.import_qgroundcontrol_mission(str(tmp_path / "mission.plan"))
    datums = {0: "geoid", 3: "home", 10: "ground"}
    places = [Place(i.y / 1e7, i.x / 1e7, i.z, datums[i.frame]) for i in raw.mission_items]
    assert [leg.end for leg in mission.legs] == places
    assert [each.command for each in raw.mission_items] == [TAKEOFF, WAYPOINT, WAYPOINT, WAYPOINT]


def test_files_of_jaxurban_say_what_their_heights_are_above(tmp_path):
    ways_m = np.array([[50, 50], [350, 50], [350, 450]])
    route = made_path(GRID, ways_m + np.array([GRID.x_min_m, GRID.y_min_m]))
    for suffix in FORMATS:
        write_path(route, tmp_path / f"route{suffix}")
        mission = read_mission(tmp_path / f"route{suffix}")
        legs = [leg for leg in mission.legs if leg.kind == "leg"]
        places = np.array([legs[0].start[:3], *(leg.end[:3] for leg in legs)])
        np.testing.assert_allclose(places[:, :2], route.lonlat, atol=1e-7)
        np.testing.assert_array_equal(places[:, 2], 60.0)
        is_plan = suffix == ".plan"
        assert {leg.end.datum for leg in legs} == {"home" if is_plan else "ground"}
        assert mission.not_judged == (() if is_plan else (NO_HOME,))


def test_px4_flies_to_its_take_off_and_ardupilot_knows_no_place_of_one(read):
    items = [item(TAKEOFF, at=1, z_m=30), item(at=2)]
    over_home = Leg(here(0, 0.0, "ground"), here(0, 30.0), "climb", 1)
    to_it = Leg(here(0, 30.0), here(1, 30.0), "leg", 1)
    assert read(items, mission={"firmwareType": 12}).legs[:2] == (over_home, to_it)
    direct = Leg(here(0, 30.0), here(2, 50.0), "leg", 2)
    assert read(items, mission={"firmwareType": 3}).legs == (over_home, direct)


def test_a_mission_without_home_begins_at_its_first_item(read):
    mission = read(BOX, mission={"plannedHomePosition": [0, 0, 0]})
    assert (mission.home, mission.home_elevation_m, mission.not_judged) == (None, None, (NO_HOME,))
    assert mission.legs[0] == Leg(here(0, 30.0), here(1, 50.0), "leg", 2)
    mended = read(BOX, mission={"plannedHomePosition": None}, home=(LON, LAT))
    assert mended.legs == read(BOX).legs
    assert mended.home_elevation_m is None


def test_a_mission_without_take_off_does_not_climb(read):
    mission = read([item(at=1), item(at=2)])
    assert kinds(mission) == [("leg", 2)]
    assert "no take-off comes before item 1" in mission.not_judged[0]


def test_an_elevation_of_home_of_zero_is_one_that_is_not_known(read):
    assert read(BOX, mission={"plannedHomePosition": [LAT, LON, 0]}).home_elevation_m is None


@pytest.mark.parametrize("command", [17, 18, 19])
def test_a_loiter_is_a_circle_of_its_radius_at_its_place(read, command):
    circle = item(command, at=1, params=(2, 0, -40, None))
    assert read([BOX[0], circle]).legs[-1] == Leg(here(1, 50.0), here(1, 50.0), "loiter", 2, 40.0)


def test_a_loiter_that_climbs_has_its_radius_second_and_keeps_its_place(read):
    climb = item(31, z_m=90, params=(1, 25, 0, None))  # at latitude and longitude 0
    mission = read([*BOX[:2], climb])
    assert mission.legs[-2:] == (
        Leg(here(1, 50.0), here(1, 90.0), "leg", 3),
        Leg(here(1, 90.0), here(1, 90.0), "loiter", 3, 25.0),
    )


def test_turns_at_the_autopilots_own_radius_are_not_judged(read):
    mission = read([*BOX[:2], item(18, at=1, params=(2, 0, 0, None)), item(19, at=1)])
    assert mission.not_judged == ("item 3 circles at a radius that is the autopilot's own",)
    assert [leg.radius_m for leg in mission.legs if leg.kind == "loiter"] == [0.0, 0.0]


def test_a_height_that_is_left_out_is_the_one_before(read):
    assert read([*BOX[:2], item(at=2, z_m=None)]).legs[-1].end == here(2, 50.0)


def test_the_return_is_open_unless_its_altitude_is_given(read):
    items = [*BOX[:2], item(RETURN, frame=2, z_m=0)]
    over, ground = read(items).legs[-2:]
    assert (over.kind, over.start, over.end[:2]) == ("return", here(1, 50.0), (LON, LAT))
    assert str(over.end.height_m) == "nan"
    assert (ground.kind, ground.end) == ("land", here(0, 0.0, "ground"))
    up, level, down = read(items, return_altitude_m=80.0).legs[-3:]
    at = here(1, 50.0)
    rises = [here(where, 80.0)._replace(level_with=at) for where in (1, 0)]
    assert (up.end, level.end, down.end) == (*rises, here(0, 0.0, "ground"))
    *_, level, _ = read(items, return_altitude_m=20.0).legs
    assert level.end == here(0, 20.0)._replace(level_with=at)  # none goes down for it


def test_a_jump_is_one_leg_back_from_the_item_before_it(read):
    jump = item(JUMP, frame=2, params=(2, 5, 0, 0))
    mission = read([*BOX[:3], jump, *BOX[3:]])
    at = kinds(mission).index(("jump", 2))
    assert mission.legs[at] == Leg(here(2, 50.0), here(1, 50.0), "jump", 2)
    assert mission.legs[at + 1].start == here(2, 50.0)  # and on from there when all are flown
    assert (kinds(mission).count(("jump", 2)), mission.not_judged) == (1, ())
    never = read([*BOX[:3], jump | {"params": [2, 0, *[0] * 5]}, *BOX[3:]])
    assert [leg[:3] for leg in never.legs] == [leg[:3] for leg in read(BOX).legs]


def test_jumps_name_ids_of_a_plan_and_row_numbers_of_waypoints(read):
    items = [each | {"doJumpId": 10 * number} for number, each in enumerate(BOX[:3], 1)]
    assert ("jump", 2) in kinds(read([*items, item(JUMP, frame=2, params=(20, 1, 0, 0))]))
    rows = [(16, 0, NONE, LAT, LON, 488), (22, 3, NONE, 0, 0, 30), (16, 3, NONE, LAT, 8.55, 50)]
    rows += [(16, 10, NONE, LAT, 8.56, 50), (JUMP, 0, (2, -1, 0, 0), 0, 0, 0)]
    jump = read(waypoints_of(*rows), "m.waypoints").legs[-1]
    assert jump == Leg(Place(8.56, LAT, 50, "ground"), Place(8.55, LAT, 50, "home"), "jump", 2)


def test_a_jump_over_cameras_leads_to_the_next_waypoint_and_cycles_end(read):
    camera = item(2000, frame=2)
    there = item(JUMP, frame=2, params=(4, -1, 0, 0))
    back = item(JUMP, frame=2, params=(2, -1, 0, 0))
    mission = read([BOX[0], item(at=1), there, camera, item(at=2), back, item(at=3)])
    assert kinds(mission) == [("climb", 1), ("leg", 2), ("jump", 5), ("jump", 2)]


@pytest.mark.parametrize("target", [6, 99, 2**40, None])
def test_a_jump_that_leads_to_no_item_is_not_judged(read, target):
    mission = read([*BOX[:3], item(JUMP, frame=2, params=(target, 1, 0, 0)), *BOX[3:]])
    assert mission.not_judged == ("the jump of item 4 is not judged: no item is its target",)


@pytest.mark.parametrize(
    ("strange", "what"),
    [
        (
            SURVEY,
            "item 3 is a survey without its waypoints (open and save it in QGroundControl), which is not read",
        ),
        (item(SPLINE, at=2), "item 3 is a spline waypoint, which is not read"),
        (item(94, at=2), "item 3 is command 94, which is not read"),
        (item(192, at=2), "item 3 is command 192, which is not read"),  # DO_REPOSITION
        (item(31_000, at=2), "item 3 is command 31000, which is not read"),
        (
            item(at=2, frame=1),
            "item 3 is command 16 in a frame that is none of the Earth, which is",
        ),
    ],
)
def test_what_is_not_understood_is_named_and_no_leg_from_it_is_invented(read, strange, what):
    mission = read([*BOX[:2], strange, item(at=3), item(at=4)])
    assert mission.not_judged[0].startswith(what)
    assert mission.not_judged[1:] == ("the way from item 3 to item 4 is not judged",)
    assert kinds(mission) == [("climb", 1), ("leg", 2), ("leg", 5)]


def test_what_moves_nothing_is_passed_over(read):
    still = [93, 112, 115, 181, 183, 189, 195, 197, 201, 206, 530, 2000, 2001, 2500]
    items = [*BOX[:2], *(item(command, frame=2, z_m=0) for command in still), *BOX[2:]]
    mission = read(items)
    assert [leg[:3] for leg in mission.legs] == [leg[:3] for leg in read(BOX).legs]
    assert mission.not_judged == ()


def test_the_speed_is_the_first_that_the_mission_sets(read):
    speeds = [item(178, frame=2, params=(1, speed, -1, 0)) for speed in (-1, 7.5, 9)]
    assert read([*speeds, *BOX], mission={"hoverSpeed": 5}).speed_m_s == 7.5


def test_home_that_is_moved_leaves_heights_above_it_open(read):
    moved = item(179, at=1, frame=0, params=(0, 0, 0, 0))
    mission = read([*BOX[:2], moved, item(at=2), item(at=3, frame=0), item(RETURN, frame=2)])
    assert [str(leg.end.height_m) for leg in mission.legs[-2:]] == ["nan", "50.0"]
    assert "item 3 moves home" in mission.not_judged[0]
    assert "the return of item 6 is not judged: home is not known" in mission.not_judged


def test_a_second_take_off_climbs_from_the_landing(read):
    mission = read([*BOX, item(TAKEOFF, z_m=20), item(at=4)])
    climb, onward = mission.legs[-2:]
    assert climb == Leg(here(3, 0.0, "ground"), here(3, 20.0), "climb", 5)
    assert onward.end == here(4, 50.0)
    assert read([*BOX, item(at=4)]).not_judged == ("the way from item 4 to item 5 is not judged",)


def fence_of(kind="polygons", outline=None, **more) -> dict:
    """Return a geofence of one area."""
    outline = outline or [[LAT, LON], [LAT, LON + 1], [LAT + 1, LON]]
    part = {"inclusion": False, kind.removesuffix("s"): outline, "version": 1} | more
    return {"version": 2, "polygons": [], "circles": []} | {kind: [part]}


def read_with(read, geofence: dict):
    """Return the mission of a plan with a geofence."""
    return read(json.dumps(plan_of(BOX) | {"geoFence": geofence}))


def test_a_geofence_is_read_and_what_of_it_is_damaged_is_named(read):
    mission = read_with(read, fence_of())
    assert mission.not_judged == ()
    assert [zone.label for zone in mission.zones] == ["'geofence polygon 1' of 'mission.plan'"]
    assert mission.zones[0].polygon.area == pytest.approx(0.5)
    circle = {"center": [LAT, LON], "radius": 250}
    assert len(read_with(read, fence_of("circles", circle)).zones) == 1
    damages = [
        fence_of(outline=[[LAT, LON], [LAT, LON + 1]]),
        fence_of(outline=[[LAT, LON]] * 4),
        fence_of(outline=[[LAT, LON], [LAT, None], [LAT + 1, LON]]),
        fence_of(outline=[[LAT, LON], [LAT + 90, LON], [LAT, 9.0]]),
        fence_of(inclusion="false"),
        fence_of(version=2),
        fence_of(inclusion=None),
        fence_of("circles", circle | {"radius": 0}),
        fence_of("circles", circle | {"radius": -5}),
        fence_of("circles", circle | {"radius": "NaN"}),
        fence_of("circles", circle | {"radius": 6e6}),  # holds a pole
        fence_of("circles", circle | {"center": [LAT, 999]}),
        fence_of("circles", {"center": [LAT, LON]}),
        fence_of("circles", [[LAT, LON]]),
        {"version": 2, "polygons": [3]},
    ]
    for number, damage in enumerate(damages):
        mission = read_with(read, damage)
        assert (number, mission.zones) == (number, [])
        assert (number, len(mission.not_judged)) == (number, 1)
        assert "is damaged, and not judged" in mission.not_judged[0]
    for more in {"circle": circle}, {"maxAltitude": 30}:
        mission = read_with(read, fence_of(**more))
        assert len(mission.zones) == 1
        (note,) = mission.not_judged
        assert note == f"geofence polygon 1 holds {', '.join(more)}, which is not judged"
    (note,) = read_with(read, fence_of() | {"maxAltitude": 50.0}).not_judged
    assert note == "its part 'maxAltitude' is not judged"
    (note,) = read_with(read, fence_of() | {"version": 1}).not_judged
    assert note == "its version of its geofence is 1, and only 2 is understood"


def test_a_fence_around_the_whole_earth_closes_nothing(read):
    earth = [[lat, lon] for lat in (-90, 90) for lon in (-180, 0, 180)[:: -1 if lat > 0 else 1]]
    mission = read_with(read, fence_of(outline=earth, inclusion=True))
    assert (mission.zones, mission.not_judged) == ([], ())


def test_of_several_areas_to_stay_in_all_are_asked_for(read):
    fence = fence_of(inclusion=True)
    fence["polygons"] *= 2
    fence["polygons"] += [fence_of(outline=[[0, 0], [0, 1], [1, 0]], inclusion=True)["polygons"][0]]
    for firmware in (12, 3, 0):
        plan = plan_of(BOX, firmwareType=firmware) | {"geoFence": fence}
        zones = read(json.dumps(plan)).zones
        assert [zone.name for zone in zones] == ["land outside the geofence"] * 3
        assert zones[-1].polygon.area == pytest.approx(360 * 180 - 0.5)


def test_a_geofence_across_the_antimeridian_is_on_both_sides(read):
    outline = [[LAT, 179.9], [LAT, -179.9], [LAT + 0.1, -179.9], [LAT + 0.1, 179.9]]
    (zone,) = read_with(read, fence_of(outline=outline)).zones
    assert zone.polygon.bounds == pytest.approx((179.9, LAT, 180.1, LAT + 0.1))
    (zone,) = read_with(read, fence_of("circles", {"center": [0, 180], "radius": 1000})).zones
    assert np.ptp(zone.polygon.bounds[::2]) == pytest.approx(2000 / 111_319.5, rel=1e-3)


def test_fences_and_rally_points_are_named_once(read):
    plan = plan_of(BOX) | {"geoFence": {"version": 2, "polygons": [{}, {}], "circles": [{}]}}
    plan |= {"rallyPoints": {"points": [[LAT, LON, 0]]}}
    names = ("polygon 1", "polygon 2", "circle 1")
    damaged = [f"geofence {name} is damaged, and not judged" for name in names]
    assert read(json.dumps(plan)).not_judged == (*damaged, "its rally points are not judged")
    said = ("its geofence is not judged", "its rally points are not judged")
    rows = [
        (5003, 0, NONE, LAT, LON, 0),
        (5003, 0, NONE, LAT, 8.6, 0),
        (5100, 3, NONE, LAT, LON, 9),
    ]
    assert read(waypoints_of(*rows), "fence.txt").not_judged == said


def test_a_point_to_return_to_after_a_breach_is_not_judged(read):
    said = ("its breachReturn point is not judged",)
    assert read_with(read, fence_of() | {"breachReturn": [LAT, LON, 30]}).not_judged == said
    assert read_with(read, fence_of() | {"breachReturn": None}).not_judged == ()


# Numbers of MAV_TYPE in MAVLink's minimal.xml.
@pytest.mark.parametrize(
    ("number", "name"),
    [
        (1, "an aeroplane"),
        *((number, "a VTOL aeroplane") for number in range(19, 26)),
        *((4, "a helicopter"), (10, "a rover"), (11, "a boat"), (12, "a submarine")),
        *((number, "no multicopter") for number in (7, 36, "car")),
    ],
)
def test_a_vehicle_that_is_no_multicopter_is_not_judged_and_named(read, number, name):
    mission = read(BOX, mission={"vehicleType": number, "cruiseSpeed": 18, "hoverSpeed": 5})
    said = f"the vehicle is {name} (vehicleType {number}), and only multicopters are judged"
    assert mission.not_judged == (said,)
    assert mission.speed_m_s == 18


@pytest.mark.parametrize("number", [None, 0, 2, 13, 14, 15, 29, 35, 43])
def test_a_multicopter_is_judged(read, number):
    assert read(BOX, mission={"vehicleType": number}).not_judged == ()


def test_rows_of_waypoints_have_home_first_and_comments(read):
    rows = [(16, 0, NONE, LAT, LON, 488.5), (22, 3, NONE, LAT, 9.0, 30), (21, 3, NONE, 0, 0, 0)]
    text = f"# made by hand\n{waypoints_of(*rows)}\n# the end"
    mission = read(text, "m.txt")
    assert (mission.home, mission.home_elevation_m) == ((LON, LAT), 488.5)
    assert mission.legs == (
        Leg(here(0, 0.0, "ground"), here(0, 30), "climb", 1),
        Leg(here(0, 30), here(0, 0.0, "ground"), "land", 2),
    )
    text = waypoints_of((22, 3, NONE, LAT, LON, 9), (16, 3, NONE, LAT, 9.0, 9))
    no_home = read(text, "m.txt", autopilot="px4")
    assert (no_home.home, no_home.not_judged, len(no_home.legs)) == (None, (NO_HOME,), 1)
    assert read(text, "m.txt").other.legs == no_home.legs


def kml(mode="", coordinates=f"{LON},{LAT},40 8.55,{LAT},45", more=""):
    mode = mode and f"<altitudeMode>{mode}</altitudeMode>"
    line = f"<LineString>{mode}<coordinates>{coordinates}</coordinates></LineString>"
    return f'<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark>{line}</Placemark>{more}</kml>'


GPX = f'<gpx creator="a watch"><rte><rtept lat="{LAT}" lon="{LON}"><ele>40</ele></rtept>'
GPX += f'<rtept lat="{LAT}" lon="8.55"><ele>45</ele></rtept></rte></gpx>'
GEOJSON = {"type": "LineString", "coordinates": [[LON, LAT, 40], [8.55, LAT, 45]]}
CSV = f"lat,lon,alt\n{LAT},{LON},40\n{LAT},8.55,45\n"
LINES = {"m.kml": kml(), "m.gpx": GPX, "m.geojson": json.dumps(GEOJSON), "m.csv": CSV}


@pytest.mark.parametrize(
    "content",
    [
        json.dumps(plan_of([item(TAKEOFF), item(at=1)])),
        json.dumps(dict(reversed(plan_of([item(TAKEOFF), item(at=1)]).items()))),
        json.dumps(plan_of([item(TAKEOFF), item(at=1)])).encode("utf-16"),
        waypoints_of(
            (16, 0, NONE, LAT, LON, 9), (22, 3, NONE, LAT, LON, 9), (16, 3, NONE, LAT, 9.0, 9)
        ),
        kml("absolute"),
        "<?xml version='1.0'?>\n<!-- by hand -->\n" + GPX,
        json.dumps(GEOJSON),
        CSV,
    ],
)
def test_a_mission_is_what_its_content_says_whatever_its_name(read, content):
    names = [f"m{suffix}" for suffix in ("", ".json", ".txt", ".xml", ".csv", ".plan", ".kmz")]
    if not isinstance(content, str):  # UTF-16, which tables of bytes do not know
        names = ["m.json", "m.plan"]
    takes_heights = "fileType" not in str(content) and "QGC" not in str(content)
    heights = "geoid" if takes_heights and isinstance(content, str) else None
    missions = [read(content, name, heights=heights) for name in names]
    assert len(missions[0].legs) >= 1
    assert all(mission.legs == missions[0].legs for mission in missions)


@pytest.mark.parametrize("name", LINES)
def test_heights_whose_datum_a_format_leaves_open_are_asked_for(read, name):
    with pytest.raises(ju.InputError, match="give heights as 'home', 'ground', 'geoid' or 'ellip"):
        read(LINES[name], name)
    mission = read(LINES[name], name, heights="ellipsoid")
    start, end = Place(LON, LAT, 40, "ellipsoid"), Place(8.55, LAT, 45, "ellipsoid")
    assert (mission.legs, mission.not_judged) == ((Leg(start, end, "leg", 2),), (NO_HOME,))


def test_kml_says_what_its_heights_are_above(read):
    assert read(kml("relativeToGround"), "m.kml").legs[0].end.datum == "ground"
    assert read(kml("absolute"), "m.kml").legs[0].end.datum == "geoid"
    assert read(kml("absolute"), "m.kml", heights="ellipsoid").legs[0].end.datum == "ellipsoid"
    with pytest.raises(ju.InputError, match="above the ground: leave heights='geoid' out"):
        read(kml("relativeToGround"), "m.kml", heights="geoid")
    with pytest.raises(ju.InputError, match="altitude mode 'clampToGround'"):
        read(kml("clampToGround"), "m.kml", heights="ground")


def test_a_line_is_climbed_to_from_the_home_that_is_named(read):
    mission = read(LINES["m.csv"], "m.csv", heights="geoid", home=(8.54, LAT))
    over = Place(8.54, LAT, 40, "geoid")
    assert mission.legs[0] == Leg(Place(8.54, LAT, 0.0, "ground"), over, "climb", 1)
    assert mission.legs[1] == Leg(over, Place(LON, LAT, 40, "geoid"), "leg", 1)
    assert mission.not_judged == ()


def test_a_note_in_a_line_of_its_own_is_no_point_of_a_table(read):
    noted = (
        CSV.replace(f"\n{LAT},8.55", f"\nrepeated in the wind\n{LAT},8.55") + "End of the flight\n"
    )
    assert read(noted, "m.csv", heights="geoid").legs == read(CSV, "m.csv", heights="geoid").legs


def test_tracks_and_lines_of_several_parts_are_read(read):
    coords = f"<gx:coord>{LON} {LAT} 40</gx:coord><gx:coord>8.55 {LAT} 45</gx:coord>"
    track = f"<gx:Track><altitudeMode>absolute</altitudeMode>{coords}</gx:Track>"
    legs = read(f'<kml xmlns:gx="http://www.google.com/kml/ext/2.2">{track}</kml>', "m.kml").legs
    for_gpx = GPX.replace("<rte>", "<trk><trkseg>").replace("</rte>", "</trkseg></trk>")
    assert read(for_gpx.replace("rtept", "trkpt"), "m.gpx", heights="geoid").legs == legs
    parts = {"type": "MultiLineString", "coordinates": [GEOJSON["coordinates"]]}
    feature = {"type": "Feature", "properties": None, "geometry": parts}
    assert read(json.dumps(feature), "m.json", heights="geoid").legs == legs
    flat = {"type": "LineString", "coordinates": [[LON, LAT], [8.55, LAT]]}
    level = {"type": "Feature", "properties": {"altitude_m": 40}, "geometry": flat}
    whole = json.dumps({"type": "FeatureCollection", "features": [level]})
    (leg,) = read(whole, "m.geojson", heights="ground").legs
    assert (leg.start, leg.end.height_m) == (Place(LON, LAT, 40, "ground"), 40)


def test_no_way_between_lines_is_invented_and_other_things_are_named(read):
    more = kml("absolute", f"9,{LAT},1 9.1,{LAT},1").removeprefix(
        '<kml xmlns="http://www.opengis.net/kml/2.2">'
    )
    more = more.removesuffix("</kml>") + "<Placemark><Point/></Placemark>"
    mission = read(kml("absolute", more=more), "m.kml")
    assert kinds(mission) == [("leg", 2), ("leg", 4)]
    assert "2 lines, and the ways between them" in mission.not_judged[1]
    assert "what it holds as Point" in mission.not_judged[2]


def test_lines_without_heights_are_refused(read):
    flat = kml("absolute", f"{LON},{LAT} 8.55,{LAT}")
    with pytest.raises(ju.InputError, match="point 1 has no height"):
        read(flat, "m.kml")
    with pytest.raises(ju.InputError, match="point 2 has no height"):
        read(GPX.replace("<ele>45</ele>", ""), "m.gpx", heights="geoid")
    with pytest.raises(ju.InputError, match="no column of height: call it altitude_m"):
        read("lat,lon\n1,2\n3,4\n", "m.csv", heights="geoid")


@pytest.mark.slow
def test_ten_thousand_items_are_read_in_a_second(read):
    jumps = [item(JUMP, frame=2, params=(2, 1, 0, 0))] * 3000
    items = [BOX[0], *(item(at=1 + number / 1000) for number in range(7000)), *jumps]
    began = time.process_time()
    mission = read(items)
    assert len(mission.legs) == 1 + 1 + 6999 + 1  # a leg that 3,000 jumps share
    strange = read([BOX[0], *[SURVEY] * 10_000])
    assert len(strange.not_judged) == 51
    assert "9950 more" in strange.not_judged[-1]
    assert time.process_time() - began < 5


HOSTILE = {
    "empty.plan": b"",
    "no-mission.plan": b"{}",
    "list.plan": b"[]",
    "deep.plan": b"[" * 100_000,
    "binary.plan": bytes(range(256)) * 100,
    "empty-items.plan": json.dumps(plan_of([])).encode(),
    "only-cameras.plan": json.dumps(plan_of([item(2000, frame=2)])).encode(),
    "items.plan": b'{"mission": {"items": {"a": 1}}}',
    "number.plan": b'{"mission": {"items": [1]}}',
    "home.plan": json.dumps(plan_of(BOX, plannedHomePosition=[95, 0, 0])).encode(),
    "home-text.plan": json.dumps(plan_of(BOX, plannedHomePosition="here")).encode(),
    "home-number.plan": json.dumps(plan_of(BOX, plannedHomePosition=7)).encode(),
    "fence.plan": json.dumps(plan_of(BOX) | {"geoFence": 3}).encode(),
    "speed.plan": json.dumps(plan_of(BOX, hoverSpeed="fast")).encode(),
    "digits.plan": b'{"mission": {"items": [' + b"9" * 10_000 + b"]}}",
    "empty.waypoints": b"QGC WPL 110\n",
    "home.waypoints": waypoints_of((16, 0, NONE, LAT, LON, 488)).encode(),
    "other.waypoints": b"QGC WPL 120\n0 1 2\n",
    "short.waypoints": b"QGC WPL 110\n0\t1\t0\t16\n",
    "text.waypoints": waypoints_of((22, 3, NONE, "north", LON, 1)).encode(),
    "pole.waypoints": waypoints_of((22, 3, NONE, 91, LON, 1)).encode(),
    "endless.waypoints": waypoints_of((22, 3, NONE, LAT, LON, "inf")).encode(),
    "binary.waypoints": bytes(range(256)),
    "bomb.kml": b'<!DOCTYPE k [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]><kml>&b;</kml>',
    "outside.gpx": b'<!DOCTYPE g [<!ENTITY a SYSTEM "file:///etc/passwd">]><gpx>&a;</gpx>',
    "cut.kml": kml()[:-9].encode(),
    "deep.kml": b"<a>" * 100_000,
    "pole.kml": kml("absolute", "0,91,3 0,92,3").encode(),
    "text.kml": kml("absolute", "a,b,c d,e,f").encode(),
    "empty.kml": b"<kml/>",
    "nan.gpx": GPX.replace('lon="8.55"', 'lon="nan"').encode(),
    "no-lon.gpx": GPX.replace('lon="8.55"', "").encode(),
    "list.geojson": b"[1, 2]",
    "nan.geojson": b'{"type": "LineString", "coordinates": [[NaN, 1, 1], [2, 2, 2]]}',
    "text.geojson": b'{"type": "LineString", "coordinates": [["1", "1", "1"], [2, 2, 2]]}',
    "numbers.geojson": b'{"type": "LineString", "coordinates": [1, 2, 3]}',
    "features.geojson": b'{"features": [null]}',
    "point.geojson": b'{"type": "Point", "coordinates": [1, 2, 3]}',
    "text.csv": b"lon,lat,alt\na,b,c\nd,e,f\n",
    "high.csv": b"lon,lat,alt\n1,2,1e9\n2,3,1e9\n",
    "empty.csv": b"",
    "binary.csv": bytes(range(256)) * 10,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_or_empty_file_is_refused_in_a_sentence(tmp_path, name):
    file = tmp_path / name
    heights = "geoid" if file.suffix in (".gpx", ".geojson", ".csv") else None
    print(refused(lambda path: read_mission(path, heights=heights), file, HOSTILE[name], name))


STRANGE = {
    "text": {"params": ["0", 0, 0, 0, LAT, LON, 50]},
    "truth": {"params": [0, 0, 0, 0, LAT, LON, True]},
    "endless": {"params": [0, 0, 0, 0, LAT, LON, 1e999]},
    "huge": {"params": [0, 0, 0, 0, LAT, LON, 1e300]},
    "short": {"params": [0, 0]},
    "none": {"params": None},
    "scaled": {"params": [0, 0, 0, 0, LAT * 1e7, LON * 1e7, 50]},
    "pole": {"params": [0, 0, 0, 0, 90.01, LON, 50]},
    "high": {"params": [0, 0, 0, 0, LAT, LON, 2e5]},
    "half a command": {"command": 16.5},
    "no command": {"command": None},
    "no frame": {"frame": []},
    "an id": {"doJumpId": "first"},
    "two heights": {"Altitude": 20.0, "AltitudeMode": 1},
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_strange_item_is_refused_by_its_number(tmp_path, name):
    content = json.dumps(plan_of([BOX[0], BOX[1] | STRANGE[name]])).encode()
    print(refused(read_mission, tmp_path / "mission.plan", content, "item 2"))


def test_wrong_arguments_are_refused(read):
    with pytest.raises(ju.InputError, match=r"give one of \.plan, \.waypoints"):
        read(b"", "mission.doc")
    with pytest.raises(ju.InputError, match="more than 16 MB"):
        read(b" " * (2**24 + 1))
    with pytest.raises(ju.InputError, match="does not exist"):
        read_mission("nowhere.plan")
    with pytest.raises(ju.InputError, match="says for each item"):
        read(BOX, heights="geoid")
    with pytest.raises(ju.InputError, match="heights must be 'home'"):
        read(CSV, "m.csv", heights="sea")
    for home in ((LAT, 147.0), (1.0,), (float("nan"), 1.0)):
        with pytest.raises(ju.InputError, match="home must be longitude and latitude"):
            read(BOX, home=home)
    with pytest.raises(ju.InputError, match="return_altitude_m must be a positive"):
        read(BOX, return_altitude_m=-3)


def test_lines_of_other_tools_are_read_whatever_their_properties_are_called(tmp_path):
    lines = [[(0, 50, 30), (0, 50.001, 30)], [(0, 50.001, 30), (0.001, 50.001, 30)]]
    features = [
        {
            "type": "Feature",
            "properties": {} if number == 0 else {"segment": 1},
            "geometry": {"type": "LineString", "coordinates": line},
        }
        for number, line in enumerate(lines)
    ]
    file = tmp_path / "tracks.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    mission = read_mission(file, heights="ground")
    assert any(leg.end.lon == 0.001 for leg in mission.legs) or mission.not_judged


@pytest.mark.parametrize(
    ("frame", "lonlat"), [(2, (0.001, 50.001)), (3, (None, 50.001)), (8, (0.001, 50.001))]
)
def test_a_landing_elsewhere_is_never_taken_for_one_where_the_vehicle_is(tmp_path, frame, lonlat):
    lon, lat = lonlat
    items = [(22, 3, 50.0, 0.0, 30.0), (21, frame, lat, lon, 0.0)]
    rows = [
        {
            "type": "SimpleItem",
            "command": command,
            "frame": of,
            "doJumpId": number,
            "params": [0, 0, 0, None, *place],
        }
        for number, (command, of, *place) in enumerate(items, 1)
    ]
    plan = {"fileType": "Plan", "mission": {"plannedHomePosition": [50.0, 0.0, 0], "items": rows}}
    plan["mission"]["plannedHomePosition"] = [50.0, 0.0001, 0]
    (tmp_path / "x.plan").write_text(json.dumps(plan))
    mission = read_mission(tmp_path / "x.plan")
    assert mission.not_judged
    assert all(leg.kind != "land" for leg in mission.legs)
