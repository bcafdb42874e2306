"""Pictures of a Monte Carlo benchmark: success, cost, time, metrics, comparisons, and how GPS complements lidar."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import Metric
from jaxurban.metrics.registry import METRICS
from jaxurban.report.figures.notes import ground_said, joined, sky_said
from jaxurban.report.figures.paths import planner_colours
from jaxurban.report.figures.style import (
    FAINT_INK,
    INK,
    MARKERS,
    Colours,
    add_colour_bar,
    dots,
    legend_below,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.studies.montecarlo.analysis import each, facts_of, range_names, weighted_rows
from jaxurban.studies.montecarlo.trial import DISTANCE, WEIGHTED

PANEL_IN = 2.45
SHARES = Colours("Greys", LogNorm(1e-6, 0.3), "share of the free cells", extend="max")
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios


def _panels(
    num: int, heading: str, note: str, *, height_in: float = 2.38, shares_y: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a row of panels."""
    panel_in = PANEL_IN, height_in
    figure, axes = panels(num, heading, note, panel_in=panel_in, most_in_row=num, shares_y=shares_y)
    for panel in axes:
        panel.spines[["top", "right"]].set_visible(False)
    return figure, axes


class Series(NamedTuple):
    """What one planner shows in one panel: its rank among the planners, its colour, and its rows."""

    panel: Axes
    rank: int
    planner: str
    colour: str
    rows: pd.DataFrame


def _by_altitude(rows: pd.DataFrame, heading: str, note: str) -> tuple[Figure, list[Axes], list[Series], int]:
    """Return a figure with a panel for each altitude, the panels, each planner's series in them, and its planners."""
    altitudes, colours = sorted(rows.altitude_m.unique()), planner_colours(sorted(rows.planner.unique()))
    figure, axes = _panels(len(altitudes), heading, note)
    series = []
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        panel.set_title(f"{altitude_m:g} m")
        for rank, (planner, colour) in enumerate(colours.items()):
            its_own = rows[(rows.altitude_m == altitude_m) & (rows.planner == planner)]
            series.append(Series(panel, rank, planner, colour, its_own))
    return figure, axes, series, len(colours)


def _lines(note: str, where: str) -> str:
    """Return the lines below a heading: what a figure tells and, where it is known, which maps it is of."""
    return "\n".join(filter(None, (note, where)))


def _beside(num: int, rank: int, of: int, step: float) -> np.ndarray:
    """Return the places of one of several series at ``num`` ticks, side by side."""
    return np.arange(num) + (rank - (of - 1) / 2) * step


@styled
def plot_success(success: pd.DataFrame, where: str = "") -> Figure:
    """Return the share of joined pairs that each planner solved, by altitude and range (`analysis.success`).

    ``where``, here and below: a line of the figure that says which maps it is of.
    """
    note = "share of the pairs that some path joins, by range and altitude"
    figure, axes, series, num = _by_altitude(success, "How often a path was found", _lines(note, where))
    ranges, width = range_names(success), 0.8 / num
    for panel, rank, planner, colour, rows in series:
        share = rows.set_index("range").share_joined
        x = _beside(len(ranges), rank, num, width)
        panel.bar(x, [share.get(name, np.nan) for name in ranges], width, color=colour, label=planner)
        panel.set_xticks(range(len(ranges)), ranges)
    _show_shares(axes)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_costs(table: pd.DataFrame, where: str = "") -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path (`joined`)."""
    table = weighted_rows(table)
    table = table[table.is_joined]
    note = "share of the joined pairs solved at up to so many times the cost of the cheapest path of any planner"
    figure, axes, series, num = _by_altitude(table, "How near to the cheapest path known", _lines(note, where))
    end = float(np.clip(table.ratio.quantile(0.98), *RATIO_AXIS))
    for panel, rank, planner, colour, rows in series:
        ratio = np.sort(rows.ratio[np.isfinite(rows.ratio)])
        share = np.arange(1, len(ratio) + 1) / max(1, len(rows))
        x, y = np.append(ratio, max(end, ratio.max(initial=1.0))), np.append(share, share[-1:] if len(share) else 0.0)
        width = 1.4 + min(0.9, 5.4 / max(num - 1, 1)) * (num - 1 - rank)  # where curves coincide all are seen
        panel.step(x, y, where="post", color=colour, label=planner, linewidth=width)
        panel.set(xlim=(1 - 0.01 * (end - 1), end), xlabel="cost / cheapest known")
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    _show_shares(axes)
    legend_below(figure, axes[0])
    return figure


def _show_shares(axes: Sequence[Axes]) -> None:
    for panel in axes:
        panel.set_ylim(0, 1.02)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))


@styled
def plot_times(table: pd.DataFrame, where: str = "") -> Figure:
    """Return the seconds that each planner searched, by altitude: median, middle half and range of 5 to 95 %."""
    table = weighted_rows(table)
    note = "box: middle half; line: median; whiskers: 5 to 95 %"
    figure, axes, series, _ = _by_altitude(table[table.elapsed_s > 0], "Time of a search", _lines(note, where))
    for panel, rank, planner, colour, rows in series:
        if len(rows):
            panel.boxplot(
                rows.elapsed_s,
                positions=[rank],
                widths=0.6,
                whis=(5, 95),
                showfliers=False,
                patch_artist=True,
                boxprops={"facecolor": colour, "alpha": 0.75, "linewidth": 0.6},
                medianprops={"color": INK},
            )
        panel.plot([], [], "s", color=colour, label=planner)
        panel.set_yscale("log")
        panel.set_xticks([])
    axes[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} s"))
    legend_below(figure, axes[0])
    return figure


@styled
def plot_usage(usage: pd.DataFrame, metrics: Mapping[str, Metric] = METRICS, where: str = "") -> Figure:
    """Return the mean of each metric along the paths, by altitude, planner and objective (`analysis.usage`).

    ``metrics`` are those of the maps.
    """
    names = [name.removeprefix("m_") for name in facts_of(usage)[1:] if usage[name].notna().any()]
    altitudes = sorted(usage.altitude_m.unique())
    runs = list(usage[["planner", "objective"]].drop_duplicates().itertuples(index=False, name=None))
    colours = planner_colours(sorted(usage.planner.unique()))
    note = "mean m over the instances that all of these solved, by altitude"
    figure, axes = _panels(len(names), "Metrics along the paths", _lines(note, where))
    for panel, metric in zip(axes, names, strict=True):
        for rank, (planner, objective) in enumerate(runs):
            at = usage[(usage.planner == planner) & (usage.objective == objective)].set_index("altitude_m")
            is_weighted = objective == WEIGHTED
            panel.plot(
                _beside(len(altitudes), rank, len(runs), 0.1),
                [at[f"m_{metric}"].get(z, np.nan) for z in altitudes],
                MARKERS[rank % len(MARKERS)],
                color=colours[planner],
                markerfacecolor=colours[planner] if is_weighted else "white",
                label=planner if is_weighted else f"{planner}, distance only",
                markersize=5,
                linestyle="none",
            )
        panel.set_xticks(range(len(altitudes)), [f"{z:g} m" for z in altitudes])
        panel.set_title(f"m_{metric} (1: {metrics[metric].one_is})")
        panel.margins(y=0.12)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_paired(paired: pd.DataFrame, where: str = "") -> Figure:
    """Return cost ratios of planners two by two with their intervals (`analysis.paired`)."""
    shown = paired[np.isfinite(paired.cost_ratio)].iloc[::-1]
    shown = shown.rename(columns={"low": "cost_ratio_low", "high": "cost_ratio_high"})
    note = "geometric mean of cost ratios where both found a path, 95 % bootstrap interval"
    figure, (panel,) = _panels(1, "Planners two by two", _lines(note, where), height_in=0.28 + 0.28 * len(shown))
    y = np.arange(len(shown), dtype=float)
    panel.axvline(1.0, color=FAINT_INK, linewidth=0.8)
    dots(panel, y, shown, "cost_ratio", {"color": INK, "marker": "o"}, is_across=True)
    panel.set_yticks(y, [f"{r.first} / {r.second}: {r.cost_ratio:.3f} ({r.both} pairs)" for r in each(shown)])
    panel.set(xscale="log", ylim=(-0.7, len(shown) - 0.3))
    panel.set_xlabel("cost of the first over cost of the second (below 1: the first is cheaper)")
    show_plain_log(panel.xaxis)
    return figure


@styled
def plot_objectives(objectives: pd.DataFrame, where: str = "") -> Figure:
    """Return what the shortest path costs and saves against the cheapest, by altitude (`analysis.objectives`)."""
    note = "distance-only over weighted runs of the same planner, 95 % interval"
    colours = planner_colours(sorted(objectives.planner.unique()))
    heading, note = "Shortest path against cheapest path", _lines(note, where)
    figure, axes = _panels(2, heading, note)
    titles = ("weighted cost, ratio", "length, ratio")
    for panel, name, title in zip(axes, ("cost_ratio", "length_ratio"), titles, strict=True):
        for rank, (planner, colour) in enumerate(colours.items()):
            rows = objectives[objectives.planner == planner].sort_values("altitude_m")
            x = _beside(len(rows), rank, len(colours), 0.12)
            dots(panel, x, rows, name, {"color": colour, "marker": "o", "label": planner})
            panel.set_xticks(range(len(rows)), [f"{z:g} m" for z in rows.altitude_m])
        panel.axhline(1.0, color=FAINT_INK, linewidth=0.8)
        panel.set_title(title)
        panel.margins(x=0.15)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_complementarity(maps: MetricMaps, table: pd.DataFrame, *, time: str | None = None) -> Figure:
    """Return how m_gps and m_lidar share the free cells, by altitude, over their means (`complementarity`).

    The squares of a panel are shaded by the share of free cells, on one logarithmic scale; the dashed line parts cells
    where GPS is the better one (below) from those where lidar is; the first panel shows means and what either covers.
    """
    altitudes = table.altitude_m.tolist()
    note = "left: mean m, and share of cells where a sensor serves (m >= 0.5); then cells by m"
    note = _lines(note, joined(sky_said(maps, time or maps.default_time), *ground_said(maps)))
    heading = "GPS and lidar over the free cells"
    figure, (first, *others) = _panels(len(altitudes) + 1, heading, note, shares_y=False, height_in=2.18)
    x = np.arange(len(altitudes))
    for name in ("gps", "lidar"):
        colour = METRICS[name].colour
        first.plot(x, table[name], "o-", color=colour, label=f"mean m_{name}", markersize=4)
        first.plot(x, table[f"{name}_serves"], "s:", color=colour, label=f"{name} serves", markersize=3.5)
    first.plot(x, table.either_serves, "^--", color=INK, label="one or the other serves", markersize=3.5)
    first.set_xticks(x, [f"{z:g} m" for z in altitudes])
    first.set_ylim(-0.03, 1.05)
    bins = np.linspace(0, 1, 41)
    for panel, row in zip(others, each(table), strict=True):
        is_free = maps.is_free(row.altitude_m, "centre")
        gps, lidar = maps.m("gps", row.altitude_m, time=time)[is_free], maps.m("lidar", row.altitude_m)[is_free]
        share = np.histogram2d(gps, lidar, [bins, bins])[0].T / len(gps)
        panel.pcolormesh(bins, bins, np.where(share > 0, share, np.nan), cmap=SHARES.cmap, norm=SHARES.norm)
        panel.plot([0, 1], [0, 1], "--", color=FAINT_INK, linewidth=0.8)
        panel.grid(visible=False)
        correlation = f", r = {row.correlation:+.2f}" if np.isfinite(row.correlation) else ""
        panel.set(xlim=(0, 1), ylim=(0, 1), xlabel="m_gps", title=f"{row.altitude_m:g} m{correlation}")
    others[0].set_ylabel("m_lidar", labelpad=1)
    add_colour_bar(figure, others, SHARES)
    legend_below(figure, first, columns=5)
    return figure


def study_figures(
    maps: MetricMaps, table: pd.DataFrame, tables: dict[str, pd.DataFrame]
) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture that a study's tables allow, by name."""
    paired, where = tables["paired"], joined(*ground_said(maps))
    weighted = weighted_rows(table)
    figures: dict[str, Callable[[], Figure]] = {"success": lambda: plot_success(tables["success"], where)}
    if weighted.is_joined.any():
        figures["costs"] = lambda: plot_costs(table, where)
    if (weighted.elapsed_s > 0).any():
        figures["times"] = lambda: plot_times(table, where)
    if len(tables["usage"]):
        figures["usage"] = lambda: plot_usage(tables["usage"], maps.metrics, where)
    if len(paired) and np.isfinite(paired.cost_ratio).any():
        figures["paired"] = lambda: plot_paired(paired, where)
    if (table.objective == DISTANCE).any() and len(tables["objectives"]):
        figures["objectives"] = lambda: plot_objectives(tables["objectives"], where)
    if "complementarity" in tables:
        figures["complementarity"] = lambda: plot_complementarity(maps, tables["complementarity"])
    return figures
