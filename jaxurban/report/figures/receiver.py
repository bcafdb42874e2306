"""Pictures of a receiver's log beside maps: along the track, against each other, over time, and the controls."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxurban.io.read.receiver import CN0, ERROR, SATELLITE, TRACKED, UTC
from jaxurban.report.figures.charts import dress, legend_below, panels, show_plain_log, styled
from jaxurban.report.figures.colours import Colours, ends_of
from jaxurban.report.figures.frame import MapLayer, add_bar_below, add_key, draw_layers, flat_layer, make_frame
from jaxurban.report.figures.notes import joined, time_said
from jaxurban.studies.receiver.prediction import NUM_VISIBLE
from jaxurban.studies.receiver.scores import AUC, COEFFICIENTS, MAIN, OPEN, SPEARMAN, WITHIN
from jaxurban.studies.receiver.validate import ReceiverValidation

NAMES = {
    NUM_VISIBLE: "satellites in view",
    "gps": "GPS quality m",
    "line of sight": "line of sight",
}
LABELS = {
    TRACKED: "satellites tracked",
    ERROR: "horizontal error (m)",
    SATELLITE: "a satellite is tracked",
    CN0: "C/N0 of tracked satellites",
}
COUNTS = (NUM_VISIBLE, TRACKED)  # of satellites
RECEIVER_COLOUR, MAP_COLOUR, OPEN_COLOUR = "#d55e00", "#0072b2", "#8a8a8a"
CURVES = {WITHIN: "within blocks", SPEARMAN: "whole track", AUC: "AUC"}
COLOURS = {WITHIN: MAP_COLOUR, SPEARMAN: OPEN_COLOUR, AUC: MAP_COLOUR}
# Fewer satellites are darker; neither end is as dark or as light as the track's colours.
BEHIND = LinearSegmentedColormap.from_list("behind", ["#6f6f6f", "#fbfbfb"])
BUILDING_COLOUR = "#d9d2c3"
LEAST_SHOWN = 0.01  # of errors (m) on a logarithmic axis
JITTER = 0.18  # sideways, of whole numbers in a scatter plot


def validation_figures(found: ReceiverValidation) -> dict[str, Callable[[], Figure]]:
    """Return what draws each picture, by its name."""
    return {name: partial(draw, found) for name, draw in DRAWN.items()}


def name_of(prediction: str) -> str:
    """Return what figures and reports call a quantity of the maps."""
    return NAMES.get(prediction, prediction.upper())


def _note(found: ReceiverValidation, *more: str) -> str:
    of = found.summary
    when = f"{time_said(of['first_utc'])} to {of['last_utc'][11:16]} UTC"
    track = f"{of['length_m'] / 1000:.2f} km, medians over pieces of {found.settings.piece_m:g} m"
    cells = f"{of['resolution_m']:g} m cells, antenna {found.settings.antenna_height_m:g} m up"
    return joined(when, track, cells, *more, found.attribution)


def plot_track(found: ReceiverValidation) -> Figure:
    """Return what the maps say and what the receiver told, along its way over the map of satellites in view."""
    witness = found.log.witnesses[0]
    shown = {MAIN[witness]: f"maps: {name_of(MAIN[witness])}", witness: f"receiver: {LABELS[witness]}"}
    behind = found.background
    frame = make_frame(
        behind.grid, list(shown.values()), "Prediction and receiver along the track", _note(found), footer_in=0.42
    )
    low, high = ends_of(behind.num_visible)
    said = f"behind: satellites in view, {time_said(behind.time)}"
    scale = _whole(Colours(BEHIND, Normalize(), said), low, max(high, low + 1))
    for panel, name in zip(frame.axes, shown, strict=True):
        draw_layers(
            panel, behind.grid, [MapLayer(behind.num_visible, scale), flat_layer(behind.is_obstacle, BUILDING_COLOUR)]
        )
        values = found.pieces[name].to_numpy()
        least, most = _ends(values)
        colours = Colours("plasma", Normalize(least, most))
        if name in COUNTS:
            colours = _whole(colours, least, most)
        if _is_skewed(name):
            colours = Colours("plasma_r", LogNorm(max(least, LEAST_SHOWN), most))
        panel.scatter(
            found.pieces.x_m,
            found.pieces.y_m,
            c=colours(np.clip(values, colours.norm.vmin, most)),
            s=16,
            linewidths=0.3,
            edgecolors="black",
            zorder=5,
        )
        add_bar_below(frame, panel, colours)
    add_key(frame, [("building", BUILDING_COLOUR)], scale)
    return frame.figure


def _ends(values: np.ndarray) -> tuple[float, float]:
    """Return the ends of an axis: those of the finite values, some way apart."""
    low, high = ends_of(values)
    return low, high if high > low else low + 1.0


def _whole(colours: Colours, low: float, high: float) -> Colours:
    """Return colours of values between two ends whose bar has whole numbers alone, as those of satellites are."""
    low, high = math.floor(low), math.ceil(high)
    ticks = [float(value) for value in MaxNLocator(5, integer=True).tick_values(low, high) if low < value < high]
    return replace(colours, norm=Normalize(low, high), ticks=ticks)


def _is_skewed(name: str) -> bool:
    """Return whether a quantity is drawn on a logarithmic axis, less being better: errors and dilutions."""
    return name == ERROR or name.endswith("dop")


@styled
def plot_scatter(found: ReceiverValidation) -> Figure:
    """Return the receiver against the prediction that is its own, a point a piece of track, a panel a witness."""
    rows = [row for row in found.main.to_dict("records") if row["witness"] in found.log.witnesses]
    rng = np.random.default_rng(0)
    figure, axes = panels(len(rows), "Receiver against prediction", _note(found), panel_in=(4.2, 3.4))
    for panel, row in zip(axes, rows, strict=True):
        witness, name = row["witness"], row["prediction"]
        known = found.pieces[found.pieces[witness].notna() & found.pieces[name].notna()]
        is_whole = np.array([[name == NUM_VISIBLE], [witness == TRACKED]])
        aside = rng.uniform(-JITTER, JITTER, (2, len(known))) * is_whole
        ends = [_ends(known[each].to_numpy()) for each in (name, witness)]
        x, y = (np.clip(known[each], *end) + by for each, end, by in zip((name, witness), ends, aside, strict=True))
        panel.scatter(x, y, s=9, color=MAP_COLOUR, alpha=0.45, linewidths=0)
        title = _coefficients(row)
        if name == NUM_VISIBLE:
            medians = known.groupby(np.round(known[name]))[witness].median()
            panel.plot(medians.index, medians, color=RECEIVER_COLOUR, marker="o", markersize=3.5, linewidth=1.2)
            title += "  ·  line: medians"
        panel.set_title(title)
        _scale(panel, witness)
        for axis, shown in ((panel.xaxis, name), (panel.yaxis, witness)):
            if shown in COUNTS:
                axis.set_major_locator(MaxNLocator(integer=True))
        if _is_skewed(name):
            panel.set_xscale("log")
            show_plain_log(panel.xaxis)
        num = int(np.isinf(known[name]).sum())
        panel.set_xlabel(f"maps: {name_of(name)}{f' ({num} undetermined, at the right edge)' if num else ''}")
        panel.set_ylabel(f"receiver: {LABELS[witness]}")
    return figure


def _scale(panel: Axes, name: str) -> None:
    """Give what a panel shows upward a logarithmic scale, if it is skewed."""
    if _is_skewed(name):
        panel.set_yscale("log")
        show_plain_log(panel.yaxis)


def _coefficients(row: Mapping[Any, Any]) -> str:
    return ", ".join(f"{CURVES[name]} {row[name]:.2f}" for name in COEFFICIENTS if np.isfinite(row[name]))


@styled
def plot_time_line(found: ReceiverValidation) -> Figure:
    """Return receiver, maps and open sky over time, a panel a witness."""
    witnesses = found.log.witnesses
    figure, axes = panels(
        len(witnesses),
        "Receiver and prediction over time",
        _note(found),
        panel_in=(9.2, 2.3),
        most_in_row=1,
    )
    pieces = found.pieces.sort_values(UTC)
    times = pieces[UTC].dt.tz_localize(None).to_numpy()
    for panel, witness in zip(axes, witnesses, strict=True):
        name = MAIN[witness]
        _step(panel, times, pieces[witness], RECEIVER_COLOUR, "receiver", 1.3)
        beside = panel if witness == TRACKED else panel.twinx()
        _step(beside, times, pieces[name], MAP_COLOUR, "maps", 1.1)
        _step(beside, times, pieces[f"{OPEN}{name}"], OPEN_COLOUR, "open sky", 0.9)
        locator = AutoDateLocator()
        panel.xaxis.set_major_locator(locator)
        panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        if beside is panel:
            panel.set_title("satellites: tracked by the receiver, in view by the maps, above the mask")
            panel.set_ylabel("satellites")
            panel.set_ylim(bottom=0)
        else:
            dress(beside, has_grid=False)
            panel.set_title(f"{LABELS[witness]} (left) and {name_of(name)} (right)")
            panel.set_ylabel(LABELS[witness], color=RECEIVER_COLOUR)
            beside.set_ylabel(name_of(name), color=MAP_COLOUR)
            for side, shown in ((panel, witness), (beside, name)):
                _scale(side, shown)
    axes[-1].set_xlabel("UTC")
    if TRACKED in witnesses:
        legend_below(figure, axes[0])
    else:
        figure.legend(
            [*axes[0].lines, *figure.axes[-1].lines],
            ["receiver", "maps", "open sky"],
            loc="outside lower center",
            ncols=3,
        )
    return figure


def _step(panel: Axes, times: np.ndarray, values: pd.Series, colour: str, label: str, width: float) -> None:
    panel.plot(
        times,
        np.clip(values, *_ends(values.to_numpy())),
        color=colour,
        linewidth=width,
        drawstyle="steps-mid",
        label=label,
    )


@styled
def plot_control(found: ReceiverValidation) -> Figure:
    """Return the first witness's agreement by length of pieces, and at every shift of the maps along the track."""
    first = found.main.iloc[0]
    shown = [name for name in COEFFICIENTS[:2] if np.isfinite(first[name])] or [AUC]
    scores = found.scores[(found.scores.witness == first.witness) & (found.scores.prediction == first.prediction)]
    heading = f"{LABELS[first.witness]} against {name_of(first.prediction)}: agreement, and every shift as control"
    figure, (by_length, by_shift) = panels(2, heading[0].upper() + heading[1:], _note(found), panel_in=(4.2, 2.8))
    is_shown = (found.shifts.witness == first.witness) & (
        (found.shifts.piece_m == first.piece_m) | found.shifts.piece_m.isna()
    )
    shifts = found.shifts[is_shown].sort_values("shift")
    step, unit = (1.0, "epochs") if np.isnan(first.piece_m) else (first.piece_m, "m")
    place = np.arange(len(scores))
    for aside, name in zip((-0.08, 0.08), shown, strict=False):
        colour = COLOURS[name]
        by_length.plot(place + aside, scores[name], "o", color=colour, label=CURVES[name])
        by_length.plot(
            place + aside, scores[f"{name}_shifts_95"], "x", color=colour, label=f"{CURVES[name]}: 95 % of shifts below"
        )
        by_shift.plot(shifts["shift"] * step, shifts[name], color=colour, linewidth=1.0)
    if WITHIN in shown and (has_interval := scores.within_low.notna()).any():
        ends = scores.within_low[has_interval], scores.within_high[has_interval]
        by_length.vlines(place[has_interval] - 0.08, *ends, color=COLOURS[WITHIN], label="95 % interval")
    lengths = ["each epoch" if np.isnan(length) else f"{length:g} m" for length in scores.piece_m]
    by_length.set_xticks(place, lengths)
    by_length.set_xlim(-0.5, len(scores) - 0.5)
    by_length.set(xlabel="pieces of track", ylabel="AUC" if shown == [AUC] else "rank correlation")
    by_length.set_title("by length of pieces")
    by_shift.set(xlabel=f"maps shifted along the track ({unit})")
    by_shift.set_title("every circular shift")
    for panel in (by_length, by_shift):
        panel.axhline(0.5 if shown == [AUC] else 0.0, color="#999999", linewidth=0.7)
    legend_below(figure, by_length)
    return figure


DRAWN: dict[str, Callable[[ReceiverValidation], Figure]] = {
    "track": plot_track,
    "scatter": plot_scatter,
    "time_line": plot_time_line,
    "control": plot_control,
}
