"""Pictures of a weight study over many routes: regrets by weight and city, breakpoints by altitude.

Bars are intervals over pairs of places; a hollow mark has too few pairs for one.
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
    panels,
    show_plain_log,
    show_shares,
    step_up,
    styled,
)
from jaxurban.report.write import Figures
from jaxurban.studies.weights.summary import ALL, pairs_of

NUM_FACTORS = 4  # at which intervals are drawn
BAR_GAP = 0.018  # between them, as a share of the axis
DOT_GAP = 0.18  # between dots of two cities, as a share of the distance between two weights


def study_figures(tables: Mapping[str, pd.DataFrame], wrong: float) -> Figures:
    """Return what draws each figure, by file name."""
    return {
        "regret": partial(plot_regret, tables["summary"], wrong),
        "nearest": partial(plot_nearest, tables["weights"], wrong),
    }


@styled
def plot_regret(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return how much more a route costs that was planned under one wrong weight: a dot per weight and city.

    Args:
      summary: rows of statistics, each of one weight and of one part of the routes: ``cut`` says by what routes are
        parted and ``value`` which part it is, here the city, or all routes where there is one city; ``regret`` is a
        share of the cost.
      wrong: by which factor the weight is wrong, in both directions.
    """
    weights = summary.weight_name[summary.regret.notna()].unique()
    is_of_city = summary.cut == "city"
    by_city = summary[is_of_city if is_of_city.any() else summary.cut == ALL]
    cities = by_city.value.unique()
    heading = f"What a weight costs that is {wrong:g} times too large or too small"
    figure, (panel,) = panels(1, heading, height_in=2.5)
    for number, city in enumerate(cities):
        rows = by_city[by_city.value == city].set_index("weight_name").reindex(weights)

        # Dots of several cities stand side by side around the place of the weight.
        x = np.arange(len(weights)) + (number - (len(cities) - 1) / 2) * DOT_GAP
        dots(
            panel,
            x,
            rows,
            "regret",
            color=SERIES_COLOURS[number % len(SERIES_COLOURS)],
            label=city,
            marker=MARKERS[number % len(MARKERS)],
        )
    panel.set_xticks(range(len(weights)), weights)
    panel.set(xlim=(-0.6, len(weights) - 0.4), ylabel="regret (% of the cost)")
    panel.set_ylim(bottom=0)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None, symbol=""))
    legend_below(figure, panel)
    return figure


@styled
def plot_nearest(weights: pd.DataFrame, wrong: float) -> Figure:
    """Return the share of routes that have changed once a weight is off by a factor: a panel per altitude.

    A curve per weight. Bars are 95 % intervals, side by side at a few factors; a dashed line is the factor of the
    regrets.

    Args:
      weights: a row per route and weight, with ``altitude_m``, ``weight_name``, whether it ``varies``, and
        ``nearest``: the least factor (above 1) at which the route changes; NaN where none is in the range.
      wrong: the factor of the regrets.
    """
    varied = weights[weights.varies]
    altitudes = sorted(varied.altitude_m.unique())
    heading = "Share of routes that change where a weight is off by a factor"
    figure, axes = panels(len(altitudes), heading, shares_y=True)
    end = max(varied.nearest.max(), 1.01)
    names = list(varied.weight_name.unique())

    # Bars stand in the middle of each of `NUM_FACTORS` equal parts of the axis, which is logarithmic.
    middles = np.geomspace(1.0, end, 2 * NUM_FACTORS + 1)[1::2]
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        at_altitude = varied[varied.altitude_m == altitude_m]
        for name, rows in at_altitude.groupby("weight_name", sort=False):
            colour = line_colour(str(name))
            step_up(panel, rows.nearest.to_numpy(), end, color=colour, label=name, linewidth=1.3)

            # Intervals of the share at these factors. Each weight has a lane of its own, to the left or to the right of
            # the middle, so that bars of different weights stand side by side.
            pairs = pairs_of(rows)
            lane = names.index(name) - (len(names) - 1) / 2
            factors = middles * end ** (lane * BAR_GAP)
            shares = [pairs.interval((rows.nearest <= each) * 1.0, "share") for each in factors]
            ends = [each.low for each in shares], [each.high for each in shares]
            panel.vlines(factors, *ends, color=colour, linewidth=2.2, alpha=0.75)

        panel.axvline(wrong, color=FAINT_INK, linewidth=0.8, linestyle=(0, (3, 2)))
        panel.set(xscale="log", xlim=(1, end), title=f"{altitude_m:g} m")
        panel.set_xlabel("factor by which the weight is off")
        show_plain_log(panel.xaxis)
    show_shares(figure, axes, "routes that change (%)", (0, 1.02))
    return figure
