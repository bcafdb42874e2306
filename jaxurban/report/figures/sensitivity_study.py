"""Pictures of a weight study over many routes: regrets by weight and city, breakpoints by altitude.

Bars are intervals over pairs of places; a hollow mark has too few pairs for one.
"""

from collections.abc import Callable, Mapping
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
    panels,
    show_plain_log,
    step_up,
    styled,
)
from jaxurban.studies.weights.summary import ALL, pairs_of

NUM_FACTORS = 4  # at which intervals are drawn
BAR_GAP = 0.018  # between them, as a share of the axis


def study_figures(
    tables: Mapping[str, pd.DataFrame], wrong: float
) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    return {
        "regret": partial(plot_regret, tables["summary"], wrong),
        "nearest": partial(plot_nearest, tables["weights"], wrong),
    }


@styled
def plot_regret(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return how much costlier the route is that a wrong weight leads to, a series a city."""
    weights = summary.weight_name[summary.regret.notna()].unique()
    part = summary[summary.cut == ("city" if (summary.cut == "city").any() else ALL)]
    cities = part.value.unique()
    heading = f"What a weight costs that is {wrong:g} times too large or too small"
    figure, (panel,) = panels(1, heading, height_in=2.5)
    for k, city in enumerate(cities):
        rows = part[part.value == city].set_index("weight_name").reindex(weights)
        colour, marker = SERIES_COLOURS[k % len(SERIES_COLOURS)], MARKERS[k % len(MARKERS)]
        look = {"color": colour, "marker": marker, "label": city}
        dots(
            panel,
            np.arange(len(weights)) + (k - (len(cities) - 1) / 2) * 0.18,
            rows,
            "regret",
            look,
        )
    panel.set_xticks(range(len(weights)), weights)
    panel.set(xlim=(-0.6, len(weights) - 0.4), ylabel="regret (% of the cost)")
    panel.set_ylim(bottom=0)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None, symbol=""))
    legend_below(figure, panel)
    return figure


@styled
def plot_nearest(weights: pd.DataFrame, wrong: float) -> Figure:
    """Return the share of routes that have changed once a weight is off by a factor, a panel an altitude.

    Bars are 95 % intervals, side by side at a few factors; a dashed line is the factor of the regrets.
    """
    varied = weights[weights.varies]
    altitudes = sorted(varied.altitude_m.unique())
    heading = "Share of routes that change where a weight is off by a factor"
    figure, axes = panels(len(altitudes), heading, shares_y=True)
    end = max(varied.nearest.max(), 1.01)
    names = list(varied.weight_name.unique())
    middles = np.geomspace(1.0, end, 2 * NUM_FACTORS + 1)[1::2]
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        for name, rows in varied[varied.altitude_m == altitude_m].groupby(
            "weight_name", sort=False
        ):
            colour, look = line_colour(str(name)), {"label": name, "linewidth": 1.3}
            step_up(panel, rows.nearest.to_numpy(), end, color=colour, **look)
            pairs = pairs_of(rows)
            at = middles * end ** ((names.index(name) - (len(names) - 1) / 2) * BAR_GAP)
            intervals = [pairs.interval((rows.nearest <= each) * 1.0, "share")[1:] for each in at]
            panel.vlines(at, *np.transpose(intervals), color=colour, linewidth=2.2, alpha=0.75)
        panel.axvline(wrong, color=FAINT_INK, linewidth=0.8, linestyle=(0, (3, 2)))
        panel.set(xscale="log", xlim=(1, end), ylim=(0, 1.02), title=f"{altitude_m:g} m")
        panel.set_xlabel("factor by which the weight is off")
        show_plain_log(panel.xaxis)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    letter_all(axes, "routes that change (%)")
    legend_below(figure, axes[0])
    return figure
