"""Pictures of maps beside a receiver, satellite by satellite: where and how well they agree, and how other cities do.

*Hidden* and *in view* are what the maps say of a satellite at a place; C/N0 is how strongly the receiver heard it.
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import PercentFormatter

from jaxurban.report.figures.sky import ROOFS, draw_horizon, sky_places
from jaxurban.report.figures.style import (
    FAINT_INK,
    INK,
    Colours,
    add_colour_bar,
    chart,
    dress,
    label_apart,
    legend_above,
    legend_below,
    letter_all,
    styled,
)
from jaxurban.report.write import Figures, framed, interval, without_ends
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.receiver.agreement import SatelliteAgreement
from jaxurban.studies.receiver.validate import ReceiverValidation

HIDDEN, SEEN = "#d55e00", "#0072b2"
CLASSES = ((False, "hidden by a building", "^", HIDDEN), (True, "in view", "o", SEEN))
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
    "num_satellites": "satellites with both",
    "model": "rule",
    "log_loss": "log-loss",
    "gain": "gain on the street rule",
    "east_m": "moved east (m)",
    "north_m": "moved north (m)",
    "within_95_m": "95 % of resampled tracks within (m)",
    "scale": "heights times",
    "scale_low": "heights times_low",
    "scale_high": "heights times_high",
    "block_m": "blocks of (m)",
    "num_blocks": "blocks",
}
SCORES = "share", "auc", "within", "log_loss", "gain"
NAMES = {"auc": "all satellites", "within": "within each satellite"}  # of scores
AROUND_M = 10.0  # of track, along which agreement is counted
MARGINS_M = np.array([-50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50])  # between the classes of margins
SHARE = Colours(
    "cividis",
    Normalize(0.4, 1.0),
    "share of satellites that agree",
    extend="min",
    ticks=(0.4, 0.6, 0.8, 1.0),
)
STRENGTH = Colours(
    "viridis_r",
    Normalize(20, 50),
    "C/N0 (dBHz); hollow marks: not received; pale marks: not judged",
    extend="both",
    ticks=(20, 30, 40, 50),
)


def satellite_figures(result: ReceiverValidation, of: SatelliteAgreement) -> Figures:
    """Return what draws each figure, by file name."""
    return {
        "track": partial(plot_track, result, of),
        "margin": partial(plot_margin, of),
        "displacement": partial(plot_displacement, of),
        "skies": partial(plot_skies, of),
    }


def satellite_tables(of: SatelliteAgreement) -> dict[str, pd.DataFrame]:
    """Return the tables of the report by name.

    ``scores`` by kind of rows; ``cities``: scores of the city in its place, and the median and the most of displaced
    cities; ``rivals``: rules beside that of the maps; ``lengths``: scores by length of the blocks of track.
    """
    # Rows of both scores: of the city in its place, and of the displaced cities that could be scored.
    names = ["auc", "within"]
    in_place = of.scores.loc[of.scores.which == "all", names]
    displaced = of.displaced[names].quantile([0.5, 1.0])
    cities = pd.concat([in_place, displaced])
    counts = of.counts
    num = f"{counts['num_displaced']} of {counts['num_asked']} displaced ones that could be scored"
    cities.insert(0, "the city", ["in its place", f"{num}, median", "most"])
    scores = of.scores.replace({"which": ROWS})
    tables = {"scores": scores, "cities": cities, "rivals": of.rivals, "lengths": of.block_lengths}
    return {name: _with_digits(table).rename(columns=HEADS) for name, table in tables.items()}


def peak_text(of: SatelliteAgreement) -> str:
    """Return where the city fits the receiver best, as a table; in words where that is not known (NaN)."""
    if not np.isfinite(list(of.peak.values())).all():
        return f"None: that takes {FEWEST_GROUPS} blocks of track, and satellites both hidden and in view."
    return framed(pd.DataFrame([of.peak]).rename(columns=HEADS))


def sentences_of(of: SatelliteAgreement) -> dict[str, str]:
    """Return what the report says of how this log was judged, by the names of the template's fields.

    ``judging``: which rays are unknown; ``strong``: from which signal on a satellite is strong; ``part``: that only
    some epochs were used. The first and the last are empty where they do not apply.
    """
    judging = part = ""
    if of.counts["is_guarded"]:
        judging = "Which rays are unknown is decided from place and direction alone, whether or not a roof hides them."
    every = of.counts["every"]
    if every > 1:
        part = f"All that moves cities or roofs, and the rules, take one of {every} epochs of this long log."
    strong = "the weakest that was received: of most nothing was"
    if of.counts["is_median"]:
        strong = "this log's median"
    return {
        "judging": judging,
        "strong": f"at {of.strong_dbhz:g} dBHz or more, {strong}",
        "part": part,
    }


def _with_digits(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of the report, in which a value and its interval (NAME_low, NAME_high) share one column.

    Of scores and losses (`SCORES`) that column holds texts with three digits behind the point.
    """
    rows = table.to_dict("records")
    columns = without_ends(table)
    texts = table[columns].reset_index(drop=True)
    for name in texts.columns.intersection([*SCORES]):
        texts[name] = [interval(row, name, _three_digits) for row in rows]
    return texts


def _three_digits(value: float) -> str:
    """Return a number with three digits behind the point, never ``-0.000``; nothing for NaN."""
    return "" if math.isnan(value) else f"{value:z.3f}"


@styled
def plot_track(result: ReceiverValidation, of: SatelliteAgreement) -> Figure:
    """Return the track in pieces of 10 m, coloured by the share of satellites on which maps and receiver agree.

    They agree where a satellite is in view and strong, or hidden and weak. Pieces without a judged satellite are
    crosses; the places of `plot_skies` are named.
    """
    # The mean place of each piece from the southwest, in metres, and the share of its satellites that agree.
    epochs = result.epochs
    judged = of.rows[of.rows.is_judged]
    piece = (epochs.along_m // AROUND_M).to_numpy()
    places = epochs[["x_m", "y_m"]].groupby(piece).mean()
    track_m = (places - places.min()).to_numpy()
    x_m, y_m = track_m.T
    agrees = (judged.is_seen == judged.is_strong).groupby(piece[judged.epoch]).mean()
    share = agrees.reindex(places.index).to_numpy()
    is_known = np.isfinite(share)

    # The track as a line, known pieces as coloured dots over it, and the others as crosses.
    note = f"Agreement: in view and {of.strong_dbhz:g} dBHz or more, or hidden and weaker. By chance it would be half."
    wide_m, tall_m = np.ptp(track_m, axis=0) + AROUND_M
    width_mm = 32 + 88 * np.clip(wide_m / tall_m, 0.6, 1.6)  # of the bar and labels; of the panel
    figure = chart(4.2, "Where maps and receiver agree", note, width_mm)
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
    for sky in of.skies:
        nearest = np.hypot(epochs.lon_deg - sky.lon_deg, epochs.lat_deg - sky.lat_deg).argmin()
        marks_m.append(track_m[places.index.get_loc(piece[nearest])])
    label_apart(panel, [sky.name for sky in of.skies], np.array([*marks_m, *track_m]))
    return figure


@styled
def plot_margin(of: SatelliteAgreement) -> Figure:
    """Return C/N0 of received satellites, and the share not received, by the margin to the shadow's edge.

    The margin is the height of the antenna above the edge of the shadow: below 0 a building hides the satellite. Both
    panels have one column per class of margins (`MARGINS_M`).
    """
    # [R] the class of each judged row: the number of edges (`MARGINS_M`) below its margin.
    judged = of.rows[of.rows.is_judged]
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


@styled
def plot_displacement(of: SatelliteAgreement) -> Figure:
    """Return how well the city fits the receiver where it is moved or its roofs are scaled: three panels of AUC.

    The city moved by metres, as a map of moves; moved by 80 to 450 m, as histograms; and by the factor of all heights.
    """
    note = (
        "AUC: of two satellites of which the maps hide one, how often the one in view is the stronger.\n"
        "Cross and line: best fit; circle and band: 95 % of the best fits of resampled tracks."
    )
    figure = chart(2.7, "Would another place, city or height fit the receiver as well?", note)
    field, cities, scales = axes = figure.subplots(1, 3, width_ratios=(1.0, 1.5, 0.8))
    for panel in axes:
        dress(panel)

    # Moved by metres: a map of the AUC by the move, with the best move and the circle around it.
    auc = of.field.pivot(index="north_m", columns="east_m", values="auc")
    image = field.pcolormesh(auc.columns, auc.index, auc, cmap="cividis")
    figure.colorbar(image, ax=field, label="AUC", shrink=0.75, anchor=(0, 1), panchor="N")
    field.plot(of.peak["east_m"], of.peak["north_m"], "x", color=INK)
    field.add_patch(Circle((0, 0), of.peak["within_95_m"], fill=False))
    field.grid(visible=False)
    field.set(
        xlabel="city moved east (m)",
        ylabel="city moved north (m)",
        aspect="equal",
        title="moved by metres",
    )

    # Moved by hundreds of metres, and roofs scaled.
    draw_cities(cities, of, {"within": HIDDEN, "auc": SEEN})
    scales.axvspan(of.peak["scale_low"], of.peak["scale_high"], color=ROOFS, alpha=0.5)
    scales.axvline(of.peak["scale"], color=INK)
    scales.plot(of.scales.scale, of.scales.auc, color=SEEN)
    scales.set(xlabel="factor of roof heights", ylabel="AUC", title="roofs scaled")
    letter_all(axes)
    return figure


def draw_cities(panel: Axes, of: SatelliteAgreement, colours: Mapping[str, str]) -> None:
    """Draw how displaced cities score, as histograms, and the city in its place, as lines.

    Args:
      panel: to draw in.
      of: with the scores.
      colours: of the scores that are drawn, by their columns (`NAMES`).
    """
    (in_place,) = of.scores[of.scores.which == "all"].to_dict("records")
    for name, colour in colours.items():
        label = f"displaced, {NAMES[name]}"
        panel.hist(of.displaced[name].dropna(), bins=15, color=colour, alpha=0.6, label=label)
        label = f"the city in its place: {in_place[name]:.2f}"
        panel.axvline(in_place[name], color=colour, label=label)
    room = 1 + 0.3 * len(colours)  # above the bars, for the legend
    panel.set_ylim(top=panel.get_ylim()[1] * room)
    panel.legend(loc="upper left")
    title = f"{of.displaced.auc.notna().sum()} cities, moved by 80 to 450 m"
    panel.set(xlabel="AUC (0.5 by chance, 1 at best)", ylabel="displaced cities", title=title)


@styled
def plot_skies(of: SatelliteAgreement) -> Figure:
    """Return the sky over the places of least and of most agreement: roofs, and satellites coloured by strength.

    The marker says whether the maps have a satellite in view; it is hollow where the receiver heard nothing, and pale
    where the satellite is not judged.
    """
    # A polar panel for each place, with its roofs.
    figure = chart(4.3, "The sky over two places: the zenith in the middle, the horizon at the rim")
    axes = figure.subplots(1, len(of.skies), subplot_kw={"projection": "polar"}, squeeze=False)[0]
    for panel, sky in zip(axes, of.skies, strict=True):
        draw_horizon(panel, sky.horizon_deg)
        panel.set_title(f"{sky.name}, {sky.utc[11:19]} UTC")

        # Satellites that are hidden and such that are in view, each class with its marker.
        for is_seen, label, marker, _ in CLASSES:
            rows = sky.satellites[sky.satellites.is_seen == is_seen].sort_values("azimuth_deg")
            colours = STRENGTH(rows.cn0_dbhz.to_numpy())
            colours[rows.cn0_dbhz == 0] = 1.0  # white
            opacity = np.where(rows.is_judged, 1.0, 0.3) if len(rows) else None  # not of no row
            panel.scatter(
                *sky_places(rows).T,
                s=50,
                alpha=opacity,
                marker=marker,
                c=colours,
                edgecolors=INK,
                linewidths=0.7,
                label=label,
                zorder=5,
            )
    letter_all(axes)
    add_colour_bar(figure, axes, STRENGTH, "bottom")
    legend_below(figure, axes[0])
    for panel, sky in zip(axes, of.skies, strict=True):
        label_apart(panel, sky.satellites.satellite, sky_places(sky.satellites))
    return figure
