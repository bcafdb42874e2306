"""Tables of one mission as each autopilot flies it, as one: what one alone meets is named by it."""

from collections.abc import Mapping, Sequence

import pandas as pd

# By which rows differ that are one.
ALONG = ["along_m", "to_m", "where", "autopilot"]
DECIMALS = 6


def concatenated(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of tables; empty ones are left out, since their columns would change the types of the others."""
    return pd.concat([table for table in tables if len(table)] or tables[:1], ignore_index=True)


def as_one(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of tables by autopilot, each once, with the only one that has it, ``""`` for one of all."""
    rows = concatenated([table.assign(autopilot=name) for name, table in tables.items()])
    values = rows.drop(columns=ALONG, errors="ignore").round(DECIMALS)
    rows["autopilot"] = rows["autopilot"].mask(values.duplicated(keep=False), "")
    return rows[~values.duplicated()].reset_index(drop=True)
