"""Receivers' own logs: RINEX observations, NMEA and Android's GnssLogger, as tables of satellites by time and place."""

import re
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, readable, warn
from jaxurban.io.ephemerides import (
    J2000_S,
    WEEK_S,
    check_time_scale,
    library,
    loaded,
    utc_of,
)
from jaxurban.io.samples import located
from jaxurban.io.sniff import HEAD_BYTES, sniff, unpacked
from jaxurban.io.tables import read_table
from jaxurban.io.tracks import (
    AZIMUTH,
    CN0,
    ELEVATION,
    HEIGHT,
    LAT,
    LON,
    RULES,
    SATELLITE,
    UTC,
    Rule,
    checked,
    fixes_of,
    renamed,
)
from jaxurban.progress import LOG
from jaxurban.world.grid import transformer

OBSERVED = "observed"  # a time
MATCH_S = 0.02  # most between the times of a reference and of its observation: clocks are kept to some milliseconds
FIX_S = 0.5  # most between a fix of GnssLogger and its measurements
WEEK = "gps_week"
TOW = "gps_tow_s"
TRACK = LON, LAT, HEIGHT
OF_REFERENCE = RULES | {
    HEIGHT: Rule(-1000.0, 20_000.0),
    WEEK: Rule(1024.0, 10_000.0),  # not modulo 1024
    TOW: Rule(0.0, WEEK_S),
}
EVENTS = 2  # an epoch with this flag or a higher one marks an event and holds no observation
SENTENCE = re.compile(r"\$([A-Z]{2})(RMC|GGA|GNS|GLL|GSV),([^*$\r\n]*)\*?(\w{0,2})", re.ASCII)
# Sentences that say that there is no fix: status V, and the modes none, estimated, by hand and simulated.
NO_FIX_SAID = re.compile(
    "RMC,(?:[^,]*,V|(?:[^,]*,){11}[NEMS])|GGA,(?:[^,]*,){5}[0678]?,|GNS,(?:[^,]*,){5}[NEMS]*,|"
    "GLL,(?:[^,]*,){5}(?:V|A,[NEMS])"
)
# Of each system by its letter in RINEX: talkers of NMEA and ConstellationType of Android, what their numbers exceed
# RINEX's by where they are larger, and the largest number in RINEX.
SYSTEMS = {
    "G": ("GP 1", 0, 32),
    "R": ("GL 3", 64, 27),
    "E": ("GA 6", 300, 36),
    "C": ("GB BD 5", 200, 63),
    "J": ("GQ QZ 4", 192, 10),
    "I": ("GI 7", 0, 14),
    "S": ("2", 100, 58),
}
NO_FIX = -1  # GSV have a place where the RMC before them has one
LEAST_L1_HZ = 1.5e9
OF_FIXES = {  # of GnssLogger, from version 3 on and before
    "LatitudeDegrees": LAT,
    "Latitude": LAT,
    "LongitudeDegrees": LON,
    "Longitude": LON,
    "UnixTimeMillis": UTC,
    "(UTC)TimeInMs": UTC,
}


Heard = tuple[
    pd.DataFrame, pd.DataFrame
]  # a row an epoch and satellite, and the file's own places by time


def read_log(
    file: str | Path, reference: str | Path | pd.DataFrame | None = None
) -> pd.DataFrame | None:
    """Return what a receiver wrote itself: RINEX observations 2 to 4, CRINEX, NMEA or GnssLogger, plain or as .gz.

    Args:
      file: of the log; its content decides what it is.
      reference: places of the antenna, see `read_reference`; left out, those of the file: fixes of NMEA and GnssLogger,
        of RINEX the approximate position of its header.

    Returns:
      A row an epoch and satellite, with the columns ``utc``, ``lon_deg``, ``lat_deg``, ``height_m`` (ellipsoidal) if it
      is known, ``satellite`` (as in RINEX 3), ``cn0_dbhz`` (the strongest of L1, E1 and B1, of NMEA of all signals; 0
      where there is none) if the file has it, and of NMEA ``azimuth_deg`` and ``elevation_deg``; without satellites a
      row a place. None for other files.

    Warns:
      UserWarning: sentences or satellites that are left out, and a position that is taken for all epochs.

    Raises:
      InputError: a file that is cut or damaged or holds no observation, no place, or no time in common with the
        reference; RINEX without sidereon.
    """
    path = located(file)
    if sniff(path) in (".txt", ".parquet"):
        return None
    what = f"the receiver log {str(file)!r}"
    with (
        readable(path, "a log", "convert or download it again", LookupError, TypeError, what=what),
        unpacked(path) as plain,
    ):
        data = plain.read_bytes()
        head = data[:HEAD_BYTES]
        reader = next((read for mark, read in READERS.items() if re.search(mark, head)), None)
        if reader is None:
            return None
        rows, track = reader(data.decode("utf-8", "replace"), what)
    if reference is not None:
        return _placed(rows, read_reference(reference), MATCH_S, what)
    if track.empty:
        raise InputError(f"{what} holds no place: give a table of the antenna's as the reference")
    if reader is _rinex:
        warn(
            f"{what} is placed at its APPROX POSITION XYZ throughout: give the reference of an antenna that moved"
        )
    return _placed(rows, fixes_of(track, what), FIX_S, what)


def _placed(rows: pd.DataFrame, track: pd.DataFrame, within_s: float, what: str) -> pd.DataFrame:
    """Return rows of satellites at the places of a track, each with the observation that is nearest in time.

    Args:
      rows: a row an epoch and satellite; empty for the track alone.
      track: places by time.
      within_s: most between the two times.
      what: begins the message.

    Raises:
      InputError: no observation is near enough to a place.
    """
    if rows.empty:
        return track
    track, rows = (each.astype({UTC: "datetime64[us, UTC]"}) for each in (track, rows))
    rows = rows.rename(columns={UTC: OBSERVED}).sort_values(OBSERVED, kind="stable")
    pairs = pd.merge_asof(
        rows[[OBSERVED]].drop_duplicates(),
        track.sort_values(UTC),
        left_on=OBSERVED,
        right_on=UTC,
        tolerance=pd.Timedelta(seconds=within_s),
        direction="nearest",
    )
    pairs = pairs.dropna(subset=UTC).drop_duplicates(UTC)
    if pairs.empty:
        raise InputError(
            f"{what} begins at {rows[OBSERVED].iloc[0]}, its places at {track[UTC].min()}, and no epoch is in common "
            f"within {within_s:g} s: give the places of the same drive"
        )
    num_lost = rows[OBSERVED].nunique() - len(pairs)
    if num_lost:
        LOG.info(f"{num_lost} epochs of {what} are left out, without a place within {within_s:g} s")
    return pairs.merge(rows).drop(columns=OBSERVED)


def read_reference(reference: str | Path | pd.DataFrame) -> pd.DataFrame:
    """Return the columns ``utc``, ``lon_deg``, ``lat_deg`` and ``height_m`` of a reference track.

    Its columns are named so, or ``lon``, ``longitude_deg``, ``lat``, ``latitude_deg``, ``ellipsoid_height_m``, and for
    the time ``gps_week`` (not modulo 1024) and ``gps_tow_s``. Capital letters, blanks and brackets do not matter:
    ``GPS TOW (s)`` is ``gps_tow_s``.

    Args:
      reference: the table or its file.

    Raises:
      InputError: a file that cannot be read, no such columns, or values out of range.
    """
    what = "the reference track"
    table = reference
    if not isinstance(table, pd.DataFrame):
        table = read_table(located(table), "reference track")
    table = renamed(table)
    times = [UTC] if UTC in table else [WEEK, TOW]
    if table.empty or not {*times, *TRACK} <= set(table):
        raise InputError(
            f"{what} has {len(table)} rows of the columns {', '.join(map(str, table.columns))}: give {UTC}, or {WEEK} "
            f"and {TOW}, and {', '.join(TRACK)} (above the ellipsoid)"
        )
    table = checked(table, [*times, *TRACK], what, OF_REFERENCE)
    if UTC not in table:
        table[UTC] = utc_of((table[WEEK] * WEEK_S + table[TOW]).to_numpy())
    return fixes_of(table[[UTC, *TRACK]], what)


def _rinex(text: str, what: str) -> Heard:
    """Return the observations of a file of RINEX or CRINEX.

    Raises:
      InputError: it is cut or damaged, not in GPS time, or without observations.
    """
    if "COMPACT RINEX" in text.partition("\n")[0]:
        text = loaded("load_crinex", text)
    file = loaded("load_rinex_obs", text)
    header = file.header
    check_time_scale(
        header.time_of_first_obs[1].abbrev if header.time_of_first_obs else "no time", what
    )
    observables = []
    for number, epoch in enumerate(file.epochs):
        time = epoch.epoch
        if epoch.flag < EVENTS and time is not None:
            time_s = library().j2000_seconds(
                time.year, time.month, time.day, time.hour, time.minute, time.second
            )
            series = file.observation_values(number)
            columns = {UTC: J2000_S + time_s, SATELLITE: series.satellites, CN0: series.values}
            observables.append(pd.DataFrame(columns, series.codes))
    if not observables:
        raise InputError(f"{what} holds no observation: name another file")
    rows = pd.concat(observables)
    rows[UTC] = utc_of(rows[UTC].to_numpy())

    # Of its observables C/N0 of L1, E1 and B1 (RINEX 3.05, tables 4 to 10), of which a value may be missing.
    codes = rows[SATELLITE].str[0] + rows.index
    strengths = rows[codes.str.match("[^C]S1|CS[12]")].fillna({CN0: 0.0})
    rows = rows.drop(columns=CN0) if strengths.empty else strengths

    # The antenna's approximate position, if there is one.
    track = pd.DataFrame({UTC: rows[UTC].unique()})
    if not np.any(header.approx_position_m):  # None or zeros
        return _whole(rows, what), track.iloc[:0]
    to_lonlat = transformer("EPSG:4978", "EPSG:4979")
    track[[*TRACK]] = to_lonlat.transform(*header.approx_position_m)
    return _whole(rows, what), track


def _nmea(text: str, what: str) -> Heard:
    """Return satellites by GSV, each at the time and place of the RMC before it.

    Raises:
      InputError: no RMC gives a date and a place.
    """
    fixes: list[tuple] = []
    seen = []
    fix = NO_FIX
    num_bad = 0
    voided = set()
    for talker, kind, body, checksum in SENTENCE.findall(text):
        if kind == "RMC":
            fix = NO_FIX  # so that no satellite is heard at the time of the one before
        if f"{reduce(xor, f'{talker}{kind},{body}'.encode()):02X}" != checksum.upper():
            num_bad += 1
            continue
        fields = body.split(",")
        if NO_FIX_SAID.match(f"{kind},{body}"):
            voided.add(fields[4 if kind == "GLL" else 0])
        if kind == "RMC" and len(fields) > 8 and fields[0] and fields[2] and fields[8]:
            fix = len(fixes)
            clock = f"{fields[8]}{float(fields[0]):013.6f}"
            place = _degrees(*fields[4:6]), _degrees(*fields[2:4])
            fixes.append((clock, *place, fields[0]))
        elif kind == "GSV":
            groups = zip(*[iter(fields[3:])] * 4, strict=False)  # a signal's number may remain
            seen += [(fix, talker, *group) for group in groups]
    if num_bad:
        warn(f"{what} has {num_bad} sentences with a wrong checksum or none, which are left out")
    if not fixes:
        raise InputError(
            f"{what} has no RMC sentence with a date and a place, and GGA has no date: switch RMC on in the receiver"
        )
    track = pd.DataFrame(fixes, columns=[UTC, LON, LAT, "clock"])
    track[UTC] = pd.to_datetime(track[UTC], format="%d%m%y%H%M%S.%f", utc=True)
    track.loc[track.pop("clock").isin(voided)] = np.nan

    columns = ["fix", "talker", SATELLITE, ELEVATION, AZIMUTH, CN0]
    gsv = pd.DataFrame(seen, columns=columns)
    numbers = gsv[columns[2:]].apply(pd.to_numeric, errors="coerce")
    rows = numbers.assign(**{UTC: gsv["fix"].map(track[UTC])}).fillna({CN0: 0.0})
    rows[SATELLITE] = list(map(_name, gsv["talker"], numbers[SATELLITE]))
    rows[ELEVATION] = rows[ELEVATION].where(rows[ELEVATION] >= 0)
    return _whole(rows, what), track


def _degrees(text: str, side: str) -> float:
    """Return degrees of NMEA's degrees and minutes, ``dddmm.mmm``, negative to the south and the west."""
    number = float(text)
    degrees = number // 100 + number % 100 / 60
    return -degrees if side in ("S", "W") else degrees


def _gnss_logger(text: str, what: str) -> Heard:
    """Return measurements (``Raw``) of L1, E1 and B1, and places (``Fix``) of the provider GPS.

    Raises:
      ValueError: lines or columns are missing.
    """
    raw = _lines(text, "Raw")
    fixes = _lines(text, "Fix").rename(columns=OF_FIXES)
    fixes = fixes[fixes["Provider"].str.lower() == "gps"].dropna(subset=[LON, LAT, UTC])
    track = fixes[[LON, LAT]].assign(**{UTC: pd.to_datetime(fixes[UTC], unit="ms", utc=True)})

    raw = raw[~(raw["CarrierFrequencyHz"] < LEAST_L1_HZ)]
    bias_ns = raw["FullBiasNanos"] + raw["BiasNanos"].fillna(0.0)
    keys = raw["ConstellationType"].map("{:.0f}".format)
    columns = {
        UTC: raw["TimeNanos"] - bias_ns,
        SATELLITE: list(map(_name, keys, raw["Svid"])),
        CN0: raw["Cn0DbHz"],
    }
    rows = _whole(pd.DataFrame(columns), what)
    return rows.assign(**{UTC: utc_of(rows[UTC].to_numpy() / 1e9)}), track


def _lines(text: str, kind: str) -> pd.DataFrame:
    """Return the numbers in lines of a kind of a GnssLogger file by the columns that its comment names.

    Beside them ``Provider`` is the text of the second column, which it is in lines of places.
    """
    lines = re.findall(rf"^(?:# *)?({kind},.*)$", text, re.MULTILINE)
    table = pd.Series(lines, dtype=str).str.split(",", expand=True)
    table = table.iloc[1:].set_axis(table.iloc[0].str.strip(), axis="columns")
    return table.apply(pd.to_numeric, errors="coerce").assign(Provider=table.iloc[:, 1])


def _name(key: str, number: float) -> str | None:
    """Return the name as in RINEX 3 of a talker or type and a number (`SYSTEMS`), None where there is none."""
    for letter, (known, offset, most) in SYSTEMS.items():
        own = number - offset if number > offset else number
        if key in known.split() and 1 <= own <= most:
            return f"{letter}{own:02.0f}"
    return None


def _whole(rows: pd.DataFrame, what: str) -> pd.DataFrame:
    """Return a row an epoch and satellite, of several the strongest, and warn of rows that lack something."""
    whole = rows.dropna()
    if len(whole) < len(rows):
        warn(
            f"{what} has {len(rows) - len(whole)} of {len(rows)} measurements without a time, a direction or a number "
            "that is known, which are left out"
        )
    return whole.groupby([UTC, SATELLITE], as_index=False).max()


READERS = {  # by what is in the first bytes of a file
    rb"\A *[234]\.\d+ +O|\A[\d.]+ +COMPACT RINEX": _rinex,
    rb"(?m)^(# *)?Raw,": _gnss_logger,
    rb"(?m)^(NMEA,)?\$[A-Z]{2}(RMC|GGA|GSV),": _nmea,  # Raw lines may stand beside them
}
