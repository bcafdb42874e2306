"""From a region to files and a scenario that runs: real formats, made here, from a server in this process."""

import io
import json
import re
import tempfile
import tomllib
import zipfile
from datetime import UTC, date, datetime, timedelta

import geopandas as gpd
import numpy as np
import osmium
import pytest
import shapely
from sgp4.exporter import export_tle

from jaxurban.errors import InputError
from jaxurban.io import fetch as fetching
from jaxurban.io.download import Cache
from jaxurban.io.fetch_plan import FetchJob, plan_fetch
from jaxurban.io.read.census import read_blocks
from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.orbits import _timescale, nominal_satellites
from jaxurban.io.read.osm import cut_buildings
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.population import Population
from jaxurban.settings import Buildings
from tests.cli_runs import assert_one_sentence, run
from tests.misbehaving_server import send, serve

BOUNDS = (-74.010, 40.710, -74.008, 40.7115)
REGION = ",".join(map(str, BOUNDS))
COUNTY = "36061"
TODAY = date(2026, 11, 20)
HOUSES = ((-74.0095, 40.7103, 40), (-74.0088, 40.7110, 25))  # south-west corner, height
SIDE_DEG = 0.0002
UNREADABLE = (ValueError, LookupError, RuntimeError, zipfile.BadZipFile)


def osm_xml():
    """Two buildings in the order in which the Overpass API writes: ways, then their nodes."""
    ways, nodes = [], []
    for number, (lon, lat, height_m) in enumerate(HOUSES, start=1):
        corners = [(lon, lat), (lon + SIDE_DEG, lat), (lon + SIDE_DEG, lat + SIDE_DEG), (lon, lat + SIDE_DEG)]
        ids = [10 * number + i for i in range(4)]
        nodes += [f'<node id="{i}" lat="{y}" lon="{x}"/>' for i, (x, y) in zip(ids, corners, strict=True)]
        refs = "".join(f'<nd ref="{i}"/>' for i in (*ids, ids[0]))
        ways.append(f'<way id="{number}">{refs}<tag k="building" v="yes"/><tag k="height" v="{height_m}"/></way>')
    parts = ('<?xml version="1.0" encoding="UTF-8"?>\n<osm version="0.6">', *ways, *nodes, "</osm>\n")
    return "\n".join(parts).encode()


def pbf(tmp_path, xml=None):
    """The same as a PBF file, nodes first."""
    (tmp_path / "in.osm").write_bytes(xml or osm_xml())
    path = tmp_path / "extract.osm.pbf"
    path.unlink(missing_ok=True)
    with osmium.SimpleWriter(str(path)) as writer:
        for kind in (osmium.osm.NODE, osmium.osm.WAY):
            for item in osmium.FileProcessor(str(tmp_path / "in.osm"), kind):
                writer.add(item)
    return path.read_bytes()


def block_ids(count, county=COUNTY):
    return [f"{county}000100{1000 + i}" for i in range(count)]


def block_zip(folder, ids, x=-74.011, width=0.001, field="GEOID20"):
    """A zipped Shapefile of blocks in a row from west to east, in NAD83 as the Census has it."""
    west = x + width * np.arange(len(ids))
    frame = gpd.GeoDataFrame({field: ids}, geometry=shapely.box(west, 40.709, west + width, 40.712), crs="EPSG:4269")
    folder.mkdir(parents=True, exist_ok=True)
    frame.to_file(folder / "tl.shp")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.glob("tl.*")):
            archive.write(path, path.name)
    return packed.getvalue()


def counts_json(ids, has_more=False):
    rows = [{"attributes": {"GEOID": block, "POP100": 100 + i}} for i, block in enumerate(ids)]
    return json.dumps({"features": rows} | ({"exceededTransferLimit": True} if has_more else {})).encode()


def districts_geojson():
    box = shapely.box(-74.02, 40.70, -74.0, 40.72)
    return gpd.GeoDataFrame({"BoroCD": [101]}, geometry=[box], crs="EPSG:4326").to_json().encode()


def tle(day):
    """The nominal satellites as two-line elements of a day."""
    satellites = nominal_satellites(day, _timescale())
    return "".join(f"{s.name}\n" + "\n".join(export_tle(s.model)) + "\n" for s in satellites).encode()


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A server with every file of the region; the sources are pointed at it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serve() as running:
        today = datetime.now(UTC).date()
        places = {
            "osm": ("/overpass?data={query}", osm_xml()),
            "population": ("/counts?box={west},{south},{east},{north}&from={offset}", counts_json(block_ids(4))),
            "blocks": ("/blocks_{county}.zip", block_zip(tmp_path / "blocks", block_ids(4))),
            "districts": ("/districts", districts_geojson()),
            "orbits": ("/gp", tle(today)),
        }
        for name, (template, body) in places.items():
            running.put(template.partition("?")[0].replace("{county}", COUNTY), send(body))
            monkeypatch.setenv(f"JAXURBAN_SOURCE_{name.upper()}", running.url + template)
        yield running


def fetch(capsys, folder, *options):
    return run(capsys, "fetch", f"--bounds={REGION}", "-o", folder, *options)


def cached(tmp_path):
    return [path for path in (tmp_path / "cache").rglob("*") if path.is_file() and "fetch" in path.parts]


def test_what_is_fetched_makes_maps(server, tmp_path, capsys):
    folder = tmp_path / "town"
    code, out, err = fetch(capsys, folder, "--json")
    assert (code, "error" in err) == (0, False)
    record = json.loads(out)
    assert {file["source"]: file["file"] for file in record["files"]} == {
        "osm": "buildings.osm",
        "orbits": "gps-ops.txt",
        "population": "population.csv",
        "blocks": "blocks.parquet",
        "districts": "districts.geojson",
    }
    assert record["num_requests"] == len(server.asked) == 5
    assert "OpenStreetMap contributors" in (folder / "scenario.toml").read_text(encoding="utf-8")
    moved = folder.rename(tmp_path / "moved")  # paths are relative
    made = run_scenario(Scenario.from_toml(moved / "scenario.toml"), tmp_path / "out")
    ds = next(iter(made.maps.values())).ds
    assert float(ds["obstacle"].sel(altitude=20).sum()) > float(ds["obstacle"].sel(altitude=60).sum()) == 0
    assert made.record["population"]["night"]["commercial"] == 100 + 101 + 102 + 103
    assert len(made.record["satellites"]) > 0
    assert float(ds["gps"].max()) > 0


def test_a_second_run_asks_nothing_while_the_copies_are_fresh(server, tmp_path, capsys):
    fetch(capsys, tmp_path / "a")
    num_asked = len(server.asked)
    code, out, _ = fetch(capsys, tmp_path / "b", "--json")
    assert (code, len(server.asked), json.loads(out)["num_requests"]) == (0, num_asked, 0)
    for name in ("scenario.toml", "buildings.osm", "population.csv", "blocks.parquet", "districts.geojson"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_dry_run_lists_the_requests_and_makes_none(server, tmp_path, capsys):
    code, out, _ = fetch(capsys, tmp_path / "a", "--dry-run")
    assert (code, server.asked, (tmp_path / "a").exists()) == (0, [], False)
    assert [line.partition(":")[0] for line in out.splitlines()] == [
        "osm",
        "population",
        "blocks",
        "districts",
        "orbits",
    ]
    assert "blocks_{county}.zip" in out
    _, out, _ = fetch(capsys, tmp_path / "a", "--dry-run", "--json", "--county", COUNTY)
    assert [row["url"] for row in json.loads(out)["requests"]][2] == f"{server.url}/blocks_{COUNTY}.zip"


def test_only_what_is_asked_for_is_fetched(server, tmp_path, capsys):
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "orbits")
    assert (code, server.paths()) == (0, ["/gp"])
    assert "no scenario is written without osm" in err
    assert not (tmp_path / "a" / "scenario.toml").exists()
    assert fetch(capsys, tmp_path / "b", "--what", "osm")[0] == 0
    settings = tomllib.loads((tmp_path / "b" / "scenario.toml").read_text(encoding="utf-8"))
    assert (set(settings), settings["gps"]["orbits"]) == ({"region", "buildings", "gps"}, "nominal")


def test_a_failure_keeps_what_has_arrived_and_the_same_command_goes_on(server, tmp_path, capsys):
    server.put(f"/blocks_{COUNTY}.zip", send(b"<html>Log in</html>"), send(block_zip(tmp_path / "z", block_ids(4))))
    code, _, err = fetch(capsys, tmp_path / "a")
    assert code == 2
    assert "not a zip file" in err.splitlines()[-1]
    assert not (tmp_path / "a" / "scenario.toml").exists()
    assert len(cached(tmp_path)) == 2 * 3  # osm, orbits and the counts, each with what is known of it
    assert fetch(capsys, tmp_path / "a")[0] == 0
    assert server.paths().count("/overpass") == 1


def test_a_scenario_is_not_replaced_unless_asked(server, tmp_path, capsys):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "scenario.toml").write_text("mine")
    code, out, err = fetch(capsys, tmp_path / "a")
    assert (code, out, server.asked) == (2, "", [])
    assert_one_sentence(err, "--overwrite")
    assert fetch(capsys, tmp_path / "a", "--overwrite")[0] == 0


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_files_of_ones_own_are_not_replaced_unless_asked(server, tmp_path, capsys):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "population.csv").write_text("mine")
    code, out, err = fetch(capsys, tmp_path / "a")
    assert (code, out, server.asked) == (2, "", [])
    assert_one_sentence(err, "population.csv", "--overwrite", "-o")
    assert files(tmp_path / "a") == {"population.csv": b"mine"}
    assert fetch(capsys, tmp_path / "a", "--what", "osm")[0] == 0  # its own names are free
    (tmp_path / "a" / "scenario.toml").unlink()
    assert fetch(capsys, tmp_path / "a", "--what", "osm")[0] == 0  # what an earlier fetch wrote is not one's own
    (tmp_path / "a" / "scenario.toml").unlink()
    (tmp_path / "a" / "buildings.osm").write_text("mine, too")
    assert fetch(capsys, tmp_path / "a", "--what", "osm")[0] == 2
    assert fetch(capsys, tmp_path / "a", "--overwrite")[0] == 0
    (tmp_path / "a" / "fetch.json").unlink()
    (tmp_path / "a" / "fetch.json").mkdir()
    assert fetch(capsys, tmp_path / "a")[0] == 2
    assert fetch(capsys, tmp_path / "a", "--overwrite")[0] == 0
    assert (tmp_path / "a" / "kept" / "fetch.json").is_dir()


def test_a_run_that_fails_leaves_the_folder_as_it_was(server, tmp_path, capsys):
    fetch(capsys, tmp_path / "a")
    before = files(tmp_path / "a")
    server.put("/gp", send(tle(datetime.now(UTC).date() - timedelta(days=1))))
    server.put("/districts", send(b"<html>Log in</html>"))
    places = ("--source", f"orbits={server.url}/gp?new", "--source", f"districts={server.url}/districts?new")
    assert fetch(capsys, tmp_path / "a", "--overwrite", *places)[0] == 2
    assert "/gp?new" in [path for path, _ in server.asked]
    assert files(tmp_path / "a") == before


def test_old_element_sets_serve_their_own_date_only(server, tmp_path, capsys):
    server.put("/gp", send(tle(date(2020, 4, 27))))
    today = datetime.now(UTC).date()
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm,orbits", "--date", today)
    assert code == 2
    assert "days away from" in err.splitlines()[-1]
    code, _, err = fetch(capsys, tmp_path / "own", "--what", "osm,orbits")
    assert (code, "the GPS maps are of 2020-04-27T12:00:00Z" in err) == (0, True)
    assert Scenario.from_toml(tmp_path / "own/scenario.toml").gps.utc_times == ("2020-04-27T12:00:00Z",)
    assert fetch(capsys, tmp_path / "a", "--what", "osm,orbits", "--date", "2020-04-28")[0] == 0
    assert Scenario.from_toml(tmp_path / "a/scenario.toml").gps.utc_times == ("2020-04-28T12:00:00Z",)


def test_without_a_network_it_is_one_sentence_and_exit_two(server, tmp_path, capsys):
    code, _, err = fetch(capsys, tmp_path / "a", "--source", "osm=http://127.0.0.1:9/x?data={query}")
    assert code == 2
    assert "cannot be reached" in err.splitlines()[-1]
    code, _, err = fetch(capsys, tmp_path / "a", "--offline")
    assert code == 2
    assert_one_sentence(err, "is not in the cache", "without --offline")
    assert cached(tmp_path) == []


def test_an_extract_is_checked_and_cut_to_the_region(server, tmp_path, capsys):
    far = osm_xml().replace(b"</osm>", b"").decode()
    for number in (1, 2):  # the same houses again, 5 km to the north
        far += (
            f'<way id="{number + 5}">'
            + "".join(f'<nd ref="{10 * number + i + 50}"/>' for i in (0, 1, 2, 3, 0))
            + '<tag k="building" v="yes"/></way>'
        )
        lon, lat, _ = HOUSES[number - 1]
        for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]):
            place = f'lat="{lat + 0.05 + y * SIDE_DEG}" lon="{lon + x * SIDE_DEG}"'
            far += f'<node id="{10 * number + i + 50}" {place}/>'
    body = pbf(tmp_path, (far + "</osm>").encode())
    url = server.put("/state.osm.pbf", send(body))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm", "--extract", url)
    assert (code, server.paths()) == (0, ["/state.osm.pbf"]), err
    found = read_buildings(Buildings(tmp_path / "a" / "buildings.osm.pbf"), "EPSG:32618").buildings
    assert sorted(found.height_m.tolist()) == [25, 40]


@pytest.mark.data
def test_a_cut_extract_holds_the_same_buildings(data_dir, tmp_path):
    source, cut = data_dir / "osm/lower-manhattan.osm.pbf", tmp_path / "cut.osm.pbf"
    cut_buildings(source, cut, (-74.0150, 40.7020, -74.0080, 40.7080))
    inside_m = (583_400.0, 4_506_200.0, 583_700.0, 4_506_600.0)
    whole, part = (read_buildings(Buildings(path), "EPSG:32618", bounds_m=inside_m).buildings for path in (source, cut))
    assert len(part.polygons) == len(whole.polygons) > 50
    np.testing.assert_array_equal(np.sort(part.height_m), np.sort(whole.height_m))
    assert shapely.area(part.polygons).sum() == pytest.approx(shapely.area(whole.polygons).sum(), rel=1e-9)


def test_an_extract_of_another_place_is_refused(server, tmp_path, capsys):
    xml = osm_xml().replace(b'version="0.6">', b'version="0.6"><bounds minlon="1" minlat="1" maxlon="2" maxlat="2"/>')
    url = server.put("/elsewhere.osm", send(xml))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm", "--extract", url)
    assert code == 2
    assert "not all of the region" in err.splitlines()[-1]


def test_an_answer_without_buildings_is_told(server, tmp_path, capsys):
    server.put("/overpass", send(b'<?xml version="1.0"?><osm version="0.6"></osm>'))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm")
    assert code == 2
    assert "has no building in" in err.splitlines()[-1]
    assert cached(tmp_path) == []


def test_an_extract_without_buildings_there_is_told(server, tmp_path, capsys):
    url = server.put("/a.osm.pbf", send(pbf(tmp_path, osm_xml().replace(b'k="building"', b'k="highway"'))))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm", "--extract", url)
    assert code == 2
    assert "has no building in" in err.splitlines()[-1]
    assert not (tmp_path / "a").exists()


def without(pattern, text):
    return re.sub(pattern, b"", text)


@pytest.mark.parametrize(
    ("damaged", "words"),
    [
        (osm_xml().replace(b'<way id="2">', b'<way id="2" & <<'), "not well-formed"),
        (osm_xml().replace(b'lat="40.7103"', b'lat="abc"'), "'abc'"),
        (osm_xml().replace(b'lat="40.7103"', b'lat="NaN"'), "'NaN'"),
        (osm_xml().replace(b'k="building"', b'k="highway"'), "has no building"),
        (without(rb"<node [^>]*/>\n?", osm_xml()), "has 2 buildings but not their nodes"),
    ],
    ids=["syntax", "word", "nan", "highways", "bare"],
)
def test_osm_xml_is_read_to_its_end(tmp_path, damaged, words):
    (tmp_path / "a").write_bytes(damaged)
    with pytest.raises(UNREADABLE, match=words):
        parts(tmp_path).read_osm(tmp_path / "a")


def test_every_block_of_a_pbf_is_unpacked(tmp_path):
    body = pbf(tmp_path)
    for place in range(len(body) // 2, len(body), 9):
        damaged = bytearray(body)
        damaged[place] ^= 1
        (tmp_path / "a").write_bytes(damaged)
        with pytest.raises(UNREADABLE):
            parts(tmp_path).read_osm(tmp_path / "a")


def test_damaged_content_is_told_without_the_paths_of_scratch_files(server, tmp_path, capsys):
    body = bytearray(block_zip(tmp_path / "b", block_ids(4)))
    broken = {
        "osm": osm_xml().replace(b'lat="40.7103"', b'lat="abc"'),
        "orbits": b"\xff\xfe" * 99,
        "blocks": without(b"PK\x05\x06.*", bytes(body)),
        "districts": districts_geojson().replace(b"101", b'"one"'),
    }
    for name, content in broken.items():
        url = server.put(f"/bad/{name}", send(content))
        source = ("--source", f"{name}={url}")
        what = "census" if name == "blocks" else name
        code, _, err = fetch(capsys, tmp_path / "a", "--what", what, *source)
        assert code == 2
        last = err.splitlines()[-1]
        assert url in last
        assert "jaxurban-part" not in last
        assert "what arrived" not in last
        assert str(tmp_path) not in last
        assert tempfile.gettempdir() not in last
    assert len(cached(tmp_path)) == 2  # the counts, which were whole


def test_blocks_of_several_counties_and_pages_come_together(server, tmp_path, capsys):
    east = block_ids(3, "36047")
    server.put(
        "/counts", send(counts_json(block_ids(4), has_more=True)), send(counts_json(east)), send(counts_json([]))
    )
    server.put("/blocks_36047.zip", send(block_zip(tmp_path / "east", east, x=-74.0085)))
    assert fetch(capsys, tmp_path / "a", "--what", "osm,census")[0] == 0
    assert [path.partition("from=")[2] for path, _ in server.asked if path.startswith("/counts")] == ["0", "4"]
    blocks, issues = read_blocks(
        Population(blocks=tmp_path / "a/blocks.parquet", table=tmp_path / "a/population.csv", block_field="GEOID"),
        "EPSG:32618",
    )
    # The third block from the east begins 120 m beyond the region: it is left out.
    assert blocks.block_id.tolist() == east[:2] + block_ids(4)
    assert issues["blocks_without_count"] == 0


def test_pages_without_end_are_told(server, tmp_path, capsys):
    server.put("/counts", send(counts_json(block_ids(4), has_more=True)))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "census")
    assert code == 2
    assert "sends nothing new" in err.splitlines()[-1]
    assert server.paths() == ["/counts"] * 2


def test_districts_where_none_are_known_are_told(server, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("JAXURBAN_SOURCE_DISTRICTS")
    code, _, err = run(capsys, "fetch", "--bounds=-100.01,40.0,-100.0,40.01", "-o", tmp_path / "a", "--what=districts")
    assert (code, server.asked) == (2, [])
    assert "only New York City's" in err.splitlines()[-1]
    url = f"{server.url}/districts"
    assert fetch(capsys, tmp_path / "b", "--what", "districts", "--districts", url)[0] == 0
    assert (tmp_path / "b" / "districts.geojson").read_bytes() == districts_geojson()


def test_where_the_census_counts_nobody_the_layer_is_left_out(server, tmp_path, capsys):
    server.put("/counts", send(counts_json([])))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm,census")
    assert code == 0
    assert "the census has no block in this region" in err
    assert Scenario.from_toml(tmp_path / "a/scenario.toml").population.blocks is None


def test_a_table_of_many_counties_needs_a_choice(server, tmp_path, capsys):
    server.put("/counts", send(counts_json([f"360{i:02d}0001001000" for i in range(1, 15)])))
    code, _, err = fetch(capsys, tmp_path / "a", "--what", "osm,census")
    assert code == 2
    assert "names 14 counties: say with --county" in err.splitlines()[-1]


def test_a_damaged_extract_is_told(server, tmp_path, capsys):
    body = bytearray(pbf(tmp_path))
    body[-40:-20] = bytes(20)  # within the last blob's packed data
    code, _, err = fetch(
        capsys, tmp_path / "a", "--what", "osm", "--extract", server.put("/a.osm.pbf", send(bytes(body)))
    )
    assert code == 2
    assert "cannot be read as OpenStreetMap data (failed to uncompress" in err.splitlines()[-1]


def test_the_population_may_be_a_csv_table(server, tmp_path, capsys):
    rows = "".join(f'"1000000US{block}","Block","{50 + i}"\n' for i, block in enumerate(block_ids(4)))
    url = server.put("/P1.csv", send(f'"GEO_ID","NAME","P001001"\n"id","Name","Total"\n{rows}'.encode()))
    server.put("/old.zip", send(block_zip(tmp_path / "old", block_ids(4), field="GEOID10")))
    places = ("--source", f"population={url}", "--source", f"blocks={server.url}/old.zip")
    assert fetch(capsys, tmp_path / "a", "--what", "osm,census", *places)[0] == 0
    blocks, _ = read_blocks(
        Population(blocks=tmp_path / "a/blocks.parquet", table=tmp_path / "a/population.csv", block_field="GEOID"),
        "EPSG:32618",
    )
    assert blocks.night_count.sum() == 50 + 51 + 52 + 53
    terms = {file["source"]: file["licence"] for file in json.loads((tmp_path / "a/fetch.json").read_text())["files"]}
    assert terms["population"] == terms["blocks"] == "ask its publisher" != terms["osm"]


def test_districts_of_ones_own_mark_nothing_commercial(server, tmp_path, capsys):
    body = districts_geojson().replace(b"BoroCD", b"ward")
    url = server.put("/wards.geojson", send(body))
    code, _, err = fetch(capsys, tmp_path / "a", "--districts", url)
    assert code == 2
    assert "has no field 'BoroCD'" in err.splitlines()[-1]
    code, _, err = fetch(capsys, tmp_path / "a", "--districts", url, "--district-field", "ward")
    assert code == 0
    assert "[population] commercial" in err
    assert Scenario.from_toml(tmp_path / "a/scenario.toml").population.commercial == ()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--what", "osm,sensus"), ("'sensus'", "did you mean 'census'")),
        (("--what", ","), ("--what must be 'osm', 'census'",)),
        (("--source", "osm"), ("--source must be NAME=URL",)),
        (("--source", "orbit=http://x.example"), ("did you mean 'orbits'",)),
        (("--source", "osm=ftp://x.example/{query}"), ("must begin with https:// or http://",)),
        (("--source", "osm=http://x.example/{town}"), ("placeholder {town}", "{query}")),
        (("--source", "osm=http://x.example/{"), ("odd brace",)),
        (("--source", "osm=http://[::1"), ("IPv6",)),
        (("--districts", "http://[::1"), ("IPv6",)),
        (("--county", "61"), ("five digits",)),
        (("--margin", "-5"), ("margin",)),
        (("--max-size", "big"), ("--max-size must be a size",)),
        *((("--timeout", value), ("--timeout must be above 0 and at most 3,600 s",)) for value in ("0", "nan", "1e12")),
        (("--date", "20.11.2026"), ("--date",)),
        (("--bounds", "1,2,3"), ("west, south, east, north",)),
        (("--bounds", "-73.9,40.7,-74.0,40.8"), ("west must be below east",)),
        (("--bounds=-74.2,40.6,-73.8,40.9",), ("km2", "100 km2 at most", "--extract")),
    ],
)
def test_bad_input_is_one_sentence_and_makes_no_request(server, tmp_path, capsys, options, words):
    code, out, err = fetch(capsys, tmp_path / "a", *options)
    assert (code, out, server.asked) == (2, "", [])
    assert_one_sentence(err, *words)


def job(**settings):
    return FetchJob(**({"bounds": BOUNDS} | settings))


def parts(folder):
    return fetching.Fetching(job(), folder, Cache(10**6, 5.0, False), [])


def test_the_known_sources_are_asked_by_name():
    urls = dict(plan_fetch(job(counties=(COUNTY,)))[0])
    assert urls["osm"].startswith("https://overpass-api.de/api/interpreter?data=%5Bout%3Axml%5D")
    assert urls["blocks"].endswith("/TIGER2020PL/LAYER/TABBLOCK/2020/tl_2020_36061_tabblock20.zip")
    assert "tigerWMS_Census2020/MapServer/10/query" in urls["population"]
    assert job().sources["orbits"].num_tries == 1  # CelesTrak wants programs to stop at a refusal
    of_2010 = dict(plan_fetch(job(counties=(COUNTY,), census_year="2010"))[0])
    assert of_2010["blocks"].endswith("/TIGER2010/TABBLOCK/2010/tl_2010_36061_tabblock10.zip")


def test_a_large_region_needs_an_extract_and_takes_one_of_any_size():
    wide = (-74.2, 40.6, -73.8, 40.9)
    with pytest.raises(InputError, match="100 km2 at most"):
        job(bounds=wide)
    assert plan_fetch(job(bounds=wide, given_urls={"osm": "https://a.example/town.osm.pbf"}))[0][0][0] == "osm"


def test_abroad_no_population_is_known_and_that_is_said():
    requests, left_out = plan_fetch(job(bounds=(24.93, 60.16, 24.96, 60.18)))
    assert [name for name, _ in requests] == ["osm", "orbits"]
    assert any("no source is known outside the United States" in note for note in left_out)


def test_old_dates_get_the_nominal_satellites_and_the_reason():
    requests, left_out = plan_fetch(job(day=TODAY - timedelta(days=2000)))
    assert "orbits" not in dict(requests)
    assert any("login at space-track.org" in note for note in left_out)


def test_an_overpass_message_in_place_of_data_is_refused(tmp_path):
    (tmp_path / "a").write_bytes(
        osm_xml().replace(b"</osm>", b"<remark> runtime error: Query timed out </remark>\n</osm>")
    )
    with pytest.raises(InputError, match="the server says 'runtime error: Query timed out'"):
        parts(tmp_path).read_osm(tmp_path / "a")


def cut_in_half(body):
    return body[: len(body) // 2 + 9]  # no boundary of two element sets


@pytest.mark.parametrize(
    ("check", "make"),
    [
        ("read_osm", lambda folder: osm_xml()),
        ("read_osm", lambda folder: pbf(folder)),
        (lambda path: fetching.read_block_zip(path, 10**6), lambda folder: block_zip(folder / "b", block_ids(4))),
        (fetching.read_counts, lambda folder: counts_json(block_ids(4))),
        ("read_districts", lambda folder: districts_geojson()),
        ("read_orbits", lambda folder: tle(TODAY)),
    ],
    ids=["osm", "pbf", "blocks", "counts", "districts", "orbits"],
)
def test_half_a_file_a_web_page_and_nothing_are_told_from_a_whole_file(tmp_path, check, make):
    path, body = tmp_path / "it", make(tmp_path)
    check = getattr(parts(tmp_path), check) if isinstance(check, str) else check
    path.write_bytes(body)
    check(path)
    for wrong in (cut_in_half(body), b"<!DOCTYPE html><html><body>Sorry</body></html>", b"", b"\x00\x01\x02" * 99):
        path.write_bytes(wrong)
        with pytest.raises(UNREADABLE):
            check(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"36061", b"ABCDE", "no column of it holds 15-digit block ids"),
        (b"[", b"[" * 100_000, "recursion"),
    ],
    ids=["letters", "deep"],
)
def test_counts_are_of_blocks(tmp_path, old, new, words):
    (tmp_path / "a").write_bytes(counts_json(block_ids(4)).replace(old, new))
    with pytest.raises((InputError, RecursionError), match=words):
        fetching.read_counts(tmp_path / "a")


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("coordinate", [b"NaN", b"Infinity", b"1e999", b"9" * 400])
def test_districts_are_on_this_globe(tmp_path, coordinate):
    (tmp_path / "a").write_bytes(districts_geojson().replace(b"-74.02", coordinate))
    with pytest.raises(UNREADABLE):
        parts(tmp_path).read_districts(tmp_path / "a")


def test_a_zip_with_a_damaged_list_of_parts_is_refused(tmp_path):
    body = block_zip(tmp_path / "b", block_ids(4))
    place = body.rfind(b"PK\x01\x02")
    for damaged in (body[100:], body[:place] + b"XXXX" + body[place + 4 :]):
        (tmp_path / "a").write_bytes(damaged)
        with pytest.raises((OSError, zipfile.BadZipFile)):
            fetching.read_block_zip(tmp_path / "a", 10**6)


def test_a_zip_that_unpacks_to_too_much_is_refused(tmp_path):
    (tmp_path / "a").write_bytes(block_zip(tmp_path / "b", block_ids(4)))
    with pytest.raises(InputError, match="unpacks to more than"):
        fetching.read_block_zip(tmp_path / "a", 100)


def test_a_message_of_tigerweb_in_place_of_counts_is_refused(tmp_path):
    (tmp_path / "a").write_text('{"error": {"code": 400, "message": "Failed to execute query."}}')
    with pytest.raises(InputError, match="Failed to execute query"):
        fetching.read_counts(tmp_path / "a")
