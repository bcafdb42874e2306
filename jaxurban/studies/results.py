"""A study as a value: its tables, whose columns have units, and its pictures, which a notebook shows."""

from pathlib import Path
from typing import Any, Unpack

import pandas as pd

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.results import Result
from jaxurban.pictures import MapForm

SHARES = (
    *("share", "changes", "regret", "regret_alone", "more_cost", "overlap"),
    *("is_other", "nominal_regret", "nominal_is_closed"),
)
FACTORS = ("nearest", "below", "above", "first", "factor")
# Of columns whose names do not end in a unit, by the name without its weight (":gps") and the end of an interval.
UNITS = {
    **dict.fromkeys((*SHARES, "elasticity", "together"), "share, of 1"),
    **dict.fromkeys(FACTORS, "times the weight"),
    **dict.fromkeys(("size", "solved", "proven", "gap", "cost_change"), "%"),
    **dict.fromkeys(("cheapest", "above_median", "above_p95", "above_most"), "%"),
    **dict.fromkeys(("no_way", "blocked", "budget"), "pairs"),
    **dict.fromkeys(("people_below", "more_people_below"), "people"),
}


class StudyResult(Result):
    """Base of the result of a study, which shows itself in a notebook."""

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables of the report by name; their ``attrs["units"]`` are `UNITS`."""
        tables = self.report.tables
        return with_units({Path(name).stem: table for name, table in tables.items()})

    @typed
    def plot(self, name: str = "", **form: Unpack[MapForm]) -> Any:
        """Return a picture of the report, which a notebook shows.

        Args:
          name: of the picture, as in the folder ``figures``; left out, the error lists them.
          form: width, ax, title and, of maps, cmap, as in `MetricMaps.plot`.

        Returns:
          A Matplotlib figure, or the part of one.

        Raises:
          InputError: no name, or one that no picture of the study has, or axes that are no cell of a grid.
        """
        figures = self.report.figures
        if name not in figures:
            drawn = ", ".join(figures) or "none"
            missing = f"the study has no picture {name!r}" if name else "no picture is named"
            raise InputError(f"{missing}: name one of the study's own ({drawn})")
        return figures[name](**form)


class Tables(dict[str, pd.DataFrame]):
    """Tables by name."""

    def __missing__(self, name: str) -> pd.DataFrame:
        """Raise InputError, which names those that the study has."""
        raise InputError(
            f"the study has no table {name!r}, whose routes it did not find or was not asked for: it has "
            f"{', '.join(self)}"
        )


def with_units(tables: dict[str, pd.DataFrame]) -> Tables:
    """Return tables whose attributes hold `UNITS`."""
    for table in tables.values():
        table.attrs["units"] = UNITS
    return Tables(tables)
