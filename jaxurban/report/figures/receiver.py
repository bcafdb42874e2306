"""The picture of a receiver's log beside maps: a point a piece of track."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxurban.io.read.receiver import ERROR, TRACKED
from jaxurban.report.figures.style import ends_of, panels, show_plain_log, styled
from jaxurban.studies.receiver.prediction import NUM_VISIBLE
from jaxurban.studies.receiver.validate import SPEARMAN, WITHIN, ReceiverValidation

NAMES = {NUM_VISIBLE: "satellites in view", "gps": "GPS quality m"}
LABELS = {TRACKED: "satellites tracked", ERROR: "horizontal error (m)"}
COUNTS = (NUM_VISIBLE, TRACKED)  # of satellites
RECEIVER_COLOUR, MAP_COLOUR = "#d55e00", "#0072b2"
JITTER = 0.18  # sideways, of whole numbers


def name_of(prediction: str) -> str:
    """Return what figures and reports call a quantity of the maps."""
    return NAMES.get(prediction, prediction.upper())


@styled
def plot_scatter(found: ReceiverValidation) -> Figure:
    """Return the receiver against the prediction that is its own, a point a piece of track, a panel a witness."""
    rng, rows = np.random.default_rng(0), found.main.to_dict("records")
    figure, axes = panels(len(rows), "Receiver against prediction, with rank correlations", panel_in=(4.2, 3.4))
    for panel, row in zip(axes, rows, strict=True):
        witness, name = row["witness"], row["prediction"]
        known = found.pieces[found.pieces[witness].notna() & found.pieces[name].notna()]
        x, y = (_jittered(known[of_axis], rng) for of_axis in (name, witness))
        for axis, of_axis, set_scale in (
            (panel.xaxis, name, panel.set_xscale),
            (panel.yaxis, witness, panel.set_yscale),
        ):
            if of_axis in COUNTS:
                axis.set_major_locator(MaxNLocator(integer=True))
            else:  # errors and dilutions
                set_scale("log")
                show_plain_log(axis)
        panel.scatter(x, y, s=9, color=MAP_COLOUR, alpha=0.45, linewidths=0)
        title = f"within blocks {row[WITHIN]:.2f}, whole track {row[SPEARMAN]:.2f}"
        if name == NUM_VISIBLE:
            medians = known.groupby(np.round(known[name]))[witness].median()
            panel.plot(medians.index, medians, color=RECEIVER_COLOUR, marker="o", markersize=3.5, linewidth=1.2)
            title += "  ·  line: medians"
        num = int(np.isinf(known[name]).sum())
        panel.set_title(title)
        panel.set_xlabel(f"maps: {name_of(name)}{f' ({num} undetermined, at the right edge)' if num else ''}")
        panel.set_ylabel(f"receiver: {LABELS[witness]}")
    return figure


def _jittered(values: pd.Series, rng: np.random.Generator) -> np.ndarray:
    """Return values within their finite ends, counts of satellites a little aside so that every point is seen."""
    aside = rng.uniform(-JITTER, JITTER, len(values)) if values.name in COUNTS else 0.0
    return np.clip(values.to_numpy(), *ends_of(values.to_numpy())) + aside
