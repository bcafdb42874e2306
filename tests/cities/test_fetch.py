"""From a region to files and a scenario that runs: real formats, made here, from a server in this process."""

import json
import re
import tempfile
import tomllib
from datetime import UTC, date, datetime
from itertools import product
from urllib.parse import unquote

import geopandas as gpd
import numpy as np
import osmium
import pytest
import shapely
from sgp4.exporter import export_tle

import jaxurban as ju
from figures.paper.common import population_totals
from jaxurban.cities.fetch import SOURCES, FetchJob
from jaxurban.cities.kinds import WATERS, Nothing
from jaxurban.cities.osm import MAYBE
from jaxurban.cities.rules import BY_VALUE, LIVES, OF_AREAS, RULES
from jaxurban.io.ephemerides import timescale
from jaxurban.io.files import only_writer
from jaxurban.io.nominal import nominal_satellites
from jaxurban.maps.run import load_city, run_scenario
from tests.cli_runs import assert_one_sentence, run
from tests.made_files import line, node, osm, way
from tests.misbehaving_server import send
from tests.tiled_runs import files_of

BOUNDS = (-74.010, 40.710, -74.008, 40.7115)
REGION = ",".join(map(str, BOUNDS))
HOUSES = ((-74.0095, 40.7103, 40), (-74.0088, 40.7110, 25))  # south-west corner, height
SIDE_DEG = 0.0002


def houses(first=1, north=0.0):
    """Two buildings in the order in which the Overpass API writes: ways, then their nodes."""
    ways, nodes = [], []
    for number, (lon, lat, height_m) in enumerate(HOUSES, first):
        corners = shapely.box(
            lon, lat + north, lon + SIDE_DEG, lat + north + SIDE_DEG
        ).exterior.coords[:4]
        ids = [10 * number + i for i in range(4)]
        nodes += [node(i, *corner) for i, corner in zip(ids, corners, strict=True)]
        ways.append(way(number, [*ids, ids[0]], building="yes", height=height_m))
    return (*ways, *nodes)


def pbf(tmp_path, *elements):
    """Elements as a PBF file, nodes first."""
    (tmp_path / "in.osm").write_text(osm(*sorted(elements)))
    path = tmp_path / "extract.osm.pbf"
    with osmium.SimpleWriter(str(path)) as writer:
        for item in osmium.FileProcessor(str(tmp_path / "in.osm")):
            writer.add(item)
    return path.read_bytes()


OSM = osm(*houses()).encode()


def geojson(shapes, **columns):
    return gpd.GeoDataFrame(columns, geometry=list(shapes), crs="EPSG:4326").to_json().encode()


def blocks_geojson(count=4, **extra):
    """Blocks in a row from west to east, as TIGERweb sends them."""
    west = -74.011 + 0.001 * np.arange(count)
    boxes, ids = (
        shapely.box(west, 40.709, west + 0.001, 40.712),
        [f"36061000100{1000 + i}" for i in range(count)],
    )
    return json.dumps(
        json.loads(geojson(boxes, GEOID=ids, POP100=100 + np.arange(count))) | extra
    ).encode()


DISTRICTS = geojson([shapely.box(-74.02, 40.70, -74.0, 40.72)], BoroCD=[101])


def tle(day):
    """The nominal satellites as two-line elements of a day."""
    satellites = nominal_satellites(day, timescale())
    return "".join(
        f"{s.name}\n" + "\n".join(export_tle(s.model)) + "\n" for s in satellites
    ).encode()


@pytest.fixture
def server(server):
    """A server with every file of the region."""
    bodies = (OSM, blocks_geojson(), DISTRICTS, tle(datetime.now(UTC).date()))
    for name, body in zip(SOURCES, bodies, strict=True):
        server.put(f"/{name}", send(body))
    return server


QUERIES = {
    "osm": "?data={query}",
    "census": "?box={west},{south},{east},{north}",
    "districts": "",
    "orbits": "",
}


def fetch(capsys, server, folder, *options):
    """Run the command with every source at the server; later options prevail."""
    places = [f"--source={name}={server.url}/{name}{query}" for name, query in QUERIES.items()]
    return run(capsys, "fetch", f"--bounds={REGION}", "-o", folder, *places, *options)


def cached(tmp_path):
    return [
        path for path in (tmp_path / "cache").rglob("*") if path.is_file() and "fetch" in path.parts
    ]


@pytest.mark.slow
def test_what_is_fetched_makes_maps(server, tmp_path, capsys):
    folder = tmp_path / "town"
    code, out, err = fetch(capsys, server, folder, "--json")
    assert (code, "error" in err) == (0, False)
    files = [
        (file["source"], file["file"], file["licence"].partition(" ")[0])
        for file in json.loads(out)["files"]
    ]
    assert files == [  # the terms are those of the place, but for OpenStreetMap
        ("osm", "buildings.osm", "ODbL"),
        ("census", "blocks.geojson", "ask"),
        ("districts", "districts.geojson", "ask"),
        ("orbits", "gps-ops.txt", "ask"),
    ]
    assert server.paths() == [f"/{name}" for name in SOURCES]
    assert fetch(capsys, server, tmp_path / "again")[0] == 0
    assert len(server.asked) == 4  # the copies are fresh
    assert files_of(folder) == files_of(tmp_path / "again")
    assert "OpenStreetMap contributors" in (folder / "scenario.toml").read_text(encoding="utf-8")
    moved = folder.rename(tmp_path / "moved")  # paths are relative
    scenario = ju.Scenario.from_toml(moved / "scenario.toml")
    made = run_scenario(scenario, tmp_path / "out")
    ds = next(iter(made.maps.values())).ds
    assert (
        float(ds["obstacle"].sel(altitude=20).sum())
        > float(ds["obstacle"].sel(altitude=60).sum())
        == 0
    )
    night = population_totals(load_city(scenario).blocks)["night"]
    assert night["commercial"] == 100 + 101 + 102 + 103
    assert float(ds["gps"].max()) > 0


def test_a_dry_run_lists_the_requests_and_makes_none(server, tmp_path, capsys):
    code, out, _ = fetch(capsys, server, tmp_path / "a", "--dry-run")
    assert (code, server.asked, (tmp_path / "a").exists()) == (0, [], False)
    assert [line.partition(":")[0] for line in out.splitlines()] == list(SOURCES)
    _, out, _ = fetch(capsys, server, tmp_path / "a", "--dry-run", "--json")
    urls = [row["url"] for row in json.loads(out)["requests"]]
    assert urls[2:] == [f"{server.url}/districts", f"{server.url}/orbits"]


def test_only_what_is_asked_for_is_fetched(server, tmp_path, capsys):
    code, _, err = fetch(capsys, server, tmp_path / "a", "--what", "orbits")
    assert (code, server.paths()) == (0, ["/orbits"])
    assert "no scenario is written without osm" in err
    assert not (tmp_path / "a" / "scenario.toml").exists()
    assert fetch(capsys, server, tmp_path / "b", "--what", "osm")[0] == 0
    settings = tomllib.loads((tmp_path / "b" / "scenario.toml").read_text(encoding="utf-8"))
    assert (set(settings), settings["gps"]["orbits"]) == ({"region", "buildings", "gps"}, "nominal")


@pytest.mark.parametrize("name", ["scenario.toml", "blocks.geojson"])
def test_files_of_ones_own_are_not_replaced_unless_asked(server, tmp_path, capsys, name):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / name).write_text("mine")
    code, out, err = fetch(capsys, server, folder)
    assert (code, out, server.asked, files_of(folder)) == (2, "", [], {name: b"mine"})
    assert_one_sentence(err, name, "--overwrite", "-o")
    assert fetch(capsys, server, folder, "--overwrite")[0] == 0
    assert (folder / "kept" / name).read_text() == "mine"


def test_what_an_earlier_fetch_wrote_is_replaced_unless_somebody_changed_it(
    server, tmp_path, capsys
):
    folder, what = tmp_path / "a", ("--what", "osm")
    for _ in range(2):
        assert fetch(capsys, server, folder, *what)[0] == 0
        (folder / "scenario.toml").unlink()
    (folder / "buildings.osm").write_text("mine, too")
    assert fetch(capsys, server, folder, *what)[0] == 2
    assert fetch(capsys, server, folder, "--overwrite")[0] == 0
    (folder / "fetch.json").unlink()
    (folder / "fetch.json").mkdir()
    assert fetch(capsys, server, folder)[0] == 2
    assert fetch(capsys, server, folder, "--overwrite")[0] == 0
    assert (folder / "kept" / "fetch.json").is_dir()


def test_a_run_that_fails_leaves_the_folder_as_it_was(server, tmp_path, capsys):
    fetch(capsys, server, tmp_path / "a")
    before = files_of(tmp_path / "a")
    server.put("/census", send(blocks_geojson(3)))
    server.put("/orbits", send(WEB_PAGE))
    places = (f"--source={name}={server.url}/{name}?new" for name in ("census", "orbits"))
    assert fetch(capsys, server, tmp_path / "a", "--overwrite", *places)[0] == 2
    assert "/census?new" in [path for path, _ in server.asked]
    assert files_of(tmp_path / "a") == before


def test_old_element_sets_serve_their_own_date_only(server, tmp_path, capsys):
    server.put("/orbits", send(tle(date(2020, 4, 27))))
    today = datetime.now(UTC).date()
    code, _, err = fetch(capsys, server, tmp_path / "now", "--what", "osm,orbits", "--date", today)
    assert (code, "the nominal constellation stands in" in err) == (0, True)
    gps = ju.Scenario.from_toml(tmp_path / "now/scenario.toml").gps
    assert (gps.orbits, gps.utc_times) == (("nominal",), (f"{today}T12:00:00Z",))
    code, _, err = fetch(capsys, server, tmp_path / "own", "--what", "osm,orbits")
    assert (code, "the GPS maps are of 2020-04-27T12:00:00Z" in err) == (0, True)
    assert ju.Scenario.from_toml(tmp_path / "own/scenario.toml").gps.utc_times == (
        "2020-04-27T12:00:00Z",
    )
    assert (
        fetch(capsys, server, tmp_path / "a", "--what", "osm,orbits", "--date", "2020-04-28")[0]
        == 0
    )
    assert ju.Scenario.from_toml(tmp_path / "a/scenario.toml").gps.utc_times == (
        "2020-04-28T12:00:00Z",
    )


def test_two_runs_do_not_share_the_cache_at_a_time(server, tmp_path, capsys):
    with only_writer(tmp_path / "cache/jaxurban/fetch"):
        code, _, err = fetch(capsys, server, tmp_path / "a")
    assert (code, server.asked) == (2, [])
    assert_one_sentence(err, "another run is writing", "XDG_CACHE_HOME")


def test_an_extract_is_kept_as_it_is(server, tmp_path, capsys):
    body = pbf(tmp_path, *houses())
    url = server.put("/state.osm.pbf", send(body))
    code, _, err = fetch(capsys, server, tmp_path / "a", "--what", "osm", "--source", f"osm={url}")
    assert (code, server.paths()) == (0, ["/state.osm.pbf"]), err
    assert (tmp_path / "a" / "buildings.osm.pbf").read_bytes() == body


def asked_of(url):
    """Keys that a URL of the Overpass API asks for, and pairs of keys and values."""
    statements = re.findall(r'nwr\["([^"]+)"(?:~"\^\(([^)]+)\)\$")?\]', unquote(url))
    pairs = {(key, value) for key, values in statements for value in values.split("|")}
    keys = {key for key, values in statements if not values}
    lives, of_lives = re.findall(r'nwr\[~"\^\(([^)]+)\):\(([^)]+)\)\$"~"."\]', unquote(url))[0]
    keys |= {":".join(pair) for pair in product(lives.split("|"), of_lives.split("|"))}
    return keys, {each for each in pairs if each[1]}


BESIDE = {  # what stands beside houses, and what does not
    "tree": {"natural": "tree"},
    "wood": {"natural": "wood"},
    "pole": {"man_made": "flagpole"},
    "mast": {"disused:man_made": "mast"},
    "crane": {"man_made": "crane"},
    "structure": {"amenity": "fountain", "height": "9"},
    "turbine": {"power": "generator", "generator:source": "wind"},
    "wire": {"power": "line"},
    "cableway": {"aerialway": "gondola"},
    "": {"amenity": "bench"},
}


def test_trees_wires_and_all_that_the_reader_knows_are_asked_for_and_stand(
    server, tmp_path, capsys
):
    url = FetchJob(BOUNDS).requests()[0].url
    keys, pairs = asked_of(url)
    assert keys >= {*MAYBE} - {"barrier"}
    assert keys >= {f"{life}:{key}" for key, lives in LIVES.items() for life in lives}
    for key, rules in BY_VALUE.items():
        for value, name in rules.items():
            if OF_AREAS in name:
                assert f'way["{key}"];relation["{key}"];' in unquote(url)
            else:
                assert ((key, value) in pairs) != isinstance(RULES[name], Nothing), (key, value)
    asked = unquote(url)
    assert 'nwr["barrier"]["barrier"!~"^(fence|hedge|kerb|bollard|gate)$"];' in asked
    for key, values in WATERS.items():
        assert f'way["{key}"~"^({"|".join(values)})$"];' in asked
    assert 'way["highway"]["layer"~"^[1-9]"];way["railway"]["layer"~"^[1-9]"];' in asked
    assert len(url) < 6000  # servers take 8,000

    # What such a query brings of a town.
    elements = []
    for number, (kind, tags) in enumerate(BESIDE.items(), 100):
        if not (keys.isdisjoint(tags) and pairs.isdisjoint(tags.items())):
            west, north = -74.0099 + 0.0002 * (number - 100), 40.7112
            if kind in ("wood", "wire", "cableway"):
                lonlat = (west, north), (west + 1e-4, north), (west, north + 1e-4)
                elements.append(line(number, lonlat, **tags))
            else:
                elements.append(node(number, west, north, **tags))
    server.put("/osm", send(osm(*houses(), *elements).encode()))
    assert fetch(capsys, server, tmp_path / "a", "--what", "osm")[0] == 0
    assert asked_of(server.asked[0][0]) == (keys, pairs)
    city = load_city(ju.Scenario.from_toml(tmp_path / "a/scenario.toml"))
    assert set(city.structures.kinds) == {*filter(None, BESIDE)}


WEB_PAGE, NOISE = b"<!DOCTYPE html><html><body>Sorry</body></html>", b"\x00\x01\x02" * 99
BARE = osm(*houses()[:2]).encode()  # without nodes
CUT_OFF = OSM.replace(b"</osm>", b"<remark> runtime error: Query timed out </remark>\n</osm>")
NO_PEOPLE = blocks_geojson().replace(b"POP100", b"other")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "body", "words"),
    [
        *((name, body, "") for name in SOURCES for body in (WEB_PAGE, NOISE, b"")),
        ("census", blocks_geojson()[:-30], ""),
        ("districts", DISTRICTS[:-30], ""),
        ("orbits", tle(date(2026, 11, 20))[: 24 * 80 + 40], ""),
        ("osm", OSM[:-30], "cannot be read as OpenStreetMap data"),
        ("osm", OSM.replace(b'<way id="2"', b"<way & <<"), "damaged or cut short"),
        ("osm", OSM.replace(b'lat="40.710300000"', b'lat="abc"'), "damaged or cut short"),
        ("osm", OSM.replace(b'lat="40.710300000"', b'lat="NaN"'), "damaged or cut short"),
        ("osm", BARE, "not one node"),
        ("osm", CUT_OFF, "says 'runtime error: Query timed out'"),
        (
            "census",
            b'{"error": {"message": "Failed to execute query."}}',
            "Failed to execute query",
        ),
        (
            "census",
            blocks_geojson(exceededTransferLimit=True),
            "a part of the region's blocks only",
        ),
        (
            "census",
            blocks_geojson(properties={"exceededTransferLimit": True}),
            "a part of the region's blocks only",
        ),
        ("census", b"[" * 100_000, ""),
        ("census", NO_PEOPLE, "has no field of population"),
        ("districts", DISTRICTS.replace(b"101", b'"one"'), "labels must be whole numbers"),
        ("districts", DISTRICTS.replace(b"BoroCD", b"ward"), "has no field 'BoroCD'"),
        *(
            ("districts", DISTRICTS.replace(b"-74.02", bad), "")
            for bad in (b"NaN", b"1e999", b"9" * 400)
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_what_does_not_serve_is_refused_by_its_address_and_not_kept(
    server, tmp_path, capsys, name, body, words
):
    server.put(f"/{name}", send(body))
    code, out, err = fetch(capsys, server, tmp_path / "a", "--what", name)
    assert (code, out, (tmp_path / "a").exists()) == (2, "", False)
    last = err.splitlines()[-1]
    assert_one_sentence(last, f"{server.url}/{name}", words)
    assert str(tmp_path) not in last
    assert tempfile.gettempdir() not in last
    assert cached(tmp_path) == []


def test_maps_refuse_an_extract_without_a_building_in_the_region(server, tmp_path, capsys):
    server.put("/osm", send(OSM.replace(b'k="building"', b'k="highway"')))
    assert fetch(capsys, server, tmp_path / "a", "--what", "osm")[0] == 0
    with pytest.raises(ju.InputError, match="no building"):
        load_city(ju.Scenario.from_toml(tmp_path / "a/scenario.toml"))


def test_every_block_of_an_extract_is_unpacked(server, tmp_path, capsys):
    body = pbf(tmp_path, *houses())
    for place in range(len(body) // 2, len(body), 30):
        damaged = bytearray(body)
        damaged[place] ^= 1
        url = server.put("/a.osm.pbf", send(bytes(damaged)))
        code, _, err = fetch(capsys, server, tmp_path / "a", "--what", "osm", f"--source=osm={url}")
        assert (code, url in err.splitlines()[-1]) == (2, True)
    assert cached(tmp_path) == []


def test_a_failure_keeps_what_has_arrived_and_the_same_command_goes_on(server, tmp_path, capsys):
    server.put("/districts", send(WEB_PAGE), send(DISTRICTS))
    assert fetch(capsys, server, tmp_path / "a")[0] == 2
    assert len(cached(tmp_path)) == 2  # buildings and blocks
    assert fetch(capsys, server, tmp_path / "a")[0] == 0
    assert server.paths().count("/osm") == 1


def test_what_holds_nothing_for_the_region_is_left_out_and_that_is_said(server, tmp_path, capsys):
    server.put("/census", send(b'{"type": "FeatureCollection", "features": []}'))
    server.put("/districts", send(DISTRICTS.replace(b"-74.0", b"-75.0")))
    code, _, err = fetch(capsys, server, tmp_path / "a")
    assert code == 0
    assert "the census has no block in this region" in err
    assert "do not touch this region" in err
    population = ju.Scenario.from_toml(tmp_path / "a/scenario.toml").population
    assert (population.blocks, population.districts) == (None, None)
    code, _, err = fetch(capsys, server, tmp_path / "b", "--what", "census,districts")
    assert (code, (tmp_path / "b").exists()) == (2, False)
    assert_one_sentence(err.splitlines()[-1], "nothing of --what can be fetched here")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--what", "osm,censsus"), ("'censsus'", "did you mean 'census'")),
        (("--what", ","), ("--what must be 'osm', 'census'",)),
        (("--source", "osm"), ("--source must be NAME=URL",)),
        (("--source", "orbit=http://x.example"), ("did you mean 'orbits'",)),
        (("--source", "osm=ftp://x.example/{query}"), ("must begin with https:// or http://",)),
        (("--source", "osm=http://x.example/{town}"), ("'town'", "{query}")),
        (("--source", "osm=http://x.example/{"), ("other braces doubled",)),
        (
            ("--source", "osm=http://x.example/\na"),
            (r"'http://x.example/\na'", "must begin with https:// or http://"),
        ),
        (("--source", "osm=http://[::1"), ("IPv6",)),
        (("--margin", "-5"), ("margin",)),
        (("--max-size", "big"), ("--max-size must be a size",)),
        (("--date", "20.11.2026"), ("--date",)),
        (("--bounds", "1,2,3"), ("west, south, east, north",)),
        (("--bounds", "-73.9,40.7,-74.0,40.8"), ("west must be below east",)),
        (("--bounds=-74.2,40.6,-73.8,40.9",), ("km2", "100 km2 at most", "--source osm=URL")),
    ],
)
def test_bad_input_is_one_sentence_and_makes_no_request(server, tmp_path, capsys, options, words):
    code, out, err = fetch(capsys, server, tmp_path / "a", *options)
    assert (code, out, server.asked) == (2, "", [])
    assert_one_sentence(err, *words)


def test_the_known_sources_are_asked_by_name_and_a_large_region_takes_an_extract_of_any_size():
    sources = {source.name: source for source in FetchJob(BOUNDS).requests()}
    assert sources["osm"].url.startswith(
        "https://overpass-api.de/api/interpreter?data=%5Bout%3Axml%5D"
    )
    assert "tigerWMS_Census2020/MapServer/10/query" in sources["census"].url
    assert sources["orbits"].num_tries == 1  # CelesTrak wants programs to stop at a refusal
    assert "{" not in "".join(source.url for source in sources.values())
    large = FetchJob((-74.2, 40.6, -73.8, 40.9), urls={"osm": "https://a.example/town.osm.pbf"})
    assert "buildings.osm.pbf" in [source.file for source in large.requests()]
