"""Ephemerides: satellites whose places on the turning Earth come from broadcast RINEX or SP3.

The library sidereon (the extra ``receiver``) reads RINEX and SP3, and says which message is used at which time: one of
GPS and QZSS for 2 hours before and after its epoch, of Galileo for 4 hours after it, of GLONASS for 30 minutes.
"""

import re
from collections.abc import Sequence
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
from skyfield.api import Time, Timescale, load
from skyfield.constants import AU_KM
from skyfield.framelib import itrs
from skyfield.vectorlib import VectorFunction

from jaxurban.errors import InputError

GPS_START = pd.Timestamp("1980-01-06", tz="UTC")
GPS_START_TAI = 2_444_244.5 + 19 / 86_400  # Julian date
J2000_S = 630_763_200.0  # from the start of GPS time to 2000-01-01T12:00 of GPS time, whence sidereon counts
WEEK_S = 604_800.0
BEIDOU_WEEKS = 1356  # of GPS time before BeiDou's first week
GPS_SCALES = ("GPS", "GPST", "GST", "GAL", "QZSST", "QZS")  # Galileo and QZSS keep to GPS time


@lru_cache(maxsize=1)
def timescale() -> Timescale:
    """Return the scale of time for Skyfield, made once."""
    return load.timescale(builtin=True)  # the copy inside Skyfield: no network


def utc_of(gps_s: np.ndarray) -> pd.DatetimeIndex:
    """Return UTC of ``[N]`` seconds since the start of GPS time, by the leap seconds at the first of them."""
    gps = GPS_START + pd.to_timedelta(gps_s, "s").round("us")
    first = timescale().tai_jd(GPS_START_TAI + gps_s[0] / 86_400).utc_datetime()
    return gps - (gps[0] - first).round("s")


class Ephemeris(VectorFunction):  # type: ignore[misc]
    """A satellite by its places in the frame that turns with Earth, for Skyfield; times must be arrays.

    Attributes:
      name: as in RINEX 3, such as G05.
      span_s: first and last time of which its file says something, seconds since the start of GPS time.
      epoch: the middle of them.
      health: by its message, 0 where it is good; without that the satellite has no place.
    """

    center = 399

    def __init__(self, name: str, source: Any, span_s: Sequence[float], health: float) -> None:
        """Keep what sidereon has read as the source of the places."""
        self.name = self.target = name
        self.span_s = span_s
        self.epoch = timescale().tai_jd(GPS_START_TAI + np.mean(span_s) / 86_400)
        self.health = health
        self._source = source

    def _places_m(self, gps_s: np.ndarray) -> np.ndarray:
        """Return ``[N, 3]`` places at ``[N]`` seconds of GPS time, NaN where there is none."""
        states = library().observable_states_at_j2000_s
        return states(self._source, [self.name] * len(gps_s), gps_s - J2000_S).positions_ecef_m

    def _at(self, t: Time) -> tuple:
        """Return the place for Skyfield, and in place of its velocity, which nobody asks for, 0."""
        gps_s = (t.whole - GPS_START_TAI + t.tai_fraction) * 86_400
        places_m = np.where(self.health, np.nan, self._places_m(gps_s))
        inertial = np.einsum("jin,nj->in", itrs.rotation_at(t), places_m / 1000 / AU_KM)
        return inertial, 0 * inertial, None, None


def library() -> ModuleType:
    """Return sidereon; InputError where it is not installed."""
    try:
        import sidereon
    except ImportError as error:
        raise InputError(
            "RINEX and SP3 files are read by sidereon: pip install 'jaxurban[receiver]'"
        ) from error
    return sidereon


def loaded(function: str, text: str) -> Any:
    """Return what a function of sidereon reads in the text of a file; ValueError where it is cut or damaged."""
    sidereon = library()
    if not text.endswith("\n"):
        raise ValueError("it ends within a line, so it was cut")
    data = text if function.startswith("parse") else text.encode()
    try:
        return getattr(sidereon, function)(data)
    except sidereon.SidereonError as error:
        raise ValueError(str(error)) from error


def check_time_scale(scale: str, what: str) -> None:
    """Raise InputError, which begins with ``what``, where a file counts in a time that is not that of GPS."""
    if scale not in GPS_SCALES:
        raise InputError(
            f"{what} counts in {scale}, and only GPS time is read: name a file of GPS time"
        )


def read_ephemerides(data: bytes, what: str) -> list[Ephemeris]:
    """Return the satellites of broadcast RINEX or SP3; none of other content.

    Args:
      data: the content of the file.
      what: names the file, and begins the message of an error.

    Raises:
      InputError: a file in another scale of time; sidereon is not installed.
      ValueError: a file that is cut or damaged.
    """
    for mark, read in READERS.items():
        if re.match(mark, data):
            return read(data.decode("utf-8", "replace"), what)
    return []


def _broadcast(text: str, what: str) -> list[Ephemeris]:
    """Return the satellites of a RINEX file of navigation messages; one is good if any of its messages says so."""
    broadcast = loaded("load_rinex_nav", text)
    glonass = loaded("parse_rinex_glonass_records", text)
    others = loaded("parse_rinex_nav_records", text)
    epochs_s = [J2000_S + record.toe_gpst_j2000_s for record in glonass]
    for record in others:
        week = record.toe_week + (BEIDOU_WEEKS if record.satellite[0] == "C" else 0)
        epochs_s.append(week * WEEK_S + record.toe_tow_s)
    # The least of a satellite's flags comes last, and stays.
    flags = [(record.satellite, record.sv_health) for record in [*glonass, *others]]
    health = dict(sorted(flags, reverse=True))
    span_s = min(epochs_s, default=0.0), max(epochs_s, default=0.0)
    return [Ephemeris(name, broadcast, span_s, health[name]) for name in sorted(health)]


def _sp3(text: str, what: str) -> list[Ephemeris]:
    """Return the satellites of precise orbits, which are good up to one step beyond the first and the last node."""
    precise = loaded("load_sp3", text)
    check_time_scale(precise.header.time_system, what)
    first_s, *_, last_s = J2000_S + np.array(precise.epochs_j2000_seconds)
    return [Ephemeris(name, precise, (first_s, last_s), 0.0) for name in precise.satellites]


READERS = {  # by the first bytes of a file
    rb"\s*[234]\.\d+ +[NGH]": _broadcast,
    rb"#[a-d][PV]\d{4}": _sp3,
}
