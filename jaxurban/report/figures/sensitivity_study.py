"""Pictures of a weight study over many routes: regrets by weight and city, breakpoints by altitude.

A row is a weight, and bars are intervals over pairs of places; a hollow mark has too few pairs for one.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from jaxurban.report.figures.metrics import line_colour
from jaxurban.report.figures.style import (
    FAINT_INK,
    MARKERS,
    SERIES_COLOURS,
    dots,
    legend_below,
    letter_all,
    name_rows,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.report.write import Figures
from jaxurban.studies.weights.summary import ALL

DOT_GAP = 0.18  # between dots of two cities, as a share of the distance between two weights
ROW_IN = 0.3  # height of a weight's row


def sensitivity_study_figures(tables: Mapping[str, pd.DataFrame], wrong: float) -> Figures:
    """Return what draws each figure, by file name."""
    return {
        "regret": partial(plot_regret, tables["summary"], wrong),
        "nearest": partial(plot_nearest, tables["summary"], wrong),
    }


def _parts(summary: pd.DataFrame, cut: str) -> pd.DataFrame:
    """Return the rows of the parts of a cut; those of all routes where the summary has one part alone."""
    is_part = summary.cut == cut
    return summary[is_part if is_part.any() else summary.cut == ALL]


@styled
def plot_regret(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return how much more a route costs that was planned under one wrong weight: a row per weight, a dot per city.

    Args:
      summary: rows of statistics, each of one weight and of one part of the routes: ``cut`` says by what routes are
        parted and ``value`` which part it is, here the city, or all routes where there is one city; ``regret`` is a
        share of the cost.
      wrong: by which factor the weight is wrong, in both directions.
    """
    weights = summary.weight_name[summary.regret.notna()].unique().tolist()
    by_city = _parts(summary, "city")
    cities = by_city.value.unique()
    heading = f"Cost of a weight that is {wrong:g} times too large or too small"
    figure, (panel,) = panels(1, heading, height_in=ROW_IN * len(weights))
    for number, city in enumerate(cities):
        rows = by_city[by_city.value == city].set_index("weight_name").reindex(weights)

        # Dots of several cities stand one below the other around the row of the weight.
        y = np.arange(len(weights)) + (number - (len(cities) - 1) / 2) * DOT_GAP
        dots(
            panel,
            y,
            rows,
            "regret",
            color=SERIES_COLOURS[number % len(SERIES_COLOURS)],
            label=city,
            marker=MARKERS[number % len(MARKERS)],
        )
    name_rows(panel, weights)
    panel.set(xlabel="regret (% of the cost)")
    panel.set_xlim(left=0)
    panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=None, symbol=""))
    if len(cities) > 1:
        legend_below(figure, panel)
    return figure


@styled
def plot_nearest(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return by which factor a weight must be off to change half of the routes: a row per weight, a panel per altitude.

    Args:
      summary: as in `plot_regret`; ``nearest`` is the median factor, and altitudes are parts of the cut ``altitude_m``.
      wrong: the factor of the regrets, drawn as a dashed line.
    """
    by_altitude = _parts(summary, "altitude_m")
    weights = by_altitude.weight_name[by_altitude.nearest.notna()].unique().tolist()
    heading = "By which factor a weight must be off to change half of the routes"
    height_in = ROW_IN * len(weights)
    altitudes = by_altitude.groupby("value", sort=False)
    figure, axes = panels(len(altitudes), heading, height_in=height_in, shares_y=True)
    end = np.nanmax([wrong, *by_altitude.nearest, *by_altitude.nearest_high])
    for panel, (altitude, rows) in zip(axes, altitudes, strict=True):
        for place, name in enumerate(weights):
            row = rows[rows.weight_name == name]
            y = np.full(len(row), place)
            dots(panel, y, row, "nearest", color=line_colour(name), marker="o")
        panel.axvline(wrong, color=FAINT_INK, linewidth=0.8, linestyle=(0, (3, 2)))
        panel.set(xscale="log", xlim=(0.97, 1.03 * end), xlabel="factor", title=altitude)
        show_plain_log(panel.xaxis)
        name_rows(panel, weights)
    letter_all(axes)
    return figure
