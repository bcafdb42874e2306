"""What known heights say of unknown ones: the order statistic, the file's own and packaged values, the user's word."""

import numpy as np
import pytest
import shapely
from scipy.stats import binom

import jaxurban as ju
from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.learned import LEAST_KNOWN, PACKAGED, classes_of, learned_from, likely_of
from tests.io.made_files import write_vector

UTM = "EPSG:32618"
SMALL, LARGE = "buildings of 60 to 200 m2", "buildings above 1,000 m2"


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
    (learned,) = learned_from(np.full(num + 1, SMALL, object), known_m).values()
    assert learned.highest_m == 30
    assert learned.num_known == num * is_own
    rank = int(np.ceil((num + 1) * 0.99))
    own = known_m[rank - 1]
    assert learned.likely_m == (own if is_own else PACKAGED[SMALL])


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
    assert part.learned[SMALL].num_known == 399
    assert len(part.buildings) < 5
    (unknown,) = part.buildings.likely_upper_m[part.buildings.is_guessed]
    assert unknown == part.learned[SMALL].likely_m < 20


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


def test_word_of_the_user_is_a_guess_of_the_city_and_of_its_scenario(tmp_path):
    with pytest.warns(ju.GuessWarning, match="highest_m = 40"):
        city = ju.City.from_files(
            ju.Buildings("sample:lower-manhattan", highest_m=40.0),
            bounds=(-74.012, 40.705, -74.010, 40.707),
        )
    assert any("highest_m = 40" in guess.name for guess in city.guesses)
    buildings = {"source": "sample:lower-manhattan", "highest_m": {"tree": 25.0}}
    scenario = ju.Scenario.from_dict({"buildings": buildings})
    (tmp_path / "town.toml").write_text(scenario.to_toml())
    assert ju.Scenario.from_toml(tmp_path / "town.toml").buildings.highest_m == {"tree": 25.0}
