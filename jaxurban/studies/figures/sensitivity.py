"""Pictures of what weights do to routes: the routes along the ranges of one, regrets of many.

In those of many a row is a weight, and bars are intervals over pairs of places; a hollow mark has too few pairs for
one.
"""

from itertools import chain
from typing import Unpack

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

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
from jaxurban.draw.metrics import obstacle_patches
from jaxurban.draw.paths import closed_at, cost_layers, one_weighting
from jaxurban.draw.routes import CostChoice, draw_ends, draw_lines
from jaxurban.draw.style import (
    INK,
    MARKERS,
    SERIES_COLOURS,
    Colours,
    dots,
    drawing,
    legend_below,
    name_rows,
    panels,
)
from jaxurban.draw.write import Look
from jaxurban.pictures import Form
from jaxurban.studies.decided import edge_band, is_at_edge
from jaxurban.studies.weights.one_route import OneRoute
from jaxurban.studies.weights.summary import ALL

DOTTED = (0, (1, 1))
MOST_ROUTES = 5  # along the range of one weight
GIVEN_ROUTE: Look = HALO | {  # dark with a white edge, so that it is seen over all colours
    "color": INK,
    "linewidth": 1.2,
    "linestyle": (0, (3, 2)),
    "zorder": 6,
}


DOT_GAP = 0.18  # between dots of two cities, as a share of the distance between two weights
ROW_IN = 0.3  # height of a weight's row
AT_ONCE = "mean, with the interval that holds for all weights at once"
ALONE: Look = {"color": "#bbbbbb", "linewidth": 4.5, "zorder": 1}  # of a weight's interval alone


@drawing
def plot_breakpoint_routes(route: OneRoute, **form: Unpack[Form]) -> Figure:
    """Return a map for each varied weight with the routes along its range, coloured by where they are the cheapest.

    A route has the colour of the geometric middle of the values at which it is the cheapest, as a multiple of the given
    weight; later routes are thinner, so that earlier ones are seen below them. Of more than `MOST_ROUTES` some are left
    out, evenly. The route under the given weights is dashed, and those along the border of the maps are dotted.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> settings = ju.studies.SensitivitySettings(vary=("gps",))
      >>> query = {"altitudes_m": [60.0], "settings": settings, "progress": False}
      >>> result = ju.studies.sensitivity(maps, "one", [(start, goal)], **query)
      >>> result.plot("switch_routes", title="The weight of GPS").savefig("switch_routes.png")
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
    layers = cost_layers(maps, *place, one_weighting([path]))
    is_closed = closed_at(maps, place, [path])
    panels_of = []
    for name, line in route.lines.items():
        num = len(line.cells)
        title = f"{name}, {len(_shown(num))} of {num} routes"
        panels_of.append(MapPanel(title, layers, is_closed=is_closed))
    heading = joined("Cheapest routes along the range of each weight", day, by=", ")
    facts = joined(f"{z:g} m above ground", "ground: normalised cost, the darker the higher")
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
    figure, axes = draw_maps(
        maps.grid, panels_of, heading, note, legend=legend, colours=colours, **form
    )

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


@drawing
def plot_regret(summary: pd.DataFrame, wrong: float, **form: Unpack[Form]) -> Figure:
    """Return how much more a route costs that was planned under one wrong weight: a row per weight, a dot per city.

    Args:
      summary: rows of statistics, each of one weight and of one part of the routes: ``cut`` says by what routes are
        parted and ``value`` which part it is, here the city, or all routes where there is one city; ``regret`` is a
        share of the cost, with intervals that hold for all weights at once, and ``regret_alone`` has that of each
        weight alone, a grey bar behind.
      wrong: by which factor the weight is wrong, in both directions.
      form: width, ax and title, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> result = ju.studies.sensitivity(maps, "many", 12, progress=False)
      >>> result.plot("regret", width="column").savefig("regret.pdf")
    """
    weights = summary.weight_name[summary.regret.notna()].unique().tolist()
    is_city = summary.cut == "city"
    by_city = summary[is_city if is_city.any() else summary.cut == ALL]
    cities = by_city.value.unique()
    heading = f"How much more routes cost with one weight {wrong:g} times too large or too small"
    figure, (panel,) = panels(1, heading, height_in=ROW_IN * len(weights), **form)
    for number, city in enumerate(cities):
        rows = by_city[by_city.value == city].set_index("weight_name").reindex(weights)

        # Dots of several cities stand one below the other around the row of the weight.
        y = np.arange(len(weights)) + (number - (len(cities) - 1) / 2) * DOT_GAP
        low, high = rows[["regret_alone_low", "regret_alone_high"]].to_numpy().T
        has_bar = np.isfinite(low)
        label = "" if number else "interval of each weight alone"
        panel.hlines(y[has_bar], low[has_bar], high[has_bar], label=label, **ALONE)
        dots(
            panel,
            y,
            rows,
            "regret",
            color=SERIES_COLOURS[number % len(SERIES_COLOURS)],
            label=city if len(cities) > 1 else AT_ONCE,
            marker=MARKERS[number % len(MARKERS)],
        )
    name_rows(panel, weights)
    panel.set(xlabel="mean regret (% of the cost)")
    panel.set_xlim(left=0)
    panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=None, symbol=""))
    legend_below(figure, panel)
    return figure
