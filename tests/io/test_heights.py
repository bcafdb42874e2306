"""Heights as people spell them."""

import math

import numpy as np
import pytest

from jaxurban.io.read.heights import estimate_heights, parse_count, parse_length_m
from jaxurban.settings import Buildings
from jaxurban.world.city import HeightOrigin

# Spellings from https://wiki.openstreetmap.org/wiki/Key:height; feet and inches by their definition (0.3048, 0.0254 m).
SPELLINGS_M = {
    "12": 12.0,
    "12.5 m": 12.5,
    " 241m ": 241.0,
    "228.6M": 228.6,
    "12,5": 12.5,
    ".5": 0.5,
    "7 metres": 7.0,
    "7 meter": 7.0,
    "40 ft": 12.192,
    "40ft": 12.192,
    "40 feet": 12.192,
    "12'": 3.6576,
    "12'6\"": 3.81,
    "12' 6": 3.81,
    "12′6″": 3.81,
    "12’6”": 3.81,
    "12'6''": 3.81,
    "12 ft 6 in": 3.81,
    "3;5": 5.0,
    "3 m; 20 ft": 6.096,
    "unknown;5": 5.0,
    "~30": 30.0,
    "ca. 30 m": 30.0,
    "0": 0.0,
}
UNREADABLE = ["", "high", "-5", "10-12", "1e2", "12 km", "12 6", "5 storeys", "inf", "nan", '6"', ";", "+3"]


@pytest.mark.parametrize(("text", "length_m"), SPELLINGS_M.items())
def test_a_spelling_gives_its_length_in_metres(text, length_m):
    assert parse_length_m(text) == pytest.approx(length_m, abs=1e-12)


@pytest.mark.parametrize("text", UNREADABLE)
def test_what_is_no_length_is_nan(text):
    assert math.isnan(parse_length_m(text))


def test_levels_are_bare_numbers():
    assert [parse_count(text) for text in ("5", "2.5", "2,5", "1;4", "~3")] == [5, 2.5, 2.5, 4, 3]
    assert all(math.isnan(parse_count(text)) for text in ("5 m", "5'", "3-4", "-1", "many"))


def estimate(**columns):
    tags = {name: np.array(values, object) for name, values in columns.items()}
    nothing, issues = np.full(len(next(iter(tags.values()))), None, object), {}
    return estimate_heights(tags, nothing, nothing, Buildings("city.osm"), issues), issues


def test_height_wins_over_levels_and_levels_over_the_default():
    heights, issues = estimate(height=["20", None, None], levels=["3", "3", None])
    np.testing.assert_allclose(heights.height_m, [20, 9, 10])
    assert heights.origin.tolist() == [HeightOrigin.HEIGHT, HeightOrigin.LEVELS, HeightOrigin.DEFAULT]
    assert heights.origin.dtype == np.uint8
    assert not any(issues.values())


@pytest.mark.parametrize("bad", ["0", "-3", "tall", "1001", "9999 ft", 0, -1.0, 5000.0])
def test_an_unusable_height_falls_to_levels_and_is_counted(bad):
    heights, issues = estimate(height=[bad], levels=["4"])
    assert (heights.height_m[0], heights.origin[0]) == (12.0, HeightOrigin.LEVELS)
    assert issues["heights_unusable"] == 1


def test_the_highest_known_building_is_no_fault():
    assert estimate(height=["828"])[0].height_m[0] == 828.0


@pytest.mark.parametrize("bad", ["0", "-1", "some", "400"])
def test_unusable_levels_fall_to_the_default_and_are_counted(bad):
    heights, issues = estimate(levels=[bad])
    assert (heights.height_m[0], heights.origin[0]) == (10.0, HeightOrigin.DEFAULT)
    assert issues["levels_unusable"] == 1


def test_levels_in_the_roof_are_added_but_say_nothing_alone():
    heights, issues = estimate(levels=["4", "0", None, "4"], roof_levels=["1", "1", "2", "?"])
    np.testing.assert_allclose(heights.height_m, [15, 3, 10, 12])
    assert issues["levels_unusable"] == 1


def test_undersides_come_from_min_height_then_min_level_then_the_ground():
    heights, issues = estimate(min_height=["5", "x", None, "0"], min_level=["1", "2", "2", None])
    np.testing.assert_allclose(heights.min_height_m, [5, 6, 6, 0])
    assert issues["min_heights_unusable"] == 1


def test_columns_may_hold_numbers_and_gaps():
    heights, issues = estimate(height=[12, np.float32(7.5), None, math.nan, "  ", [3]])
    np.testing.assert_allclose(heights.height_m, [12, 7.5, 10, 10, 10, 10])
    assert issues["heights_unusable"] == 1  # the list


def test_no_outlines_give_no_heights():
    assert estimate(height=[])[0].height_m.shape == (0,)
