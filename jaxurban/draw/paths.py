"""Pictures of paths over the normalised cost, the overview of one region, and all pictures of a region as PNG."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import chain, cycle
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from jaxurban.draw.frame import (
    BLOCKED_COLOUR,
    ENDS,
    MOST_RULES,
    DrawnMap,
    MapPanel,
    cropped,
    draw_maps,
    frame_note,
    joined,
    mark_ends,
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
from jaxurban.draw.style import Colours, drawing
from jaxurban.draw.write import Figures, save
from jaxurban.errors import InputError
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
from jaxurban.planners.base import EVERY_PATH, Status
from jaxurban.settings import DEFAULTS
from jaxurban.world.grid import Grid

# A family of planners has a hue, its members a dark and a light tone: the colour-blind see both.
PLANNER_COLOURS = {
    "astar-dist": "#0b3c8c",
    "astar": "#1b74d6",
    "astar-plus": "#3fa9f5",
    "bitstar-dist": "#b3400a",
    "bitstar-plus": "#ffb000",
    "ptp": "#c51b8a",
}
OTHER_COLOURS = ("#00857a", "#4a148c", "#7fc241", "#8c510a", "#59d8c8", "#d9a3ff", "#404040")
# Pale, so that routes stand out, and bluish, as obstacles are tan; the few costs beyond the scale's end are darker.
PALE = LinearSegmentedColormap.from_list("pale", ["#fbfaff", "#a596cf"]).with_extremes(
    over="#7d68b3"
)
COST_LABEL = "normalised cost\n(0: best free cell, 1: worst"
COST_COLOURS = Colours(PALE, Normalize(0, 1), f"{COST_LABEL})")
SHOWN_SHARES = 0.02, 0.98  # of the free cells that are shown lie below the ends of the scale
LARGER = 2.0  # than the surroundings of the routes: of larger maps these alone are drawn
ON_A_GRID = (
    "{}: the best by steps from a cell to its neighbours; at other angles a route may be better."
)
MOST_LETTERS = 17  # of a path's name in the legend and below its panel
STEP_PT = 2.2  # by which a path is wider than the next one, or less
# Widths of the last of several paths of a panel, which lies over the others, and of the first of many.
LINE_PT, WIDEST_PT = 2.2, 7.5
MOST_LISTED = 12  # paths of a panel: more are a batch, whose lines are as narrow, and whose ends are all marked
BATCH_PT, BATCH_END = 1.2, 0.4
EDGED = "edged"  # gid of lines that have white edges
# Of their white edge, which parts them from the map and from lines below: of a lone line, and of how much less wide
# than the line below a line is, so that little of that is hidden.
EDGE_PT, EDGE_SHARE = 0.8, 0.18

Paths = PlannedPath | Sequence[PlannedPath | None] | Mapping[str, PlannedPath | None]


class CostChoice(NamedTuple):
    """Which map of the cost a path was planned on; without a time or a time of day the maps have none."""

    altitude_m: float
    time: str | None
    time_of_day: str | None


class DrawnPath(NamedTuple):
    """A path and what pictures call it."""

    path: PlannedPath
    name: str = ""

    @property
    def place(self) -> CostChoice:
        """The map of the cost that the path was planned on."""
        settings = self.path.settings
        return CostChoice(self.path.altitude_m, settings["time"], settings["time_of_day"])


def paths_in(paths: Paths) -> list[PlannedPath]:
    """Return the paths of one, several, a batch, or a dictionary.

    Raises:
      InputError: something else than paths.
    """
    if isinstance(paths, PlannedPath):
        return [paths]
    if isinstance(paths, Mapping):
        paths = [*paths.values()]
    planned = [path for path in paths if path is not None]
    for path in planned:
        if not isinstance(path, PlannedPath):
            raise InputError(f"paths must be paths from plan, got {type(path).__name__}")
    return planned


def planner_colours(planners: Iterable[str]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    others = cycle(OTHER_COLOURS)
    return {name: PLANNER_COLOURS.get(name) or next(others) for name in dict.fromkeys(planners)}


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
      InputError: an altitude, time or time of day that these maps do not hold, or another number of names than paths.

    Examples:
      >>> shortest = ju.plan(maps, start, goal, altitude_m=60.0, objective="distance")
      >>> figure = ju.plot.plot_paths(maps, {"cheapest": path, "shortest": shortest})
      >>> figure.savefig("paths.png")
    """
    # A panel for each place: the altitude, time and time of day of a map that paths were planned on.
    maps = as_maps(maps)
    named = named_paths(paths, names)
    planned = [each.path for each in named]
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
    panels = [
        _cost_panel(maps, place, shown, has_times, has_days) for place, shown in named_at.items()
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
    if drawn and not one_weighting(planned):
        of_cost = "cost: that of all weights 1, as those of the routes differ"
    note = joined(facts, rules, of_cost, grid_said(drawn), by="\n")

    # The legend: what no path enters, and each path that is drawn in its colour.
    colours = planner_colours(each.name for each in named)
    paths_at = [[each.path for each in shown] for shown in named_at.values()]
    names_drawn = {each.name: colours[each.name] for each in drawn}
    if len(names_drawn) > MOST_LISTED:
        names_drawn = {}
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


def named_paths(paths: Paths, names: Sequence[str] | None) -> list[DrawnPath]:
    """Return paths with what they are called.

    Args:
      paths: one, several, a batch, or a dictionary by name.
      names: of the paths, in their order; None: each is called by its key, or else by its planner, with a number where
        that planned several between the same ends.

    Raises:
      InputError: something else than paths, or another number of names.
    """
    planned = paths_in(paths)
    if isinstance(paths, Mapping) and names is None:
        names = [name for name, path in paths.items() if path is not None]
    if names is not None and (isinstance(names, str) or len(names) != len(planned)):
        raise InputError(
            f"names must be a list of {len(planned)}, one for each path, got {names!r}"
        )
    if names is None:
        return _numbered(_by_proof([DrawnPath(path, path.search.planner) for path in planned]))

    # A dollar sign begins a formula.
    texts = [name.replace("$", r"\$") for name in names]
    return [DrawnPath(path, text) for path, text in zip(planned, texts, strict=True)]


def _numbered(named: Sequence[DrawnPath]) -> list[DrawnPath]:
    """Return paths; those of one planner between the same ends of a map, under other weights or rules, with numbers."""
    ends = [(each.path.xy_m[:1].tolist(), each.path.xy_m[-1:].tolist()) for each in named]
    keys = [str((each.name, each.place, *of_it)) for each, of_it in zip(named, ends, strict=True)]
    totals, counted = Counter(keys), Counter[str]()
    numbered: list[DrawnPath] = []
    for key, each in zip(keys, named, strict=True):
        counted[key] += 1
        is_one = totals[key] == 1 or not each.path.status.has_path
        numbered.append(each if is_one else each._replace(name=f"{each.name} {counted[key]}"))
    return numbered


def _by_proof(named: Sequence[DrawnPath]) -> list[DrawnPath]:
    """Return paths; those of one query that are all proven cheapest on one graph become one, ``astar``."""
    together: dict[Any, list[DrawnPath]] = {}
    for number, each in enumerate(named):
        path = each.path
        key: Any = number
        if path.status is Status.OPTIMAL:
            ends = path.xy_m[[0, -1]].tolist()
            rules = {**path.settings, "budget_s": 0, "seed": 0}
            key = str((each.place, path.search.graph, ends, rules, f"{path.cost:.9g}"))
        together.setdefault(key, []).append(each)
    return [
        DrawnPath(same[0].path, same[0].name if len(same) == 1 else DEFAULTS.planner)
        for same in together.values()
    ]


def _cost_panel(
    maps: MetricMaps,
    place: CostChoice,
    named: Sequence[DrawnPath],
    has_time: bool,
    has_day: bool,
) -> MapPanel:
    """Return a panel of the normalised cost, below which the outcome of each path stands.

    Args:
      maps: of the cost.
      place: which map of the cost.
      named: the paths that were planned on it.
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
    layers = cost_layers(maps, *place, one_weighting([each.path for each in named]))
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


def draw_paths(panel: Axes, paths: Sequence[PlannedPath], colours: Sequence[str]) -> None:
    """Draw the paths that reach their goal, and start and goal of the first of them.

    Args:
      panel: a map.
      paths: the paths of the panel; those without a route are left out.
      colours: one for each path.
    """
    shown = zip(paths, colours, strict=True)
    found = [(path.xy_m, colour) for path, colour in shown if path.status.has_path]
    draw_lines(panel, [line_m for line_m, _ in found], [colour for _, colour in found])
    draw_ends(panel, paths)


def draw_lines(
    panel: Axes, lines_m: Sequence[np.ndarray], colours: Any, styles: Sequence[Any] = ("-",)
) -> None:
    """Draw lines with white edges where they are, the first widest, so that all are seen where they coincide.

    Args:
      panel: a map.
      lines_m: ``[N, 2]`` easting and northing of the points of each line, in metres.
      colours: one for each line.
      styles: of the lines, one after the other, as Matplotlib has them.
    """
    widths_pt = widths_of(len(lines_m))
    steps_pt = -np.diff(widths_pt)
    edge_pt = min(EDGE_PT, EDGE_SHARE * steps_pt[steps_pt > 0].min(initial=np.inf))
    for line_m, colour, style, width_pt in zip(
        lines_m, colours, cycle(styles), widths_pt, strict=False
    ):
        effect = withStroke(linewidth=width_pt + 2 * edge_pt, foreground="white")
        line = LineCollection(
            [line_m],
            linewidths=width_pt,
            colors=[colour],
            linestyles=[style],
            joinstyle="round",
            zorder=4,
            gid=EDGED,
            path_effects=[effect],
        )
        panel.add_collection(line, autolim=False)


def widths_of(num: int) -> np.ndarray:
    """Return the widths of lines in points, each less than the one before it; a lone line is wide, many are narrow."""
    if num > MOST_LISTED:  # of a batch, which seldom coincide
        return np.full(num, BATCH_PT)
    widest_pt = min(WIDEST_PT, LINE_PT + STEP_PT * max(num - 1, 1))
    return np.linspace(widest_pt, LINE_PT, num)


def path_entries(colours: Mapping[str, str], *paths_at: Sequence[PlannedPath]) -> list[Line2D]:
    """Return the entries of a legend: the names of paths, and their ends where a panel shows any.

    Args:
      colours: of the paths, by their names.
      paths_at: the paths of each panel.
    """
    lines = [
        Line2D([], [], color=colour, linewidth=2.5, label=legend_name(name))
        for name, colour in colours.items()
    ]
    if any(path.status.has_path for path in chain(*paths_at)):
        lines += ENDS
    return lines


def outcome_line(path: PlannedPath, name: str, has_cost: bool = True) -> str:
    """Return a line of text: a path's name, with its cost and its length in km, or with its status without a route.

    Args:
      path: the path.
      name: what pictures call it.
      has_cost: whether the cost is named.
    """
    if not path.status.has_path:
        return f"{legend_name(name)}: {path.status.value}"
    cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
    length = f"{path.length_m / 1000:.2f} km"
    graph = " (best on the grid)" if is_best_of_grid(path) else ""
    return f"{legend_name(name)}: {joined(cost if has_cost else '', length, by=', ')}{graph}"


def batch_line(paths: Sequence[PlannedPath]) -> str:
    """Return a line of text on many paths: how many have a route, and their lengths in km."""
    lengths_km = [path.length_m / 1000 for path in paths if path.status.has_path]
    line = f"{len(lengths_km)} of {len(paths)} have a route"
    if not lengths_km:
        return line
    return f"{line}, {min(lengths_km):.2f} to {max(lengths_km):.2f} km, median {np.median(lengths_km):.2f} km"


def is_best_of_grid(path: PlannedPath) -> bool:
    """Return whether a path is the cheapest of a grid, and one at any angle may cost less."""
    return path.status is Status.OPTIMAL and path.search.graph not in ("", EVERY_PATH)


def grid_said(named: Iterable[DrawnPath]) -> str:
    """Return what the cheapest path of a grid is, if any of some paths is one."""
    names = list(dict.fromkeys(each.name for each in named if is_best_of_grid(each.path)))
    if not names:
        return ""
    more = " ..." * (len(names) > MOST_RULES)
    return ON_A_GRID.format(joined(*names[:MOST_RULES], by=", ") + more)


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found; of many paths those of all."""
    found = [path for path in paths if path.status.has_path]
    if len(paths) > MOST_LISTED:
        for path in found:
            mark_ends(panel, path.xy_m[0], path.xy_m[-1], BATCH_END)
        return
    for path in found[:1]:
        mark_ends(panel, path.xy_m[0], path.xy_m[-1])


def legend_name(name: str) -> str:
    """Return a name of at most `MOST_LETTERS` letters, its end cut off where it is longer."""
    return name if len(name) <= MOST_LETTERS else f"{name[: MOST_LETTERS - 1]}…"


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
      InputError: an altitude, time or time of day that these maps do not hold, or another number of names than paths.

    Examples:
      >>> ju.plot.plot_overview(maps, {"cheapest": path}).savefig("overview.png")
    """
    # The first place at the altitude that paths were planned on, and the paths with a route there.
    maps = as_maps(maps)
    named = named_paths(paths, names)
    planned = [each.path for each in named]
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
