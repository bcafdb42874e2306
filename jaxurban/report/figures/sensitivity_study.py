"""Pictures of a weight study over many routes: shares, regrets, breakpoints by weight, city, stratum and altitude."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from jaxurban.report.figures.sensitivity import CLUSTER_COLOURS, SHARES_SHOWN
from jaxurban.report.figures.style import (
    FAINT_INK,
    MARKERS,
    TEXT_PT,
    chart,
    dots,
    dress,
    legend_below,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.studies.bootstrap import share_of
from jaxurban.studies.queries import outcome_label
from jaxurban.studies.weights.summary import ALL, CLEAR, Drawn, change_said

NUM_FACTORS = 60  # at which an interval is drawn
INTERVALS = "bars: intervals over pairs of places; hollow: too few pairs for one"


def study_figures(tables: Mapping[str, pd.DataFrame], wrong: float) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    found = {
        "share": lambda: plot_shares(tables["summary"]),
        "regret": lambda: plot_regret(tables["summary"], wrong),
        "nearest": lambda: plot_nearest(tables["weights"], wrong),
        "where": lambda: plot_where(tables["summary"], wrong),
    }
    if "sobol_summary" in tables:
        found["sobol"] = lambda: plot_sobol_shares(tables["sobol_summary"])
    if "remade_summary" in tables:
        found["remade"] = lambda: plot_remade(tables["remade_summary"])
    return found


def looks(names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the colour and the marker of each of several series."""
    return [
        {"color": CLUSTER_COLOURS[k % len(CLUSTER_COLOURS)], "marker": MARKERS[k % len(MARKERS)], "label": name}
        for k, name in enumerate(names)
    ]


def _by_city(summary: pd.DataFrame, name: str, heading: str, note: str) -> Figure:
    """Return a figure of a statistic by weight, a series a city."""
    weights = [
        each
        for each in dict.fromkeys(summary.weight_name)
        if summary.set_index("weight_name")[name].notna().loc[[each]].any()
    ]
    cut = "city" if (summary.cut == "city").any() else ALL
    part = summary[summary.cut == cut]
    cities = list(dict.fromkeys(part.value))
    figure, (panel,) = panels(1, heading, f"{note}; {INTERVALS}", panel_in=(5.9, 2.5))
    for k, (city, look) in enumerate(zip(cities, looks(cities), strict=True)):
        rows = part[part.value == city].set_index("weight_name").reindex(weights)
        dots(panel, np.arange(len(weights)) + (k - (len(cities) - 1) / 2) * 0.18, rows, name, look)
    panel.set_xticks(range(len(weights)), weights)
    panel.set_xlim(-0.6, len(weights) - 0.4)
    panel.set_ylim(bottom=0)
    panel.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    legend_below(figure, panel)
    return figure


@styled
def plot_shares(summary: pd.DataFrame) -> Figure:
    """Return the share of the cost that each weight makes up, by city."""
    note = "elasticity of the cheapest cost by the weight, mean over routes"
    return _by_city(summary, "share", "What the cost of routes is made of", note)


@styled
def plot_regret(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return what a wrong weight costs, by city."""
    note = f"how much dearer the route is that a weight {wrong:g} times too large or too small leads to"
    return _by_city(summary, "regret", "What a wrong weight costs", note)


@styled
def plot_nearest(weights: pd.DataFrame, wrong: float) -> Figure:
    """Return the share of routes that have changed once a weight is off by a factor, a panel an altitude."""
    varied = weights[weights.varies]
    altitudes, names = sorted(varied.altitude_m.unique()), list(dict.fromkeys(varied.weight_name))
    figure, axes = panels(
        len(altitudes),
        "How far a weight may be off before the route changes",
        "share of routes whose nearest breakpoint lies within the factor, up or down; bands: 95 % intervals",
        shares_y=True,
    )
    end = max(varied.nearest.max(), 1.01)
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        at = varied[varied.altitude_m == altitude_m]
        for name, look in zip(names, looks(names), strict=True):
            factors = np.sort(at.nearest[at.weight_name == name].to_numpy())
            if len(factors):
                is_reached = factors < end  # the others do not change within the range
                x = np.concatenate([[1.0], factors[is_reached], [end]])
                y = np.concatenate([[0.0], np.flatnonzero(is_reached) + 1.0, [is_reached.sum()]]) / len(factors)
                panel.step(x, y, where="post", color=look["color"], label=name, linewidth=1.3)
                _band(panel, at[at.weight_name == name], end, look["color"])
        panel.axvline(wrong, color=FAINT_INK, linewidth=0.8, linestyle=(0, (3, 2)))
        panel.set(xscale="log", xlim=(1, end), ylim=(0, 1.02), xlabel="factor (1)")
        panel.set_title(f"{altitude_m:g} m")
        show_plain_log(panel.xaxis)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    legend_below(figure, axes[0])
    return figure


def _band(panel: Axes, rows: pd.DataFrame, end: float, colour: str) -> None:
    """Draw the 95 % interval of the share of routes that have changed by each factor below ``end``."""
    drawn, factors = Drawn(rows), np.geomspace(1.0, end, NUM_FACTORS, endpoint=False)
    ends = np.array([drawn.interval((rows.nearest <= factor).astype(float), share_of)[1:] for factor in factors])
    panel.fill_between(factors, *ends.T, color=colour, alpha=0.13, linewidth=0)


@styled
def plot_where(summary: pd.DataFrame, wrong: float) -> Figure:
    """Return the regret of each wrong weight by stratum and altitude, a panel a weight."""
    cut = next(
        (each for each in ("stratum, altitude_m", "stratum", "altitude_m", ALL) if (summary.cut == each).any()), ALL
    )
    part = summary[(summary.cut == cut) & summary.regret.notna()]
    split = part.value.astype(str).str.rpartition(", ")
    places, series = (
        (split[0], split[2]) if cut.startswith("stratum,") else (part.value.astype(str), part.value.map(lambda _: ""))
    )
    names, ticks, kinds = (list(dict.fromkeys(each)) for each in (part.weight_name, sorted(places), series))
    figure, axes = panels(
        max(1, len(names)),
        "Where a wrong weight costs",
        f"regret of a weight {wrong:g} times wrong, on routes that start or end there; {INTERVALS}",
        shares_y=True,
    )
    for panel, name in zip(axes, names, strict=False):
        for k, (kind, look) in enumerate(zip(kinds, looks(kinds), strict=True)):
            rows = part[(part.weight_name == name) & (series == kind)]
            x = np.array([ticks.index(each) for each in places[rows.index]], float)
            dots(panel, x + (k - (len(kinds) - 1) / 2) * 0.2, rows, "regret", look)
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
    """Return mean total Sobol shares of each outcome; pale where a share is not told from 0."""
    total = shares[(shares.kind == "total") & shares.share.notna()]
    outcomes, names = list(dict.fromkeys(total.outcome)), list(dict.fromkeys(total.weight_name))
    figure, axes = panels(
        max(1, len(outcomes)),
        "Which weights decide what routes are like",
        "total Sobol shares, means over routes; pale: not told from 0; "
        f"{INTERVALS}; triangles: above {SHARES_SHOWN[1]:g}",
        shares_y=True,
    )
    for panel, outcome in zip(axes, outcomes, strict=False):
        rows = total[total.outcome == outcome].set_index("weight_name").reindex(names)
        for is_clear, alpha in ((True, 1.0), (False, 0.35)):
            which = ((rows.verdict == CLEAR) == is_clear).to_numpy() & rows.share.notna().to_numpy()
            if which.any():
                look = {"color": CLUSTER_COLOURS[1], "marker": "o", "alpha": alpha}
                dots(panel, np.flatnonzero(which).astype(float), rows[which], "share", look)
        beyond = np.flatnonzero((rows.share > SHARES_SHOWN[1]).to_numpy())
        marks = panel.plot(beyond, np.full(len(beyond), SHARES_SHOWN[1]), "^", color=CLUSTER_COLOURS[1], clip_on=False)
        marks[0].set_in_layout(False)  # where there are none, they lie nowhere
        panel.set_xticks(range(len(names)), names)
        panel.set(title=outcome_label(str(outcome)), xlim=(-0.6, len(names) - 0.4))
    axes[0].set_ylim(0, SHARES_SHOWN[1])
    figure.supylabel("share of variance (1)", size=TEXT_PT - 1)
    return figure


@styled
def plot_remade(remade: pd.DataFrame) -> Figure:
    """Return how many routes change on maps made anew, and what the routes of the nominal maps cost there."""
    part = remade[remade.of == ALL].iloc[::-1].reset_index(drop=True)
    names = [change_said(*each) for each in zip(part.changed, part.factor, strict=True)]
    height_in, note = 0.24 * len(names) + 0.8, f"other heights, other parameters; {INTERVALS}"
    figure = chart(8.7, height_in, "Routes on maps made anew", note)
    drawn = {"is_other": "routes that change", "nominal_regret": "regret of the nominal route"}
    for k, (panel, (name, label)) in enumerate(zip(figure.subplots(1, 2), drawn.items(), strict=True)):
        dress(panel, has_grid=False)
        panel.grid(axis="x", linewidth=0.4, alpha=0.5)
        dots(
            panel,
            np.arange(len(part), dtype=float),
            part,
            name,
            {"color": CLUSTER_COLOURS[k], "marker": "o"},
            is_across=True,
        )
        panel.set_yticks(range(len(names)), names if k == 0 else [""] * len(names), size=TEXT_PT - 1)
        panel.set(xlabel=label, ylim=(-0.6, len(names) - 0.4))
        panel.set_xlim(left=0)
        panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    return figure
