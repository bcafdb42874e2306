"""Files as other programs write them: what stands in them is read, or the sentence names what helps."""

import json
import warnings

import geopandas as gpd
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.city import read_buildings
from tests.made_files import WGS84

UTM = "EPSG:32618"
SIDE = 0.0003  # degrees
HOUSE, TOWER = (shapely.box(x, 40.71, x + SIDE, 40.71 + SIDE) for x in (-74.01, -74.009))
POINT = shapely.Point(-74.008, 40.71)
FACES = ", ".join(shapely.force_3d(TOWER, z).wkt.removeprefix("POLYGON Z ") for z in (0, 120))


def heights(path):
    """Return the heights of the buildings of a file, and of its structures."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ju.errors.GuessWarning)
        city = read_buildings(ju.Buildings(path), UTM)
    return [sorted(found.height_m.tolist()) for found in (city.buildings, city.structures)]


def table(path, shapes, **columns):
    """Write a table of shapes and return its path."""
    frame = gpd.GeoDataFrame(columns, geometry=shapes, crs=WGS84)
    frame.to_file(path)
    return path


def test_surfaces_of_faces_in_a_table_stand_up_to_their_highest(tmp_path):
    path = tmp_path / "city.csv"
    path.write_text(f'WKT,height\n"{HOUSE.wkt}",8\n"POLYHEDRALSURFACE Z ({FACES})",\n')
    assert heights(path) == [[8, 120], []]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (POINT, [[8], [180]]),
        (shapely.LineString([(-74.008, 40.71), (-74.008, 40.7103)]), [[8], [180]]),
        (TOWER.exterior, [[8, 180], []]),
        (shapely.GeometryCollection([shapely.LineString(TOWER.exterior)]), [[8], [180]]),
    ],
)
def test_what_is_no_area_stands_by_its_height(tmp_path, shape, expected):
    assert heights(table(tmp_path / "city.geojson", [HOUSE, shape], height=[8, 180])) == expected


def test_layers_that_are_not_read_are_named(tmp_path):
    path = tmp_path / "city.gpkg"
    for layer, shape in (("buildings", HOUSE), ("towers", TOWER), ("chimneys", POINT)):
        gpd.GeoDataFrame({"height": [8]}, geometry=[shape], crs=WGS84).to_file(path, layer=layer)
    with pytest.warns(ju.errors.GuessWarning, match="'towers', 'chimneys' is left out"):
        read_buildings(ju.Buildings(path), UTM)


@pytest.mark.parametrize(
    "columns",
    [
        {"height": [8.0, 150.0], "height_ft": [26.2, None]},
        {"height_cm": [800, 15000]},
        {"HeightMM": [8000, 150000]},
        {"building_h": [8, 150]},
        {"floors": [3, 50]},
        {"height": ["8", None], "tags": [None, '{"height": "150"}']},
        {"other_tags": ['"height" => "8"', '"height"=>"150","name"=>NULL']},
    ],
)
def test_heights_are_taken_row_by_row_in_their_unit(tmp_path, columns):
    found, _ = heights(table(tmp_path / "city.geojson", [HOUSE, TOWER], **columns))
    assert found == pytest.approx([8, 150], abs=1.1)


@pytest.mark.parametrize("column", ["h", "ht", "bldg_ht", "roof_z", "z_max", "b3_h_dak_m", "Höhe"])
def test_plain_names_of_heights_are_asked_for(tmp_path, column):
    path = table(tmp_path / "city.geojson", [HOUSE, TOWER], **{column: [8, 150]})
    with pytest.raises(ju.InputError, match=f'height_column="{column}"'):
        heights(path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f'WKT,height\n"SRID=4326;{HOUSE.wkt}",8\n'.encode(), "sed -E"),
        (b"<osmChange><create></create></osmChange>", "osmium apply-changes"),
        (json.dumps({"type": "FeatureCollection"}).encode("utf-16"), "iconv -f UTF-16"),
        ('{"type": "FeatureCollection", "name": "é", "features": []}'.encode("latin-1"), "UTF-8"),
    ],
)
def test_texts_that_are_not_read_are_named_with_what_helps(tmp_path, text, sentence):
    path = tmp_path / ("city.csv" if text.startswith(b"WKT") else "city.geojson")
    path.write_bytes(text)
    with pytest.raises(ju.InputError, match=sentence):
        heights(path)
