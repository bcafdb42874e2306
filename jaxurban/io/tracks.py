"""Tables of times and places, such as tracks and receivers' logs, whose columns are checked by rules."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import MAXYEAR, MINYEAR
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, warn
from jaxurban.io.tables import read_table

UTC = "utc"
LON = "lon_deg"
LAT = "lat_deg"
ALTITUDE = "altitude_m"
HEIGHT = "height_m"
OTHER_NAMES = {  # of columns, in small letters with _ for what is no letter
    **dict.fromkeys(("lon", "longitude", "longitude_deg"), LON),
    **dict.fromkeys(("lat", "latitude", "latitude_deg"), LAT),
    **dict.fromkeys(("ellipsoid_height_m", "ellipsoidal_height_m"), HEIGHT),
}
SATELLITE = "satellite"
CN0 = "cn0_dbhz"
AZIMUTH = "azimuth_deg"
ELEVATION = "elevation_deg"
OtherUnits = Sequence[tuple[Mapping[str, float], str, str]]


class Rule(NamedTuple):
    """What the numbers of a column may be.

    Attributes:
      low, high: the ends of their range.
      hint: ends the message on a number that is not in it.
      may_lack: some rows may hold no number; not all of them.
    """

    low: float
    high: float
    hint: str = ""
    may_lack: bool = False


RULES = {
    LON: Rule(-180.0, 180.0),
    LAT: Rule(-90.0, 90.0, " (longitude and latitude may be swapped)"),
    ALTITUDE: Rule(0.0, 20_000.0),
    # No receiver measures a C/N0 of 70 dBHz outdoors.
    CN0: Rule(0.0, 70.0, " (in dBHz; 0 means above the horizon and not received)"),
}
# Bounds that all values of a table keep only if they are of another unit, that unit, and the one that is needed.
# Degrees so small are a place in the Atlantic.
OTHER_UNITS: OtherUnits = (
    ({LON: math.pi, LAT: math.pi / 2}, "radians", "degrees"),
    ({CN0: 9.0}, "the digits 1 to 9 of a signal's strength, or ratios", "dBHz"),
)
# The zone of a time, behind its minutes or seconds; pandas reads all but the names.
ZONE = re.compile(r"(?:Z|UTC|GMT|:\d\d(?:\.\d+)?\s*[+-]\d\d(?::?\d\d)?)$", re.IGNORECASE)
ROLLOVER = pd.Timedelta(weeks=1024)
ROLLED_OVER = pd.Timestamp(
    "2010-01-01", tz="UTC"
)  # a receiver that has rolled over dates all until 2029 before it
LIKE_THIS = "2018-12-19T06:07:37Z"
TIME_REMEDY = (
    f"write UTC with a Z, as {LIKE_THIS} (GPS time is 18 s ahead of it since 2017), or local times with their offset, "
    "as 2018-12-19T15:07:37+09:00, and remove rows without a time"
)


def read_track(file: str | Path) -> pd.DataFrame:
    """Return the rows of a table's file as they stand: ``utc``, ``lon_deg``, ``lat_deg``, and if given others.

    These are ``altitude_m``, and of a receiver's log with a row a satellite ``satellite`` and ``cn0_dbhz``.

    Raises:
      InputError: a file that cannot be read, a column that is missing, or invalid values.
    """
    return track_of(read_table(file, "track"), f"the track file {str(file)!r}")


def track_of(table: pd.DataFrame, what: str) -> pd.DataFrame:
    """Return the rows of a table as `read_track` does, and raise its errors; ``what`` names the table in them."""
    table = renamed(table)
    if "datetime_utc" in table:  # of AirData
        table[UTC] = table["datetime_utc"].astype(str) + "Z"
    columns = [column for column in (UTC, LON, LAT, ALTITUDE, SATELLITE, CN0) if column in table]
    if columns[:3] != [UTC, LON, LAT] or table.empty:
        raise InputError(
            f"{what} must have rows of the columns {UTC}, {LON} and {LAT}, in a file separated by commas"
        )
    return fixes_of(checked(table, columns, what), what)


def fixes_of(track: pd.DataFrame, what: str) -> pd.DataFrame:
    """Return the rows of a track that have a place; at 0, 0 receivers are that have no fix.

    Args:
      track: with the columns ``utc``, ``lon_deg`` and ``lat_deg``, NaN where there is no fix.
      what: names the track, and begins messages.

    Warns:
      UserWarning: how many rows are left out; times that look as if weeks were counted modulo 1024.

    Raises:
      InputError: no row has a place.
    """
    is_fix = track[[LON, LAT]].fillna(0.0).any(axis=1)
    fixes = track[is_fix].reset_index(drop=True)
    lost = f"{len(track) - len(fixes):,} of {len(track):,} places without a fix, at 0, 0 or by their own words"
    if fixes.empty:
        raise InputError(f"{what} has {lost}: record it again under the open sky")
    if len(fixes) < len(track):
        warn(f"{what} has {lost}, which are left out")
    first = fixes[UTC].min()
    if first < ROLLED_OVER:
        warn(
            f"{what} begins on {first:%Y-%m-%d}, whose sky is taken: if the receiver counts weeks modulo 1024, it was "
            f"{first + ROLLOVER:%Y-%m-%d}; then give a table in which {UTC} is 1,024 weeks later"
        )
    return fixes


def renamed(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose columns are in small letters with ``_`` for what is no letter, and as `OTHER_NAMES` says."""
    names = [re.sub(r"\W+", "_", str(column).lower()).strip("_") for column in table.columns]
    return table.set_axis([OTHER_NAMES.get(name, name) for name in names], axis="columns")


def checked(
    table: pd.DataFrame,
    columns: Sequence[str],
    what: str,
    rules: Mapping[str, Rule] = RULES,
    other_units: OtherUnits = OTHER_UNITS,
) -> pd.DataFrame:
    """Return columns of a table as times in UTC, numbers in float64, and others as they stand.

    Args:
      table: with all of the columns.
      columns: to return, in this order.
      what: names the table, and begins the message of an error.
      rules: of the columns of numbers, by name.
      other_units: what columns look like in another unit, as `OTHER_UNITS`.

    Raises:
      InputError: a column that is there twice, an invalid time, a number against its rule, or values of another unit.
    """
    read = {}
    for column in columns:
        if (table.columns == column).sum() > 1:
            raise InputError(f"{what} has two columns {column}: keep one")
        if column in rules:
            read[column] = _numbers(table[column], rules[column], what)
        elif column == UTC:
            read[UTC] = by_text(table[UTC], _times, what)
    table = table[list(columns)].assign(**read)

    # Columns all of whose values are as small as they would be in another unit.
    for bounds, unit, needed in other_units:
        largest = {name: float(table[name].abs().max()) for name in bounds if name in table}
        # All 0 is 0 in any unit.
        if largest and all(0 < value <= bounds[name] for name, value in largest.items()):
            most = " and ".join(
                f"{column} of at most {value:.4g}" for column, value in largest.items()
            )
            raise InputError(
                f"{what} has {most} in all rows, as if they were {unit}: give {needed}"
            )
    return table


def by_text(column: pd.Series, read: Callable[[pd.Series, str], pd.Series], what: str) -> pd.Series:
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


def _numbers(column: pd.Series, rule: Rule, what: str) -> pd.Series:
    """Return a column of numbers as float64, NaN where one is lacking that may.

    Raises:
      InputError: a value that is no number or against the rule; ``what`` begins the message.
    """
    if column.dtype == object:  # arrays without a dimension become numbers
        column = column.map(lambda value: value if np.ndim(value) else np.asarray(value).item())
    values = pd.to_numeric(column, errors="coerce").astype(float)
    may_lack = rule.may_lack and bool(column.notna().any())
    is_right = np.isfinite(values) & values.between(rule.low, rule.high)
    is_wrong = ~(is_right | (column.isna() & may_lack))
    is_wrong |= pd.api.types.is_bool_dtype(column)
    if is_wrong.any():
        wrong = column[is_wrong].tolist()  # a list's numbers are Python's
        raise InputError(
            f"{what} has {wrong[0]!r} in {column.name} of {len(wrong)} row(s), where a number from {rule.low:g} to "
            f"{rule.high:g} belongs{rule.hint}: mend them, or remove the rows or the column"
        )
    return values
