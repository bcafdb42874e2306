"""The sky over a place: the buildings around the rim, and the satellites that they hide and leave."""

import math
from itertools import product
from typing import Any, Unpack

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from jaxurban.draw.frame import joined, time_said
from jaxurban.draw.style import (
    INK,
    MARKERS,
    SERIES_COLOURS,
    chart,
    drawing,
    grow,
    label_apart,
    legend_columns,
    width_in_of,
)
from jaxurban.pictures import Form
from jaxurban.receivers.along import SkyAt
from jaxurban.receivers.rule import HIDDEN, SEEN, UNKNOWN

ROOFS = "#cfcac2"
SKY = 0.62  # height by the figure's width
KEY_IN, ROW_IN = 0.5, 0.15  # height of the legend without rows, and of a row
RINGS_DEG = 60, 30  # elevations at which circles are drawn, from the middle
EDGE_DEG = 8.0  # of the band at the rim that is hatched where the horizon is not known
LOOKS: dict[str, dict[str, Any]] = {  # of states; the marker is the system's
    SEEN: {"linewidths": 0.7},
    HIDDEN: {"linewidths": 1.4, "facecolors": "white"},
    UNKNOWN: {"linewidths": 1.0, "facecolors": "white", "linestyles": ":"},
}
MARKS = {SEEN: "", HIDDEN: " ✕", UNKNOWN: " ?"}  # behind a satellite's name


@drawing
def plot_sky(of: SkyAt, time: str | None = None, **form: Unpack[Form]) -> Figure:
    """Return the sky over a place at a time: north up, the zenith in the middle, the horizon filled.

    Each satellite system has a marker and a colour, and each state (seen, hidden, unknown) a look of the marker.

    Args:
      of: from `jaxurban.sky`.
      time: one of its times; the first, if left out.
      form: width, ax and title, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: no such time.

    Examples:
      >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
      >>> ju.plot.plot_sky(here, title="The sky over a street").savefig("sky.png")
    """
    # The figure with its heading and note, which counts what is drawn.
    width_in = width_in_of(form)
    time = of.times[0] if time is None else time
    if of.times != (time,):
        of = of.at(time)
    lon, lat = of.lonlat
    note = [joined(time_said(time), "exact outlines", of.attribution), *of.cautions]
    heading = f"The sky {of.altitude_m:g} m above ground at {lon:.5f}, {lat:.5f}"
    figure = chart(SKY * width_in + KEY_IN, heading, "\n".join(note), **form)
    panel: Any = figure.add_subplot(projection="polar")
    draw_horizon(panel, of.horizon_deg)

    # The satellites at that time: a marker and a colour for each system, a look for each state.
    now = of.table
    systems = enumerate(dict.fromkeys(now["system"]))
    for (number, system), (state, state_look) in product(systems, LOOKS.items()):
        rows = now[(now["system"] == system) & (now["state"] == state)]
        if rows.empty:
            continue
        look = {
            "edgecolors": INK,
            "s": 55,
            "zorder": 5,
            "marker": MARKERS[number % len(MARKERS)],
            "facecolors": SERIES_COLOURS[number % len(SERIES_COLOURS)],
        }
        label = f"{system.upper()}, {state}{MARKS[state]}".replace("$", r"\$")  # no mathematics
        panel.scatter(*sky_places(rows).T, label=label, **(look | state_look))
    labels = panel.get_legend_handles_labels()[1]
    num_cols = legend_columns(labels, width_in)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=num_cols)
    grow(figure, ROW_IN * math.ceil(len(labels) / num_cols))

    # Names in short: "05" of "GPS BIIF-9 (PRN 05)".
    states = zip(now["satellite"], now["state"], strict=True)
    names = [short_name(name) + MARKS[state] for name, state in states]
    label_apart(panel, names, sky_places(now))
    return figure


def short_name(satellite: str) -> str:
    """Return the last word of a satellite's name, which may stand in brackets: ``E11`` of ``GSAT0101 (E11)``."""
    return satellite.removesuffix(" (nominal)").split()[-1].strip("()")


def sky_places(rows: pd.DataFrame) -> np.ndarray:
    """Return where satellites stand in a polar panel, ``[N, 2]``: azimuth in radians, degrees from the zenith."""
    return np.column_stack([np.radians(rows["azimuth_deg"]), 90 - rows["elevation_deg"]])


def draw_horizon(panel: PolarAxes, horizon_deg: np.ndarray) -> None:
    """Draw the buildings of a sky in a polar panel: north up, the radius 90 degrees less the elevation.

    Args:
      panel: to draw in.
      horizon_deg: ``[360]`` by degree of azimuth; NaN where it is not known, which is hatched.
    """
    panel.set_theta_zero_location("N")
    panel.set_theta_direction(-1)
    panel.set_rlim(0, 90)
    panel.set_xticks(np.radians([0, 90, 180, 270]), ["N", "E", "S", "W"])
    panel.tick_params(pad=-3)
    panel.set_yticks([90 - elevation for elevation in RINGS_DEG], ["", ""])
    rings = ", ".join(f"{elevation}°" for elevation in RINGS_DEG)
    panel.plot([], [], color="#b0b0b0", linewidth=0.8, label=f"rings: {rings}")

    # The roofs, once around the sky: the first degree stands again at the end.
    around = np.radians(np.arange(361))
    roof_edge = 90 - np.append(horizon_deg, horizon_deg[0])
    panel.fill_between(around, roof_edge, 90, color=ROOFS, label="buildings")
    is_missing = np.isnan(roof_edge)
    if is_missing.any():
        panel.fill_between(
            around,
            90 - EDGE_DEG,
            90,
            is_missing,
            facecolor="white",
            edgecolor=ROOFS,
            hatch="////",
            linewidth=0.0,
            label="horizon not known",
        )
