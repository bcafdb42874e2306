"""GeoJSON, GeoPackage, Shapefile and GeoParquet files of buildings."""

import geopandas as gpd
import pytest
import shapely

from jaxurban.io.read.city import read_buildings
from jaxurban.settings import Buildings
from tests.io.made_files import SQUARE, UTM, WGS84, write_features, write_vector


def read(path, shapes=None, **columns):
    """Write shapes in degrees with their columns, by default a square a row, and read the buildings of the file."""
    shapes = shapes or [SQUARE] * len(next(iter(columns.values())))
    return read_buildings(Buildings(write_vector(path, shapes, WGS84, **columns)), UTM)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
@pytest.mark.parametrize("crs", [WGS84, UTM, "EPSG:2263"])
def test_every_format_in_every_crs_gives_the_same_building(tmp_path, suffix, crs):
    write_vector(tmp_path / f"city{suffix}", [SQUARE], WGS84, crs, height=[21.5])
    source = read_buildings(Buildings(tmp_path / f"city{suffix}"), UTM)
    expected = gpd.GeoSeries([SQUARE], crs=WGS84).to_crs(UTM)[0]
    assert source.buildings.height_m.tolist() == [21.5]
    assert shapely.hausdorff_distance(source.buildings.polygons[0], expected) < 0.01  # GeoJSON rounds to 1e-7 degrees
    assert source.area.bounds == pytest.approx(expected.bounds, abs=0.01)


@pytest.mark.parametrize(
    ("columns", "height_m", "issues"),
    [
        ({"HEIGHT": ["40 ft"]}, [12.192], {}),
        ({"height_m": [12.5]}, [12.5], {}),
        ({"measuredHeight": [7.25]}, [7.25], {}),
        ({"building:height": ["12'6\""]}, [3.81], {}),
        ({"building:levels": ["4"]}, [12.0], {}),
        ({"levels": [4]}, [12.0], {}),
        ({"num_floors": [4.0]}, [12.0], {}),
        ({"roof:height": ["4"]}, [10.0], {}),  # the height of the roof alone
        ({"heightroof": [4]}, [10.0], {}),  # New York's, in feet
        ({"height": [5.0, 6.0, 7.0], "is_underground": [True, False, None]}, [6, 7], {"underground": 1}),
        (
            {"levels": ["2", "2", None], "building:levels": ["3", None, None], "height": [None, None, "-1"]},
            [9, 6, 10],  # of one meaning: they fill each other's gaps
            {"heights_unusable": 1},
        ),
        (
            {"building": ["yes", None, None], "building:part": [None, "yes", None], "height": ["9", "8", "7"]},
            [8],
            {"outlines_replaced_by_parts": 1, "not_buildings": 1},
        ),
    ],
)
def test_common_columns_are_understood(tmp_path, columns, height_m, issues):
    source = read(tmp_path / "city.parquet", **columns)
    assert source.buildings.height_m.tolist() == pytest.approx(height_m)
    assert {name: count for name, count in source.read_issues.items() if count} == issues


def test_names_that_a_shapefile_cuts_are_understood(tmp_path):
    with pytest.warns(UserWarning, match="10 characters"), pytest.warns(RuntimeWarning, match="Normalized"):
        source = read(tmp_path / "city.shp", **{"building:levels": ["4"], "roof:levels": ["1"]})
    assert source.buildings.height_m.tolist() == [15.0]


def test_what_is_no_polygon_is_counted_and_left_out_and_collections_give_their_polygons(tmp_path):
    mixed = shapely.GeometryCollection([SQUARE, shapely.Point(0, 0)])
    source = read(tmp_path / "city.geojson", [SQUARE.centroid, mixed, SQUARE], height=[1, 2, 3])
    assert source.buildings.height_m.tolist() == [2.0, 3.0]
    assert source.read_issues["non_polygons"] == 1
    rings = ([[0, 0], [1, 1], [0, 0]], [[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]])
    broken = [(None, {}), *(({"type": "Polygon", "coordinates": [ring]}, {}) for ring in rings)]
    source = read_buildings(Buildings(write_features(tmp_path / "broken.geojson", *broken)), "EPSG:32631")
    assert len(source.buildings) == 1
    assert (source.read_issues["polygons_dropped"], source.read_issues["polygons_repaired"]) == (2, 1)


def test_the_layer_of_polygons_is_chosen_or_asked_for(tmp_path):
    for layer, shape in (("trees", SQUARE.centroid), ("houses", SQUARE)):
        gpd.GeoDataFrame({"height": [5]}, geometry=[shape], crs=WGS84).to_file(tmp_path / "a.gpkg", layer=layer)
    assert read_buildings(Buildings(tmp_path / "a.gpkg"), UTM).buildings.height_m.tolist() == [5.0]
    for layer in ("parcels", "Buildings"):
        gpd.GeoDataFrame({"height": [7]}, geometry=[SQUARE], crs=WGS84).to_file(tmp_path / "a.gpkg", layer=layer)
    assert read_buildings(Buildings(tmp_path / "a.gpkg"), UTM).buildings.height_m.tolist() == [7.0]
