"""What a file is by its content: read as such, or named with the line that converts it."""

import bz2
import gzip
import io
import json
import os
import re
import shutil
import sqlite3
import tarfile
import tempfile
import zipfile

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.city import OUTLINE_READERS, lonlat_extent, read_buildings
from jaxurban.cities.osm import read_osm
from jaxurban.cities.osm_plain import plain_osm
from jaxurban.cities.outlines import Near
from jaxurban.cities.vector import read_vector
from jaxurban.errors import GuessWarning
from jaxurban.io import sniff as sniffing
from jaxurban.io.issues import ReadIssue
from jaxurban.io.sniff import sniff, unpacked
from jaxurban.world.grid import box_of
from tests.cli_runs import assert_one_sentence, run
from tests.made_files import LAT, LON, SQUARE, UTM, WGS84, node, osm, refused, relation, way

SHIFTED = shapely.affinity.translate(SQUARE, 0.002)
SQUARES = [SQUARE, SHIFTED]
HEIGHTS = ["12", "60"]
FRAME = gpd.GeoDataFrame({"height": [12.0, 60.0]}, geometry=SQUARES, crs=WGS84)
LINES = FRAME.to_json(to_wgs84=True, drop_id=True)
LINES = "\n".join(json.dumps(feature) for feature in json.loads(LINES)["features"]) + "\n"
TABLE = "geometry,height\n" + "".join(
    f'"{shape.wkt}",{height}\n' for shape, height in zip(SQUARES, HEIGHTS, strict=True)
)


def corners(square):
    return list(square.exterior.coords)


def elements(*, first=1, has_nodes=True, has_geometry=False, has_refs=True):
    """Return both squares as the Overpass API's JSON has them; their nodes begin with a number."""
    found = []
    for index, (square, height) in enumerate(zip(SQUARES, HEIGHTS, strict=True)):
        ids = [first + 4 * index + corner for corner in (0, 1, 2, 3, 0)]
        places = [{"lat": lat, "lon": lon} for lon, lat in corners(square)]
        if has_nodes:
            found += [
                {"type": "node", "id": i} | place
                for i, place in list(zip(ids, places, strict=True))[:4]
            ]
        about = {"type": "way", "id": 20 - index, "tags": {"building": "yes", "height": height}}
        if has_refs:
            about["nodes"] = ids
        if has_geometry:
            about["geometry"] = places
        found.append(about)
    return found


def overpass(listed, **more):
    return json.dumps({"version": 0.6, "osm3s": {}, "elements": listed} | more)


def xml_with_geometry(*, has_refs=True):
    """Return both squares as the Overpass API's XML has them with ``out geom``."""
    ways = ""
    for item in elements(has_nodes=False, has_geometry=True):
        ways += f'<way id="{item["id"]}"><bounds minlat="1" minlon="1" maxlat="2" maxlon="2"/>'
        for ref, place in zip(item["nodes"], item["geometry"], strict=True):
            ref_text = f'ref="{ref}" ' if has_refs else ""
            ways += f'<nd {ref_text}lat="{place["lat"]}" lon="{place["lon"]}"/>'
        ways += "".join(f'<tag k="{k}" v="{v}"/>' for k, v in item["tags"].items()) + "</way>"
    return osm(ways)


def edited(quote='"', *, marked=""):
    """Return both squares as JOSM writes them: one with ids below 0, one uploaded."""
    text = ""
    for square, height, sign in zip(SQUARES, HEIGHTS, (-1, 1), strict=True):
        ids = [sign * number for number in (1, 2, 3, 4)]
        text += "".join(node(i, *place) for i, place in zip(ids, corners(square)[:4], strict=True))
        text += way(sign * 10, [*ids, ids[0]], building="yes", height=height)
    return osm(text.replace('<way id="10"', f'<way id="10"{marked}')).replace('"', quote)


def city_of(path):
    return read_buildings(ju.Buildings(path), UTM).buildings


def assert_both_squares(path):
    """Check the two squares against their areas by Shapely, and their heights."""
    buildings = city_of(path)
    expected = FRAME.to_crs(UTM).area.to_numpy()
    order = np.argsort(buildings.height_m)
    np.testing.assert_allclose(shapely.area(buildings.polygons)[order], expected, rtol=1e-3)
    np.testing.assert_allclose(buildings.height_m[order], [12, 60])
    assert lonlat_extent(path) == pytest.approx(tuple(FRAME.total_bounds), abs=1e-6)


OSM_FORMS = {
    "json": overpass(elements()),
    "json of out geom": overpass(elements(has_nodes=False, has_geometry=True)),
    "json of out tags geom": overpass(elements(has_nodes=False, has_geometry=True, has_refs=False)),
    "json with node ids beyond 32 bits": overpass(elements(first=2**33)),
    "xml of out geom": xml_with_geometry(),
    "xml of out tags geom": xml_with_geometry(has_refs=False),
    "an editor's": edited(),
    "an editor's with single quotes": edited("'"),
}


@pytest.mark.slow
@pytest.mark.parametrize("form", OSM_FORMS)
@pytest.mark.parametrize("name", ["city.osm", "city.json", "export"])
def test_every_form_of_openstreetmap_holds_the_same_buildings_under_any_name(tmp_path, form, name):
    (tmp_path / name).write_text(OSM_FORMS[form])
    assert_both_squares(tmp_path / name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["city.geojsonl", "city.ndjson", "city.csv", "city.json"])
def test_geojson_lines_are_read_under_any_name(tmp_path, name):
    (tmp_path / name).write_text(LINES)
    assert sniff(tmp_path / name) == ".geojsonl"
    assert_both_squares(tmp_path / name)


@pytest.mark.parametrize("suffix", [".fgb", ".gpkg", ".geojson"])
@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_vector_files_are_read_packed_or_not(tmp_path, suffix, pack):
    FRAME.to_file(tmp_path / f"plain{suffix}")
    path = tmp_path / f"city{suffix if pack is bytes else '.packed'}"
    path.write_bytes(pack((tmp_path / f"plain{suffix}").read_bytes()))
    before = sorted(tmp_path.iterdir())
    assert sniff(path) == suffix
    assert_both_squares(path)
    assert sorted(tmp_path.iterdir()) == before


def test_a_flatgeobuf_of_many_features_is_read_near_a_region_only(tmp_path):
    squares = [shapely.affinity.translate(SQUARE, 0.01 * i) for i in range(200)]
    gpd.GeoDataFrame(geometry=squares, crs=WGS84).to_file(tmp_path / "a.fgb")
    near = ju.City.from_files(tmp_path / "a.fgb", bounds=(LON, LAT, LON + 0.005, LAT + 0.005))
    assert 1 <= len(near.buildings) < 100


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("open.csv", TABLE.encode()),
        ("open.txt", TABLE.encode()),
        ("open.csv.gz", gzip.compress(TABLE.encode(), mtime=0)),
        (
            "open.csv",
            TABLE.replace("geometry,", "WKT;").replace('",', '";').encode(),
        ),
    ],
)
def test_a_table_with_wkt_is_read_in_degrees_and_says_so(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.warns(GuessWarning, match="cannot say its CRS.*EPSG:4326.*ogr2ogr -s_srs"):
        assert len(read_vector(tmp_path / name).polygons) == 2
    with pytest.warns(GuessWarning):
        buildings = city_of(tmp_path / name)
    assert sorted(buildings.height_m) == [12, 60]


def test_a_table_in_metres_is_asked_for_its_crs(tmp_path):
    text = 'wkt,height\n"POLYGON ((583000 4506000, 583010 4506000, 583010 4506010, 583000 4506000))",3\n'
    refused(
        read_vector, tmp_path / "m.csv", text.encode(), "has coordinates such as.*ogr2ogr -s_srs"
    )


def test_microsofts_lines_in_csv_gz_are_read(tmp_path):
    (tmp_path / "part.csv.gz").write_bytes(gzip.compress(LINES.encode()))
    assert_both_squares(tmp_path / "part.csv.gz")


def test_deleted_objects_of_an_editor_are_left_out(tmp_path):
    for quote in "\"'":
        marked = ' action="delete"'
        (tmp_path / "city.osm").write_text(edited(quote, marked=marked))
        assert city_of(tmp_path / "city.osm").height_m.tolist() == [12]


def test_a_relations_ways_are_taken_from_its_members_and_holes_stay(tmp_path):
    hole = shapely.affinity.scale(SQUARE, 0.5, 0.5)
    members = [
        {
            "type": "way",
            "ref": number,
            "role": role,
            "geometry": [{"lat": lat, "lon": lon} for lon, lat in corners(square)],
        }
        for number, role, square in ((1, "outer", SQUARE), (2, "inner", hole))
    ]
    tags = {"type": "multipolygon", "building": "yes"}
    listed = [{"type": "relation", "id": 5, "members": members, "tags": tags}]
    (tmp_path / "a.json").write_text(overpass(listed))
    (polygon,) = read_osm(tmp_path / "a.json").polygons
    assert polygon.area == pytest.approx(0.75 * SQUARE.area, rel=1e-3)
    xml = "".join(
        f'<member type="way" ref="{member["ref"]}" role="{member["role"]}">'
        + "".join(f'<nd lat="{at["lat"]}" lon="{at["lon"]}"/>' for at in member["geometry"])
        + "</member>"
        for member in members
    )
    text = osm(relation(5, [], building="yes").replace("<tag", f"{xml}<tag", 1))
    (tmp_path / "a.osm").write_text(text)
    assert read_osm(tmp_path / "a.osm").polygons[0].equals(polygon)


def test_a_way_that_comes_again_without_its_tags_keeps_them(tmp_path):
    # "out body; >; out skel;" of the Overpass API: ways of relations come twice, the second time after them.
    whole = elements()
    again = [{k: v for k, v in item.items() if k != "tags"} for item in whole if "tags" in item]
    member = {"type": "way", "ref": 20, "role": "outer"}
    site = {"type": "relation", "id": 9, "members": [member], "tags": {"type": "site"}}
    (tmp_path / "a.json").write_text(overpass([*whole, site, *again]))
    assert_both_squares(tmp_path / "a.json")


def test_ways_after_relations_are_put_in_order(tmp_path):
    nodes = [node(i + 1, *place) for i, place in enumerate(corners(SQUARE)[:4])]
    parts = [*nodes, way(7, [1, 2]), relation(3, [(7, "")], type="site")]
    (tmp_path / "a.osm").write_text(osm(*parts, way(5, [1, 2, 3, 4, 1], building="yes")))
    assert len(read_osm(tmp_path / "a.osm").polygons) == 1


def test_places_that_a_bounded_out_geom_leaves_out_are_missing_nodes(tmp_path):
    listed = elements(has_nodes=False, has_geometry=True)
    listed[0]["geometry"][1] = None
    (tmp_path / "a.json").write_text(overpass(listed))
    issues = read_osm(tmp_path / "a.json").issues
    assert issues[ReadIssue.WAYS_WITH_MISSING_NODES] == 1


CUT_SHORT = "runtime error: Query timed out"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", overpass(elements(), remark=f'{CUT_SHORT} in "query" at line 1.')),
        ("a.osm", osm(node(1, 0, 0)).replace("</osm>", f"<remark> {CUT_SHORT} </remark></osm>")),
    ],
)
def test_what_a_server_cut_short_is_refused(name, text, tmp_path, capsys):
    (tmp_path / name).write_text(text)
    code, _, err = run(capsys, "info", tmp_path / name)
    assert code == 2
    assert_one_sentence(err, name, CUT_SHORT, "ask for a smaller region, or later")


def test_the_box_of_an_edited_file_is_kept(tmp_path):
    box = (LON - 0.01, LAT - 0.01, LON + 0.01, LAT + 0.01)
    text = edited().replace("<node", f"{osm(boxes=[box]).split(chr(10))[2]}<node", 1)
    (tmp_path / "a.osm").write_text(text)
    assert read_osm(tmp_path / "a.osm").boxes == (pytest.approx(box),)


def test_plain_files_are_passed_through(tmp_path):
    for name, text in (
        ("a.osm", osm(node(1, 0, 0))),
        ("b.osm", osm(node(2, 0, 0), boxes=[(0, 0, 1, 1)])),
    ):
        (tmp_path / name).write_text(text)
        with plain_osm(tmp_path / name, "") as plain:
            assert plain == tmp_path / name
        with unpacked(tmp_path / name) as plain:
            assert plain == tmp_path / name


WAYS_ALONE = osm(way(1, [1, 2, 3, 1], building="yes"))


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.osm", WAYS_ALONE, r"not one node.*`\(\._;>;\); out;`"),
        ("a.json", overpass(elements(has_nodes=False)), r"not one node.*`\(\._;>;\); out;`"),
        ("a.json", overpass([{"type": "way"}]), "it is damaged or cut short"),
        ("a.json", overpass(elements())[:-40], "it is damaged or cut short"),
        ("a.osm", edited()[:-40], "it is damaged or cut short"),
        ("a.osm", osm(way(2, [1]), node(1, 0, 0), way(1, [1]), way(2, [1])), "osmium sort"),
    ],
)
def test_openstreetmap_that_is_not_whole_is_refused_with_the_remedy(tmp_path, name, text, sentence):
    refused(read_osm, tmp_path / name, text.encode(), sentence)


def archive(path):
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a", "b")


def tape(path, mode="w"):
    with tarfile.open(path, mode) as file:
        file.addfile(tarfile.TarInfo("a"), io.BytesIO())


def plain_sqlite(path):
    pd.DataFrame({"height": [1]}).to_sql("town", sqlite3.connect(path))


def with_table(path, statement):
    """Write both squares, in a database whose layer is a table or a view of a statement in place of theirs."""
    FRAME.to_file(path, driver="SQLite", layer="town")
    kind = "view" if "VIEW" in statement else "table"
    with sqlite3.connect(path) as base:
        base.execute("PRAGMA writable_schema = 1")
        base.execute(
            "INSERT INTO sqlite_master VALUES (?, 'other', 'other', 0, ?)", (kind, statement)
        )
        base.execute("UPDATE geometry_columns SET f_table_name = 'other'")
    base.close()


def table_of(module, options=""):
    def write(path):
        FRAME.to_file(path.with_name("elsewhere.geojson"))
        other = path.with_name("elsewhere.geojson")
        with_table(path, f"CREATE VIRTUAL TABLE other USING {module}('{other}'{options})")

    return write


def endless(path):
    rows = "SELECT 1 UNION ALL SELECT i + 1 FROM r"
    with_table(path, f"CREATE VIEW other AS WITH RECURSIVE r(i) AS ({rows}) SELECT i FROM r")


def bad_lzma(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("a.geojson", LINES)
    data = bytearray(path.read_bytes())
    data[60:90] = bytes(30)
    path.write_bytes(data)


def not_utf8(path):
    FRAME.to_file(path)
    crs = path.with_suffix(".prj")
    crs.write_bytes(crs.read_bytes().replace(b"WGS_1984", b"\xc9\x9f\xff", 1))


def bare_parquet(path, frame=FRAME, **columns):
    table = pd.DataFrame({"id": range(len(frame)), "geometry": frame.geometry.to_wkb()})
    table.assign(height=frame["height"], **columns).to_parquet(path)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.json", b'{"type":"CityJSON","version":"1.1"}', "as a city model .*damaged"),
        ("a.jsonl", b'{"CityObjects": {}, "type": "CityJSONFeature"}', "begin with that line"),
        (
            "a.gml",
            b'<?xml version="1.0"?><!-- of <osm --><core:CityModel xmlns:core="x">',
            "cannot be read as a city model",
        ),
        ("a.laz", b"LASF" + bytes(100), "as lidar points .*damaged or cut short"),
        ("a.zip", archive, "holds no object of CityGML or CityJSON and no outlines"),
        ("a.7z", b"7z\xbc\xaf\x27\x1c", "an archive: .*`7z x "),
        ("a.tar", tape, "an archive: .*`tar -xf "),
        ("a.tgz", lambda path: tape(path, "w:gz"), "an archive: .*`tar -xf "),
        ("a.sqlite", plain_sqlite, "holds no geometry"),
        ("a.geojson", b"<!DOCTYPE html><html>", "a web page"),
        (
            "a.parquet",
            lambda path: pd.DataFrame({"wkb": [b"no"]}).to_parquet(path),
            "damaged or cut short",
        ),
        ("a.parquet", lambda path: pd.DataFrame({"a": [1]}).to_parquet(path), "holds no geometry"),
        (
            "a.csv",
            b"x,y\n1,2\n",
            "a table without shapes, as it has no column wkt or geometry.*ogr2ogr",
        ),
        ("a.xyz", b"1 2 3", r"no content that is known: .*\.fgb.*\.tif.*\.gz"),
        ("a.geojson", b'{"type": "FeatureCollection", "features": [{', "damaged or cut short"),
        ("a.osm.gz", gzip.compress(edited().encode(), mtime=0)[:-30], "damaged or cut short"),
        ("a.osm.bz2", bz2.compress(edited().encode())[:-30], "damaged or cut short"),
        ("a.gz", b"\x1f\x8b" + bytes(20), "damaged or cut short"),
        ("a.zip", bad_lzma, "as an archive"),
        ("a.shp", not_utf8, "damaged or cut short"),
        ("a.sqlite", table_of("VirtualOGR"), "damaged or cut short"),
        ("a.sqlite", table_of("VirtualGeoJSON", ", 4326"), "damaged or cut short"),
        ("a.sqlite", endless, "a view that may never end"),
    ],
)
def test_what_is_not_read_is_named_by_info_with_what_helps(
    tmp_path, capsys, name, content, sentence
):
    refused(city_of, tmp_path / name, content, sentence)
    code, out, err = run(capsys, "info", tmp_path / name)
    assert (code, out) == (2, "")
    assert re.search(sentence, err)


def test_parquet_of_wkb_is_read_in_degrees_and_says_so(tmp_path):
    bare_parquet(tmp_path / "duckdb.parquet", bbox=[{"xmin": LON}] * 2)
    with pytest.warns(GuessWarning, match="cannot say its CRS.*EPSG:4326"):
        assert_both_squares(tmp_path / "duckdb.parquet")


def test_bytes_in_place_of_heights_of_parquet_are_heights_that_nobody_can_read(tmp_path):
    bare_parquet(tmp_path / "a.parquet", FRAME.assign(height=[b"\x9a12", b"60"]))
    with pytest.warns(GuessWarning):
        read = read_buildings(ju.Buildings(tmp_path / "a.parquet"), UTM)
    assert read.read_issues[ReadIssue.HEIGHTS_UNUSABLE] == 2


@pytest.mark.parametrize("name", ["a.sqlite", "b.gdb", "c.gdb.zip"])
def test_databases_are_read_whole_and_near_a_region_only(tmp_path, name):
    squares = [shapely.affinity.translate(SQUARE, 0.01 * i) for i in range(200)]
    many = gpd.GeoDataFrame({"height": [5.0] * 200}, geometry=squares, crs=WGS84)
    for frame, folder in ((FRAME, tmp_path / "few"), (many, tmp_path / "many")):
        folder.mkdir()
        plain = folder / name.removesuffix(".zip")
        driver = "SQLite" if name.endswith("sqlite") else "OpenFileGDB"
        frame.to_file(plain, driver=driver)
        if name.endswith(".zip"):
            shutil.make_archive(folder / plain.name, "zip", folder, plain.name)
    assert_both_squares(tmp_path / "few" / name)
    near = Near(box_of((LON, LAT, LON + 0.005, LAT + 0.005), UTM), UTM)
    assert 1 <= len(read_vector(tmp_path / "many" / name, near).polygons) < 100


def test_overtures_buildings_and_parts_are_read_from_one_folder(tmp_path):
    half = shapely.box(LON, LAT, LON + 0.0005, LAT + 0.001)
    other = shapely.box(LON + 0.0005, LAT, LON + 0.001, LAT + 0.001)
    parts = gpd.GeoDataFrame({"height": [20.0, 8.0]}, geometry=[half, other], crs=WGS84)
    (tmp_path / "overture").mkdir()
    bare_parquet(tmp_path / "overture" / "building.parquet", has_parts=[True, False])
    columns = {"building_id": ["b0", "b0"], "min_height": [4.0, None], "min_floor": [1, None]}
    bare_parquet(tmp_path / "overture" / "building_part.parquet", parts, **columns)
    with pytest.warns(GuessWarning):
        buildings = city_of(tmp_path / "overture")
    assert sorted(buildings.height_m) == [8, 20, 60]  # the first gave way to its parts
    assert sorted(buildings.min_height_m) == [0, 0, 4]


def test_google_and_microsoft_are_read_as_they_publish(tmp_path):
    rows = "".join(f'{LAT},{LON},90.5,0.8,"{shape.wkt}",87G8P2X2+2X\n' for shape in SQUARES)
    text = f"latitude,longitude,area_in_meters,confidence,geometry,full_plus_code\n{rows}"
    (tmp_path / "89c_buildings.csv.gz").write_bytes(gzip.compress(text.encode()))
    lines = LINES.replace('"height": 12.0', '"height": -1.0, "confidence": 0.9')
    (tmp_path / "part-00001.c000.csv.gz").write_bytes(gzip.compress(lines.encode()))
    with pytest.warns(GuessWarning):
        google = city_of(tmp_path / "89c_buildings.csv.gz")
    microsoft = city_of(tmp_path / "part-00001.c000.csv.gz")
    assert google.height_m.tolist() == [18.9, 18.9]
    assert sorted(microsoft.height_m) == [18.9, 60]
    for buildings in (google, microsoft):
        areas = shapely.area(buildings.polygons)
        np.testing.assert_allclose(areas, FRAME.to_crs(UTM).area, rtol=1e-3)


def test_a_name_with_blanks_is_quoted_in_the_line_that_helps(tmp_path):
    said = refused(city_of, tmp_path / "two words.7z", b"7z\xbc\xaf\x27\x1c", "7z x")
    assert f"`7z x '{tmp_path / 'two words.7z'}'`" in said


def test_a_bomb_is_refused_before_it_fills_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(sniffing, "MOST_UNPACKED", 2**20)
    bomb = gzip.compress(WAYS_ALONE.encode() + bytes(20_000_000))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "held"))
    (tmp_path / "held").mkdir()
    refused(read_osm, tmp_path / "a.osm.gz", bomb, "unpacks to more than")
    assert not os.listdir(tmp_path / "held")


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_what_unpacks_to_more_than_a_hundred_times_its_size_is_refused(tmp_path, monkeypatch, pack):
    monkeypatch.setattr(sniffing, "ALWAYS_UNPACKED", 2**16)
    for name, start in {"a.geojson": LINES, "a.csv": TABLE, "a.osm": WAYS_ALONE}.items():
        packed = pack(start.encode() + b" " * 2**20)
        refused(
            city_of,
            tmp_path / f"{name}.gz",
            packed,
            "unpacks to more than 100 times its size or 20 GiB",
        )


def test_an_archive_of_empty_files_is_refused_before_they_are_made(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for number in range(3000):
            archive.writestr(f"{number}.txt", "")
    refused(city_of, tmp_path / "a.zip", None, "unpacks to more than 100 times its size")


def test_only_what_runs_unpacked_long_ago_is_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folders = [tmp_path / f"jaxurban-unpacked-{name}" for name in ("old", "new")]
    mine = tmp_path / "jaxurban-maps"
    for folder in (*folders, mine):
        folder.mkdir()
        (folder / "a.osm").write_text("")
    for folder in (folders[0], mine):
        os.utime(folder, (0, 0))
    (tmp_path / "a.geojson.gz").write_bytes(gzip.compress(LINES.encode()))
    read_vector(tmp_path / "a.geojson.gz")
    assert sorted(os.listdir(tmp_path)) == ["a.geojson.gz", mine.name, folders[1].name]


def test_a_packed_file_that_names_a_server_is_not_opened(tmp_path):
    link = '"crs": {"type": "link", "properties": {"href": "http://127.0.0.1:9/x"}}'
    for text in (LINES.replace('"type"', f'{link}, "type"', 1), f'{{"a": 1, {link}}}'):
        packed = gzip.compress(text.encode())
        refused(read_vector, tmp_path / "a.geojson.gz", packed, "refers to other files or servers")


def test_a_link_is_found_across_the_blocks_in_which_a_file_is_read(tmp_path):
    start = '{"type": "FeatureCollection", "features": [], "crs": {"type"'
    for gap in (2**20 - len(start), 2**20 - len(start) - 3, 2**20):
        text = f'{start}{" " * gap}:"\\u006cink"}}}}'
        refused(read_vector, tmp_path / "a.geojson", text.encode(), "refers to other files")


def test_a_further_reader_needs_no_bounds_and_takes_columns(tmp_path, monkeypatch):
    file = tmp_path / "town.tsv"
    file.write_text("no format that is known")
    FRAME.to_file(tmp_path / "town.gpkg")

    def read(path, near, settings):
        return read_vector(tmp_path / "town.gpkg", near, settings)

    monkeypatch.setitem(OUTLINE_READERS, ".tsv", read)
    assert lonlat_extent(file) == pytest.approx(tuple(FRAME.total_bounds), abs=1e-6)
    columns = ju.Buildings(file, height_column="height", unit="m")
    assert len(ju.City.from_files(columns).buildings) == len(FRAME)


def test_a_long_line_of_hashes_is_looked_at_in_a_moment(tmp_path):
    (tmp_path / "notes.csv").write_text("# " * 1000 + "none")
    assert sniff(tmp_path / "notes.csv") == ""
    (tmp_path / "noted.waypoints").write_text("# by hand\n# twice\nQGC WPL 110\n")
    assert sniff(tmp_path / "noted.waypoints") == ".waypoints"
