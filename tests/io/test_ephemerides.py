"""Broadcast RINEX and SP3 as orbits: against closed forms, between their nodes, and in the sky of maps."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from skyfield.api import load
from skyfield.framelib import itrs

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.orbits import look_angles, middle_epoch, read_orbits
from jaxurban.maps.build import view_sky
from jaxurban.world.grid import Grid
from tests.guess_records import by_name
from tests.io.test_orbits import TLE
from tests.made_files import refused
from tests.receivers.test_rinex import (
    ANOMALY,
    ECCENTRICITY,
    INCLINATION,
    NAV,
    NODE,
    PERIGEE,
    SEMI_AXIS_ROOT,
    TOE_S,
    UNDER_LAT_DEG,
    UNDER_LON_DEG,
    WEEK,
    header,
    message,
    orbit_m,
)

TIMESCALE = load.timescale(builtin=True)
GPS_START = pd.Timestamp("1980-01-06T00:00:00Z")
LEAP_S = 18
MIDDLE_S = 345_600.0  # of the week: 2023-06-22T00:00:00 of GPS time


def utc_of(tow_s: float) -> pd.Timestamp:
    return GPS_START + pd.Timedelta(days=7 * WEEK, seconds=tow_s - LEAP_S)


def places_m(satellite, tows_s) -> np.ndarray:
    """Return places in the frame that turns with Earth."""
    times = TIMESCALE.from_datetimes([utc_of(tow_s).to_pydatetime() for tow_s in tows_s])
    return satellite.at(times).frame_xyz(itrs).m.T


def yuma_of(number: int) -> str:
    """Return the made orbit as a YUMA almanac."""
    fields = {
        "ID": f"{number:02d}",
        "Health": "000",
        "Eccentricity": ECCENTRICITY,
        "Time of Applicability(s)": TOE_S,
        "Orbital Inclination(rad)": INCLINATION,
        "Rate of Right Ascen(r/s)": -8e-9,
        "SQRT(A)  (m 1/2)": SEMI_AXIS_ROOT,
        "Right Ascen at Week(rad)": NODE,
        "Argument of Perigee(rad)": PERIGEE,
        "Mean Anom(rad)": ANOMALY,
        "Af0(s)": 1e-4,
        "Af1(s/s)": 0.0,
        "week": WEEK,
    }
    head = f"******** Week {WEEK % 1024} almanac for PRN-{number:02d} ********\r\n"
    return head + "".join(f"{name + ':':<27} {value}\r\n" for name, value in fields.items())


def written(folder, text, name="orbits"):
    (folder / name).write_bytes(text.encode("latin-1"))
    return folder / name


def sp3_of(tows_s, names=("G05", "R07"), scale="GPS") -> str:
    """Return the made orbit as SP3, 1.5 times as far out for the second satellite."""
    lines = [
        f"#cP2023  6 22  0  0  0.00000000 {len(tows_s):7d} ORBIT IGS14 HLM  IGS",
        f"## {WEEK} {tows_s[0]:15.8f} {tows_s[1] - tows_s[0]:14.8f} 60117 0.0000000000000",
        f"+   {len(names):2d}   {''.join(names)}" + "  0" * (17 - len(names)),
        "++       " + "  2" * 17,
        f"%c M  cc {scale} ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%f  1.2500000  1.025000000  0.00000000000  0.000000000000000",
        "%i    0    0    0    0      0      0      0      0         0",
    ]
    for tow_s in tows_s:
        time = GPS_START + pd.Timedelta(days=7 * WEEK, seconds=tow_s)
        lines.append(f"*  {time:%Y %m %d %H %M %S}.00000000")
        for factor, name in zip((1.0, 1.5), names, strict=True):
            place_km = "".join(f"{value / 1000 * factor:14.6f}" for value in orbit_m(tow_s))
            lines.append(f"P{name}{place_km}{0.1:14.6f}")
    return "\n".join([*lines, "EOF"]) + "\n"


TOWS_S = np.arange(0, 7 * 3600, 900.0) + MIDDLE_S - 3 * 3600
LINES = message("G05").splitlines()
NAV_2 = header("     2.11           N: GPS NAV DATA") + "\n".join(
    [" 5 23  6 22  1  0  0.0" + LINES[0][23:], *(line[1:] for line in LINES[1:]), ""]
)
NAV_4 = NAV.replace("3.03", "4.00").replace("G05 2023", "> EPH G05 LNAV\nG05 2023")
NAV_4 = NAV_4.replace("G07 2023", "> EPH G07 LNAV\nG07 2023")


@pytest.mark.parametrize("text", [NAV_2, NAV, NAV_4])
def test_broadcast_orbits_of_every_version_follow_the_closed_form(tmp_path, text):
    orbits = read_orbits(written(tmp_path, text))
    tows_s = TOE_S + np.array([-7000.0, 0.0, 1.5, 7000.0])
    expected = np.array([orbit_m(tow_s) for tow_s in tows_s])
    np.testing.assert_allclose(places_m(orbits.satellites[0], tows_s), expected, atol=0.1)
    assert middle_epoch(orbits) == "2023-06-22T01:00:00Z"  # 00:59:42, to the minute


def test_sp3_is_right_between_its_nodes_where_every_second_is_left_out(tmp_path):
    """30 minutes apart, and as good one step beyond the last node."""
    orbits = read_orbits(written(tmp_path, sp3_of(TOWS_S[::2])))
    for factor, satellite in zip((1.0, 1.5), orbits.satellites, strict=True):
        between = TOWS_S[1:-1:2]
        expected = factor * np.array([orbit_m(tow_s) for tow_s in between])
        assert np.linalg.norm(places_m(satellite, between) - expected, axis=1).max() < 10.0


@pytest.mark.data
@pytest.mark.parametrize("name", ["igs15904.sp3", "grg21553.sp3"])
def test_real_sp3_is_right_between_its_nodes_where_every_second_is_left_out(
    data_dir, tmp_path, name
):
    file = data_dir.parent / "formats/given/gnss" / name
    if not file.exists():
        pytest.skip("the file is not there")
    head, *epochs = re.split(r"(?m)^(?=\*)", file.read_text())
    epochs[-1] = epochs[-1].replace("EOF\n", "")
    half = read_orbits(written(tmp_path, "".join([head, *epochs[::2], "EOF\n"])))
    num = 0
    times = [pd.Timestamp(*map(int, each.split()[1:6])) for each in epochs[1:-1:2]]
    gps = TIMESCALE.from_datetimes([time.tz_localize("UTC").to_pydatetime() for time in times])
    leap_s = {"igs15904.sp3": 15, "grg21553.sp3": 18}[name]
    gps = TIMESCALE.tt_jd(gps.tt - leap_s / 86_400)
    for satellite in half.satellites:
        found = satellite.at(gps).frame_xyz(itrs).m.T
        for place_m, epoch in zip(found, epochs[1:-1:2], strict=True):
            row = re.search(rf"^P{satellite.name}(.{{14}})(.{{14}})(.{{14}})", epoch, re.MULTILINE)
            if row and float(row[1]):
                assert np.linalg.norm(place_m - 1000 * np.array(row.groups(), float)) < 10.0
                num += 1
    assert num > 1000


@pytest.mark.parametrize("kind", ["broadcast", "sp3"])
def test_orbits_of_every_kind_give_the_sky_of_maps(tmp_path, kind):
    text = {"broadcast": NAV, "sp3": sp3_of(TOWS_S, ("G05", "G07"))}[kind]
    grid = Grid.from_bounds(
        (UNDER_LON_DEG - 0.01, UNDER_LAT_DEG - 0.01, UNDER_LON_DEG + 0.01, UNDER_LAT_DEG + 0.01),
        50.0,
        "EPSG:32616",
    )
    gps = ju.Gps(orbits=written(tmp_path, text), times=str(utc_of(349_740.0)), mask_deg=10.0)
    sky = view_sky(grid, gps)
    assert (sky.names[0], sky.systems[0]) == ("G05", "gps")
    assert np.degrees(sky.elevation_rad[0, 0]) > 89.0
    lost = by_name(sky.guesses).get("satellites without a place", "")
    assert ("call the satellite unhealthy: G07" in lost) == (kind == "broadcast")


@pytest.mark.parametrize("text", [NAV, sp3_of(TOWS_S)])
def test_a_time_of_which_the_file_says_nothing_is_refused_with_its_span(tmp_path, text):
    orbits = read_orbits(written(tmp_path, text))
    with pytest.raises(InputError, match=r"nothing of 2023-06-23T.*, only of 2023-06-2\dT.* to "):
        look_angles(orbits, [utc_of(TOE_S + 86_400)], UNDER_LON_DEG, UNDER_LAT_DEG)


def test_a_constellation_comes_from_one_source(tmp_path):
    nav = written(tmp_path, NAV, "a.nav")
    for other in (written(tmp_path, TLE, "a.tle"), "nominal"):
        with pytest.raises(
            InputError, match=r"holds gps, and so does .*: leave one of the two out"
        ):
            read_orbits([nav, other])
    galileo = written(tmp_path, TLE.replace("GPS BIIA-10 (PRN 32)", "GSAT0201 (GALILEO 5)"), "e")
    assert len(read_orbits([nav, galileo]).satellites) == 3


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (NAV[:-100].encode("latin-1"), "ends within a line, so it was cut.: give a TLE"),
        (sp3_of(TOWS_S, scale="UTC").encode(), "counts in UTC, and only GPS time is read"),
        (sp3_of(TOWS_S)[:200].encode(), "cannot be read as whole element sets"),
    ],
)
def test_damaged_orbits_are_one_sentence(tmp_path, content, sentence):
    refused(read_orbits, tmp_path / "orbits", content, sentence)


@pytest.mark.parametrize("text", [NAV, sp3_of(TOWS_S)])
def test_without_sidereon_the_extra_is_named(tmp_path, monkeypatch, text):
    monkeypatch.setitem(sys.modules, "sidereon", None)
    with pytest.raises(InputError, match=re.escape("pip install 'jaxurban[receiver]'")):
        read_orbits(written(tmp_path, text))


def test_the_lines_of_the_page_on_formats_make_element_sets_of_an_almanac(tmp_path, monkeypatch):
    page = Path(ju.__file__).parents[1] / "docs/guides/formats.md"
    (lines,) = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    written(tmp_path, yuma_of(5) + "\r\n" + yuma_of(6).replace(" 000", " 063"), "current.alm")
    with pytest.raises(InputError, match="a YUMA almanac: make element sets of it with the lines"):
        read_orbits("current.alm")
    exec(lines, {})
    (satellite,) = read_orbits("gps.csv").satellites  # the other one is unhealthy
    assert satellite.name == "GPS (PRN 05)"
    for days, most_deg in ((0.0, 0.1), (0.3, 0.1), (1.0, 0.1), (3.5, 0.3), (7.0, 0.3)):
        tow_s = TOE_S + 86_400 * days
        x, y, z = orbit_m(tow_s)
        angle = -8e-9 * 86_400 * days  # of the node, which the closed form keeps
        x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
        away_m = np.linalg.norm(places_m(satellite, [tow_s])[0] - [x, y, z])
        assert np.degrees(away_m / 20_200e3) < most_deg
