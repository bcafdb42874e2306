"""Pictures of paths over the normalised cost, and the overview of one region."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.frame import ENDS, LegendEntry, MapLayer, MapPanel, draw_maps, mark_ends
from jaxurban.report.figures.metrics import (
    free_layer,
    layers_above_zero,
    metric_colours,
    obstacle_layer,
    obstacle_patches,
    roof_layers,
)
from jaxurban.report.figures.notes import frame_note, joined, meaning_of, rules_said, time_said
from jaxurban.report.figures.style import Colours, ends_of

# The paper's colours (tab10), then the rest of tab10 for planners that it does not have.
PLANNER_COLOURS = {
    "astar-dist": "#1f77b4",
    "astar-plus": "#ff7f0e",
    "bitstar-dist": "#2ca02c",
    "bitstar-plus": "#d62728",
    "ptp": "#9467bd",
}
OTHER_COLOURS = ("#e377c2", "#17becf", "#bcbd22", "#8c564b", "#aec7e8", "#ffbb78", "#98df8a")
COST_ENDS = "0: best free cell, 1: worst"
COST_COLOURS = Colours("gray", Normalize(0, 1), f"$H_\\mathrm{{norm}}$\n({COST_ENDS})")
BLOCKED_COLOUR = "#d9c08c"  # obstacles over the grey cost map
MOST_LETTERS = 17  # of a path's name in the legend and below its panel
MOST_WIDER_PT = 7.2  # of the first of several paths, whose lines narrow one after the other
EDGE_PT = 0.25  # of the dark edge of a path, by which paths that coincide are told apart without their colours

Paths = PlannedPath | Sequence[PlannedPath | None] | Mapping[float, Sequence[PlannedPath]]


def by_altitude(paths: Paths) -> dict[float, list[PlannedPath]]:
    """Return paths, one or several or already so, by the altitude that they start at.

    Raises:
      InputError: something else than paths.
    """
    if isinstance(paths, Mapping):
        return {float(altitude_m): list(planned) for altitude_m, planned in paths.items()}
    found: dict[float, list[PlannedPath]] = {}
    for path in [paths] if isinstance(paths, PlannedPath) else paths:
        if path is not None:
            if not isinstance(path, PlannedPath):
                raise InputError(f"paths must be paths from plan, or such by altitude, got {type(path).__name__}")
            found.setdefault(path.altitude_m, []).append(path)
    return found


def planner_colours(planners: Iterable[str]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    others = cycle(OTHER_COLOURS)
    return {name: PLANNER_COLOURS.get(name) or next(others) for name in dict.fromkeys(planners)}


def plot_paths(
    maps: GivenMaps,
    paths: Paths,
    *,
    altitudes_m: Sequence[float] | None = None,
    names: Sequence[str] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
) -> Figure:
    """Return H_total by altitude, the sum of the costs (black best, white worst), with the paths of all planners.

    All panels have one scale. A panel shows the GPS time and the time of day that its paths were planned for, in its
    title where they differ from panel to panel. Under it stands each planner's cost and length, or its status. Where
    paths coincide, the later one is drawn narrower, so that both are seen.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several, a batch, or paths by altitude; empty for the costs alone.
      altitudes_m: which altitudes; left out, all of the maps', or those of the paths that are not given by altitude.
      names: what the paths are called, one after the other; left out, by their planners.
      time: UTC time of the GPS maps of a panel without paths; the first if left out.
      time_of_day: of the population map of a panel without paths; the first if left out.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold, or another number of names than paths.
    """
    maps, planned_at = as_maps(maps), by_altitude(paths)
    name_of = _names(planned_at, names)
    shown = maps.altitudes_m if isinstance(paths, Mapping) or not planned_at else tuple(sorted(planned_at))
    shown = shown if altitudes_m is None else tuple(altitudes_m)
    of_panels = [panel for z in shown for panel in _panels_at(maps, z, planned_at.get(z, ()), time, time_of_day)]
    every = [path for *_, planned in of_panels for path in planned]
    colours = planner_colours(name_of[id(path)] for path in every)
    times = list(dict.fromkeys(at for _, at, _, _ in of_panels))
    totals = [
        np.where(maps.is_free(z, "centre"), maps.total(z, time=at, time_of_day=day), np.nan)
        for z, at, day, _ in of_panels
    ]
    scale, panels = _total_colours(totals), []
    for total, (z, at, day, planned) in zip(totals, of_panels, strict=True):
        title = " · ".join(filter(None, (f"{z:g} m", day, time_said(at) if at and len(times) > 1 else "")))
        foot = "\n".join(outcome_of(path, name_of[id(path)]) for path in planned)
        panels.append(MapPanel(title, [MapLayer(total, scale), obstacle_layer(maps, z, BLOCKED_COLOUR)], foot))
    not_same = "time of day: as the paths were planned for, not the same in all panels"
    note = joined(
        frame_note(maps, times[0] if len(times) == 1 else None),
        not_same if len({day for _, _, day, _ in of_panels}) > 1 else "",
        "below: cost, length" if every else "",
    )
    note = "\n".join(filter(None, [note, rules_said(*(path.settings for path in every))]))
    heading = f"Cost{' and paths' if every else ''}, by altitude above ground"
    legend: list[LegendEntry] = [*obstacle_patches(maps, BLOCKED_COLOUR), *path_entries(colours, every)]
    figure, axes = draw_maps(maps.grid, panels, heading, note, legend=legend, colours=scale)
    for panel, (*_, planned) in zip(axes, of_panels, strict=True):
        draw_paths(panel, planned, [colours[name_of[id(path)]] for path in planned])
    return figure


def _total_colours(totals: Sequence[np.ndarray]) -> Colours:
    """Return one grey scale over all free cells of several sums of costs, NaN elsewhere."""
    low, high = ends_of(np.concatenate([total.ravel() for total in totals]))
    label = "$H_\\mathrm{total}$, sum of the costs, each weighing 1\n(lower is better)"
    return Colours("gray", Normalize(low, max(high, low + 1e-6)), label)


def _names(planned_at: Mapping[float, Sequence[PlannedPath]], names: Sequence[str] | None) -> dict[int, str]:
    """Return what each path is called, by its `id`."""
    planned = [path for paths in planned_at.values() for path in paths]
    if names is None:
        return {id(path): path.search.planner for path in planned}
    if isinstance(names, str) or len(names) != len(planned):
        raise InputError(f"names must be a list of {len(planned)}, one for each path, got {names!r}")
    return {id(path): name for path, name in zip(planned, names, strict=True)}


def _panels_at(
    maps: MetricMaps,
    altitude_m: float,
    planned: Sequence[PlannedPath],
    time: str | None = None,
    time_of_day: str | None = None,
) -> list[tuple[float, str | None, str | None, list[PlannedPath]]]:
    """Return a panel (altitude, time, time of day, paths) for each map that paths were planned on, else for one map."""
    if not planned:
        return [(altitude_m, time or maps.default_time, time_of_day or next(iter(maps.times_of_day), None), [])]

    def planned_on(path: PlannedPath) -> tuple[str, str]:
        return path.settings["time"] or "", path.settings["time_of_day"] or ""

    groups = groupby(sorted(planned, key=planned_on), key=planned_on)
    return [(altitude_m, time or None, time_of_day or None, list(group)) for (time, time_of_day), group in groups]


def cost_layers(maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None) -> list[MapLayer]:
    """Return H_norm and obstacles as they are drawn."""
    norm = maps.normalised(altitude_m, time=time, time_of_day=time_of_day)
    return [MapLayer(norm, COST_COLOURS), obstacle_layer(maps, altitude_m, BLOCKED_COLOUR)]


def draw_paths(panel: Axes, paths: Sequence[PlannedPath], colours: Sequence[str]) -> None:
    """Draw the paths that were found, each in its colour, and start and goal of the first of them."""
    for rank, (path, colour) in enumerate(zip(paths, colours, strict=True)):
        if path.status.has_path:
            width = 1.6 + min(1.8, MOST_WIDER_PT / max(len(paths) - 1, 1)) * (len(paths) - 1 - rank)
            edge = [Stroke(linewidth=width + 2 * EDGE_PT, foreground="black"), Normal()]
            look: dict[str, Any] = {"linewidth": width, "solid_joinstyle": "round", "path_effects": edge}
            panel.plot(*path.xy_m.T, color=colour, zorder=3 + rank, **look)
    draw_ends(panel, paths)


def path_entries(colours: Mapping[str, str], paths: Sequence[PlannedPath]) -> list[Line2D]:
    """Return the legend's entries of the names that paths are drawn under, and of their ends where one was found."""
    lines = [Line2D([], [], color=colour, linewidth=2.5, label=shortened(name)) for name, colour in colours.items()]
    return [*lines, *(ENDS if any(path.status.has_path for path in paths) else ())]


def outcome_of(path: PlannedPath, name: str) -> str:
    """Return a path's cost and length, or its status."""
    if not path.status.has_path:
        return f"{shortened(name)}: {path.status.value}"
    cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
    return f"{shortened(name)}: {cost}, {path.length_m / 1000:.2f} km"


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found."""
    for path in [path for path in paths if path.status.has_path][:1]:
        mark_ends(panel, path.xy_m[0], path.xy_m[-1])


def shortened(name: str, most: int = MOST_LETTERS) -> str:
    """Return a name of at most so many letters, its end cut off where it is longer."""
    return name if len(name) <= most else f"{name[: most - 1]}…"


def plot_overview(maps: GivenMaps, paths: Paths, *, altitude_m: float | None = None) -> Figure:
    """Return one picture of a region: roof heights, GPS, lidar, clearance, population, and paths over H_norm.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      paths: one, several, a batch, or paths by altitude.
      altitude_m: one of the maps'; left out, the first that paths are given at, else the maps' first.

    Raises:
      InputError: an altitude that these maps do not hold.
    """
    maps, planned_at = as_maps(maps), by_altitude(paths)
    first_m = maps.altitudes_m[0] if isinstance(paths, Mapping) else next(iter(planned_at), maps.altitudes_m[0])
    z = first_m if altitude_m is None else altitude_m
    (_, time, time_of_day, planned), *_ = _panels_at(maps, z, planned_at.get(z, ()))
    shown = [("Roof height (m)", roof_layers(maps), "")]
    for name, metric in maps.metrics.items():
        if name == "population":
            layers = layers_above_zero(maps.m("density", time_of_day=time_of_day), metric_colours(maps, "density"))
            shown.append((f"People per km², {time_of_day}", layers, ""))
        else:
            layers = [obstacle_layer(maps, z), free_layer(maps, name, z, time=time)]
            shown.append((metric.label, layers, f"1: {meaning}" if (meaning := meaning_of(maps, name)) else ""))
    what, costs = " and paths" if planned else "", cost_layers(maps, z, time, time_of_day)[::-1]
    shown.append((", ".join(filter(None, (f"Cost{what}", time_of_day))), costs, COST_ENDS))
    panels = [
        MapPanel(title, [*layers[:-1], replace(layers[-1], colours=replace(layers[-1].colours, label=label))])
        for title, layers, label in shown
    ]
    line_colours = planner_colours(path.search.planner for path in planned)
    entries = path_entries(line_colours, planned)
    for path, line in zip(planned, entries, strict=False):
        if not path.status.has_path:
            line.set_label(f"{line.get_label()}\n({path.status.value})")
    legend: list[LegendEntry] = [*obstacle_patches(maps), ("obstacle (cost)", BLOCKED_COLOUR), *entries]
    heading = f"Metric maps{what}, {z:g} m above ground"
    note = "\n".join(filter(None, [frame_note(maps, time), rules_said(*(path.settings for path in planned))]))
    figure, axes = draw_maps(maps.grid, panels, heading, note, legend=legend, has_ticks=False)
    draw_paths(axes[-1], planned, [line_colours[path.search.planner] for path in planned])
    return figure
