"""``jaxurban sky``: a place or a track in, a table, DOPs, files and a picture out."""

import json
import shutil
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
    assert {*table["state"]} <= {"seen", "hidden", "unknown"}
    code, out, _ = run(capsys, "sky", maps, *AT, "--time", WHEN, "--by", "map", "--json")
    facts = json.loads(out)
    assert (code, facts["facts"]["by"]) == (0, "map")
    assert [row["time"] for row in facts["dops"]] == [WHEN]


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give either --at, a place, or --track, a file"),
        (("--at=-73.9,40.7",), "--at needs --altitude"),
        ((*AT, "-o", "sky.gif"), "-o must end in .parquet or .csv or .png or .pdf or .svg"),
        (("--track", "t.csv", "--speed", 3), "a table has its own times"),
        (("--track", "t.gpx", "--altitude", 3), "a route needs --speed"),
        (("--track", "no.csv", "--altitude", 3), "no.csv"),
        ((*AT, "--resolution", 20), "rays follow outlines"),
        (
            (*AT, "--by", "map", "--resolution", 3),
            "resolution_m must be that of maps in the folder",
        ),
        ((*AT, "--sources", "nowhere"), "'nowhere' does not exist"),
        ((*AT, "--sources", "t.csv"), "'t.csv' is none"),
    ],
)
def test_what_cannot_be_done_ends_with_2_and_a_sentence(
    maps, words, said, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("t.csv", "t.gpx"):
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
