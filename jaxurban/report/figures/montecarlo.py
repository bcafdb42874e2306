"""Pictures of a Monte Carlo benchmark: cost, and how GPS complements lidar."""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import Stroke
from matplotlib.ticker import MaxNLocator

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.report.figures.frame import symbol_of
from jaxurban.report.figures.paths import planner_colours
from jaxurban.report.figures.style import (
    FAINT_INK,
    Colours,
    add_colour_bar,
    letter_all,
    panels,
    show_shares,
    step_up,
    styled,
)
from jaxurban.report.write import Figures, joined_with_and
from jaxurban.studies.montecarlo.analysis import weighted_rows

SHARES = Colours(
    "Greys",
    LogNorm(1e-4, 30),
    "share of the free cells (%)",
    extend="max",
    ticks=(1e-4, 0.01, 1, 30),
)
CURVES_APART_PT = 1.5
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios


@styled
def plot_costs(table: pd.DataFrame) -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path known.

    A panel per altitude, a rising curve per planner.

    Args:
      table: rows of the joined pairs, with ``planner``, ``altitude_m`` and ``ratio``: the cost of the planner's path
        by that of the cheapest one known, from 1 up; NaN where it has no path, which counts as not solved.
    """
    colours = planner_colours(sorted(table.planner.unique()))
    heading = "Share of pairs solved within a factor of the cheapest cost known"
    figure, axes = panels(table.altitude_m.nunique(), heading, shares_y=True)
    end = np.clip(table.ratio.quantile(0.98), *RATIO_AXIS)
    left = 1 - 0.01 * (end - 1)  # a little room before the ratio of 1
    for panel, (altitude_m, rows) in zip(axes, table.groupby("altitude_m"), strict=True):
        for rank, (planner, colour) in enumerate(colours.items()):
            # Curves are drawn side by side around their place, so that all are seen where they coincide.
            apart_pt = ((len(colours) - 1) / 2 - rank) * CURVES_APART_PT
            step_up(
                panel,
                rows.ratio[rows.planner == planner].to_numpy(),
                end,
                color=colour,
                label=planner,
                path_effects=[Stroke(offset=(-apart_pt, apart_pt))],
                linewidth=1.4,
            )
        panel.set(xlim=(left, end), xlabel="cost / cheapest known", title=f"{altitude_m:g} m")
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    show_shares(figure, axes, "joined pairs solved at that ratio (%)", (-0.04, 1.04))
    return figure


@styled
def plot_complementarity(maps: MetricMaps, table: pd.DataFrame) -> Figure:
    """Return how two metrics share the free cells: a panel per altitude, with one metric along each axis.

    The squares of a panel are shaded by their share of the free cells, on one logarithmic scale; the dashed line parts
    cells where the first metric is the better one (below) from cells where the second is.

    Args:
      maps: with both metrics.
      table: a row per altitude, with ``altitude_m``, the ``correlation`` of the two (NaN where it is not defined), and
        a column of the name of each metric.
    """
    names = [str(name) for name in table if name in maps.metrics]
    labels = [maps.metrics[name].label for name in names]
    heading = f"{joined_with_and(labels)} over the free cells"
    figure, axes = panels(len(table), heading, shares_y=True)
    bins = np.linspace(0, 1, 41)  # edges of 40 squares along each axis

    # Each panel: every free cell adds its share to a square, and squares without a cell stay white.
    rows: Any = table.itertuples()
    for panel, row in zip(axes, rows, strict=True):
        is_free = maps.is_free(row.altitude_m, "centre")
        x, y = (maps.m(name, row.altitude_m)[is_free] for name in names)
        share_of_a_cell = np.full(len(x), 100 / max(len(x), 1))
        panel.hist2d(
            x, y, bins, weights=share_of_a_cell, cmap=SHARES.cmap, norm=SHARES.norm, cmin=1e-12
        )
        panel.plot([0, 1], [0, 1], "--", color=FAINT_INK, linewidth=0.8)
        panel.grid(visible=False)
        title = f"{row.altitude_m:g} m"
        if np.isfinite(row.correlation):
            title += f", r = {row.correlation:+.2f}"
        panel.set(xlim=(0, 1), xlabel=symbol_of(names[0]), title=title)
    letter_all(axes, symbol_of(names[1]))
    add_colour_bar(figure, axes, SHARES)
    return figure


def study_figures(
    maps: MetricMaps, table: pd.DataFrame, tables: dict[str, pd.DataFrame]
) -> Figures:
    """Return the functions that draw the pictures of a study, by name; a picture without rows is left out.

    Args:
      maps: of the study.
      table: a row per planner, objective, instance and altitude.
      tables: of the report, by name; without ``complementarity`` that picture is left out.
    """
    weighted = weighted_rows(table)
    figures: Figures = {}
    if weighted.has_path.any() and weighted.is_joined.any():
        figures["costs"] = partial(plot_costs, weighted[weighted.is_joined])
    if len(tables.get("complementarity", ())):
        figures["complementarity"] = partial(plot_complementarity, maps, tables["complementarity"])
    return figures
