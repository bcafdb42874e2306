"""Pictures of a Monte Carlo benchmark: success, cost, time, metrics, comparisons, and how GPS complements lidar."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import Metric
from jaxurban.metrics.registry import METRICS
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
from jaxurban.studies.montecarlo.trial import WEIGHTED

SHARES = Colours("Greys", LogNorm(1e-6, 0.3), "share of the free cells", extend="max")
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios


def _panels(num: int, heading: str, height_in: float = 2.38) -> tuple[Figure, list[Axes]]:
    """Return a figure with a row of panels."""
    return panels(num, heading, panel_in=(2.45, height_in), most_in_row=num, shares_y=True)


def _by_altitude(
    rows: pd.DataFrame, axes: Sequence[Axes], colours: Mapping[str, str]
) -> Iterator[tuple[Axes, int, str, pd.DataFrame]]:
    """Yield the rows of each planner at each altitude, with the panel of the altitude, titled, and the rank."""
    for panel, (altitude_m, there) in zip(axes, rows.groupby("altitude_m"), strict=True):
        panel.set_title(f"{altitude_m:g} m")
        for rank, planner in enumerate(colours):
            yield panel, rank, planner, there[there.planner == planner]


def _beside(num: int, rank: int, of: int, step: float) -> np.ndarray:
    """Return the places of one of several series at ``num`` ticks, side by side."""
    return np.arange(num) + (rank - (of - 1) / 2) * step


@styled
def plot_success(success: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved, by altitude and range (`analysis.success`)."""
    colours, ranges = planner_colours(sorted(success.planner.unique())), range_names(success)
    figure, axes = _panels(success.altitude_m.nunique(), "Share of pairs that some path joins, for which one was found")
    for panel, rank, planner, rows in _by_altitude(success, axes, colours):
        share, width = rows.set_index("range").share_joined.reindex(ranges), 0.8 / len(colours)
        x = _beside(len(ranges), rank, len(colours), width)
        panel.bar(x, share, width, color=colours[planner], label=planner)
        panel.set_xticks(range(len(ranges)), ranges)
    _show_shares(axes)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_costs(table: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path."""
    colours = planner_colours(sorted(table.planner.unique()))
    figure, axes = _panels(table.altitude_m.nunique(), "Share of pairs solved at so many times the cheapest cost known")
    end = float(np.clip(table.ratio.quantile(0.98), *RATIO_AXIS))
    for panel, rank, planner, rows in _by_altitude(table, axes, colours):
        ratio = np.sort(rows.ratio[np.isfinite(rows.ratio)])
        share = np.arange(1, len(ratio) + 1) / max(1, len(rows))
        x, y = np.append(ratio, max(end, ratio.max(initial=1.0))), np.append(share, share[-1:] if len(share) else 0.0)
        others = len(colours) - 1
        width = 1.4 + min(0.9, 5.4 / max(others, 1)) * (others - rank)  # where curves coincide all are seen
        panel.step(x, y, where="post", color=colours[planner], label=planner, linewidth=width)
        panel.set(xlim=(1 - 0.01 * (end - 1), end), xlabel="cost / cheapest known")
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    _show_shares(axes)
    legend_below(figure, axes[0])
    return figure


def _show_shares(axes: Sequence[Axes]) -> None:
    axes[0].set_ylim(0, 1.02)
    for panel in axes:
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))


@styled
def plot_times(table: pd.DataFrame) -> Figure:
    """Return the seconds that each planner searched, by altitude: median, middle half and range of 5 to 95 %."""
    colours = planner_colours(sorted(table.planner.unique()))
    figure, axes = _panels(table.altitude_m.nunique(), "Time of a search: median, middle half, 5 to 95 %")
    boxes: dict[str, Any] = {
        "widths": 0.6,
        "whis": (5, 95),
        "showfliers": False,
        "patch_artist": True,
        "medianprops": {"color": INK},
    }
    for panel, rank, planner, rows in _by_altitude(table, axes, colours):
        if len(rows):
            look = {"facecolor": colours[planner], "alpha": 0.75, "linewidth": 0.6}
            panel.boxplot(rows.elapsed_s, positions=[rank], boxprops=look, **boxes)
        panel.plot([], [], "s", color=colours[planner], label=planner)
        panel.set(yscale="log", xticks=[])
    axes[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} s"))
    legend_below(figure, axes[0])
    return figure


@styled
def plot_usage(usage: pd.DataFrame, metrics: Mapping[str, Metric] = METRICS) -> Figure:
    """Return the mean of each metric along the paths, by altitude, planner and objective (`analysis.usage`).

    ``metrics`` are those of the maps.
    """
    names = [name.removeprefix("m_") for name in facts_of(usage)[1:] if usage[name].notna().any()]
    altitudes, runs = sorted(usage.altitude_m.unique()), list(usage.groupby(["planner", "objective"], sort=False))
    colours = planner_colours(sorted(usage.planner.unique()))
    figure, axes = _panels(len(names), "Mean m along the paths, by altitude")
    for panel, metric in zip(axes, names, strict=True):
        for rank, ((planner, objective), rows) in enumerate(runs):
            colour, is_weighted = colours[str(planner)], objective == WEIGHTED
            panel.plot(
                _beside(len(altitudes), rank, len(runs), 0.1),
                rows.set_index("altitude_m")[f"m_{metric}"].reindex(altitudes),
                MARKERS[rank % len(MARKERS)],
                color=colour,
                markerfacecolor=colour if is_weighted else "white",
                label=planner if is_weighted else f"{planner}, distance only",
                markersize=5,
            )
        panel.set_xticks(range(len(altitudes)), [f"{z:g} m" for z in altitudes])
        panel.set_title(f"m_{metric} (1: {metrics[metric].one_is})")
        panel.margins(y=0.12)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_paired(paired: pd.DataFrame) -> Figure:
    """Return cost ratios of planners two by two with their 95 % intervals (`analysis.paired`)."""
    shown = paired.iloc[::-1].rename(columns={"low": "cost_ratio_low", "high": "cost_ratio_high"})
    figure, (panel,) = _panels(1, "Cost of the first over cost of the second", 0.28 + 0.28 * len(shown))
    y = np.arange(len(shown), dtype=float)
    panel.axvline(1.0, color=FAINT_INK, linewidth=0.8)
    dots(panel, y, shown, "cost_ratio", {"color": INK, "marker": "o"}, is_across=True)
    panel.set_yticks(y, [f"{r.first} / {r.second}: {r.cost_ratio:.3f} ({r.both} pairs)" for r in each(shown)])
    panel.set(xscale="log", ylim=(-0.7, len(shown) - 0.3), xlabel="ratio (below 1: the first is cheaper)")
    show_plain_log(panel.xaxis)
    return figure


@styled
def plot_objectives(objectives: pd.DataFrame) -> Figure:
    """Return what the shortest path costs and saves against the cheapest, by altitude (`analysis.objectives`)."""
    colours = planner_colours(sorted(objectives.planner.unique()))
    figure, axes = _panels(2, "Shortest path over cheapest path of the same planner")
    for panel, name, title in zip(axes, ("cost_ratio", "length_ratio"), ("weighted cost", "length"), strict=True):
        for rank, (planner, colour) in enumerate(colours.items()):
            rows = objectives[objectives.planner == planner].sort_values("altitude_m")
            x = _beside(len(rows), rank, len(colours), 0.12)
            dots(panel, x, rows, name, {"color": colour, "marker": "o", "label": planner})
            panel.set_xticks(range(len(rows)), [f"{z:g} m" for z in rows.altitude_m])
        panel.axhline(1.0, color=FAINT_INK, linewidth=0.8)
        panel.set_title(f"{title}, ratio")
        panel.margins(x=0.15)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_complementarity(maps: MetricMaps, table: pd.DataFrame, *, time: str | None = None) -> Figure:
    """Return how m_gps and m_lidar share the free cells, by altitude, over their means (`complementarity`).

    The squares of a panel are shaded by the share of free cells, on one logarithmic scale; the dashed line parts cells
    where GPS is the better one (below) from those where lidar is; the first panel shows means, and the share of cells
    that each serves (m >= 0.5).
    """
    altitudes = table.altitude_m.tolist()
    figure, (first, *others) = _panels(len(altitudes) + 1, "GPS and lidar over the free cells", 2.18)
    x = np.arange(len(altitudes))
    for name in ("gps", "lidar"):
        colour = METRICS[name].colour
        first.plot(x, table[name], "o-", color=colour, label=f"mean m_{name}", markersize=4)
        first.plot(x, table[f"{name}_serves"], "s:", color=colour, label=f"{name} serves", markersize=3.5)
    first.plot(x, table.either_serves, "^--", color=INK, label="one or the other serves", markersize=3.5)
    first.set_xticks(x, [f"{z:g} m" for z in altitudes])
    first.set(ylim=(-0.03, 1.05), ylabel="mean m, share; right: m_lidar")
    bins = np.linspace(0, 1, 41)
    for panel, row in zip(others, each(table), strict=True):
        is_free = maps.is_free(row.altitude_m, "centre")
        gps, lidar = maps.m("gps", row.altitude_m, time=time)[is_free], maps.m("lidar", row.altitude_m)[is_free]
        share = np.histogram2d(gps, lidar, [bins, bins])[0].T / len(gps)
        panel.pcolormesh(bins, bins, np.where(share > 0, share, np.nan), cmap=SHARES.cmap, norm=SHARES.norm)
        panel.plot([0, 1], [0, 1], "--", color=FAINT_INK, linewidth=0.8)
        panel.grid(visible=False)
        correlation = f", r = {row.correlation:+.2f}" if np.isfinite(row.correlation) else ""
        panel.set(xlim=(0, 1), xlabel="m_gps", title=f"{row.altitude_m:g} m{correlation}")
    add_colour_bar(figure, others, SHARES, 2.2)
    legend_below(figure, first, columns=5)
    return figure


def study_figures(
    maps: MetricMaps, table: pd.DataFrame, tables: dict[str, pd.DataFrame]
) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture that a study's tables allow, by name."""
    weighted, paired = weighted_rows(table), tables["paired"]
    drawn: dict[str, tuple[Callable[..., Figure], pd.DataFrame]] = {
        "success": (plot_success, tables["success"]),
        "costs": (plot_costs, weighted[weighted.is_joined]),
        "times": (plot_times, weighted[weighted.elapsed_s > 0]),
        "usage": (partial(plot_usage, metrics=maps.metrics), tables["usage"]),
        "paired": (plot_paired, paired[np.isfinite(paired.cost_ratio)] if len(paired) else paired),
        "objectives": (plot_objectives, tables["objectives"]),
        "complementarity": (partial(plot_complementarity, maps), tables.get("complementarity", pd.DataFrame())),
    }
    return {name: partial(draw, rows) for name, (draw, rows) in drawn.items() if len(rows)}
