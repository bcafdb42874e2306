"""What known heights say of unknown ones: medians, the order statistic, own and packaged values, the user's word."""

import json
import re

import numpy as np
import pytest
import shapely
from scipy.stats import binom

import jaxurban as ju
from jaxurban.cities import city as city_reader
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.city import read_buildings
from jaxurban.cities.outlines import Outlines
from jaxurban.io.learned import (
    LEAST_FOR_GUESS,
    LEAST_KNOWN,
    OPEN_GUESSES_M,
    PACKAGED,
    PART_CLASSES,
    built_shares,
    classes_of,
    learned_from,
    likely_of,
)
from jaxurban.world.footprints import HeightOrigin
from tests.made_files import write_vector

UTM = "EPSG:32618"
SMALL, LARGE = "buildings of 60 to 200 m2", "buildings above 1,000 m2"


def shapely_features(features: list[tuple[shapely.Geometry, dict[str, str]]]) -> str:
    """Return the text of a GeoJSON file of geometries and their tags."""
    listed = [
        {"type": "Feature", "geometry": shapely.geometry.mapping(shape), "properties": tags}
        for shape, tags in features
    ]
    return json.dumps({"type": "FeatureCollection", "features": listed})


def houses(num: int, height_m: np.ndarray | float, side_m: float = 10.0) -> tuple[list, list]:
    """Return squares in a row, and their heights."""
    x_m = 580_000 + 30.0 * np.arange(num) + np.zeros(num)
    boxes = shapely.box(x_m, 4_500_000, x_m + side_m, 4_500_000 + side_m)
    return list(boxes), list(np.broadcast_to(height_m, num))


def test_likely_is_passed_by_one_in_a_hundred_of_the_next():
    rng = np.random.default_rng(1)
    passed = [
        rng.exponential(10) > likely_of(rng.exponential(10, LEAST_KNOWN)) for _ in range(4000)
    ]
    low, high = binom.interval(0.999, len(passed), 0.01)
    assert sum(passed) <= high
    assert sum(passed) >= low / 2  # and it is no needless bound


@pytest.mark.parametrize(("num", "is_own"), [(LEAST_KNOWN - 1, False), (LEAST_KNOWN, True)])
def test_own_heights_count_from_so_many_on(num, is_own):
    known_m = np.append(np.linspace(1, 30, num), [0.0])
    (learned,) = learned_from(np.full(num + 1, SMALL, object), known_m, known_m).values()
    assert learned.highest_m == 30
    assert learned.num_known == num * is_own
    rank = int(np.ceil((num + 1) * 0.99))
    own = known_m[rank - 1]
    assert learned.likely_m == (own if is_own else PACKAGED[SMALL][1])


@pytest.mark.parametrize("num", [LEAST_FOR_GUESS - 1, LEAST_FOR_GUESS])
def test_guess_is_the_median_of_the_file_where_that_knows_enough(tmp_path, num):
    """Levels count too, parts do not, and the guess stays below what is likely and the bound."""
    num_tall = num // 2
    heights_m = np.append(np.linspace(60, 90, num_tall), np.full(num - num_tall + 2, np.nan))
    levels = np.append(np.full(num_tall, np.nan), np.linspace(16, 18, num - num_tall))
    shapes, _ = houses(num + 2, 0.0)
    about = {"height": heights_m, "levels": [*levels, np.nan, np.nan]}
    about["building"] = ["yes"] * (num + 1) + ["garage"]
    path = write_vector(tmp_path / "town.gpkg", shapes, **about)
    city = read_buildings(ju.Buildings(path), UTM)
    is_own = num == LEAST_FOR_GUESS
    known_m = np.fmax(np.nan_to_num(heights_m[:num]), 3 * np.nan_to_num(levels))
    guess_m = np.median(known_m) if is_own else OPEN_GUESSES_M[SMALL]
    learned = city.learned[SMALL]
    assert (learned.open_guess_m, learned.num_for_guess) == (guess_m, num * is_own)
    house, garage = np.flatnonzero(city.buildings.origin == HeightOrigin.DEFAULT)
    buildings = city.buildings
    assert buildings.height_m[house] == guess_m
    assert buildings.height_m[garage] == min(guess_m, 25)
    assert learned.likely_m >= guess_m
    assert np.all(buildings.height_m <= buildings.likely_upper_m)
    assert np.all(buildings.likely_upper_m <= buildings.upper_m)
    said = read_buildings(ju.Buildings(path, default_height_m=12.5), UTM).buildings
    assert said.height_m[[house, garage]].tolist() == [12.5, 12.5]


def test_guess_of_each_class_and_of_trees_is_packaged_where_the_file_knows_few():
    sides_m = np.sqrt([50.0, 100.0, 500.0, 2000.0])
    outlines = [shapely.box(200.0 * i, 0, 200 * i + side, side) for i, side in enumerate(sides_m)]
    trees = [shapely.Point(0, 500 + 20 * i) for i in range(LEAST_FOR_GUESS + 1)]
    tags = {"building": np.array(["yes"] * 4 + [None] * len(trees), object)}
    tags["natural"] = np.array([None] * 4 + ["tree"] * len(trees), object)

    def read(num_known):
        heights = [None] * 4 + ["50"] * num_known + [None] * (len(trees) - num_known)
        tags["height"] = np.array(heights, object)
        shapes = np.array(outlines + trees, object)
        given = Outlines(shapes, tags, UTM, (), {})
        return to_buildings(ju.Buildings("town.osm"), given, UTM)

    buildings, structures, *_, learned = read(LEAST_FOR_GUESS - 1)
    assert buildings.height_m.tolist() == [*OPEN_GUESSES_M.values()]
    assert structures.height_m[-1] == PACKAGED["tree"][0]
    _, structures, *_, learned = read(LEAST_FOR_GUESS)
    assert (learned["tree"].guess_m, learned["tree"].num_for_guess) == (50, LEAST_FOR_GUESS)
    # Where half of the known ones are higher, the bound of 35 m is none.
    assert (structures.height_m[-1], structures.likely_upper_m[-1]) == (50, 50)
    assert structures.upper_m[-1] == np.inf


def test_share_of_ground_that_is_built_is_that_of_five_by_five_cells():
    rng = np.random.default_rng(3)
    corner_m = rng.uniform(0, 2000, (300, 2))
    boxes = shapely.box(*corner_m.T, *(corner_m + rng.uniform(5, 60, (300, 2))).T)
    cell = np.floor(shapely.get_coordinates(shapely.centroid(boxes)) / 80)
    for own, share in zip(cell, built_shares(boxes), strict=True):
        is_near = (abs(cell - own) <= 2).all(axis=1)
        assert share == pytest.approx(shapely.area(boxes[is_near]).sum() / 400**2)


@pytest.mark.parametrize(
    ("gap_m", "guess_m"), [(15.0, PACKAGED[SMALL][0]), (60.0, OPEN_GUESSES_M[SMALL])]
)
def test_guess_is_higher_where_the_ground_is_built_up(gap_m, guess_m):
    x_m, y_m = (each.ravel() * gap_m for each in np.mgrid[:30, :30])
    tags = {"building": np.full(900, "yes", object)}
    town = Outlines(shapely.box(x_m, y_m, x_m + 10, y_m + 10), tags, UTM, (), {})
    buildings = to_buildings(ju.Buildings("town.osm"), town, UTM).buildings
    assert buildings.height_m[465] == guess_m


def test_classes_begin_at_their_areas():
    areas_m2 = np.array([1, 59.9, 60, 199, 200, 999, 1000, 1e6])
    assert classes_of(areas_m2).tolist() == [name for name in list(PACKAGED)[:4] for _ in "12"]


def test_file_is_the_same_for_a_part_of_its_region(tmp_path):
    shapes, heights_m = houses(400, np.append(np.linspace(3, 20, 399), np.nan))
    path = write_vector(tmp_path / "town.gpkg", shapes, height=heights_m)
    whole = read_buildings(ju.Buildings(path), UTM)
    x_m = shapely.bounds(shapes[-1])[0]
    part = read_buildings(ju.Buildings(path), UTM, bounds_m=(x_m, 4_500_000, x_m + 10, 4_500_010))
    assert part.learned == whole.learned
    assert part.learned[SMALL].num_known == part.learned[SMALL].num_for_guess == 399
    assert len(part.buildings) < 5
    (unknown,) = part.buildings.likely_upper_m[part.buildings.is_guessed]
    assert unknown == part.learned[SMALL].likely_m < 20
    assert part.buildings.height_m[part.buildings.is_guessed] == pytest.approx([11.5])


def test_a_large_file_says_nothing_of_its_parts_and_of_the_whole(tmp_path, monkeypatch):
    shapes, heights_m = houses(400, np.append(np.linspace(3, 20, 399), np.nan))
    path = write_vector(tmp_path / "town.gpkg", shapes, height=heights_m)
    monkeypatch.setattr(city_reader, "SMALL_BYTES", 1)
    for bounds_m in (None, (580_000, 4_500_000, 600_000, 4_500_010)):
        town = read_buildings(ju.Buildings(path), UTM, bounds_m=bounds_m)
        (guess_m,) = town.buildings.height_m[town.buildings.is_guessed]
        assert guess_m == OPEN_GUESSES_M[SMALL]
        assert town.learned[SMALL].num_for_guess == 0


def test_guess_is_said_with_its_value_and_how_many_heights_say_it(tmp_path):
    shapes, heights_m = houses(31, np.append(np.full(30, 8.0), np.nan))
    large, unknown_m = houses(1, np.nan, 40.0)
    large = [shapely.transform(large[0], lambda xy: xy + np.array([0, 500]))]
    path = write_vector(tmp_path / "town.gpkg", shapes + large, height=heights_m + unknown_m)
    said = "2 by the median of their class: .*60 to 200 m2 8 m of 30 known; .*above 1,000 m2 38.6 m of the pack"
    with pytest.warns(ju.GuessWarning, match=r"2 by the median of their class\): give a source"):
        town = ju.City.from_files(path)
    assert re.search(said, "".join(guess.sentence for guess in town.guesses))
    with pytest.warns(ju.GuessWarning, match="2 by the default of 12 m"):
        ju.City.from_files(ju.Buildings(path, default_height_m=12.0))


def test_bound_ends_where_the_file_knows_higher_ones_and_at_the_users_word(tmp_path):
    shapes, heights_m = houses(2, np.array([120.0, np.nan]), 40.0)
    small, unknown_m = houses(1, np.nan)
    small = [shapely.transform(small[0], lambda xy: xy + np.array([0, 500]))]
    path = write_vector(tmp_path / "town.gpkg", shapes + small, height=heights_m + unknown_m)

    def limits_m(**how) -> list[float]:
        buildings = read_buildings(ju.Buildings(path, **how), UTM).buildings
        return buildings.upper_m[buildings.is_guessed].tolist()

    assert limits_m() == [np.inf, 100]
    assert limits_m(highest_m=40.0) == [40, 40]
    assert limits_m(highest_m={"building": 8.0, "tree": 3.0}) == [8, 8]
    with pytest.raises(ju.InputError, match="did you mean 'tree'"):
        limits_m(highest_m={"trees": 3.0})
    with pytest.raises(ju.InputError, match="above 0"):
        ju.Buildings(path, highest_m=0.0)


def read_tagged(*rows: tuple[shapely.Geometry, dict[str, str]]) -> ju.City:
    """Return buildings, structures and more of shapes in metres with tags, as a file of these alone says."""
    names = {name for _, tags in rows for name in tags}
    tags = {name: np.array([row[1].get(name) for row in rows], object) for name in names}
    shapes = np.array([row[0] for row in rows], object)
    given = Outlines(shapes, {"building": np.full(len(rows), None, object), **tags}, UTM, (), {})
    return to_buildings(ju.Buildings("town.osm"), given, UTM)


def box(x_m: float, y_m: float, area_m2: float) -> shapely.Geometry:
    """Return a square of an area with its lower left corner at a place."""
    side_m = area_m2**0.5
    return shapely.box(x_m, y_m, x_m + side_m, y_m + side_m)


@pytest.mark.parametrize("area_m2", [30.0, 165.0, 500.0, 2000.0])
@pytest.mark.parametrize("about", [{"height": "105.9"}, {"levels": "36"}])
def test_no_class_has_a_bound_below_what_the_file_knows_of_it(area_m2, about):
    known = box(0, 0, area_m2), {"building": "yes"} | about
    unknown = box(200, 0, area_m2), {"building": "yes"}
    house = box(400, 0, 100), {"building": "house"}
    buildings = read_tagged(known, unknown, house).buildings
    assert buildings.upper_m[1:].tolist() == [np.inf, 25]


def test_names_that_say_low_are_bounded_by_the_highest_of_them():
    rows = [(box(50 * i, 0, 100), {"building": "terrace"}) for i in range(3)]
    rows[0][1]["height"] = "31"
    assert read_tagged(*rows).buildings.upper_m.tolist() == [31, 31, 31]


@pytest.mark.parametrize(
    ("about", "limit_m", "known_m"),
    [
        ({"natural": "tree"}, 35, 41),
        ({"man_made": "storage_tank"}, 30, 44),
        ({"highway": "street_lamp"}, 15, 20),
    ],
)
def test_bound_of_a_kind_is_not_below_what_the_file_knows_of_it(about, limit_m, known_m):
    known = shapely.Point(0, 0), about | {"height": str(known_m)}
    unknown, other = ((shapely.Point(x, 0), about) for x in (100, 200))
    assert read_tagged(unknown, other).structures.upper_m.tolist() == [limit_m] * 2
    assert read_tagged(known, unknown, other).structures.upper_m.tolist() == [known_m] * 3


@pytest.mark.parametrize(
    ("part", "upper_m"),
    [
        (box(10, 10, 20), np.inf),  # in a building of 1,600 m2
        (box(35, 10, 64), np.inf),  # mostly in it
        (box(40, 10, 20), np.inf),  # beside it
        (box(202, 2, 20), 100),  # in a small one
        (box(210, 2, 20), np.inf),  # beside that: of what, is not known
        (box(300, 10, 20), np.inf),  # in none
    ],
)
def test_a_part_has_the_class_of_what_it_lies_in_and_no_bound_elsewhere(part, upper_m):
    tower, house = box(0, 0, 1600), box(200, 0, 100)
    wholes = [(shape, {"building": "yes"}) for shape in (tower, house)]
    buildings = read_tagged(*wholes, (part, {"part": "yes"})).buildings
    assert buildings.upper_m[buildings.is_part].tolist() == [upper_m]


def test_a_building_that_is_drawn_within_another_has_the_class_of_that():
    shapes = box(0, 0, 1600), box(200, 0, 100), box(10, 10, 20), box(202, 2, 20), box(40, 10, 20)
    buildings = read_tagged(*((shape, {"building": "yes"}) for shape in shapes)).buildings
    assert buildings.upper_m.tolist() == [np.inf, 100, np.inf, 100, 100]


def test_parts_that_touch_each_other_and_no_building_have_no_bound():
    parts = [(box(5 * i, 0, 25), {"part": "yes"}) for i in range(4)]
    assert read_tagged(*parts).buildings.upper_m.tolist() == [np.inf] * 4


def test_likely_of_parts_is_learned_of_parts():
    """Wholes and parts are of one class, and as many parts as count by themselves are known."""
    wholes = [(box(100 * i, 0, 1600), {"building": "yes"}) for i in range(LEAST_KNOWN + 1)]
    inner = [(box(100 * i, 0, 100), {"part": "yes"}) for i in range(LEAST_KNOWN + 1)]
    heights_m = np.linspace(20, 50, LEAST_KNOWN)
    for (_, tags), height_m in zip(inner, heights_m, strict=False):
        tags["height"] = str(height_m)
    city = read_tagged(*wholes, *inner)
    own = city.learned[PART_CLASSES[3]]
    assert own.num_known == own.num_for_guess == LEAST_KNOWN
    assert own.likely_m == pytest.approx(heights_m[296])  # the 297th of 300
    buildings = city.buildings
    (unknown,) = np.flatnonzero(buildings.is_part & buildings.is_guessed)
    assert buildings.likely_upper_m[unknown] == pytest.approx(own.likely_m)
    few = read_tagged(*wholes[:5], *inner[:5])
    assert few.learned[PART_CLASSES[3]].likely_m == PACKAGED[PART_CLASSES[3]][1]


def test_a_piece_of_a_building_is_no_smaller_than_what_is_seen_of_it():
    """A line, of a building that is cut off, has the bound of the class of its hull or of none."""
    small, wide = (
        shapely.LineString([(0, 0), (side_m, 0), (side_m, side_m)]) for side_m in (10, 30)
    )
    rows = (small, "yes"), (wide, "yes"), (wide, "garage")
    city = read_tagged(*((line, {"building": value}) for line, value in rows))
    assert city.structures.upper_m.tolist() == [100, np.inf, 25]


def test_users_word_takes_nothing_back_that_the_file_says(tmp_path):
    path = tmp_path / "town.geojson"
    house = shapely.box(8.0, 48.0, 8.0002, 48.0002)
    features = [
        (house, {"building": "yes", "height": "50"}),
        (shapely.Point(8.0001, 48.0001), {"man_made": "mast"}),
        (shapely.Point(8.001, 48.0001), {"man_made": "mast"}),
        (
            shapely.transform(house, lambda xy: xy + np.array([0.002, 0])),
            {"building": "yes", "building:levels": "30"},
        ),
        (
            shapely.transform(house, lambda xy: xy + np.array([0.004, 0])),
            {"building:part": "yes", "min_height": "60"},
        ),
        (shapely.transform(house, lambda xy: xy + np.array([0.006, 0])), {"building": "yes"}),
    ]
    path.write_text(shapely_features(features))
    word = ju.Buildings(path, highest_m={"building": 12.0, "mast": 10.0})
    read = read_buildings(word, UTM)
    said = read_buildings(ju.Buildings(path), UTM)
    levels, floor, plain = (
        read.buildings.polygons.tolist().index(each) for each in said.buildings.polygons[-3:]
    )
    assert (
        read.buildings.height_m[[levels, floor]].tolist()
        == said.buildings.height_m[[levels, floor]].tolist()
    )
    assert read.buildings.upper_m[levels] == 90
    assert read.buildings.upper_m[floor] == np.inf
    assert read.buildings.upper_m[plain] == 12
    assert read.structures.upper_m.tolist() == [np.inf, 10]


@pytest.mark.slow
def test_word_of_the_user_is_a_guess_of_the_city_and_of_its_scenario(tmp_path):
    with pytest.warns(ju.GuessWarning, match="highest_m=40"):
        city = ju.City.from_files(
            ju.Buildings("sample:lower-manhattan", highest_m=40.0),
            bounds=(-74.012, 40.705, -74.010, 40.707),
        )
    assert any("highest_m = 40" in guess.name for guess in city.guesses)
    buildings = {"source": "sample:lower-manhattan", "highest_m": {"tree": 25.0}}
    scenario = ju.Scenario.from_dict({"buildings": buildings})
    (tmp_path / "town.toml").write_text(scenario.to_toml())
    assert ju.Scenario.from_toml(tmp_path / "town.toml").buildings.highest_m == {"tree": 25.0}
