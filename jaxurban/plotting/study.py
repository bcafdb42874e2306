"""Pictures of a study: success, cost, time, metrics, comparisons, and how GPS and lidar complement each other."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter, PercentFormatter

from jaxurban.cost import METRICS
from jaxurban.maps import MetricMaps
from jaxurban.plotting.frame import FAINT_INK, INK, SMALL_PT, TEXT_PT
from jaxurban.plotting.paths import OTHER_COLOURS, PLANNER_COLOURS
from jaxurban.studies.analysis import each, range_names, weighted_rows
from jaxurban.studies.trial import DISTANCE, WEIGHTED

PANEL_IN = 2.45
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios
METRIC_COLOURS = {"gps": "#1f77b4", "lidar": "#d95f02", "population": "#7b4fa3", "risk": "#2a9d5c"}
MARKERS = "osD^vP*X"


def colours_of(planners: Sequence[str]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    others = iter(OTHER_COLOURS * len(planners))
    return {name: PLANNER_COLOURS.get(name) or next(others) for name in planners}


def _panels(
    num: int, heading: str, note: str, height_in: float = 2.6, shares_y: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a row of panels and room for a legend at its foot."""
    width_in = max(6.4, 0.9 + PANEL_IN * num)
    total_in = height_in + 1.45
    figure = Figure(figsize=(width_in, total_in), facecolor="white")
    figure.text(0.1 / width_in, 1 - 0.08 / total_in, heading, va="top", size=12, weight="bold", color=INK)
    figure.text(0.1 / width_in, 1 - 0.33 / total_in, note, va="top", size=SMALL_PT, color=FAINT_INK)
    grid = figure.add_gridspec(
        1,
        num,
        left=0.72 / width_in,
        right=1 - 0.15 / width_in,
        bottom=0.82 / total_in,
        top=1 - 0.85 / total_in,
        wspace=0.12 if shares_y else 0.34,
    )
    axes: list[Axes] = []
    for number in range(num):
        axes.append(figure.add_subplot(grid[number], sharey=axes[0] if axes and shares_y else None))
        axes[-1].tick_params(labelsize=SMALL_PT, length=3, labelleft=not shares_y or number == 0)
        axes[-1].spines[["top", "right"]].set_visible(False)
        axes[-1].grid(axis="y", color="#e6e6e6", linewidth=0.6)
        axes[-1].set_axisbelow(True)
    return figure, axes


def _legend(figure: Figure, axes: Sequence[Axes], columns: int = 6) -> None:
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncols=min(columns, len(names)), fontsize=SMALL_PT, frameon=False)


def plot_success(success: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner answered, by altitude and range (`analysis.success`)."""
    altitudes, ranges = sorted(success.altitude_m.unique()), range_names(success)
    planners = sorted(success.planner.unique())
    colours = colours_of(planners)
    figure, axes = _panels(
        len(altitudes), "How often a path was found", "share of the pairs that some path joins, by range and altitude"
    )
    width = 0.8 / len(planners)
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        at = success[success.altitude_m == altitude_m].set_index(["planner", "range"]).share_joined
        for rank, planner in enumerate(planners):
            values = [at.get((planner, name), np.nan) for name in ranges]
            x = np.arange(len(ranges)) + (rank - (len(planners) - 1) / 2) * width
            panel.bar(x, values, width, color=colours[planner], label=planner)
        panel.set_xticks(range(len(ranges)), ranges)
        panel.set_title(f"{altitude_m:g} m", size=TEXT_PT, loc="left")
        panel.set_ylim(0, 1.02)
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    _legend(figure, axes)
    return figure


def plot_costs(table: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path (`joined`)."""
    rows = weighted_rows(table)
    rows = rows[rows.is_joined]
    altitudes, planners = sorted(rows.altitude_m.unique()), sorted(rows.planner.unique())
    colours = colours_of(planners)
    figure, axes = _panels(
        len(altitudes),
        "How near to the cheapest path known",
        "share of the joined pairs answered at up to so many times the cost of the cheapest path found by any planner",
    )
    end = float(np.clip(rows.ratio.quantile(0.98), *RATIO_AXIS))
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        for rank, planner in enumerate(planners):
            asked = rows[(rows.planner == planner) & (rows.altitude_m == altitude_m)].ratio.to_numpy()
            ratio = np.sort(asked[np.isfinite(asked)])
            share = np.arange(1, len(ratio) + 1) / max(1, len(asked))
            ends = (
                np.append(ratio, max(end, ratio.max(initial=1.0))),
                np.append(share, share[-1] if len(share) else 0.0),
            )
            width = 1.4 + 0.9 * (len(planners) - 1 - rank)  # where curves coincide all are seen
            panel.step(*ends, where="post", color=colours[planner], label=planner, linewidth=width)
        panel.set(xlim=(1 - 0.01 * (end - 1), end), ylim=(0, 1.02))
        panel.set_xlabel("cost / cheapest known", size=SMALL_PT)
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
        panel.set_title(f"{altitude_m:g} m", size=TEXT_PT, loc="left")
        panel.yaxis.set_major_formatter(PercentFormatter(1.0))
    _legend(figure, axes)
    return figure


def plot_times(table: pd.DataFrame) -> Figure:
    """Return the seconds that each planner searched, by altitude: median, middle half and range of 5 to 95 %."""
    rows = weighted_rows(table)
    rows = rows[rows.elapsed_s > 0]
    altitudes, planners = sorted(rows.altitude_m.unique()), sorted(rows.planner.unique())
    colours = colours_of(planners)
    figure, axes = _panels(len(altitudes), "Time of a search", "box: middle half; line: median; whiskers: 5 to 95 %")
    for panel, altitude_m in zip(axes, altitudes, strict=True):
        for rank, planner in enumerate(planners):
            seconds = rows[(rows.planner == planner) & (rows.altitude_m == altitude_m)].elapsed_s
            if len(seconds):
                panel.boxplot(
                    seconds,
                    positions=[rank],
                    widths=0.6,
                    whis=(5, 95),
                    showfliers=False,
                    patch_artist=True,
                    boxprops={"facecolor": colours[planner], "alpha": 0.75, "linewidth": 0.6},
                    medianprops={"color": INK},
                )
            panel.plot([], [], "s", color=colours[planner], label=planner)
        panel.set_yscale("log")
        panel.set_xticks([])
        panel.set_title(f"{altitude_m:g} m", size=TEXT_PT, loc="left")
    axes[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} s"))
    _legend(figure, axes)
    return figure


def plot_usage(usage: pd.DataFrame) -> Figure:
    """Return the mean of each metric along the paths, by altitude, planner and objective (`analysis.usage`)."""
    metrics = [name for name in METRICS if usage[f"m_{name}"].notna().any()]
    altitudes = sorted(usage.altitude_m.unique())
    runs = list(usage[["planner", "objective"]].drop_duplicates().itertuples(index=False, name=None))
    colours = colours_of(sorted(usage.planner.unique()))
    figure, axes = _panels(
        len(metrics),
        "Metrics along the paths",
        "mean m over the instances that all of these solved, by altitude; scales differ",
        shares_y=False,
    )
    for panel, metric in zip(axes, metrics, strict=True):
        for rank, (planner, objective) in enumerate(runs):
            at = usage[(usage.planner == planner) & (usage.objective == objective)].set_index("altitude_m")
            values = [at[f"m_{metric}"].get(z, np.nan) for z in altitudes]
            x = np.arange(len(altitudes)) + (rank - (len(runs) - 1) / 2) * 0.1
            is_weighted = objective == WEIGHTED
            name = planner if is_weighted else f"{planner}, distance only"
            face = colours[planner] if is_weighted else "white"
            panel.plot(
                x,
                values,
                MARKERS[rank % len(MARKERS)],
                color=colours[planner],
                markerfacecolor=face,
                label=name,
                markersize=5,
                linestyle="none",
            )
        panel.set_xticks(range(len(altitudes)), [f"{z:g} m" for z in altitudes])
        panel.set_title(
            f"m_{metric}" + (" (1: most people)" if metric == "population" else " (1: best)"), size=TEXT_PT, loc="left"
        )
        panel.margins(y=0.12)
    _legend(figure, axes)
    return figure


def plot_paired(paired: pd.DataFrame) -> Figure:
    """Return cost ratios of planners two by two with their intervals (`analysis.paired`)."""
    shown = paired[np.isfinite(paired.cost_ratio)].iloc[::-1]
    height_in = 0.5 + 0.28 * len(shown)
    figure, (panel,) = _panels(
        1,
        "Planners two by two",
        "geometric mean of cost ratios where both found a path, 95 % bootstrap interval",
        height_in,
    )
    panel.set_position((0.38, 0.75 / (height_in + 1.45), 0.42, height_in / (height_in + 1.45)))
    y = np.arange(len(shown))
    ends = np.abs(shown[["low", "high"]].to_numpy().T - shown.cost_ratio.to_numpy())
    panel.axvline(1.0, color=FAINT_INK, linewidth=0.8)
    panel.errorbar(shown.cost_ratio, y, xerr=ends, fmt="o", color=INK, markersize=4, capsize=3, linewidth=1.2)
    panel.set_yticks(y, [f"{row.first} / {row.second}" for row in each(shown)])
    for place, row in zip(y, each(shown), strict=True):
        text = f"{row.cost_ratio:.3f}  ({row.both} pairs)"
        panel.annotate(text, (1.02, place), xycoords=("axes fraction", "data"), va="center", size=SMALL_PT, color=INK)
    panel.set_xscale("log")
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    low, high = min(0.98, shown.low.min()), max(1.02, shown.high.max())
    panel.set_xticks(np.round(np.geomspace(low, high, 4), 2))
    panel.set_ylim(-0.7, len(shown) - 0.3)
    panel.set_xlabel("cost of the first over cost of the second (below 1: the first is cheaper)", size=SMALL_PT)
    return figure


def plot_objectives(objectives: pd.DataFrame) -> Figure:
    """Return what the shortest path costs and saves against the cheapest, by altitude (`analysis.objectives`)."""
    figure, axes = _panels(
        2,
        "Shortest path against cheapest path",
        "distance-only over weighted runs of the same planner, 95 % interval",
        shares_y=False,
    )
    planners = sorted(objectives.planner.unique())
    colours = colours_of(planners)
    titles = ("weighted cost, ratio", "length, ratio")
    for panel, name, title in zip(axes, ("cost_ratio", "length_ratio"), titles, strict=True):
        for rank, planner in enumerate(planners):
            rows = objectives[objectives.planner == planner].sort_values("altitude_m")
            x = np.arange(len(rows)) + 0.12 * (rank - (len(planners) - 1) / 2)
            ends = np.abs(rows[[f"{name}_low", f"{name}_high"]].to_numpy().T - rows[name].to_numpy())
            panel.errorbar(x, rows[name], yerr=ends, fmt="o", color=colours[planner], capsize=3, label=planner)
            panel.set_xticks(range(len(rows)), [f"{z:g} m" for z in rows.altitude_m])
        panel.axhline(1.0, color=FAINT_INK, linewidth=0.8)
        panel.set_title(title, size=TEXT_PT, loc="left")
        panel.margins(x=0.15)
    _legend(figure, axes)
    return figure


def plot_complementarity(maps: MetricMaps, table: pd.DataFrame, *, time: str | None = None) -> Figure:
    """Return how m_gps and m_lidar share the free cells, by altitude, over their means (`complementarity`).

    The squares of a panel are shaded by the share of free cells, on a logarithmic scale; the dashed line parts cells
    where GPS is the better one (below) from those where lidar is; the first panel shows means and what either covers.
    """
    altitudes = table.altitude_m.tolist()
    figure, axes = _panels(
        len(altitudes) + 1,
        "GPS and lidar over the free cells",
        "left: mean m, and share of cells where a sensor serves (m >= 0.5); then cells by m, darker: more",
        shares_y=False,
        height_in=2.4,
    )
    first, *panels = axes
    x = np.arange(len(altitudes))
    for name in ("gps", "lidar"):
        first.plot(x, table[name], "o-", color=METRIC_COLOURS[name], label=f"mean m_{name}", markersize=4)
        first.plot(x, table[f"{name}_serves"], "s:", color=METRIC_COLOURS[name], label=f"{name} serves", markersize=3.5)
    first.plot(x, table.either_serves, "^--", color=INK, label="one or the other serves", markersize=3.5)
    first.set_xticks(x, [f"{z:g} m" for z in altitudes])
    first.set_ylim(-0.03, 1.05)
    bins = np.linspace(0, 1, 41)
    for panel, row in zip(panels, each(table), strict=True):
        is_free = maps.is_free(row.altitude_m, "centre")
        gps, lidar = maps.m("gps", row.altitude_m, time=time)[is_free], maps.m("lidar", row.altitude_m)[is_free]
        share = np.histogram2d(gps, lidar, [bins, bins])[0].T / len(gps)
        panel.pcolormesh(bins, bins, np.log10(np.where(share > 0, share, np.nan)), cmap="Greys", vmin=-6, vmax=-0.5)
        panel.plot([0, 1], [0, 1], "--", color=FAINT_INK, linewidth=0.8)
        panel.grid(visible=False)
        panel.set(xlim=(0, 1), ylim=(0, 1))
        panel.set_xlabel("m_gps", size=SMALL_PT)
        told = f", r = {row.correlation:+.2f}" if np.isfinite(row.correlation) else ""
        panel.set_title(f"{row.altitude_m:g} m{told}", size=TEXT_PT, loc="left")
    panels[0].set_ylabel("m_lidar", size=SMALL_PT, labelpad=1)
    _legend(figure, axes, columns=5)
    return figure


def study_figures(maps: MetricMaps, table: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> dict[str, Figure]:
    """Return every picture that a study's tables allow, by name."""
    figures = {
        "success": plot_success(tables["success"]),
        "costs": plot_costs(table),
        "times": plot_times(table),
    }
    if len(tables["usage"]):
        figures["usage"] = plot_usage(tables["usage"])
    if len(tables["paired"]) and np.isfinite(tables["paired"].cost_ratio).any():
        figures["paired"] = plot_paired(tables["paired"])
    if (table.objective == DISTANCE).any() and len(tables["objectives"]):
        figures["objectives"] = plot_objectives(tables["objectives"])
    if "complementarity" in tables:
        figures["complementarity"] = plot_complementarity(maps, tables["complementarity"])
    return figures
