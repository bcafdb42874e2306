"""Pictures of what weights do to a route: breakpoints along lines, the Pareto front."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import LogLocator, NullLocator

from jaxurban.report.figures.frame import (
    ENDS,
    LegendEntry,
    MapPanel,
    draw_maps,
    frame_note,
    joined,
    rules_said,
)
from jaxurban.report.figures.metrics import line_colour, obstacle_patches
from jaxurban.report.figures.paths import BLOCKED_COLOUR, cost_layers, draw_ends
from jaxurban.report.figures.style import (
    FAINT_INK,
    INK,
    Colours,
    add_colour_bar,
    chart,
    dress,
    legend_below,
    letter_all,
    panels,
    show_plain,
    styled,
)
from jaxurban.report.write import listed
from jaxurban.studies.weights.study import Sensitivity

GIVEN_COLOUR = "#c51b8a"
ON_ROUTES_COLOUR = "#ffffff"  # of the given weights' route over others of all colours


def sensitivity_figures(result: Sensitivity) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    return {
        "switches": lambda: plot_breakpoints(result),
        "switch_routes": lambda: plot_breakpoint_routes(result),
        "pareto": lambda: plot_pareto(result),
    }


@styled
def plot_breakpoints(result: Sensitivity) -> Figure:
    """Return the cheapest cost along the range of each weight, a dot where the route changes."""
    figure, axes = panels(
        len(result.lines), "Cheapest cost along the range of each weight", shares_y=True
    )
    for panel, name in zip(axes, result.lines, strict=True):
        line, column = result.lines[name], result.names.index(name)
        ends = line.corners[:, column]
        evenly = (np.geomspace(ends[0], ends[1], 400) - ends[0]) / np.ptp(ends)
        shares = np.sort(np.append(evenly, line.breakpoints))
        costs = line.cost_at(np.stack([1 - shares, shares], axis=-1))
        values = ends[0] + shares * (ends[1] - ends[0])
        look: dict[str, Any] = {"markersize": 4, "markeredgewidth": 0, "linewidth": 1.1}
        look["markevery"] = np.isin(shares, line.breakpoints)
        panel.plot(values, costs, "o-", color=line_colour(name), **look)
        look = {"linestyle": (0, (3, 2)), "zorder": 1, "label": "given weight"}
        panel.axvline(result.weights[column], color=INK, linewidth=0.9, **look)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(numticks=6))
        panel.xaxis.set_minor_locator(NullLocator())
        for axis in (panel.xaxis, panel.yaxis):
            show_plain(axis)
        title = f"{name}, breakpoints: {len(line.breakpoints)}"
        panel.set(xlim=ends, xlabel=f"weight of {name}", title=title)
    legend_below(figure, axes[0])
    letter_all(axes, "cheapest cost")
    return figure


def plot_breakpoint_routes(result: Sensitivity) -> Figure:
    """Return a map for each weight with the routes along its range, coloured by where they are the cheapest."""
    titles = [f"{name}, routes: {len(result.lines[name].cells)}" for name in result.lines]
    low, high = result.settings.factors
    powers = range(*(math.ceil(math.log10(factor) - 1e-9) for factor in (low, 10 * high)))
    ticks = [10.0**power for power in powers]
    colours = Colours(
        "viridis", LogNorm(low, high), "weight, as a multiple of the given one", ticks=ticks
    )
    legend = [("given weights\n(dashed)", ON_ROUTES_COLOUR)]
    figure, axes = _maps(
        result, titles, "Cheapest routes along the range of each weight", legend, colours
    )
    for panel, name in zip(axes, result.lines, strict=True):
        table = result.breakpoints(name)
        middle = np.sqrt(table["from"] * table["to"]) / result.weights[result.names.index(name)]
        widths = np.linspace(3.2, 1.4, len(table))
        look: dict[str, Any] = {"colors": colours(middle), "linewidths": widths, "zorder": 4}
        routes = LineCollection(result.line_routes[name], capstyle="round", **look)
        panel.add_collection(routes)
        edge = [Stroke(linewidth=2.4, foreground=INK), Normal()]
        look = {"linewidth": 1.2, "linestyle": (0, (3, 2)), "path_effects": edge, "zorder": 6}
        panel.plot(*result.route.xy_m.T, color=ON_ROUTES_COLOUR, **look)
    return figure


@styled
def plot_pareto(result: Sensitivity) -> Figure:
    """Return the supported Pareto points of two or three features; the last is the colour."""
    front = result.front
    figure = chart(4.0, f"Best trade-offs between {listed(front.objectives)}")
    panel = figure.subplots()
    points = front.points[[*front.objectives]].to_numpy()
    gradient = result.cost["gradient"].loc[[*front.objectives]].to_numpy()
    last = np.append(points[:, -1], gradient[-1])
    labels = [_feature_label(result, name) for name in front.objectives]
    colours = Colours("viridis", Normalize(last.min(), last.max()), labels[-1])
    look: dict[str, Any] = {"norm": colours.norm, "cmap": colours.cmap, "label": "_"}
    x, y, *_ = points.T
    panel.scatter(x, y, s=26, c=points[:, -1], edgecolors=FAINT_INK, linewidths=0.4, **look)
    look |= {"marker": "*", "edgecolors": GIVEN_COLOUR, "label": "given weights"}
    panel.scatter(gradient[0], gradient[1], s=220, c=gradient[-1:], **look)
    if len(labels) == 3:
        add_colour_bar(figure, [panel], colours)
    panel.set(xlabel=labels[0], ylabel=labels[1])
    panel.margins(0.06)
    dress(panel)
    panel.legend(loc="best", frameon=True)
    return figure


def _feature_label(result: Sensitivity, name: str) -> str:
    if name == "distance":
        return "distance (m)"
    settings, unit = result.route.settings, "sum of c over steps"
    if settings["cost_model"] == "line":
        unit = f"sum of c per {settings['reference_length_m']:g} m"
    return f"{name} cost ({unit}; lower is better)"


def _maps(
    result: Sensitivity,
    titles: list[str],
    heading: str,
    legend: Sequence[LegendEntry],
    colours: Colours | None = None,
) -> tuple[Figure, list[Axes]]:
    """Return maps of the normalised cost with the route's ends, on which routes are drawn."""
    settings, z = result.route.settings, result.route.altitude_m
    layers = cost_layers(result.maps, z, settings["time"], settings["time_of_day"])
    heading = joined(heading, settings["time_of_day"], by=", ")
    facts = joined(f"{z:g} m above ground", "grey: normalised cost, black: lowest")
    note = "\n".join([facts, frame_note(result.maps, settings["time"]), rules_said(settings)])
    entries = [*obstacle_patches(result.maps, BLOCKED_COLOUR), *legend, *ENDS]
    panels_of = [MapPanel(title, layers) for title in titles]
    figure, axes = draw_maps(
        result.maps.grid, panels_of, heading, note, legend=entries, colours=colours
    )
    for panel in axes:
        draw_ends(panel, [result.route])
    return figure, axes
