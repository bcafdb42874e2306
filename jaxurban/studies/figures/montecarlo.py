"""The picture of a Monte Carlo benchmark: cost."""

from typing import Unpack

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from jaxurban.draw.routes import planner_colours, widths_of
from jaxurban.draw.style import drawing, legend_below, letter_all, panels, step_up
from jaxurban.pictures import Form

CURVE = 0.6  # width of a curve by that of a route
RATIO_AXIS = (1.1, 2.0)  # the least and the greatest end of the axis of cost ratios


@drawing
def plot_costs(table: pd.DataFrame, **form: Unpack[Form]) -> Figure:
    """Return the share of joined pairs that each planner solved within a ratio of the cheapest path known.

    A panel per altitude, a rising curve per planner.

    Args:
      table: rows of the joined pairs, with ``planner``, ``altitude_m`` and ``ratio``: the cost of the planner's path
        by that of the cheapest one known, from 1 up; NaN where it has no path, which counts as not solved.
    """
    colours = planner_colours(sorted(table.planner.unique()))
    heading = "Share of pairs solved within a factor of the cheapest cost known"
    figure, axes = panels(table.altitude_m.nunique(), heading, shares_y=True, **form)
    room = 0.01 * (table.ratio.max() - 1)  # before the ratio of 1, and after the last one
    end = np.clip(table.ratio.max() + room, *RATIO_AXIS)
    left = 1 - 0.01 * (end - 1)
    for panel, (altitude_m, rows) in zip(axes, table.groupby("altitude_m"), strict=True):
        # Earlier curves are wider, so that all are seen where they coincide.
        widths_pt = CURVE * widths_of(len(colours))
        for (planner, colour), width_pt in zip(colours.items(), widths_pt, strict=True):
            ratios = rows.ratio[rows.planner == planner].to_numpy()
            step_up(panel, ratios, end, color=colour, label=planner, linewidth=width_pt)
        title = f"{altitude_m:g} m, pairs: {len(ratios)}"
        panel.set(xlim=(left, end), xlabel="cost / cheapest known", title=title)
        panel.xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
        panel.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    letter_all(axes, "joined pairs solved at that ratio (%)")
    axes[0].set_ylim(-0.04, 1.04)  # curves at 0 are seen whole
    legend_below(figure, axes[0])
    return figure
