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
from jaxurban.report.figures.frame import (
    SLOT_IN,
    Frame,
    MapLayer,
    add_bar_below,
    add_key,
    draw_layers,
    drop_in,
    make_frame,
    mark_ends,
    write_legend,
)
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
LINE_IN, LEGEND_LETTER_IN = 0.17, 0.06  # height of a legend line, width of a letter
HANDLE_LETTERS, KEY_LETTERS = 5, 17  # that a legend's line takes; of a name in the key column
FOOTER_IN = 0.62  # under a panel of the overview: a colour bar and two lines
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
    panels = [panel for z in shown for panel in _panels_at(maps, z, planned_at.get(z, ()), time, time_of_day)]
    colours = planner_colours(name_of[id(path)] for _, _, _, planned in panels for path in planned)
    times = list(dict.fromkeys(at for _, at, _, _ in panels))
    times_of_day = {day for _, _, day, _ in panels}
    titles = [
        " · ".join(filter(None, (f"{z:g} m", day, time_said(at) if at and len(times) > 1 else "")))
        for z, at, day, _ in panels
    ]
    most = max(len(planned) for _, _, _, planned in panels)
    totals = [
        np.where(maps.is_free(z, "centre"), maps.total(z, time=at, time_of_day=day), np.nan) for z, at, day, _ in panels
    ]
    not_same = "time of day: as the paths were planned for, not the same in all panels"
    note = joined(
        frame_note(maps, times[0] if len(times) == 1 else None),
        not_same if len(times_of_day) > 1 else "",
        "below: cost, length" if most else "",
    )
    note = "\n".join(filter(None, [note, rules_said(*(path.settings for *_, each in panels for path in each))]))
    what = "Cost and paths" if most else "Cost"
    frame = make_frame(
        maps.grid,
        titles,
        f"{what}, by altitude above ground",
        note,
        footer_in=most * LINE_IN + 0.1 * bool(most),
    )
    scale = _total_colours(totals)
    for panel, total, (z, _, _, planned) in zip(frame.axes, totals, panels, strict=True):
        draw_layers(panel, maps.grid, [MapLayer(total, scale), obstacle_layer(maps, z, BLOCKED_COLOUR)])
        handles = [
            draw_path(panel, path, colours, rank, len(planned), name_of[id(path)]) for rank, path in enumerate(planned)
        ]
        draw_ends(panel, planned)
        legend_below(panel, frame, handles)
    has_ends = any(path.status.has_path for _, _, _, planned in panels for path in planned)
    add_key(frame, obstacle_patches(maps, BLOCKED_COLOUR), scale, has_ends=has_ends)
    return frame.figure


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


def draw_path(
    panel: Axes, path: PlannedPath, colours: Mapping[str, str], rank: int, num: int, name: str | None = None
) -> Line2D:
    """Draw one of ``num`` paths, if there is one, under its planner's or another name, and return its legend handle."""
    name = name or path.search.planner
    label = f"{name}: {path.status.value}"
    if path.status.has_path:
        cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
        label = f"{name}: {cost}, {path.length_m / 1000:.2f} km"
        width = 1.6 + min(1.8, MOST_WIDER_PT / max(num - 1, 1)) * (num - 1 - rank)
        edge = [Stroke(linewidth=width + 2 * EDGE_PT, foreground="black"), Normal()]
        look: dict[str, Any] = {"linewidth": width, "solid_joinstyle": "round", "path_effects": edge}
        panel.plot(*path.xy_m.T, color=colours[name], zorder=3 + rank, **look)
    is_found = path.status.has_path
    return Line2D([], [], color=colours[name], linewidth=2.5, linestyle="-" if is_found else ":", label=label)


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found."""
    found = next((path for path in paths if path.status.has_path), None)
    if found is None:
        return
    mark_ends(panel, found.xy_m[0], found.xy_m[-1])


def shortened(name: str, most: int) -> str:
    """Return a name of at most so many letters, its end cut off where it is longer."""
    return name if len(name) <= most else f"{name[: max(most - 1, 1)]}…"


def legend_below(panel: Axes, frame: Frame, handles: Sequence[Line2D]) -> None:
    """Write a panel's legend, if it has one, in its footer."""
    most = int(max(frame.panel_in[0], SLOT_IN) / LEGEND_LETTER_IN) - HANDLE_LETTERS
    for handle in handles:
        name, _, told = str(handle.get_label()).rpartition(": ")
        handle.set_label(f"{shortened(name, most - len(told) - 2)}: {told}")
    if handles:
        write_legend(panel, handles, 0.0, drop_in(panel))


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
    what = " and paths" if planned else ""
    names = {"roof": "Roof height (m)"}
    for name, metric in maps.metrics.items():
        if name == "population":
            names["density"] = f"People per km², {time_of_day}"
        else:
            names[name] = metric.label
    names["cost"] = ", ".join(filter(None, (f"Cost{what}", time_of_day)))
    frame = make_frame(
        maps.grid,
        list(names.values()),
        f"Metric maps{what}, {z:g} m above ground",
        "\n".join(filter(None, [frame_note(maps, time), rules_said(*(path.settings for path in planned))])),
        footer_in=FOOTER_IN,
        with_ticks=False,
    )
    for panel, name in zip(frame.axes, names, strict=True):
        label = ""
        if name == "roof":
            layers = roof_layers(maps)
        elif name == "density":
            layers = layers_above_zero(maps.m(name, time_of_day=time_of_day), metric_colours(maps, name))
        elif name == "cost":
            layers, label = cost_layers(maps, z, time, time_of_day)[::-1], COST_ENDS
        else:
            layers = [obstacle_layer(maps, z), free_layer(maps, name, z, time=time)]
            label = f"1: {meaning}" if (meaning := meaning_of(maps, name)) else ""
        draw_layers(panel, maps.grid, layers)
        add_bar_below(frame, panel, replace(layers[-1].colours, label=label))
    colours = planner_colours(path.search.planner for path in planned)
    for rank, path in enumerate(planned):
        draw_path(frame.axes[-1], path, colours, rank, len(planned))
    draw_ends(frame.axes[-1], planned)
    lines = [
        (
            shortened(path.search.planner, KEY_LETTERS) + ("" if path.status.has_path else f"\n({path.status.value})"),
            colours[path.search.planner],
        )
        for path in planned
    ]
    has_ends = any(path.status.has_path for path in planned)
    add_key(frame, [*obstacle_patches(maps), ("obstacle (cost)", BLOCKED_COLOUR), *lines], has_ends=has_ends)
    return frame.figure
