"""The sky over a place: the buildings around the rim, and the satellites that they hide and leave."""

from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from jaxurban.errors import InputError
from jaxurban.paths.sight import HIDDEN, SEEN, UNKNOWN
from jaxurban.paths.sky import SkyAt
from jaxurban.report.figures.frame import joined, time_said
from jaxurban.report.figures.style import (
    INK,
    MARKERS,
    SERIES_COLOURS,
    Width,
    chart,
    inches,
    styled,
)

ROOFS = "#cfcac2"
SKY, KEY_IN = 0.62, 0.8  # height of the sky by the figure's width; of the legend
EDGE_DEG = 8.0  # of the band at the rim that is hatched where the horizon is not known
LOOKS: dict[str, dict[str, Any]] = {  # of states; the marker is the system's
    SEEN: {"linewidths": 0.7},
    HIDDEN: {"linewidths": 1.4, "facecolors": "white"},
    UNKNOWN: {"linewidths": 1.0, "facecolors": "white", "linestyles": ":"},
}
MARKS = {SEEN: "", HIDDEN: " ✕", UNKNOWN: " ?"}  # behind a satellite's name


@styled
def plot_sky(of: SkyAt, time: str | None = None, *, width: Width = "page") -> Figure:
    """Return the sky over a place at a time: north up, the zenith in the middle, the horizon filled.

    Args:
      of: from `jaxurban.sky`.
      time: one of its times; the first, if left out.
      width: see `plot_metric`.

    Raises:
      InputError: no such time.
    """
    time = of.times[0] if time is None else time
    if time not in of.times:
        raise InputError(f"time must be one of {', '.join(of.times)}, got {time!r}")
    lon, lat = of.lonlat
    methods = {
        "outlines": "exact outlines",
        "map": "satellites by the map's cell, horizon by outlines",
    }
    note = [joined(time_said(time), methods[of.by], of.attribution), *of.cautions]
    heading = f"The sky {of.altitude_m:g} m above ground at {lon:.5f}, {lat:.5f}"
    figure = chart(SKY * inches(width) + KEY_IN, heading, "\n".join(note), width)
    panel: Any = figure.add_subplot(projection="polar")
    draw_horizon(panel, of.horizon_deg)
    now = of.table[of.table["time"] == time]
    systems = list(dict.fromkeys(now["system"]))
    for (k, system), (state, look) in product(enumerate(systems), LOOKS.items()):
        rows = now[(now["system"] == system) & (now["state"] == state)]
        if rows.empty:
            continue
        x, y = np.radians(rows["azimuth_deg"]), 90 - rows["elevation_deg"]
        shape = {"marker": MARKERS[k % len(MARKERS)], "edgecolors": INK, "s": 55, "zorder": 5}
        colour = {"facecolors": SERIES_COLOURS[k % len(SERIES_COLOURS)]}
        label = f"{system.upper()}, {state}{MARKS[state]}"
        panel.scatter(x, y, label=label, **(colour | shape | look))
        for name, x_at, y_at in zip(rows["satellite"], x, y, strict=True):
            short = name.removesuffix(" (nominal)").split()[-1].strip("()") + MARKS[state]
            offset = (5, -9 if k % 2 else 4)
            panel.annotate(short, (x_at, y_at), offset, textcoords="offset points", size=7)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=2)
    return figure


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
    panel.set_yticks([30, 60], ["", ""])
    around, rim = np.radians(np.arange(361)), 90 - np.append(horizon_deg, horizon_deg[0])
    panel.fill_between(around, rim, 90, color=ROOFS, label="buildings")
    if (is_missing := np.isnan(rim)).any():
        look: dict[str, Any] = {"facecolor": "white", "edgecolor": INK, "hatch": "////"}
        look |= {"linewidth": 0.0, "label": "horizon not known"}
        panel.fill_between(around, 90 - EDGE_DEG, 90, is_missing, **look)
