"""Pictures of what weights do to a route: breakpoints along lines, the Pareto front."""

import math

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import LogLocator, NullLocator

from jaxurban.report.figures.frame import (
    ENDS,
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
from jaxurban.report.write import Figures, Look, listed
from jaxurban.studies.weights.study import Sensitivity

GIVEN_COLOUR = "#c51b8a"
ON_ROUTES_COLOUR = "#ffffff"  # of the given weights' route over others of all colours


def sensitivity_figures(result: Sensitivity) -> Figures:
    """Return what draws each figure, by file name."""
    return {
        "switches": lambda: plot_breakpoints(result),
        "switch_routes": lambda: plot_breakpoint_routes(result),
        "pareto": lambda: plot_pareto(result),
    }


@styled
def plot_breakpoints(result: Sensitivity) -> Figure:
    """Return the cheapest cost along the range of each weight, the others as given, with a dot where the route changes.

    A panel per varied weight; a dashed line is the given weight.
    """
    heading = "Cheapest cost along the range of each weight"
    figure, axes = panels(len(result.lines), heading, shares_y=True)
    for panel, (name, line) in zip(axes, result.lines.items(), strict=True):
        column = result.names.index(name)
        low, high = line.corners[:, column]

        # Places along the line, as shares of the way from its low end to its high end: 400 that are even on the
        # logarithmic axis, and the breakpoints, which alone get a dot.
        evenly = (np.geomspace(low, high, 400) - low) / (high - low)
        shares = np.sort(np.append(evenly, line.breakpoints))
        costs = line.cost_at(np.stack([1 - shares, shares], axis=-1))
        panel.plot(
            low + shares * (high - low),
            costs,
            "o-",
            color=line_colour(name),
            markersize=4,
            markeredgewidth=0,
            linewidth=1.1,
            markevery=np.isin(shares, line.breakpoints),
        )

        # The given weight, the axes and the title.
        panel.axvline(
            result.weights[column],
            color=INK,
            linewidth=0.9,
            linestyle=(0, (3, 2)),
            zorder=1,
            label="given weight",
        )

        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(numticks=6))
        panel.xaxis.set_minor_locator(NullLocator())
        for axis in (panel.xaxis, panel.yaxis):
            show_plain(axis)
        title = f"{name}, breakpoints: {len(line.breakpoints)}"
        panel.set(xlim=(low, high), xlabel=f"weight of {name}", title=title)
    legend_below(figure, axes[0])
    letter_all(axes, "cheapest cost")
    return figure


def plot_breakpoint_routes(result: Sensitivity) -> Figure:
    """Return a map for each varied weight with the routes along its range, coloured by where they are the cheapest.

    A route has the colour of the geometric middle of the values at which it is the cheapest, as a multiple of the given
    weight; later routes are thinner, so that earlier ones are seen below them. The route under the given weights is
    dashed.
    """
    low, high = result.settings.factors

    # A tick at each power of ten, from the low factor to the first one that is not below the high factor. Rounding may
    # bring a logarithm a little above a whole number, which the small number undoes.
    first = math.ceil(math.log10(low) - 1e-9)
    last = math.ceil(math.log10(high) - 1e-9)
    ticks = [10.0**power for power in range(first, last + 1)]
    label = "weight, as a multiple of the given one"
    colours = Colours("viridis", LogNorm(low, high), label, ticks=ticks)

    # Equal maps of the normalised cost, on which the routes are drawn, with the ends of the given weights' route.
    settings = result.route.settings
    z = result.route.altitude_m
    layers = cost_layers(result.maps, z, settings["time"], settings["time_of_day"])
    panels_of = [
        MapPanel(f"{name}, routes: {len(line.cells)}", layers)
        for name, line in result.lines.items()
    ]
    heading = "Cheapest routes along the range of each weight"
    heading = joined(heading, settings["time_of_day"], by=", ")
    facts = joined(f"{z:g} m above ground", "grey: normalised cost, black: lowest")
    note = "\n".join([facts, frame_note(result.maps, settings["time"]), rules_said(settings)])
    figure, axes = draw_maps(
        result.maps.grid,
        panels_of,
        heading,
        note,
        legend=[
            *obstacle_patches(result.maps, BLOCKED_COLOUR),
            ("given weights\n(dashed)", ON_ROUTES_COLOUR),
            *ENDS,
        ],
        colours=colours,
    )

    for panel, name in zip(axes, result.lines, strict=True):
        draw_ends(panel, [result.route])

        # A row for each route along the range, with the weights between which it is the cheapest.
        table = result.breakpoints(name)
        given_weight = result.weights[result.names.index(name)]
        middle = np.sqrt(table["from"] * table["to"]) / given_weight
        widths = np.linspace(3.2, 1.4, len(table))
        routes = LineCollection(
            result.line_routes[name],
            capstyle="round",
            colors=colours(middle),
            linewidths=widths,
            zorder=4,
        )
        panel.add_collection(routes)

        # The route under the given weights, white with a dark edge, so that it is seen over all colours.
        edge = [Stroke(linewidth=2.4, foreground=INK), Normal()]
        panel.plot(
            *result.route.xy_m.T,
            color=ON_ROUTES_COLOUR,
            linewidth=1.2,
            linestyle=(0, (3, 2)),
            path_effects=edge,
            zorder=6,
        )
    return figure


@styled
def plot_pareto(result: Sensitivity) -> Figure:
    """Return the best trade-offs between two or three features of routes, a point per route (supported Pareto points).

    The first two features are the axes, and the last one is the colour; a star is the route under the given weights.
    """
    # The features of each route, and of the route under the given weights: these are the gradient of the cost.
    front = result.front
    figure = chart(4.0, f"Best trade-offs between {listed(front.objectives)}")
    panel = figure.subplots()
    points = front.points[[*front.objectives]].to_numpy()
    gradient = result.cost["gradient"].loc[[*front.objectives]].to_numpy()
    last = np.append(points[:, -1], gradient[-1])
    labels = [_feature_label(result, name) for name in front.objectives]
    colours = Colours("viridis", Normalize(last.min(), last.max()), labels[-1])
    look: Look = {"norm": colours.norm, "cmap": colours.cmap, "label": "_"}
    x, y, *_ = points.T
    panel.scatter(x, y, s=26, c=points[:, -1], edgecolors=FAINT_INK, linewidths=0.4, **look)

    # The star.
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
    """Return the label of an axis for the distance or a metric's cost c along a route, with its unit."""
    if name == "distance":
        return "distance (m)"
    settings = result.route.settings
    unit = "sum of c over steps"
    if settings["cost_model"] == "line":
        unit = f"sum of c per {settings['reference_length_m']:g} m"
    return f"{name} cost ({unit}; lower is better)"
