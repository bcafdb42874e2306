"""Orbits: against Skyfield and the published constellation, several systems, and damaged files."""

import csv
import json
import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas as pd
import pytest
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_omm, export_tle
from skyfield.api import EarthSatellite, load, wgs84
from skyfield.framelib import itrs

import jaxurban as ju
from benchmarks.make_samples import GALILEO
from jaxurban.errors import InputError, StaleElementsWarning
from jaxurban.io.nominal import GPS, nominal_satellites
from jaxurban.io.orbits import NO_SATELLITE, look_angles, matching, middle_epoch, read_orbits
from jaxurban.settings import parse_time
from jaxurban.world.sky import Sky
from tests.made_files import refused

LON_DEG, LAT_DEG = -74.0, 40.715
TIMESCALE = load.timescale(builtin=True)
NAME = "GPS BIIA-10 (PRN 32)"
# Of no real satellite, as CelesTrak writes them: line 1 then line 2.
TLE = f"""{NAME}
1 20959U 90103A   12342.96616720  .00000000  00000-0  00000-0 0  8008
2 20959  55.0000 230.0000 0120000 333.0000  26.0000  2.00550000161372
"""
TIME = "2012-12-08T00:00:00Z"


def sky_of(source, *times, **options):
    return look_angles(read_orbits(source), times or [TIME], LON_DEG, LAT_DEG, **options)


def written(tmp_path, text, name="orbits.txt"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def assert_as_skyfields(sky, satellites, time):
    """Check azimuth and elevation against Skyfield's, to a millidegree."""
    at, point = TIMESCALE.from_datetime(parse_time(time)), wgs84.latlon(LAT_DEG, LON_DEG)
    found = [(satellite - point).at(at).altaz() for satellite in satellites]
    expected = np.array([[azimuth.degrees, altitude.degrees] for altitude, azimuth, _ in found])
    angles_rad = np.stack([sky.azimuth_rad[0], sky.elevation_rad[0]], axis=1)
    np.testing.assert_allclose(np.degrees(angles_rad), expected, atol=1e-3)


@pytest.mark.data
@pytest.mark.parametrize(
    ("day", "count", "time"),
    [
        ("2012-12-07", 32, "2012-12-07T05:30:00Z"),
        ("2020-04-27", 31, "2020-04-27T16:00:00Z"),
        ("2026-08-07", 32, "2026-08-07T23:59:59.5+02:00"),
    ],
)
def test_look_angles_from_tle_equal_skyfields_to_a_millidegree(data_dir, day, count, time):
    path = data_dir / "gps" / f"gps-ops_{day}.tle"
    lines = [line.rstrip() for line in path.read_text().splitlines()]
    sky = sky_of(path, time)
    assert (len(sky.names), set(sky.systems)) == (count, {"gps"})
    assert_as_skyfields(
        sky, [EarthSatellite(*lines[i + 1 : i + 3]) for i in range(0, len(lines), 3)], time
    )


@pytest.mark.data
def test_omm_csv_and_json_give_the_same_sky(data_dir, tmp_path):
    path, time = data_dir / "gps" / "gps-ops_2024-03-31_omm.csv", "2024-03-31T16:00:00Z"
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    numbers = pd.read_csv(path).to_json(orient="records")
    for file in (
        path,
        written(tmp_path, json.dumps(rows), "text.json"),
        written(tmp_path, numbers, "numbers.json"),
    ):
        sky = sky_of(file, time)
        assert len(sky.names) == 31
        assert_as_skyfields(sky, [EarthSatellite.from_omm(TIMESCALE, row) for row in rows], time)


def test_name_lines_are_optional_and_blank_lines_ignored(tmp_path):
    name, first, second = TLE.splitlines()
    bare = sky_of(written(tmp_path, f"{first}\n{second}", "bare"))
    zero = sky_of(written(tmp_path, f"\n0 {name}\r\n{first}\r\n{second}\r\n\n", "zero"))
    assert (bare.names, zero.names) == (("catalogue number 20959",), (NAME,))
    np.testing.assert_array_equal(bare.elevation_rad, zero.elevation_rad)
    assert bare.systems == ("unknown",)


def test_azimuth_counts_from_grid_north():
    true, grid = (
        sky_of("nominal", convergence_rad=angle_rad).azimuth_rad for angle_rad in (0.0, 0.01)
    )
    np.testing.assert_allclose((true - grid) % math.tau, 0.01, atol=1e-12)


@pytest.mark.parametrize(
    "text", ["2020-04-27T16:00:00Z", "2020-04-27T16:00:00", "2020-04-27T12:00:00-04:00"]
)
def test_times_are_utc_unless_they_carry_an_offset(text):
    assert sky_of("nominal", text).times == ("2020-04-27T16:00:00Z",)


def test_elements_warn_after_14_days_and_are_refused_after_max_age(tmp_path):
    source = written(tmp_path, TLE)
    sky = sky_of(source, "2012-12-20T00:00:00Z")  # without a warning
    np.testing.assert_allclose(sky.element_age_days, 12.0338, atol=1e-4)
    for time in ("2012-12-22T00:00:00Z", "2012-11-22T00:00:00Z"):
        with pytest.warns(StaleElementsWarning, match="14 days away|16 days away"):
            sky_of(source, time)
    for time, limit in (("2013-12-07T00:00:00Z", 90.0), ("2012-12-14T00:00:00Z", 5.0)):
        with pytest.raises(
            InputError, match=r"PRN 32.* days away from .* more than max_age_days = .*nominal"
        ):
            sky_of(source, TIME, time, max_age_days=limit)


def test_nominal_elements_of_a_file_that_are_too_old_are_not_answered_with_nominal_ones():
    with pytest.raises(InputError, match=r"\(nominal\) .* name a file of elements") as refused:
        ju.sky(ju.sample_city("lower-manhattan"), (-74.01, 40.71), 60.0, time="2026-12-01")
    assert 'orbits = "nominal"' not in str(refused.value)


def earth_fixed(time, constellation=GPS):
    """Radius (km, [S]) and unit vectors ([S, 3], fixed to the Earth) of the nominal satellites."""
    satellites = nominal_satellites(time.date(), TIMESCALE, constellation)
    return places_of(satellites, TIMESCALE.from_datetime(time))


def places_of(satellites, at):
    vectors = np.array([s.at(at).frame_xyz(itrs).km for s in satellites])
    radius = np.linalg.norm(vectors, axis=1)
    return radius, vectors / radius[:, None]


def separation_deg(a, b):
    return np.degrees(2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2))


def on_circles(node_deg, latitude_deg, tilt_deg, earth_deg):
    """Unit vectors ([S, 3], fixed to the Earth) on circular orbits, when the Earth has turned by an angle."""
    node, latitude, tilt, earth = map(np.radians, (node_deg, latitude_deg, tilt_deg, earth_deg))
    lon = node - earth + np.arctan2(np.cos(tilt) * np.sin(latitude), np.cos(latitude))
    lat = np.arcsin(np.sin(tilt) * np.sin(latitude))
    return np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


EPOCH = datetime(1993, 7, 1, tzinfo=UTC)


def test_the_nominal_constellation_stands_as_published_at_its_epoch():
    greenwich_deg = 15 * (18 + 36 / 60 + 14.4 / 3600)  # Table 3-1 of the standard
    radius, found = earth_fixed(EPOCH)
    np.testing.assert_allclose(radius, 26559.7, atol=10)  # km; the standard allows 17
    # SGP4 adds the pull of Moon and Sun.
    assert (
        separation_deg(
            found, on_circles(*np.transpose(list(GPS.slots.values())), 55, greenwich_deg)
        ).max()
        < 0.1
    )


# Slots that the European GNSS Service Centre lists at 2016-11-21 00:00 UTC: node, argument of latitude; degrees.
GALILEO_SLOTS = {"A02": (317.632, 225.153), "A05": (317.632, 0.153), "C07": (197.632, 120.153)}


@pytest.mark.parametrize("days", [0, 758.125, 3650])  # from the table's date, by its rates
def test_nominal_galileo_stands_as_published(days):
    time = datetime(2016, 11, 21, tzinfo=UTC) + timedelta(days=days)
    earth_deg = 360 * (
        0.7790572732640 + 1.00273781191135448 * (TIMESCALE.from_datetime(time).ut1 - 2451545.0)
    )  # IERS
    published = (
        np.array(list(GALILEO_SLOTS.values())) + np.array([-0.02764398, 613.72253566]) * days
    )
    radius, found = earth_fixed(time, GALILEO)
    slots = [list(GALILEO.slots).index(name) for name in GALILEO_SLOTS]
    np.testing.assert_allclose(radius, 29_600.318, atol=17)
    assert separation_deg(found[slots], on_circles(*published.T, 56, earth_deg)).max() < 0.15


@pytest.mark.parametrize("num_turns", [1, 10_000, 25_000])
def test_the_nominal_ground_track_repeats_for_decades(num_turns):
    # Twice round the Earth; UT1 stays within 6 s of UTC until then: 0.03 degrees.
    later = EPOCH + timedelta(days=num_turns * 720 / GPS.latitude_rate_deg)
    (_, before), (radius, after) = earth_fixed(EPOCH), earth_fixed(later)
    np.testing.assert_allclose(radius, 26559.7, atol=17)
    assert separation_deg(before, after).max() < 0.2


@pytest.mark.data
def test_real_galileo_satellites_stand_in_the_nominal_slots(data_dir):
    at = TIMESCALE.from_datetime(datetime(2018, 12, 19, 3, tzinfo=UTC))
    _, real = places_of(read_orbits(data_dir / "tokyo" / "galileo_2018-12-19.tle").satellites, at)
    _, slots = earth_fixed(at.utc_datetime(), GALILEO)
    apart_deg = separation_deg(real[:, None], slots).min(axis=1)
    assert np.sort(apart_deg)[-2] < 2  # all but the one that was never put into a slot


def test_the_nominal_constellation_never_grows_old_and_moves_smoothly_over_midnight():
    sky = sky_of(
        "nominal",
        *(datetime(2051, 3, 1, tzinfo=UTC) + timedelta(seconds=s) for s in (-2, -1, 0, 1)),
    )
    assert np.all(sky.element_age_days == 0)
    assert sky.systems == ("gps",) * 24
    before, over, after = np.degrees(np.diff(sky.elevation_rad, axis=0))
    np.testing.assert_allclose(over, (before + after) / 2, atol=0.01)


def omm(kind, epoch, **fields):
    """The message of the satellite as CelesTrak writes it, as CSV or, all text, as JSON."""
    satellite = Satrec.twoline2rv(*TLE.splitlines()[1:])
    row = (
        pd.Series(export_omm(satellite, NAME) | {"EPOCH": epoch} | fields).astype(str).to_frame().T
    )
    return row.to_csv(index=False) if kind == "csv" else row.to_json(orient="records")


NOON, OF_OTHERS, AT_THREE = "2024-03-31T12:00:00", ("GPS", "TAI"), "2024-03-31T03:00:00"


@pytest.mark.parametrize("kind", ["csv", "json"])
@pytest.mark.parametrize(
    "epoch", [f"{NOON}+09:00", f"{AT_THREE}Z", AT_THREE, "2024-03-30T22:00:00.0-05:00"]
)
def test_the_epoch_of_an_omm_may_bear_an_offset(tmp_path, kind, epoch):
    orbits = read_orbits(written(tmp_path, omm(kind, epoch, TIME_SYSTEM="utc")))
    read = orbits.satellites[0].epoch.utc_datetime()
    assert abs(read - datetime(2024, 3, 31, 3, tzinfo=UTC)) < timedelta(milliseconds=1)
    assert middle_epoch(orbits) == "2024-03-31T03:00:00Z"


def test_names_of_satellites_steer_no_terminal(tmp_path):
    for kind in ("csv", "json"):
        read = read_orbits(written(tmp_path, omm(kind, NOON, OBJECT_NAME="GPS \x1b[31mred\x07")))
        assert read.satellites[0].name == "GPS [31mred"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[null]", "not an OMM .it is no table of names and values"),
        (b"OBJECT_NAME,MEAN_MOTION\na,1\rb,2\n", "cannot be read as whole element sets|not an OMM"),
        (b"\x00\x00\x00\x0d\x0a\x09OSMHeader\x18\xff\xfe", "cannot be read as whole element sets"),
        (b"", "holds no element set"),
        (b"No GP data found\n", "holds no element set"),
        (b'{"type": "FeatureCollection", "features": []}', "not an OMM .no EPOCH"),
        (b"[]", "holds no element set"),
        (b"[1, 2]", "not an OMM"),
        (b'[{"OBJECT_NAME": ', "cannot be read as whole element sets"),
        (
            b'[{"OBJECT_NAME": "GPS", "EPOCH": "2024-03-31T12:00:07"}]',
            "cut or not an OMM .no [A-Z_]+",
        ),
        (b"<html><body>Not found</body></html>", "is a web page: fetch the file again"),
        (b"<ndm><omm>", "holds no element set"),
        (b"OBJECT_NAME,EPOCH,MEAN_MOTION\nGPS,2024-03-31T12:00:07,2.0", "element set 1 .* is cut"),
        (TLE[:-20].encode(), "element set of .* is cut or damaged .*of 69 characters"),
        (TLE[:90].encode(), "must follow each other"),
        (TLE.replace("55.0000", "55.0100").encode(), "element set of .* checksum"),
        (TLE.encode() + b"GPS BIIA-14 (PRN 26)\n", "must follow each other"),
        (2 * TLE.encode(), "2 element sets of satellite 20959"),
        *(
            (omm("csv", NOON, TIME_SYSTEM=each).encode(), f"TIME_SYSTEM is {each}, and only UTC")
            for each in OF_OTHERS
        ),
        *(
            (omm("json", NOON, TIME_SYSTEM=each).encode(), f"TIME_SYSTEM is {each}, and only UTC")
            for each in OF_OTHERS
        ),
    ],
)
def test_a_file_that_is_no_orbits_is_refused_in_one_sentence(tmp_path, content, message):
    assert str(tmp_path) in refused(read_orbits, tmp_path / "orbits", content, message)


# Semi-major axis (km), inclination (degrees); names as CelesTrak writes them.
# Sources: OS-SIS-ICD (Galileo), GLONASS ICD, BDS-SIS-ICD (its medium orbits).
WALKER = {
    "galileo": (29_600.3, 56.0, "GSAT02{:02d} (GALILEO {})"),
    "glonass": (25_508.2, 64.8, "COSMOS 24{:02d} (GLONASS)"),
    "beidou": (27_906.1, 55.0, "BEIDOU-3 M{}"),
}
EARTH_MU_KM3_S2 = 398_600.8  # WGS 72, as SGP4 has it


def walker_tle(system: str, first_number: int) -> str:
    """Return element sets of 2020-04-27 00:00 UTC of 24 satellites on 3 planes, through SGP4's exporter."""
    axis_km, inclination_deg, name = WALKER[system]
    motion = math.sqrt(EARTH_MU_KM3_S2 / axis_km**3) * 60  # radians a minute
    epoch_days, lines = (
        (datetime(2020, 4, 27, tzinfo=UTC) - datetime(1949, 12, 31, tzinfo=UTC)).days,
        [],
    )
    for i in range(24):
        plane, slot = divmod(i, 8)
        model, anomaly = Satrec(), math.tau * (slot / 8 + plane / 24)
        angles = math.radians(inclination_deg), anomaly, motion, math.tau * plane / 3
        model.sgp4init(WGS72, "i", first_number + i, epoch_days, 0.0, 0.0, 0.0, 1e-4, 0.0, *angles)
        lines += [name.format(i + 1, i + 1), *export_tle(model)]
    return "\n".join(lines) + "\n"


def test_several_constellations_are_read_together_as_alone_and_counted_by_system(tmp_path):
    sources = [
        "nominal",
        *(written(tmp_path, walker_tle(each, 100 * i), each) for i, each in enumerate(WALKER, 400)),
    ]
    times = ["2020-04-27T16:00:00Z", "2020-04-28T04:00:00Z"]  # nominal elements change at midnight
    orbits, together, alone = (
        read_orbits(sources),
        sky_of(sources, *times),
        [sky_of(each, *times) for each in sources],
    )
    assert together.systems == tuple(np.repeat(["gps", *WALKER], 24))
    for satellite, system in zip(orbits.satellites[24:], together.systems[24:], strict=True):
        distance_km = satellite.at(satellite.epoch).distance().km
        assert distance_km == pytest.approx(WALKER[system][0], rel=2e-3)
    counts = {
        sky.systems[0]: np.sum(sky.elevation_rad >= math.radians(5), axis=1).tolist()
        for sky in alone
    }
    under = together.under(5.0)
    for system, by_time in counts.items():
        is_of_system = np.array(under.systems) == system
        assert under.is_in_view[:, is_of_system].sum(axis=1).tolist() == by_time
    assert all(
        5 <= count <= 12 for by_time in counts.values() for count in by_time
    )  # a third is in view
    assert together.names == sum((sky.names for sky in alone), ())
    for field in ("azimuth_rad", "elevation_rad", "element_age_days"):
        parts = [getattr(sky, field) for sky in alone]
        np.testing.assert_array_equal(getattr(together, field), np.concatenate(parts, axis=1))


NAMES = {
    "gps": ("GPS BIIR-2  (PRN 13)", "NAVSTAR 43 (USA 132)"),
    "galileo": ("GSAT0101 (GALILEO-PFM)", "GSAT0201 (GALILEO 5)"),
    "glonass": ("COSMOS 2456 (GLONASS)",),
    "beidou": ("BEIDOU-3 M1",),
    "qzss": ("QZS-2 (MICHIBIKI-2)",),
    "navic": ("IRNSS-1B",),
    "unknown": ("GSAT-10", "ISS (ZARYA)"),
}


@pytest.mark.parametrize(
    ("system", "name"), [(system, name) for system, names in NAMES.items() for name in names]
)
def test_names_tell_the_system(tmp_path, name, system):
    assert sky_of(written(tmp_path, TLE.replace(NAME, name))).systems == (system,)


def test_a_satellite_given_twice_is_refused(tmp_path):
    gps, copy = written(tmp_path, TLE), written(tmp_path, TLE, "copy.tle")
    for sources, sentence in (
        ([gps, copy], r"2 element sets of satellite 20959 are in .*orbits\.txt and .*copy\.tle"),
        (["nominal", gps], "leave one of the two out"),
        ([], "at least one source and none twice"),
        (["nominal", "nominal"], "at least one source and none twice"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_orbits(sources)


def test_the_middle_epoch_is_that_of_the_files_to_the_minute(tmp_path):
    orbits = read_orbits(["nominal", written(tmp_path, TLE.replace(NAME, "GALILEO 5"))])
    assert middle_epoch(orbits) == "2012-12-07T23:11:00Z"  # day 342.9661672: 23:11:16.8
    assert middle_epoch(read_orbits("nominal")) is None


ELEMENT_NAMES = {
    "GPS BIIF-3  (PRN 24)": "G24",
    "GPS BIII-1 (PRN 04)": "G04",
    "BEIDOU-2 G7 (C03)": "C03",
    "QZS-2 (QZSS/PRN 194)": "J02",
    "QZS-3 (QZSS/PRN 189)": "J07",
    "GALAXY 30 (WAAS/PRN 135)": "S35",
    "E12": "E12",
    "GSAT0210 (GALILEO 13)": "",
    "COSMOS 2456 (730)": "",
    "GPS slot A1": "",
}


def test_satellites_of_a_log_are_found_by_what_the_names_of_element_sets_say():
    turned = np.zeros((1, len(ELEMENT_NAMES)))
    sky = Sky(
        (TIME,), tuple(ELEMENT_NAMES), turned, turned, ("unknown",) * len(ELEMENT_NAMES), turned
    )
    asked = [*filter(None, ELEMENT_NAMES.values()), "R05", "E13"]
    assert matching(asked, sky).tolist() == [0, 1, 2, 3, 4, 5, 6, NO_SATELLITE, NO_SATELLITE]
    with pytest.raises(
        InputError,
        match=r"none of the log's satellites \(G01, E30 ...\), but GPS slot A1, .*PRN 24",
    ):
        matching(["G01", "E30"], sky_of("nominal"))
