"""check: random files of cities, in the ways that tools and offices write them, against what was planted in them."""

import numpy as np
import pytest
import shapely

from jaxurban.cities.rules import KINDS
from tests.cities.generator.extracts import IN_NO_ROW
from tests.cities.generator.judge import invented, truth_of
from tests.cities.generator.plant import EDITS, Prism, Thing
from tests.cities.generator.trial import (
    City,
    Flight,
    Trial,
    city_of,
    trial,
    trials_of,
    unseen,
    write_city,
)
from tests.cities.generator.verdicts import Verdict, verdicts_of
from tests.cities.generator.write import STYLES

NUM_QUICK, NUM_SLOW = 50, 100
NUM_SEEN = 40
LEAST_READ, LEAST_CLEAN, LEAST_FOUND = 0.9, 0.95, 0.99
# What OGR does not read whole of OpenStreetMap's XML: things that lack something, and all without nodes.
LACKING = {"open ring", "missing node", "missing member"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cities")


@pytest.fixture(scope="module")
def written(folder) -> list[tuple[City, tuple]]:
    """Return cities, whose files lie in the folder, and what is asked of them."""
    cities = map(city_of, range(NUM_QUICK))
    return [(city, write_city(city, folder)) for city in cities]


def about(each: Trial) -> str:
    """Return what one needs to look for a fault."""
    city = each.city
    what = f"city {city.number} ({city.suffix}, {city.style}), {each.flight.aim} {each.edit}"
    return f"{what}: {each.verdict.state}, {each.verdict.words}"


def assert_lawful(trials: list[Trial]) -> None:
    """Check that nothing is crashed into by what is Clean, and that what is known is said."""
    assert not [about(each) for each in trials if each.verdict.state == "crashed"]
    assert not [about(each) for each in trials if each.is_false_clean]
    judged = [each for each in trials if each.verdict.state != "refused"]
    assert len(judged) >= LEAST_READ * len(trials)
    free = [each for each in judged if each.truth.is_free]
    lost = [about(each) for each in free if each.verdict.state != "clean"]
    assert len(lost) <= (1 - LEAST_CLEAN) * len(free), lost
    known = [each for each in judged if each.truth.known]
    unsaid = [about(each) for each in known if each.verdict.state != "findings"]
    assert len(unsaid) <= (1 - LEAST_FOUND) * len(known), unsaid


@pytest.mark.slow
def test_random_cities_keep_the_law(written):
    assert_lawful([trials_of(city, verdicts_of(*asked))[0] for city, asked in written])


@pytest.mark.slow
def test_more_random_cities_keep_the_law(tmp_path):
    numbers = range(NUM_QUICK, NUM_QUICK + NUM_SLOW)
    assert_lawful([each for number in numbers for each in trial(number, tmp_path, num_flights=4)])


def test_cities_are_of_all_styles_formats_and_edits():
    cities = [city_of(number, num_flights=0) for number in range(200)]
    assert {city.style for city in cities} == {*STYLES}
    assert {(city.style, city.suffix) for city in cities} == {
        (name, suffix) for name, style in STYLES.items() for suffix in style.formats
    }
    assert {thing.edit for city in cities for thing in city.things} == {*EDITS}


def test_made_up_values_stand_in_no_row():
    assert sum(map(len, IN_NO_ROW.values())) == 20
    assert not [
        key for key, values in IN_NO_ROW.items() if not KINDS[key].keys().isdisjoint(values)
    ]


@pytest.mark.slow
def test_ogr_and_shapely_see_what_was_planted(written, folder):
    num_read = 0
    for city, _ in written[:NUM_SEEN]:
        is_read, gone = unseen(city, folder)
        num_read += is_read
        if is_read and city.style != "out geom":
            assert gone <= LACKING, (city.number, city.style, city.suffix)
    assert num_read > 0.9 * NUM_SEEN


def tower(*, is_known: bool = True) -> Thing:
    """A tower of 20 m and 10 m a side, which may be taken for one of 30 m."""
    shape = shapely.box(100, 100, 110, 110)
    return Thing("tower", (), (Prism(shape, 20.0),), (Prism(shape, 30.0),), is_known)


@pytest.mark.parametrize(
    ("y_m", "height_m", "clearance_m", "is_hit", "is_free"),
    [
        (105, 15, 0, True, False),  # through it
        (105, 22, 0, True, False),  # nearer over it than 3 m
        (105, 25, 0, False, False),  # where it may be
        (105, 35, 0, False, True),  # over it
        (115, 15, 0, False, True),  # beside it
        (113, 15, 4, True, False),
        (116, 15, 4, False, True),
        (114.5, 15, 4, False, False),  # too near to call
    ],
)
def test_the_judge_agrees_with_what_can_be_worked_out(y_m, height_m, clearance_m, is_hit, is_free):
    ends_m = np.array([(50.0, y_m, height_m), (160.0, y_m, height_m)])
    truth = truth_of([tower()], ends_m, clearance_m, 3.0)
    assert bool(truth.hits) == is_hit
    assert truth.known == truth.hits
    assert truth.is_free == is_free
    assert not truth_of([tower(is_known=False)], ends_m, clearance_m, 3.0).known


def test_a_clean_contact_and_a_finding_elsewhere_are_faults():
    ends_m = np.array([(50.0, 105.0, 15.0), (160.0, 105.0, 15.0)])
    things = (tower(),)
    truth = truth_of(things, ends_m, 0.0, 3.0)
    flight = Flight("through", "tower", ends_m, 0.0)
    city = City(0, "osm", ".osm", things, (flight,))
    for state, is_false in (("clean", True), ("findings", False), ("not-judged", False)):
        assert Trial(city, flight, truth, Verdict(state), 0).is_false_clean == is_false
    for x_m, num in ((105.0, 0), (120.0, 1)):
        assert invented(truth, np.array([(x_m, 105.0)])) == num
    free = truth_of(things, ends_m + np.array([0, 50, 0]), 0.0, 3.0)
    assert invented(free, np.array([(105.0, 155.0)])) == 1
