"""check: a file that names no autopilot is judged as both fly it, and the worse counts; what a mission's end says."""

import json

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import speaking
from jaxurban.flights.missions.mission import read_mission
from tests.cli_runs import run
from tests.flights.missions import files
from tests.flights.missions.cases import MAKERS
from tests.flights.missions.draw import Draw
from tests.flights.missions.trial import Court, make_maps
from tests.flights.missions.verdicts import verdict_of
from tests.flights.test_judged_flight import HOME, World, checked, world

WAYPOINT, UNLIMITED, TURNS, TIMED, RETURN, LAND, TAKEOFF, TO_ALT, JUMP = (
    *(16, 17, 18, 19, 20, 21, 22, 31, 177),
)
HOVER = (0, 0, 0, 0)
WORSE = ["clean", "not-judged", "findings"]
BOTH = ("ardupilot", "px4")


def wpl(scene: World, *rows, go_on=1) -> str:
    """Return ``QGC WPL 110`` of home and rows: command, frame, place in metres or None, height, four parameters."""
    lines = ["QGC WPL 110"]
    for number, row in enumerate([(WAYPOINT, 0, HOME, 0.0, HOVER), *rows]):
        command, frame, place, height_m, params = row
        lon, lat = (0, 0) if place is None else scene.lonlat(*place)
        cells = (number, 0, frame, command, *params, lat, lon, height_m, go_on)
        lines.append("\t".join(map(str, cells)))
    return "\n".join(lines)


def up(place=HOME, height_m=30.0):
    return (TAKEOFF, 3, place, height_m, HOVER)


def to(x_m, y_m, height_m=30.0, frame=3, command=WAYPOINT, params=HOVER):
    return (command, frame, (x_m, y_m), height_m, params)


def down(x_m, y_m, frame=3):
    return (LAND, frame, (x_m, y_m), 0.0, HOVER)


# Towers (centre, width, height), rows of a mission, and what ArduPilot and PX4 make of it, worked by hand from their
# sources (docs/guides/check.md, the table of what they fly differently).
TOWER = (200.0, 300.0, 10.0, 50.0)
DIFFERENT = {
    "take-off, on the way to its place": (
        (100.0, 350.0, 10.0, 50.0),
        [up((100, 400)), to(300, 400), down(300, 400)],
        ("clean", "findings"),
    ),
    "take-off, on the way from home": (
        TOWER,
        [up((100, 400)), to(300, 400), to(300, 300), down(300, 300)],
        ("clean", "clean"),
    ),
    "take-off, straight on from home": (
        TOWER,
        [up((100, 400)), to(300, 300), down(300, 300)],
        ("findings", "clean"),
    ),
    "height 0 of a waypoint": (
        (250.0, 300.0, 10.0, 20.0),
        [up(), to(150, 300), to(400, 300, 0.0), down(400, 300)],
        ("clean", "findings"),
    ),
    "height 0 of a loiter": (
        (250.0, 300.0, 10.0, 20.0),
        [up(), to(150, 300), to(400, 300, 0.0, command=TIMED), down(400, 300)],
        ("clean", "findings"),
    ),
    "radius that a waypoint accepts": (
        (285.0, 315.0, 6.0, 60.0),
        [up(), to(300, 300, params=(0, 40, 0, 0)), to(300, 500), down(300, 500)],
        ("clean", "not-judged"),
    ),
    "circle, on the way to its centre": (
        (300.0, 300.0, 10.0, 50.0),
        [up(), to(300, 300, command=TURNS, params=(1, 0, 100, 0)), down(200, 300)],
        ("clean", "findings"),
    ),
    "circle, on the way out": (
        (250.0, 350.0, 10.0, 50.0),
        [up(), to(300, 300, command=TURNS, params=(1, 0, 100, 0)), to(300, 400), down(300, 400)],
        ("findings", "clean"),
    ),
    "loiter to an altitude": (
        (280.0, 300.0, 10.0, 100.0),
        [up(), to(300, 300, 150.0, command=TO_ALT), down(300, 300)],
        ("clean", "findings"),
    ),
    "return from near home": (
        (107.0, 300.0, 4.0, 24.0),
        [up(), to(112, 300, 20.0), (RETURN, 3, None, 0.0, HOVER)],
        ("findings", "findings"),
    ),
}


@pytest.mark.parametrize("name", DIFFERENT)
def test_the_worse_of_both_counts_and_an_option_says_which(tmp_path, name):
    tower, rows, states = DIFFERENT[name]
    scene = world(tower)
    text = wpl(scene, *rows)
    options = {"return_altitude_m": 60.0}
    found = {}
    for autopilot, state in zip(BOTH, states, strict=True):
        alone = checked(scene, tmp_path, text, "m.waypoints", autopilot=autopilot, **options)
        assert (autopilot, alone.state, alone.autopilots) == (autopilot, state, (autopilot,))
        assert set(alone.findings["autopilot"]) <= {""}
        found[autopilot] = len(alone.findings)
    both = checked(scene, tmp_path, text, "m.waypoints", **options)
    assert both.state == max(states, key=WORSE.index)
    assert both.autopilots == BOTH
    by = both.findings["autopilot"].value_counts()
    for autopilot, num in found.items():
        assert by.get("", 0) + by.get(autopilot, 0) == num


@pytest.mark.slow
def test_a_roof_at_the_place_of_the_take_off_is_met_by_px4_alone_and_said(tmp_path):
    """The reproduction of a mission that was clean, whose take-off has its place in a roof."""
    scene = world((150.0, 400.0, 30.0, 44.0))
    result = checked(scene, tmp_path, wpl(scene, up((150, 400)), to(100, 200)), "m.waypoints")
    assert result.state == "findings"
    assert set(result.findings["autopilot"]) == {"px4"}
    assert all(text.startswith("Flown by PX4: Flies through") for text in result.sentences)
    assert "autopilot: ArduPilot and PX4" in result.lines
    record = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert record["autopilots"] == ["ardupilot", "px4"]
    assert {row["autopilot"] for row in record["findings"]} == {"px4"}
    result.save(tmp_path / "report")
    page = (tmp_path / "report" / "report.md").read_text()
    assert "Autopilot: ArduPilot and PX4." in page
    assert "Note: It ends in the air at item 2: nothing in the file lands it" in page
    beyond = world((300.0, 300.0, 5.0, 5.0))
    text = wpl(beyond, up((2000, 400)), to(100, 200), down(100, 200))
    outside = checked(beyond, tmp_path, text, "m.waypoints")
    assert outside.state == "not-judged"
    assert all(text.startswith("Flown by PX4: ") for text in outside.not_judged)


@pytest.mark.parametrize("firmware", [0, None, 3, 12, 1, 99])
def test_a_plan_that_names_neither_firmware_is_judged_for_both(tmp_path, firmware):
    scene = world((300.0, 500.0, 5.0, 5.0))
    text = scene.plan(to(300, 300), down(300, 300), firmware=firmware)
    result = checked(scene, tmp_path, text)
    named = {3: ("ardupilot",), 12: ("px4",)}
    assert result.autopilots == named.get(firmware, BOTH)
    assert result.state == "clean"
    if firmware not in named:
        alone = checked(scene, tmp_path, text, autopilot="px4")
        assert (alone.state, alone.autopilots) == ("clean", ("px4",))


def test_an_autopilot_other_than_the_one_that_the_file_names_is_refused(tmp_path):
    scene = world((300.0, 500.0, 5.0, 5.0))
    for firmware, same, other in ((3, "ardupilot", "px4"), (12, "px4", "ardupilot")):
        text = scene.plan(to(300, 300), down(300, 300), firmware=firmware)
        assert checked(scene, tmp_path, text, autopilot=same).state == "clean"
        with pytest.raises(ju.InputError, match=f"leave autopilot='{other}' out"):
            checked(scene, tmp_path, text, autopilot=other)
    with pytest.raises(ju.InputError, match="autopilot"):
        checked(scene, tmp_path, text, autopilot="inav")
    mission = read_mission(tmp_path / "m.plan")
    with pytest.raises(ju.InputError, match="autopilot are of a file"):
        ju.check(scene.maps, mission, autopilot="px4")


def test_what_a_file_says_already_is_left_out_by_the_name_of_the_door(tmp_path):
    scene = world((300.0, 500.0, 5.0, 5.0))
    (tmp_path / "m.plan").write_text(scene.plan(to(300, 300), firmware=3))
    for options, option in (
        ({"autopilot": "px4"}, "--autopilot"),
        ({"heights": "home"}, "--heights"),
    ):
        with speaking("scenario"), pytest.raises(ju.InputError, match=rf"\({option}.*\) out$"):
            read_mission(tmp_path / "m.plan", **options)
        with pytest.raises(ju.InputError, match=r"leave [a-z]+='[a-z0-9]+' out$"):
            read_mission(tmp_path / "m.plan", **options)


def test_a_mission_that_both_fly_alike_is_judged_once(tmp_path):
    scene = world((300.0, 500.0, 5.0, 5.0))
    (tmp_path / "m.waypoints").write_text(wpl(scene, up(HOME), to(300, 300), down(300, 300)))
    mission = read_mission(tmp_path / "m.waypoints")
    assert (mission.other, mission.autopilot, mission.autopilots) == (None, "unknown", BOTH)


@pytest.mark.parametrize(
    ("rows", "item"),
    [
        ([up()], 1),
        ([up(), to(200, 300)], 2),
        ([up(), to(200, 300), to(300, 300, command=TIMED)], 3),
        ([up(), to(200, 300), (201, 3, (9, 9), 0.0, HOVER)], 2),
        ([up(), to(200, 300), down(200, 300), up(), to(300, 300)], 5),
        ([up(), to(200, 300), down(200, 300)], None),
        ([up(), to(200, 300), (LAND, 3, None, 0.0, HOVER)], None),
        ([up(), to(200, 300), (RETURN, 3, None, 0.0, HOVER)], None),
    ],
)
def test_a_mission_that_ends_in_the_air_says_so(tmp_path, rows, item):
    scene = world((300.0, 500.0, 5.0, 5.0))
    result = checked(scene, tmp_path, wpl(scene, *rows), "m.waypoints", return_altitude_m=50.0)
    said = f"It ends in the air at item {item}: nothing in the file lands it or brings it home."
    assert result.state == "clean"
    assert (said in result.notes) == (item is not None)
    assert (f"  note: {said}" in result.lines) == (item is not None)
    assert result.to_dict()["notes"] == list(result.notes)


def test_a_loiter_for_ever_is_named_as_such_and_a_line_ends_in_the_air(tmp_path):
    scene = world((300.0, 500.0, 5.0, 5.0))
    stays = checked(scene, tmp_path, wpl(scene, up(), to(200, 300, command=UNLIMITED)), "m.txt")
    assert "circles without end" in stays.not_judged[0]
    assert "ends in the air" not in " ".join(stays.notes)
    places = [scene.lonlat(*place) for place in (HOME, (300.0, 300.0))]
    line = {"type": "LineString", "coordinates": [[*place, 30] for place in places]}
    options = {"heights": "ground", "home": tuple(places[0])}
    result = checked(scene, tmp_path, json.dumps(line), "m.geojson", **options)
    (said,) = result.notes
    assert said.startswith("It ends in the air at point 2: ")


@pytest.mark.parametrize("command", [WAYPOINT, TIMED, TO_ALT, LAND, TAKEOFF])
def test_px4_takes_0_0_for_a_place_and_the_note_says_so(tmp_path, command):
    scene = world((300.0, 500.0, 5.0, 5.0))
    there = (command, 3, None, 30.0, HOVER)
    rows = [there, to(300, 300)] if command == TAKEOFF else [up(), to(300, 300), there]
    text = wpl(scene, *rows)
    said = f"items that have it ({1 + rows.index(there)})"
    for autopilot, is_said in ((None, True), ("px4", True), ("ardupilot", False)):
        result = checked(scene, tmp_path, text, "m.waypoints", autopilot=autopilot)
        assert (said in " ".join(result.notes)) == is_said
        assert result.state == "clean"


@pytest.mark.parametrize(
    ("item", "is_refused"),
    [
        ((WAYPOINT, 10, (300, 300), 30.0, HOVER), True),
        ((TURNS, 3, (300, 300), 30.0, (1, 0, 0, 0)), True),
        ((WAYPOINT, 3, (300, 300), 30.0, HOVER), False),
    ],
)
def test_what_px4_refuses_is_named_where_it_may_fly_the_mission(tmp_path, item, is_refused):
    scene = world((300.0, 500.0, 5.0, 5.0))
    text = wpl(scene, up(), item)
    for autopilot, is_asked in ((None, True), ("px4", True), ("ardupilot", False)):
        notes = checked(scene, tmp_path, text, "m.waypoints", autopilot=autopilot).notes
        assert any("PX4 refuses the mission for items 2:" in each for each in notes) == (
            is_refused and is_asked
        )


def test_returns_are_named_for_both_and_the_worst_is_in_the_table(tmp_path):
    scene = world((100.0, 350.0, 10.0, 50.0))
    text = wpl(scene, up((100, 450), 60.0), to(300, 300, 60.0), down(300, 300))
    both = checked(scene, tmp_path, text, "m.waypoints")
    alone = [checked(scene, tmp_path, text, "m.waypoints", autopilot=each) for each in BOTH]
    worst = np.nanmax([each.return_altitudes.set_index("item")["way_m"][2] for each in alone])
    assert both.return_altitudes.set_index("item")["way_m"][2] == worst
    assert both.return_altitudes["item"].is_unique
    typed = " ".join(both.return_lines)
    assert all(name in typed for name in ("RTL_ALT ", "RTL_RETURN_ALT"))


@pytest.fixture(scope="module")
def court(tmp_path_factory) -> Court:
    """Worlds and their maps, made once."""
    folder = tmp_path_factory.mktemp("worlds")
    make_maps(folder)
    return Court(folder)


def mutated(rows: list[list[str]], draw: Draw) -> list[list[str]]:
    """Return rows of ``QGC WPL 110`` in which what autopilots fly differently is drawn at random."""
    for row in rows[1:]:
        command = int(row[3])
        if command == TAKEOFF and draw.is_so(0.6):
            row[8:10] = [f"{value:.7f}" for value in draw.world.lonlat(*draw.place_m())[::-1]]
        if command == WAYPOINT and draw.is_so(0.3):
            row[5] = str(draw.one_of(5, 15, 30))
        if command == WAYPOINT and draw.is_so(0.15):
            row[3] = str(draw.one_of(TIMED, TO_ALT))
        if command == WAYPOINT and draw.is_so(0.1):
            row[10] = "0"
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 200, 50))
def test_random_missions_are_judged_by_the_worse_of_both(court, tmp_path, first):
    differ = 0
    for number in range(first, first + 50):
        rng = np.random.default_rng([77, number])
        draw = Draw(court.worlds[str(rng.choice(["flat", "hills"]))], rng)
        case = MAKERS[str(rng.choice(["mixed", "loiter", "return", "jump"]))](draw, "mixed")
        while case.suffix != ".waypoints":
            case = MAKERS["loiter"](draw, "loiter")
        rows = [line.split("\t") for line in case.text.splitlines()[1:]]
        file = tmp_path / f"{number}.waypoints"
        file.write_text(files.waypoints_text(mutated(rows, draw)))
        name = case.world.name
        options = court.sources[name] | case.options
        said = verdict_of(court.maps[name], file, options)
        each = [verdict_of(court.maps[name], file, options | {"autopilot": one}) for one in BOTH]
        states = [verdict.state for verdict in each]
        if "refused" in states:
            assert said.state == "refused"
            continue
        assert said.state == max(states, key=WORSE.index), (number, states, said)
        differ += states[0] != states[1]
    assert differ > 0


@pytest.mark.slow
def test_the_command_names_the_autopilots_that_it_judged_for(court, capsys):
    world_made = court.worlds["flat"]
    draw = Draw(world_made, np.random.default_rng(3))
    places = draw.places_m(2, 2)
    rows = files.waypoints(world_made, [], places[0])
    lon, lat = world_made.lonlat(*places[1])
    rows.append([str(each) for each in (1, 0, 3, 22, 0, 0, 0, 0, lat, lon, 140, 1)])
    file = court.folder / "both.waypoints"
    file.write_text(files.waypoints_text(rows))
    arguments = [
        "check",
        world_made.folder,
        file,
        f"--resolution={world_made.resolution_m}",
        "--json",
    ]
    for more, names in (([], ["ardupilot", "px4"]), (["--autopilot=px4"], ["px4"])):
        _, output, _ = run(capsys, *arguments, *more)
        assert json.loads(output)["autopilots"] == names
