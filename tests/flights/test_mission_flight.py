"""How autopilots fly items: circles from their edge, jumps again and again, returns with a cone, aeroplanes."""

import json

import pyproj
import pytest

from jaxurban.flights.missions.mission import read_mission
from jaxurban.flights.missions.parts import Place
from tests.flights.test_mission import BOX, JUMP, RETURN, TAKEOFF, here, item, plan_of

ARDUPILOT, PX4, GENERIC = 3, 12, 0
GEOD = pyproj.Geod(ellps="WGS84")
TURNS = 18


@pytest.fixture
def read(tmp_path):
    """Return a reader of a mission of items by an autopilot."""

    def reading(items, firmware=ARDUPILOT, **options):
        (tmp_path / "m.plan").write_text(json.dumps(plan_of(items, firmwareType=firmware)))
        return read_mission(tmp_path / "m.plan", **options)

    return reading


def apart_m(one: Place, other: Place) -> float:
    return GEOD.inv(*one[:2], *other[:2])[2]


def circle(at, radius_m=30.0, turns=2.0):
    return item(TURNS, at=at, params=(turns, 0, radius_m, None))


def test_ardupilot_flies_to_the_nearest_point_of_a_circle_and_on_from_there(read):
    mission = read([*BOX[:2], circle(3), item(at=3, z_m=80)])
    to_edge, turns, onward = mission.legs[-3:]
    assert to_edge.start == here(1, 50.0)
    assert apart_m(to_edge.end, here(3, 50)) == pytest.approx(30.0, abs=1e-6)
    ways_m = apart_m(to_edge.start, to_edge.end), apart_m(to_edge.start, here(3, 50))
    assert ways_m[1] - ways_m[0] == pytest.approx(30.0, abs=1e-3)
    assert (turns.start, turns.end, turns.radius_m) == (to_edge.end, here(3, 50.0), 30.0)
    assert (onward.start, onward.end) == (to_edge.end, here(3, 80.0))
    assert mission.not_judged == ()


def test_px4_stops_at_the_centre_and_of_an_unknown_autopilot_both_are_judged(read):
    items = [*BOX[:2], circle(3), item(at=4)]
    ardupilot, px4, unknown = read(items), read(items, PX4), read(items, GENERIC)
    ways = [(leg.kind, leg.start, leg.end) for leg in px4.legs[-3:]]
    assert ways[0] == ("leg", here(1, 50.0), here(3, 50.0))
    assert ways[2] == ("leg", here(3, 50.0), here(4, 50.0))
    assert [way.legs for way in unknown.ways.values()] == [ardupilot.legs, px4.legs]
    assert unknown.autopilots == ("ardupilot", "px4")
    assert px4.not_judged == unknown.not_judged == ()


@pytest.mark.parametrize("firmware", [ARDUPILOT, GENERIC])
def test_a_circle_entered_from_its_centre_or_left_within_a_turn_has_an_unknown_way_out(
    read, firmware
):
    for around in (circle(1), circle(3, turns=0.5)):
        mission = read([*BOX[:2], around, item(at=4)], firmware)
        assert "the way out of the circle of item 3 is not judged" in mission.not_judged[0]
    assert read([*BOX[:2], circle(1), item(at=4)], PX4).not_judged == ()


def test_a_height_left_open_is_that_of_the_start_each_time_it_is_flown(read):
    rest = [item(at=4, z_m=60.0), item(at=5, z_m=30.0), item(JUMP, frame=2, params=(3, 1, 0, 0))]
    mission = read([*BOX[:2], item(at=2, z_m=None), item(at=3, z_m=None), *rest])
    ways = [(leg.kind, leg.item, leg.start.height_m, leg.end.height_m) for leg in mission.legs]
    assert ways[2:4] == [("leg", 3, 50.0, 50.0), ("leg", 4, 50.0, 50.0)]
    assert ways[6:] == [("jump", 3, 30.0, 30.0), ("leg", 4, 30.0, 30.0), ("leg", 5, 30.0, 60.0)]


@pytest.mark.parametrize(("frame", "is_known"), [(3, True), (0, True), (10, False)])
def test_a_height_left_open_in_another_frame_is_not_judged(read, frame, is_known):
    mission = read([*BOX[:2], item(at=2, z_m=None, frame=frame), item(at=3)])
    assert (mission.not_judged == ()) == is_known
    assert mission.legs[-1].start == here(2, 50.0)


def test_jumps_within_jumps_end_and_each_leg_is_flown_once(read):
    jumps = [item(JUMP, frame=2, params=(2, 3, 0, 0)), item(JUMP, frame=2, params=(3, -1, 0, 0))]
    legs = read([*BOX[:3], jumps[0], item(at=5, z_m=None), jumps[1], item(at=6)]).legs
    assert len(legs) == len(set(map(str, legs)))
    assert {leg.item for leg in legs if leg.kind == "jump"} == {2, 3}


@pytest.mark.parametrize(
    ("firmware", "at", "heights_m"),
    [
        (ARDUPILOT, 0.2, [45.3, 100.0]),
        (ARDUPILOT, 0.3, [68.0, 100.0]),
        (ARDUPILOT, 2.0, [100.0]),
        (PX4, 0.3, [100.0]),
        (PX4, 0.1, [7.5, 100.0]),
        (GENERIC, 0.3, [68.0, 100.0]),
    ],
)
def test_a_return_near_home_is_judged_with_and_without_a_cone(read, firmware, at, heights_m):
    mission = read([BOX[0], item(at=at), item(RETURN, frame=2)], firmware, return_altitude_m=100.0)
    level = [leg for leg in mission.legs if leg.kind == "return" and leg.end[:2] == mission.home]
    assert [leg.end.height_m for leg in level] == pytest.approx(heights_m, abs=0.3)
    assert [leg.is_variant for leg in level] == [True] * (len(level) - 1) + [False]
    assert {leg.end.level_with for leg in level} == {here(at, 50.0)}


def test_a_jump_over_an_item_leaves_it_out_and_its_account_says_so(read):
    jump = item(JUMP, frame=2, params=(5, 1, 0, 0))
    mission = read([*BOX[:2], jump, item(at=2), item(at=3)])
    assert [leg.item for leg in mission.legs] == [1, 2, 5]
    assert mission.accounts[3].why == "jumps pass over it"
    assert mission.num_lost == 0


def test_jumps_are_flown_as_often_as_they_say(read):
    jumps = [item(JUMP, frame=2, params=(6, 1, 0, 0)), item(JUMP, frame=2, params=(2, 2, 0, 0))]
    items = [*BOX[:2], item(at=2), jumps[0], item(at=4), item(at=5), jumps[1], item(at=6)]
    ways = [(leg.kind, leg.item) for leg in read(items).legs[1:]]
    assert ways == [
        *(("leg", 2), ("leg", 3), ("jump", 6), ("jump", 2)),
        *(("leg", 5), ("leg", 6), ("leg", 8)),  # on the second round the first jump is spent
    ]


def test_a_jump_without_end_is_flown_until_the_jumps_within_it_are_spent(read):
    jumps = [item(JUMP, frame=2, params=(6, 3, 0, 0)), item(JUMP, frame=2, params=(2, -1, 0, 0))]
    items = [*BOX[:2], item(at=2), jumps[0], item(at=4), item(at=5), jumps[1], item(at=6)]
    mission = read(items)
    ways = [(leg.kind, leg.item) for leg in mission.legs[1:]]
    assert ways[:4] == [("leg", 2), ("leg", 3), ("jump", 6), ("jump", 2)]
    assert ways[4:] == [("leg", 5), ("leg", 6)]
    assert mission.not_judged == (NO_END.format(7, "jumps without end"),)
    assert (mission.accounts[7].why, mission.num_lost) == (mission.not_judged[0], 0)


NO_END = "item {} {}, so the flight has no end: what follows is not flown, and not judged"


def jump(target, times=-1):
    return item(JUMP, frame=2, params=(target, times, 0, 0))


@pytest.mark.parametrize(
    ("items", "last"),
    [
        ([jump(4)], 4),  # to itself
        ([jump(5), jump(4)], 4),  # in a ring
        ([jump(3), jump(4)], 4),
        ([jump(2)], 4),
        ([jump(1)], 4),  # to the take-off
        ([jump(2, None)], 4),
        ([jump(2, 1), jump(3, 2), jump(4)], 6),
        ([item(17, at=4)], 4),
        ([item(17)], 4),
        ([item(17, at=4), jump(2, 1)], 4),
    ],
)
@pytest.mark.parametrize("firmware", [ARDUPILOT, PX4, GENERIC])
def test_a_flight_without_an_end_says_so_and_what_follows_is_not_flown(read, items, last, firmware):
    does = "circles without end" if items[0]["command"] == 17 else "jumps without end"
    for tail in ([], [item(at=7), item(21, at=7)]):
        mission = read([*BOX[:3], *items, *tail], firmware)
        assert mission.not_judged == (NO_END.format(last, does),)
        assert all(leg.item <= 3 + len(items) for leg in mission.legs)
        assert mission.num_lost == 0


@pytest.mark.parametrize(("firmware", "is_flown"), [(ARDUPILOT, True), (PX4, False), (0, False)])
def test_an_item_that_does_not_go_on_by_itself_is_the_end_but_for_ardupilot(
    read, firmware, is_flown
):
    mission = read([*BOX[:2], item(at=2, autoContinue=False), item(at=3)], firmware)
    mission = mission.other or mission
    assert [leg.item for leg in mission.legs][-1] == (4 if is_flown else 3)
    assert (mission.not_judged == ()) == is_flown


def test_a_pause_is_not_known_to_end(read):
    assert "item 3 is command 193, which is not read" in read([*BOX[:2], item(193)]).not_judged


def test_a_landing_of_an_unknown_autopilot_comes_down_from_either_height(read):
    mission = read([*BOX[:2], item(21, at=3, frame=10, z_m=0)], GENERIC)
    down = [way.legs[-1] for way in mission.ways.values()]
    assert [(leg.start.datum, leg.kind) for leg in down] == [("ground", "land"), ("home", "land")]
    assert {leg.end for leg in down} == {here(3, 0.0, "ground")}


@pytest.mark.parametrize("command", [84, 85, 3000])
def test_what_flies_as_an_aeroplane_is_not_judged_whole(read, command):
    mission = read([*BOX[:2], item(command, at=2, params=(4, 0, 0, 0))])
    assert "aeroplane" in " ".join(mission.not_judged)


def test_each_item_has_an_account_that_names_its_legs_or_why_there_are_none(read):
    mission = read([*BOX[:2], item(82, at=2), item(2000, frame=2), *BOX[2:]])
    accounts = [(each.what, bool(each.legs), each.why) for each in mission.accounts]
    assert accounts[:4] == [
        ("item 1", True, ""),
        ("item 2", True, ""),
        ("item 3", False, "item 3 is a spline waypoint, which is not read"),
        ("item 4", False, "it moves nothing"),
    ]
    assert all(leg in range(len(mission.legs)) for each in mission.accounts for leg in each.legs)


def test_a_waypoint_with_a_hold_is_a_stop(read):
    held = item(at=2, params=(3, 0, 0, None))
    legs = read([item(TAKEOFF, at=0), item(at=1), held, item(at=3)]).legs
    assert [leg.turn_m for leg in legs[-3:]] == [2.0, 0.0, 2.0]
