"""What a receiver's validation writes: report.md, tables, and a picture of the log beside the maps."""

import hashlib
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxurban.io.read.tracks import AZIMUTH
from jaxurban.maps.levels import listed_m
from jaxurban.report.figures.style import (
    FAINT_INK,
    ends_of,
    legend_below,
    letter_all,
    panels,
    show_plain_log,
    styled,
)
from jaxurban.report.satellites import (
    peak_text,
    satellite_figures,
    satellite_tables,
    sentences_of,
)
from jaxurban.report.write import (
    Figures,
    Look,
    Written,
    bullets,
    fill,
    interval,
    paragraphs,
    study_outputs,
    table,
)
from jaxurban.satellites.track import NUM_VISIBLE
from jaxurban.settings import as_tuple
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.receiver.logs import ERROR, TRACKED, ReceiverLog
from jaxurban.studies.receiver.validate import (
    COEFFICIENTS,
    MAIN,
    SPEARMAN,
    WITHIN,
    ReceiverValidation,
)

NAMES = {NUM_VISIBLE: "satellites in view", "gps": "GPS quality m"}
LABELS = {TRACKED: "satellites tracked", ERROR: "horizontal error (m)"}
COUNTS = (NUM_VISIBLE, TRACKED)  # of satellites
HEADS = {WITHIN: "rank correlation within blocks", SPEARMAN: "over the whole track"}
RECEIVER_COLOUR, NUM_CLASSES = "#d55e00", 6


OF_LOG = "Where satellites stand is what the log says, and those that its file leaves out are not counted."
OF_ORBITS = (
    "The maps hold the satellites of [gps] orbits only, all of which are taken to be healthy."
)


def name_of(prediction: str) -> str:
    """Return what figures and reports call a quantity of the maps."""
    return NAMES.get(prediction, prediction.upper())


@styled
def plot_scatter(result: ReceiverValidation) -> Figure:
    """Return what the receiver measured against what the maps predict of it: a panel per measurement.

    A circle per piece of track, and the middle half of what was measured in each sixth of the pieces, by prediction.
    Values that are infinite stand at the edge.
    """
    rows = result.main.to_dict("records")
    heading = "Receiver against prediction, with rank correlations"
    figure, axes = panels(len(rows), heading, height_in=2.8)
    for panel, row in zip(axes, rows, strict=True):
        witness = row["witness"]
        name = row["prediction"]

        # The pieces in which both are known; an infinite value becomes the largest finite one.
        known = result.pieces.dropna(subset=[witness, name])
        x = known[name].clip(*ends_of(known[name].to_numpy()))
        y = known[witness].clip(*ends_of(known[witness].to_numpy()))
        _scale_axis(panel.xaxis, panel.set_xscale, name)
        _scale_axis(panel.yaxis, panel.set_yscale, witness)
        look: Look = {"markersize": 2.5, "markerfacecolor": "none", "label": "piece of track"}
        panel.plot(x, y, "o", color=FAINT_INK, **look)

        # Classes of about as many pieces: the middle half of what was measured as a bar, its median as a dot.
        of_class = np.ceil(NUM_CLASSES * x.rank(pct=True))
        middle_x = x.groupby(of_class).median()
        low, median, high = (y.groupby(of_class).quantile(share) for share in (0.25, 0.5, 0.75))
        label = "median and middle half of a sixth of the pieces"
        panel.vlines(middle_x, low, high, color=RECEIVER_COLOUR, linewidth=2.5, label=label)
        panel.plot(middle_x, median, "o", color=RECEIVER_COLOUR, markersize=6)

        label = f"maps: {name_of(name)}"
        num_infinite = np.isinf(known[name]).sum()
        if num_infinite:
            label += f" ({num_infinite} undetermined, at the right edge)"
        title = f"within blocks {row[WITHIN]:.2f}, whole track {row[SPEARMAN]:.2f}"
        panel.set(title=title, xlabel=label, ylabel=f"receiver: {LABELS[witness]}")
    letter_all(axes)
    legend_below(figure, axes[0])
    return figure


def _scale_axis(axis: Axis, set_scale: Callable[[str], None], quantity: str) -> None:
    """Give an axis whole numbers for counts, a logarithmic scale for errors and dilutions of precision.

    Args:
      axis: of a panel.
      set_scale: method of the panel that sets the scale of this axis by name.
      quantity: what the axis shows, of the maps or of the receiver.
    """
    if quantity in COUNTS:
        axis.set_major_locator(MaxNLocator(integer=True))
        return
    set_scale("log")
    show_plain_log(axis)


def validation_outputs(result: ReceiverValidation) -> Written:
    """Return what a validation writes, by file name, and the facts that identify it.

    Among the facts is a hash of the log's rows: two logs may have one name.
    """
    # The rows of the log as one text, of which the key has a hash.
    text = result.log.epochs.to_csv(index=False)
    if result.log.satellites is not None:
        text += result.log.satellites.to_csv(index=False)

    # Tables, with times as texts, and figures.
    pieces = result.pieces.assign(utc=result.pieces.utc.map(lambda time: time.isoformat()))
    tables = {"pieces": pieces, "scores": result.scores, "shifts": result.shifts}
    figures: Figures = {"scatter": partial(plot_scatter, result)}
    of = result.satellites
    if of is not None:
        tables |= {
            "satellites.parquet": of.rows,
            "satellite_scores": of.scores,
            "displaced": of.displaced,
            "field": of.field,
            "scales": of.scales,
            "rivals": of.rivals,
        }
        figures |= satellite_figures(result, of)
    key = {
        "log": result.log.name,
        "rows": hashlib.sha256(text.encode()).hexdigest(),
        "scenario": result.scenario,
        "settings": result.settings.to_dict(),
    }
    return study_outputs(validation_markdown(result), tables, figures), key


def validation_markdown(result: ReceiverValidation) -> str:
    """Return the report as Markdown; its parts on satellites are empty for a log without a row per satellite."""
    # Scores of each measurement with its own prediction, and with other quantities of the maps.
    is_main = result.scores.prediction == result.scores.witness.map(MAIN)
    others = result.scores[~is_main]
    tables = {}
    sentences = {}
    verdict = peak = ""
    satellites = result.satellites
    if satellites is not None:
        tables = satellite_tables(satellites)
        sentences = sentences_of(satellites)
        verdict = f"**{satellites.verdict}**"
        peak = peak_text(satellites)
    return fill(
        "validate",
        tables=tables,
        credits=[result.attribution],
        result=result,
        of=satellites,
        verdict=verdict,
        settings=result.settings,
        fewest=FEWEST_GROUPS,
        facts=table(("", ""), _facts(result)),
        scores=score_table(result.scores[is_main]),
        others=paragraphs("Other quantities of the maps:", score_table(others))
        if len(others)
        else "",
        cautions=bullets(f"{caution.level}: {caution}" for caution in result.known_cautions),
        sentences=sentences,
        peak=peak,
        of_orbits=OF_LOG if _needs_no_orbits(result.log) else OF_ORBITS,
    )


def _needs_no_orbits(log: ReceiverLog) -> bool:
    """Return whether a log has all directions of its satellites, and no counts to compare with those of maps."""
    has_angles = log.satellites is not None and AZIMUTH in log.satellites
    return has_angles and not log.witnesses


def _facts(result: ReceiverValidation) -> list[tuple[str, str]]:
    """Return the facts on the log and the maps, the rows of a table of the report: name and text.

    The orbits are left out where none were needed.

    Args:
      result: of the comparison; its summary has numbers of the track, and its scenario the settings of the maps.
    """
    summary = result.summary
    settings = result.settings
    scenario = result.scenario

    # In a log without counts of its own, satellites are counted from the rows that are judged.
    counted = ""
    if result.satellites is not None and not result.log.witnesses:
        counted = " (of rows that are judged)"

    # The texts of the facts.
    orbits = ", ".join(f"`{name}`" for name in scenario["gps"]["orbits"])
    skies = f"{summary['num_skies']} skies, one each {settings.sky_step_s:g} s"
    masks_deg = listed_m(as_tuple(scenario["gps"]["mask_deg"]))
    num_left_out = f"{summary['epochs_left_out']:,}"
    mean_tracked = summary.get(f"mean_{TRACKED}", math.nan)
    facts = {
        "epochs": f"{summary['epochs']:,}, of which {num_left_out} are left out: in a building or without data",
        "time": f"{summary['first_utc']} to {summary['last_utc']}",
        "track": f"{summary['length_m'] / 1000:.2f} km",
        f"satellites in view, mean{counted}": _number(summary["mean_num_visible"], digits=1),
        f"satellites tracked, mean{counted}": _number(mean_tracked, digits=1),
        "maps": f"cells of {summary['resolution_m']:g} m, elevation mask {masks_deg} degrees, "
        f"`oversample` {scenario['region']['oversample']}, antenna {settings.antenna_height_m:g} m above the ground",
        "orbits": "" if _needs_no_orbits(result.log) else f"{orbits}; {skies}",
        "city": f"buildings `{scenario['buildings']['source']}`, terrain `{scenario['terrain']['source'] or 'flat'}`",
    }
    return [(name, fact) for name, fact in facts.items() if fact]


def with_interval(row: Mapping[Any, Any], coefficient: str) -> str:
    """Return a coefficient with the interval that it has, as ``0.42 (0.29 to 0.54)``; nothing where it is undefined."""
    return interval(row, coefficient, _number)


def score_table(scores: pd.DataFrame) -> str:
    """Return scores as a table in Markdown, a line per row.

    Of each coefficient there are three columns: the value with its interval, what 95 % of all shifts of the maps along
    the track stay below, and p.
    """
    head = ["receiver", "maps", "pieces of", "number"]
    for name in COEFFICIENTS:
        head += [HEADS[name], "95 % of shifts below", "p"]
    rows = []
    for row in scores.to_dict("records"):
        cells = [
            LABELS[row["witness"]],
            name_of(row["prediction"]),
            f"{row['piece_m']:g} m",
            f"{row['num']:,}",
        ]
        for name in COEFFICIENTS:
            cells += [
                with_interval(row, name),
                _number(row[f"{name}_shifts_95"]),
                _number(row[f"{name}_p"], digits=3),
            ]
        rows.append(cells)
    return table(head, rows)


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
