"""Texts of CRSs: none opens a file, whatever it is written in, and what lies far from where one is made is refused."""

import json

import pyproj
import pytest

from jaxurban.errors import InputError
from jaxurban.world.grid import WGS84, check_on_earth, known_crs, transformer

DATUM = 'DATUM["x",SPHEROID["Bessel",6377397.155,299.15]%s]'
PROJECTED = (
    'PROJCS["x",GEOGCS["x",%s,PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",9],UNIT["metre",1],'
    'AXIS["Easting",EAST],AXIS["Northing",NORTH]%s]'
)
HEIGHTS = 'VERT_CS["h",VERT_DATUM["h",2005,EXTENSION["PROJ4_GRIDS","%s"]],UNIT["metre",1]]'
SHIFTED = "+proj=utm +zone=32 +ellps=bessel +nadgrids=%s +type=crs"
FAR = (4_467_118.0, 5_331_599.0, 4_467_238.0, 5_331_699.0)  # of Munich in zone 4 of Gauss-Krueger


def extended(extension: str) -> str:
    return PROJECTED % (DATUM % "", f',EXTENSION["PROJ4","{extension}"]')


def with_heights(grid: str) -> str:
    return f'COMPD_CS["x",{PROJECTED % (DATUM % "", "")},{HEIGHTS % grid}]'


def in_digits(text: str) -> str:
    """Return JSON in which letters stand as digits, as any may."""
    return text.replace("nadgrids", "n\\u0061dgrids").replace('"value"', '"v\\u0061lue"')


@pytest.fixture
def file(tmp_path):
    """A definition that PROJ reads where it opens it: then the CRS is a sound one."""
    path = tmp_path / "init"
    path.write_text("<x> +proj=utm +zone=32 +ellps=GRS80 <>\n")
    assert pyproj.CRS(f"+proj=utm +zone=32 +init={path}:x").is_projected
    return path


@pytest.mark.parametrize(
    "form",
    [
        "+init={}:x",
        "init = {}:x",
        "+title=town +init={}:x",
        "+init={}:x + EPSG:5783",
        "+init=epsg:25832 +nadgrids={}",
        SHIFTED % "{}",
        SHIFTED % "@null,{}",
        SHIFTED % '"{}"',
        SHIFTED % "http://127.0.0.1:9/{}",
        "+proj=utm +zone=32 +ellps=bessel +geoidgrids={} +type=crs",
        "+proj=pipeline +step +proj=hgridshift +grids={}",
        "+proj=pipeline +step +proj=axisswap +order=2,1",
        "+proj=deformation +dt=1 +ellps=GRS80 +xy_grids={} +type=crs",
        "+proj=tinshift +file={} +type=crs",
        "+proj=defmodel +model={} +type=crs",
        extended("+init={}:x"),
        extended("+proj=tmerc +ellps=bessel +nadgrids={}"),
        PROJECTED % (DATUM % ',EXTENSION["PROJ4_GRIDS","{}"]', ""),
        PROJECTED % (DATUM % ",EXTENSION[proj4_grids,{}]", ""),
        with_heights("{}"),
        with_heights("g2012a_conus.gtx,{}"),
        PROJECTED.replace("Transverse_Mercator", "PROJ tinshift file={}") % (DATUM % "", ""),
    ],
)
def test_a_text_that_names_a_file_is_refused_before_it_is_opened(file, form):
    with pytest.raises(InputError, match=r"^the CRS .* of 'a' names another file or a server"):
        known_crs(form.replace("{}", str(file)), " of 'a'")


@pytest.mark.parametrize("version", ["WKT2_2019", "JSON"])
def test_a_bound_crs_with_a_file_is_refused_in_any_writing(file, version):
    bound = pyproj.CRS(SHIFTED % file)
    text = in_digits(bound.to_json()) if version == "JSON" else bound.to_wkt(version)
    with pytest.raises(InputError, match="names another file"):
        known_crs(text)


@pytest.mark.parametrize(
    "text",
    [
        "+init=epsg:25832",
        "+init=EPSG:25832 +no_defs",
        "+proj=merc +a=6378137 +b=6378137 +nadgrids=@null +wktext +no_defs",
        SHIFTED % "@null",
        pyproj.CRS("EPSG:3857").to_wkt("WKT1_GDAL"),  # with nadgrids=@null in it
        "+proj=utm +zone=32 +ellps=bessel +towgs84=1,2,3,0,0,0,0 +type=crs",
        with_heights("g2012a_conus.gtx,g2012a_alaska.gtx"),  # as lidar points have it
        pyproj.CRS(with_heights("g2012a_conus.gtx")).to_wkt(),
        "EPSG:25832+5783",
        "ETRS89 / UTM zone 32N",
        "urn:ogc:def:crs:EPSG::25832",
        pyproj.CRS("EPSG:25832").to_json(pretty=True),
    ],
)
@pytest.mark.filterwarnings("ignore:.*is deprecated:FutureWarning")
def test_what_names_no_file_places_as_before(text):
    x, y = 500_000.0, 5_300_000.0
    before = pyproj.Transformer.from_crs(text, WGS84, always_xy=True).transform(x, y)
    assert transformer(text, WGS84).transform(x, y) == before


@pytest.mark.parametrize("text", ["x" * 1_000_000, f'GEOGCS["{"x" * 1_000_000}"]'])
def test_a_text_of_a_million_characters_is_refused(text):
    with pytest.raises(InputError, match="or is longer than 20,000 characters") as caught:
        known_crs(text)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("text", ["", "EPSG:1", "\ud800", '{"a":' * 3000, "DICT:/x,1"])
def test_other_texts_are_no_known_crs(text):
    with pytest.raises(InputError, match=r"^crs '.* is not a known CRS: use a projected one"):
        known_crs(text)


SPHEROID = 'AUTHORITY["EPSG","7022"]]'
ED50 = pyproj.CRS("EPSG:23032").to_wkt("WKT1_GDAL")
SHIFTED_WKT = ED50.replace(SPHEROID, f"{SPHEROID},TOWGS84[-87,-98,-121,0,0,0,0]")
COMPOUND = pyproj.CRS("EPSG:25832+5783")


@pytest.mark.parametrize(
    "text",
    [
        "EPSG:25832",
        "EPSG:25832+5783",
        "EPSG:5555",
        "ETRS89 / UTM zone 32N + DHHN92 height",
        "urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783",
        COMPOUND.to_wkt(),
        COMPOUND.to_wkt("WKT1_GDAL"),
        COMPOUND.to_json(),
        json.dumps(COMPOUND.to_json_dict() | {"name": "town"}),
        pyproj.CRS("EPSG:25832").to_wkt("WKT1_ESRI"),
        SHIFTED_WKT,
    ],
)
def test_the_horizontal_part_says_where_a_crs_is_made_for(text):
    crs = known_crs(text)
    near = pyproj.Transformer.from_crs(WGS84, text, always_xy=True).transform(9.5, 48.0)
    check_on_earth("near", crs, near * 2)
    with pytest.raises(InputError, match="far from the area for which that is made"):
        check_on_earth("far", crs, FAR)
