"""Pictures of fitted weights: how sure they are, how the fit went, and what routes they lead to."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxurban.kernels.search.weighing import weighted_sum
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import map_settings
from jaxurban.report.figures.frame import MapLayer, add_key, draw_layers, flat_layer, make_frame, mark_ends
from jaxurban.report.figures.metrics import line_colour, obstacle_patches
from jaxurban.report.figures.notes import frame_note, joined, rules_said
from jaxurban.report.figures.paths import BLOCKED_COLOUR
from jaxurban.report.figures.style import FAINT_INK, SMALL_PT, TEXT_PT, Colours, chart, dress, show_plain_log, styled
from jaxurban.studies.demonstrations import PlannedBeside
from jaxurban.studies.tuning.target_fit import TargetFit
from jaxurban.studies.tuning.weight_fit import WeightFit

DEMONSTRATION_COLOUR, PLANNED_COLOUR, SHORTEST_COLOUR = "#f0a030", "#0b4f9e", "#999999"
PALE = 1.6  # the scale goes on so far beyond the map's costs, so that routes stand out
LEAST_TOP = 1e-4  # of the scale of regrets
LEAST_SHOWN = 1e-6  # of a regret or a loss, on logarithmic scales
WIDTH_IN = 9.0


@styled
def plot_weights(fit: WeightFit | TargetFit, units: Sequence[str]) -> Figure:
    """Return each fitted weight with its interval, and what share of the demonstrations' cost it makes up.

    Args:
      fit: from `fit_weights`, or from `fit_targets`, which has neither intervals nor shares.
      units: a unit for each weight.
    """
    values = fit.weights.vector(fit.names)
    low, high = fit.interval if isinstance(fit, WeightFit) else np.full((2, len(values)), np.nan)
    has_interval = bool(np.isfinite(low).all())
    subtitle = "bars: 5 to 95 % of resampled fits, and all weights that explain the demonstrations as well"
    figure = _figure(0.75 + 0.55 * len(values), "Fitted weights", subtitle if has_interval else "")
    is_imitation = isinstance(fit, WeightFit)
    axes = figure.subplots(1, 2, width_ratios=(1.6, 1))[:] if is_imitation else np.array([figure.subplots()])
    places = np.arange(len(values))[::-1]
    is_shown = values > 0
    ends = np.concatenate([values[is_shown], high[np.isfinite(high)], np.maximum(low, values / 100)[np.isfinite(low)]])
    ends = ends[ends > 0]
    margin = max(1.6, float(ends.max() / ends.min()) ** 0.06)  # room for the numbers over the marks
    least, most = ends.min() / margin, ends.max() * margin
    for place, name, value, *interval in zip(places, fit.names, values, low, high, strict=True):
        if value == 0:
            axes[0].text(least * 1.1, place, "0 (cannot be identified)", va="center", color=FAINT_INK)
            continue
        if has_interval:
            axes[0].plot(np.clip(interval, least, most), [place] * 2, color=line_colour(name), linewidth=5, alpha=0.35)
        axes[0].plot(value, place, "o", color=line_colour(name), markersize=6)
        axes[0].annotate(f"{value:.3g}", (value, place), (0, 8), textcoords="offset points", ha="center")
    axes[0].set(xscale="log", xlim=(least, most), ylim=(-0.5, len(values) - 0.4), xlabel="weight (each in its unit)")
    axes[0].set_yticks(places, [f"{name}\n({unit})" for name, unit in zip(fit.names, units, strict=True)])
    show_plain_log(axes[0].xaxis)
    if isinstance(fit, WeightFit):
        axes[1].barh(places, 100 * fit.shares, color=[line_colour(name) for name in fit.names], height=0.55)
        for place, share in zip(places, fit.shares, strict=True):
            axes[1].text(100 * share + 1.0, place, f"{100 * share:.3g}", va="center")
        axes[1].set(xlabel="share of the demonstrations' cost (%)", ylim=axes[0].get_ylim(), yticks=[])
        axes[1].set_xlim(0, 115 * float(fit.shares.max()))
    return _dressed(figure)


@styled
def plot_learning(fit: WeightFit | TargetFit) -> Figure:
    """Return the fit's course by round, and, of imitation, what fewer demonstrations would have given."""
    curve = fit.curve
    note = f"{fit.num_plans:,} searches; rounds: {len(curve)}; no less than {LEAST_SHOWN:g} is shown"
    figure = _figure(3.4, "Learning curves", note)
    fewer = fit.by_demonstrations if isinstance(fit, WeightFit) else pd.DataFrame()
    panels = figure.subplots(1, 3 if len(fewer) else 2)
    for name, colour, label in (
        ("mean_regret", PLANNED_COLOUR, "mean regret of demonstrations"),
        ("worst_gap", SHORTEST_COLOUR, "largest gain by a new route"),
        ("loss", DEMONSTRATION_COLOUR, "loss"),
    ):
        if name in curve:
            shown = np.maximum(curve[name], LEAST_SHOWN)
            panels[0].plot(curve["round"], shown, "o-", color=colour, markersize=3, linewidth=1.2, label=label)
    panels[0].set(yscale="log", xlabel="round", ylabel="share of the cost" if "noise" in curve else "squared misses")
    show_plain_log(panels[0].yaxis)
    if "noise" in curve:
        for name in (name for name in fit.names if curve[name].any()):
            ratio = curve[name] / curve[name].iloc[-1]
            panels[1].plot(
                curve["round"], ratio, "o-", color=line_colour(name), markersize=3, linewidth=1.2, label=name
            )
        panels[1].set(yscale="log", xlabel="round", ylabel="weight / its last value")
        show_plain_log(panels[1].yaxis)
    else:
        for target, row in fit.outcomes.iterrows() if isinstance(fit, TargetFit) else ():
            ratio = curve[target] / row.wished if row.wished else curve[target]
            panels[1].plot(curve["round"], ratio, "o-", markersize=3, linewidth=1.2, label=target)
        panels[1].axhline(1.0, color=FAINT_INK, linewidth=0.6)
        panels[1].set(xlabel="round", ylabel="outcome / its bound")
    if len(fewer):
        regrets = 100 * fewer[["held_out_regret", "worst_held_out_regret"]].clip(lower=LEAST_SHOWN)
        for (_, shown), style, label in zip(regrets.items(), ("o-", "o:"), ("mean", "worst of 8"), strict=True):
            panels[2].plot(fewer["num_examples"], shown, style, color=PLANNED_COLOUR, markersize=3, label=label)
        # Limits of their own, since all regrets may be the same.
        panels[2].set_ylim(regrets.to_numpy().min() / 2, regrets.to_numpy().max() * 2)
        panels[2].set(yscale="log", xlabel="demonstrations fitted", ylabel="regret of the others (%)")
        show_plain_log(panels[2].yaxis)
        panels[2].set_xscale("log", base=2)
        panels[2].set_xticks(fewer["num_examples"], [f"{num}" for num in fewer["num_examples"]])
    for panel in panels:
        panel.legend(fontsize=SMALL_PT - 0.5, frameon=False)
        if panel is not panels[-1] or not len(fewer):
            panel.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
            panel.set_xlim(0.5, len(curve) + 0.5)
    return _dressed(figure)


@styled
def plot_regret(fit: WeightFit, names: Sequence[str]) -> Figure:
    """Return by how much each demonstration is costlier than the cheapest route, coloured by how far it was trusted."""
    mean, best = (100 * max(value, LEAST_SHOWN) for value in (float(fit.regret.mean()), fit.best_mean_regret))
    note = (
        f"mean {mean:.3g} %; at best, under any weights, {best:.3g} % (no less than {100 * LEAST_SHOWN:g} % is shown)"
    )
    figure = _figure(3.2, "Regret of each demonstration: its cost above the cheapest route's", note)
    panel = figure.subplots()
    trust = Colours("Blues", Normalize(-0.25, 1))  # what is not trusted is pale
    places = np.arange(1, len(names) + 1)
    panel.bar(places, 100 * fit.regret, color=trust(fit.trust), edgecolor=FAINT_INK, linewidth=0.3)
    top = 100 * max(float(fit.regret.max()), LEAST_TOP)
    panel.set(ylabel="regret (%)", xlabel="demonstration", xlim=(0.2, len(names) + 0.8), ylim=(-0.02 * top, 1.1 * top))
    if fit.regret.max() < LEAST_SHOWN:
        told = f"none has a regret of {100 * LEAST_SHOWN:g} % or more"
        panel.text(0.5, 0.5, told, transform=panel.transAxes, ha="center", size=TEXT_PT)
    if len(names) <= 40:
        panel.set_xticks(places, [name[:12] for name in names])
        if max(map(len, names)) > 3:
            panel.tick_params(axis="x", rotation=60)
    bar = figure.colorbar(ScalarMappable(trust.norm, trust.cmap), ax=panel, pad=0.015, fraction=0.03, ticks=[0, 0.5, 1])
    bar.ax.set_ylim(0, 1)
    bar.set_label("trust (1: full)")
    return _dressed(figure)


@styled
def plot_targets(fit: TargetFit) -> Figure:
    """Return for each target its bound, and what the shortest routes, the fit, and the target alone reach."""
    figure = _figure(0.9 + 0.75 * len(fit.outcomes), "Targets and outcomes", "green: where the target is met")
    panels = figure.subplots(len(fit.outcomes), 1, squeeze=False)[:, 0]
    rows = zip(panels, fit.outcomes.iterrows(), fit.alone["reached"], strict=True)
    for panel, (target, row), alone in rows:
        marks = (
            ("shortest routes", row.shortest, "s", SHORTEST_COLOUR),
            ("target alone", alone, "D", DEMONSTRATION_COLOUR),  # also seen under the next one
            ("all targets together", row.reached, "o", PLANNED_COLOUR),
        )
        shown = np.array([row.wished, *(value for _, value, _, _ in marks)])
        pad = 0.12 * max(float(np.ptp(shown)), 0.05 * abs(row.wished), 1e-6)
        low, high = shown.min() - pad, shown.max() + pad
        panel.axvspan(*((row.wished, high) if ">=" in str(target) else (low, row.wished)), color="#d9efdc", linewidth=0)
        panel.axvline(row.wished, color="#2a7a3b", linewidth=1.2, label="bound")
        for label, value, marker, colour in marks:
            size = 10 if marker == "D" else 7
            panel.plot(value, 0, marker, color=colour, markersize=size, label=label, markeredgecolor="white")
        panel.set(xlim=(low, high), ylim=(-1, 1), yticks=[])
        panel.set_ylabel(
            f"{target}\n{'met' if row.is_met else 'missed'}", rotation=0, ha="right", va="center", labelpad=8
        )
    panels[0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.15))
    return _dressed(figure)


def plot_routes(beside: PlannedBeside, cost_map: CostMap, weights: np.ndarray, given: str = "demonstration") -> Figure:
    """Return a map of the cost under weights with the demonstrations on it and the routes that the weights lead to.

    Args:
      beside: from `plan_beside`.
      cost_map: one of its demonstrations' maps; only those on it are drawn.
      weights: ``[K]`` distance and the map's metrics.
      given: what the demonstrations are called: a fit to targets takes only their ends.
    """
    grid, maps = cost_map.grid, cost_map.maps
    shown = [k for k, each in enumerate(beside.demonstrations) if each.query.cost_map is cost_map]
    title = joined(f"{cost_map.altitude_m:g} m above ground", cost_map.time_of_day)
    overlap = beside.table["overlap"].iloc[shown].mean()
    note = joined(frame_note(maps, cost_map.time), f"{100 * overlap:.0f} % of the {given}s' cells shared")
    fitted = dict(zip(("distance", *cost_map.names), weights.tolist(), strict=True))
    note = f"{note}\n{rules_said(map_settings(cost_map) | {'weights': fitted})}"
    frame = make_frame(grid, [title], f"{given.capitalize()}s and routes under the fitted weights", note)
    cost = weighted_sum(cost_map.costs, weights[1:])
    free = cost[cost_map.is_free]
    least, most = float(free.min()), float(np.percentile(free, 99))
    norm = Normalize(least, least + max(PALE * (most - least), 1e-12))
    colours = Colours("gray_r", norm, "cost of a cell\nunder the weights", extend="max")
    layers = [
        MapLayer(np.where(cost_map.is_free, cost, np.nan), colours),
        flat_layer(~cost_map.is_free & maps.ds["has_data"].values, BLOCKED_COLOUR),
    ]
    panel = frame.axes[0]
    draw_layers(panel, grid, layers)
    corner = np.array([grid.x_min_m, grid.y_min_m])
    for routes, colour, width, order in (
        (beside.demonstrations, DEMONSTRATION_COLOUR, 3.4, 3),
        (beside.planned, PLANNED_COLOUR, 1.1, 4),
    ):
        for k in shown:
            panel.plot(*(routes[k].points_m + corner).T, color=colour, linewidth=width, zorder=order, alpha=0.95)
    for k in shown:
        query = beside.demonstrations[k].query
        mark_ends(panel, grid.xy_of_cell(*query.start), grid.xy_of_cell(*query.goal), size=0.62)
    patches = [
        (given, DEMONSTRATION_COLOUR),
        ("fitted weights", PLANNED_COLOUR),
        ("closed to paths", BLOCKED_COLOUR),
        *obstacle_patches(maps)[1:],
    ]
    add_key(frame, patches, colours, has_ends=True)
    return frame.figure


def _figure(height_in: float, heading: str, note: str) -> Figure:
    """Return an empty figure with a heading; ``height_in`` is what is left for its panels."""
    return chart(WIDTH_IN, height_in + 0.6, heading, note)


def _dressed(figure: Figure) -> Figure:
    for panel in figure.axes:
        dress(panel, has_grid=False)
    return figure
