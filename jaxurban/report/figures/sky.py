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
from jaxurban.report.figures.style import INK, MARKERS, SERIES_COLOURS, Width, chart, inches, styled
from jaxurban.report.write import Look

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

    Each satellite system has a marker and a colour, and each state (seen, hidden, unknown) a look of the marker.

    Args:
      of: from `jaxurban.sky`.
      time: one of its times; the first, if left out.
      width: see `plot_metric`.

    Raises:
      InputError: no such time.
    """
    # The figure with its heading and note.
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

    # The satellites at that time: a marker and a colour for each system, a look for each state.
    now = of.table[of.table["time"] == time]
    systems = enumerate(dict.fromkeys(now["system"]))
    for (number, system), (state, state_look) in product(systems, LOOKS.items()):
        rows = now[(now["system"] == system) & (now["state"] == state)]
        if rows.empty:
            continue
        azimuth_rad = np.radians(rows["azimuth_deg"])
        zenith_deg = 90 - rows["elevation_deg"]
        look = {"edgecolors": INK, "s": 55, "zorder": 5}
        look["marker"] = MARKERS[number % len(MARKERS)]
        look["facecolors"] = SERIES_COLOURS[number % len(SERIES_COLOURS)]
        label = f"{system.upper()}, {state}{MARKS[state]}"
        panel.scatter(azimuth_rad, zenith_deg, label=label, **(look | state_look))

        # Names in short, those of every other system below their marks: "05" of "GPS BIIF-9 (PRN 05)".
        offset_pt = (5, -9) if number % 2 else (5, 4)
        for name, *place in zip(rows["satellite"], azimuth_rad, zenith_deg, strict=True):
            short = name.removesuffix(" (nominal)").split()[-1].strip("()") + MARKS[state]
            panel.annotate(short, place, offset_pt, textcoords="offset points", size=7)
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

    # The roofs, once around the sky: the first degree stands again at the end.
    around = np.radians(np.arange(361))
    roof_edge = 90 - np.append(horizon_deg, horizon_deg[0])
    panel.fill_between(around, roof_edge, 90, color=ROOFS, label="buildings")
    is_missing = np.isnan(roof_edge)
    if is_missing.any():
        look: Look = {"facecolor": "white", "edgecolor": INK, "hatch": "////"}
        look |= {"linewidth": 0.0, "label": "horizon not known"}
        panel.fill_between(around, 90 - EDGE_DEG, 90, is_missing, **look)
