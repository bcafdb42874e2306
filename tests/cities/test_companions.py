"""CRSs in files and in what lies beside them: every reader refuses one that names another file, and opens none."""

import json
import os
import warnings

import geopandas as gpd
import laspy
import numpy as np
import pyarrow.parquet as pq
import pyproj
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.base_map import read_base_map
from jaxurban.cities.city import lonlat_extent
from jaxurban.cities.raster import read_raster
from jaxurban.cities.vector import read_vector
from jaxurban.io.geoparquet import read_geoparquet
from tests.made_files import UTM, box, refused, write_raster, write_vector

DATUM = 'DATUM["x",SPHEROID["Bessel",6377397.155,299.15]%s]'
WKT = (
    'PROJCS["x",GEOGCS["x",%s,PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",9],UNIT["metre",1]%s]'
)
NAMED = "names another file|refers to other files"
HOUSE = box(0, 0, 100, 100)


@pytest.fixture
def other(tmp_path):
    """A file by which PROJ makes a sound CRS of `texts_of`, if it opens it."""
    (tmp_path / "other").write_text("<x> +proj=utm +zone=32 +ellps=GRS80 <>\n")
    return tmp_path / "other"


def texts_of(other) -> dict[str, str]:
    return {
        "init": f"+init={other}:x",
        "extension": WKT % (DATUM % "", f',EXTENSION["PROJ4","+init={other}:x"]'),
        "grids": WKT % (DATUM % f',EXTENSION["PROJ4_GRIDS","{other}"]', ""),
    }


KINDS = ["init", "extension", "grids"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("end", [".prj", ".PRJ", ".Prj"])
def test_a_shapefile_whose_prj_names_a_file_is_refused(tmp_path, other, kind, end):
    path = write_vector(tmp_path / "town.shp", [HOUSE], height=[9.0])
    path.with_suffix(".prj").unlink()
    path.with_suffix(end).write_text(texts_of(other)[kind])
    refused(read_vector, path, None, NAMED)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("escape", [str, lambda text: text.replace("i", "\\u0069")])
@pytest.mark.parametrize("more", [{}, {"type": "OGC"}, {"a": {"b": {}}}])
def test_a_geojson_whose_crs_names_a_file_is_refused(tmp_path, other, kind, escape, more):
    text = texts_of(other)[kind]
    crs = {"type": "name", **more, "properties": {"name": text, "urn": text}}
    content = {"type": "FeatureCollection", "crs": crs, "features": []}
    written = escape(json.dumps(content)).encode()
    refused(read_vector, tmp_path / "town.geojson", written, NAMED)


@pytest.mark.parametrize("kind", ["extension", "grids"])
@pytest.mark.parametrize("name", ["town.gpkg", "town.fgb"])
@pytest.mark.filterwarnings("ignore")
def test_a_database_whose_definition_names_a_file_is_refused(tmp_path, other, kind, name):
    frame = gpd.GeoDataFrame({"height": [9.0]}, geometry=[HOUSE], crs=texts_of(other)[kind])
    frame.to_file(tmp_path / name)
    refused(read_vector, tmp_path / name, None, NAMED)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["town.tif.aux.xml", "town.TIF.AUX.XML"])
def test_a_raster_whose_companion_names_a_file_is_refused(tmp_path, other, kind, name):
    path = write_raster(tmp_path / "town.tif", np.ones((4, 4)))
    text = texts_of(other)[kind].replace('"', "&quot;").replace("i", "&#105;")
    (tmp_path / name).write_text(f"<PAMDataset><SRS>{text}</SRS></PAMDataset>")
    refused(lambda path: read_raster(path, UTM), path, None, NAMED)


def test_a_companion_that_is_a_pipe_is_not_opened(tmp_path):
    path = write_vector(tmp_path / "town.shp", [HOUSE], height=[9.0])
    path.with_suffix(".prj").unlink()
    os.mkfifo(path.with_suffix(".prj"))
    refused(read_vector, path, None, "it is a pipe or a device")


@pytest.mark.parametrize("name", ["town.gpkg", "town.fgb"])
def test_what_is_no_companion_of_a_file_says_nothing_of_it(tmp_path, other, name):
    path = write_vector(tmp_path / name, [HOUSE], height=[9.0])
    path.with_suffix(".prj").write_text(texts_of(other)["init"])
    assert len(read_vector(path).polygons) == 1


def parquet(path, crs):
    frame = gpd.GeoDataFrame(
        {"kind": ["park"], "name": [""], "height": [9.0]}, geometry=[HOUSE], crs=UTM
    )
    frame.to_parquet(path)
    table = pq.read_table(path)
    metadata = table.schema.metadata
    geo = json.loads(metadata[b"geo"])
    geo["columns"]["geometry"]["crs"] = crs
    pq.write_table(table.replace_schema_metadata({**metadata, b"geo": json.dumps(geo)}), path)
    return path


@pytest.mark.parametrize("is_json", [True, False])
@pytest.mark.parametrize(
    "read", [read_vector, lambda path: read_base_map(path, UTM, HOUSE.bounds), read_geoparquet]
)
def test_a_geoparquet_file_whose_metadata_name_a_file_is_refused(tmp_path, other, is_json, read):
    crs = f"+init={other}:x"
    if is_json:
        crs = pyproj.CRS(f"+proj=utm +zone=32 +nadgrids={other} +type=crs").to_json_dict()
    refused(read, parquet(tmp_path / "town.parquet", crs), None, "names another file")


@pytest.mark.parametrize("name", ["town.city.json", "town.gml"])
def test_a_city_model_whose_crs_names_a_file_is_refused(tmp_path, other, name):
    crs = f"+init={other}:x"
    ring = "0 0 9 9 0 9 9 9 9 0 0 9"
    text = (
        '<CityModel xmlns="http://www.opengis.net/citygml/2.0" xmlns:g="http://www.opengis.net/gml" '
        f'xmlns:b="http://www.opengis.net/citygml/building/2.0"><cityObjectMember><b:Building>'
        f'<b:lod1MultiSurface><g:MultiSurface srsName="{crs}"><g:surfaceMember><g:Polygon><g:exterior>'
        f"<g:LinearRing><g:posList>{ring}</g:posList></g:LinearRing></g:exterior></g:Polygon>"
        "</g:surfaceMember></g:MultiSurface></b:lod1MultiSurface></b:Building></cityObjectMember></CityModel>"
    )
    if name.endswith("json"):
        geometry = {"type": "MultiSurface", "lod": "1", "boundaries": [[[0, 1, 2]]]}
        model = {
            "type": "CityJSON",
            "version": "1.1",
            "metadata": {"referenceSystem": crs},
            "transform": {"scale": [1, 1, 1], "translate": [0, 0, 0]},
            "CityObjects": {"a": {"type": "Building", "geometry": [geometry]}},
            "vertices": [[0, 0, 9], [9, 0, 9], [9, 9, 9]],
        }
        text = json.dumps(model)
    refused(lonlat_extent, tmp_path / name, text.encode(), r"declares the CRS \+init=.*: set")


def points(path, crs):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets = [4_467_118.0, 5_331_599.0, 500.0]
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(crs))
    header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x = header.offsets[0] + np.array([0.0, 99.0])
    las.y = header.offsets[1] + np.array([0.0, 99.0])
    las.z = np.array([500.0, 530.0])
    las.classification = np.array([2, 6], np.uint8)
    las.write(path)
    return path


@pytest.mark.parametrize("kind", ["extension", "grids"])
def test_lidar_points_whose_header_names_a_file_are_refused(tmp_path, other, kind):
    path = points(tmp_path / "town.las", texts_of(other)[kind])
    refused(lonlat_extent, path, None, "names another file")


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:25832+5783"])
@pytest.mark.parametrize("end", [".las", ".parquet", ".gpkg", ".tif"])
def test_every_reader_refuses_a_wrong_zone_with_heights_and_without(tmp_path, crs, end):
    path = tmp_path / f"town{end}"
    parsed = pyproj.CRS(crs)
    where = (4_467_118.0, 5_331_599.0, 4_467_218.0, 5_331_699.0)  # Munich, in zone 4
    if end == ".las":
        points(path, parsed.to_wkt())
    elif end == ".tif":
        transform = (1.0, 0.0, where[0], 0.0, -1.0, where[3])
        write_raster(path, np.ones((100, 100)), transform, parsed.to_wkt())
    else:
        frame = gpd.GeoDataFrame({"height": [9.0]}, geometry=[shapely.box(*where)], crs=crs)
        frame.to_parquet(path) if end == ".parquet" else frame.to_file(path)
    refused(lonlat_extent, path, None, "far from the area for which that is made")


@pytest.mark.parametrize("crs", ["+init={}:x", "+proj=utm +zone=32 +nadgrids={} +type=crs"])
def test_a_crs_of_the_settings_that_names_a_file_is_refused(tmp_path, other, crs):
    path = write_vector(tmp_path / "town.gpkg", [HOUSE], height=[9.0])
    text = crs.replace("{}", str(other))
    region = {"bounds": [8.99, 48.0, 9.01, 48.01], "crs": text}
    with warnings.catch_warnings(action="ignore"):
        for read in (
            lambda: ju.City.from_files(ju.Buildings(path, crs=text)),
            lambda: ju.Grid.from_bounds(region["bounds"], 10.0, crs=text),
            lambda: ju.Scenario.from_dict({"region": region, "buildings": {"source": str(path)}}),
        ):
            with pytest.raises(ju.InputError, match="names another file"):
                read()
