"""Return altitudes as autopilots hold and fly them: numbers worked by hand from their sources and documents."""

import math

import pandas as pd
import pytest

from jaxurban.flights.autopilots import low_returns, parameter_texts, typed_m
from jaxurban.flights.missions.flight import levels_m

# Autopilot, metres from home, return altitude, own height above home, the least height that is flown home, and why.
RULES = [
    # ArduCopter's RTL Mode page: with the default slope of 3, at 10 m from home it rises to 30 m at most.
    ("ardupilot", 10.0, 60.0, 0.0, 30.0, "3 x 10 m"),
    ("ardupilot", 20.0, 60.0, 0.0, 60.0, "3 x 20 m is the return altitude"),
    ("ardupilot", 19.9, 60.0, 0.0, 59.7, "3 x 19.9 m"),
    ("ardupilot", 500.0, 60.0, 0.0, 60.0, "outside the cone"),
    ("ardupilot", 0.5, 60.0, 0.0, 2.0, "no lower than RTL_ALT_MIN of 200 cm"),
    ("ardupilot", 10.0, 60.0, 45.0, 45.0, "it does not descend to the cone"),
    ("ardupilot", 500.0, 60.0, 75.0, 75.0, "nor to the return altitude"),
    # PX4: RTL_CONE_ANG of 45 degrees, d / tan 45 = d, within RTL_MIN_DIST of 10 m.
    ("px4", 6.0, 60.0, 0.0, 6.0, "6 m / tan 45"),
    ("px4", 10.0, 60.0, 0.0, 10.0, "10 m / tan 45, at RTL_MIN_DIST"),
    ("px4", 10.1, 60.0, 0.0, 60.0, "beyond RTL_MIN_DIST"),
    ("px4", 8.0, 5.0, 0.0, 5.0, "the cone is above the return altitude"),
    ("px4", 6.0, 60.0, 25.0, 25.0, "max of the cone and its own height"),
    # INAV's Navigation.md, mode 4 (AT_LEAST): as FIXED, but it only climbs.
    ("inav", 20.0, 60.0, 0.0, 60.0, "it climbs to nav_rth_altitude"),
    ("inav", 20.0, 60.0, 75.0, 75.0, "and does not descend"),
    # Not known: the lowest of ArduCopter's and PX4's.
    ("unknown", 6.0, 60.0, 0.0, 6.0, "PX4's"),
    ("unknown", 15.0, 60.0, 0.0, 45.0, "ArduCopter's"),
]


def departures(*rows: tuple[int, float, float, float]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["item", "apart_m", "own_m", "least_m"])


@pytest.mark.parametrize(("autopilot", "apart_m", "altitude_m", "own_m", "flown_m", "why"), RULES)
def test_an_autopilot_returns_at_the_height_of_its_documents(
    autopilot, apart_m, altitude_m, own_m, flown_m, why
):
    low = low_returns(departures((1, apart_m, own_m, 1e3)), autopilot, altitude_m)
    assert low["flown_m"].tolist() == pytest.approx([flown_m]), why
    assert levels_m(autopilot, apart_m, altitude_m)[-1] == altitude_m


def test_altitudes_are_rounded_up_to_whole_metres_that_every_parameter_holds():
    heights_m = [73.2, 74.0, 74.005, 74.02, 0.0, -5.0]
    assert [typed_m(height_m) for height_m in heights_m] == [74, 74, 74, 75, 2, 2]


def test_each_autopilot_gets_its_parameter_in_its_unit():
    none = departures()
    texts = parameter_texts(73.2, departures=none)
    assert list(texts) == ["ArduCopter", "PX4", "INAV"]
    copter, px4, inav = texts.values()
    assert copter == "RTL_ALT = 7400 (cm) up to 4.6, RTL_ALT_M = 74 (m) from 4.7 on."
    assert px4 == "RTL_RETURN_ALT = 74 (m)."
    assert inav.startswith("nav_rth_altitude = 7400 (cm, at most 65000), nav_rth_alt_mode")
    assert parameter_texts(73.2, "px4", none) == {"PX4": px4}
    assert parameter_texts(73.2, "dji", none) == {}


def test_the_cone_is_named_at_the_first_place_where_it_leaves_a_return_too_low():
    places = departures(
        (2, 25.0, 10.0, 74.0),  # cone 75 m
        (3, 20.0, 10.0, 74.0),  # cone 60 m
        (4, 8.0, 80.0, 74.0),  # its own height is enough
        (5, 8.0, 5.0, math.nan),  # what it needs is not known
    )
    copter, px4, inav = parameter_texts(74.0, departures=places).values()
    assert "from item 3, 20 m from home, at 60.0 m, below the 74.0 m needed" in copter
    assert copter.endswith("set RTL_CONE_SLOPE = 0.")
    assert "CONE" not in px4
    assert "cone" not in inav
    assert "at 8.0 m" in parameter_texts(74.0, "px4", departures((6, 8.0, 5.0, 74.0)))["PX4"]


def test_what_is_not_known_is_not_low():
    assert low_returns(departures((1, 8.0, 5.0, math.nan)), "px4", 10.0).empty
    assert low_returns(departures((1, 8.0, 5.0, 74.0)), "px4", math.nan).empty
    assert len(low_returns(departures((1, 80.0, math.nan, 74.0)), "px4", 10.0)) == 1


def test_without_places_it_says_how_to_switch_each_cone_off():
    copter, px4, inav = parameter_texts(74.0).values()
    assert "near home" in copter
    assert copter.endswith("set RTL_CONE_SLOPE = 0.")
    assert px4.endswith("set RTL_CONE_ANG = 0.")
    assert "home" not in inav
