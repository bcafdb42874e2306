"""Tables of CSV, whichever reader takes them: a row that does not fit its header is refused with its line."""

import gzip
import io
import re

import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.cities.census import _counts_in_table
from jaxurban.cities.vector import open_frame
from jaxurban.flights.missions.mission import read_mission
from jaxurban.io.orbits import read_orbits
from jaxurban.io.tables import check_rows, read_table
from jaxurban.io.tracks import read_track
from jaxurban.receivers.validation.logs import read_receiver_log

LITCHI = "latitude,longitude,altitude(m),curvesize(m),altitudemode,note"
OMM = (
    "OBJECT_NAME,OBJECT_ID,EPOCH,MEAN_MOTION,ECCENTRICITY,INCLINATION,RA_OF_ASC_NODE,ARG_OF_PERICENTER,MEAN_ANOMALY,"
    "EPHEMERIS_TYPE,CLASSIFICATION_TYPE,NORAD_CAT_ID,ELEMENT_SET_NO,REV_AT_EPOCH,BSTAR,MEAN_MOTION_DOT,MEAN_MOTION_DDOT"
)
SQUARE = "POLYGON((8.{0} 47.1,8.{0}5 47.1,8.{0}5 47.2,8.{0} 47.1))"
# Of each reader what it reads of a file, the header, and a row of a number from 1 to 3.
READERS = {
    "litchi": (
        lambda file: [leg.end.height_m for leg in read_mission(file, home=(8.5, 47)).legs[1:]],
        LITCHI,
        "47.{0},8.5,{0}.5,0,0,a",
    ),
    "places": (
        lambda file: [leg.end.height_m for leg in read_mission(file, heights="geoid").legs],
        "lon,lat,name,altitude_m",
        '8.{0},47.1,"a, b",{0}.5',
    ),
    "track": (
        lambda file: read_track(file)["altitude_m"].tolist(),
        "utc,lon_deg,lat_deg,altitude_m,note",
        "2026-11-01T12:00:0{0}Z,8.{0},47.1,{0}.5,a",
    ),
    "log": (
        lambda file: read_receiver_log(file).satellites["cn0_dbhz"].tolist(),
        "utc,lon_deg,lat_deg,satellite,cn0_dbhz,note",
        "2026-11-01T12:00:0{0}Z,8.{0},47.1,G05,4{0}.5,a",
    ),
    "orbits": (
        lambda file: [each.model.satnum for each in read_orbits(file).satellites],
        OMM,
        "GPS (PRN 0{0}),1997-035A,2026-11-01T06:07:12,2.0056,.0076,55.8,130.5,54.4,306.5,0,U,2485{0},999,21,0,0,0",
    ),
    "outlines": (
        lambda file: open_frame(file, "buildings")["height"].tolist(),
        "WKT,height,levels",
        f'"{SQUARE}",{{0}}.5,3',
    ),
    "census": (
        lambda file: _counts_in_table(
            ju.Population(blocks="b", table=str(file)), pd.Series(["101", "102", "103"]), "b"
        ).tolist(),
        "GEOID10,NAME,POP10",
        "10{0},a,{0}.0",
    ),
}
without_last = re.compile(r",[^,]*$").sub
pytestmark = pytest.mark.filterwarnings("ignore::jaxurban.errors.GuessWarning")


@pytest.fixture(params=READERS)
def table(request, tmp_path):
    """Return a function that reads a header and rows, the header, and three rows, of one of `READERS`."""
    reader, header, row = READERS[request.param]
    file = tmp_path / "table.csv"

    def read(*lines: str):
        file.write_text("\n".join(lines) + "\n")
        return reader(file)

    return read, header, [row.format(number) for number in (1, 2, 3)]


def test_a_row_with_a_value_less_or_more_is_refused_with_its_line(table):
    read, header, (one, two, three) = table
    num = header.count(",") + 1
    for changed, more in ((without_last("", two), -1), (two + ",7", 1)):
        words = f"line 3 of .* and its header differ in .*, {num + more} and {num}: mend that line"
        with pytest.raises(ju.InputError, match=words):
            read(header, one, changed, three)
        with pytest.raises(ju.InputError, match=r"line 2 of .* and its header differ"):
            read(header, changed, changed, changed)


def test_a_file_that_was_cut_within_a_row_is_refused_with_its_line(table):
    read, header, rows = table
    for cut in (rows[2][: len(rows[2]) // 2], rows[2][:2]):
        with pytest.raises(ju.InputError, match=r"line 4 of|unexpected end of data"):
            read(header, *rows[:2], cut)


def test_commas_at_the_end_and_blank_lines_change_nothing(table):
    read, header, (one, two, three) = table
    plain = read(header, one, two, three)
    assert len(plain) in (2, 3)
    for lines in (
        [header, f"{one},", f"{two},", f"{three},"],
        [header, one, f"{two},,,", three] if header != LITCHI else [header, one, two, three],
        [f"{header},", f"{one},", f"{two},", f"{three},"],
        [header, one, "", two, three, "", ""],
    ):
        assert read(*lines) == plain


def test_a_note_below_the_rows_of_a_census_is_of_no_block(tmp_path):
    file = tmp_path / "people.csv"
    file.write_text("GEOID10,NAME,POP10\n101,a,10\n   \nSource: the census\n")
    assert READERS["census"][0](file)[0] == 10


def test_a_value_in_quotes_may_hold_commas_quotes_and_lines():
    rows = b'a,b\n"1, 2","3 ""4""\n5"\n"6",7\n'
    assert check_rows(io.BytesIO(rows), "a.csv") == 2
    with pytest.raises(ju.InputError, match=r"line 5 of 'a.csv' .* 1 and 2: mend that line"):
        check_rows(io.BytesIO(rows + b"8\n"), "a.csv")


def test_outlines_of_any_length_and_any_separator_are_read(tmp_path):
    corners = ",".join(f"{8 + k * 1e-6:.6f} 47.1" for k in range(12_000))
    ring = f'"POLYGON((8 47,{corners},8 47))"'
    assert len(ring) > 131_072  # what Python's reader of CSV takes
    file = tmp_path / "long.csv"
    for mark in ",;\t|":
        file.write_text(f"WKT{mark}height\n{ring}{mark}5.5\n{ring}{mark}6.5\n")
        assert open_frame(file, "buildings")["height"].tolist() == ["5.5", "6.5"]


def test_rows_of_a_packed_table_are_looked_at_too(tmp_path):
    file = tmp_path / "table.csv.gz"
    file.write_bytes(gzip.compress(b"a,b\n1,2\n3\n"))
    with pytest.raises(ju.InputError, match=r"line 3 of .* and its header differ .*, 1 and 2"):
        read_table(file, "instances")


def test_a_table_is_known_by_its_content_under_any_name(tmp_path):
    frame = pd.DataFrame({"a": [1, 2], "b": [3, 4]})
    text = frame.to_csv(index=False).encode()
    for name in ("t.csv", "t.parquet", "t.txt", "t.dat", "t"):
        for content in (text, gzip.compress(text), frame.to_parquet()):
            (tmp_path / name).write_bytes(content)
            pd.testing.assert_frame_equal(read_table(tmp_path / name, "instances"), frame)
    (tmp_path / "t.csv").write_text('{"type": "FeatureCollection", "features": []}')
    with pytest.raises(ju.InputError, match="is no table: give CSV or Parquet"):
        read_table(tmp_path / "t.csv", "instances")
