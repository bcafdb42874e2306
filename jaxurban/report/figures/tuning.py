"""Pictures of fitted weights: how sure they are, how the fit went, and what routes they lead to."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxurban.kernels.search.weighing import weighted_sum
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import map_settings
from jaxurban.report.figures.frame import ENDS, LegendEntry, MapLayer, MapPanel, draw_maps, flat_layer, mark_ends
from jaxurban.report.figures.metrics import line_colour, obstacle_patches
from jaxurban.report.figures.notes import frame_note, joined, rules_said
from jaxurban.report.figures.paths import BLOCKED_COLOUR
from jaxurban.report.figures.style import (
    FAINT_INK,
    Colours,
    add_colour_bar,
    chart,
    dots,
    dress,
    legend_below,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.tuning.target_fit import TargetFit
from jaxurban.studies.tuning.weight_fit import WeightFit

DEMONSTRATION_COLOUR, PLANNED_COLOUR, SHORTEST_COLOUR = "#f0a030", "#0b4f9e", "#999999"
PALE = 1.6  # the scale goes on so far beyond the map's costs, so that routes stand out
LEAST_TOP = 1e-4  # of the scale of regrets
LEAST_SHOWN = 1e-6  # of a regret or a loss, on logarithmic scales
WIDTH_IN = 9.0
LINE: dict[str, Any] = {"markersize": 3, "linewidth": 1.2}


@styled
def plot_weights(fit: WeightFit | TargetFit, units: Sequence[str]) -> Figure:
    """Return each fitted weight with its interval, and what share of the demonstrations' cost it makes up.

    Args:
      fit: from `fit_weights`, or from `fit_targets`, which has neither intervals nor shares.
      units: a unit for each weight.
    """
    values, num = fit.weights.vector(fit.names), len(fit.names)
    low, high = fit.interval if isinstance(fit, WeightFit) else np.full((2, num), np.nan)
    table = pd.DataFrame({"weight": values, "weight_low": low, "weight_high": high})
    table[values == 0] = np.nan
    figure = chart(WIDTH_IN, 0.75 + 0.55 * num, "Fitted weights")
    axes = figure.subplots(
        1,
        1 + isinstance(fit, WeightFit),
        sharey=True,
        squeeze=False,
        width_ratios=(1.6, 1)[: 1 + isinstance(fit, WeightFit)],
    )[0]
    for panel in axes:
        dress(panel, "x")
    places = np.arange(num, dtype=float)[::-1]
    for k, name in enumerate(fit.names):
        look = {"color": line_colour(name), "marker": "o", "elinewidth": 4, "capsize": 0, "markersize": 6}
        dots(axes[0], places[k : k + 1], table.iloc[k : k + 1], "weight", look, is_across=True)
    names = [
        f"{name}: {value:.3g}" if value else f"{name}: 0, cannot be identified"
        for name, value in zip(fit.names, values, strict=True)
    ]
    axes[0].set_yticks(places, [f"{name}\n({unit})" for name, unit in zip(names, units, strict=True)])
    axes[0].set(xscale="log", ylim=(-0.5, num - 0.4), xlabel="weight (each in its unit)")
    show_plain_log(axes[0].xaxis)
    if isinstance(fit, WeightFit):
        bars = axes[1].barh(places, 100 * fit.shares, color=[line_colour(name) for name in fit.names], height=0.55)
        axes[1].bar_label(bars, fmt="%.3g", padding=3)
        axes[1].set_xlabel("share of the demonstrations' cost (%)")
        axes[1].margins(x=0.15)
    return figure


@styled
def plot_learning(fit: WeightFit | TargetFit) -> Figure:
    """Return the fit's course by round.

    No less than a millionth is shown of regrets and losses.
    """
    curve, is_imitation = fit.curve, isinstance(fit, WeightFit)
    figure, axes = panels(2, "Learning curves", panel_in=(2.5, 2.6))
    for name, colour, label in (
        ("mean_regret", PLANNED_COLOUR, "mean regret of demonstrations"),
        ("worst_gap", SHORTEST_COLOUR, "largest gain by a new route"),
        ("loss", DEMONSTRATION_COLOUR, "loss"),
    ):
        if name in curve:
            axes[0].plot(curve["round"], curve[name].clip(lower=LEAST_SHOWN), "o-", color=colour, label=label, **LINE)
    axes[0].set(yscale="log", ylabel="share of the cost" if is_imitation else "squared misses")
    show_plain_log(axes[0].yaxis)
    if is_imitation:
        for name in (name for name in fit.names if curve[name].any()):
            ratio = curve[name] / curve[name].iloc[-1]
            axes[1].plot(curve["round"], ratio, "o-", color=line_colour(name), label=name, **LINE)
        axes[1].set(yscale="log", ylabel="weight / its last value")
        show_plain_log(axes[1].yaxis)
    else:
        for target, row in fit.outcomes.iterrows() if isinstance(fit, TargetFit) else ():
            axes[1].plot(curve["round"], curve[target] / (row.wished or 1), "o-", label=target, **LINE)
        axes[1].axhline(1.0, color=FAINT_INK, linewidth=0.6)
        axes[1].set_ylabel("outcome / its bound")
    for panel in axes:
        panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        panel.set(xlabel="round", xlim=(0.5, len(curve) + 0.5))
    for panel in axes:
        panel.legend()
    return figure


@styled
def plot_regret(fit: WeightFit, names: Sequence[str]) -> Figure:
    """Return by how much each demonstration is costlier than the cheapest route, coloured by how far it was trusted."""
    figure, (panel,) = panels(1, "Regret of each demonstration", panel_in=(WIDTH_IN - 0.6, 2.6))
    trust = Colours("Blues", Normalize(0, 1), "trust (1: full)")
    places = np.arange(1, len(names) + 1)
    panel.bar(places, 100 * fit.regret, color=trust(fit.trust), edgecolor=FAINT_INK, linewidth=0.3)
    top = 100 * max(float(fit.regret.max()), LEAST_TOP)
    panel.set(ylabel="cost above the cheapest route's (%)", xlim=(0.2, len(names) + 0.8), ylim=(-0.02 * top, 1.1 * top))
    panel.set_xlabel("demonstration")
    if len(names) <= 40:
        panel.set_xticks(places, [name[:12] for name in names])
        panel.tick_params(axis="x", rotation=60 if max(map(len, names)) > 3 else 0)
    add_colour_bar(figure, [panel], trust, 2.4)
    return figure


@styled
def plot_targets(fit: TargetFit) -> Figure:
    """Return for each target its bound, green where it is met, and what shortest routes, fit and it alone reach."""
    figure = chart(WIDTH_IN, 0.9 + 0.75 * len(fit.outcomes), "Targets and outcomes")
    axes = figure.subplots(len(fit.outcomes), 1, squeeze=False)[:, 0]
    for panel, (target, row), alone in zip(axes, fit.outcomes.iterrows(), fit.alone["reached"], strict=True):
        marks = (
            ("shortest routes", row.shortest, "s", 7, SHORTEST_COLOUR),
            ("target alone", alone, "D", 10, DEMONSTRATION_COLOUR),  # also seen under the next one
            ("all targets together", row.reached, "o", 7, PLANNED_COLOUR),
        )
        shown = np.array([row.wished, *(value for _, value, *_ in marks)])
        pad = 0.12 * max(float(np.ptp(shown)), 0.05 * abs(row.wished), 1e-6)
        low, high = shown.min() - pad, shown.max() + pad
        panel.axvspan(*((row.wished, high) if ">=" in str(target) else (low, row.wished)), color="#d9efdc", linewidth=0)
        panel.axvline(row.wished, color="#2a7a3b", linewidth=1.2, label="bound")
        for label, value, marker, size, colour in marks:
            panel.plot(value, 0, marker, color=colour, markersize=size, label=label, markeredgecolor="white")
        panel.set(xlim=(low, high), ylim=(-1, 1), yticks=[])
        name = f"{target}\n{'met' if row.is_met else 'missed'}"
        panel.set_ylabel(name, rotation=0, ha="right", va="center", labelpad=8)
    legend_below(figure, axes[0])
    return figure


def plot_routes(
    demonstrations: Sequence[Demonstration],
    planned: Sequence[Demonstration],
    cost_map: CostMap,
    weights: np.ndarray,
    given: str = "demonstration",
) -> Figure:
    """Return a map of the cost under weights with the demonstrations on it and the routes that the weights lead to.

    Args:
      demonstrations: as given.
      planned: the cheapest routes under the weights between the same ends.
      cost_map: one of their maps; only those on it are drawn.
      weights: ``[K]`` distance and the map's metrics.
      given: what the demonstrations are called: a fit to targets takes only their ends.
    """
    grid, maps = cost_map.grid, cost_map.maps
    both = [pair for pair in zip(demonstrations, planned, strict=True) if pair[0].query.cost_map is cost_map]
    title = joined(f"{cost_map.altitude_m:g} m above ground", cost_map.time_of_day)
    fitted = dict(zip(("distance", *cost_map.names), weights.tolist(), strict=True))
    note = f"{frame_note(maps, cost_map.time)}\n{rules_said(map_settings(cost_map) | {'weights': fitted})}"
    cost = weighted_sum(cost_map.costs, weights[1:])
    free = cost[cost_map.is_free]
    least, most = float(free.min()), float(np.percentile(free, 99))
    norm = Normalize(least, least + max(PALE * (most - least), 1e-12))
    colours = Colours("gray_r", norm, "cost of a cell\nunder the weights", extend="max")
    closed = flat_layer(~cost_map.is_free & maps.ds["has_data"].values, BLOCKED_COLOUR)
    panels = [MapPanel(title, [MapLayer(np.where(cost_map.is_free, cost, np.nan), colours), closed])]
    lines = (given, DEMONSTRATION_COLOUR), ("fitted weights", PLANNED_COLOUR)
    legend: list[LegendEntry] = [*lines, ("closed to paths", BLOCKED_COLOUR), *obstacle_patches(maps)[1:], *ENDS]
    heading = f"{given.capitalize()}s and routes under the fitted weights"
    figure, (panel,) = draw_maps(grid, panels, heading, note, legend=legend, colours=colours)
    corner = np.array([grid.x_min_m, grid.y_min_m])
    for shown, route in both:
        panel.plot(*(shown.points_m + corner).T, color=DEMONSTRATION_COLOUR, linewidth=3.4, zorder=3)
        panel.plot(*(route.points_m + corner).T, color=PLANNED_COLOUR, linewidth=1.1, zorder=4)
        start, goal = (grid.xy_of_cell(*cell) for cell in (shown.query.start, shown.query.goal))
        mark_ends(panel, start, goal, size=0.68)
    return figure
