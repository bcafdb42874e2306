"""Columns of outlines as publishers name them, as the settings do, and what is asked for."""

import json
from collections.abc import Mapping
from typing import Any

import pytest

import jaxurban as ju
from jaxurban.cities.census import read_blocks
from jaxurban.cities.city import read_buildings
from jaxurban.metrics.population import Population
from tests.made_files import SQUARE, UTM, WGS84, box, osm, write_features, write_vector

NEW_YORK = "EPSG:2263"  # US survey feet, where the square lies
# A row of each publisher's table, named as in its dictionary, and the height of its roof above the ground in metres.
PUBLISHED: dict[str, tuple[Mapping[str, Any], float]] = {
    "New York": (
        {"bin": "1021905", "height_roof": "63.64", "ground_elevation": "13"},
        63.64 * 0.3048,
    ),
    "New York until 2023": ({"bin": 1, "heightroof": 400.5, "groundelev": 9.0}, 400.5 * 0.3048),
    "Los Angeles": (
        {"CODE": "Building", "BLD_ID": "3", "HEIGHT": 1018.0, "ELEV": 288.0},
        1018 * 0.3048,
    ),
    "Philadelphia": (
        {"bin": 1, "base_elevation": 48.0, "approx_hgt": 29.0, "max_hgt": 33.0},
        33 * 0.3048,
    ),
    "San Francisco": ({"hgt_maxcm": "1593", "hgt_mediancm": "1334", "gnd_mincm": "603"}, 15.93),
    "Vancouver": ({"topelev_m": 50.5, "baselev_m": 30.0, "hgt_agl": 20.5}, 20.5),
    "Toronto": (
        {
            **{"AVG_HEIGHT": 20.0, "MIN_HEIGHT": 12.0, "MAX_HEIGHT": 30.0},
            **{"SURF_ELEV": 80.0, "HEIGHT_MSL": 110.0},
        },
        30.0,
    ),
    "Melbourne": ({"structure_max_elevation": 60.0, "structure_extrusion": 42.5}, 42.5),
    "BD TOPO": ({"HAUTEUR": 6.7, "Z_MIN_SOL": 504.8, "Z_MIN_TOIT": 511.5, "NB_ETAGES": 2.0}, 6.7),
    "BD TOPO, GeoPackage": ({"hauteur": 6.7, "altitude_minimale_sol": 504.8}, 6.7),
    "3DBAG": ({"b3_h_maaiveld": -0.25, "b3_h_dak_50p": 20.0, "b3_h_dak_max": 31.0}, 31.25),
    "Hong Kong": ({"BaseHeight": 5.0, "TopHeight": 105.0}, 100.0),
    "Ordnance Survey": ({"AbsHMin": 5.0, "AbsHMax": 45.0, "RelH2": 35.0, "RelHMax": 40.0}, 40.0),
    "Ordnance Survey, NGD": (
        {"height_absolutemax_m": 45.0, "height_relativeroofbase_m": 9, "height_relativemax_m": 12},
        12.0,
    ),
    "swissBUILDINGS3D": ({"DACH_MAX": 430.5, "GELAENDEPUNKT": 410.0, "GESAMTHOEHE": 20.5}, 20.5),
    "Microsoft": ({"height": 7.5, "confidence": 0.9}, 7.5),
    "Microsoft, unknown": ({"height": -1.0, "confidence": 0.9}, 10.0),
    "Google": ({"area_in_meters": 120.0, "confidence": 0.8, "full_plus_code": "7JVW"}, 10.0),
    "Overture": (
        {
            **{"height": None, "num_floors": 4.0, "min_height": None, "roof_height": 2.5},
            **{"is_underground": False, "has_parts": False, "level": 1},
        },
        12.0,
    ),
    "GlobalBuildingAtlas": ({"source": "ms", "id": "1", "height": 8.25, "var": 1.5}, 8.25),
    "USA Structures": ({"OCC_CLS": "Residential", "HEIGHT": 6.62, "SQMETERS": 51.5}, 6.62),
    "INSPIRE": ({"numberOfFloorsAboveGround": 5, "heightBelowGround": 3.0}, 15.0),
    "Chicago": ({"stories": 3, "year_built": 1930}, 9.0),
}


def heights(path, about, crs=WGS84, near=None, **settings):
    """Return the heights in metres of squares, a row of columns each, and what was counted."""
    columns = {name: [row.get(name) for row in about] for name in about[0]}
    write_vector(path, [SQUARE] * len(about), WGS84, crs, **columns)
    file = ju.Buildings(path, default_height_m=10.0, **settings)
    city = read_buildings(file, UTM, bounds_m=near)
    issues = {name: count for name, count in city.read_issues.items() if count}
    return city.buildings.height_m.tolist(), issues


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLISHED)
def test_tables_of_publishers_are_known_by_their_columns(tmp_path, name):
    about, height_m = PUBLISHED[name]
    near = (0.0, 0.0, 1e6, 1e7)  # so that only columns of buildings are read
    found, _ = heights(tmp_path / "city.parquet", [about], near=near)
    assert found == pytest.approx([height_m], abs=1e-9)


@pytest.mark.parametrize(
    "lost", [(), ("is_underground",), ("min_floor",), ("is_underground", "min_floor", "min_height")]
)
def test_parts_of_overture_are_parts_whatever_columns_they_lack(tmp_path, lost):
    whole = {"id": "b", "building_id": None, "height": None}
    part = {"id": "p", "building_id": "b", "height": 80.0}
    more = {"is_underground": False, "min_floor": None, "min_height": None}
    kept = {name: value for name, value in more.items() if name not in lost}
    found, issues = heights(tmp_path / "city.parquet", [whole | kept, part | kept])
    assert found == [80.0]
    assert issues == {"outlines_replaced_by_parts": 1}


@pytest.mark.parametrize("name", ["BUILDING_ID", "BUILDING_I"])
def test_a_column_that_numbers_buildings_makes_no_parts_of_them(tmp_path, name):
    path = write_vector(tmp_path / "city.gpkg", [SQUARE] * 3, WGS84, **{name: [11, 12, 13]})
    assert not read_buildings(ju.Buildings(path), UTM).buildings.is_part.any()


def test_the_feet_of_a_shapefile_of_los_angeles_are_no_metres(tmp_path):
    rows = [{"BLD_ID": "1", "ELEV": 290.1, "HEIGHT": feet} for feet in (310.5, 45.2, 1018.0, 22.0)]
    found, issues = heights(tmp_path / "lariac.shp", rows, NEW_YORK)
    assert found == pytest.approx([94.6404, 13.77696, 310.2864, 6.7056])
    assert issues == {}


ASKED: dict[str, tuple[Mapping[str, Any], str, str]] = {
    "beside feet": ({"HEIGHT": 30.0}, NEW_YORK, "HEIGHT"),
    "beside feet, above any height in metres": ({"HEIGHT": 1018.0}, NEW_YORK, "HEIGHT"),
    "of no known publisher": ({"BLDG_HGT": 30.0}, UTM, "BLDG_HGT"),
    "as high as the default": ({"BLDG_HGT": 10.0}, UTM, "BLDG_HGT"),
    "as text": ({"Hoehe": "30,5"}, WGS84, "Hoehe"),
    "cut by a Shapefile": ({"BLDG_HEIGH": 30.0}, WGS84, "BLDG_HEIGH"),
    "beside an empty column": ({"height": None, "altura": 30.0}, WGS84, "altura"),
    "of which another is no roof": ({"min_height": 3.0, "max_height": 30.0}, WGS84, "max_height"),
}


@pytest.mark.parametrize("name", ASKED)
def test_heights_without_a_known_unit_are_asked_for_and_the_settings_answer(tmp_path, name):
    about, crs, column = ASKED[name]
    path = tmp_path / "city.gpkg"
    sentence = f"'{column}'.* unit: set ju.Buildings.height_column=.{column}.. and unit = .ft. or"
    with pytest.raises(ju.InputError, match=sentence) as error:
        heights(path, [about], crs)
    assert "\n" not in str(error.value)
    value = float(str(about[column]).replace(",", "."))
    found, _ = heights(path, [about], crs, height_column=column, unit="ft")
    assert found == pytest.approx([value * 0.3048])


@pytest.mark.parametrize(
    "about",
    [
        {"height": 30.0, "BLDG_HGT": 98.4},  # no height lacks
        {"height_class": 3.0, "roof_height": 4.0, "base_height": 12.0, "has_height": True},
        {"height_note": "see the plan"},
        {"HEIGHT": None},
    ],
)
def test_nothing_is_asked_where_no_height_would_change(tmp_path, about):
    assert heights(tmp_path / "city.gpkg", [about])[0] == [about.get("height", 10.0)]


def test_settings_name_columns_of_any_table(tmp_path):
    rows = [
        {"top": "1 210.5", "floor": "1190.5", "flats": 4.0},
        {"top": "12 m", "floor": None, "flats": 4.0},
    ]
    path = tmp_path / "city.gpkg"
    near = (0.0, 0.0, 1e6, 1e7)
    assert heights(path, rows, near=near, levels_column="flats")[0] == [12, 12]
    assert heights(path, rows, height_column="flats", unit="m")[0] == [4, 4]
    given = {"height_column": "floor", "ground_column": "flats", "unit": "cm"}
    found, _ = heights(path, rows, near=near, **given)
    assert found == pytest.approx([11.865, 10.0])  # the second has no roof


def test_units_in_a_text_stand_before_the_unit_of_the_column(tmp_path):
    rows = [{"top": text} for text in ("100", "100 m", "90-100", "1 401", "high")]
    found, issues = heights(tmp_path / "city.gpkg", rows, height_column="top", unit="ft")
    assert found == pytest.approx([30.48, 100, 30.48, 427.0248, 10])
    assert issues == {"heights_unusable": 1}


def test_columns_that_a_file_lacks_or_cannot_have_are_refused(tmp_path):
    with pytest.raises(ju.InputError, match="no column rooof: its columns are height"):
        heights(tmp_path / "a.gpkg", [{"height": 3.0}], height_column="rooof", unit="m")
    path = tmp_path / "city.osm"
    path.write_text(osm(boxes=[(-74, 40, -73, 41)]))
    with pytest.raises(ju.InputError, match=r"for tables of outlines, and .*osm' is none"):
        read_buildings(ju.Buildings(path, levels_column="storeys"), UTM)
    with pytest.raises(ju.InputError, match="height_column and unit go together"):
        ju.Buildings(path, unit="ft")
    with pytest.raises(ju.InputError, match="ground_column only with them"):
        ju.Buildings(path, ground_column="ground")


NESTED = {
    "tower": {"building": "yes", "height": "120", "building:levels": "30"},
    "park": {"leisure": "park", "height": "3"},
    "cellar": {"building": "yes", "location": "underground"},
    "quoted": {"building": "yes", "height": "40'6\""},
}


def test_tags_in_one_column_are_opened(tmp_path):
    # As query-overpass nests them, and as GDAL's driver of OpenStreetMap writes what has no column of its own.
    nested = [
        (SQUARE, {"type": "way", "id": number, "tags": tags})
        for number, tags in enumerate(NESTED.values())
    ]
    path = write_features(tmp_path / "nested.geojson", *nested)
    city = read_buildings(ju.Buildings(path), UTM)
    assert city.buildings.height_m.tolist() == pytest.approx([120, 40.5 * 0.3048])
    assert (city.read_issues["not_standing"], city.read_issues["underground"]) == (1, 1)

    rows = []
    for tags in NESTED.values():
        rest = {key: json.dumps(value) for key, value in tags.items() if key != "building"}
        hstore = ",".join(f'"{key}"=>{value}' for key, value in rest.items())
        rows.append({"building": tags.get("building"), "other_tags": hstore})
    found, issues = heights(tmp_path / "gdal.gpkg", rows, near=(0.0, 0.0, 1e6, 1e7))
    assert found == pytest.approx([120, 40.5 * 0.3048])
    assert (issues["not_standing"], issues["underground"]) == (1, 1)


@pytest.mark.parametrize("text", ["see below", "{", "[1, 2]", "[" * 100_000, "7", None])
def test_other_texts_in_a_column_of_tags_say_nothing(tmp_path, text):
    rows = [{"tags": text, "height": 7.0}, {"tags": "x", "height": 8.0}]
    assert heights(tmp_path / "city.parquet", rows)[0] == [7, 8]


def test_a_height_that_its_storeys_contradict_gives_way_to_them(tmp_path):
    rows = [{"height": 10.0, "building:levels": levels} for levels in (63, 7, 6, 1)]
    found, issues = heights(tmp_path / "city.gpkg", rows)
    assert found == [189, 21, 10, 10]  # 10 m leave 7 storeys less than 1.5 m each, and 6 more
    assert issues == {"heights_below_levels": 2}


def test_columns_of_people_that_differ_are_refused(tmp_path):
    shapes = [box(0, 0, 10, 10), box(10, 0, 20, 10)]
    ids = {"GEOID10": ["360610001001000", "360610001001001"]}

    def people(column=None, **columns):
        path = write_vector(tmp_path / "blocks.gpkg", shapes, **ids, **columns)
        blocks, _ = read_blocks(Population(blocks=path, column=column), UTM)
        return blocks.night_count.tolist()

    joined = {"POP_2020": [321, 885], "count": [7, 8]}
    with pytest.raises(ju.InputError, match=r"POP_2020, count: name the one in ju.Population.col"):
        people(**joined)
    assert people("POP_2020", **joined) == people(TOT_P_2021=[321, 885]) == [321, 885]
    assert people(POP100=[5, 6], P0010001=[5, 6], pop_density=[1.0, 2.0]) == [5, 6]
    with pytest.raises(ju.InputError, match=r"has no field residents.*ju.Population.column"):
        people("residents", **joined)
