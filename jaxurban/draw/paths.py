"""Pictures of paths over the normalised cost, the overview of one region, and all pictures of a region as PNG."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import chain, cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Stroke, withStroke

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
from jaxurban.draw.style import Colours, Width
from jaxurban.draw.write import Figures, save
from jaxurban.errors import InputError
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.base import TIME, TIME_OF_DAY
from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.registry import ON_REQUEST
from jaxurban.metrics.variables import AUXILIARY_VARIABLES
from jaxurban.paths.closed import OBSTACLE, causes_at, constraints_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import rules_on
from jaxurban.planners.base import Status
from jaxurban.settings import DEFAULTS

# A family of planners has a hue, its members a dark and a light tone: the colour-blind see both.
PLANNER_COLOURS = {
    "astar-dist": "#0b3c8c",
    "astar": "#1b74d6",
    "astar-plus": "#3fa9f5",
    "bitstar-dist": "#b3400a",
    "bitstar-plus": "#ffb000",
    "ptp": "#c51b8a",
}
OTHER_COLOURS = ("#00857a", "#7b3fb5", "#7fc241", "#8c510a", "#59d8c8", "#d9a3ff", "#404040")
COST_COLOURS = Colours("gray", Normalize(0, 1), "normalised cost\n(0: best free cell, 1: worst)")
MOST_LETTERS = 17  # of a path's name in the legend and below its panel
LINE_PT = 1.6  # of a path
EDGE_PT = 0.4  # of its white edge, which parts it from the map and from the next one
APART_PT = 2.3  # from the middle of a path to that of the next one where both coincide
# Lines are side by side where more than `SHARED` of a stretch lies in the other's cells, which is `SHORT` of the line.
SHORT, SHARED = 0.02, 0.5
POINTS_PER_IN = 72

Paths = PlannedPath | Sequence[PlannedPath | None]


class CostChoice(NamedTuple):
    """Which map of the cost a path was planned on; without a time or a time of day the maps have none."""

    altitude_m: float
    time: str | None
    time_of_day: str | None


class _NamedPath(NamedTuple):
    """A path and what pictures call it."""

    path: PlannedPath
    name: str = ""

    @property
    def place(self) -> CostChoice:
        """The map of the cost that the path was planned on."""
        settings = self.path.settings
        return CostChoice(self.path.altitude_m, settings["time"], settings["time_of_day"])


def paths_in(paths: Paths) -> list[PlannedPath]:
    """Return the paths of one, several or a batch.

    Raises:
      InputError: something else than paths.
    """
    if isinstance(paths, PlannedPath):
        return [paths]
    planned = [path for path in paths if path is not None]
    for path in planned:
        if not isinstance(path, PlannedPath):
            raise InputError(f"paths must be paths from plan, got {type(path).__name__}")
    return planned


def planner_colours(planners: Iterable[str]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    others = cycle(OTHER_COLOURS)
    return {name: PLANNER_COLOURS.get(name) or next(others) for name in dict.fromkeys(planners)}


def plot_paths(
    maps: MapsLike,
    paths: Paths,
    *,
    altitude_m: Altitudes = None,
    names: Sequence[str] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    lanes: bool = True,
    width: Width = "page",
) -> Figure:
    """Return the normalised cost by altitude (black best, white worst) with the paths of all planners.

    A panel shows the GPS time and the time of day that its paths were planned for, in its title where they differ from
    panel to panel. Under it stands each planner's cost and length, or its status. Where paths share cells they are
    drawn side by side (`side_by_side`), so that all are seen. Cells that are closed to all of them and no obstacle are
    hatched (`closed_at`).

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several or a batch; empty for the costs alone.
      altitude_m: which altitude, or which ones; left out, those of the paths, or all of the maps' where there is none.
      names: what the paths are called, one after the other; left out, by their planners.
      time: UTC time of the GPS maps of a panel without paths; the first if left out.
      time_of_day: of the population map of a panel without paths; the first if left out.
      lanes: whether paths are drawn side by side where they share cells; else each is where it is, the last on top.
      width: see `plot_metric`.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold, or another number of names than paths.
    """
    # A panel for each place: the altitude, time and time of day of a map that paths were planned on.
    maps = as_maps(maps)
    named = _named(paths, names)
    planned = [each.path for each in named]
    if altitude_m is None:
        altitude_m = sorted({path.altitude_m for path in planned})
    places: list[CostChoice] = []
    for z in altitudes_of(maps, altitude_m):
        places += _places_at(maps, z, planned, time, time_of_day)
    named_at = {place: [each for each in named if each.place == place] for place in places}
    times = {place.time for place in places}
    has_times = len(times) > 1
    panels = [_cost_panel(maps, place, shown, has_times) for place, shown in named_at.items()]

    # The heading, which names the time of day if all panels have one.
    drawn = list(chain.from_iterable(named_at.values()))
    what = "Cost and paths" if drawn else "Cost"
    days = {place.time_of_day for place in places}
    day = days.pop() if len(days) == 1 else ""
    heading = joined(f"{what}, by altitude above ground", day, by=", ")

    # The note: sky and maps, and the rules of the routes.
    facts = frame_note(maps, None if has_times else times.pop())
    note = joined(facts, rules_said(*(each.path.settings for each in drawn)), by="\n")

    # The legend: what no path enters, and each path that is drawn in its colour.
    colours = planner_colours(each.name for each in named)
    paths_at = [[each.path for each in shown] for shown in named_at.values()]
    names_drawn = {each.name: colours[each.name] for each in drawn}
    entries = path_entries(names_drawn, *paths_at, lanes=lanes)
    figure, axes = draw_maps(
        maps.grid,
        panels,
        heading,
        note,
        legend=[*obstacle_patches(maps, BLOCKED_COLOUR, panels), *entries],
        colours=COST_COLOURS,
        width=width,
    )
    for panel, shown, here in zip(axes, named_at.values(), paths_at, strict=True):
        draw_paths(panel, here, [colours[each.name] for each in shown], APART_PT * lanes)
    return figure


def _named(paths: Paths, names: Sequence[str] | None) -> list[_NamedPath]:
    """Return paths with what they are called.

    Args:
      paths: one, several or a batch.
      names: of the paths, in their order; None: each is called by its planner.

    Raises:
      InputError: something else than paths, or another number of names.
    """
    planned = paths_in(paths)
    if names is not None and (isinstance(names, str) or len(names) != len(planned)):
        raise InputError(
            f"names must be a list of {len(planned)}, one for each path, got {names!r}"
        )
    if names is None:
        return _by_proof([_NamedPath(path, path.search.planner) for path in planned])

    # A dollar sign begins a formula.
    texts = [name.replace("$", r"\$") for name in names]
    return [_NamedPath(path, text) for path, text in zip(planned, texts, strict=True)]


def _by_proof(named: Sequence[_NamedPath]) -> list[_NamedPath]:
    """Return paths; those of one query that are all proven cheapest on one graph become one, ``astar``."""
    together: dict[Any, list[_NamedPath]] = {}
    for number, each in enumerate(named):
        path = each.path
        key: Any = number
        if path.status is Status.OPTIMAL:
            ends = path.xy_m[[0, -1]].tolist()
            rules = {**path.settings, "budget_s": 0, "seed": 0}
            key = str((each.place, path.search.graph, ends, rules, f"{path.cost:.9g}"))
        together.setdefault(key, []).append(each)
    return [
        _NamedPath(same[0].path, same[0].name if len(same) == 1 else DEFAULTS.planner)
        for same in together.values()
    ]


def _cost_panel(
    maps: MetricMaps, place: CostChoice, named: Sequence[_NamedPath], has_time: bool
) -> MapPanel:
    """Return a panel of the normalised cost, below which the outcome of each path stands.

    Args:
      maps: of the cost.
      place: which map of the cost.
      named: the paths that were planned on it.
      has_time: whether the title names the time, if the map has one.
    """
    title = joined(f"{place.altitude_m:g} m", place.time_of_day, by=" · ")
    if place.time and has_time:
        title = joined(title, time_said(place.time), by=" · ")
    foot = joined(
        "cost, length:" if named else "",
        *(outcome_line(each.path, each.name) for each in named),
        by="\n",
    )
    is_closed = closed_at(maps, place, [each.path for each in named])
    return MapPanel(title, cost_layers(maps, *place), foot, is_closed=is_closed)


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
    places = dict.fromkeys(_NamedPath(path).place for path in at_altitude)
    day = time_of_day or next(iter(maps.times_of_day), None)
    return list(places) or [CostChoice(altitude_m, time or maps.default_time, day)]


def cost_layers(
    maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None
) -> list[DrawnMap]:
    """Return the normalised cost (0: best free cell, 1: worst) and, over it, the obstacles, as layers of a picture."""
    norm = maps.normalised(altitude_m, time=time, time_of_day=time_of_day)
    return [DrawnMap(norm, COST_COLOURS), obstacle_layer(maps, altitude_m, BLOCKED_COLOUR)]


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


def draw_paths(
    panel: Axes, paths: Sequence[PlannedPath], colours: Sequence[str], apart_pt: float = APART_PT
) -> None:
    """Draw the paths that reach their goal, and start and goal of the first of them.

    Args:
      panel: a map.
      paths: the paths of the panel; those without a route are left out.
      colours: one for each path.
      apart_pt: from one lane to the next; 0: every path is where it is.
    """
    shown = zip(paths, colours, strict=True)
    found = [(path, colour) for path, colour in shown if path.status.has_path]
    side_m = max((path.settings["resolution_m"] for path, _ in found), default=0.0)
    lines_m = [path.xy_m for path, _ in found]
    draw_lines(panel, lines_m, side_m, [colour for _, colour in found], apart_pt)
    draw_ends(panel, paths)


def draw_lines(
    panel: Axes,
    lines_m: Sequence[np.ndarray],
    side_m: float,
    colours: Sequence[str],
    apart_pt: float = APART_PT,
) -> None:
    """Draw lines with white edges, side by side where they share cells.

    Args:
      panel: a map whose place in the figure is settled.
      lines_m: ``[N, 2]`` easting and northing of the points of each line, in metres.
      side_m: of a cell.
      colours: one for each line.
      apart_pt: from one lane to the next; 0: every line is where it is.
    """
    figure: Any = panel.figure
    m_per_pt = np.ptp(panel.get_xlim()) / panel.bbox.width * figure.dpi / POINTS_PER_IN
    places_m = side_by_side(lines_m, side_m, apart_pt * m_per_pt)
    edge = withStroke(linewidth=LINE_PT + 2 * EDGE_PT, foreground="white")
    for line_m, colour in zip(places_m, colours, strict=True):
        panel.plot(
            *line_m,
            zorder=4,
            path_effects=[edge],
            color=colour,
            linewidth=LINE_PT,
            solid_joinstyle="round",
        )


def side_by_side(
    lines_m: Sequence[np.ndarray], side_m: float, apart_m: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return where lines are drawn: spread evenly around their place where they share cells, elsewhere where they are.

    Lines that only cross each other stay (`SHARED`), and those that part do so gently.

    Args:
      lines_m: ``[N, 2]`` easting and northing of the points of each line, in metres.
      side_m: of a cell.
      apart_m: from one line to the next in a cell that they share.

    Returns:
      ``[V]`` eastings and ``[V]`` northings of each line, which has more points than before.
    """
    points_m = [
        shapely.get_coordinates(shapely.segmentize(shapely.LineString(line_m), side_m / 2))
        for line_m in lines_m
    ]
    cells = [np.floor(each_m / side_m) @ (1, 1j) for each_m in points_m]
    places_m = []
    for number, each_m in enumerate(points_m):
        num = 1 + int(SHORT * len(each_m))
        window = np.ones(num) / num
        # Half a lane to the left for each line before this one in the same cells, and to the right for each after it.
        lanes = np.zeros(len(each_m))
        for other, other_cells in enumerate(cells):
            share = np.convolve(np.isin(cells[number], other_cells), window, "same")
            lanes += np.sign(number - other) * (share > SHARED) / 2
        # Places as complex numbers, so that the unit step to the left is i times that along the line.
        xy_m = each_m @ (1, 1j)
        along_m = np.convolve(np.gradient(xy_m), window, "same")
        left = 1j * along_m / np.maximum(abs(along_m), 1e-9)
        xy_m += apart_m * np.convolve(lanes, window, "same") * left
        places_m.append((xy_m.real, xy_m.imag))
    return places_m


BESIDE = Line2D(
    [],
    [],
    linewidth=LINE_PT,
    color="#555555",
    path_effects=[Stroke(offset=(0, -APART_PT / 2)), Stroke(offset=(0, APART_PT / 2))],
    label="shared stretches:\nside by side",
)


def path_entries(
    colours: Mapping[str, str], *paths_at: Sequence[PlannedPath], lanes: bool = True
) -> list[Line2D]:
    """Return the entries of a legend: the names of paths, their ends, and that some are drawn side by side.

    The latter two are left out where no panel shows such paths.

    Args:
      colours: of the paths, by their names.
      paths_at: the paths of each panel.
      lanes: whether paths are drawn side by side where they share cells.
    """
    lines = [
        Line2D([], [], color=colour, linewidth=2.5, label=legend_name(name))
        for name, colour in colours.items()
    ]
    num_found = [sum(path.status.has_path for path in paths) for paths in paths_at]
    if any(num_found):
        lines += ENDS
    if lanes and max(num_found, default=0) > 1:
        lines.append(BESIDE)
    return lines


def outcome_line(path: PlannedPath, name: str) -> str:
    """Return a line of text: a path's name, with its cost and its length in km, or with its status without a route.

    Args:
      path: the path.
      name: what pictures call it.
    """
    if not path.status.has_path:
        return f"{legend_name(name)}: {path.status.value}"
    cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
    return f"{legend_name(name)}: {cost}, {path.length_m / 1000:.2f} km"


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found."""
    for path in [path for path in paths if path.status.has_path][:1]:
        mark_ends(panel, path.xy_m[0], path.xy_m[-1])


def legend_name(name: str) -> str:
    """Return a name of at most `MOST_LETTERS` letters, its end cut off where it is longer."""
    return name if len(name) <= MOST_LETTERS else f"{name[: MOST_LETTERS - 1]}…"


def plot_overview(
    maps: MapsLike,
    paths: Paths = (),
    *,
    altitude_m: float | None = None,
    names: Sequence[str] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    width: Width = "page",
) -> Figure:
    """Return one picture of a region: roof heights, the map of each metric, and paths over the cost.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several or a batch; none for the maps alone.
      altitude_m: one of the maps'; left out, the lowest of the paths', or the maps' first where there is none.
      names: what the paths are called, one after the other; left out, by their planners.
      time, time_of_day: of the maps, where there is no path; the first if left out.
      width: see `plot_metric`.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold, or another number of names than paths.
    """
    # The first place at the altitude that paths were planned on, and the paths with a route there.
    maps = as_maps(maps)
    named = _named(paths, names)
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
    cost, obstacles = cost_layers(maps, *place)
    title = joined(f"Cost{what}", time_of_day)
    is_closed = closed_at(maps, place, drawn)
    panels.append(MapPanel(title, [obstacles, cost], is_closed=is_closed))

    # Note, heading and legend of the picture, and the paths over the last panel.
    colours = planner_colours(each.name for each in named)
    rules = rules_said(*(path.settings for path in drawn))
    note = joined(frame_note(maps, time), rules, by="\n")
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
        width=width,
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

    Raises:
      InputError: the folder cannot be written to, or holds such files that were not written so, or changed since.
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
