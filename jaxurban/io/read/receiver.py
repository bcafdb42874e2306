"""Logs of a satellite receiver: tables of where it was, when, and what it tracked, to `ReceiverLog`."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.tables import read_table

UTC, LON, LAT = "utc", "lon_deg", "lat_deg"
OTHER_NAMES = {"lon": LON, "lat": LAT}
WITNESSES = TRACKED, ERROR = "num_tracked", "error_2d_m"  # what a log may hold of how well the receiver did
MOST_NAMED = 12  # columns, in an error
RANGES = {  # of a value; no receiver has channels for more satellites
    LON: (-180.0, 180.0),
    LAT: (-90.0, 90.0),
    TRACKED: (0.0, 200.0),
    ERROR: (0.0, np.inf),
}
# The zone of a time, behind its minutes or seconds; pandas reads all but the names.
ZONE = re.compile(r"(?:Z|UTC|GMT|:\d\d(?:\.\d+)?\s*[+-]\d\d(?::?\d\d)?)$", re.IGNORECASE)
LIKE_THIS = "2018-12-19T06:07:37Z"
TIME_REMEDY = (
    f"write UTC with a Z, as {LIKE_THIS} (GPS time is 18 s ahead of it since 2017), or local times with their offset, "
    "as 2018-12-19T15:07:37+09:00, and remove rows without a time"
)
REMEDY = f"give a table with the columns {UTC} (as {LIKE_THIS}), {LON}, {LAT} and {' or '.join(WITNESSES)}"


@dataclass(frozen=True, eq=False)
class ReceiverLog:
    """What a receiver recorded along its way. ``N`` epochs in the order of their times.

    Attributes:
      name: of the file.
      epochs: ``[N]`` rows ``utc`` (datetime64 with zone), ``lon_deg``, ``lat_deg`` (WGS 84), and where they are known
        ``num_tracked`` and ``error_2d_m``, NaN where a row does not say.
    """

    name: str
    epochs: pd.DataFrame

    @property
    def witnesses(self) -> tuple[str, ...]:
        """Columns of the epochs that show how well the receiver did."""
        return tuple(name for name in WITNESSES if name in self.epochs)


def read_receiver_log(source: str | Path | pd.DataFrame) -> ReceiverLog:
    """Return a receiver's log, a row an epoch.

    Args:
      source: a table, or its file (.csv, .parquet), with ``utc``, ``lon_deg`` (or ``lon``), ``lat_deg`` (or ``lat``)
        and ``num_tracked``, ``error_2d_m`` or both.

    Raises:
      InputError: a file that cannot be read, no rows, a column that is missing or there twice, times that are none or
        of no known zone, coordinates that are none, two rows of one time, or values that no receiver gives.
    """
    table = source if isinstance(source, pd.DataFrame) else read_table(source, "receiver log")
    name = "the table" if table is source else str(source)
    names = [str(column).strip() for column in table.columns]
    table = table.set_axis([OTHER_NAMES.get(column, column) for column in names], axis="columns")
    known = [column for column in (UTC, *RANGES) if column in table]
    if known[:3] != [UTC, LON, LAT] or len(known) == 3 or table.empty:
        raise _wrong(
            name, f"has {len(table)} rows of the columns {', '.join(names[:MOST_NAMED])}: {REMEDY}, separated by commas"
        )
    if twice := [column for column in known if (table.columns == column).sum() > 1]:
        raise _wrong(name, f"has two columns {twice[0]}: keep one")
    table = table.assign(**{UTC: _times(table[UTC], name)}, **{c: _numbers(table[c], name) for c in known[1:]})
    table = table.sort_values(UTC, kind="stable", ignore_index=True)
    if (is_second := table[UTC].duplicated()).any():
        at = table[UTC][is_second].iloc[0].isoformat()
        raise _wrong(name, f"has two rows at {at}: keep one row an epoch")
    return ReceiverLog(name, table[known])


def _wrong(name: str, why: str) -> InputError:
    return InputError(f"the receiver log {name!r} {why}")


def _times(column: pd.Series, name: str) -> pd.Series:
    """Return times in UTC; text must say its zone, and so must the times of a Parquet file."""
    texts = column.astype(str).str.strip()
    if isinstance(column.dtype, pd.DatetimeTZDtype):
        times = column.dt.tz_convert("UTC")
    else:
        zoned = texts.where(texts.str.contains(ZONE, na=False))
        iso = zoned.str.replace(r"\s*(?:UTC|GMT)$", "Z", case=False, regex=True)
        times = pd.to_datetime(iso, utc=True, format="ISO8601", errors="coerce")
    if (is_wrong := times.isna()).any():
        why = "which is none or without a zone and may be a local one"
        raise _wrong(name, f"has {str(texts[is_wrong].iloc[0])!r} as a time, {why}: {TIME_REMEDY}")
    return times


def _numbers(column: pd.Series, name: str) -> pd.Series:
    """Return a column of numbers, NaN where a receiver gave none; no place may lack any, nor all of a witness."""
    low, high = RANGES[str(column.name)]
    values = pd.to_numeric(column, errors="coerce").astype(float)
    may_lack = column.name in WITNESSES and bool(column.notna().any())
    is_wrong = ~(np.isfinite(values) & values.between(low, high) | (column.isna() & may_lack))
    if (is_wrong | pd.api.types.is_bool_dtype(column)).any():
        wrong = column[is_wrong | pd.api.types.is_bool_dtype(column)].tolist()  # a list's numbers are Python's
        hint = " (longitude and latitude may be swapped)" if column.name == LAT else ""
        rule = f"where a number from {low:g} to {high:g} belongs{hint}: mend them, or remove the rows or the column"
        raise _wrong(name, f"has {wrong[0]!r} in {column.name} of {len(wrong)} row(s), {rule}")
    return values
