"""RINEX 3: a receiver's observations, with its navigation messages and a reference track, to `ReceiverLog`.

The library sidereon (the extra ``receiver``) reads the files and computes satellites from their messages.
"""

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from jaxurban.errors import InputError, readable
from jaxurban.io.read.tracks import LAT, LON, RULES, UTC, Rule, checked, renamed
from jaxurban.io.samples import located
from jaxurban.io.tables import read_table
from jaxurban.studies.receiver.logs import (
    AZIMUTH,
    CN0,
    ELEVATION,
    EPOCH,
    SATELLITE,
    ReceiverLog,
    log_of,
)
from jaxurban.world.grid import transformer

LOWEST_HEARD_DEG = 5.0  # lowest elevation of a satellite that has rows in a log
MATCH_S = 0.02  # most between the times of a reference and of its observation: clocks are kept to some milliseconds
HEIGHT = "height_m"
WEEK = "gps_week"
TOW = "gps_tow_s"
TRACK = LON, LAT, HEIGHT
OF_REFERENCE = RULES | {
    HEIGHT: Rule(-1000.0, 20_000.0),
    WEEK: Rule(1024.0, 10_000.0),  # not modulo 1024
    TOW: Rule(0.0, 604_800.0),
}
OTHER_NAMES = {  # of a reference's columns, in small letters with _ for what is no letter
    "lon": LON,
    "longitude_deg": LON,
    "lat": LAT,
    "latitude_deg": LAT,
    "ellipsoid_height_m": HEIGHT,
    "ellipsoidal_height_m": HEIGHT,
}
WGS84_3D = "EPSG:4979"
WGS84_ECEF = "EPSG:4978"
J2000, GPS_START = (pd.Timestamp(day, tz="UTC") for day in ("2000-01-01T12:00", "1980-01-06"))
GPS_SCALES = "GPST", "GST", "QZSST"  # Galileo and QZSS keep their time to that of GPS
L1_HZ = 1_575_420_000.0  # sidereon asks for it to compute a Doppler shift, which is not used
# How the codes of C/N0 on L1, E1 and B1 begin (RINEX 3.05, tables 4 to 10), by a system's letter; "S1" where the letter
# is missing here.
BANDS = {"C": ("S2", "S1")}
EVENTS = 2  # an epoch with this flag or a higher one marks an event and holds no observation
AGAIN = "convert or download it again"
FIRST_LINE = r"\s*[34]\.\d+\s+{}"  # version and type


def read_rinex(
    observations: str | Path, navigation: str | Path, reference: str | Path | pd.DataFrame
) -> ReceiverLog:
    """Return the log of a receiver from its RINEX 3 files, at the places of a better reference.

    The log has a row for each epoch that is in the reference and in the observations (within `MATCH_S`) and each
    satellite that by its broadcast orbit stands at least `LOWEST_HEARD_DEG` above the horizon then. Its C/N0 is the
    strongest S observable of L1, E1 or B1, 0 where there is none. A satellite that its navigation message calls
    unhealthy has no row, nor has one without a message that is valid at the time.

    Args:
      observations: RINEX 3 (or 4) file of observations.
      navigation: RINEX 3 (or 4) file of navigation messages, with leap seconds.
      reference: table, or its file (.csv, .csv.gz, .parquet), with ``lon_deg``, ``lat_deg``, ``height_m`` (ellipsoidal)
        and ``utc``, or ``gps_week`` and ``gps_tow_s``; see `read_track`.

    Returns:
      The log; ``left_out`` names the satellites without a row though they were received, or have messages.

    Raises:
      InputError: files that are not RINEX 3 or 4 or are cut, no leap seconds or no C/N0 in them, a reference that lacks
        a column or has values of another unit or no time in common, or sidereon is not installed.
    """
    messages = Messages(navigation)
    track = read_track(reference, messages.leap_s)
    observed_s, strengths, letters = _read_strengths(observations)

    # Pair each observation with the nearest row of the track.
    track_s = messages.seconds_of(track[UTC])
    away_s, nearest = KDTree(observed_s[:, None]).query(track_s[:, None])
    pairs = pd.DataFrame({"observation": nearest, "away_s": away_s})
    pairs = pairs[pairs.away_s <= MATCH_S].sort_values("away_s")
    pairs = pairs.drop_duplicates("observation").sort_index()
    if pairs.empty:
        late_s = track_s.min() - observed_s.min()
        raise InputError(
            f"the reference track and the observations {str(observations)!r} have no epoch in common, within "
            f"{MATCH_S:g} s: the track begins {late_s:+.3f} s after them, and that of the same drive is needed"
        )
    track = track.iloc[pairs.index].reset_index(drop=True)
    track = track.assign(observation=pairs.observation.to_numpy())

    # A row for each satellite above the horizon, of systems whose C/N0 the file has.
    angles = messages.angles(track)
    is_heard = angles[SATELLITE].str[0].isin(letters)
    rows = angles[is_heard & (angles[ELEVATION] >= LOWEST_HEARD_DEG)].join(track, on=EPOCH)
    rows = rows.merge(strengths, "left", ["observation", SATELLITE]).fillna({CN0: 0.0})

    left_out = messages.left_out(set(angles[SATELLITE]), set(strengths[SATELLITE]))
    left_out |= dict.fromkeys(
        angles[SATELLITE][~is_heard], "no C/N0 of L1, E1 or B1 in the observations"
    )
    return replace(log_of(rows, str(observations)), left_out=dict(sorted(left_out.items())))


def read_track(reference: str | Path | pd.DataFrame, leap_s: float) -> pd.DataFrame:
    """Return the columns ``utc``, ``lon_deg``, ``lat_deg`` and ``height_m`` of a reference track.

    Its columns are named so, or ``lon``, ``longitude_deg``, ``lat``, ``latitude_deg``, ``ellipsoid_height_m``, and for
    the time ``gps_week`` (not modulo 1024) and ``gps_tow_s``. Capital letters, blanks and brackets do not matter:
    ``GPS TOW (s)`` is ``gps_tow_s``.

    Args:
      reference: the table or its file.
      leap_s: seconds by which GPS time is ahead of UTC.

    Raises:
      InputError: a file that cannot be read, no such columns, or values out of range.
    """
    if isinstance(reference, pd.DataFrame):
        what = "the reference track"
        table = reference
    else:
        what = f"the reference track {str(reference)!r}"
        table = read_table(located(reference), "reference track")
    names = [re.sub(r"\W+", "_", str(name).lower()).strip("_") for name in table.columns]
    table = renamed(table.set_axis(names, axis="columns"), OTHER_NAMES)
    times = [UTC] if UTC in table else [WEEK, TOW]
    if table.empty or not {*times, *TRACK} <= set(table):
        raise InputError(
            f"{what} has {len(table)} rows of the columns {', '.join(map(str, table.columns))}: give {UTC}, or {WEEK} "
            f"and {TOW}, and {', '.join(TRACK)} (above the ellipsoid)"
        )
    table = checked(table, [*times, *TRACK], what, OF_REFERENCE)
    if UTC not in table:
        days = pd.to_timedelta(7.0 * table[WEEK], unit="D")
        seconds = pd.to_timedelta(table[TOW] - leap_s, unit="s")
        table[UTC] = GPS_START + days + seconds.dt.round("us")
    return table[[UTC, *TRACK]]


class Messages:
    """The navigation messages of a file, from which the positions of satellites are computed.

    Attributes:
      name: of the file.
      leap_s: seconds by which GPS time is ahead of UTC, as the file says.
    """

    def __init__(self, navigation: str | Path) -> None:
        """Read a file of navigation messages.

        Raises:
          InputError: no RINEX 3 or 4 navigation file, one that is cut, or without leap seconds.
        """
        self._sidereon = _library()
        self.name = str(navigation)
        text = _text(navigation, "N", "navigation")
        with _whole(self._sidereon, navigation, "navigation"):
            self._ephemeris = self._sidereon.load_rinex_nav(text.encode())
            self._records: list[Any] = [
                *self._sidereon.parse_rinex_nav_records(text),
                *self._sidereon.parse_rinex_glonass_records(text),
            ]
        if not self._records:
            raise InputError(
                f"the navigation file {self.name!r} holds no message of a satellite: name another file"
            )
        if self._ephemeris.leap_seconds is None:
            raise InputError(
                f"the navigation file {self.name!r} has no leap seconds, which GPS time is ahead of UTC: add the line "
                f"{'    18'.ljust(60)}LEAP SECONDS (18 since 2017) above END OF HEADER"
            )
        self.leap_s = float(self._ephemeris.leap_seconds)

    def seconds_of(self, utc: pd.Series) -> np.ndarray:
        """Return times in UTC as seconds of GPS time since J2000, ``[N]`` float64."""
        return ((utc - J2000) / pd.Timedelta(seconds=1)).to_numpy() + self.leap_s

    def angles(self, track: pd.DataFrame) -> pd.DataFrame:
        """Return where the satellites stand along a track, without those that have no healthy message at the time.

        Args:
          track: with the columns ``utc``, ``lon_deg``, ``lat_deg`` and ``height_m`` of `read_track`.

        Returns:
          A row for each epoch and satellite, with the row of the track (``epoch``), ``satellite``, ``azimuth_deg``
          (clockwise from true north) and ``elevation_deg`` (negative below the horizon). The light's travel time is
          taken into account.
        """
        antenna_m = np.column_stack(
            transformer(WGS84_3D, WGS84_ECEF).transform(*track[[*TRACK]].to_numpy().T)
        )
        times_s = self.seconds_of(track[UTC]).tolist()
        names = np.array(sorted({record.satellite for record in self._records}))
        # Azimuth and elevation by epoch and satellite, NaN without a message.
        angles_deg = np.full((len(track), len(names), 2), np.nan)
        for s, name in enumerate(names.tolist()):
            for epoch, time_s in enumerate(times_s):
                try:
                    seen = self._sidereon.observe_broadcast(
                        self._ephemeris, name, antenna_m[epoch], time_s, L1_HZ
                    )
                except self._sidereon.SolveError:
                    continue
                angles_deg[epoch, s] = seen.azimuth_deg, seen.elevation_deg

        epochs, satellites = np.nonzero(np.isfinite(angles_deg[..., 1]))
        azimuth_deg, elevation_deg = angles_deg[epochs, satellites].T
        columns = {
            EPOCH: epochs,
            SATELLITE: names[satellites],
            AZIMUTH: azimuth_deg,
            ELEVATION: elevation_deg,
        }
        return pd.DataFrame(columns)

    def left_out(self, placed: set[str], received: set[str]) -> dict[str, str]:
        """Return why satellites that were received or have messages have no place: a reason by name.

        Args:
          placed: satellites that have a place at some time.
          received: satellites that were received.
        """
        flags: dict[str, set[int]] = {}  # of health, 0 where it is good
        for record in self._records:
            flags.setdefault(record.satellite, set()).add(int(record.sv_health))
        reasons = {}
        for name in (flags.keys() | received) - placed:
            health = max(flags.get(name, {0}))
            reasons[name] = "no navigation message of the time"
            if health:
                reasons[name] = f"unhealthy by its navigation message (health {health})"
        return reasons


def _read_strengths(observations: str | Path) -> tuple[np.ndarray, pd.DataFrame, list[str]]:
    """Read a file of observations, and return its epochs and how strongly each satellite was received.

    Returns:
      ``[N]`` epochs in seconds of GPS time since J2000; a table of ``observation`` (the number of its epoch),
      ``satellite`` and ``cn0_dbhz``, the strongest of the satellite's observables in `BANDS`; and the letters of the
      systems for which the file has observables of C/N0.

    Raises:
      InputError: no RINEX 3 or 4 observation file, one that is cut, not in GPS time, without C/N0 or observations.
    """
    sidereon = _library()
    data = _text(observations, "O", "observation").encode()
    with _whole(sidereon, observations, "observation"):
        file = sidereon.load_rinex_obs(data)
    what = f"the observation file {str(observations)!r}"
    first = file.header.time_of_first_obs
    scale = first[1].abbrev if first else "unknown"
    if scale not in GPS_SCALES:
        raise InputError(
            f"{what} counts in {scale}, and only GPS time is read: convert it to a file of GPS time"
        )
    codes = []  # of each system with observables of C/N0, these observables
    for system in file.header.systems:
        bands = BANDS.get(system.letter, ("S1",))
        own = [code for code in file.obs_codes(system) if code.startswith(bands)]
        if own:
            codes.append((system, own))
    if not codes:
        raise InputError(
            f"{what} has no C/N0 of L1, E1 or B1 (S1C, S2I ...): write it with these observables"
        )

    # The time of each epoch of observations; of each observable in it the satellite, and the value or NaN.
    only = sidereon.ObservationFilter(codes)
    times_s = []
    names: list[str] = []
    values = []
    for number, epoch in enumerate(file.epochs):
        time = epoch.epoch
        if epoch.flag >= EVENTS or time is None:
            continue
        minute = pd.Timestamp(time.year, time.month, time.day, time.hour, time.minute, tz="UTC")
        series = file.observation_values(number, only)
        names += series.satellites
        values.append(series.values)
        times_s.append((minute - J2000).total_seconds() + time.second)  # with its fraction
    if not times_s:
        raise InputError(f"{what} holds no observation: name another file")

    observation = np.repeat(np.arange(len(times_s)), list(map(len, values)))
    rows = pd.DataFrame({"observation": observation, SATELLITE: names, CN0: np.concatenate(values)})
    strongest = rows.dropna().groupby(["observation", SATELLITE], as_index=False).max()
    return np.array(times_s), strongest, [system.letter for system, _ in codes]


def _text(file: str | Path, letter: str, kind: str) -> str:
    """Return the text of a RINEX file; comments may be in any encoding.

    Args:
      file: its path.
      letter: of its type in the first line, ``"O"`` or ``"N"``.
      kind: the same in a word, for messages.

    Raises:
      InputError: it cannot be read, is not of this type in RINEX 3 or 4, or ends within a line.
    """
    what = f"the {kind} file {str(file)!r}"
    remedy = f"name the receiver's {kind} file as RINEX 3 (RTKLIB's convbin writes both)"
    with readable(file, "text", remedy, what=what):
        text = Path(file).read_bytes().decode("utf-8", "replace")
    if not re.match(FIRST_LINE.format(letter), text):
        begins = text.partition("\n")[0].strip()[:60]
        raise InputError(
            f"{what} begins with {begins!r}, not as a {kind} file in RINEX 3 or 4: {remedy}"
        )
    if not text.endswith("\n"):
        raise InputError(f"{what} ends within a line, so it was cut: {AGAIN}")
    return text


def _whole(sidereon: ModuleType, file: str | Path, kind: str) -> Any:
    """Return a context in which errors of sidereon become the InputError that a file of this kind is damaged."""
    return readable(
        file, "RINEX", AGAIN, sidereon.SidereonError, what=f"the {kind} file {str(file)!r}"
    )


def _library() -> ModuleType:
    """Return sidereon; InputError where it is not installed."""
    try:
        import sidereon
    except ImportError as error:
        raise InputError(
            "RINEX files are read by sidereon: pip install 'jaxurban[receiver]'"
        ) from error
    return sidereon
