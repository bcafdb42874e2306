"""Longitude and latitude instead of easting and northing at the edges of a figure's maps, so that places are found."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator

from jaxurban.report.figures.frame import MAP, decimals_of, round_ticks
from jaxurban.world.grid import Grid

LABEL_IN = {"x": 0.75, "y": 0.5}  # room that a tick needs along its axis
CLEAR_IN = {"x": 0.3, "y": 0.0}  # that the last one leaves free, for the next panel's first
NUM_PLACES = 65  # along an edge, between which degrees are interpolated


def show_degrees(figure: Figure, grid: Grid) -> Figure:
    """Label the maps of a figure by degrees, and return it; maps without ticks, as in the overview, stay without.

    A tick stands where its meridian or parallel meets the map's lower or left edge: in a projection these run a little
    askew, so that it holds at that edge.

    Args:
      figure: from any function that draws maps.
      grid: any grid in the CRS of its maps.
    """
    for panel in figure.axes:
        if panel.get_gid() == MAP:
            (west_m, east_m), (south_m, north_m) = panel.get_xlim(), panel.get_ylim()
            x_m, y_m = np.linspace(west_m, east_m, NUM_PLACES), np.linspace(south_m, north_m, NUM_PLACES)
            longitudes = grid.lonlat_of_xy(x_m, np.full(NUM_PLACES, south_m))[0]
            latitudes = grid.lonlat_of_xy(np.full(NUM_PLACES, west_m), y_m)[1]
            width_in, height_in = panel.get_position().size * figure.get_size_inches()
            _label(panel, panel.xaxis, x_m, np.unwrap(longitudes, period=360.0), "EW", width_in)
            _label(panel, panel.yaxis, y_m, latitudes, "NS", height_in)
    return figure


def in_degrees(
    figures: Mapping[str, Callable[[], Figure]], grid: Grid, is_wanted: bool
) -> dict[str, Callable[[], Figure]]:
    """Return what draws figures, their maps labelled by degrees where that is wanted."""

    def labelled(draw: Callable[[], Figure]) -> Figure:
        return show_degrees(draw(), grid)

    return {name: partial(labelled, draw) if is_wanted else draw for name, draw in figures.items()}


def _label(panel: Axes, axis: Axis, at_m: np.ndarray, degrees: np.ndarray, sides: str, room_in: float) -> None:
    name = "x" if axis is panel.xaxis else "y"
    ticks, step = round_ticks(degrees[0], degrees[-1], room_in / LABEL_IN[name], CLEAR_IN[name] / room_in)
    axis.set_major_locator(FixedLocator(np.interp(ticks, degrees, at_m).tolist()))
    decimals = decimals_of(step)
    shown = (ticks + 180) % 360 - 180 if name == "x" else ticks
    axis.set_major_formatter(
        FixedFormatter([f"{abs(tick):.{decimals}f}°{sides[0 if tick >= 0 else 1]}" for tick in shown])
    )
    axis.set_label_text("")  # the letters say which it is
