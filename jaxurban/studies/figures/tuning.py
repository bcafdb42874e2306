"""Pictures of fitted weights: how sure they are, and what routes they lead to."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np
from matplotlib.figure import Figure

from jaxurban.draw.frame import (
    BLOCKED_COLOUR,
    ENDS,
    DrawnMap,
    MapPanel,
    draw_maps,
    frame_note,
    joined,
    mark_ends,
    rules_said,
)
from jaxurban.draw.metrics import line_colour, obstacle_layer, obstacle_patches
from jaxurban.draw.paths import colours_of_cost
from jaxurban.draw.routes import draw_lines
from jaxurban.draw.style import dots, drawing, name_rows, panels, show_plain_log
from jaxurban.paths.cost_map import CostMap
from jaxurban.pictures import Form, MapForm
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.tuning.weight_fit import WeightFit

DEMONSTRATION_COLOUR, PLANNED_COLOUR, PILOT_COLOUR = "#009e73", "#0b3c8c", "#000000"


@drawing
def plot_weights(fit: WeightFit, **form: Unpack[Form]) -> Figure:
    """Return each fitted weight as a dot with its interval, on a logarithmic scale.

    A weight of 0 is a triangle at the upper end of its interval, or a line there where it is not decided, and nothing
    where this is 0 too, as where the routes do not identify it; a dot without an interval is hollow. A cross is the
    weight of the pilot who flew the routes, where it is known.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> shown = ju.fit.demonstrations([path], maps)
      >>> fit = ju.fit.fit_weights(shown, bootstrap=0)
      >>> ju.plot.plot_weights(fit).savefig("weights.png")
    """
    # A row per weight, with the ends of its interval named as `dots` expects them; NaN where there is no dot.
    table = fit.table.rename(columns={"low": "weight_low", "high": "weight_high"})
    is_0 = table.weight == 0
    is_open = table.index.isin([name for each in fit.verdicts if each.needed for name in each.what])
    drawn = table.weight.mask(is_0, table.weight_high)
    table["weight"] = drawn.where(drawn > 0)
    heading = "Fitted weights and their intervals"
    figure, (panel,) = panels(1, heading, height_in=0.3 * len(table), **form)
    for place, name in enumerate(table.index):
        marker = "o"
        if is_0[name]:
            marker = "|" if is_open[place] else "<"
        row = table.loc[[name]]
        dots(panel, np.array([place]), row, "weight", color=line_colour(name), marker=marker)
    # What the marks mean that are drawn.
    marks = ["dot: the fitted weight", "bar: its interval"]
    if (table.weight_low <= 0).any():
        marks.append("bar to the edge: reaches 0")
    if (is_0 & ~is_open & (drawn > 0)).any():
        marks.append("triangle: the weight is 0, and at most this")
    pilot = table.pilot.where(table.pilot > 0)
    if pilot.notna().any():
        panel.scatter(pilot, range(len(table)), marker="x", color=PILOT_COLOUR, zorder=3)
        marks.append("cross: the pilot's weight")
    # A bar that reaches 0 is cut off a decade below at the nearest, so that it does not look short.
    panel.set(xscale="log")
    least, most = panel.get_xlim()
    panel.set(
        xlim=(min(least, most / 10), most), xlabel="\n".join(["weight, of a sum of 1", *marks])
    )
    show_plain_log(panel.xaxis)
    name_rows(panel, (table.index + ", " + table.unit).to_list())
    return figure


@drawing
def plot_fitted_routes(
    demonstrations: Sequence[Demonstration],
    planned: Sequence[Demonstration],
    cost_map: CostMap,
    weights: np.ndarray,
    given: str = "demonstration",
    **form: Unpack[MapForm],
) -> Figure:
    """Return a map of the cost under weights with the demonstrations on it and the routes that the weights lead to.

    Args:
      demonstrations: as given.
      planned: the cheapest routes under the weights between the same ends.
      cost_map: one of their maps; only those on it are drawn.
      weights: ``[K]`` distance and the map's metrics.
      given: what the demonstrations are called: a fit to targets takes only their ends.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> shown = ju.fit.demonstrations([path], maps)
      >>> fit = ju.fit.fit_weights(shown, bootstrap=0)
      >>> fitted = ju.plan(maps, start, goal, altitude_m=60.0, weights=fit.weights)
      >>> found = ju.fit.demonstrations([fitted], maps)
      >>> figure = ju.plot.plot_fitted_routes(shown, found, shown[0].query.cost_map, fit.weights.vector(fit.names))
      >>> figure.savefig("routes.png")
    """
    # What the picture says of the map and of the weights.
    grid = cost_map.grid
    maps = cost_map.maps
    title = joined(f"{cost_map.altitude_m:g} m above ground", cost_map.time_of_day)
    fitted = dict(zip(("distance", *cost_map.names), weights.tolist(), strict=True))
    settings = cost_map.record | {"weights": fitted}
    note = f"{frame_note(maps, cost_map.time)}\n{rules_said(settings)}"

    # [Y, X] the cost of each cell under the weights, NaN where no route goes.
    cost = np.tensordot(weights[1:], cost_map.costs, axes=1)
    free = np.where(cost_map.is_free, cost, np.nan)
    colours = replace(colours_of_cost(free), label="cost of a cell\nunder the weights")
    obstacles = obstacle_layer(maps, cost_map.altitude_m, BLOCKED_COLOUR)
    has_data = maps.ds["has_data"].values
    is_closed = ~cost_map.is_free & (obstacles.values < 0) & has_data
    shown = DrawnMap(np.where(has_data, cost, np.nan), colours)
    panels_of = [MapPanel(title, [shown, obstacles], is_closed=is_closed)]
    heading = f"{given.capitalize()}s and routes under the fitted weights"
    figure, (panel,) = draw_maps(
        grid,
        panels_of,
        heading,
        note,
        legend=[
            (given, DEMONSTRATION_COLOUR),
            ("fitted weights", PLANNED_COLOUR),
            *obstacle_patches(maps, BLOCKED_COLOUR, panels_of),
            *ENDS,
        ],
        colours=colours,
        **form,
    )

    # A demonstration and, thinner, the route between its ends. Their points are in metres from the southwest corner of
    # the map.
    southwest_m = grid.bounds_m[:2]
    for demonstration, route in zip(demonstrations, planned, strict=True):
        query = demonstration.query
        if query.cost_map is not cost_map:
            continue
        lines_m = demonstration.points_m + southwest_m, route.points_m + southwest_m
        draw_lines(panel, lines_m, (DEMONSTRATION_COLOUR, PLANNED_COLOUR), ["-", "--"])
        ends_m = grid.xy_of_cell(*query.start), grid.xy_of_cell(*query.goal)
        mark_ends(panel, *ends_m, size=0.68)
    return figure
