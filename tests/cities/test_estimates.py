"""Heights that a model estimated, as real files say them, and what is likely and possible of such roofs."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.city import read_buildings
from jaxurban.errors import GuessWarning, InputError
from jaxurban.world.footprints import HeightOrigin
from tests.cities.test_columns import PUBLISHED
from tests.made_files import (
    LAT,
    LON,
    SQUARE,
    UTM,
    WGS84,
    box,
    node,
    osm,
    way,
    write_raster,
    write_vector,
)

ML = "Microsoft ML Buildings"
SMALL = shapely.box(LON, LAT, LON + 0.0001, LAT + 0.0001)  # 60 to 200 m2


def overture(height: str, whole: str = "OpenStreetMap") -> str:
    """Return the sources of a feature, and of its height if that is not empty, as Overture's GeoJSON has them."""
    sources = [{"property": "", "dataset": whole, "confidence": None}]
    if height:
        sources.append({"property": "/properties/height", "dataset": height, "confidence": 0.9})
    return json.dumps(sources)


# What models say of a height of 20 m, each by its publisher's page (see `estimates.py`), and up to what it may be.
ESTIMATED: dict[str, tuple[Mapping[str, Any], float]] = {
    "Microsoft": ({"confidence": 0.9}, 0.0),
    "Google": ({"area_in_meters": 120.0, "confidence": 0.8, "full_plus_code": "7JVW"}, 0.0),
    "Global Building Atlas": ({"source": "ms", "region": "EUR", "var": 81.0}, 20 + 2.33 * 9),
    "EUBUCCO": (
        {
            **{"height_source": "estimated", "height_confidence_lower": 12.0},
            **{"height_confidence_upper": 95.0, "type_confidence": 0.9},
        },
        95.0,
    ),
    "EUBUCCO of Microsoft": ({"height_source": "msft", "floors_source": "osm"}, 0.0),
    "Overture": ({"sources": overture(ML)}, 0.0),
    "Overture, whole": ({"sources": overture("", ML)}, 0.0),
    "Overture, of an article": ({"sources": overture("doi:10.1038/s41597-024-03446-2")}, 0.0),
    "OpenStreetMap": ({"source:height": "estimation from side photo"}, 0.0),
    "INSPIRE": ({"heightAboveGround_status": "estimated"}, 0.0),
    "ALKIS, by storeys": ({"DatenquelleDachhoehe": "2000"}, 0.0),
    "ALKIS, by default, as a number": ({"DQDACH": 3000.0}, 0.0),
}
MEASURED: dict[str, Mapping[str, Any]] = {
    "EUBUCCO of an office": {"height_source": "gov-france", "height_confidence_upper": 21.0},
    "EUBUCCO of OpenStreetMap": {"height_source": "osm", "type_confidence": 0.9},
    "Overture of lidar": {"sources": overture("USGS Lidar", ML)},
    "Overture of OpenStreetMap": {"sources": overture("")},
    "photogrammetry": {"height_method": "photogrammetry (digital surface model)"},
    "lidar": {"source:height": "Welsh Government LiDAR 2020 to 2023 (DSM minus DTM)"},
    "ALKIS, by laser": {"DatenquelleDachhoehe": "1000"},
    "another variance": {"height_var": 3.0, "variety": "oak"},
}


def city_of(path, *about, shape=SQUARE, **settings):
    """Return a city of equal roofs of 20 m, a row of columns each."""
    columns = {name: [row.get(name) for row in about] for name in about[0]}
    shapes = [shape] * len(about)
    write_vector(path, shapes, WGS84, **{"height": 20.0, **columns})
    return read_buildings(ju.Buildings(path, **settings), UTM)


@pytest.mark.parametrize("suffix", ["geojson", "parquet"])
@pytest.mark.parametrize("name", ESTIMATED)
def test_estimates_are_known_as_their_publishers_write_them(tmp_path, name, suffix):
    about, up_to_m = ESTIMATED[name]
    buildings = city_of(tmp_path / f"a.{suffix}", about).buildings
    assert buildings.origin.tolist() == [HeightOrigin.ESTIMATED]
    assert buildings.height_m.tolist() == [20]
    assert (buildings.upper_m[0], buildings.likely_upper_m[0]) == (
        np.inf,
        427,
    )  # as large ones have
    small = city_of(tmp_path / f"b.{suffix}", about, shape=SMALL).buildings
    assert small.upper_m[0] == max(up_to_m, 100)
    assert small.likely_upper_m[0] == pytest.approx(max(up_to_m, 40.4))


@pytest.mark.parametrize("name", MEASURED)
def test_what_was_measured_or_said_is_no_estimate(tmp_path, name):
    buildings = city_of(tmp_path / "a.geojson", MEASURED[name]).buildings
    assert buildings.origin.tolist() == [HeightOrigin.HEIGHT]


@pytest.mark.parametrize("name", sorted({*PUBLISHED} - {"Microsoft", "GlobalBuildingAtlas"}))
def test_no_official_table_is_taken_for_estimates(tmp_path, name):
    about, _ = PUBLISHED[name]
    columns = {column: [value] for column, value in about.items()}
    write_vector(tmp_path / "a.geojson", [SQUARE], WGS84, **columns)
    city = read_buildings(ju.Buildings(tmp_path / "a.geojson"), UTM)
    assert HeightOrigin.ESTIMATED not in city.buildings.origin


def test_the_confidence_of_a_survey_makes_no_estimates(tmp_path):
    about = {"height_relativemax_m": 12.0, "height_confidence": 0.9, "confidence": 1.0}
    write_vector(tmp_path / "a.gpkg", [SQUARE], WGS84, **{k: [v] for k, v in about.items()})
    city = read_buildings(ju.Buildings(tmp_path / "a.gpkg"), UTM)
    assert city.buildings.origin.tolist() == [HeightOrigin.HEIGHT]


def test_a_confidence_beside_a_height_that_names_its_unit_makes_it_an_estimate(tmp_path):
    about = {"height_m": [22.4], "height_confidence_upper": [95.0]}
    write_vector(tmp_path / "a.gpkg", [SQUARE], WGS84, **about)
    city = read_buildings(ju.Buildings(tmp_path / "a.gpkg"), UTM)
    assert city.buildings.origin.tolist() == [HeightOrigin.ESTIMATED]


def test_a_file_that_is_called_by_the_name_of_a_model_holds_estimates(tmp_path):
    city = city_of(tmp_path / "3D-GloBFP_Europe.shp", {"id": 1})
    assert city.buildings.origin.tolist() == [HeightOrigin.ESTIMATED]
    city = city_of(tmp_path / "3D-GloBFP_lidar.shp", {"height_sou": "lidar"})
    assert city.buildings.origin.tolist() == [HeightOrigin.HEIGHT]  # its row says it
    for name in ("default.shp", "from_google_earth.shp", "estimated_cost.shp"):
        city = city_of(tmp_path / name, {"id": 1})
        assert city.buildings.origin.tolist() == [HeightOrigin.HEIGHT], name


def test_each_row_says_for_itself_how_its_height_is_known(tmp_path):
    rows = [{"height_source": word} for word in ("estimated", "gov-berlin", None)]
    origin = city_of(tmp_path / "a.geojson", *rows).buildings.origin
    assert origin.tolist() == [HeightOrigin.ESTIMATED, HeightOrigin.HEIGHT, HeightOrigin.HEIGHT]


def test_the_user_says_of_any_outlines_that_their_heights_are_estimates_or_measured(tmp_path):
    path = tmp_path / "a.osm"
    corners = [(LON, LAT), (LON + 0.001, LAT), (LON, LAT + 0.001)]
    nodes = [node(number, *corner) for number, corner in enumerate(corners, 1)]
    path.write_text(osm(*nodes, way(9, (1, 2, 3, 1), building="yes", height="20")))
    known, said = (
        read_buildings(ju.Buildings(path, heights=heights), UTM).buildings.origin.tolist()
        for heights in (None, "estimated")
    )
    assert (known, said) == ([HeightOrigin.HEIGHT], [HeightOrigin.ESTIMATED])
    city = city_of(tmp_path / "a.geojson", {"height_source": "estimated"}, heights="measured")
    assert city.buildings.origin.tolist() == [HeightOrigin.HEIGHT]


def test_the_word_on_heights_is_refused_of_a_raster(tmp_path):
    path = write_raster(tmp_path / "a.tif", np.full((4, 4), 20.0, np.float32))
    with pytest.raises(InputError, match="is for outlines"):
        read_buildings(ju.Buildings(path, heights="estimated"), UTM)


@pytest.mark.parametrize(
    ("side_m", "height_m", "upper_m", "likely_m", "bound_m"),
    [
        (10.0, 20.0, 0.0, 40.4, 100.0),  # of a class with a bound, both of the class
        (10.0, 20.0, 95.0, 95.0, 100.0),  # its own is higher than what is likely
        (10.0, 20.0, 130.0, 130.0, 130.0),  # and than the bound
        (10.0, 60.0, 0.0, 60.0, 100.0),  # higher than what is likely of its class
        (10.0, 150.0, 0.0, 150.0, np.inf),  # nor has one that is higher than that of its class
        (40.0, 20.0, 95.0, 427.0, np.inf),  # large ones have no bound
    ],
)
def test_likely_and_bound_are_the_higher_of_the_model_and_of_the_class(
    tmp_path, side_m, height_m, upper_m, likely_m, bound_m
):
    about = {"height_source": "estimated", "height_confidence_upper": [upper_m]}
    path = write_vector(tmp_path / "a.gpkg", [box(0, 0, side_m, side_m)], height=height_m, **about)
    buildings = read_buildings(ju.Buildings(path), UTM).buildings
    assert buildings.height_m.tolist() == [height_m]
    assert buildings.likely_upper_m[0] == pytest.approx(likely_m)
    assert buildings.upper_m[0] == pytest.approx(bound_m)


def test_a_method_that_says_nothing_leaves_it_to_the_next_word(tmp_path):
    for word in ("unknown", "None", "n/a"):
        city = city_of(tmp_path / "a.geojson", {"height_source": word, "confidence": 0.9})
        assert city.buildings.origin.tolist() == [HeightOrigin.ESTIMATED]


@pytest.mark.parametrize(
    ("name", "is_estimated"),
    [
        *(dict.fromkeys(["predicted_height", "pred_height", "height_pred"], True).items()),
        *(dict.fromkeys(["height_est", "ml_height", "est_height"], True).items()),
        *(dict.fromkeys(["roof_h", "west_height", "htmls", "predecessor"], False).items()),
    ],
)
def test_a_column_that_the_user_names_may_say_that_it_is_of_a_model(tmp_path, name, is_estimated):
    path = write_vector(tmp_path / "a.geojson", [SQUARE], WGS84, **{name: [20.0]})
    buildings = read_buildings(ju.Buildings(path, height_column=name, unit="m"), UTM).buildings
    assert (buildings.origin[0] == HeightOrigin.ESTIMATED) == is_estimated


@pytest.mark.parametrize(
    "name", ["method", "HGT_SOURCE", "hgt_src", "height_type", "roof_height_source"]
)
def test_more_columns_say_where_a_height_is_from(tmp_path, name):
    for word, is_estimated in (("ML estimate", True), ("lidar 2019", False)):
        city = city_of(tmp_path / "a.geojson", {name: word})
        assert (city.buildings.origin[0] == HeightOrigin.ESTIMATED) == is_estimated
    for figure in ("confidence_score", "height_std", "variance"):
        city = city_of(tmp_path / "a.geojson", {figure: 0.7})
        assert city.buildings.origin[0] == HeightOrigin.ESTIMATED


@pytest.mark.parametrize("heights", [{"heights": "estimated"}, {}])
def test_a_lamp_whose_doubtful_height_exceeds_its_bound_has_none(tmp_path, heights):
    path = tmp_path / "a.osm"
    tag = "height" if heights else "est_height"
    path.write_text(osm(node(1, LON, LAT, highway="street_lamp", **{tag: "40"})))
    lamp = read_buildings(ju.Buildings(path, **heights), UTM).structures
    assert (lamp.height_m.tolist(), lamp.upper_m.tolist()) == ([40], [np.inf])


def test_highest_m_opens_estimates(tmp_path):
    about = {"height_source": "estimated", "height_confidence_upper": 95.0}
    buildings = city_of(tmp_path / "a.geojson", about, highest_m=30.0).buildings
    assert (buildings.height_m[0], buildings.likely_upper_m[0], buildings.upper_m[0]) == (
        20,
        30,
        30,
    )


def test_estimates_teach_nothing_of_unknown_heights(tmp_path):
    rows = [{"height": 30.0, "height_source": "estimated"}] * 30 + [{"height": None}]
    city = city_of(tmp_path / "a.geojson", *rows)
    assert city.buildings.height_m[-1] == 38.6  # of the packaged table


def test_a_city_of_estimates_says_first_how_many_and_what_would_open_it(tmp_path):
    path = write_vector(
        tmp_path / "a.geojson", [SQUARE] * 4, WGS84, height=20.0, confidence=[0.9, 0.9, 0.9, None]
    )
    with pytest.warns(GuessWarning) as warned:
        city = ju.City.from_files(ju.Buildings(path))
    first, *_ = map(str, (each.message for each in warned))
    assert first.startswith(
        "3 of the 4 heights of buildings in the region are estimates of a model"
    )
    assert "surface model" in first
    assert "highest_m" in first
    assert city.guesses[0].name == "75 % of heights estimated by a model"


def test_trees_of_estimated_height_keep_the_bound_of_their_kind(tmp_path):
    path = tmp_path / "a.osm"
    path.write_text(osm(node(1, LON, LAT, natural="tree", height="12")))
    trees = read_buildings(ju.Buildings(path, heights="estimated"), UTM).structures
    assert trees.origin.tolist() == [HeightOrigin.ESTIMATED]
    heights_m = trees.height_m[0], trees.likely_upper_m[0], trees.upper_m[0]
    assert heights_m == (12, 20, 35)
