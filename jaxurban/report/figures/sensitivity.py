"""Pictures of what weights do to a route: breakpoints along lines, the Pareto front."""

from itertools import combinations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from jaxurban.report.figures.frame import (
    BLOCKED_COLOUR,
    ENDS,
    HALO,
    MapPanel,
    draw_maps,
    frame_note,
    joined,
    rules_said,
)
from jaxurban.report.figures.metrics import line_colour, obstacle_patches
from jaxurban.report.figures.paths import (
    EDGE_PT,
    CostChoice,
    closed_at,
    cost_layers,
    draw_ends,
)
from jaxurban.report.figures.style import (
    INK,
    Colours,
    legend_below,
    letter_all,
    panels,
    show_plain,
    show_plain_log,
    styled,
)
from jaxurban.report.write import Figures, Look, joined_with_and
from jaxurban.studies.weights.study import Sensitivity

MOST_ROUTES = 10  # along the range of one weight
GIVEN_STAR: Look = {"color": "#c51b8a", "markersize": 11.0, "markeredgecolor": INK}
GIVEN_ROUTE: Look = HALO | {  # dark with a white edge, so that it is seen over all colours
    "color": INK,
    "linewidth": 1.2,
    "linestyle": (0, (3, 2)),
    "zorder": 6,
}


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

        title = f"{name}, breakpoints: {len(line.breakpoints)}"
        panel.set(xscale="log", xlim=(low, high), xlabel=f"weight of {name}", title=title)
        show_plain_log(panel.xaxis)
        show_plain(panel.yaxis)
    legend_below(figure, axes[0])
    letter_all(axes, "cheapest cost")
    return figure


def plot_breakpoint_routes(result: Sensitivity) -> Figure:
    """Return a map for each varied weight with the routes along its range, coloured by where they are the cheapest.

    A route has the colour of the geometric middle of the values at which it is the cheapest, as a multiple of the given
    weight; later routes are thinner, so that earlier ones are seen below them. Of more than `MOST_ROUTES` some are left
    out, evenly. The route under the given weights is dashed.
    """
    low, high = result.settings.factors

    label = "weight, as a multiple of the given one"
    colours = Colours("viridis", LogNorm(low, high), label, ticks=(low, 1.0, high))

    # Equal maps of the normalised cost, on which the routes are drawn, with the ends of the given weights' route.
    settings = result.route.settings
    z = result.route.altitude_m
    day = settings["time_of_day"]
    place = CostChoice(z, settings["time"], day)
    layers = cost_layers(result.maps, *place)
    is_closed = closed_at(result.maps, place, [result.route])
    panels_of = []
    for name, line in result.lines.items():
        num = len(line.cells)
        title = f"{name}, {len(_shown(num))} of {num} routes"
        panels_of.append(MapPanel(title, layers, is_closed=is_closed))
    heading = joined("Cheapest routes along the range of each weight", day, by=", ")
    facts = joined(f"{z:g} m above ground", "grey: normalised cost, black: lowest")
    note = "\n".join([facts, frame_note(result.maps, settings["time"]), rules_said(settings)])
    figure, axes = draw_maps(
        result.maps.grid,
        panels_of,
        heading,
        note,
        legend=[
            *obstacle_patches(result.maps, BLOCKED_COLOUR, panels_of),
            Line2D([], [], label="given weights", **GIVEN_ROUTE),
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
        shown = _shown(len(table))
        widths = np.linspace(3.2, 1.4, len(shown))
        for number, colour, width in zip(shown, colours(middle)[shown], widths, strict=True):
            edge = [withStroke(linewidth=width + 2 * EDGE_PT, foreground="white")]
            panel.plot(
                *result.line_routes[name][number].T,
                color=colour,
                linewidth=width,
                path_effects=edge,
                zorder=4,
            )
        panel.plot(*result.route.xy_m.T, **GIVEN_ROUTE)
    return figure


def _shown(num: int) -> np.ndarray:
    """Return which of the routes along a range are drawn: at most `MOST_ROUTES`, the first and the last among them."""
    return np.unique(np.linspace(0, num - 1, min(num, MOST_ROUTES)).astype(int))


@styled
def plot_pareto(result: Sensitivity) -> Figure:
    """Return the best trade-offs between two or three features of routes, a point per route (supported Pareto points).

    A panel for each pair of features; a star is the route under the given weights.
    """
    # The features of each route, and of the route under the given weights: these are the gradient of the cost.
    names = result.front.objectives
    gradient = result.cost["gradient"]
    pairs = list(combinations(names, 2))
    figure, axes = panels(len(pairs), f"Best trade-offs between {joined_with_and(names)}")
    for panel, (across, up) in zip(axes, pairs, strict=True):
        points = result.front.points
        panel.plot(points[across], points[up], "o", color=INK, markersize=3.5, label="best routes")
        panel.plot(gradient[across], gradient[up], "*", label="given weights", **GIVEN_STAR)
        panel.set(xlabel=_feature_label(result, across), ylabel=_feature_label(result, up))
        panel.margins(0.06)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(4))
    letter_all(axes)
    legend_below(figure, axes[0])
    return figure


def _feature_label(result: Sensitivity, name: str) -> str:
    """Return the label of an axis for the distance or a metric's cost c along a route, with its unit."""
    if name == "distance":
        return "distance (m)"
    settings = result.route.settings
    unit = "sum of c over steps"
    if settings["cost_model"] == "line":
        unit = f"sum of c per {settings['reference_length_m']:g} m"
    return f"{name} cost ({unit})"
