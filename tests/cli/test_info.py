"""What `jaxurban info` says of files that are neither buildings nor rasters: what they hold, and what reads them."""

import json
import math
import shutil
import sys
from functools import reduce
from operator import xor

import pytest
import shapely

import jaxurban as ju
from jaxurban.io.samples import located
from tests.cli_runs import TOWN, assert_one_sentence, run, write_city

SP3_HEAD = "#cP2005  4  2  2  0  0.00000000      33 ORBIT IGS00 HLM  IGS"

ITEM = {
    "type": "SimpleItem",
    "command": 16,
    "frame": 3,
    "autoContinue": True,
    "params": [0, 0, 0, None, 40.757, -73.998, 50],
}
PLAN = {
    "fileType": "Plan",
    "version": 1,
    "geoFence": {"version": 2, "circles": [], "polygons": []},
    "rallyPoints": {"version": 2, "points": []},
    "mission": {
        "version": 2,
        "firmwareType": 12,
        "plannedHomePosition": [40.757, -73.999, 10],
        "items": [{**ITEM, "doJumpId": number} for number in (1, 2, 3)],
    },
}
ROW = "\t0\t3\t16\t0\t0\t0\t0\t40.757\t-73.998\t50\t1\n"
WAYPOINTS = f"QGC WPL 110\n0\t1\t0{ROW[4:]}1{ROW}2{ROW}"
LINE = "-73.999,40.757,50 -73.998,40.757,50"
KML = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><LineString>{}<coordinates>'
    f"{LINE}</coordinates></LineString></Placemark></kml>"
)
GEOJSON = {
    "type": "Feature",
    "properties": {},
    "geometry": {
        "type": "LineString",
        "coordinates": [[-73.999, 40.757, 50], [-73.998, 40.757, 50]],
    },
}
TRACK = "utc,lon_deg,lat_deg\n2024-04-27T10:00:00Z,-73.999,40.757\n2024-04-27T10:00:05Z,-73.998,40.757\n"


def nmea(*seconds: int) -> str:
    bodies = (
        f"GNRMC,10000{second}.00,A,4045.42,N,07359.91,W,0.1,0.0,270424,,,A" for second in seconds
    )
    return "".join(f"${body}*{reduce(xor, body.encode()):02X}\n" for body in bodies)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.plan", json.dumps(PLAN), "a mission of 3 items: jaxurban check DIR"),
        ("a.waypoints", WAYPOINTS, "a mission of 2 items: jaxurban check DIR"),
        ("a.txt", WAYPOINTS, "a mission of 2 items: jaxurban check DIR"),
        ("a.kml", KML.format(""), "a mission of 2 items: jaxurban check DIR"),
        (
            "b.kml",
            KML.format("<altitudeMode>relativeToGround</altitudeMode>"),
            "a mission of 2 items: jaxurban check DIR",
        ),
        ("a.geojson", json.dumps(GEOJSON), "a mission of 2 items: jaxurban check DIR"),
        (
            "a.nmea",
            nmea(0, 1, 2),
            "a log or a track of 3 s, from 2024-04-27T10:00:00Z to 2024-04-27T10:00:02Z: jaxurban sky DIR --track",
        ),
        (
            "track.csv",
            TRACK,
            "a log or a track of 2 s, from 2024-04-27T10:00:00Z to 2024-04-27T10:00:05Z: jaxurban sky DIR --track",
        ),
        ("a.toml", "\ufeff" + TOWN, "a scenario of 2 altitudes: jaxurban maps"),
    ],
)
def test_info_says_what_a_file_holds_and_which_command_reads_it(
    capsys, tmp_path, name, content, said
):
    (tmp_path / name).write_text(content, encoding="utf-8")
    code, out, err = run(capsys, "info", tmp_path / name)
    assert (code, err) == (0, "")
    assert out.startswith(f"holds  {said} ")
    assert name in out
    code, out, _ = run(capsys, "info", tmp_path / name, "--json")
    assert json.loads(out)["holds"].startswith(said)


def test_info_says_the_title_of_the_report_in_a_folder(capsys, tmp_path):
    (tmp_path / "report.md").write_text("# What differs\n\nMuch.\n")
    (tmp_path / "checksums.json").write_text("{}")
    code, out, err = run(capsys, "info", tmp_path)
    assert (code, err) == (0, "")
    assert out == f"holds  a report, 'What differs': read '{tmp_path / 'report.md'}'\n"


def test_of_a_folder_of_folders_of_maps_every_command_names_these(made, capsys, tmp_path):
    for command in (("compare", made.parent, made, "-o", tmp_path / "x"), ("view", made.parent)):
        code, _, err = run(capsys, *command)
        assert code == 2
        assert_one_sentence(err, "holds no maps itself", f"name one of them, '{made}'")
    code, _, err = run(capsys, "maps", made.parent, "-o", tmp_path / "x")
    assert code == 2
    assert_one_sentence(err, f"name one of them, '{made}'")
    assert not (tmp_path / "x").exists()


def test_an_empty_folder_is_said_to_be_empty_and_a_refused_run_leaves_none(capsys, tmp_path):
    code, _, err = run(capsys, "info", tmp_path)
    assert code == 2
    assert_one_sentence(err, f"'{tmp_path}' is empty")
    (tmp_path / "town.toml").write_text(TOWN)
    maps = "maps", tmp_path / "town.toml", "-o", tmp_path / "new" / "town"
    code, _, err = run(capsys, *maps, "--memory", "1MiB")
    assert (code, "memory" in err) == (2, True), err
    assert not (tmp_path / "new").exists()


HOUSE = shapely.box(-73.998, 40.757, -73.997, 40.758)
ZONE = {
    "type": "Feature",
    "properties": {"name": "park", "ceiling_m": 120},
    "geometry": shapely.geometry.mapping(HOUSE),
}
GEOZONE = {
    "features": [
        {
            "identifier": "A1",
            "restriction": "PROHIBITED",
            "geometry": [
                {
                    "uomDimensions": "M",
                    "lowerLimit": 0,
                    "lowerVerticalReference": "AGL",
                    "upperLimit": 60,
                    "upperVerticalReference": "AGL",
                    "horizontalProjection": shapely.geometry.mapping(HOUSE),
                }
            ],
        }
    ]
}


@pytest.mark.parametrize(
    ("zone", "said"),
    [
        (ZONE, "(1 closed: 'park' from the ground to 120 m)"),
        (GEOZONE, "(1 closed: 'A1' from 0 m to 60 m)"),
    ],
)
def test_info_of_a_file_of_zones_names_them_and_the_option_that_takes_them(
    capsys, tmp_path, zone, said
):
    path = tmp_path / "zones.geojson"
    path.write_text(json.dumps(zone))
    code, out, err = run(capsys, "info", path)
    assert (code, err) == (0, "")
    assert out == f"holds  no-fly zones {said}: jaxurban plan DIR --no-fly {str(path)!r}\n"
    path.write_text(json.dumps(ZONE | {"properties": {}}))  # an outline, of whatever
    _, out, _ = run(capsys, "info", path)
    assert "buildings" in out
    assert f"jaxurban plan DIR --no-fly {str(path)!r}" in out


@pytest.mark.filterwarnings(  # of Zarr, which xarray writes
    "ignore:Consolidated metadata", "ignore:.*Zarr format 3 specification"
)
def test_info_of_what_was_written_says_what_it_is(capsys, made, tmp_path):
    _, whole, _ = run(capsys, "info", made)
    for inner in ("maps.zarr", "geotiff"):
        assert run(capsys, "info", made / inner) == (0, whole, "")
    layer = min((made / "geotiff").glob("gps_20m*.tif"))
    code, out, err = run(capsys, "info", layer)
    assert (code, err) == (0, "")
    assert out.startswith("holds  a map of GPS quality, 20 m above ground, 2020-")
    ju.open_maps(made).ds.to_zarr(tmp_path / "own.zarr")
    code, out, _ = run(capsys, "info", tmp_path / "own.zarr")
    assert (code, out) == (
        0,
        f"holds  a Zarr: xarray.open_zarr({str(tmp_path / 'own.zarr')!r}) reads it\n",
    )

    study = tmp_path / "checked"
    (tmp_path / "a.plan").write_text(json.dumps(PLAN))
    run(capsys, "check", made, tmp_path / "a.plan", "-o", study)
    title = (study / "report.md").read_text().splitlines()[0].removeprefix("# ")
    assert run(capsys, "info", study)[:2] == (
        0,
        f"holds  a report, {title!r}: read {str(study / 'report.md')!r}\n",
    )


def test_info_knows_element_sets_by_their_satellites_and_dates(capsys, tmp_path):
    path = tmp_path / "gps.txt"
    shutil.copy(located("sample:shinjuku/gps.tle"), path)
    code, out, _ = run(capsys, "info", path)
    num = sum(line.startswith("1 ") for line in path.read_text().splitlines())
    assert code == 0
    assert out.startswith(f"holds  orbits of {num} satellites from 2018-12-")
    assert f"[gps] orbits = '{path}' in a scenario" in out


def test_info_says_what_orbits_need_whose_reader_is_not_installed(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sidereon", None)
    path = tmp_path / "z.sp3"
    path.write_text(f"{SP3_HEAD}\n* 2005 4 2 2 0 0.00000000\nEOF\n", encoding="utf-8")
    code, out, err = run(capsys, "info", path)
    assert (code, out) == (2, "")
    assert_one_sentence(err)
    assert "jaxurban[receiver]" in err


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.plan", json.dumps({**PLAN, "mission": {}}), ("a.plan", "as a mission", "items are no")),
        ("a.log", "FMT, 128, 89, FMT", ("a.log", "a log of ArduPilot: make GPX of it")),
        ("a.toml", "[region\n", ("a.toml", "a scenario in TOML")),
        ("a.doc", "Dear Sir", ("a.doc", "no content that is known: buildings are read from")),
        ("a.geojson", '{"type": "Feature"', ("a.geojson", "as a vector file")),
    ],
)
def test_what_cannot_be_read_is_named_as_what_it_is(capsys, tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    code, _, err = run(capsys, "info", tmp_path / name)
    assert code == 2
    assert_one_sentence(err, *words)


IN_HOUSE = ("--at", "-73.9975,40.7575")


def test_info_says_what_stands_at_a_place_of_a_file_and_by_which_rule(capsys, tmp_path):
    write_city(tmp_path, HOUSE)
    code, out, err = run(capsys, "info", tmp_path / "city.geojson", *IN_HOUSE)
    assert (code, err) == (0, "")
    lines = [line.split(maxsplit=1) for line in out.splitlines()[1:]]
    assert dict(map(tuple, lines)) == {
        "kind": "building",
        "rule": "area in a file that names no buildings",
        "height_m": "30.0",
        "known_by": "a height in its file",
        "likely_m": "30.0",
        "highest_m": "30.0",
        "min_height_m": "0.0",
        "distance_m": "0.0",
        "source": str(tmp_path / "city.geojson"),
    }
    assert out.startswith("this stands at -73.997500, 40.757500")


def test_info_at_a_place_prints_its_numbers_as_json_and_null_for_no_bound(capsys, tmp_path):
    write_city(tmp_path, HOUSE, shapely.box(-73.996, 40.757, -73.995, 40.758))
    file = tmp_path / "city.geojson"
    city = json.loads(file.read_text())
    city["features"].append(
        {
            "type": "Feature",
            "properties": {"man_made": "chimney"},
            "geometry": {"type": "Point", "coordinates": [-73.9964, 40.7575]},
        }
    )
    file.write_text(json.dumps(city))
    _, out, _ = run(capsys, "info", file, "--at", "-73.9964,40.7575", "--json")
    (row,) = json.loads(out)["numbers"]
    assert (row["kind"], row["height_m"], row["highest_m"]) == ("chimney", 30.0, None)
    _, out, _ = run(capsys, "info", file, "--at", "-73.9968,40.7575", "--json")
    facts = json.loads(out)
    assert facts["stands"] == "nothing stands at -73.996800, 40.757500"
    east_m = 0.0002 * 111_320 * math.cos(math.radians(40.7575))
    assert facts["numbers"][0]["kind"] == "building"
    assert facts["numbers"][0]["distance_m"] == pytest.approx(east_m, rel=0.01)


def test_info_at_a_place_outside_or_swapped_is_one_sentence(capsys, tmp_path):
    write_city(tmp_path, HOUSE)
    for place in ("40.7575,-73.9975", "-73.9,40.7575"):
        code, out, err = run(capsys, "info", tmp_path / "city.geojson", f"--at={place}")
        assert (code, out) == (2, "")
        assert_one_sentence(err, place.split(",")[0], "longitude first")


@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_info_of_maps_says_what_stands_in_the_city_that_they_are_of(capsys, made):
    city = ju.Scenario.from_toml(made.parent / "town.toml")
    assert city.is_synthetic
    code, out, err = run(capsys, "info", made, "--at", "-73.9965,40.758", "--json")
    assert code == 0, err
    assert json.loads(out)["numbers"][0]["known_by"] == "the synthetic city"
