"""The picture of how high a straight flight home must be."""

import numpy as np
from matplotlib.figure import Figure

from jaxurban.draw.frame import END_LOOK
from jaxurban.draw.metrics import plot_metric
from jaxurban.draw.style import HEAD_IN, TEXT_PT
from jaxurban.draw.write import Look
from jaxurban.flights.return_altitude import NAME, ReturnAltitude


def plot_return(home: ReturnAltitude) -> Figure:
    """Return the least altitude of a straight return from every cell, with home as a star.

    Args:
      home: from `ju.return_altitude`.
    """
    figure = plot_metric(home.maps, NAME)
    panel = figure.axes[0]
    text = home.sentence.replace(", at", ",\nat", 1)
    if np.isnan(home.altitude_m).any():
        text += " Beige: no value."
    panel.set_title(text, loc="left", fontsize=TEXT_PT)
    # The second line of the title takes no room from the map.
    figure.set_figheight(figure.get_figheight() + HEAD_IN)
    panel.plot(*home.home_xy_m, marker="*", markersize=14.0, clip_on=False, **END_LOOK)
    label: Look = {"textcoords": "offset points", "backgroundcolor": "white", "fontsize": TEXT_PT}
    panel.annotate("home", home.home_xy_m, (9, 7), **label)
    return figure
