"""`City.why`: what stands at a place, by which rule, how high, and how that is known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.rules import RULES
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.world.footprints import KNOWN_BY, HeightOrigin
from jaxurban.world.grid import WGS84, transformer
from tests.made_files import line, node, osm, write_features
from tests.made_maps import city_of_kinds

INF = np.inf
EAST, NORTH = 1.19e-5, 0.9e-5  # degrees of a metre, about
BOX = (-74.0, 40.7, -73.995, 40.704)


def square(number: int, col: int, row: int, **tags) -> str:
    """Return an area of 20 m in a raster of 50 m from the box's southwest corner."""
    west, south = BOX[0] + 50 * (col + 1) * EAST, BOX[1] + 50 * (row + 1) * NORTH
    east, north = west + 20 * EAST, south + 20 * NORTH
    corners = [(west, south), (east, south), (east, north), (west, north), (west, south)]
    return line(number, corners, **tags)


def centre(col: int, row: int) -> tuple[float, float]:
    """Return longitude and latitude of the middle of a `square`."""
    return BOX[0] + (50 * (col + 1) + 10) * EAST, BOX[1] + (50 * (row + 1) + 10) * NORTH


# By hand: what stands in each square, the rule of the table that says so, and how high it is known to be.
TEN = [
    ({"building": "yes", "height": "31"}, "building", "building", 31, "a height in its file", 31),
    ({"building": "yes", "building:levels": "4"}, "building", "building", 12,
     "its number of levels", 34),
    ({"building": "house"}, "building", "building", 6.8, "a guess", 25),
    ({"building": "yes", "height": "~20"}, "building", "building", 20,
     "a rough figure in its file", INF),
    ({"man_made": "storage_tank"}, "tank", "man_made: tank storage_tank", 10, "a guess", 30),
    ({"man_made": "chimney", "height": "80"}, "chimney", "man_made: chimney stack flare", 80,
     "a height in its file", 80),
    ({"natural": "wood"}, "wood", "natural: wood", 20, "a guess", 45),
    ({"attraction": "big_wheel"}, "attraction=big_wheel", "attraction: *", np.nan, "not known", 200),
    ({"leisure": "thing", "height": "9"}, "structure", "height of 6 m or more", 9,
     "a height in its file", 9),
    ({"historic": "monument"}, "historic=monument",
     "historic: monument tower gate city_gate column obelisk lighthouse", np.nan, "not known", 60),
]  # fmt: skip


@pytest.fixture(scope="module")
def town(tmp_path_factory) -> City:
    file = tmp_path_factory.mktemp("why") / "town.osm"
    squares = [square(k + 1, k % 5, k // 5, **tags) for k, (tags, *_) in enumerate(TEN)]
    pier = square(20, 0, 3, man_made="pier")
    tree = node(99, *centre(1, 3), natural="tree")
    tower = square(21, 2, 3, building="yes", height="60")
    upper = square(22, 2, 3, **{"building:part": "yes", "height": "60", "min_height": "40"})
    lower = square(23, 2, 3, **{"building:part": "yes", "height": "40"})
    file.write_text(osm(*squares, pier, tree, tower, upper, lower, boxes=[BOX]), encoding="utf-8")
    with pytest.warns(ju.GuessWarning):
        return City.from_files(file)


@pytest.mark.parametrize("k", range(len(TEN)))
def test_each_of_ten_things_says_its_rule_and_how_its_height_is_known(town, k):
    _, kind, rule, height_m, known_by, highest_m = TEN[k]
    (row,) = town.why(*centre(k % 5, k // 5)).to_dict("records")
    assert (row["kind"], row["rule"], row["known_by"]) == (kind, rule, known_by)
    assert row["rule"] in RULES
    assert [row["height_m"], row["highest_m"]] == pytest.approx([height_m, highest_m], nan_ok=True)
    assert row["likely_m"] <= row["highest_m"]
    assert row["distance_m"] == 0
    assert row["source"] == town.sources["buildings"]


def test_what_stands_on_a_place_is_listed_highest_first_with_its_underside(town):
    things = town.why(*centre(2, 3))
    assert things["height_m"].tolist() == [60, 40]
    assert things["min_height_m"].tolist() == [40, 0]
    assert things.columns.name.startswith("this stands at -73.9")


def test_where_nothing_stands_the_heading_says_so_and_the_nearest_is_named(town):
    lon, lat = centre(0, 3)  # a pier, which the rules leave out
    things = town.why(lon, lat)
    assert things.columns.name == f"nothing stands at {lon:.6f}, {lat:.6f}"
    assert things["kind"].tolist() == ["tree"]  # 50 m to the east
    assert things["distance_m"][0] == pytest.approx(50 - 2.8, abs=0.7)


def test_a_thing_within_a_metre_counts_as_there_and_one_beyond_does_not(town):
    lon, lat = centre(0, 0)
    beside = [town.why(lon, lat + (10 + gap_m) * NORTH) for gap_m in (0.6, 1.6)]
    assert [each.columns.name.split(" stands")[0] for each in beside] == ["this", "nothing"]
    assert [each["distance_m"][0] for each in beside] == pytest.approx([0.6, 1.6], abs=0.1)


@pytest.mark.parametrize(
    ("lon", "lat"), [(40.702, -73.998), (-73.9, 40.702), (np.nan, 40.702), (0.0, 95.0)]
)
def test_a_place_outside_the_city_is_refused_in_one_sentence(town, lon, lat):
    with pytest.raises(InputError, match=r"give a place in the city, longitude first$"):
        town.why(lon, lat)


def test_what_stands_alone_far_from_all_buildings_is_still_named(tmp_path):
    mast, house = shapely.Point(-73.9, 40.75), shapely.box(-74.0, 40.7, -73.9998, 40.7002)
    file = write_features(
        tmp_path / "a.geojson", (mast, {"man_made": "mast"}), (house, {"building": "yes"})
    )
    with pytest.warns(ju.GuessWarning):
        city = City.from_files(file)
    assert city.why(-73.9, 40.75)["kind"].tolist() == ["mast"]
    with pytest.raises(InputError, match="nothing is known"):
        city.why(-73.95, 40.75)


def test_a_place_that_is_no_number_is_refused(town):
    with pytest.raises(InputError, match="lon must be a number"):
        town.why("west", 40.7)


CORNER = (583_000.0, 4_506_000.0)


def at(city: City, east_m: float, north_m: float) -> pd.DataFrame:
    """Return what stands at a place given in metres from the corner of `city_of_kinds`."""
    x_m, y_m = CORNER[0] + east_m, CORNER[1] + north_m
    return city.why(*transformer(city.crs, WGS84).transform(x_m, y_m))


def test_plants_of_a_raster_and_the_ground_are_named_beside_outlines():
    city = city_of_kinds(CORNER)
    plants = at(city, 30, 130)
    assert plants[["kind", "height_m", "known_by"]].to_numpy().tolist() == [
        ["wood", 14.0, "a raster of heights"]
    ]
    assert at(city, 20, 20)["kind"].tolist() == ["building"]  # where the raster has 0 m
    assert "ground_m" not in plants
    sloped = replace(city.vegetation, values=np.full((40, 40), 7.5, np.float32))
    assert at(replace(city, terrain=sloped), 30, 130)["ground_m"].tolist() == [7.5]
    holed = replace(city.vegetation, values=np.full((40, 40), np.nan, np.float32))
    unknown = at(replace(city, vegetation=holed), 75, 130)
    assert unknown.columns.name.startswith("this stands")  # what is not known is not nothing
    assert np.isnan(unknown["height_m"][0])
    assert unknown["highest_m"][0] == 45
    assert unknown["known_by"][0] == KNOWN_BY[HeightOrigin.UNKNOWN]


def test_a_city_of_a_raster_says_the_height_of_its_pixel_or_nothing():
    plants = city_of_kinds(CORNER)
    roofs = City(
        plants.crs, plants.extent_m, roofs=plants.vegetation, sources={"buildings": "a.tif"}
    )
    row = at(roofs, 30, 130).loc[0]
    assert row[["kind", "height_m", "likely_m", "highest_m", "source"]].tolist() == [
        "roof", 14.0, 14.0, 14.0, "a.tif"
    ]  # fmt: skip
    bare = at(roofs, 100, 20)
    assert len(bare) == 0
    assert bare.columns.name.startswith("nothing stands at")


def test_every_origin_of_a_height_has_words_of_its_own():
    assert KNOWN_BY.keys() == {*HeightOrigin}
    assert len({*KNOWN_BY.values()}) == len(KNOWN_BY)
