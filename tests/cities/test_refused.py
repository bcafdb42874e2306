"""What no reader takes: one sentence that names the file and says what to do, and no request to a server."""

import json
import os
import socket
from functools import partial
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.census import read_blocks, read_districts
from jaxurban.cities.city import read_buildings
from jaxurban.cities.land_cover import read_land_cover
from jaxurban.cities.osm import read_osm
from jaxurban.cities.raster import raster_extent_m, read_raster
from jaxurban.cities.vector import open_layers, read_vector
from jaxurban.flights.airspace import read_zones
from jaxurban.io.orbits import read_orbits
from jaxurban.receivers.validation.logs import read_receiver_log
from jaxurban.settings import SLABS
from tests.made_files import (
    FEET,
    SQUARE,
    UTM,
    WGS84,
    X,
    Y,
    box,
    refused,
    write_features,
    write_raster,
    write_vector,
)

BLOCK = "360610001001000"

pytestmark = pytest.mark.filterwarnings(
    "ignore:.crs. was not provided"
)  # by those that write such files here

read_pixels = partial(read_raster, crs=UTM)
read_labels = partial(read_districts, crs=UTM)
read_layers = partial(open_layers, role="no-fly")


def buildings(path, **settings):
    return read_buildings(ju.Buildings(path, **settings), UTM)


def blocks(path, bounds_m=None, **settings):
    return read_blocks(ju.Population(blocks=path, **settings), UTM, bounds_m)


def counts(path):
    """Read a table of people beside sound blocks."""
    return blocks(
        write_vector(path.with_name("sound.gpkg"), [box(0, 0, 9, 9)], GEOID10=[BLOCK]), table=path
    )


def cover(path):
    return read_land_cover(path, UTM, (583_000, 4_507_000, 584_000, 4_508_000))


READERS = {
    "city.osm.pbf": buildings,
    "roofs.tif": buildings,
    **dict.fromkeys(("city.geojson", "city.gpkg", "city.shp", "city.parquet"), read_vector),
    "city.osm": read_osm,
    "cover.osm": cover,
    "dem.tif": read_pixels,
    "extent.tif": partial(raster_extent_m, crs=UTM),
    **dict.fromkeys(("zones.geojson", "zones.json", "zones.kml", "zones.gpkg"), read_zones),
    "blocks.shp": blocks,
    "people.tif": blocks,
    "counts.csv": counts,
    "districts.geojson": read_labels,
    **dict.fromkeys(("sky.tle", "sky.json", "sky.csv"), read_orbits),
    **dict.fromkeys(("log.csv", "log.parquet"), read_receiver_log),
    "city.toml": ju.Scenario.from_toml,
}
FAULTS = {
    "missing": (None, "does not exist|No such file"),
    "pipe": (os.mkfifo, "a pipe or a device|does not exist"),
    "empty": (b"", "."),
    "nonsense": (b"no map at all", "."),
    "zeros": (bytes(200), "."),
    "cut short": (b'{"type": "FeatureCollection", "features": [{', "."),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", READERS)
def test_a_file_that_is_none_is_refused_by_every_reader(tmp_path, name, fault):
    refused(READERS[name], tmp_path / name, *FAULTS[fault])


def of(shapes, **how):
    return partial(write_vector, shapes=shapes, **how)


def pixels(*values, **how):
    return partial(write_raster, values=np.float32([values]), **how)


def cut_raster(path):
    noise = np.random.default_rng(0).random((200, 200), np.float32)
    path.write_bytes(write_raster(path, noise).read_bytes()[:80_000])


def layered(path):
    write_vector(path, [SQUARE], WGS84)
    gpd.GeoDataFrame(geometry=[SQUARE], crs=WGS84).to_file(path, layer="parcels")


def metres(path):
    write_features(path, (box(0, 0, 10, 10), {}))


UNREAD = "' is of a format that is not read: unpack it, or .*`ogr2ogr`$"
BROKEN_OSM = (
    b"<gpx></gpx>",
    b'<osm version="0.6"><node id="1"',
    b'<osm version="0.6"><node id="1" lat="x" lon="0"/></osm>',
    b'<osm version="0.6"><node id="x" lat="0" lon="0"/></osm>',
)


RING = [[8.5, 47.3], [8.501, 47.3], [8.501, 47.301], [8.5, 47.3]]
SHAPE = {"type": "Polygon", "coordinates": [RING]}
ROW = json.dumps({"type": "Feature", "properties": {"height": 40}, "geometry": SHAPE})
ROWS = f"{ROW}\n{ROW}\n".encode()
TWICE = f'WKT,height,height\n"{shapely.Polygon(RING).wkt}",40,9\n'.encode()


@pytest.mark.parametrize(
    ("read", "name", "content", "sentence"),
    [
        (read_vector, "metres.geojson", metres, "degrees.*583010, 4506010.*ogr2ogr"),
        *(
            (read_vector, f"a.{end}", of([SQUARE], crs=None), "no CRS.*-a_srs")
            for end in ("shp", "gpkg", "parquet")
        ),
        (
            read_vector,
            "table.parquet",
            pd.DataFrame({"height": [1.0]}).to_parquet,
            "holds no geometry",
        ),
        (read_vector, "layers.gpkg", layered, "layers, parcels.*buildings"),
        *(
            (read_layers, name, b"PK\x03\x04 and more", UNREAD)
            for name in ("blocks.zip", "blocks.tab")
        ),
        (read_layers, "blocks.tab", b"!table", UNREAD),
        (read_layers, "blocks.gdb", Path.mkdir, "as a vector file .*damaged"),
        (read_layers, "a.shp", of([SQUARE], crs=None), "declares no CRS"),
        (buildings, "twice.csv", TWICE, "several columns called 'height': rename"),
        (buildings, "cut.geojsonl", ROWS[:-60], "cut short.*give a whole one"),
        (buildings, "trees.geojson", of([SQUARE.centroid], crs=WGS84), "holds no building"),
        (buildings, "city.dwg", b"", r"'\.dwg'.*\.pbf.*\.gpkg.*\.tif"),
        (buildings, "folder", Path.mkdir, "is empty: name the file of buildings"),
        *(
            (buildings, "roofs.tif", pixels(1, value), " 1 cells")
            for value in (np.nan, 1001, -9999)
        ),
        (
            partial(buildings, kind="surface"),
            "city.geojson",
            b"",
            'kind="surface".* is for rasters',
        ),
        (partial(buildings, hanging=SLABS), "roofs.tif", b"", "is for outlines"),
        (
            read_pixels,
            "a.tif",
            pixels(1, np.nan, np.inf),
            "2 cells that are NaN or infinite.*-a_nodata",
        ),
        (
            read_pixels,
            "a.tif",
            pixels(1, np.nan, nodata=-9999),
            "1 cells that are NaN or infinite.*-a_nodata",
        ),
        (read_pixels, "a.tif", pixels(1, -9999), "1 cells outside -500 to 9000 m.*-a_nodata"),
        (read_pixels, "a.tif", pixels(1, crs=None), "no CRS"),
        (read_pixels, "a.tif", pixels(1, bands=2), "has 2 bands"),
        (read_pixels, "a.tif", cut_raster, "cannot be read as a raster"),
        (read_pixels, "a.tif", pixels(1, units="furlong"), "'furlong'.*-units m"),
        (
            read_pixels,
            "a.tif",
            pixels(1, **FEET),
            r"does not say plainly.*US survey foot.*gdal_edit\.py -units m",
        ),
        (
            partial(read_pixels, bounds_m=(X + 9000, Y, X + 9100, Y + 100)),
            "a.tif",
            pixels(1),
            "not reach the region",
        ),
        *(
            (READERS["city.osm"], "a.osm", text, "cannot be read as OpenStreetMap data")
            for text in BROKEN_OSM
        ),
        (counts, "a.csv", b"id,population\n", "joins no block"),
        (
            counts,
            "a.csv",
            f"id,a,b\n{BLOCK},1,2\n".encode(),
            "name one of 'id', 'a', 'b' in ju.Population.column",
        ),
        (
            counts,
            "a.csv",
            f"id,population\n{BLOCK},1\n{BLOCK},2\n".encode(),
            "more than one count for the block",
        ),
        (
            blocks,
            "a.gpkg",
            of([SQUARE], GEOID10=[BLOCK]),
            r"no field of population .* set ju\.Population\(table",
        ),
        (blocks, "people.tif", pixels(1, -200), "1 pixels of less than 0 people: declare"),
        (
            partial(blocks, table="a.csv"),
            "people.tif",
            pixels(1),
            "leave ju.Population.table=.... and column out",
        ),
        (
            partial(blocks, bounds_m=(0, 0, 10, 10)),
            "people.tif",
            pixels(1),
            "does not reach the region",
        ),
        (
            read_labels,
            "a.gpkg",
            of([SQUARE], BoroCD=["Harlem"]),
            "the label Harlem .*whole numbers",
        ),
        (read_labels, "a.gpkg", of([SQUARE], BoroC=[1]), "'BoroCD' .did you mean 'BoroC'"),
        (
            cover,
            "a.pbf",
            b"not a pbf at all",
            r"fetch it again, or name another file in ju\.studies\.Study\(land_cover",
        ),
        (read_labels, "torn.gpkg", b"SQLite format 3\x00 torn", "cannot be read as a vector file"),
        (read_labels, "empty.geojson", write_features, "holds no polygons"),
    ],
)
def test_what_does_not_serve_is_refused_with_the_remedy(tmp_path, read, name, content, sentence):
    refused(read, tmp_path / name, content, sentence)


URL = "http://127.0.0.1:PORT/x"
SOURCE = f"<OGRVRTLayer name='b'><SrcDataSource>/vsicurl/{URL}</SrcDataSource></OGRVRTLayer>"
VRT = f"<OGRVRTDataSource>{SOURCE}</OGRVRTDataSource>"
STREAM = f'{{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read /vsicurl/{URL} ! write"}}'
LINK = f'{{"type": "%s", "properties": {{"href": "{URL}", "url": "{URL}"}}}}'
LINKED = f'{{"type": "FeatureCollection", "%s": {LINK}, "features": []}}'
MOSAIC = f"""<VRTDataset rasterXSize="2" rasterYSize="2"><SRS>EPSG:32618</SRS><GeoTransform>0,1,0,0,0,-1</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename>/vsicurl/{URL}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""


@pytest.mark.parametrize(
    ("read", "suffix", "text"),
    [
        *(
            (read, suffix, text)
            for read in (read_vector, read_layers)
            for suffix in (".geojson", ".kml", ".gpkg", "")
            for text in (VRT, STREAM, f'{{"a": "{VRT}"}}', f"<?xml version='1.0'?>{VRT}")
        ),
        *(
            (read_vector, ".geojson", LINKED % (crs, kind))
            for crs in ("crs", r"\u0063rs")
            for kind in ("link", "URL")
        ),
        *((READERS["extent.tif"], suffix, MOSAIC) for suffix in (".vrt", ".tif")),
    ],
)
def test_a_file_that_names_a_server_is_refused_before_a_request(tmp_path, read, suffix, text):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        content = text.replace("PORT", str(server.getsockname()[1])).encode()
        refused(
            read,
            tmp_path / f"city{suffix}",
            content,
            "cannot be read|are read: convert it|not read: unpack it",
        )
        with pytest.raises(BlockingIOError):
            server.accept()


MASK = MOSAIC.replace("<SRS>", "<Metadata><MDI key='INTERNAL_MASK_FLAGS_1'>2</MDI></Metadata><SRS>")
TMS = f"""<GDAL_WMS><Service name="TMS"><ServerUrl>{URL}</ServerUrl></Service><DataWindow><SizeX>4</SizeX></DataWindow>
</GDAL_WMS>"""


@pytest.mark.parametrize("suffix", [".msk", ".MSK", ".Msk"])
@pytest.mark.parametrize("text", [MASK, TMS, MASK.replace(f"/vsicurl/{URL}", "zero.tif"), None])
def test_a_mask_beside_a_raster_that_may_name_other_files_is_refused_and_nothing_is_asked_or_read(
    tmp_path, suffix, text
):
    path, mask = (
        write_raster(tmp_path / "a.tif", np.ones((2, 2), np.float32)),
        tmp_path / f"a.tif{suffix}",
    )
    write_raster(tmp_path / "zero.tif", np.zeros((2, 2), np.float32))
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        if text is None:
            os.mkfifo(mask)  # from which nothing ever comes
        else:
            mask.write_text(text.replace("PORT", str(server.getsockname()[1])))
        for read in (read_pixels, READERS["extent.tif"]):
            refused(
                read,
                path,
                None,
                rf"a\.tif\{suffix}', the mask of .*a\.tif', is no GeoTIFF .*remove it",
            )
        with pytest.raises(BlockingIOError):
            server.accept()
