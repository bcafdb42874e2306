"""What `jaxurban info` says of files that are neither buildings nor rasters: what they hold, and what reads them."""

import json
import shutil
import sys
from functools import reduce
from operator import xor

import pytest

from jaxurban.io.samples import located
from tests.cli_runs import TOWN, assert_one_sentence, run

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
