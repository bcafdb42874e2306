"""Ephemerides: satellites whose places on the turning Earth come from broadcast RINEX, SP3 or a YUMA almanac.

The library sidereon (the extra ``receiver``) reads RINEX and SP3, and says which message is used at which time: one of
GPS and QZSS for 2 hours before and after its epoch, of Galileo for 4 hours after it, of GLONASS for 30 minutes.
"""

import re
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
from skyfield.api import Time, Timescale, load
from skyfield.constants import AU_KM
from skyfield.framelib import itrs
from skyfield.vectorlib import VectorFunction

from jaxurban.errors import InputError, readable

GPS_START = pd.Timestamp("1980-01-06", tz="UTC")
GPS_START_TAI = 2_444_244.5 + 19 / 86_400  # Julian date
J2000_S = 630_763_200.0  # from the start of GPS time to 2000-01-01T12:00 of GPS time, whence sidereon counts
WEEK_S = 604_800.0
BEIDOU_WEEKS = 1356  # of GPS time before BeiDou's first week
GPS_SCALES = ("GPS", "GPST", "GST", "GAL", "QZSST", "QZS")  # Galileo and QZSS keep to GPS time
ROLLOVER_WEEKS = 1024
MU_M3_S2 = 3.986005e14  # of Earth, and its rotation: IS-GPS-200, table 20-IV
EARTH_RAD_S = 7.2921151467e-5
YUMA_LINES = 13  # of a satellite
AGAIN = "convert or download it again"
PlacesM = Callable[[np.ndarray], np.ndarray]


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
    """

    center = 399

    def __init__(self, name: str, span_s: tuple[float, float], places_m: PlacesM) -> None:
        """Keep ``places_m``, which returns ``[N, 3]`` of ``[N]`` seconds of GPS time; NaN where there is no place."""
        self.name = self.target = name
        self.span_s = span_s
        self._places_m = places_m

    @property
    def epoch(self) -> Time:
        """The middle of the span."""
        return timescale().tai_jd(GPS_START_TAI + np.mean(self.span_s) / 86_400)

    def _at(self, t: Time) -> tuple:
        """Return the place for Skyfield, and in place of its velocity, which nobody asks for, 0."""
        gps_s = (t.whole - GPS_START_TAI + t.tai_fraction) * 86_400
        places_au = self._places_m(gps_s).T / (1000 * AU_KM)
        inertial_au = np.einsum("ji...,j...->i...", itrs.rotation_at(t), places_au)
        return inertial_au, 0 * inertial_au, None, None


Read = tuple[
    list[Ephemeris], dict[str, str]
]  # the satellites of a file, and why others are left out


def library() -> ModuleType:
    """Return sidereon; InputError where it is not installed."""
    try:
        import sidereon
    except ImportError as error:
        raise InputError(
            "RINEX and SP3 files are read by sidereon: pip install 'jaxurban[receiver]'"
        ) from error
    return sidereon


def read_ephemerides(data: bytes, source: str | Path) -> Read | None:
    """Return the satellites of broadcast RINEX, SP3 or a YUMA almanac; None of other content.

    Args:
      data: the content of the file.
      source: the file, for messages.

    Raises:
      InputError: a file that is cut or damaged, in another scale of time, without a satellite that can be used, or an
        almanac whose week is modulo 1024; sidereon is not installed.
    """
    reader = next((read for mark, read in READERS.items() if re.match(mark, data)), None)
    if reader is None:
        return None
    errors = () if reader is _yuma else (library().SidereonError,)
    what = f"the orbits file {str(source)!r}"
    with readable(source, "whole orbits", AGAIN, *errors, what=what):
        if not data.endswith(b"\n"):
            raise ValueError("it ends within a line, so it was cut")
        found = reader(data.decode("utf-8", "replace"), what)
    if not found[0]:
        raise InputError(f"{what} holds no healthy satellite: name another file")
    return found


def _unhealthy(health: Any, names: list[str]) -> dict[str, str]:
    """Return why satellites are left out, by the health and the satellite of each message: all say unhealthy."""
    least = pd.Series(health, names).groupby(level=0).min()
    return {
        str(name): f"unhealthy by its navigation message (health {value:.0f})"
        for name, value in least[least != 0].items()
    }


def _by_sidereon(source: Any, names: Any, span_s: tuple[float, float]) -> list[Ephemeris]:
    """Return satellites of what sidereon has read."""

    def places_m(name: str, gps_s: np.ndarray) -> np.ndarray:
        states = library().observable_states_at_j2000_s
        return states(source, [name] * len(gps_s), gps_s - J2000_S).positions_ecef_m

    return [Ephemeris(name, span_s, partial(places_m, name)) for name in names]


def _broadcast(text: str, what: str) -> Read:
    """Return the satellites of a RINEX file of navigation messages."""
    sidereon = library()
    broadcast = sidereon.load_rinex_nav(text.encode())
    glonass = sidereon.parse_rinex_glonass_records(text)
    others = sidereon.parse_rinex_nav_records(text)
    epochs_s = [J2000_S + record.toe_gpst_j2000_s for record in glonass]
    for record in others:
        week = record.toe_week + (BEIDOU_WEEKS if record.satellite[0] == "C" else 0)
        epochs_s.append(week * WEEK_S + record.toe_tow_s)
    records = [*glonass, *others]
    names = [record.satellite for record in records]
    left_out = _unhealthy([record.sv_health for record in records], names)
    span_s = min(epochs_s, default=0.0), max(epochs_s, default=0.0)
    return _by_sidereon(broadcast, sorted({*names} - {*left_out}), span_s), left_out


def _sp3(text: str, what: str) -> Read:
    """Return the satellites of precise orbits, between the first and the last of their nodes."""
    precise = library().load_sp3(text.encode())
    scale = precise.header.time_system
    if scale not in GPS_SCALES:
        raise InputError(
            f"{what} counts in {scale}, and only GPS time is read: take a product of GPS time"
        )
    nodes_s = J2000_S + np.array(precise.epochs_j2000_seconds)
    satellites = _by_sidereon(precise, precise.satellites, (nodes_s[0], nodes_s[-1]))
    return satellites, {}


def _yuma(text: str, what: str) -> Read:
    """Return the satellites of a YUMA almanac (IS-GPS-200, section 20.3.3.5.2.1)."""
    values = np.array(re.findall(r":\s*(\S+)\s*$", text, re.MULTILINE), float)
    table = values.reshape(-1, YUMA_LINES)
    week = table[0, -1]
    if week < ROLLOVER_WEEKS:
        weeks = week + ROLLOVER_WEEKS * np.arange(3)
        days = ", ".join(f"{GPS_START + pd.Timedelta(days=7 * each):%Y-%m-%d}" for each in weeks)
        raise InputError(
            f"{what} counts its week modulo 1024, {week:.0f}, which began on {days}: write the full one into it, as "
            f"`sed -i 's/^week:.*/week: {weeks[1]:.0f}/' FILE` does for the second"
        )
    names = [f"G{number:02.0f}" for number in table[:, 0]]
    left_out = _unhealthy(table[:, 1], names)
    satellites = []
    for name, elements in zip(names, table, strict=True):
        if name not in left_out:
            epoch_s = week * WEEK_S + elements[3]
            places_m = partial(_kepler, elements, epoch_s)
            satellites.append(Ephemeris(name, (epoch_s, epoch_s), places_m))
    return satellites, left_out


def _kepler(elements: np.ndarray, epoch_s: float, gps_s: np.ndarray) -> np.ndarray:
    """Return ``[N, 3]`` places of a satellite by the lines of an almanac, whose epoch is given, at ``[N]`` times."""
    eccentricity, toa_s, inclination, node_rate, axis_root, node, perigee, start = elements[2:10]
    since_s = gps_s - epoch_s
    anomaly = mean = start + np.sqrt(MU_M3_S2) / axis_root**3 * since_s
    for _ in range(10):  # each time the error shrinks by the eccentricity
        anomaly = mean + eccentricity * np.sin(anomaly)
    in_plane = np.cos(anomaly) - eccentricity + 1j * np.sqrt(1 - eccentricity**2) * np.sin(anomaly)
    to_node = axis_root**2 * in_plane * np.exp(1j * perigee)
    turn = node + node_rate * since_s - EARTH_RAD_S * (since_s + toa_s)
    level = (to_node.real + 1j * to_node.imag * np.cos(inclination)) * np.exp(1j * turn)
    return np.stack([level.real, level.imag, to_node.imag * np.sin(inclination)], axis=-1)


READERS = {  # by the first bytes of a file
    rb"\s*[234]\.\d+ +[NGH]": _broadcast,
    rb"#[a-d][PV]\d{4}": _sp3,
    rb"\s*\*+ *Week +\d+ +almanac": _yuma,
}
