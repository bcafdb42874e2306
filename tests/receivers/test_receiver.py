"""Receiver logs: a row an epoch or a satellite, from tables and files, and what is wrong with one in a sentence."""

import gzip
import time

import numpy as np
import pandas as pd
import pytest

from jaxurban.errors import InputError
from jaxurban.receivers.validation import logs
from jaxurban.receivers.validation.logs import read_receiver_log

GOOD = pd.DataFrame(
    {
        "utc": ["2018-12-19T06:07:38Z", "2018-12-19T06:07:37Z", "2018-12-19T06:07:39Z"],
        "lon_deg": [139.1, 139.0, 139.2],
        "lat_deg": [35.1, 35.0, 35.2],
        "satellite": ["G05"] * 3,
        "cn0_dbhz": [41.0, 40.0, 42.0],
    }
)


def test_epochs_come_in_the_order_of_their_times():
    log = read_receiver_log(GOOD)
    assert log.satellites.cn0_dbhz.tolist() == [40, 41, 42]
    assert log.epochs.lon_deg.tolist() == [139.0, 139.1, 139.2]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_file_is_read_as_the_table_that_it_holds(suffix, tmp_path):
    file = tmp_path / f"log{suffix}"
    GOOD.to_csv(file, index=False) if suffix == ".csv" else GOOD.to_parquet(file)
    pd.testing.assert_frame_equal(read_receiver_log(file).epochs, read_receiver_log(GOOD).epochs)


ZONES = (" UTC", "UTC", " gmt", "+00", "+0000", "+00:00", ".000Z", ".000 +00:00")


@pytest.mark.parametrize(
    "utc",
    [
        GOOD.utc.str.replace("T06", "T15").str.replace("Z", "+09:00"),
        pd.to_datetime(GOOD.utc).dt.tz_convert("Asia/Tokyo"),
        *(GOOD.utc.str.replace("T", " ").str.replace("Z", zone) for zone in ZONES),
    ],
)
def test_an_offset_from_utc_is_taken_off_and_a_zone_may_be_written_in_several_ways(utc):
    read, expected = (read_receiver_log(table).epochs for table in (GOOD.assign(utc=utc), GOOD))
    pd.testing.assert_frame_equal(read, expected)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (GOOD.iloc[:0], ("has 0 rows", "satellite and cn0_dbhz")),
        (GOOD.drop(columns="utc"), ("of the columns lon_deg", "columns utc")),
        (GOOD.assign(utc=GOOD.utc.str.rstrip("Z")), ("without a zone", "local", "+09:00")),
        (
            GOOD.assign(utc=pd.to_datetime(GOOD.utc).dt.tz_localize(None)),
            ("without a zone", "local"),
        ),
        (GOOD.assign(utc=[1545199657.0] * 3), ("'1545199657.0'", "GPS time")),
        (GOOD.assign(utc="noon"), ("'noon'", "Z")),
        (GOOD.assign(utc="-001-01-01T06:07:37Z"), ("'-001-01-01T06:07:37Z'", "write UTC")),
        (GOOD.assign(utc="0000-01-01T06:07:37Z"), ("'0000-01-01T06:07:37Z'", "write UTC")),
        (GOOD.assign(utc="2018-13-41T06:07:37Z"), ("'2018-13-41T06:07:37Z'", "write UTC")),
        (
            GOOD.assign(utc=[*GOOD.utc[:2], "12/19/2018 06:07:39Z"]),
            ("'12/19/2018 06:07:39Z'", "write UTC"),
        ),
        (GOOD.assign(utc="2018-12-19"), ("without a zone",)),
        (GOOD.assign(utc=[None, *GOOD.utc[1:]]), ("a time, which is none", "remove rows without")),
        (
            GOOD.drop(columns=["satellite", "cn0_dbhz"]).assign(num_tracked=8),
            ("of the columns utc, lon_deg, lat_deg, num_tracked: give", "satellite and cn0_dbhz"),
        ),
        (GOOD.assign(lon_deg=[np.nan, 139.0, 139.0]), ("has nan in lon_deg of 1 row(s)", "remove")),
        (GOOD.assign(lat_deg=139.0), ("from -90 to 90", "swapped")),
        (
            GOOD.assign(utc=GOOD.utc[0]),
            ("two rows of G05 at 2018-12-19T06:07:38", "one row an epoch"),
        ),
        (GOOD.assign(**{" utc": GOOD.utc}), ("two columns utc", "keep one")),
        (GOOD.assign(cn0_dbhz="many"), ("'many'", "cn0_dbhz")),
    ],
)
def test_what_is_wrong_with_a_log_is_one_sentence(table, words):
    assert_refused(table, *words)


def assert_refused(source, *words):
    """Check that a log is refused in one sentence that holds all words."""
    with pytest.raises(InputError) as raised:
        read_receiver_log(source)
    said = str(raised.value)
    assert "\n" not in said
    assert [word for word in words if word not in said] == []


SEEN = pd.DataFrame(  # two epochs of three satellites, unsorted
    {
        "utc": [*["2018-12-19T06:07:38Z"] * 3, *["2018-12-19T06:07:37.0Z"] * 3],
        "lon_deg": [139.1, 139.1, 139.1, 139.0, 139.0, 139.0],
        "lat_deg": [35.1, 35.1, 35.1, 35.0, 35.0, 35.0],
        "satellite": ["G05", "E12", "C19", "E12", "G05", "J02"],
        "azimuth_deg": [10.0, 20.0, 30.0, 21.0, 11.0, 0.0],
        "elevation_deg": [50.0, 60.0, 70.0, 61.0, 51.0, 0.0],
        "cn0_dbhz": [45.0, 0.0, 30.0, 1.0, 44.0, 0.0],
    }
)


def test_a_log_of_satellites_comes_by_epoch_and_satellite():
    log = read_receiver_log(SEEN)
    assert log.epochs.lon_deg.tolist() == [139.0, 139.1]
    assert log.epochs.utc.dt.second.tolist() == [37, 38]
    rows = log.satellites
    assert rows.epoch.tolist() == [0, 0, 0, 1, 1, 1]
    assert rows.satellite.tolist() == ["E12", "G05", "J02", "C19", "E12", "G05"]
    assert rows.cn0_dbhz.tolist() == [1.0, 44.0, 0.0, 30.0, 0.0, 45.0]
    assert rows.azimuth_deg.tolist() == [21.0, 11.0, 0.0, 30.0, 20.0, 10.0]
    assert rows.elevation_deg.tolist() == [61.0, 51.0, 0.0, 70.0, 60.0, 50.0]
    assert {str(kind) for kind in rows.dtypes} == {"int32", "category", "float32"}
    assert dict(log.left_out) == {}


def test_a_log_of_satellites_may_leave_angles_to_orbits_and_hold_other_columns():
    counts = SEEN.drop(columns=["azimuth_deg", "elevation_deg"])
    log = read_receiver_log(counts.assign(num_tracked=[2] * 3 + [3] * 3, other="x"))
    assert list(log.satellites) == ["epoch", "satellite", "cn0_dbhz"]
    assert list(log.epochs) == ["utc", "lon_deg", "lat_deg"]


@pytest.mark.parametrize(
    "suffix", [".csv", ".csv.gz", ".CSV.BZ2", ".csv.xz", ".csv.zip", ".parquet"]
)
def test_a_file_of_satellites_may_be_compressed(suffix, tmp_path):
    file = tmp_path / f"log{suffix}"
    packing = {".BZ2": "bz2"}.get(file.suffix, "infer")
    SEEN.to_parquet(file) if suffix == ".parquet" else SEEN.to_csv(
        file, index=False, compression=packing
    )
    read, expected = read_receiver_log(file), read_receiver_log(SEEN)
    pd.testing.assert_frame_equal(read.epochs, expected.epochs)
    pd.testing.assert_frame_equal(read.satellites, expected.satellites)


def changed(column: str, *values: object) -> pd.DataFrame:
    """Return the log with other values at its beginning."""
    return SEEN.assign(**{column: [*values, *SEEN[column][len(values) :]]})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (SEEN.iloc[:0], ("has 0 rows", "satellite and cn0_dbhz")),
        (SEEN.drop(columns="cn0_dbhz"), ("of the columns", "satellite and cn0_dbhz")),
        (
            SEEN.drop(columns="elevation_deg"),
            ("one of the columns azimuth_deg and elevation_deg", "give both"),
        ),
        *(
            (changed(name, np.nan), (f"has nan in {name} of 1 row", "remove"))
            for name in SEEN.columns[4:]
        ),
        (changed("lat_deg", np.nan), ("has nan in lat_deg of 1 row",)),
        (changed("satellite", None), ("as a satellite", "such as G05")),
        (changed("satellite", "GPS 5"), ("'GPS 5' as a satellite", "such as G05", "rename")),
        (
            changed("satellite", "G05", "G05"),
            ("two rows of G05 at 2018-12-19T06:07:38", "keep one", "such as that of L1"),
        ),
        (
            changed("lon_deg", 139.2),
            ("two places at 2018-12-19T06:07:38", "keep one place an epoch"),
        ),
        (changed("lon_deg", 239.2), ("has 239.2 in lon_deg", "from -180 to 180")),
        (
            SEEN.assign(lon_deg=SEEN.lat_deg, lat_deg=SEEN.lon_deg),
            ("has 139.1 in lat_deg", "swapped"),
        ),
        (
            SEEN.assign(**np.radians(SEEN[["lon_deg", "lat_deg"]])),
            ("as if they were radians", "give degrees"),
        ),
        (
            SEEN.assign(azimuth_deg=np.radians(SEEN.azimuth_deg)),
            ("azimuth_deg of at most 0.5236", "give degrees"),
        ),
        (
            SEEN.assign(elevation_deg=np.radians(SEEN.elevation_deg)),
            ("elevation_deg of at most 1.222", "give degrees"),
        ),
        (
            SEEN.assign(azimuth_deg=SEEN.azimuth_deg - 15),
            ("has -5.0 in azimuth_deg of 3 row", "from 0 to 360"),
        ),
        (
            changed("elevation_deg", -0.1),
            ("has -0.1 in elevation_deg", "below the horizon", "remove the rows"),
        ),
        (SEEN.assign(cn0_dbhz=10 ** (SEEN.cn0_dbhz / 10)), ("in cn0_dbhz", "from 0 to 70", "dBHz")),
        (
            SEEN.assign(cn0_dbhz=SEEN.cn0_dbhz // 5),
            ("cn0_dbhz of at most 9", "digits 1 to 9", "give dBHz"),
        ),
    ],
)
def test_what_is_wrong_with_a_log_of_satellites_is_one_sentence(table, words):
    assert_refused(table, *words)


def test_a_log_of_too_many_rows_is_to_be_thinned(monkeypatch):
    monkeypatch.setattr(logs, "MOST_ROWS", 2)
    assert_refused(SEEN, "has 6 rows, more than the 2 that are read", "thin")


@pytest.mark.parametrize("suffix", [".csv.gz", ".csv.bz2", ".csv.xz", ".csv.zip", ".parquet"])
def test_a_truncated_or_empty_file_is_one_sentence(suffix, tmp_path):
    file = tmp_path / f"log{suffix}"
    SEEN.to_parquet(file) if suffix == ".parquet" else SEEN.to_csv(file, index=False)
    whole = file.read_bytes()
    for data in (whole[: len(whole) // 2], b"", b"no log", gzip.compress(b"")):
        file.write_bytes(data)
        assert_refused(file, str(file))


def test_digits_of_other_scripts_are_no_name_of_a_satellite():
    assert_refused(changed("satellite", "G٠٥", "G05", "G06"), "'G٠٥'", "RINEX 3")


def test_a_table_of_many_columns_is_refused_by_its_first_line(tmp_path):
    file = tmp_path / "wide.csv"
    row = ",".join(["1"] * 50_000)
    file.write_text(f"{row}\n{row}\n")
    began_s = time.perf_counter()
    assert_refused(file, "has 50,000 columns, and 2,000 are read at most")
    assert time.perf_counter() - began_s < 5
