"""Receivers' own logs: files that independent writers make of a table hold its rows, and real and wrong ones."""

import gzip
from contextlib import suppress
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxurban.errors import InputError
from jaxurban.receivers.log_files import read_log
from jaxurban.receivers.validation.logs import read_receiver_log, table_log
from jaxurban.receivers.validation.rinex import with_navigation
from tests.made_files import refused

KEYS = ["utc", "satellite"]
LEAP_S = 18
GPS_EPOCH = pd.Timestamp("1980-01-06", tz="UTC")
TALKERS = {"G": ("GP", 0), "R": ("GL", 64), "E": ("GA", 0), "C": ("GB", 0), "J": ("GQ", 0)}
ANDROID = {"G": (1, 0), "R": (3, 0), "E": (6, 0), "C": (5, 0), "J": (4, 192)}
UTC = pd.Timestamp("2023-06-22T23:59:58.5Z")
TABLE = pd.DataFrame(
    {
        "utc": np.repeat(UTC + pd.to_timedelta([0, 1, 2], "s"), 5),  # over midnight
        "lon_deg": np.repeat([-70.5, -70.50001, -70.50002], 5),
        "lat_deg": np.repeat([-33.25, -33.25001, -33.25003], 5),
        "satellite": ["G05", "R12", "E31", "C19", "J02"] * 3,
        "cn0_dbhz": [45.0, 0.0, 38.0, 22.0, 30.0] * 3,
        "azimuth_deg": [10.0, 355.0, 181.0, 90.0, 270.0] * 3,
        "elevation_deg": [5.0, 89.0, 45.0, 30.0, 60.0] * 3,
    }
)


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}\r\n"


def angle(degrees: float, digits: int, sides: str) -> str:
    whole, part = divmod(abs(degrees), 1.0)
    return f"{whole:0{digits}.0f}{part * 60:010.7f},{sides[int(degrees < 0)]}"


def nmea_of(table: pd.DataFrame) -> str:
    """Return a table as NMEA 4.11, by its own text: three sentences of position, then GSV by system."""
    lines = []
    for utc, rows in table.groupby("utc"):
        clock, first = f"{utc:%H%M%S}.{utc.microsecond // 1000:03d}", rows.iloc[0]
        place = f"{angle(first.lat_deg, 2, 'NS')},{angle(first.lon_deg, 3, 'EW')}"
        lines.append(sentence(f"GNRMC,{clock},A,{place},0.1,65.1,{utc:%d%m%y},,,A,V"))
        lines.append(sentence(f"GNGGA,{clock},{place},1,12,0.76,4.4,M,-30.0,M,,"))
        for letter, of_system in rows.groupby(rows.satellite.astype(str).str[0]):
            talker, offset = TALKERS[letter]
            entries = [
                f"{int(row.satellite[1:]) + offset:02d},{row.elevation_deg:02.0f},{row.azimuth_deg:03.0f},"
                + (f"{row.cn0_dbhz:02.0f}" if row.cn0_dbhz else "")
                for row in of_system.itertuples()
            ]
            parts = [entries[i : i + 4] for i in range(0, len(entries), 4)]
            for number, part in enumerate(parts, start=1):
                head = f"{talker}GSV,{len(parts)},{number},{len(entries):02d}"
                lines.append(sentence(",".join([head, *part, "1"])))
    return "".join(lines)


def gnss_logger_of(table: pd.DataFrame, version: int = 3) -> str:
    """Return a table as a GnssLogger file: what was received, and a fix some time after it."""
    names = ("LatitudeDegrees,LongitudeDegrees", "UnixTimeMillis")
    if version == 1:
        names = ("Latitude,Longitude", "(UTC)TimeInMs")
    lines = [
        f"# Version: v{version}",
        "# Raw,utcTimeMillis,TimeNanos,LeapSecond,FullBiasNanos,BiasNanos, Svid,Cn0DbHz,CarrierFrequencyHz,"
        "ConstellationType",
        f"# Fix,Provider,{names[0]},AltitudeMeters,{names[1]}",
    ]
    for number, (utc, rows) in enumerate(table.groupby("utc")):
        gps_ns, own_ns = (utc - GPS_EPOCH).value + LEAP_S * 10**9 - 120_000_000, 10**9 * number
        for row in rows[rows.cn0_dbhz > 0].itertuples():
            kind, offset = ANDROID[row.satellite[0]]
            bias_ns = own_ns - gps_ns
            number_of = int(row.satellite[1:]) + offset
            raw = f"Raw,,{own_ns},,{bias_ns},0.0,{number_of},"
            lines.append(f"{raw}{row.cn0_dbhz},1575420030,{kind}")
            lines.append(f"{raw}{row.cn0_dbhz + 9},1176450000,{kind}")  # L5 does not count
        place = f"{rows.lat_deg.iloc[0]},{rows.lon_deg.iloc[0]},50.0,{utc.value // 10**6}"
        lines += [
            f"Fix,{'gps' if version == 1 else 'GPS'},{place}",
            f"Fix,NLP,1.0,2.0,3.0,{number}",
        ]
    return "\n".join(lines) + "\n"


def written(folder: Path, text: str, name: str = "log.txt") -> Path:
    path = folder / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


def check_rows(read: pd.DataFrame | None, table: pd.DataFrame) -> None:
    """Check that a table was read as it was written, within the rounding of NMEA."""
    assert read is not None
    both = read.merge(table, on=KEYS, suffixes=("", "_written"))
    assert len(both) == len(read) == len(table)
    for name, most in {"lon_deg": 1e-8, "lat_deg": 1e-8, "cn0_dbhz": 0.5}.items():
        assert np.abs(both[name] - both[f"{name}_written"]).max() <= most
    if "azimuth_deg" in read:
        turn = (both.azimuth_deg - both.azimuth_deg_written + 180) % 360 - 180
        assert np.abs(turn).max() <= 0.5 + 1e-4
        assert np.abs(both.elevation_deg - both.elevation_deg_written).max() <= 0.5 + 1e-4


@pytest.mark.parametrize("name", ["log.txt", "log.nmea.gz"])
def test_nmea_has_the_rows_of_the_table_that_it_was_made_of(tmp_path, name):
    check_rows(read_log(written(tmp_path, nmea_of(TABLE), name)), TABLE)


@pytest.mark.parametrize("version", [1, 3])
def test_gnss_logger_has_the_received_rows_of_the_table(tmp_path, version):
    read = read_log(written(tmp_path, gnss_logger_of(TABLE, version)))
    check_rows(read, TABLE[TABLE.cn0_dbhz > 0])
    assert "azimuth_deg" not in read


def test_sentences_with_a_wrong_checksum_are_passed_over_and_counted(tmp_path):
    text = nmea_of(TABLE).replace("$GPGSV,1,1,01,05", "$GPGSV,1,1,01,06", 1)
    with pytest.warns(UserWarning, match="has 1 sentences with a wrong checksum"):
        read = read_log(written(tmp_path, "noise \x00\r\n" + text))
    assert len(read) == len(TABLE) - 1
    assert "G06" not in set(read.satellite)


def test_sentences_without_a_checksum_are_counted_and_lend_no_time(tmp_path):
    first, marker, last = nmea_of(TABLE).rpartition("$GNRMC")
    cut = last.partition("*")
    bare = first + marker + cut[0] + cut[2][2:]
    with (
        pytest.warns(UserWarning, match="has 1 sentences with a wrong checksum or none"),
        pytest.warns(UserWarning, match="has 5 of 15 measurements without a time"),
    ):
        read = read_log(written(tmp_path, bare))
    check_rows(read, TABLE[:10])


def test_a_gnss_logger_of_columns_alone_is_refused(tmp_path):
    columns = gnss_logger_of(TABLE).partition("\nRaw,")[0]
    with pytest.raises(InputError, match=r"cannot be read as a log|holds no place"):
        read_log(written(tmp_path, columns + "\n"))


def test_measurements_without_a_direction_or_a_known_number_are_counted(tmp_path):
    lines = sentence("GPGSV,1,1,03,,,,53,40,45,100,30,07,10,,20,1")
    with pytest.warns(UserWarning, match="has 3 of 18 measurements without a time, a direction"):
        check_rows(read_log(written(tmp_path, nmea_of(TABLE) + lines)), TABLE)


def test_what_is_heard_without_a_fix_is_not_put_at_the_last_place(tmp_path):
    lost = sentence("GNRMC,235999.50,V,,,,,,,220623,,,N,V")
    more = lost + sentence("GPGSV,1,1,01,05,05,010,55,1")
    with pytest.warns(UserWarning, match="has 1 of 16 measurements without a time"):
        check_rows(read_log(written(tmp_path, nmea_of(TABLE) + more)), TABLE)


def android_nmea_of(table: pd.DataFrame) -> str:
    """Return a table as GnssLogger's own .nmea: a prefix, and the phone's milliseconds behind each sentence."""
    return "".join(
        f"NMEA,{line},{1_687_478_398_500 + number}\n"
        for number, line in enumerate(nmea_of(table).splitlines())
    )


@pytest.mark.parametrize("head", ["", "# \n# Header Description:\n# \n# Version: v3.1.0.4\n# \n"])
def test_nmea_of_gnss_logger_has_the_rows_of_the_plain_one(tmp_path, head):
    check_rows(read_log(written(tmp_path, head + android_nmea_of(TABLE), "pixel.nmea")), TABLE)


def test_sentences_beside_raw_measurements_do_not_make_a_log_nmea(tmp_path):
    text = android_nmea_of(TABLE) + gnss_logger_of(TABLE)
    assert "azimuth_deg" not in read_log(written(tmp_path, text))


def rmc(clock: str, place="3315.0,S,07030.0,W", status="A", date="220623", mode=",A") -> str:
    return sentence(f"GNRMC,{clock},{status},{place},0.1,65.1,{date},,{mode}")


def quality(clock: str, kind: str, word: str) -> str:
    """Return a sentence that says with one word how good the place is."""
    place = "3315.0,S,07030.0,W"
    return {
        "GGA": sentence(f"GNGGA,{clock},{place},{word},12,0.76,4.4,M,-30.0,M,,"),
        "GNS": sentence(f"GNGNS,{clock},{place},{word},12,0.76,4.4,-30.0,,"),
        "GLL": sentence(f"GNGLL,{place},{clock},{word}"),
    }[kind]


CLOCKS = ["235958.50", "235959.50"]
GSV = sentence("GPGSV,1,1,01,05,05,010,45,1")


@pytest.mark.parametrize(
    ("kind", "word", "is_fix"),
    [
        *(("RMC", f",{mode}", mode in "ADFRP") for mode in "ADFRPNEMS"),
        *(("GGA", word, word in "123459") for word in "0123456789"),
        ("GGA", "", False),
        *(("GNS", word, is_fix) for word, is_fix in (("AN", True), ("NN", False), ("EE", False))),
        *(("GNS", word, is_fix) for word, is_fix in (("NAN", True), ("M", False), ("S", False))),
        *(
            ("GLL", word, is_fix)
            for word, is_fix in (("A,A", True), ("V,N", False), ("A,E", False))
        ),
        ("GLL", "V", False),
    ],
)
@pytest.mark.parametrize("is_before", [True, False])
@pytest.mark.filterwarnings("ignore:.*measurements without a time")
def test_a_place_that_the_receiver_calls_no_fix_is_left_out_and_counted(
    tmp_path, kind, word, is_fix, is_before
):
    good, doubtful = CLOCKS
    lines = [rmc(doubtful, mode=word)]
    if kind != "RMC":
        lines = [rmc(doubtful), quality(doubtful, kind, word)]
    if is_before:
        lines.reverse()
    path = written(tmp_path, rmc(good) + GSV + "".join(lines) + GSV)
    if is_fix:
        assert read_log(path).utc.nunique() == 2
        return
    with pytest.warns(UserWarning, match="has 1 of 2 places without a fix"):
        assert read_log(path).utc.dt.second.tolist() == [58]


@pytest.mark.parametrize(
    "lost", [{"place": "0000.0000,N,00000.0000,E"}, {"status": "V"}, {"status": "V", "mode": ",N"}]
)
@pytest.mark.filterwarnings("ignore:.*measurements without a time")
def test_a_place_at_0_0_and_one_of_status_v_are_no_places(tmp_path, lost):
    with pytest.warns(UserWarning, match="has 1 of 2 places without a fix, at 0, 0 or by"):
        read = read_log(written(tmp_path, rmc(CLOCKS[0]) + GSV + rmc(CLOCKS[1], **lost) + GSV))
    assert read.lon_deg.tolist() == [-70.5]
    with pytest.raises(InputError, match="has 2 of 2 places without a fix"):
        read_log(written(tmp_path, "".join(rmc(clock, **lost) + GSV for clock in CLOCKS)))


def test_a_place_on_the_equator_or_on_the_meridian_of_greenwich_is_one(tmp_path):
    for place in ("0000.0,N,07030.0,W", "3315.0,S,00000.0,E"):
        assert len(read_log(written(tmp_path, rmc(CLOCKS[0], place) + GSV))) == 1


def test_a_date_of_1024_weeks_ago_is_said_with_the_day_that_may_be_meant(tmp_path):
    text = rmc(CLOCKS[0], date="061103") + GSV  # 2023-06-22 less 1,024 weeks
    with pytest.warns(UserWarning, match=r"begins on 2003-11-06.*it was 2023-06-22; then give"):
        read_log(written(tmp_path, text))


@pytest.mark.filterwarnings("ignore:.*without a fix", "error:.*begins on")
def test_a_clock_that_starts_in_1980_before_the_first_fix_says_nothing_of_the_log(tmp_path):
    text = rmc(CLOCKS[0], status="V", date="060180") + rmc(CLOCKS[1]) + GSV
    assert read_log(written(tmp_path, text)).utc.dt.year.tolist() == [2023]


def test_of_several_signals_the_strongest_counts(tmp_path):
    more = sentence("GPGSV,1,1,01,05,05,010,51,6")
    read = read_log(written(tmp_path, nmea_of(TABLE) + more)).set_index(KEYS).cn0_dbhz
    assert read[TABLE.utc.iloc[-1], "G05"] == 51
    assert read[UTC, "G05"] == 45


def test_a_log_without_satellites_is_a_track_and_says_so(tmp_path):
    text = "".join(line for line in nmea_of(TABLE).splitlines(True) if "GSV" not in line)
    read = read_log(written(tmp_path, text))
    assert read.utc.tolist() == TABLE.utc.unique().tolist()
    with pytest.raises(
        InputError, match=r"3 rows of the columns utc, lon_deg, lat_deg: .*cn0_dbhz"
    ):
        table_log(read, "log")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "".join(line for line in nmea_of(TABLE).splitlines(True) if "RMC" not in line).encode(),
            "no RMC sentence with a date and a place, and GGA has no date: switch RMC on",
        ),
        (sentence("GNRMC,99,A,3725.58,N,12205.6,W,0,0,070220,,,A").encode(), "read as a log"),
        (gnss_logger_of(TABLE).replace(",Svid", ",Nr").replace(", Svid", ",Nr").encode(), "Svid"),
        (gnss_logger_of(TABLE).replace("Fix,GPS", "Fix,FLP").encode(), "holds no place: give"),
        (gnss_logger_of(TABLE)[:400].encode(), "holds no place|read as a log"),
        (b"\xb5b\x02\x15\x00" + nmea_of(TABLE).encode(), "UBX .*`convbin -r ubx "),
        (b"\x1f\x9d\x90abc", "Unix compress: unpack it with `gzip -dS .Z"),
        (b"% program   : RTKLIB ver.2.4.2\n% obs start : 2023\n", "RTKLIB: .*rnx2rtkp -u.*awk"),
        (
            b"31 CURRENT.ALM\n 682 233472\n\n1\n63\n",
            "SEM almanac: take the YUMA almanac of the same week",
        ),
        (
            b"******** Week 682 almanac for PRN-01 ********\n",
            "YUMA almanac: .* lines under 'Almanacs' in docs/guides/formats.md",
        ),
        (b"     3.03           OBSERVATION DATA    M\n", "read as a log"),
        (b"3.0                 COMPACT RINEX FORMAT\n\xff\x00", "read as a log"),
        (gzip.compress(nmea_of(TABLE).encode())[:-20], "read as a log|damaged"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*has .* measurements without")
def test_what_is_wrong_with_a_log_is_one_sentence(tmp_path, content, message):
    refused(read_log, tmp_path / "log", content, message)


def test_other_files_are_no_logs(tmp_path):
    assert read_log(written(tmp_path, "utc,lon_deg\n", "table.csv")) is None
    assert read_log(written(tmp_path, '{"type": "FeatureCollection"}', "route.geojson")) is None


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("made", [nmea_of, gnss_logger_of])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_damaged_logs_are_read_or_refused(tmp_path, made, seed):
    data, rng = bytearray(made(TABLE).encode()), np.random.default_rng(seed)
    for place in rng.integers(len(data), size=30):
        data[place] = rng.integers(256)
    text = data[: rng.integers(1, len(data))].decode("latin-1")
    with suppress(InputError):
        read_log(written(tmp_path, text))


@pytest.mark.slow
@pytest.mark.data
def test_a_real_log_has_the_same_rows_in_every_format(data_dir, tmp_path):
    table = pd.read_csv(data_dir / "tokyo/tokyo_nihonbashi_2023-06-22_satellites.csv.gz")
    table["utc"] = pd.to_datetime(table.utc)
    check_rows(read_log(written(tmp_path, nmea_of(table))), table)
    heard = table[table.cn0_dbhz > 0]
    read = read_log(written(tmp_path, gnss_logger_of(table)))
    check_rows(read, heard)
    rows = with_navigation(read, data_dir / "tokyo/nihonbashi-rinex/rover.nav", "log").satellites
    expected = read_receiver_log(table).satellites
    both = rows.merge(expected, "outer", ["epoch", "satellite"], indicator="of")
    alone = both[both.of != "both"]
    assert len(rows) == 11_234
    assert alone.satellite.tolist() == ["E09"]  # no message then
    assert (both.cn0_dbhz_x == both.cn0_dbhz_y)[both.of == "both"].all()
