"""Logs of a satellite receiver: tables of where it was, when, and what it received, to `ReceiverLog`."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.samples import located
from jaxurban.io.tables import read_table
from jaxurban.io.tracks import (
    AZIMUTH,
    CN0,
    ELEVATION,
    LAT,
    LIKE_THIS,
    LON,
    OTHER_UNITS,
    RULES,
    SATELLITE,
    UTC,
    Rule,
    by_text,
    checked,
    renamed,
)

OF_SATELLITES = (SATELLITE, CN0, AZIMUTH, ELEVATION)
EPOCH = "epoch"
MOST_NAMED = 12  # columns, in an error
MOST_ROWS = 5_000_000  # of satellites: three hours at 10 Hz with 45 of them; a study needs some 500 bytes for each
OF_LOGS = RULES | {
    AZIMUTH: Rule(0.0, 360.0),
    ELEVATION: Rule(0.0, 90.0, " (satellites below the horizon are no part of a log)"),
}
UNITS_OF_LOGS = (
    *OTHER_UNITS,
    ({AZIMUTH: math.tau}, "radians", "degrees"),
    ({ELEVATION: math.pi / 2}, "radians", "degrees"),
)
# RINEX 3.05, section 3.5: a constellation's letter and a number.
RINEX_NAME = re.compile(r"[GRECJIS]\d\d", re.ASCII)
REMEDY = (
    f"give a table with a row per satellite and the columns {UTC} (as {LIKE_THIS}), {LON}, {LAT}, {SATELLITE} and "
    f"{CN0}"
)


@dataclass(frozen=True, eq=False)
class ReceiverLog:
    """What a receiver recorded along its way. ``N`` epochs in the order of their times.

    Attributes:
      name: of the file.
      epochs: ``[N]`` rows ``utc`` (datetime64 with zone), ``lon_deg``, ``lat_deg`` (WGS 84).
      satellites: a row an epoch and satellite, in this order: ``epoch`` (int32, its row of ``epochs``), ``satellite``
        (a category of RINEX 3 names, such as G05), ``cn0_dbhz`` (float32; 0: above the horizon, not received) and,
        where the log has them, ``azimuth_deg`` (clockwise from true north) and ``elevation_deg`` (float32).
      left_out: satellites that have no row because their own navigation message calls them unhealthy, or is not there,
        and the reason of each.
    """

    name: str
    epochs: pd.DataFrame
    satellites: pd.DataFrame
    left_out: Mapping[str, str] = field(default_factory=dict)


def read_receiver_log(source: str | Path | pd.DataFrame) -> ReceiverLog:
    """Return a receiver's log, in the order of its times.

    Args:
      source: a table, or its file (.csv, .csv.gz, .parquet), with a row per satellite: ``utc``, ``lon_deg`` (or
        ``lon``), ``lat_deg`` (or ``lat``), ``satellite``, ``cn0_dbhz``, and ``azimuth_deg`` and ``elevation_deg`` if it
        has them.

    Raises:
      InputError: a file that cannot be read, no rows, a column that is missing or there twice, invalid times or
        of no known zone, invalid coordinates, two rows of one time (and satellite), two places of one time,
        values that no receiver gives or that are of another unit, or more rows than `MOST_ROWS`.
    """
    if isinstance(source, pd.DataFrame):
        return table_log(source, "the table")
    # Texts that many rows repeat take less room as categories.
    kinds = dict.fromkeys((UTC, SATELLITE), "category")
    return table_log(read_table(located(source), "receiver log", dtype=kinds), str(source))


def table_log(table: pd.DataFrame, name: str) -> ReceiverLog:
    """Return the log that a table holds; columns and errors as of `read_receiver_log`, ``name`` is that of its file."""
    what = f"the receiver log {name!r}"
    table = renamed(table)

    # Time and place, and what was received.
    columns = (UTC, LON, LAT, *OF_SATELLITES)
    known = [column for column in columns if column in table]
    if known[:5] != [*columns[:5]] or table.empty:
        names = ", ".join(map(str, table.columns[:MOST_NAMED]))
        raise InputError(
            f"{what} has {len(table)} rows of the columns {names}: {REMEDY}, separated by commas"
        )
    if len(table) > MOST_ROWS:
        thin = "thin it to fewer epochs, such as one a second, or cut it into parts"
        raise InputError(
            f"{what} has {len(table):,} rows, more than the {MOST_ROWS:,} that are read: {thin}"
        )
    table = checked(table, known, what, OF_LOGS, UNITS_OF_LOGS)
    return ReceiverLog(name, *_by_satellite(table, what))


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
    table[SATELLITE] = by_text(table[SATELLITE], _satellites, what)
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
