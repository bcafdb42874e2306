"""Pictures of maps beside a receiver, satellite by satellite: where and how well they agree.

*Hidden* and *in view* are what the maps say of a satellite at a place; C/N0 is how strongly the receiver heard it.
"""

from functools import partial

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from jaxurban.draw.style import (
    FAINT_INK,
    INK,
    Colours,
    add_colour_bar,
    chart,
    dress,
    label_apart,
    legend_above,
    styled,
)
from jaxurban.draw.write import Figures
from jaxurban.receivers.validation.validate import ReceiverValidation

HIDDEN, SEEN = "#d55e00", "#0072b2"
ROWS = {  # of scores
    "all": "all judged",
    "received": "received ones",
    "unguarded": "all, judged or not",
    "G": "GPS",
    "R": "GLONASS",
    "E": "Galileo",
    "C": "BeiDou",
    "J": "QZSS",
    "I": "NavIC",
    "S": "SBAS",
}
HEADS = {  # of the report's tables
    "which": "rows",
    "rows": "number",
    "auc": "AUC",
    "within": "within each satellite",
    "num_satellites": "satellites with both",
}
AROUND_M = 10.0  # of track, along which agreement is counted
MARGINS_M = np.array([-50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50])  # between the classes of margins
SHARE = Colours(
    "cividis",
    Normalize(0.4, 1.0),
    "share of satellites that agree",
    extend="min",
    ticks=(0.4, 0.6, 0.8, 1.0),
)


def satellite_figures(result: ReceiverValidation) -> Figures:
    """Return what draws each figure, by file name."""
    return {"track": partial(plot_track, result), "margin": partial(plot_margin, result)}


@styled
def plot_track(result: ReceiverValidation) -> Figure:
    """Return the track in pieces of 10 m, coloured by the share of satellites on which maps and receiver agree.

    They agree where a satellite is in view and strong, or hidden and weak. Pieces without a judged satellite are
    crosses; the places of ``skies`` are named.
    """
    # The mean place of each piece from the southwest, in metres, and the share of its satellites that agree.
    epochs = result.epochs
    judged = result.rows[result.rows.is_judged]
    piece = (epochs.along_m // AROUND_M).to_numpy()
    places = epochs[["x_m", "y_m"]].groupby(piece).mean()
    track_m = (places - places.min()).to_numpy()
    x_m, y_m = track_m.T
    agrees = (judged.is_seen == judged.is_strong).groupby(piece[judged.epoch]).mean()
    share = agrees.reindex(places.index).to_numpy()
    is_known = np.isfinite(share)

    # The track as a line, known pieces as coloured dots over it, and the others as crosses.
    strong = f"{result.strong_dbhz:g} dBHz or more"
    note = f"Agreement: in view and {strong}, or hidden and weaker. By chance it would be half."
    wide_m, tall_m = np.ptp(track_m, axis=0) + AROUND_M
    width_mm = 32 + 88 * np.clip(wide_m / tall_m, 0.6, 1.6)  # of the bar and labels; of the panel
    figure = chart(4.2, "Where maps and receiver agree", note, width=width_mm)
    panel = figure.subplots()
    dress(panel)
    panel.plot(x_m, y_m, color=FAINT_INK, linewidth=0.6, zorder=0)
    panel.scatter(
        x_m[is_known], y_m[is_known], s=30, c=SHARE(share[is_known]), edgecolors=INK, linewidths=0.3
    )
    panel.scatter(
        x_m[~is_known], y_m[~is_known], s=25, marker="x", color=INK, label="nothing judged"
    )
    if not is_known.all():
        legend_above(panel)
    panel.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    add_colour_bar(figure, [panel], SHARE)

    # The names of the places, at the piece that holds the nearest epoch.
    marks_m = []
    for sky in result.skies:
        nearest = np.hypot(epochs.lon_deg - sky.lon_deg, epochs.lat_deg - sky.lat_deg).argmin()
        marks_m.append(track_m[places.index.get_loc(piece[nearest])])
    label_apart(panel, [sky.name for sky in result.skies], np.array([*marks_m, *track_m]))
    return figure


@styled
def plot_margin(result: ReceiverValidation) -> Figure:
    """Return C/N0 of received satellites, and the share not received, by the margin to the shadow's edge.

    The margin is the height of the antenna above the edge of the shadow: below 0 a building hides the satellite. Both
    panels have one column per class of margins (`MARGINS_M`).
    """
    # [R] the class of each judged row: the number of edges (`MARGINS_M`) below its margin.
    judged = result.rows[result.rows.is_judged]
    margin_class = np.digitize(judged.margin_m, MARGINS_M, right=True)
    note = "Boxes: the middle half of the received satellites; lines: 5 to 95 %. Above: how many were judged."
    figure = chart(4.2, "How strongly satellites are heard, by how deep they are hidden", note)
    panel, below = axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    edge = len(MARGINS_M) / 2  # the classes are symmetric around a margin of 0
    for k in np.unique(margin_class):
        strength_dbhz = judged.cn0_dbhz[margin_class == k]
        is_heard = strength_dbhz > 0
        colour = HIDDEN if k < edge else SEEN
        panel.boxplot(
            strength_dbhz[is_heard],
            positions=[k],
            widths=0.7,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            boxprops={"facecolor": colour},
            medianprops={"color": "white"},
        )
        num_judged = f"{len(is_heard):,}"
        panel.annotate(num_judged, (k, 1.0), xycoords=("data", "axes fraction"), ha="center")
        below.bar(k, 1 - is_heard.mean(), color=colour, width=0.7)

    # What both panels share: a line between hidden and in view, and the edges of the classes.
    for each in axes:
        dress(each)
        each.axvline(edge, color=INK, linewidth=1.2)
    below.set_xticks(np.arange(len(MARGINS_M)) + 0.5, MARGINS_M)
    below.set(
        xlabel="hidden  ←  height of the antenna above the edge of the shadow (m)  →  in view",
        ylabel="not received",
    )
    below.yaxis.set_major_formatter(PercentFormatter(1.0))
    panel.set_ylabel("C/N0 (dBHz)")
    return figure
