"""Pictures of a Monte Carlo benchmark: success, cost, and how GPS complements lidar."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.report.figures.frame import symbol_of
from jaxurban.report.figures.paths import Beside, planner_colours
from jaxurban.report.figures.style import (
    FAINT_INK,
    Colours,
    add_colour_bar,
    legend_below,
    letter_all,
    panels,
    step_up,
    styled,
)
from jaxurban.report.write import listed
from jaxurban.studies.montecarlo.analysis import range_names, rows_of, weighted_rows

SHARES = Colours(
    "Greys",
    LogNorm(1e-6, 0.3),
    "share of the free cells",
    extend="max",
    ticks=(1e-6, 1e-4, 0.01, 0.3),
)
CURVES_APART_PT = 1.5
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios


def _by_altitude(
    rows: pd.DataFrame, axes: Sequence[Axes], colours: Mapping[str, str]
) -> Iterator[tuple[Axes, int, str, pd.DataFrame]]:
    """Yield the rows of each planner at each altitude, with the panel of the altitude, titled, and the rank."""
    for panel, (altitude_m, of_altitude) in zip(axes, rows.groupby("altitude_m"), strict=True):
        panel.set_title(f"{altitude_m:g} m")
        for rank, planner in enumerate(colours):
            yield panel, rank, planner, of_altitude[of_altitude.planner == planner]


@styled
def plot_success(success: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved, by altitude and range (`analysis.success`)."""
    colours, ranges = planner_colours(sorted(success.planner.unique())), range_names(success)
    heading = "Share of pairs that some path joins, for which one was found"
    figure, axes = panels(success.altitude_m.nunique(), heading, shares_y=True)
    for panel, rank, planner, rows in _by_altitude(success, axes, colours):
        share, width = rows.set_index("range").share_joined.reindex(ranges), 0.8 / len(colours)
        x, colour = np.arange(len(ranges)), colours[planner]
        panel.bar(x + rank * width, share, width, color=colour, label=planner)
        panel.set_xticks(x + (0.8 - width) / 2, ranges)
    _show_shares(figure, axes, "joined pairs solved (%)")
    return figure


@styled
def plot_costs(table: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path."""
    colours = planner_colours(sorted(table.planner.unique()))
    heading = "Share of pairs solved at so many times the cheapest cost known"
    figure, axes = panels(table.altitude_m.nunique(), heading, shares_y=True)
    end = float(np.clip(table.ratio.quantile(0.98), *RATIO_AXIS))
    for panel, rank, planner, rows in _by_altitude(table, axes, colours):
        lane = (len(colours) - 1) / 2 - rank  # where curves coincide all are seen
        look: dict[str, Any] = {"path_effects": [Beside(lane * CURVES_APART_PT)], "linewidth": 1.4}
        step_up(panel, rows.ratio.to_numpy(), end, color=colours[planner], label=planner, **look)
        panel.set(xlim=(1 - 0.01 * (end - 1), end), xlabel="cost / cheapest known")
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    _show_shares(figure, axes, "joined pairs solved at that ratio (%)", -0.04)
    return figure


def _show_shares(figure: Figure, axes: Sequence[Axes], label: str, low: float = 0.0) -> None:
    letter_all(axes, label)
    axes[0].set_ylim(low, 1.04)
    for panel in axes:
        panel.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    legend_below(figure, axes[0])


@styled
def plot_complementarity(maps: MetricMaps, table: pd.DataFrame) -> Figure:
    """Return how the two metrics of a table share the free cells, by altitude.

    The squares of a panel are shaded by the share of free cells, on one logarithmic scale; the dashed line parts cells
    where the first is the better one (below) from those where the second is.
    """
    names = [str(name) for name in table if name in maps.metrics]
    labels = [maps.metrics[name].label for name in names]
    heading = f"{listed(labels)} over the free cells"
    figure, axes = panels(len(table), heading, shares_y=True)
    bins = np.linspace(0, 1, 41)
    for panel, row in zip(axes, rows_of(table), strict=True):
        is_free = maps.is_free(row.altitude_m, "centre")
        x, y = (maps.m(name, row.altitude_m)[is_free] for name in names)
        of_all = np.full(is_free.sum(), 1 / max(is_free.sum(), 1))
        look: dict[str, Any] = {"cmap": SHARES.cmap, "norm": SHARES.norm, "cmin": 1e-12}
        panel.hist2d(x, y, bins, weights=of_all, **look)
        panel.plot([0, 1], [0, 1], "--", color=FAINT_INK, linewidth=0.8)
        panel.grid(visible=False)
        correlation = f", r = {row.correlation:+.2f}" if np.isfinite(row.correlation) else ""
        title = f"{row.altitude_m:g} m{correlation}"
        panel.set(xlim=(0, 1), xlabel=symbol_of(names[0]), title=title)
    letter_all(axes, symbol_of(names[1]))
    add_colour_bar(figure, axes, SHARES)
    return figure


def study_figures(
    maps: MetricMaps, table: pd.DataFrame, tables: dict[str, pd.DataFrame]
) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture that a study's tables allow, by name."""
    weighted = weighted_rows(table)
    drawn: dict[str, tuple[Callable[..., Figure], pd.DataFrame]] = {
        "success": (plot_success, tables["success"]),
        "costs": (plot_costs, weighted[weighted.is_joined & bool(weighted.has_path.any())]),
        "complementarity": (
            partial(plot_complementarity, maps),
            tables.get("complementarity", pd.DataFrame()),
        ),
    }
    return {name: partial(draw, rows) for name, (draw, rows) in drawn.items() if len(rows)}
