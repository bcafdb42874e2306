"""GeoJSON, GeoPackage, Shapefile and GeoParquet files of buildings."""

import json
import os
import socket

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.orbits import read_orbits
from jaxurban.io.read.osm import read_osm
from jaxurban.io.read.raster import raster_extent_m
from jaxurban.io.read.vector import open_layers, read_vector
from jaxurban.io.tables import read_table
from jaxurban.maps.scenario import Scenario
from jaxurban.settings import Buildings

UTM, WGS84 = "EPSG:32618", "EPSG:4326"
SQUARE = shapely.box(-74.0, 40.7, -73.999, 40.701)


def frame(columns, shapes=None, crs=WGS84):
    num_rows = len(next(iter(columns.values())))
    return gpd.GeoDataFrame(columns, geometry=shapes or [SQUARE] * num_rows, crs=crs)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
@pytest.mark.parametrize("crs", [WGS84, UTM, "EPSG:2263"])
def test_every_format_in_every_crs_gives_the_same_building(tmp_path, suffix, crs):
    path = tmp_path / f"city{suffix}"
    table = frame({"height": [21.5]}).to_crs(crs)
    if suffix == ".parquet":
        table.to_parquet(path)
    else:
        table.to_file(path)
    source = read_buildings(Buildings(path), UTM)
    expected = frame({"height": [0]}).to_crs(UTM).geometry[0]
    assert source.buildings.height_m.tolist() == [21.5]
    assert shapely.hausdorff_distance(source.buildings.polygons[0], expected) < 0.01  # GeoJSON rounds to 1e-7 degrees
    assert source.area.bounds == pytest.approx(expected.bounds, abs=0.01)


@pytest.mark.parametrize(
    ("column", "value", "height_m"),
    [
        ("HEIGHT", "40 ft", 12.192),
        ("height_m", 12.5, 12.5),
        ("measuredHeight", 7.25, 7.25),
        ("building:height", "12'6\"", 3.81),
        ("building:levels", "4", 12.0),
        ("levels", 4, 12.0),
        ("num_floors", 4.0, 12.0),
        ("roof:height", "4", 10.0),  # the height of the roof alone
        ("heightroof", 4, 10.0),  # New York's, in feet
    ],
)
def test_common_columns_are_understood(tmp_path, column, value, height_m):
    path = tmp_path / "city.geojson"
    frame({column: [value]}).to_file(path)
    assert read_buildings(Buildings(path), UTM).buildings.height_m[0] == pytest.approx(height_m)


def test_names_that_a_shapefile_cuts_are_understood(tmp_path):
    path = tmp_path / "city.shp"
    with pytest.warns(UserWarning, match="10 characters"), pytest.warns(RuntimeWarning, match="Normalized"):
        frame({"building:levels": ["4"], "roof:levels": ["1"]}).to_file(path)
    assert read_buildings(Buildings(path), UTM).buildings.height_m.tolist() == [15.0]


def test_columns_of_one_meaning_fill_each_others_gaps(tmp_path):
    path = tmp_path / "city.gpkg"
    frame({"levels": ["2", "2", None], "building:levels": ["3", None, None], "height": [None, None, "-1"]}).to_file(
        path
    )
    source = read_buildings(Buildings(path), UTM)
    assert source.buildings.height_m.tolist() == [9.0, 6.0, 10.0]
    assert source.read_issues["heights_unusable"] == 1


def test_the_rules_for_parts_hold_for_vector_files(tmp_path):
    path = tmp_path / "city.geojson"
    columns = {"building": ["yes", None, None], "building:part": [None, "yes", None], "height": ["9", "8", "7"]}
    frame(columns).to_file(path)
    source = read_buildings(Buildings(path), UTM)
    assert source.buildings.height_m.tolist() == [8.0]
    assert source.read_issues["outlines_replaced_by_parts"] == 1
    assert source.read_issues["not_buildings"] == 1


def test_what_overture_says_is_underground_is_left_out(tmp_path):
    path = tmp_path / "city.parquet"
    frame({"height": [5.0, 6.0, 7.0], "is_underground": [True, False, None]}).to_parquet(path)
    assert read_buildings(Buildings(path), UTM).buildings.height_m.tolist() == [6.0, 7.0]


def test_points_are_counted_and_left_out_and_collections_give_their_polygons(tmp_path):
    path = tmp_path / "city.geojson"
    mixed = shapely.GeometryCollection([SQUARE, shapely.Point(0, 0)])
    frame({"height": [1, 2, 3]}, [SQUARE.centroid, mixed, SQUARE]).to_file(path)
    source = read_buildings(Buildings(path), UTM)
    assert source.buildings.height_m.tolist() == [2.0, 3.0]
    assert source.read_issues["non_polygons"] == 1


def test_empty_and_broken_geometries_are_counted(tmp_path):
    path = tmp_path / "city.geojson"
    rings = ([[0, 0], [1, 1], [0, 0]], [[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]])
    geometries = [None, *({"type": "Polygon", "coordinates": [ring]} for ring in rings)]
    features = [{"type": "Feature", "properties": {}, "geometry": geometry} for geometry in geometries]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    source = read_buildings(Buildings(path), "EPSG:32631")
    assert len(source.buildings) == 1
    assert (source.read_issues["polygons_dropped"], source.read_issues["polygons_repaired"]) == (2, 1)


def test_metres_in_a_geojson_are_refused_with_the_remedy(tmp_path):
    path = tmp_path / "metres.geojson"
    feature = {"type": "Feature", "properties": {}, "geometry": shapely.box(583000, 4506000, 583010, 4506010)}
    feature["geometry"] = json.loads(shapely.to_geojson(feature["geometry"]))
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    with pytest.raises(InputError, match=r"metres\.geojson.*degrees.*583010, 4506010.*ogr2ogr"):
        read_vector(path)


@pytest.mark.parametrize("suffix", [".shp", ".gpkg", ".parquet"])
def test_a_file_without_crs_is_refused_with_the_remedy(tmp_path, suffix):
    path = tmp_path / f"nowhere{suffix}"
    table = frame({"height": [1]}, crs=None)
    if suffix == ".parquet":
        table.to_parquet(path)
    else:
        with pytest.warns(UserWarning, match="crs"):
            table.to_file(path)
    with pytest.raises(InputError, match=r"nowhere.*no CRS.*-a_srs"):
        read_vector(path)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
@pytest.mark.parametrize("content", [b"", b"no map at all", b'{"type": "FeatureCollection", "features": [{'])
def test_a_file_of_another_kind_is_refused_by_name(tmp_path, suffix, content):
    path = tmp_path / f"city{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="city"):
        read_vector(path)


@pytest.mark.parametrize("name", ["blocks.zip", "blocks.gdb", "blocks.tab"])
def test_a_format_that_is_not_read_is_refused_with_what_to_do(tmp_path, name):
    path = tmp_path / name
    path.mkdir() if name.endswith("gdb") else path.write_bytes(b"PK\x03\x04 and more")
    with pytest.raises(InputError, match=rf"{name}' is of a format that is not read: unpack it, or .*`ogr2ogr`$"):
        open_layers(path, "no-fly")


def test_a_table_without_geometry_is_refused(tmp_path):
    path = tmp_path / "table.parquet"
    pd.DataFrame({"height": np.ones(2)}).to_parquet(path)
    with pytest.raises(InputError, match=r"table\.parquet"):
        read_vector(path)


def test_the_layer_of_polygons_is_chosen_or_asked_for(tmp_path):
    path = tmp_path / "layers.gpkg"
    frame({"height": [1]}, [SQUARE.centroid]).to_file(path, layer="trees")
    frame({"height": [5]}).to_file(path, layer="houses")
    assert read_buildings(Buildings(path), UTM).buildings.height_m.tolist() == [5.0]
    frame({"height": [6]}).to_file(path, layer="parcels")
    with pytest.raises(InputError, match=r"layers\.gpkg.*trees, houses, parcels.*buildings"):
        read_vector(path)
    frame({"height": [7]}).to_file(path, layer="Buildings")
    assert read_buildings(Buildings(path), UTM).buildings.height_m.tolist() == [7.0]


def test_a_file_without_polygons_is_refused(tmp_path):
    path = tmp_path / "trees.geojson"
    frame({"height": [1]}, [SQUARE.centroid]).to_file(path)
    with pytest.raises(InputError, match=r"trees\.geojson.*holds no building"):
        read_buildings(Buildings(path), UTM)


URL = "http://127.0.0.1:{port}/x.geojson"
SOURCE = "<OGRVRTLayer name='b'><SrcDataSource>/vsicurl/{url}</SrcDataSource></OGRVRTLayer>"
VRT = f"<OGRVRTDataSource>{SOURCE}</OGRVRTDataSource>"
LINKED = (
    '{{"type": "FeatureCollection", "{crs}": {{"type": "{kind}", "properties": {{"href": "{url}", "url": "{url}"}}}}, '
)
LINKED += '"features": []}}'
STREAM = '{{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read /vsicurl/{url} ! write"}}'


@pytest.mark.parametrize("text", [VRT, STREAM, '{{"a": "' + VRT + '"}}', "<?xml version='1.0'?>" + VRT])
@pytest.mark.parametrize("suffix", [".geojson", ".kml", ".gpkg", ""])
def test_a_file_that_sends_gdal_to_a_server_is_refused_before_a_request(tmp_path, text, suffix):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        path = tmp_path / f"city{suffix}"
        path.write_text(text.format(url=URL.format(port=server.getsockname()[1])))
        for read in (read_vector, lambda path: open_layers(path, "zones")):
            with pytest.raises(InputError, match="city"):
                read(path)
        with pytest.raises(TimeoutError):
            server.accept()


@pytest.mark.parametrize("crs", ["crs", r"\u0063rs"])
@pytest.mark.parametrize("kind", ["link", "URL"])
def test_a_geojson_whose_crs_is_on_a_server_is_refused_before_a_request(tmp_path, crs, kind):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        path = tmp_path / "city.geojson"
        path.write_text(LINKED.format(crs=crs, kind=kind, url=URL.format(port=server.getsockname()[1])))
        with pytest.raises(InputError, match="refers to other files or servers"):
            read_vector(path)
        with pytest.raises(TimeoutError):
            server.accept()


@pytest.mark.parametrize("suffix", [".geojson", ".parquet", ".shp", ".tif", ".osm", ".csv", ".toml", ".tle"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, suffix):
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    readers = {".tif": raster_extent_m, ".osm": read_osm, ".csv": read_table, ".toml": Scenario.from_toml}
    readers[".tle"] = read_orbits
    arguments = {".tif": ["EPSG:32631"], ".csv": ["routes"]}
    with pytest.raises(InputError, match=r"pipe.*a pipe or a device"):
        readers.get(suffix, read_vector)(path, *arguments.get(suffix, []))
