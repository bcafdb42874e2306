"""Logs of a satellite receiver: tables of where it was, when, and what it received, to `ReceiverLog`."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import MAXYEAR, MINYEAR
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.samples import located
from jaxurban.io.tables import read_table

UTC = "utc"
LON = "lon_deg"
LAT = "lat_deg"
ALTITUDE = "altitude_m"
OTHER_NAMES = {"lon": LON, "lat": LAT}
# What a log may hold of how well the receiver did.
WITNESSES = TRACKED, ERROR = ("num_tracked", "error_2d_m")
OF_SATELLITES = SATELLITE, CN0, AZIMUTH, ELEVATION = (
    "satellite",
    "cn0_dbhz",
    "azimuth_deg",
    "elevation_deg",
)
EPOCH = "epoch"
MOST_NAMED = 12  # columns, in an error
MOST_ROWS = 5_000_000  # of satellites: three hours at 10 Hz with 45 of them; a study needs some 500 bytes for each
RANGES = {  # of a value; no receiver has channels for more satellites, and none measures a C/N0 of 70 dBHz outdoors
    LON: (-180.0, 180.0),
    LAT: (-90.0, 90.0),
    ALTITUDE: (0.0, 20_000.0),
    TRACKED: (0.0, 200.0),
    ERROR: (0.0, np.inf),
    CN0: (0.0, 70.0),
    AZIMUTH: (0.0, 360.0),
    ELEVATION: (0.0, 90.0),
    "height_m": (-1000.0, 20_000.0),  # of a reference track, beside RINEX
    "gps_week": (1024.0, 10_000.0),  # not modulo 1024
    "gps_tow_s": (0.0, 604_800.0),
}
HINTS = {
    LAT: " (longitude and latitude may be swapped)",
    CN0: " (in dBHz; 0 means above the horizon and not received)",
    ELEVATION: " (satellites below the horizon are no part of a log)",
}
# Bounds that all values of a log keep only if they are of another unit. Degrees so small are a place in the Atlantic.
OTHER_UNITS = (
    ({LON: math.pi, LAT: math.pi / 2}, "radians", "degrees"),
    ({AZIMUTH: math.tau}, "radians", "degrees"),
    ({ELEVATION: math.pi / 2}, "radians", "degrees"),
    ({CN0: 9.0}, "the digits 1 to 9 of a signal's strength, or ratios", "dBHz"),
)
# RINEX 3.05, section 3.5: a constellation's letter and a number.
RINEX_NAME = re.compile(r"[GRECJIS]\d\d", re.ASCII)
# The zone of a time, behind its minutes or seconds; pandas reads all but the names.
ZONE = re.compile(r"(?:Z|UTC|GMT|:\d\d(?:\.\d+)?\s*[+-]\d\d(?::?\d\d)?)$", re.IGNORECASE)
LIKE_THIS = "2018-12-19T06:07:37Z"
TIME_REMEDY = (
    f"write UTC with a Z, as {LIKE_THIS} (GPS time is 18 s ahead of it since 2017), or local times with their offset, "
    "as 2018-12-19T15:07:37+09:00, and remove rows without a time"
)
REMEDY = (
    f"give a table with the columns {UTC} (as {LIKE_THIS}), {LON}, {LAT} and {' or '.join(WITNESSES)}, "
    f"or {SATELLITE} and {CN0}"
)


@dataclass(frozen=True, eq=False)
class ReceiverLog:
    """What a receiver recorded along its way. ``N`` epochs in the order of their times.

    Attributes:
      name: of the file.
      epochs: ``[N]`` rows ``utc`` (datetime64 with zone), ``lon_deg``, ``lat_deg`` (WGS 84), and where they are known
        ``num_tracked`` and ``error_2d_m``, NaN where a row does not say.
      satellites: None for a log of counts, else a row an epoch and satellite, in this order: ``epoch`` (int32, its row
        of ``epochs``), ``satellite`` (a category of RINEX 3 names, such as G05), ``cn0_dbhz`` (float32; 0: above the
        horizon, not received) and, where the log has them, ``azimuth_deg`` (clockwise from true north) and
        ``elevation_deg`` (float32).
      left_out: satellites that have no row because their own navigation message calls them unhealthy, or is not there,
        and the reason of each.
    """

    name: str
    epochs: pd.DataFrame
    satellites: pd.DataFrame | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def witnesses(self) -> tuple[str, ...]:
        """Columns of the epochs that show how well the receiver did."""
        return tuple(name for name in WITNESSES if name in self.epochs)


def read_receiver_log(source: str | Path | pd.DataFrame) -> ReceiverLog:
    """Return a receiver's log, in the order of its times.

    Args:
      source: a table, or its file (.csv, .csv.gz, .parquet), with ``utc``, ``lon_deg`` (or ``lon``), ``lat_deg`` (or
        ``lat``), and ``num_tracked``, ``error_2d_m`` or both; or with a row per satellite, ``satellite``, ``cn0_dbhz``,
        and ``azimuth_deg`` and ``elevation_deg`` if it has them.

    Raises:
      InputError: a file that cannot be read, no rows, a column that is missing or there twice, invalid times or
        of no known zone, invalid coordinates, two rows of one time (and satellite), two places of one time,
        values that no receiver gives or that are of another unit, or more rows than `MOST_ROWS`.
    """
    if isinstance(source, pd.DataFrame):
        return log_of(source, "the table")
    return log_of(
        read_table(located(source), "receiver log", categories=(UTC, SATELLITE)), str(source)
    )


def read_track(file: str | Path) -> pd.DataFrame:
    """Return the rows of a table's file as they stand: ``utc``, ``lon_deg``, ``lat_deg``, and ``altitude_m`` if given.

    Raises:
      InputError: a file that cannot be read, a column that is missing, or invalid values.
    """
    return track_of(read_table(file, "track"), f"the track file {str(file)!r}")


def track_of(table: pd.DataFrame, what: str) -> pd.DataFrame:
    """Return the rows of a table as `read_track` does, and raise its errors; ``what`` names the table in them."""
    table = renamed(table, OTHER_NAMES)
    columns = [column for column in (UTC, LON, LAT, ALTITUDE) if column in table]
    if columns[:3] != [UTC, LON, LAT] or table.empty:
        raise InputError(
            f"{what} must have rows of the columns {UTC}, {LON} and {LAT}, in a file separated by commas"
        )
    return checked(table, columns, what)


def log_of(table: pd.DataFrame, name: str) -> ReceiverLog:
    """Return the log that a table holds; columns and errors as of `read_receiver_log`, ``name`` is that of its file."""
    what = f"the receiver log {name!r}"
    table = renamed(table, OTHER_NAMES)
    has_satellites = SATELLITE in table and CN0 in table

    # Time and place, and one column at least of what was received.
    columns = (UTC, LON, LAT, *WITNESSES, *(OF_SATELLITES if has_satellites else ()))
    known = [column for column in columns if column in table]
    if known[:3] != [UTC, LON, LAT] or len(known) == 3 or table.empty:
        names = ", ".join(map(str, table.columns[:MOST_NAMED]))
        raise InputError(
            f"{what} has {len(table)} rows of the columns {names}: {REMEDY}, separated by commas"
        )
    if has_satellites and len(table) > MOST_ROWS:
        thin = "thin it to fewer epochs, such as one a second, or cut it into parts"
        raise InputError(
            f"{what} has {len(table):,} rows, more than the {MOST_ROWS:,} that are read: {thin}"
        )

    table = checked(table, known, what)
    if has_satellites:
        return ReceiverLog(name, *_by_satellite(table, what))
    table = table.sort_values(UTC, kind="stable", ignore_index=True)
    _check_once(table, [UTC], what, "rows", "row an epoch")
    return ReceiverLog(name, table)


def renamed(table: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """Return a table with the names of its columns stripped, and those of ``names`` replaced."""
    stripped = [str(column).strip() for column in table.columns]
    return table.set_axis([names.get(column, column) for column in stripped], axis="columns")


def checked(table: pd.DataFrame, columns: Sequence[str], what: str) -> pd.DataFrame:
    """Return columns of a table as times in UTC, numbers in float64, and others as they stand.

    Args:
      table: with all of the columns.
      columns: to return, in this order.
      what: names the table, and begins the message of an error.

    Raises:
      InputError: a column that is there twice, an invalid time, a number out of `RANGES`, or values of another unit.
    """
    for column in columns:
        if (table.columns == column).sum() > 1:
            raise InputError(f"{what} has two columns {column}: keep one")
    read = {column: _numbers(table[column], what) for column in columns if column in RANGES}
    if UTC in columns:
        read[UTC] = _by_text(table[UTC], _times, what)
    table = table[list(columns)].assign(**read)
    _check_units(table, what)
    return table


def _by_satellite(table: pd.DataFrame, what: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables ``epochs`` and ``satellites`` of a `ReceiverLog` from a table with a row per satellite.

    Args:
      table: as from `checked`.
      what: names the table, and begins the message of an error.

    Raises:
      InputError: an azimuth without elevation, an invalid name, two rows of one satellite or two places at one time.
    """
    if (AZIMUTH in table) != (ELEVATION in table):
        raise InputError(
            f"{what} has one of the columns {AZIMUTH} and {ELEVATION}: give both, or none"
        )
    number, _ = pd.factorize(table[UTC], sort=True)
    columns = [column for column in OF_SATELLITES if column in table]
    table = table.astype(dict.fromkeys(columns[1:], np.float32))
    table[EPOCH] = pd.Series(number, table.index, dtype=np.int32)
    table[SATELLITE] = _by_text(table[SATELLITE], _satellites, what)
    table = table.sort_values([EPOCH, SATELLITE], ignore_index=True)
    _check_once(
        table,
        [EPOCH, SATELLITE],
        what,
        "rows",
        "row an epoch and satellite, such as that of L1, E1 or B1",
    )
    epochs = table.drop(columns=[EPOCH, *columns]).drop_duplicates(ignore_index=True)
    _check_once(epochs, [UTC], what, "places", "place an epoch")
    return epochs, table[[EPOCH, *columns]]


def _check_once(table: pd.DataFrame, key: list[str], what: str, twice: str, remedy: str) -> None:
    """Raise InputError where two rows have one key.

    Args:
      table: with a column of times.
      key: columns that name a row together.
      what: names the table, and begins the message.
      twice: what there are two of, for the message.
      remedy: of what to keep one, and for what.
    """
    is_second = table.duplicated(key)
    if is_second.any():
        row = table[is_second].iloc[0]
        whose = f" of {row[SATELLITE]}" if SATELLITE in key else ""
        raise InputError(
            f"{what} has two {twice}{whose} at {row[UTC].isoformat()}: keep one {remedy}"
        )


def _check_units(table: pd.DataFrame, what: str) -> None:
    """Raise InputError where all values of a column are as small as they would be in another unit (`OTHER_UNITS`).

    Columns that are all 0 pass. ``what`` begins the message.
    """
    for bounds, unit, needed in OTHER_UNITS:
        columns = [column for column in bounds if column in table]
        largest = {column: float(table[column].abs().max()) for column in columns}
        is_small = [0 < largest[column] <= bounds[column] for column in columns]
        if is_small and all(is_small):  # all 0 is 0 in any unit
            most = " and ".join(
                f"{column} of at most {value:.4g}" for column, value in largest.items()
            )
            raise InputError(
                f"{what} has {most} in all rows, as if they were {unit}: give {needed}"
            )


def _by_text(
    column: pd.Series, read: Callable[[pd.Series, str], pd.Series], what: str
) -> pd.Series:
    """Return a column as ``read`` reads it from texts or times; each value is read once, as a log repeats many.

    Args:
      column: ``[N]`` of any kind.
      read: takes the distinct values and ``what``, and returns what they are read as.
      what: names the table, for messages.
    """
    is_compact = isinstance(column.dtype, pd.DatetimeTZDtype | pd.CategoricalDtype)
    numbers, values = pd.factorize(
        column if is_compact else column.astype(str), use_na_sentinel=False
    )
    return read(pd.Series(values), what).take(numbers).set_axis(column.index)


def _satellites(column: pd.Series, what: str) -> pd.Series:
    """Return names of satellites as a category; InputError, which begins with ``what``, of what is no RINEX 3 name."""
    names = column.astype(str).str.strip()
    is_wrong = ~names.str.fullmatch(RINEX_NAME, na=False)
    if is_wrong.any():
        needed = "a name as in RINEX 3, such as G05, R12, E18, C19 or J02, belongs"
        raise InputError(
            f"{what} has {str(names[is_wrong].iloc[0])!r} as a satellite, where {needed}: rename or remove it"
        )
    return names.astype("category")


def _times(column: pd.Series, what: str) -> pd.Series:
    """Return times in UTC; text must say its zone, and so must the times of a Parquet file.

    Raises:
      InputError: a value that is no time, or without a zone; ``what`` begins the message.
    """
    texts = column.astype(str).str.strip()
    if isinstance(column.dtype, pd.DatetimeTZDtype):
        times = column.dt.tz_convert("UTC")
    else:
        zoned = texts.where(texts.str.contains(ZONE, na=False))
        iso = zoned.str.replace(r"\s*(?:UTC|GMT)$", "Z", case=False, regex=True)
        times = pd.to_datetime(iso, utc=True, format="ISO8601", errors="coerce")
    is_wrong = ~times.dt.year.between(MINYEAR, MAXYEAR)  # nor is a time that is missing
    if is_wrong.any():
        why = "which is none or without a zone and may be a local one"
        raise InputError(
            f"{what} has {str(texts[is_wrong].iloc[0])!r} as a time, {why}: {TIME_REMEDY}"
        )
    return times


def _numbers(column: pd.Series, what: str) -> pd.Series:
    """Return a column of numbers as float64.

    Only columns of `WITNESSES` may lack values, not all of them; these are NaN.

    Raises:
      InputError: a value that is no number or out of the column's range; ``what`` begins the message.
    """
    low, high = RANGES[str(column.name)]
    values = pd.to_numeric(column, errors="coerce").astype(float)
    may_lack = column.name in WITNESSES and bool(column.notna().any())
    is_wrong = ~(np.isfinite(values) & values.between(low, high) | (column.isna() & may_lack))
    is_wrong |= pd.api.types.is_bool_dtype(column)
    if is_wrong.any():
        wrong = column[is_wrong].tolist()  # a list's numbers are Python's
        hint = HINTS.get(str(column.name), "")
        raise InputError(
            f"{what} has {wrong[0]!r} in {column.name} of {len(wrong)} row(s), where a number from {low:g} to {high:g} "
            f"belongs{hint}: mend them, or remove the rows or the column"
        )
    return values
