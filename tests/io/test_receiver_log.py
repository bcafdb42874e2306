"""Receiver logs: tables of epochs, and what is wrong with one in one sentence."""

import numpy as np
import pandas as pd
import pytest

from jaxurban.errors import InputError
from jaxurban.io.read.receiver import read_receiver_log

GOOD = pd.DataFrame(
    {
        "utc": ["2018-12-19T06:07:38Z", "2018-12-19T06:07:37Z", "2018-12-19T06:07:39Z"],
        "lon_deg": [139.1, 139.0, 139.2],
        "lat_deg": [35.1, 35.0, 35.2],
        "num_tracked": [8, 7, 9],
    }
)


def test_epochs_come_in_the_order_of_their_times():
    log = read_receiver_log(GOOD)
    assert log.epochs.num_tracked.tolist() == [7, 8, 9]
    assert log.epochs.lon_deg.tolist() == [139.0, 139.1, 139.2]
    assert log.witnesses == ("num_tracked",)


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
        (GOOD.iloc[:0], ("has 0 rows", "num_tracked")),
        (GOOD.drop(columns="utc"), ("of the columns lon_deg", "columns utc")),
        (GOOD.assign(utc=GOOD.utc.str.rstrip("Z")), ("without a zone", "local", "+09:00")),
        (GOOD.assign(utc=pd.to_datetime(GOOD.utc).dt.tz_localize(None)), ("without a zone", "local")),
        (GOOD.assign(utc=[1545199657.0] * 3), ("'1545199657.0'", "GPS time")),
        (GOOD.assign(utc="noon"), ("'noon'", "Z")),
        (GOOD.assign(utc="2018-13-41T06:07:37Z"), ("'2018-13-41T06:07:37Z'", "write UTC")),
        (GOOD.assign(utc=[*GOOD.utc[:2], "12/19/2018 06:07:39Z"]), ("'12/19/2018 06:07:39Z'", "write UTC")),
        (GOOD.assign(utc="2018-12-19"), ("without a zone",)),
        (GOOD.assign(utc=[None, *GOOD.utc[1:]]), ("a time, which is none", "remove rows without")),
        (GOOD.drop(columns="num_tracked"), ("of the columns utc, lon_deg, lat_deg: give", "error_2d_m")),
        (GOOD.assign(lon_deg=[np.nan, 139.0, 139.0]), ("has nan in lon_deg of 1 row(s)", "remove")),
        (GOOD.assign(lat_deg=139.0), ("from -90 to 90", "swapped")),
        (GOOD.assign(utc=GOOD.utc[0]), ("two rows at 2018-12-19T06:07:38", "one row an epoch")),
        (GOOD.assign(num_tracked=[8, -1, 9]), ("has -1 in num_tracked", "a number from 0 to 200")),
        (GOOD.assign(num_tracked=[8, 1e9, 9]), ("a number from 0 to 200",)),
        (GOOD.assign(num_tracked=True), ("has True in num_tracked",)),
        (GOOD.assign(error_2d_m=-0.5), ("has -0.5 in error_2d_m", "a number from 0 to inf")),
        (GOOD.assign(**{" utc": GOOD.utc}), ("two columns utc", "keep one")),
        (GOOD.assign(num_tracked="many"), ("'many'", "num_tracked")),
        (GOOD.assign(num_tracked=np.nan), ("nan in num_tracked of 3 row(s)", "remove")),
    ],
)
def test_what_is_wrong_with_a_log_is_one_sentence(table, words):
    with pytest.raises(InputError) as raised:
        read_receiver_log(table)
    said = str(raised.value)
    assert "\n" not in said
    assert [word for word in words if word not in said] == []
