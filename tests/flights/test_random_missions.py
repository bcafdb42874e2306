"""check: random missions of all formats against an independent judge, which looks at points every 20 cm."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.flights.missions.draw import FORMATS
from tests.flights.missions.flights import (
    LAND,
    LOITER_TURNS,
    TAKEOFF,
    WAYPOINT,
    Autopilot,
    Item,
    fly_lines,
)
from tests.flights.missions.judge import Truth, ruling, truth_of
from tests.flights.missions.trial import KINDS, Court, Trial, case_of, make_maps
from tests.flights.missions.verdicts import Verdict
from tests.flights.missions.worlds import World, worlds_in

NUM_QUICK, NUM_SLOW = 100, 500


@pytest.fixture(scope="module")
def court(tmp_path_factory) -> Court:
    """The worlds and their maps, made once."""
    folder = tmp_path_factory.mktemp("worlds")
    make_maps(folder)
    return Court(folder)


def assert_lawful(trial: Trial) -> None:
    """Check that no contact and nothing unknown is clean, and that no finding is invented."""
    case, verdict = trial.case, trial.verdict
    about = f"mission {trial.number} ({case.kind}, {case.suffix}, {case.world.name}): {verdict}"
    assert verdict.state != "crashed", about
    assert not trial.ruling.false_clean, f"{trial.ruling.false_clean}; {about}"
    assert not trial.ruling.invented, f"{trial.ruling.invented}; {about}"


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, NUM_QUICK, 20))
def test_random_missions_keep_the_law(court, first):
    trials = [court.trial(number) for number in range(first, first + 20)]
    for trial in trials:
        assert_lawful(trial)
    assert {"clean", "findings"} <= {trial.verdict.state for trial in trials}


@pytest.mark.slow
@pytest.mark.parametrize("first", range(NUM_QUICK, NUM_QUICK + NUM_SLOW, 50))
def test_more_random_missions_keep_the_law(court, first):
    for number in range(first, first + 50):
        assert_lawful(court.trial(number))


def test_missions_are_of_all_kinds_and_formats():
    worlds = worlds_in(Path())
    cases = [case_of(worlds, number) for number in range(NUM_QUICK)]
    assert {case.kind for case in cases} >= {*KINDS} - {"damaged"}
    assert {case.suffix for case in cases} == {*FORMATS}
    assert len({case.kind for case in cases if case.is_damaged}) >= 20
    assert {case.datum for case in cases} >= {"home", "ground", "geoid", "ellipsoid", "mixed"}


@pytest.fixture
def tower() -> World:
    """Level ground with a house of 20 m and 10 m a side."""
    outline = np.array([shapely.box(245, 245, 255, 255)])
    return World("one", Path(), 5.0, outline, np.array([-np.inf]), np.array([20.0]))


def judged(world: World, y_m: float, height_m: float, *clearances_m: float) -> Truth:
    """Return the truth of a line from west to east."""
    line = np.array([(200, y_m, height_m), (300, y_m, height_m)])
    return truth_of(world, fly_lines(world, [line], "ground", (200, y_m)), *clearances_m)


@pytest.mark.parametrize(
    ("y_m", "height_m", "clearances_m", "margin_m"),
    [
        (250, 15, (0, 0), -5),  # through it
        (250, 25, (0, 0), 5),  # over it
        (250, 25, (0, 6), -1),
        (258, 15, (0, 0), np.inf),  # beside it
        (258, 15, (4, 0), -3 * 1),  # places are three times as sharp as heights
        (258, 22, (4, 3), -1),
        (258, 25, (4, 3), 2),
    ],
)
def test_the_judge_agrees_with_what_can_be_worked_out(tower, y_m, height_m, clearances_m, margin_m):
    truth = judged(tower, y_m, height_m, *clearances_m)
    assert truth.building_m.min() == pytest.approx(margin_m, abs=1e-6)
    assert truth.has_contact == (margin_m < 0)


def test_a_contact_that_is_clean_and_a_finding_that_is_elsewhere_break_the_law(tower):
    truth = judged(tower, 250, 15, 0, 0)
    assert ruling(tower, truth, Verdict("clean")).false_clean == "building, 5.0 m deep"
    for x_m, num_invented in ((245, 0), (242, 1)):
        finding = Verdict("findings", ("building",), ((*tower.lonlat(x_m, 250.0), 15.0),))
        assert len(ruling(tower, truth, finding).invented) == num_invented
        assert not ruling(tower, truth, finding).false_clean
    clear = judged(tower, 200, 15, 0, 0)
    assert ruling(tower, clear, Verdict("clean")) == ("", ())


@pytest.mark.parametrize(
    ("firmware", "has_contact"), [("ardupilot", True), ("px4", False), ("other", True)]
)
def test_a_circle_is_left_from_where_the_autopilot_leaves_it(tower, firmware, has_contact):
    """From the west round (270, 210), and north: from the centre it passes the house, from the edge it does not."""
    places = [(200.0, 210.0), (270.0, 210.0), (270.0, 400.0)]
    commands = (TAKEOFF, LOITER_TURNS, WAYPOINT)
    items = [
        Item(command, xy_m, 15.0, radius_m=25.0)
        for command, xy_m in zip(commands, places, strict=True)
    ]
    flown = Autopilot(tower, firmware, places[0], None).fly([*items, Item(LAND)])
    assert truth_of(tower, flown, 0.0, 0.0).has_contact == has_contact


@pytest.mark.parametrize(("hold_s", "is_cut"), [(0.0, True), (5.0, False)])
def test_a_corner_round_a_house_is_cut_without_a_stop(tower, hold_s, is_cut):
    places = [(255.7, 200.0), (255.7, 255.7), (200.0, 255.7)]
    commands = (TAKEOFF, WAYPOINT, WAYPOINT)
    items = [
        Item(command, xy_m, 15.0, hold_s=hold_s)
        for command, xy_m in zip(commands, places, strict=True)
    ]
    flown = Autopilot(tower, "px4", places[0], None).fly([*items, Item(LAND)])
    truth = truth_of(tower, flown, 0.0, 0.0)
    assert bool(len(truth.cut_m)) == is_cut
    assert not truth.has_contact
