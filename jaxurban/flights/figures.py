"""The picture of how high a straight flight home must be."""

from typing import Unpack

import numpy as np
from matplotlib.figure import Figure

from jaxurban.draw.frame import END_LOOK, HALO
from jaxurban.draw.metrics import plot_metric, precise_percent
from jaxurban.draw.style import HEAD_IN, TEXT_PT, drawing, grow, width_in_of, wrapped
from jaxurban.draw.write import Look
from jaxurban.flights.autopilots import typed_m
from jaxurban.flights.return_altitude import NAME, ReturnAltitude
from jaxurban.pictures import MapForm

LABEL: Look = HALO | {"textcoords": "offset points", "fontsize": TEXT_PT}


@drawing
def plot_return(home: ReturnAltitude, **form: Unpack[MapForm]) -> Figure:
    """Return the least altitude of a straight return from every cell, with home as a star.

    Args:
      home: from `ju.return_altitude`.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> ju.plot.plot_return(ju.return_altitude(maps, start)).savefig("return.png")
    """
    width_in = width_in_of(form)
    figure = plot_metric(home.maps, NAME, **form)
    panel = figure.axes[0]
    figures = home.figures
    share = precise_percent(figures["clear_share"])
    highest_m = typed_m(figures["highest_m"])
    text = f"{figures['typed_m']} m clears {share} of the area, {highest_m} m all that has a value"
    if np.isnan(home.altitude_m).any():
        text += "; elsewhere no altitude is known to be clear"
    title = wrapped(text, width_in, TEXT_PT)
    panel.set_title(title)
    grow(figure, HEAD_IN * title.count("\n"))  # further lines take no room from the map
    panel.plot(*home.home_xy_m, marker="*", markersize=14.0, clip_on=False, **END_LOOK)
    panel.annotate("home", home.home_xy_m, (9, 7), **LABEL)
    return figure
