"""RINEX logs: a made orbit against its closed form, a real drive against RTKLIB's table, and files that are wrong."""

import math
import re
import sys

import numpy as np
import pandas as pd
import pytest
from pyproj import Transformer

from jaxurban.errors import InputError
from jaxurban.io.orbits import read_orbits
from jaxurban.receivers.log_files import read_log, read_reference
from jaxurban.receivers.validation.logs import ReceiverLog, read_receiver_log
from jaxurban.receivers.validation.rinex import angles_along, with_navigation

WEEK, TOW_S, LEAP_S = 2267, 349_740.0, 18  # 2023-06-22T01:09:00 of GPS time
UTC = pd.Timestamp("2023-06-22T01:08:42Z")
ECEF = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
SEMI_AXIS_ROOT, ECCENTRICITY, INCLINATION, NODE, PERIGEE, ANOMALY, TOE_S = (
    5153.7,
    0.01,
    0.96,
    -2.1,
    0.7,
    0.4,
    349_200.0,
)


def orbit_m(tow_s: float) -> np.ndarray:
    """Return where the made satellite is in the frame that turns with Earth (IS-GPS-200, table 20-IV)."""
    axis_m, since_s = SEMI_AXIS_ROOT**2, tow_s - TOE_S
    mean = eccentric = ANOMALY + math.sqrt(3.986005e14 / axis_m**3) * since_s
    for _ in range(20):
        eccentric = mean + ECCENTRICITY * math.sin(eccentric)
    true = 2 * math.atan(
        math.sqrt((1 + ECCENTRICITY) / (1 - ECCENTRICITY)) * math.tan(eccentric / 2)
    )
    argument, radius_m = true + PERIGEE, axis_m * (1 - ECCENTRICITY * math.cos(eccentric))
    node = NODE - 7.2921151467e-5 * tow_s
    x, y = radius_m * math.cos(argument), radius_m * math.sin(argument)
    across = y * math.cos(INCLINATION)
    return np.array(
        [
            x * math.cos(node) - across * math.sin(node),
            x * math.sin(node) + across * math.cos(node),
            y * math.sin(INCLINATION),
        ]
    )


def angles_deg(
    lon_deg: float, lat_deg: float, place_m: np.ndarray, satellite_m: np.ndarray
) -> tuple[float, float]:
    """Return azimuth and elevation by the plane that touches the ellipsoid at a place."""
    lon, lat = math.radians(lon_deg), math.radians(lat_deg)
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    sight = (satellite_m - place_m) / np.linalg.norm(satellite_m - place_m)
    azimuth = math.atan2(sight @ east, sight @ np.cross(up, east))
    return math.degrees(azimuth) % 360, math.degrees(math.asin(sight @ up))


def message(name: str, health: float = 0.0) -> str:
    rows = (
        [1.0, 0.0, 0.0, ANOMALY],
        [0.0, ECCENTRICITY, 0.0, SEMI_AXIS_ROOT],
        [TOE_S, 0.0, NODE, 0.0],
        [INCLINATION, 0.0, PERIGEE, 0.0],
        [0.0, 1.0, WEEK, 0.0],
        [2.0, health, 0.0, 1.0],
        [TOE_S - 600.0, 4.0],
    )
    lines = ["    " + "".join(f"{value:19.12E}" for value in row) for row in rows]
    return "\n".join([f"{name} 2023 06 22 01 00 00" + f"{0:19.12E}" * 3, *lines]) + "\n"


def header(begin: str, *lines: str) -> str:
    labelled = [
        (begin, "RINEX VERSION / TYPE"),
        *(line.split("|") for line in lines),
        ("", "END OF HEADER"),
    ]
    return "".join(f"{value:<60}{label:<20}\n" for value, label in labelled)


NAV_BEGIN = "     3.03           N: GNSS NAV DATA    M: Mixed"
OBS_BEGIN = "     3.03           OBSERVATION DATA    M: Mixed"
LEAP_LINE = f"{LEAP_S:6d}|LEAP SECONDS"
NAV = header(NAV_BEGIN, "log: \\\xff|COMMENT", LEAP_LINE) + message("G05") + message("G07", 63.0)
CODES = (
    "G    2 C1C S1C|SYS / # / OBS TYPES",
    "E    2 C1C S1C|SYS / # / OBS TYPES",
    "I    1 S5A|SYS / # / OBS TYPES",
)
FIRST = "  2023    06    22    01    09    0.0060000     GPS|TIME OF FIRST OBS"
RANGE_M = f"{2.1e7:14.3f}  "
OBS = header(OBS_BEGIN, *CODES, FIRST) + "".join(
    [
        "> 2023 06 22 01 09  0.0060000  0  4\n",
        f"G05{RANGE_M}{45.0:14.3f}\nG07{RANGE_M}{41.0:14.3f}\nE11{RANGE_M}{38.0:14.3f}\nI02{30.0:14.3f}\n",
        "> 2023 06 22 01 09  1.0060000  0  1\n",
        f"G05{RANGE_M}\n",
    ]
)
UNDER_LON_DEG, UNDER_LAT_DEG, _ = ECEF.transform(*orbit_m(TOW_S), direction="INVERSE")
LON_DEG, LAT_DEG, HEIGHT_M = UNDER_LON_DEG + 20.0, UNDER_LAT_DEG - 10.0, 40.0
TRACK = pd.DataFrame(
    {
        "GPS TOW (s)": [TOW_S, TOW_S + 1, TOW_S + 2],
        " GPS Week": WEEK,
        "Latitude (deg)": LAT_DEG,
        "Longitude (deg)": [LON_DEG, LON_DEG + 1e-5, LON_DEG],
        "Ellipsoid Height (m)": HEIGHT_M,
    }
)
PLAIN = pd.DataFrame(
    {
        "utc": [UTC, UTC + pd.Timedelta(seconds=1)],
        "lon": LON_DEG,
        "lat": LAT_DEG,
        "height_m": HEIGHT_M,
    }
)


def read_rinex(observations, navigation, reference) -> ReceiverLog:
    table = read_log(observations, reference)
    assert table is not None
    return with_navigation(table, navigation, str(observations))


@pytest.fixture
def files(tmp_path):
    """Return the made observations and navigation messages."""
    paths = tmp_path / "made.obs", tmp_path / "made.nav"
    for path, text in zip(paths, (OBS, NAV), strict=True):
        path.write_bytes(text.encode("latin-1"))
    return paths


def test_a_satellite_stands_where_the_closed_form_of_its_orbit_puts_it(files):
    place_m = np.array(ECEF.transform(LON_DEG, LAT_DEG, HEIGHT_M))
    log = read_rinex(*files, TRACK)
    assert log.epochs.utc.tolist() == [UTC, UTC + pd.Timedelta(seconds=1)]
    assert log.satellites.satellite.tolist() == ["G05", "G05"]
    assert log.satellites.cn0_dbhz.tolist() == [45.0, 0.0]
    for epoch, row in log.satellites.iterrows():
        expected = angles_deg(LON_DEG, LAT_DEG, place_m, orbit_m(TOW_S + epoch))
        assert (row.azimuth_deg, row.elevation_deg) == pytest.approx(
            expected, abs=2e-3
        )  # the light's time is 1e-3
    track = read_reference(PLAIN.assign(utc=PLAIN.utc + pd.Timedelta(hours=1)))
    later = angles_along(read_orbits(files[1]), track)
    expected = angles_deg(LON_DEG, LAT_DEG, place_m, orbit_m(TOW_S + 3600))
    assert (later.azimuth_deg[0], later.elevation_deg[0]) == pytest.approx(expected, abs=2e-3)


def test_satellites_that_are_unhealthy_or_have_no_message_are_named(files):
    assert dict(read_rinex(*files, TRACK).left_out) == {
        "E11": "no navigation message of the time",
        "G07": "unhealthy by its navigation message (health 63)",
    }


def test_a_reference_may_say_utc_or_weeks_in_a_table_or_a_file(files, tmp_path):
    TRACK.to_csv(tmp_path / "track.csv.gz", index=False)
    logs = [
        read_rinex(*files, reference) for reference in (TRACK, PLAIN, tmp_path / "track.csv.gz")
    ]
    for log in logs[1:]:
        pd.testing.assert_frame_equal(log.satellites, logs[0].satellites)
        assert log.epochs.utc.tolist() == logs[0].epochs.utc.tolist()


CUT = "cannot be read as (a log|whole element sets) .it ends within a line, so it was cut.: (convert|give)"


@pytest.mark.parametrize(
    ("obs", "nav", "track", "sentence"),
    [
        (OBS, OBS, TRACK, "orbits file .* holds no element set: give .* broadcast RINEX"),
        (OBS, "", TRACK, "holds no element set"),
        (OBS[: OBS.index("E11")], NAV, TRACK, "log .* cannot be read as a log .*truncated"),
        (
            OBS,
            NAV[: NAV.rindex("\n", 0, -1) + 1],
            TRACK,
            "orbits file .* cannot be read as whole element sets .*truncated",
        ),
        (OBS[:-9], NAV, TRACK, CUT),
        (OBS, NAV[:-100], TRACK, CUT),
        (OBS[:81], NAV, TRACK, "cannot be read as a log .*END OF HEADER"),
        (OBS[: OBS.index(">")], NAV, TRACK, "holds no observation"),
        (OBS, NAV[: NAV.index("G05")], TRACK, "element set"),
        (OBS.replace("    GPS", "    BDT"), NAV, TRACK, "counts in BDT, and only GPS time is read"),
        (
            OBS,
            NAV,
            TRACK.assign(**{"GPS TOW (s)": TOW_S + 3600}),
            r"begins at 2023-06-22 01:08:42\.006.* its places at .*02:08:42.* no epoch is in common within 0\.02 s",
        ),
        (
            OBS,
            NAV,
            TRACK.drop(columns=" GPS Week"),
            "of the columns gps_tow_s, lat_deg, .*: give utc, or gps_week and gps_tow_s",
        ),
        (
            OBS,
            NAV,
            TRACK.drop(columns="Ellipsoid Height (m)"),
            "rows of the columns .*give .* height_m .above the ellipsoid",
        ),
        (OBS, NAV, TRACK.iloc[:0], "has 0 rows of the columns"),
        (
            OBS,
            NAV,
            TRACK.assign(**{" GPS Week": WEEK - 2048}),
            "has 219 in gps_week of 3 row.*from 1024",
        ),
        (
            OBS,
            NAV,
            TRACK.assign(**{"Latitude (deg)": np.nan}),
            "reference track has nan in lat_deg",
        ),
        (OBS, NAV, None, "holds no place: give a table of the antenna's as the reference"),
    ],
)
def test_what_is_wrong_with_rinex_files_is_one_sentence(tmp_path, obs, nav, track, sentence):
    paths = tmp_path / "a.obs", tmp_path / "a.nav"
    for path, text in zip(paths, (obs, nav), strict=True):
        path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=sentence) as raised:
        read_rinex(*paths, track)
    assert "\n" not in str(raised.value)


def test_without_sidereon_the_extra_is_named(files, monkeypatch):
    monkeypatch.setitem(sys.modules, "sidereon", None)
    with pytest.raises(InputError, match=re.escape("pip install 'jaxurban[receiver]'")):
        read_rinex(*files, TRACK)


@pytest.mark.data
def test_a_real_log_has_the_rows_angles_and_strengths_of_rtklibs_table(data_dir):
    folder = data_dir / "tokyo/nihonbashi-rinex"
    log = read_rinex(folder / "rover.obs", folder / "rover.nav", folder / "reference.csv")
    table = read_receiver_log(data_dir / "tokyo/tokyo_nihonbashi_2023-06-22_satellites.csv.gz")
    assert log.epochs.utc.tolist() == table.epochs.utc.tolist()
    assert np.abs(log.epochs.lon_deg - table.epochs.lon_deg).max() < 1e-7
    both = log.satellites.merge(
        table.satellites, "outer", ["epoch", "satellite"], suffixes=("", "_table"), indicator="of"
    )
    alone = both[both.of != "both"]
    assert alone[["satellite", "of", "cn0_dbhz_table"]].values.tolist() == [
        ["E09", "right_only", 0.0]
    ]  # no message then
    both = both[both.of == "both"]
    assert len(both) == 11_234
    assert set(both.satellite.str[0]) == set("GRECJ")
    turn_deg = (both.azimuth_deg - both.azimuth_deg_table + 180) % 360 - 180
    assert turn_deg.abs().max() < 0.009  # the table has two decimals, and no light's time
    assert (both.elevation_deg - both.elevation_deg_table).abs().max() < 0.006
    assert (both.cn0_dbhz == both.cn0_dbhz_table).all()
    assert log.left_out["E18"] == "unhealthy by its navigation message (health 130)"
    assert set(log.left_out) == {"C20", "C38", "C44", "C61", "E03", "E18", "G09", "R06", "R12"}
