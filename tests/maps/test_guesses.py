"""What files do not say: told on the terminal, in run.json, to Python and in pictures, once each."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import shapely
from matplotlib.text import Text

import jaxurban as ju
from jaxurban import plot as plotting
from jaxurban.errors import GuessWarning, speaking
from jaxurban.io.burn import burn
from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface
from jaxurban.knowledge import GuessKind, guessed
from jaxurban.maps.build import view_sky
from jaxurban.maps.guesses import leaving_share
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask
from jaxurban.metrics.population import Population
from jaxurban.world.blocks import Blocks, Zoning
from jaxurban.world.grid import Grid, transformer
from tests.cli_runs import run
from tests.guess_records import FLAT, by_name
from tests.io.test_orbits import walker_tle
from tests.made_files import UTM, WGS84, X, Y, box, north_up, write_raster, write_vector

BOUNDS = tuple(transformer(UTM, WGS84).transform_bounds(*box(5, 5, 395, 395).bounds))


def write_buildings(path, heights, levels=None):
    """Write a row of houses of 40 m x 40 m, and a covering one so that the data reach all of the region."""
    houses = [box(x, 100, x + 40, 140) for x in 20 + 90 * np.arange(len(heights))]
    levels = [*(levels or [None] * len(heights)), None, None]
    tags = {"building": "yes", "height": [*heights, "5", "5"], "building:levels": levels}
    write_vector(
        path, [*houses, box(-100, -100, -90, -90), box(450, 450, 460, 460)], to=WGS84, **tags
    )
    return houses


def write_scenario(tmp_path, extra=""):
    region = f"[region]\nbounds = {list(BOUNDS)}\nresolution_m = 10\naltitudes_m = [20]\n"
    (tmp_path / "scenario.toml").write_text(
        f'{region}[buildings]\nsource = "town.geojson"\n{extra}'
    )
    return tmp_path / "scenario.toml"


def told_by(function):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = function()
    return result, [str(item.message) for item in caught if item.category is GuessWarning]


def town(tmp_path, heights=("30",) * 4, **options):
    """Return a city of houses read from a file, and what Python was warned of."""
    write_buildings(tmp_path / "town.geojson", heights)
    return told_by(
        lambda: City.from_files(
            tmp_path / "town.geojson", **{"bounds": BOUNDS, "crs": UTM} | options
        )
    )


def guesses_of(city, region=None, **sections):
    region = region or Grid.from_bounds(BOUNDS, 10.0, UTM)
    params = MapParams((20.0,), sections=sections)
    return by_name(MapTask(city, region, view_sky(region, ju.Gps()), params).all_guesses)


def texts_of(maps):
    return [text.get_text() for text in plotting.plot_heights(maps).findobj(Text)]


@pytest.mark.slow
def test_guessed_heights_are_told_on_the_terminal_in_the_record_and_in_the_picture(
    tmp_path, capsys
):
    houses = write_buildings(
        tmp_path / "town.geojson", ["30", None, None, "25"], [None, "4", None, "2"]
    )
    code, _, err = run(capsys, "maps", write_scenario(tmp_path), "-o", tmp_path / "out")
    assert code == 0
    sentence = (
        "heights of the 4 buildings in the region are guessed (1 from the number of levels at 3 m each, "
        "1 by the median of their class): give a source with heights"
    )
    assert [
        line
        for line in err.splitlines()
        if sentence in line and line.startswith("jaxurban: warning: ")
    ]
    found = json.loads((tmp_path / "out/run.json").read_text())["warnings"]
    assert sum(sentence in warning for warning in found) == 1
    maps = ju.open_maps(tmp_path / "out")
    assert "50 % of heights" in by_name(maps.guesses)
    is_guessed = burn(np.array(houses[1:3]), np.ones(2), maps.grid, 0, "int32")[0].astype(bool)
    assert is_guessed.sum() == 32
    np.testing.assert_array_equal(maps.m("roof_guessed"), is_guessed)
    texts = texts_of(maps)
    assert "(b) height guessed: 50 % of cells with a roof" in texts
    assert {"no roof", "height known", "height guessed"} <= {*texts}
    assert any(text.startswith("Guessed: 50 % of heights") for text in texts)


def test_a_warning_names_the_commonest_kinds_and_the_record_all():
    kinds = "9,235 tree, 320 bridge, 12 mast, 3 tank, 2 wall, 1 wire"
    (guess,) = guessed(GuessKind.STRUCTURES, number=9571, kinds=kinds)
    assert "(9,235 tree, 320 bridge, 12 mast, 3 tank, 2 wall and so on)" in guess.warning
    assert f"({kinds})" in guess.sentence


def test_of_known_heights_without_terrain_only_the_ground_is_guessed_and_over_terrain_nothing(
    tmp_path,
):
    city, told = town(tmp_path)
    assert city.guesses == (FLAT,)
    assert told == [FLAT.sentence]
    maps, _ = told_by(lambda: ju.build_maps(city, BOUNDS, resolution_m=10.0, altitudes_m=[20.0]))
    assert "roof_guessed" not in maps.ds
    texts = texts_of(maps)
    assert not any("height guessed" in text for text in texts)
    assert any(text.startswith("Guessed: flat ground") for text in texts)
    write_raster(
        tmp_path / "ground.tif", np.zeros((40, 40), np.float32), north_up(50, 40, X - 500, Y - 500)
    )
    city, told = town(tmp_path, terrain=tmp_path / "ground.tif")
    assert (told, city.guesses) == ([], ())


def test_one_guessed_roof_of_many_is_known_by_all_cells_that_it_touches(tmp_path):
    bounds = transformer(UTM, WGS84).transform_bounds(*box(5, 5, 2805, 395).bounds)
    city, _ = town(tmp_path, ["30"] * 30 + [None], bounds=bounds)
    region = Grid.from_bounds(bounds, 15.0, UTM)
    assert city.buildings.guessed_share(region.bounds_m) > 0
    surface = build_surface(city, region, region, has_guessed=True)
    guessed = box(20 + 90 * 30, 100, 60 + 90 * 30, 140).buffer(-0.01)
    touched = burn(np.array([guessed]), np.ones(1), region, 0, "int32")[1]
    np.testing.assert_array_equal(surface.roof_guessed, touched.astype(bool))


@pytest.mark.slow
def test_python_is_warned_once_of_each_guess_and_maps_hold_all_of_them(tmp_path):
    city, at_reading = town(tmp_path, ["300", None, None, "25"])
    maps, at_building = told_by(
        lambda: ju.build_maps(city, BOUNDS, resolution_m=10.0, altitudes_m=[20.0])
    )
    assert [*at_reading, *at_building] == [guess.warning for guess in maps.guesses]
    assert len(at_reading) == 2
    assert any(
        "nominal ones at 2020-04-27T16:00:00Z, the paper's time" in sentence
        for sentence in at_building
    )
    assert any("rays that leave the data" in sentence for sentence in at_building)
    ran = run_scenario(Scenario.from_toml(write_scenario(tmp_path)), tmp_path / "out")
    with speaking("scenario"):  # as the run itself
        assert ran.record["warnings"] == [guess.warning for guess in ran.maps[10.0].guesses]
    assert ran.maps[10.0].guesses == maps.guesses
    np.testing.assert_array_equal(ran.maps[10.0].m("roof_guessed"), maps.m("roof_guessed"))


def test_the_synthetic_city_guesses_nothing():
    region = Grid.from_bounds((-73.971, 40.7795, -73.969, 40.7805), 20.0, UTM)
    assert guesses_of(ju.demo_city(500, 500), region) == {}


def test_elements_without_times_stand_at_their_own_time_and_nominal_ones_at_the_papers(tmp_path):
    city, _ = town(tmp_path)
    orbits = tmp_path / "galileo.tle"
    orbits.write_text(walker_tle("galileo", 40_000))
    scenario = Scenario.from_toml(write_scenario(tmp_path, '[gps]\norbits = "galileo.tle"\n'))
    made = run_scenario(scenario, tmp_path / "out")
    assert made.record["epochs"] == ["2020-04-27T00:00:00Z"]
    assert any(
        "satellites stand as at 2020-04-27T00:00:00Z" in warning
        for warning in made.record["warnings"]
    )
    region = made.maps[10.0].grid
    assert view_sky(region, ju.Gps()).times == ("2020-04-27T16:00:00Z",)
    asked = view_sky(region, ju.Gps(orbits=orbits, times="2020-04-28T00:00:00Z"))
    assert (asked.times, asked.guesses) == (("2020-04-28T00:00:00Z",), ())
    maps, told = told_by(
        lambda: ju.build_maps(city, grid=region, altitudes_m=[20.0], gps=ju.Gps(orbits=orbits))
    )
    assert maps.times == ("2020-04-27T00:00:00Z",)
    assert any("satellites stand as at" in sentence for sentence in told)


def test_the_share_of_answers_beyond_the_data_is_that_of_rays_followed_one_by_one(tmp_path):
    city, _ = town(tmp_path, ["60", "30", "30", "30"])
    region = Grid.from_bounds(BOUNDS, 20.0, UTM)
    sky = view_sky(region, ju.Gps(times=["2020-04-27T16:00:00Z", "2020-04-27T19:00:00Z"]))
    t, s = np.nonzero(sky.elevation_rad >= np.radians(5.0))
    run_m, toward = (60.0 - 20.0) / np.tan(sky.elevation_rad[t, s]), sky.azimuth_rad[t, s]
    x_m = region.x_m[None, None] + (run_m * np.sin(toward))[:, None, None]
    y_m = region.y_m[None, :, None] + (run_m * np.cos(toward))[:, None, None]
    x_min, y_min, x_max, y_max = city.known_extent_m
    leaving = (x_m < x_min) | (x_m > x_max) | (y_m < y_min) | (y_m > y_max)
    assert 0.01 < np.mean(leaving) < 0.99
    assert leaving_share(city, region, sky, 20.0) == pytest.approx(np.mean(leaving), abs=1e-12)


def test_maps_say_how_far_the_buildings_are_known(tmp_path):
    city = ju.demo_city(600, 500)
    maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=[20.0])
    maps.save(tmp_path / "maps")
    west, south, east, north = ju.open_maps(tmp_path / "maps").ds.attrs["known_bounds_m"]
    assert (east - west, north - south) == pytest.approx((600, 500))


def peopled(*sides_m):
    """A city of square blocks in a row, each with 100 people."""
    x, side_m, num = X + np.r_[0.0, np.cumsum(sides_m)[:-1]], np.array(sides_m), len(sides_m)
    polygons, zoning = (
        shapely.box(x, Y, x + side_m, Y + side_m),
        np.full(num, Zoning.RESIDENTIAL, np.uint8),
    )
    number = np.arange(num)
    blocks = Blocks(
        polygons, np.full(num, 100.0), np.full(num, 107, np.int32), zoning, number.astype(object)
    )
    extent_m = X, Y, X + 1000.0, Y + 1000.0
    return replace(ju.demo_city(500, 500), blocks=blocks, crs=UTM, extent_m=extent_m)


@pytest.mark.parametrize(("times", "is_guessed"), [(("day", "night"), True), (("night",), False)])
def test_people_of_the_day_are_a_guess_of_those_who_sleep_there(times, is_guessed):
    city = replace(peopled(60.0, 60.0), sources={"blocks": "blocks.shp"})
    said = guesses_of(city, population=Population(time_of_day=times)).get("people by factors", "")
    assert ("times 3 in commercial districts and 0.5 elsewhere" in said) == is_guessed


@pytest.mark.parametrize(
    ("side_m", "settings", "is_told"),
    [
        (10.0, {}, True),
        (10.0, {"normalise": "p95"}, False),
        (10.0, {"normalise": 3e4}, False),
        (50.0, {}, False),
    ],
)
def test_one_tiny_block_that_sets_the_population_scale_is_told_with_its_remedy(
    side_m, settings, is_told
):
    guesses = guesses_of(peopled(side_m, 60.0, 60.0, 60.0, 60.0), population=Population(**settings))
    said = guesses.get("one block sets the population scale", "")
    # By day half of its 1,000,000 people per km2 are away.
    assert (
        "census block 0 (100 m2) with 500,000 people per km2 sets the population scale alone"
        in said
    ) == is_told
    assert (
        "the median inhabited block gets 0.03; set ju.Population(normalise=...) to" in said
    ) == is_told
    assert bool(said) == is_told


def write_people(tmp_path, counts, labels=(101, 102), field="BoroCD"):
    """Write three blocks, their counts, and two districts."""
    ids = [f"36061000100100{i}" for i in range(3)]
    shapes = [box(x, -10, x + 140, 410) for x in 140 * np.arange(3) - 10]
    blocks = write_vector(tmp_path / "blocks.gpkg", shapes, GEOID10=ids)
    lines = [f'"{block}","{count}"' for block, count in zip(ids, counts, strict=False)]
    (tmp_path / "counts.csv").write_text("\n".join(["GEOID10,population", *lines]))
    halves = box(-50, -50, 200, 500), box(200, -50, 500, 500)
    districts = write_vector(tmp_path / "districts.geojson", halves, to=WGS84, **{field: labels})
    return ju.Population(
        blocks=blocks, table=tmp_path / "counts.csv", districts=districts, district_field=field
    )


def assert_told(told, words):
    """Besides the flat ground nothing was told but one sentence, or nothing at all."""
    others = [sentence for sentence in told if sentence != FLAT.sentence]
    assert [words in sentence for sentence in others] == ([] if words is None else [True])


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (
            ("120", "n/a"),
            "2 of 3 census blocks in and around the region are read as 0 people (in 1 the count can",
        ),
        (("0", "0", "0"), "all census counts in and around the region are 0"),
        (("120", "0", "7"), None),
    ],
)
def test_counts_that_are_read_as_zero_are_told(tmp_path, counts, words):
    _, told = town(tmp_path, population=write_people(tmp_path, counts))
    assert_told(told, words)


@pytest.mark.parametrize(
    ("field", "labels", "commercial", "zoned", "words"),
    [
        ("BoroCD", (101, 107), None, {"COMMERCIAL", "RESIDENTIAL"}, None),
        ("boro_cd", (101, 107), None, {"COMMERCIAL", "RESIDENTIAL"}, None),
        (
            "ward",
            (101, 107),
            None,
            {"RESIDENTIAL"},
            "commercial=...) lists no district of 'districts.geojson' (ward), so",
        ),
        ("ward", (101, 107), (107,), {"COMMERCIAL", "RESIDENTIAL"}, None),
        ("ward", (1, 2), (), {"RESIDENTIAL"}, None),
        (
            "ward",
            (1, 2),
            (101, 102),
            {"RESIDENTIAL"},
            "commercial=...) lists no district of 'districts.geojson' (ward), so",
        ),
    ],
)
def test_new_yorks_commercial_districts_are_no_other_citys(
    tmp_path, field, labels, commercial, zoned, words
):
    people = replace(
        write_people(tmp_path, ("10", "20", "30"), labels, field), commercial=commercial
    )
    city, told = town(tmp_path, population=people)
    assert {Zoning(zoning).name for zoning in city.blocks.zoning} - {"OTHER"} == zoned
    assert_told(told, words)
