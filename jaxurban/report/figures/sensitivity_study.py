"""Pictures of a weight study over many routes: shares, regrets, breakpoints by weight, city, stratum and altitude.

Bars are intervals over pairs of places; a hollow mark has too few pairs for one.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from jaxurban.report.figures.metrics import line_colour
from jaxurban.report.figures.sensitivity import SHARES_SHOWN
from jaxurban.report.figures.style import (
    FAINT_INK,
    MARKERS,
    SERIES_COLOURS,
    chart,
    dots,
    dress,
    legend_below,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.studies.queries import outcome_label
from jaxurban.studies.weights.summary import ALL, CLEAR, change_said, pairs_of

NUM_FACTORS = 60  # at which an interval is drawn


def study_figures(tables: Mapping[str, pd.DataFrame], wrong: float) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    found: dict[str, Callable[[], Figure]] = {
        "share": partial(plot_shares, tables["summary"]),
        "regret": partial(plot_regret, tables["summary"], wrong),
        "nearest": partial(plot_nearest, tables["weights"], wrong),
        "where": partial(plot_where, tables["summary"], wrong),
    }
    if "sobol_summary" in tables:
        found["sobol"] = partial(plot_sobol_shares, tables["sobol_summary"])
    if "remade_summary" in tables:
        found["remade"] = partial(plot_remade, tables["remade_summary"])
    return found


def _look(k: int, name: str) -> dict[str, Any]:
    """Return how the marks of one of several series are drawn."""
    return {"color": SERIES_COLOURS[k % len(SERIES_COLOURS)], "marker": MARKERS[k % len(MARKERS)], "label": name}


def _by_city(summary: pd.DataFrame, name: str, heading: str) -> Figure:
    """Return a figure of a statistic by weight, a series a city."""
    weights = summary.weight_name[summary[name].notna()].unique()
    part = summary[summary.cut == ("city" if (summary.cut == "city").any() else ALL)]
    cities = part.value.unique()
    figure, (panel,) = panels(1, heading, panel_in=(5.9, 2.5))
    for k, city in enumerate(cities):
        rows = part[part.value == city].set_index("weight_name").reindex(weights)
        dots(panel, np.arange(len(weights)) + (k - (len(cities) - 1) / 2) * 0.18, rows, name, _look(k, city))
    panel.set_xticks(range(len(weights)), weights)
    panel.set_xlim(-0.6, len(weights) - 0.4)
    panel.set_ylim(bottom=0)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    legend_below(figure, panel)
    return figure


@styled
def plot_shares(summary: pd.DataFrame) -> Figure:
    """Return the share of the cost that each weight makes up, by city: the elasticity of the cheapest cost, a mean."""
    return _by_city(summary, "share", "What the cost of routes is made of")


@styled
def plot_regret(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return how much costlier the route is that a wrong weight leads to, by city."""
    return _by_city(summary, "regret", f"What a weight costs that is {wrong:g} times too large or too small")


@styled
def plot_nearest(weights: pd.DataFrame, wrong: float) -> Figure:
    """Return the share of routes that have changed once a weight is off by a factor, a panel an altitude.

    Bands are 95 % intervals; a dashed line is the factor of the regrets.
    """
    varied = weights[weights.varies]
    altitudes = sorted(varied.altitude_m.unique())
    figure, axes = panels(
        len(altitudes), "Share of routes that change where a weight is off by a factor", shares_y=True
    )
    end = max(varied.nearest.max(), 1.01)
    edges = np.geomspace(1.0, end, NUM_FACTORS, endpoint=False)
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        for name, rows in varied[varied.altitude_m == altitude_m].groupby("weight_name", sort=False):
            colour, factors = line_colour(str(name)), np.sort(rows.nearest.to_numpy())
            is_reached = factors < end  # the others do not change within the range
            x = np.concatenate([[1.0], factors[is_reached], [end]])
            y = np.concatenate([[0.0], np.flatnonzero(is_reached) + 1.0, [is_reached.sum()]]) / len(factors)
            panel.step(x, y, where="post", color=colour, label=name, linewidth=1.3)
            pairs = pairs_of(rows)
            changed = [pairs.interval((rows.nearest <= edge).astype(float), "share")[1:] for edge in edges]
            panel.fill_between(edges, *np.transpose(changed), color=colour, alpha=0.13, linewidth=0)
        panel.axvline(wrong, color=FAINT_INK, linewidth=0.8, linestyle=(0, (3, 2)))
        panel.set(xscale="log", xlim=(1, end), ylim=(0, 1.02), xlabel="factor (1)")
        panel.set_title(f"{altitude_m:g} m")
        show_plain_log(panel.xaxis)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    legend_below(figure, axes[0])
    return figure


@styled
def plot_where(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return the regret of each wrong weight by stratum (of start or goal) and altitude, a panel a weight."""
    held = set(summary.cut)
    cut = next(each for each in ("stratum, altitude_m", "stratum", "altitude_m", ALL) if each in {*held, ALL})
    part = summary[(summary.cut == cut) & summary.regret.notna()]
    split = part.value.astype(str).str.rpartition(", ")
    is_both = cut.startswith("stratum,")
    part = part.assign(place=split[0] if is_both else part.value.astype(str), kind=split[2] if is_both else "")
    names, ticks, kinds = part.weight_name.unique(), sorted(part.place.unique()), list(part.kind.unique())
    heading = f"Regret of a weight that is {wrong:g} times wrong, by where routes start or end"
    figure, axes = panels(max(1, len(names)), heading, shares_y=True)
    for panel, name in zip(axes, names, strict=False):
        for k, kind in enumerate(kinds):
            rows = part[(part.weight_name == name) & (part.kind == kind)]
            x = np.array([ticks.index(place) for place in rows.place], float)
            dots(panel, x + (k - (len(kinds) - 1) / 2) * 0.2, rows, "regret", _look(k, kind))
        panel.set_title(name)
        panel.set_xticks(range(len(ticks)), ticks)
        panel.set_xlim(-0.6, len(ticks) - 0.4)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes[0].set_ylim(bottom=0)  # of all panels, once everything is drawn
    if any(kinds):
        legend_below(figure, axes[0])
    return figure


@styled
def plot_sobol_shares(shares: pd.DataFrame) -> Figure:
    """Return mean total Sobol shares of each outcome; pale: not clear of 0; a triangle: beyond the end."""
    total = shares[(shares.kind == "total") & shares.share.notna()]
    outcomes, names = total.outcome.unique(), total.weight_name.unique()
    figure, axes = panels(
        max(1, len(outcomes)), "Total Sobol shares: which weights decide what routes are like", shares_y=True
    )
    for panel, outcome in zip(axes, outcomes, strict=False):
        rows = total[total.outcome == outcome].set_index("weight_name").reindex(names)
        x, is_beyond = np.arange(len(names), dtype=float), (rows.share > SHARES_SHOWN[1]).to_numpy()
        for alpha, is_so in ((1.0, rows.verdict == CLEAR), (0.35, (rows.verdict != CLEAR) & rows.share.notna())):
            look = {"color": SERIES_COLOURS[1], "marker": "o", "alpha": alpha}
            dots(panel, x[is_so], rows[is_so], "share", look)
        if is_beyond.any():
            ends = np.full(is_beyond.sum(), SHARES_SHOWN[1])
            panel.plot(x[is_beyond], ends, "^", color=SERIES_COLOURS[1], clip_on=False)
        panel.set_xticks(x, names)
        panel.set(title=outcome_label(str(outcome)), xlim=(-0.6, len(names) - 0.4))
    axes[0].set(ylim=(0, SHARES_SHOWN[1]), ylabel="share of variance (1)")
    return figure


@styled
def plot_remade(remade: pd.DataFrame) -> Figure:
    """Return how many routes change on perturbed maps, and what the routes of the nominal maps cost there."""
    part = remade[remade.of == ALL].iloc[::-1].reset_index(drop=True)
    names = [change_said(*each) for each in zip(part.changed, part.factor, strict=True)]
    figure = chart(8.7, 0.24 * len(names) + 0.8, "Routes on perturbed maps")
    drawn = {"is_other": "routes that change", "nominal_regret": "regret of the nominal route"}
    axes = figure.subplots(1, 2, sharey=True)
    for k, (panel, (name, label)) in enumerate(zip(axes, drawn.items(), strict=True)):
        dress(panel, "x")
        look = {"color": SERIES_COLOURS[k], "marker": "o"}
        dots(panel, np.arange(len(part), dtype=float), part, name, look, is_across=True)
        panel.set(xlabel=label, ylim=(-0.6, len(names) - 0.4))
        panel.set_xlim(left=0)
        panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes[0].set_yticks(range(len(names)), names)
    return figure
