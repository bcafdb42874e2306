"""Orbits: element sets from files, or the nominal constellation, to look angles."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sgp4.io import verify_checksum
from skyfield.api import EarthSatellite, wgs84
from skyfield.iokit import parse_tle_file

from jaxurban.errors import InputError, StaleElementsWarning, readable, warn
from jaxurban.io.ephemerides import Ephemeris, read_ephemerides, timescale, utc_of
from jaxurban.io.nominal import GPS, MARK, nominal_satellites
from jaxurban.io.samples import located
from jaxurban.io.sniff import sniff, unpacked
from jaxurban.io.tables import check_rows
from jaxurban.settings import NOMINAL, iso_utc, parse_time
from jaxurban.world.sky import Sky

WARN_AGE_DAYS = 14.0  # SGP4 keeps GPS satellites within about 0.1 degree for two weeks
TLE_LENGTH = 69
# How CelesTrak and Space-Track name navigation satellites. GSAT with fewer than four digits is an Indian
# communications satellite, and Cosmos any Soviet or Russian one: an element file is taken to hold those that navigate.
SYSTEM_NAMES = {
    "gps": r"GPS|NAVSTAR|G\d\d$",
    "galileo": r"GALILEO|GSAT ?\d{4}|.*\(GALILEO|E\d\d$",
    "glonass": r"GLONASS|COSMOS|.*\(GLONASS|R\d\d$",
    "beidou": r"BEIDOU|BDS|C\d\d$",
    "qzss": r"QZS|J\d\d$",
    "navic": r"IRNSS|NVS|I\d\d$",
}
RINEX_NAME = re.compile(r"\b[GRECJIS]\d\d\b", re.ASCII)  # as in "BEIDOU-3 M1 (C19)"
PRN = re.compile(r"PRN ?(\d+)", re.ASCII)  # as in "GPS BIIF-3 (PRN 24)", "QZS-2 (QZSS/PRN 184)"
PRN_RANGES = (  # first and last PRN, letter, and what is taken off (RINEX 3.05, table 1; of QZSS also its L1S signals)
    (1, 63, "G", 0),
    (120, 158, "S", 100),
    (183, 192, "J", 182),
    (193, 202, "J", 192),
)
NO_SATELLITE = -1
REMEDY = (
    "give a TLE file or an OMM file (csv or json) such as CelesTrak's gps-ops, broadcast RINEX, SP3, "
    'or "nominal"'
)


@dataclass(frozen=True)
class Orbits:
    """Satellites that can be moved to a time.

    Attributes:
      satellites: one element set each, or an `Ephemeris`; for the nominal constellation the elements of its table's
        date (`look_angles` takes each day's own).
      sources: for each satellite the file that it is from, or ``"nominal"``.
    """

    satellites: tuple[EarthSatellite | Ephemeris, ...]
    sources: tuple[str, ...]

    @property
    def pairs(self) -> list[tuple[EarthSatellite | Ephemeris, str]]:
        """Each satellite and its source."""
        return list(zip(self.satellites, self.sources, strict=True))

    def of(self, source: str) -> list[int]:
        """Return the numbers of the satellites from one source."""
        return [s for s, name in enumerate(self.sources) if name == source]

    @property
    def nominal_systems(self) -> list[str]:
        """Constellations that have nominal satellites, each once: from no file, or named so by a file."""
        names = [
            satellite.name
            for satellite, source in self.pairs
            if source == NOMINAL or satellite.name.endswith(MARK)
        ]
        return list(dict.fromkeys(map(_system, names)))


def read_orbits(source: str | Path | Sequence[str | Path]) -> Orbits:
    """Return the satellites of a file, or the nominal GPS constellation for ``"nominal"``, or of several of these.

    Read are two-line elements with or without name lines, orbit mean-elements messages (OMM) as CSV or JSON, broadcast
    RINEX 2 to 4 and SP3, plain or packed as .gz; the content decides, not the file's name. Each
    satellite's constellation follows from its name.

    Raises:
      InputError: no source, no such file, another kind of file, a cut or damaged one, two element sets of one
        satellite, or satellites of a constellation that another source holds whole.
    """
    sources = list(map(str, [source] if isinstance(source, str | Path) else source))
    if not sources or len(set(sources)) < len(sources):
        raise InputError(
            f"orbits must name at least one source and none twice, got {sources}: {REMEDY}"
        )
    satellites: list[EarthSatellite | Ephemeris] = []
    names: list[str] = []
    for name in sources:
        if name == NOMINAL:
            satellites += nominal_satellites(GPS.table_date, timescale())
        else:
            satellites += _read_file(name)
        names += [name] * (len(satellites) - len(names))
    orbits = Orbits(tuple(satellites), tuple(names))
    _check_twice(orbits)
    return orbits


def middle_epoch(orbits: Orbits) -> str | None:
    """Return the middle one of the epochs of the elements from files, to the minute, ISO 8601 UTC; None without any."""
    epochs = sorted(
        satellite.epoch.utc_datetime() for satellite, source in orbits.pairs if source != NOMINAL
    )
    if not epochs:
        return None
    middle = epochs[len(epochs) // 2]
    # Half a minute more, cut to the minute, is rounded.
    return iso_utc((middle + timedelta(seconds=30)).replace(second=0, microsecond=0))


def span_of(satellites: Iterable[EarthSatellite | Ephemeris]) -> str:
    """Return in words from when to when the elements, messages or nodes of satellites are, one at least."""
    moments = []
    for satellite in satellites:
        if isinstance(satellite, Ephemeris):
            moments += utc_of(np.array(satellite.span_s)).tolist()
        else:
            moments.append(satellite.epoch.utc_datetime())
    return f"{iso_utc(min(moments))} to {iso_utc(max(moments))}"


def _check_twice(orbits: Orbits) -> None:
    """Raise InputError where a satellite comes twice, or beside a constellation that another source holds whole."""
    whole = {  # sources by constellation
        _system(satellite.name): source
        for satellite, source in orbits.pairs
        if source == NOMINAL or isinstance(satellite, Ephemeris)
    }
    from_files: dict[int, str] = {}  # sources by catalogue number
    for satellite, source in orbits.pairs:
        system = _system(satellite.name)
        other = whole.get(system, source)
        if other != source:
            raise InputError(
                f'"{other}" holds {system}, and so does {source}: leave one of the two out'
            )
        if system in whole:
            continue
        number = satellite.model.satnum
        if number in from_files:
            places = " and ".join(dict.fromkeys([from_files[number], source]))
            raise InputError(
                f"2 element sets of satellite {number} are in {places}: keep the one nearest in time"
            )
        from_files[number] = source


def _read_file(source: str) -> Sequence[EarthSatellite | Ephemeris]:
    """Return the satellites of one file: of an ephemeris, of OMM in JSON or CSV, else of two-line elements.

    Raises:
      InputError: no such file, another kind of file, a cut or damaged element set, or none.
    """
    path = located(source)
    what = f"the orbits file {source}"
    with readable(path, "whole element sets", REMEDY, what=what):
        sniff(path)
        with unpacked(path) as plain:
            data = plain.read_bytes()
        ephemerides = read_ephemerides(data, what)
        if ephemerides:
            return ephemerides
        text = data.decode("utf-8-sig").lstrip()
        header = text.partition("\n")[0]
        messages: Any = None
        if text.startswith(("{", "[")):
            messages = json.loads(text)
        elif "MEAN_MOTION" in header and "," in header:
            check_rows(io.BytesIO(data), path.name)
            messages = list(csv.DictReader(io.StringIO(text)))
    listed = [messages] if isinstance(messages, dict) else messages
    satellites = _from_tles(text, source) if listed is None else _from_omms(listed, source)
    if not satellites:
        raise InputError(f"{what} holds no element set: {REMEDY}")
    return satellites


def _from_tles(text: str, source: str | Path) -> list[EarthSatellite]:
    """Return the satellites of a text of two-line elements, each a line 1 and a line 2, some below a line of a name.

    Raises:
      InputError: a wrong checksum, or lines that are cut or do not belong together; ``source`` names the file.
    """
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    first = [line for line in lines if line.startswith("1 ")]
    second = [line for line in lines if line.startswith("2 ")]
    try:
        verify_checksum(*first, *second)
        satellites = list(parse_tle_file((line.encode() for line in lines), timescale()))
        is_paired = [line[2:7] for line in first] == [line[2:7] for line in second]
        is_cut = bool(second) and lines[-1] != second[-1]
        if not is_paired or is_cut or len(satellites) < len(first):
            raise ValueError(
                f"a line 1 and a line 2 of one satellite, of {TLE_LENGTH} characters, must follow each other"
            )
    except ValueError as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise InputError(
            f"an element set of {source} is cut or damaged ({reason}): download the file again"
        ) from error
    for satellite in satellites:
        satellite.name = _printable(satellite.name) or f"catalogue number {satellite.model.satnum}"
    return satellites


def _printable(name: Any) -> str:
    """Return a name without the characters that would steer a terminal."""
    return "".join(filter(str.isprintable, str(name or ""))).strip()


def _from_omms(messages: Iterable[Any], source: str | Path) -> list[EarthSatellite]:
    """Return the satellites of orbit mean-elements messages.

    Args:
      messages: a dictionary each, by the names of the standard.
      source: the file, for messages.

    Raises:
      InputError: a message that is none, lacks an element, has one that is not finite, or counts in another time.
    """
    satellites = []
    for number, message in enumerate(messages, start=1):
        try:
            if not isinstance(message, dict):
                raise ValueError("it is no table of names and values")

            # SGP4's reader wants the fraction of a second, which the standard leaves optional.
            fields = {**message}
            epoch = parse_time(fields["EPOCH"]).replace(tzinfo=None)
            fields["EPOCH"] = epoch.strftime("%Y-%m-%dT%H:%M:%S.%f")
            satellite = EarthSatellite.from_omm(timescale(), fields)
            model = satellite.model
            elements = (model.no_kozai, model.ecco, model.inclo, model.nodeo, model.argpo, model.mo)
            if not all(map(math.isfinite, elements)):
                raise ValueError("an element is not finite")
            if str(fields.get("TIME_SYSTEM") or "UTC").strip().upper() != "UTC":
                raise ValueError(
                    f"its TIME_SYSTEM is {fields['TIME_SYSTEM']}, and only UTC is read"
                )
        except (KeyError, TypeError, ValueError) as error:
            reason = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
            raise InputError(
                f"element set {number} of {source} is cut or not an OMM ({reason}): {REMEDY}"
            ) from error
        satellite.name = _printable(fields.get("OBJECT_NAME")) or f"catalogue number {model.satnum}"
        satellites.append(satellite)
    return satellites


def look_angles(
    orbits: Orbits,
    times: Sequence[str | datetime],
    lon_deg: ArrayLike,
    lat_deg: ArrayLike,
    height_m: ArrayLike = 0.0,
    convergence_rad: float = 0.0,
    max_age_days: float = 90.0,
) -> Sky:
    """Return where every satellite stands at every time, seen from one point or from one at each time.

    Args:
      orbits: from `read_orbits`.
      times: UTC, as ISO 8601 text or datetimes.
      lon_deg: longitude of the point, or of the point at each time, WGS 84.
      lat_deg: its latitude.
      height_m: its height above the ellipsoid.
      convergence_rad: meridian convergence there, by which azimuths are turned: they count clockwise from grid north.
      max_age_days: oldest elements accepted, before or after the time.

    Returns:
      The sky, with ``[T, S]`` angles in radians of the times and satellites in the order of the arguments; NaN where
      a broadcast or precise orbit says nothing of a time.

    Warns:
      StaleElementsWarning: elements older than `WARN_AGE_DAYS` at a time.

    Raises:
      InputError: text that is not a time, elements too old, ones that SGP4 cannot carry to a time, or a file that has
        no satellite at a time.
    """
    # The angles, a set of elements at a time; `age_days` stays 0 for nominal satellites.
    utc = [parse_time(time) for time in times]
    places = np.broadcast_arrays(lat_deg, lon_deg, height_m, np.zeros(len(utc)))[:3]
    azimuth_rad, elevation_rad, age_days = np.zeros((3, len(utc), len(orbits.satellites)))
    for index, satellites in _satellites_at(orbits, utc):
        moments = timescale().from_datetimes([utc[t] for t in index])
        point = wgs84.latlon(*(values[index] for values in places))
        for s, satellite in satellites:
            elevation, azimuth, _ = (satellite - point).at(moments).altaz()
            elevation_rad[index, s] = elevation.radians
            azimuth_rad[index, s] = azimuth.radians
            if orbits.sources[s] != NOMINAL:
                age_days[index, s] = np.abs(moments.tt - satellite.epoch.tt)

    # Elements that SGP4 gives up on, and those that are too old, by the oldest ones.
    names = tuple(satellite.name for satellite in orbits.satellites)
    iso = tuple(map(iso_utc, utc))
    _check_places(orbits, iso, ~np.isfinite(elevation_rad))
    oldest_days = age_days.max(initial=0.0)
    if oldest_days > min(WARN_AGE_DAYS, max_age_days):
        t, s = np.argwhere(age_days == oldest_days)[0]
        age = f"the elements of {names[s]} in {orbits.sources[s]} are {oldest_days:.0f} days away from {iso[t]}"
        remedy = f'use elements of that date (CelesTrak, Space-Track) or orbits = "{NOMINAL}"'
        if names[s].endswith(MARK):  # of a file that was written for one day
            remedy = (
                "name a file of elements of that date (CelesTrak, Space-Track) in [gps] orbits, or leave the time out "
                "where the maps have one"
            )
        if oldest_days > max_age_days:
            raise InputError(f"{age}, more than max_age_days = {max_age_days:g}: {remedy}")
        warn(f"{age}, so its place is uncertain: {remedy}", StaleElementsWarning)
    return Sky(
        times=iso,
        names=names,
        azimuth_rad=(azimuth_rad - convergence_rad) % math.tau,
        elevation_rad=elevation_rad,
        systems=tuple(map(_system, names)),
        element_age_days=age_days,
    )


def _check_places(orbits: Orbits, iso: Sequence[str], is_lost: np.ndarray) -> None:
    """Raise InputError where SGP4 loses a satellite, or an ephemeris has no place for any of its satellites.

    Args:
      orbits: the satellites.
      iso: the times as texts, ``T`` of them.
      is_lost: ``[T, S]``, which satellites have no place at a time.
    """
    for s, (satellite, source) in enumerate(orbits.pairs):
        is_ephemeris = isinstance(satellite, Ephemeris)
        is_out = is_lost[:, orbits.of(source) if is_ephemeris else [s]].all(axis=1)
        if not is_out.any():
            continue
        time = iso[int(np.argmax(is_out))]
        if not is_ephemeris:
            raise InputError(
                f"SGP4 cannot carry {satellite.name} of {source} to {time}: remove it from the file"
            )
        raise InputError(
            f"{source} says nothing of {time}, only of {span_of([satellite])}: use orbits of that time"
        )


def matching(satellites: Sequence[str], sky: Sky) -> np.ndarray:
    """Return which satellites of a sky a receiver's log names: ``[N]`` indices, `NO_SATELLITE` where the sky has none.

    Names of element sets hold the RINEX 3 name (``C19``) or, of GPS, QZSS and SBAS, the PRN. CelesTrak's of Galileo and
    GLONASS hold neither: rename these in the file.

    Args:
      satellites: RINEX 3 names, such as ``G05``.
      sky: of the orbits.

    Raises:
      InputError: the sky has none of them.
    """
    numbers = {rinex_name(name): number for number, name in enumerate(sky.names)}
    matched = np.array([numbers.get(name, NO_SATELLITE) for name in satellites], int)
    if (matched == NO_SATELLITE).all():
        raise InputError(
            f"the orbits name none of the log's satellites ({', '.join(satellites[:6])} ...), but "
            f"{', '.join(sky.names[:3])} ...: give element sets of that "
            "day whose names hold the PRN or the RINEX name, as GPS BIIF-3 (PRN 24) or BEIDOU-3 M1 (C19) do, or "
            "azimuth_deg and elevation_deg in the log"
        )
    return matched


def rinex_name(name: str) -> str:
    """Return the RINEX 3 name that an element set's name holds, itself or by a PRN (see `PRN_RANGES`), else ``""``."""
    written = RINEX_NAME.search(name)
    if written:
        return written.group()
    match = PRN.search(name)
    prn = int(match[1]) if match else 0  # 0 is in no range
    for first, last, letter, offset in PRN_RANGES:
        if first <= prn <= last:
            return f"{letter}{prn - offset:02d}"
    return ""


def _satellites_at(
    orbits: Orbits, utc: list[datetime]
) -> Iterator[tuple[list[int], list[tuple[int, EarthSatellite]]]]:
    """Yield sets of elements: the indices of the times that a set serves, and its satellites with their numbers.

    Elements from files serve all times. Nominal satellites have other elements on each day (UTC).

    Args:
      orbits: the satellites; a satellite's number is its place in them.
      utc: the times.
    """
    nominal = orbits.of(NOMINAL)
    numbered = enumerate(orbits.satellites)
    from_files = [(s, satellite) for s, satellite in numbered if s not in nominal]
    if from_files:
        yield list(range(len(utc))), from_files
    if not nominal:
        return
    for day in sorted({time.date() for time in utc}):
        of_day = zip(nominal, nominal_satellites(day, timescale()), strict=True)
        yield [t for t, time in enumerate(utc) if time.date() == day], list(of_day)


def _system(name: str) -> str:
    """Return the constellation of a satellite by its name, or ``"unknown"``."""
    for system, names in SYSTEM_NAMES.items():
        if re.match(names, name.upper()):
            return system
    return "unknown"
