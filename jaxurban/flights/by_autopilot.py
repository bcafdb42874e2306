"""Checks of one mission as each autopilot flies it: the worse counts, and what one alone meets is named by it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pandas as pd

from jaxurban.flights.check_result import MissionCheck, flown_by
from jaxurban.flights.item_returns import by_item, return_lines

ALONG = ["along_m", "to_m", "autopilot"]  # by which findings differ that are one
DECIMALS = 6


def worse_of(
    checks: Mapping[str, MissionCheck], departures: pd.DataFrame, ceiling_m: int
) -> MissionCheck:
    """Return checks, by the autopilot that flies the mission, as one: that with the most findings, and the others'.

    Args:
      checks: without returns.
      departures: from which the mission may return, by any of the autopilots (`departures_of`).
      ceiling_m: above the ground at home, which no return altitude to type exceeds.
    """
    worst = max(checks.values(), key=lambda check: len(check.findings))
    found, unknown = {}, {}
    for name, check in checks.items():
        found[name] = check.findings
        unknown[name] = pd.DataFrame({"what": check.not_judged})
    not_judged = _as_one(unknown)
    return replace(
        worst,
        findings=_as_one(found),
        not_judged=[*map(flown_by, not_judged["autopilot"], not_judged["what"])],
        return_altitudes=by_item(departures),
        return_lines=return_lines(departures, worst.flight, ceiling_m),
    )


def joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of tables; empty ones are left out, since their columns would change the types of the others."""
    return pd.concat([table for table in tables if len(table)] or tables[:1], ignore_index=True)


def _as_one(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of tables, each once, with the only autopilot that has it, ``""`` for one of all."""
    rows = joined([table.assign(autopilot=name) for name, table in tables.items()])
    values = rows.drop(columns=ALONG, errors="ignore").round(DECIMALS)
    rows["autopilot"] = rows["autopilot"].mask(values.duplicated(keep=False), "")
    return rows[~values.duplicated()].reset_index(drop=True)
