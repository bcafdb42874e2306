"""Pictures of paths over the normalised cost, the overview of one region, and all pictures of a region as PNG."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Unpack

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from jaxurban.draw.frame import (
    BLOCKED_COLOUR,
    DrawnMap,
    MapPanel,
    cropped,
    draw_maps,
    frame_note,
    joined,
    rules_said,
    surroundings,
    time_said,
)
from jaxurban.draw.heights import plot_heights
from jaxurban.draw.metrics import (
    AVAILABILITY,
    EMPTY_COLOUR,
    RATED,
    Altitudes,
    altitudes_of,
    drawn_variables,
    free_layer,
    layers_above_zero,
    metric_colours,
    obstacle_layer,
    obstacle_patches,
    plot_epochs,
    plot_gps_rating,
    plot_metric,
    plot_obstacles,
    plot_population,
    plot_sensor_choice,
    roof_layers,
)
from jaxurban.draw.routes import (
    MOST_LISTED,
    CostChoice,
    DrawnPath,
    Paths,
    batch_line,
    check_over,
    draw_paths,
    grid_said,
    named_paths,
    outcome_line,
    path_entries,
    paths_in,
    planner_colours,
)
from jaxurban.draw.style import Colours, drawing
from jaxurban.draw.write import Figures, save
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps, scaled_over
from jaxurban.metrics.base import TIME, TIME_OF_DAY
from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.registry import ON_REQUEST
from jaxurban.metrics.variables import AUXILIARY_VARIABLES
from jaxurban.paths.closed import OBSTACLE, causes_at, constraints_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import cost_map, rules_on
from jaxurban.pictures import MapForm
from jaxurban.world.grid import Grid

# Pale, so that routes stand out, and bluish, as obstacles are tan; the few costs beyond the scale's end are darker.
PALE = LinearSegmentedColormap.from_list("pale", ["#fbfaff", "#a596cf"]).with_extremes(
    over="#7d68b3"
)
COST_LABEL = "normalised cost\n(0: best free cell, 1: worst"
COST_COLOURS = Colours(PALE, Normalize(0, 1), f"{COST_LABEL})")
SHOWN_SHARES = 0.02, 0.98  # of the free cells that are shown lie below the ends of the scale
LARGER = 2.0  # than the surroundings of the routes: of larger maps these alone are drawn


@drawing
def plot_paths(
    maps: MapsLike,
    paths: Paths,
    *,
    altitude_m: Altitudes = None,
    names: Sequence[str] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return the normalised cost by altitude (the paler, the better) with the paths of all planners.

    The cost is that under the weights of the paths; where these differ, and without paths, all weights are 1.

    The scale holds the costs of all but a few of the free cells that are shown (`SHOWN_SHARES`). Of maps that are much
    larger than the surroundings of the paths, these alone are drawn.

    A panel shows the GPS time and the time of day that its paths were planned for, in its title where they differ from
    panel to panel. Under it stands each planner's cost and length, or its status; of more than 12 paths how many have a
    route, and their lengths. Earlier paths are wider, so that all are seen where they coincide. Cells that are closed
    to all of them and no obstacle are hatched (`closed_at`).

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several, a batch, or a dictionary by name; empty for the costs alone.
      altitude_m: which altitude, or which ones, within the range of the maps'; left out, those of the paths, or all of
        the maps' where there is none.
      names: what the paths are called, one after the other; left out, by their keys, or else by their planners.
      time: UTC time of the GPS maps of a panel without paths; the first if left out.
      time_of_day: of the population map of a panel without paths; the first if left out.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold, another number of names than paths, or
        a path that lies nowhere over the maps.

    Examples:
      >>> shortest = ju.plan(maps, start, goal, altitude_m=60.0, objective="distance")
      >>> figure = ju.plot.plot_paths(maps, {"cheapest": path, "shortest": shortest})
      >>> figure.savefig("paths.png")
    """
    # A panel for each place: the altitude, time and time of day of a map that paths were planned on.
    maps = as_maps(maps)
    named = named_paths(paths, names)
    planned = [each.path for each in named]
    check_over(maps.grid, planned)
    if altitude_m is None:
        altitude_m = sorted({path.altitude_m for path in planned})
    places: list[CostChoice] = []
    for z in altitudes_of(maps, altitude_m):
        places += _places_at(maps, z, planned, time, time_of_day)
    named_at = {place: [each for each in named if each.place == place] for place in places}
    drawn = list(chain.from_iterable(named_at.values()))
    times = {place.time for place in places}
    days = {place.time_of_day for place in places}
    has_times = len(times) > 1
    has_days = len(days) > 1
    weights = one_weighting([each.path for each in drawn])
    panels = [
        _cost_panel(maps, place, shown, weights, has_times, has_days)
        for place, shown in named_at.items()
    ]

    # Of the maps what lies around the routes, and one scale for all that is shown.
    grid = _shown_part(maps.grid, drawn)
    panels = [cropped(panel, maps.grid, grid) for panel in panels]
    cost_colours = colours_of_cost(*(panel.layers[0].values for panel in panels))
    panels = [
        panel._replace(layers=[panel.layers[0]._replace(colours=cost_colours), panel.layers[1]])
        for panel in panels
    ]

    # The heading, which names the time of day if all panels have one.
    what = "Cost and paths" if drawn else "Cost"
    day = "" if has_days else days.pop()
    heading = joined(f"{what}, by altitude above ground", day, by=", ")

    # The note: sky and maps, and the rules of the routes.
    facts = frame_note(maps, None if has_times else times.pop())
    rules = rules_said(*(each.path.settings for each in drawn))
    of_cost = ""
    if drawn and not weights:
        of_cost = "cost: that of all weights 1, as those of the routes differ"
    note = joined(facts, rules, of_cost, grid_said(drawn), by="\n")

    # The legend: what no path enters, and each path that is drawn in its colour.
    colours = planner_colours(each.name for each in named)
    paths_at = [[each.path for each in shown] for shown in named_at.values()]
    names_drawn = {each.name: colours[each.name] for each in drawn}
    entries = path_entries(names_drawn, *paths_at)
    figure, axes = draw_maps(
        grid,
        panels,
        heading,
        note,
        legend=[*obstacle_patches(maps, BLOCKED_COLOUR, panels), *entries],
        colours=cost_colours,
        **form,
    )
    for panel, shown, here in zip(axes, named_at.values(), paths_at, strict=True):
        draw_paths(panel, here, [colours[each.name] for each in shown])
    return figure


def _shown_part(whole: Grid, drawn: Sequence[DrawnPath]) -> Grid:
    """Return the surroundings of routes if maps are much larger (`LARGER`), else the whole grid of the maps."""
    routes_m = [each.path.xy_m for each in drawn if each.path.status.has_path]
    if not routes_m:
        return whole
    near = surroundings(whole, np.concatenate(routes_m))
    is_larger = np.prod(whole.shape) > LARGER * np.prod(near.shape)
    return near if is_larger else whole


def _cost_panel(
    maps: MetricMaps,
    place: CostChoice,
    named: Sequence[DrawnPath],
    weights: Mapping[str, float],
    has_time: bool,
    has_day: bool,
) -> MapPanel:
    """Return a panel of the normalised cost, below which the outcome of each path stands.

    Args:
      maps: of the cost.
      place: which map of the cost.
      named: the paths that were planned on it.
      weights: of the cost, those of all paths of the picture; 1 where they differ.
      has_time: whether the title names the time, if the map has one.
      has_day: whether it names the time of day.
    """
    day = place.time_of_day if has_day else ""
    title = joined(f"{place.altitude_m:g} m", day, by=" · ")
    if place.time and has_time:
        title = joined(title, time_said(place.time), by=" · ")
    # Costs under different weights cannot be compared.
    has_cost = len({str(each.path.settings["weights"]) for each in named}) == 1
    head = "cost, length:" if has_cost else "length:"
    outcomes = [outcome_line(each.path, each.name, has_cost) for each in named]
    foot = "\n".join([head, *outcomes]) if named else ""
    if len(named) > MOST_LISTED:
        foot = batch_line([each.path for each in named])
    is_closed = closed_at(maps, place, [each.path for each in named])
    layers = cost_layers(maps, *place, weights)
    return MapPanel(title, layers, foot, is_closed=is_closed)


def one_weighting(paths: Sequence[PlannedPath]) -> dict[str, float]:
    """Return the weights under which all of some paths were planned; none where these differ, or without paths."""
    named = [path.settings["weights"] for path in paths]
    return dict(named[0]) if named and all(each == named[0] for each in named) else {}


def _places_at(
    maps: MetricMaps,
    altitude_m: float,
    planned: Sequence[PlannedPath],
    time: str | None = None,
    time_of_day: str | None = None,
) -> list[CostChoice]:
    """Return the maps at an altitude that paths were planned on, each once; without such paths one map.

    Args:
      maps: of the cost.
      altitude_m: the altitude.
      planned: paths, at any altitude.
      time: UTC time of the one map; None: the first of the maps.
      time_of_day: of the one map; None: the first of the maps.
    """
    at_altitude = [path for path in planned if path.altitude_m == altitude_m]
    places = dict.fromkeys(DrawnPath(path).place for path in at_altitude)
    day = time_of_day or next(iter(maps.times_of_day), None)
    return list(places) or [CostChoice(altitude_m, time or maps.default_time, day)]


def cost_layers(
    maps: MetricMaps,
    altitude_m: float,
    time: str | None,
    time_of_day: str | None,
    weights: Mapping[str, float] | None = None,
) -> list[DrawnMap]:
    """Return the normalised cost (0: best free cell, 1: worst) and, over it, the obstacles, as layers of a picture.

    Between two altitudes of the maps the costs are those that planners pay there (`cost_map`).

    Args:
      maps: of the cost.
      altitude_m, time, time_of_day: which map of it.
      weights: of the metrics; 1 for those that are left out, as of H_total.
    """
    if altitude_m in maps.altitudes_m:
        costs = maps.costs(altitude_m, time=time, time_of_day=time_of_day)
    else:
        between = cost_map(maps, altitude_m, time=time, time_of_day=time_of_day)
        costs = dict(zip(between.names, between.costs, strict=True))
    named = weights or {}
    total = np.sum([named.get(name, 1.0) * cost for name, cost in costs.items()], axis=0)
    norm = scaled_over(maps.is_free(altitude_m, "centre"), total)
    colours = colours_of_cost(norm)
    return [DrawnMap(norm, colours), obstacle_layer(maps, altitude_m, BLOCKED_COLOUR)]


def colours_of_cost(*costs: np.ndarray) -> Colours:
    """Return the colours of normalised costs: one scale, between whose ends all but a few of the cells lie.

    Args:
      costs: ``[Y, X]`` of each map that is shown, NaN where no cell is free.
    """
    known = np.concatenate([cost[np.isfinite(cost)] for cost in costs])
    if not known.size:
        return COST_COLOURS
    low, high = np.quantile(known, SHOWN_SHARES).tolist()
    if low == high:
        return COST_COLOURS
    label = f"{COST_LABEL},\nat most {100 * SHOWN_SHARES[0]:g} % beyond an end)"
    extend = "both" if known.min() < low else "max"
    return Colours(PALE, Normalize(low, high), label, extend)


def closed_at(maps: MetricMaps, place: CostChoice, paths: Sequence[PlannedPath]) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells with data that are closed to each path of a panel, and no obstacle.

    Args:
      maps: of the panel.
      place: which map of the cost it shows.
      paths: that were planned on it, whose rules close cells; without any, the rules of the maps' scenario do.
    """
    rules = {(constraints_of(path), path.settings["obstacles"]) for path in paths}
    rules = rules or {(rules_on(maps, None, None, "")[2], maps.obstacles)}
    causes = [causes_at(maps.with_obstacles(rule), limits, *place) for limits, rule in rules]
    return (np.min(causes, axis=0) > OBSTACLE) & maps.ds["has_data"].values


@drawing
def plot_overview(
    maps: MapsLike,
    paths: Paths = (),
    *,
    altitude_m: float | None = None,
    names: Sequence[str] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return one picture of a region: roof heights, the map of each metric, and paths over the cost.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several, a batch, or a dictionary by name; none for the maps alone.
      altitude_m: one of the maps'; left out, the lowest of the paths', or the maps' first where there is none.
      names: what the paths are called, one after the other; left out, by their keys, or else by their planners.
      time, time_of_day: of the maps, where there is no path; the first if left out.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold, another number of names than paths, or
        a path that lies nowhere over the maps.

    Examples:
      >>> ju.plot.plot_overview(maps, {"cheapest": path}).savefig("overview.png")
    """
    # The first place at the altitude that paths were planned on, and the paths with a route there.
    maps = as_maps(maps)
    named = named_paths(paths, names)
    planned = [each.path for each in named]
    check_over(maps.grid, planned)
    z = altitude_m
    if z is None:
        z = min((path.altitude_m for path in planned), default=maps.altitudes_m[0])
    place = _places_at(maps, z, planned, time, time_of_day)[0]
    _, time, time_of_day = place
    named = [each for each in named if each.place == place and each.path.status.has_path]
    drawn = [each.path for each in named]

    # A panel for each metric: of metrics such as population the variable whose zero is drawn in white, of others m in
    # the free cells.
    panels = [MapPanel("Roof height (m)", roof_layers(maps))]
    blank = [AUXILIARY_VARIABLES["roof"].scale.zero]  # what white stands for
    for name, metric in maps.metrics.items():
        with_zero = [each for each in metric.variables.values() if each.scale.zero]
        for variable in with_zero:
            values = maps.m(variable.name, time_of_day=time_of_day)
            layers = layers_above_zero(values, metric_colours(maps, variable.name))
            panels.append(MapPanel(joined(metric.label, time_of_day), layers))
            blank.append(variable.scale.zero)
        if not with_zero:
            layers = [obstacle_layer(maps, z, BLOCKED_COLOUR), free_layer(maps, name, z, time=time)]
            panels.append(MapPanel(metric.label, layers))

    # The cost. It is the last layer of its panel, which has the colour bar, as obstacles have none of their own.
    what = " and paths" if drawn else ""
    cost, obstacles = cost_layers(maps, *place, one_weighting(drawn))
    title = joined(f"Cost{what}", time_of_day)
    is_closed = closed_at(maps, place, drawn)
    panels.append(MapPanel(title, [obstacles, cost], is_closed=is_closed))

    # Note, heading and legend of the picture, and the paths over the last panel.
    colours = planner_colours(each.name for each in named)
    rules = rules_said(*(path.settings for path in drawn))
    note = joined(frame_note(maps, time), rules, grid_said(named), by="\n")
    heading = joined(f"Metric maps{what}, {z:g} m above ground", time_of_day, by=", ")
    figure, axes = draw_maps(
        maps.grid,
        panels,
        heading,
        note,
        legend=[
            (",\n".join(blank), EMPTY_COLOUR),
            *obstacle_patches(maps, BLOCKED_COLOUR, panels),
            *path_entries(colours, drawn),
        ],
        has_ticks=False,
        **form,
    )
    draw_paths(axes[-1], drawn, [colours[each.name] for each in named])
    return figure


def save_figures(maps: MapsLike, paths: Paths, folder: str | Path) -> list[Path]:
    """Write every picture of these maps and paths as PNG and return the files; each appears whole or not at all.

    GPS at one time is drawn at the first; of several times there is also a panel each (``gps_epochs``) and the share of
    them at which it is good enough (``gps_availability``), of a long series the latter and what 5 % stay below.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: one, several or a batch; empty for maps alone.
      folder: where to; made if it is not there.

    Returns:
      The files.

    Raises:
      InputError: the folder cannot be written to, or holds such files that were not written so, or changed since.

    Examples:
      >>> [file.name for file in ju.plot.save_figures(maps, path, "figures")][:3]
      ['overview.png', 'heights.png', 'obstacle.png']
    """
    maps = as_maps(maps)
    outputs = {f"{name}.png": draw for name, draw in maps_figures(maps, paths).items()}
    with Workspace.shared(Path(folder), "maps --figures", outputs):
        return save(folder, outputs)


def maps_figures(maps: MetricMaps, paths: Paths) -> Figures:
    """Return the functions that draw the pictures of these maps and paths, by file name without its end.

    Args:
      maps: whose metrics are drawn.
      paths: one, several or a batch; empty: the cost is drawn instead, a picture per time of day.
    """
    # The maps; metrics that vary with the time of day are left for the picture of people.
    by_day = [name for name, metric in maps.metrics.items() if TIME_OF_DAY in metric.dims]
    figures: Figures = {
        "overview": lambda: plot_overview(maps, paths),
        "heights": lambda: plot_heights(maps),
        "obstacle": lambda: plot_obstacles(maps),
        **{name: partial(plot_metric, maps, name) for name in maps.metrics if name not in by_day},
        "sensor_choice": lambda: plot_sensor_choice(maps),
    }

    # The cost: with the paths over it, or alone at each time of day.
    if paths_in(paths):
        figures["paths"] = lambda: plot_paths(maps, paths)
    else:
        for time_of_day in maps.times_of_day or (None,):
            name = "cost" if len(maps.times_of_day) < 2 else f"cost_{time_of_day}"
            figures[name] = partial(plot_paths, maps, (), time_of_day=time_of_day)

    # Further variables: statistics of a long series, and all those of metrics that are made on request only.
    held = held_metrics(maps.ds, costs_only=False)
    on_request = {name for name, metric in held.items() if metric.section in ON_REQUEST}
    for name, variable in drawn_variables(maps).items():
        has_statistics = maps.variable(variable.of) != variable.of  # such as a median instead of m
        is_statistic = has_statistics and name.endswith(("_availability", "_p05"))
        if name == AVAILABILITY or is_statistic or variable.of in on_request:
            figures[name] = partial(plot_metric, maps, name)

    # Metrics that vary with time, at each of several times; the GPS rating; and people.
    if len(maps.times) > 1 and maps.default_time is not None:
        for name, metric in maps.metrics.items():
            if TIME in metric.dims and name not in on_request:
                figures[f"{name}_epochs"] = partial(plot_epochs, maps, name)

    if RATED in maps.ds:  # statistics over a long series hold none
        figures["gps_rating"] = lambda: plot_gps_rating(maps)
    for name in by_day:
        figures[name] = lambda: plot_population(maps)
    return figures
