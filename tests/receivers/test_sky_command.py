"""``jaxurban sky``: a place or a track in, a table, DOPs, files and a picture out."""

import json
import re
import shutil
from functools import reduce
from operator import xor
from pathlib import Path

import pandas as pd
import pytest
from shapely import box

from tests.cli_runs import assert_one_sentence, run, write_city

WHEN = "2020-04-27T16:00:00Z"


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """Return the folder of maps of a town of one house, made by the command."""
    folder = tmp_path_factory.mktemp("town")
    write_city(folder, box(-73.998, 40.757, -73.997, 40.758))
    from jaxurban import Scenario
    from jaxurban.maps.run import run_scenario

    run_scenario(Scenario.from_toml(folder / "town.toml"), folder / "maps", progress=False)
    return folder / "maps"


AT = ("--at=-73.9985,40.7575", "--altitude", 10)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_place_is_printed_and_written(maps, tmp_path, capsys):
    files = [tmp_path / name for name in ("sky.png", "sky.csv")]
    code, out, err = run(capsys, "sky", maps, *AT, "-o", files[0], "-o", files[1])
    assert code == 0, err
    assert "roof_height_m" in out
    assert "num_visible" in out
    assert "credit" not in out
    assert "jaxurban: Guessed: " in err
    assert files[0].read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(files[1])
    assert re.search(rf"\s{table['azimuth_deg'][0]:.2f}\s", out)  # and no more digits
    assert {*table["state"]} <= {"seen", "hidden", "unknown"}
    code, out, _ = run(capsys, "sky", maps, *AT, "--time", WHEN, "--json")
    facts = json.loads(out)
    assert code == 0
    assert [row["time"] for row in facts["dops"]] == [WHEN]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_track_and_a_route_give_a_row_a_place(maps, tmp_path, capsys):
    track = tmp_path / "track.csv"
    rows = pd.DataFrame({"utc": [WHEN, WHEN], "lon_deg": [-73.9985, -73.998], "lat_deg": 40.757})
    rows.assign(altitude_m=[10.0, 40.0]).to_csv(track, index=False)
    code, _, err = run(capsys, "sky", maps, "--track", track, "-o", tmp_path / "out.csv")
    assert code == 0, err
    table = pd.read_csv(tmp_path / "out.csv")
    assert table["altitude_m"].tolist() == [10.0, 40.0]
    assert {"time", "lon", "lat", "num_visible", "num_unknown", "gdop", "vdop", "has_fix"} <= {
        *table
    }
    route = tmp_path / "route.geojson"
    line = {"type": "LineString", "coordinates": [[-73.999, 40.757], [-73.998, 40.757]]}
    route.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": line}))
    flown = ("--track", route, "--altitude", 40, "--speed", 10, "--time", WHEN)
    code, out, _ = run(capsys, "sky", maps, *flown, "--json")
    facts = json.loads(out)
    assert (code, len(facts["table"])) == (0, 10)
    assert "dops" not in facts
    for more, said in (
        ((), "holds no times: give the speed"),
        (("--time", WHEN), "a route needs --speed"),
    ):
        code, _, err = run(capsys, "sky", maps, *flown[:4], *more)
        assert code == 2
        assert_one_sentence(err, said)


@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_log_gives_a_row_a_satellite_that_validate_reads(maps, tmp_path, capsys):
    log, out = tmp_path / "log.nmea", tmp_path / "labels.csv"
    body = "GPRMC,160000.00,A,4045.42,N,07359.91,W,0.1,0.0,270420,,,A"
    seen = "GPGSV,1,1,01,05,45,100,38"
    checks = [reduce(xor, each.encode()) for each in (body, seen)]
    log.write_text(f"${body}*{checks[0]:02X}\n${seen}*{checks[1]:02X}\n")
    track = ("--track", log, "--altitude", 10, "--by-satellite", "-o", out)
    code, printed, err = run(capsys, "sky", maps, *track)
    assert code == 0, err
    assert "roof_height_m" in printed
    labels = pd.read_csv(out)
    assert list(labels)[:4] == ["utc", "lon_deg", "lat_deg", "satellite"]
    assert list(labels)[-1] == "cn0_dbhz"
    assert {*labels["state"]} <= {"seen", "hidden", "unknown"}
    assert len(labels) > 5


def test_a_flight_with_times_needs_no_speed(maps, tmp_path, capsys):
    points = "".join(
        f'<trkpt lon="{lon}" lat="40.757"><time>{WHEN[:17]}{second:02}Z</time></trkpt>'
        for second, lon in ((1, -73.999), (5, -73.998))
    )
    track = tmp_path / "flight.gpx"
    track.write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    code, out, _ = run(capsys, "sky", maps, "--track", track, "--altitude", 40, "--json")
    table = json.loads(out)["table"]
    assert code == 0
    assert [row["time"][17:19] for row in table] == ["01", "05"]
    track.write_text(track.read_text().replace("time>", "cmt>"))
    code, _, err = run(capsys, "sky", maps, "--track", track, "--altitude", 40)
    assert code == 2
    assert_one_sentence(err, "holds no times: give the speed of the flight (--speed)")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give either --at, a place, or --track, a file"),
        (AT[:1], "--at needs --altitude"),
        ((*AT, "-o", "sky.gif"), "-o must end in .parquet or .csv or .png or .pdf or .svg"),
        (("--track", "t.csv", "--speed", 3), "a table has its own times"),
        (("--track", "no.gpx", "--altitude", 3), "no.gpx"),
        ((*AT, "--by-satellite"), "--by-satellite needs --track"),
        (("--track", "t.csv", "--reference", "r.csv"), "--reference a receiver's log there"),
        (("--track", "no.csv", "--altitude", 3), "no.csv"),
        ((*AT, "--sources", "nowhere"), "'nowhere' does not exist"),
        ((*AT, "--sources", "t.csv"), "name the folder of these files"),
    ],
)
def test_what_cannot_be_done_ends_with_2_and_a_sentence(
    maps, words, said, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("t.csv", "t.gpx", "r.csv"):
        Path(name).touch()
    code, out, err = run(capsys, "sky", maps, *words)
    assert (code, out) == (2, "")
    assert_one_sentence(err, said)


def test_a_track_of_other_columns_is_refused(maps, tmp_path, capsys):
    track = tmp_path / "track.csv"
    for text in ("utc,lon_deg\n", "", "utc,lon_deg,lat_deg\nnoon,1,2\n"):
        track.write_text(text)
        code, _, err = run(capsys, "sky", maps, "--track", track, "--altitude", 20)
        assert code == 2
        assert_one_sentence(err, "the track file")


def test_maps_whose_city_is_gone_say_so(maps, tmp_path, capsys):
    shutil.copytree(maps, tmp_path / "alone")
    code, _, err = run(capsys, "sky", tmp_path / "alone", *AT)
    assert code == 2
    assert_one_sentence(err, "--sources")
