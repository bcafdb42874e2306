"""Pictures of what weights do to routes: breakpoints along lines and the Pareto front of one, regrets of many.

In those of many a row is a weight, and bars are intervals over pairs of places; a hollow mark has too few pairs for
one.
"""

from collections.abc import Mapping
from functools import partial
from itertools import chain, combinations

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from jaxurban.draw.frame import (
    BLOCKED_COLOUR,
    ENDS,
    HALO,
    MapPanel,
    draw_maps,
    frame_note,
    joined,
    rules_said,
)
from jaxurban.draw.metrics import line_colour, obstacle_patches
from jaxurban.draw.paths import (
    CostChoice,
    closed_at,
    cost_layers,
    draw_ends,
    draw_lines,
)
from jaxurban.draw.style import (
    FAINT_INK,
    INK,
    MARKERS,
    SERIES_COLOURS,
    Colours,
    dots,
    legend_below,
    letter_all,
    name_rows,
    panels,
    show_plain,
    show_plain_log,
    styled,
)
from jaxurban.draw.write import Figures, Look, joined_with_and
from jaxurban.studies.decided import edge_band, is_at_edge
from jaxurban.studies.weights.one_route import OneRoute
from jaxurban.studies.weights.summary import ALL

DOTTED = (0, (1, 1))
RUG = 0.06  # height of a breakpoint's tick, as a share of its panel's
MOST_ROUTES = 10  # along the range of one weight
GIVEN_STAR: Look = {"color": "#c51b8a", "markersize": 11.0, "markeredgecolor": INK}
GIVEN_ROUTE: Look = HALO | {  # dark with a white edge, so that it is seen over all colours
    "color": INK,
    "linewidth": 1.2,
    "linestyle": (0, (3, 2)),
    "zorder": 6,
}


DOT_GAP = 0.18  # between dots of two cities, as a share of the distance between two weights
ROW_IN = 0.3  # height of a weight's row


def one_figures(route: OneRoute) -> Figures:
    """Return what draws each figure of one route, by file name."""
    return {
        "switches": partial(plot_breakpoints, route),
        "switch_routes": partial(plot_breakpoint_routes, route),
        "pareto": partial(plot_pareto, route),
    }


def many_figures(tables: Mapping[str, pd.DataFrame], wrong: float) -> Figures:
    """Return what draws each figure of many routes, by file name."""
    return {
        "regret": partial(plot_regret, tables["summary"], wrong),
        "nearest": partial(plot_nearest, tables["summary"], wrong),
    }


@styled
def plot_breakpoints(route: OneRoute) -> Figure:
    """Return the cheapest cost along the range of each weight, the others as given; ticks are where the route changes.

    A panel per varied weight; a dashed line is the given weight.
    """
    heading = "Cheapest cost along the range of each weight"
    figure, axes = panels(len(route.lines), heading, shares_y=True)
    for panel, (name, line) in zip(axes, route.lines.items(), strict=True):
        column = route.names.index(name)
        low, high = line.corners[:, column]

        # The cost at 400 places that are even on the logarithmic axis, and the breakpoints, which are shares of the way
        # from its low end to its high end, as ticks on the axis.
        weights = np.geomspace(low, high, 400)
        shares = (weights - low) / (high - low)
        costs = line.cost_at(np.stack([1 - shares, shares], axis=-1))
        panel.plot(weights, costs, color=line_colour(name), linewidth=1.4)
        changes = low + np.asarray(line.breakpoints) * (high - low)
        panel.vlines(
            changes,
            0,
            RUG,
            transform=panel.get_xaxis_transform(),
            color=INK,
            linewidth=0.8,
            label="breakpoint",
        )

        # The given weight, the axes and the title.
        panel.axvline(
            route.weights[column],
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


def plot_breakpoint_routes(route: OneRoute) -> Figure:
    """Return a map for each varied weight with the routes along its range, coloured by where they are the cheapest.

    A route has the colour of the geometric middle of the values at which it is the cheapest, as a multiple of the given
    weight; later routes are thinner, so that earlier ones are seen below them. Of more than `MOST_ROUTES` some are left
    out, evenly. The route under the given weights is dashed, and those along the border of the maps are dotted.
    """
    low, high = route.factors

    label = "weight, as a multiple of the given one"
    colours = Colours("viridis", LogNorm(low, high), label, ticks=(low, 1.0, high))

    # Equal maps of the normalised cost, on which the routes are drawn, with the ends of the given weights' route.
    path = route.path
    maps = path.maps
    assert maps is not None
    settings = path.settings
    z = path.altitude_m
    day = settings["time_of_day"]
    place = CostChoice(z, settings["time"], day)
    layers = cost_layers(maps, *place)
    is_closed = closed_at(maps, place, [path])
    panels_of = []
    for name, line in route.lines.items():
        num = len(line.cells)
        title = f"{name}, {len(_shown(num))} of {num} routes"
        panels_of.append(MapPanel(title, layers, is_closed=is_closed))
    heading = joined("Cheapest routes along the range of each weight", day, by=", ")
    facts = joined(f"{z:g} m above ground", "grey: normalised cost, black: lowest")
    note = "\n".join([facts, frame_note(maps, settings["time"]), rules_said(settings)])
    legend = obstacle_patches(maps, BLOCKED_COLOUR, panels_of)
    legend += [Line2D([], [], label="given weights", **GIVEN_ROUTE), *ENDS]
    band = edge_band(maps)
    at_edge = {}
    for name, lines_m in route.line_routes.items():
        at_edge[name] = [
            is_at_edge(xy_m - maps.grid.bounds_m[:2], maps.grid, band) for xy_m in lines_m
        ]
    if any(chain.from_iterable(at_edge.values())):
        label = "along the border of the maps"
        legend.append(Line2D([], [], label=label, color=INK, linestyle=DOTTED))
    figure, axes = draw_maps(maps.grid, panels_of, heading, note, legend=legend, colours=colours)

    for panel, name in zip(axes, route.lines, strict=True):
        draw_ends(panel, [path])

        # A row for each route along the range, with the weights between which it is the cheapest.
        table = route.breakpoints(name)
        given_weight = route.weights[route.names.index(name)]
        middle = np.sqrt(table["from"] * table["to"]) / given_weight
        shown = _shown(len(table))
        lines_m = [route.line_routes[name][number] for number in shown]
        styles = [("-", DOTTED)[at_edge[name][number]] for number in shown]
        draw_lines(panel, lines_m, colours(middle)[shown], styles)
        panel.plot(*path.xy_m.T, **GIVEN_ROUTE)
    return figure


def _shown(num: int) -> np.ndarray:
    """Return which of the routes along a range are drawn: at most `MOST_ROUTES`, the first and the last among them."""
    return np.unique(np.linspace(0, num - 1, min(num, MOST_ROUTES)).astype(int))


@styled
def plot_pareto(route: OneRoute) -> Figure:
    """Return the best trade-offs between two or three features of routes, a point per route (supported Pareto points).

    A panel for each pair of features; a star is the route under the given weights, and its label says what else these
    count, as a route that serves more may be worse in all that is drawn.
    """
    # The features of each route, and of the route under the given weights.
    names = route.front.objectives
    given = dict(zip(route.names, route.features, strict=True))
    pairs = list(combinations(names, 2))
    weights = zip(route.names, route.weights, strict=True)
    others = [name for name, weight in weights if weight > 0 and name not in names]
    star = "given weights"
    if others:
        star += f", which also count {joined_with_and(others)}"
    figure, axes = panels(len(pairs), f"Best trade-offs between {joined_with_and(names)}")
    for panel, (across, up) in zip(axes, pairs, strict=True):
        points = route.front.points
        panel.plot(points[across], points[up], "o", color=INK, markersize=3.5, label="best routes")
        panel.plot(given[across], given[up], "*", label=star, **GIVEN_STAR)
        panel.set(xlabel=_feature_label(route, across), ylabel=_feature_label(route, up))
        panel.margins(0.06)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(4))
    legend_below(figure, axes[0])
    return figure


def _feature_label(route: OneRoute, name: str) -> str:
    """Return the label of an axis for the distance or a metric's cost c along a route, with its unit."""
    if name == "distance":
        return "distance (m)"
    settings = route.path.settings
    unit = "sum of c over steps"
    if settings["cost_model"] == "line":
        unit = f"sum of c per {settings['reference_length_m']:g} m"
    return f"{name} cost\n({unit})"


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
