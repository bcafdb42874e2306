"""Pictures of paths over the normalised cost, and the overview of one region."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.plotting.frame import (
    SMALL_PT,
    Frame,
    Layer,
    add_bar_below,
    add_key,
    draw_layers,
    drop_in,
    make_frame,
)
from jaxurban.plotting.metrics import (
    colour_map,
    density_layers,
    density_style,
    frame_note,
    free_layer,
    obstacle_layer,
    obstacle_patches,
    roof_layers,
    roof_ticks,
)

# The paper's colours (tab10), then the rest of tab10 for planners that it does not have.
PLANNER_COLOURS = {
    "astar-dist": "#1f77b4",
    "astar-plus": "#ff7f0e",
    "bitstar-dist": "#2ca02c",
    "bitstar-plus": "#d62728",
    "ptp": "#9467bd",
}
OTHER_COLOURS = ("#e377c2", "#17becf", "#bcbd22", "#8c564b")
BLOCKED_COLOUR = "#d9c08c"  # obstacles over the grey cost map
DAY_UP_TO_M = 60.0  # the paper draws day at 20 and 60 m, night above
LINE_IN = 0.17  # height of a legend line

Paths = Mapping[float, Sequence[PlannedPath]]


def planner_colours(paths: Sequence[PlannedPath]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    names = list(dict.fromkeys(path.search.planner for path in paths))
    others = [name for name in names if name not in PLANNER_COLOURS]
    spare = {name: OTHER_COLOURS[i % len(OTHER_COLOURS)] for i, name in enumerate(others)}
    return {name: PLANNER_COLOURS.get(name) or spare[name] for name in names}


def paper_time_of_day(maps: MetricMaps, altitude_m: float) -> str | None:
    """Return the time of day of the paper's figures at an altitude, if the maps have it, else their first."""
    wanted = "day" if altitude_m <= DAY_UP_TO_M else "night"
    return wanted if wanted in maps.times_of_day else next(iter(maps.times_of_day), None)


def plot_paths(maps: MetricMaps, paths: Paths, *, altitudes_m: Sequence[float] | None = None) -> Figure:
    """Return H_norm (black 0, white 1) by altitude with the paths of all planners over it.

    A panel shows the epoch and the time of day that its paths were planned for; without paths, the first
    epoch and the paper's time of day. Under it stands each planner's cost and length, or its status.
    Where paths coincide, the later one is drawn narrower, so that both are seen.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude.
      altitudes_m: which altitudes; all of the maps' if left out.

    Raises:
      InputError: an altitude, time or time of day that these maps do not hold.
    """
    shown = maps.altitudes_m if altitudes_m is None else tuple(altitudes_m)
    panels = [panel for z in shown for panel in _panels_at(maps, z, paths.get(z, ()))]
    colours = planner_colours([path for _, _, _, planned in panels for path in planned])
    titles = [" · ".join(filter(None, (f"{z:g} m", time_of_day))) for z, _, time_of_day, _ in panels]
    times = list(dict.fromkeys(time for _, time, _, _ in panels))
    most = max(len(planned) for _, _, _, planned in panels)
    note = frame_note(maps, times[0] if len(times) == 1 else None) + ("  ·  below: cost, length" if most else "")
    frame = make_frame(
        maps.grid,
        titles,
        "Normalised cost and paths, by altitude above ground",
        note,
        footer_in=most * LINE_IN + 0.1,
    )
    for panel, (z, time, time_of_day, planned) in zip(frame.axes, panels, strict=True):
        draw_layers(panel, maps.grid, cost_layers(maps, z, time, time_of_day))
        handles = [draw_path(panel, path, colours, rank, len(planned)) for rank, path in enumerate(planned)]
        draw_ends(panel, planned)
        legend_below(panel, frame, handles)
    norm = (colour_map("gray"), Normalize(0, 1))
    add_key(frame, obstacle_patches(maps, BLOCKED_COLOUR), norm, "$H_\\mathrm{norm}$\n(0: best free cell, 1: worst)")
    return frame.figure


def _panels_at(
    maps: MetricMaps, altitude_m: float, planned: Sequence[PlannedPath]
) -> list[tuple[float, str | None, str | None, list[PlannedPath]]]:
    """Return a panel (altitude, time, time of day, paths) for each map that paths were planned on."""
    if not planned:
        return [(altitude_m, maps.default_time, paper_time_of_day(maps, altitude_m), [])]

    def planned_on(path: PlannedPath) -> tuple[str, str]:
        return path.settings["time"] or "", path.settings["time_of_day"] or ""

    groups = groupby(sorted(planned, key=planned_on), key=planned_on)
    return [(altitude_m, time or None, time_of_day or None, list(group)) for (time, time_of_day), group in groups]


def cost_layers(maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None) -> list[Layer]:
    """Return H_norm and obstacles as they are drawn."""
    norm = maps.normalised(altitude_m, time=time, time_of_day=time_of_day)
    return [Layer(norm, colour_map("gray"), Normalize(0, 1)), obstacle_layer(maps, altitude_m, BLOCKED_COLOUR)]


def draw_path(panel: Axes, path: PlannedPath, colours: Mapping[str, str], rank: int, num: int) -> Line2D:
    """Draw one of ``num`` paths, if there is one, and return its legend handle."""
    planner = path.search.planner
    label = f"{planner}: {path.status.value}"
    if path.status.has_path:
        cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
        label = f"{planner}: {cost}, {path.length_m / 1000:.2f} km"
        width = 1.6 + 1.5 * (num - 1 - rank)
        panel.plot(*path.xy_m.T, color=colours[planner], linewidth=width, solid_joinstyle="round", zorder=3 + rank)
    is_found = path.status.has_path
    return Line2D([], [], color=colours[planner], linewidth=2.5, linestyle="-" if is_found else ":", label=label)


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found."""
    found = next((path for path in paths if path.status.has_path), None)
    if found is None:
        return
    look: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black", "markerfacecolor": "white", "zorder": 20}
    panel.plot(*found.xy_m[0], marker="o", markersize=6.5, **look)
    panel.plot(*found.xy_m[-1], marker="*", markersize=12, **look)


def legend_below(panel: Axes, frame: Frame, handles: Sequence[Line2D]) -> None:
    """Write a panel's legend, if it has one, in its footer."""
    if handles:
        panel.legend(
            handles=list(handles),
            loc="upper left",
            bbox_to_anchor=(-0.01, -drop_in(panel) / frame.panel_in[1]),
            fontsize=SMALL_PT - 0.5,
            frameon=False,
            borderpad=0.1,
            borderaxespad=0.1,
            labelspacing=0.25,
            handlelength=1.6,
        )


def plot_overview(maps: MetricMaps, paths: Paths, *, altitude_m: float | None = None) -> Figure:
    """Return one picture of a region: roof heights, GPS, lidar, clearance, population, and paths over H_norm.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude.
      altitude_m: one of the maps'; the first if left out.

    Raises:
      InputError: an altitude that these maps do not hold.
    """
    z = maps.altitudes_m[0] if altitude_m is None else altitude_m
    (_, time, time_of_day, planned), *_ = _panels_at(maps, z, paths.get(z, ()))
    names = {"roof": "Roof height (m)", "gps": f"GPS quality, {z:g} m", "lidar": f"Lidar quality, {z:g} m"}
    if "density" in maps.ds:
        names["density"] = f"People per km², {time_of_day}"
    names |= {"risk": f"Risk (clearance), {z:g} m", "cost": f"Cost and paths, {z:g} m"}
    frame = make_frame(
        maps.grid,
        list(names.values()),
        "Metric maps and paths",
        frame_note(maps, time),
        footer_in=0.4,
        with_ticks=False,
    )
    for panel, name in zip(frame.axes, names, strict=True):
        ticks: Sequence[float] | None = (0, 0.5, 1)
        extend = "neither"
        if name == "roof":
            layers = roof_layers(maps)
            ticks = roof_ticks(maps)[::2]
        elif name == "density":
            layers = density_layers(maps.m(name, time_of_day=time_of_day), *density_style(maps))
            ticks, extend = None, "min"
        elif name == "cost":
            layers = cost_layers(maps, z, time, time_of_day)[::-1]
        else:
            layers = [obstacle_layer(maps, z), free_layer(maps, name, z, time=time)]
        draw_layers(panel, maps.grid, layers)
        add_bar_below(frame, panel, (layers[-1].cmap, layers[-1].norm), extend, ticks)
    colours = planner_colours(planned)
    for rank, path in enumerate(planned):
        draw_path(frame.axes[-1], path, colours, rank, len(planned))
    draw_ends(frame.axes[-1], planned)
    lines = [
        (
            path.search.planner + ("" if path.status.has_path else f"\n({path.status.value})"),
            colours[path.search.planner],
        )
        for path in planned
    ]
    add_key(frame, [*obstacle_patches(maps), ("obstacle (cost)", BLOCKED_COLOUR), *lines])
    return frame.figure
