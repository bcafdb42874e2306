"""Picture of several fits of weights: how near they are to a reference, and what they leave on held-out routes."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxurban.report.figures.charts import chart, dress, legend_below, show_plain_log, styled
from jaxurban.report.figures.frame import FAINT_INK
from jaxurban.studies.tuning.compared_fits import FitComparison

WIDTH_IN, ROW_IN = 9.0, 0.3
LEAST_SPAN = 20.0  # of a logarithmic axis, from end to end
LEAST_FAR, LEAST_REGRET = 1e-7, 1e-6  # of 1 - cosine and of a regret, on logarithmic scales
SEEN_COLOUR, PILOT_COLOUR, CITY_COLOUR = "#0b4f9e", "#f0a030", "#999999"


@styled
def plot_fits(found: FitComparison) -> Figure:
    """Return a row a fit: 1 - cosine to the reference, and the regret on held-out routes with its interval."""
    fits = found.table
    reference = "the pilot's weights" if found.reference == "pilot" else f"the fit {found.reference!r}"
    held_out = int(found.routes.is_held_out.sum())
    bad = int(found.routes.is_bad.sum())
    bars = "bars: intervals, of cosines over bootstrap fits"
    note = f"{held_out} of {len(found.routes)} routes held out; {bad} found bad; {bars}"
    figure = chart(WIDTH_IN, 1.0 + ROW_IN * len(fits), "Fits compared", note)
    near, left = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(fits))[::-1]
    far = 1 - fits[["cosine", "cosine_high", "cosine_low"]].set_axis(["mean", "low", "high"], axis=1)
    _draw(near, places, far, LEAST_FAR, SEEN_COLOUR, "")
    near.set(xlabel=f"1 - cosine to {reference}", yticks=places, ylim=(-0.6, len(fits) - 0.4))
    near.set_yticklabels(fits["fit"])
    for name in (f"regret {city}" for city in dict.fromkeys(found.routes.city)):
        left.plot(100 * fits[name].clip(lower=LEAST_REGRET), places, "|", color=CITY_COLOUR, markersize=8)
    _draw(left, places + 0.08, 100 * _ends(fits, "held_out_regret"), 100 * LEAST_REGRET, SEEN_COLOUR, "held-out routes")
    if "pilot_regret" in fits:
        label = "to the pilot: routes planned under the fit"
        _draw(left, places - 0.14, 100 * _ends(fits, "pilot_regret"), 100 * LEAST_REGRET, PILOT_COLOUR, label)
    left.plot([], [], "|", color=CITY_COLOUR, markersize=8, label="held-out routes of one city")
    left.set(xlabel=f"regret (%; no less than {100 * LEAST_REGRET:g} is shown)")
    legend_below(figure, left)
    for panel in (near, left):
        least, most = panel.dataLim.intervalx  # all may be the same
        margin = max(1.6, (LEAST_SPAN / (most / least)) ** 0.5)
        panel.set_xlim(least / margin, most * margin)
        panel.set_xscale("log")
        show_plain_log(panel.xaxis)
        dress(panel, has_grid=False)
        panel.grid(axis="x", color=FAINT_INK, linewidth=0.3, alpha=0.5)
    return figure


def _ends(fits: pd.DataFrame, name: str) -> pd.DataFrame:
    return fits[[name, f"{name}_low", f"{name}_high"]].set_axis(["mean", "low", "high"], axis=1)


def _draw(panel: Axes, places: np.ndarray, shown: pd.DataFrame, least: float, colour: str, label: str) -> None:
    """Draw means with their intervals, none below the least that is shown."""
    shown = shown.clip(lower=least)
    panel.hlines(places, shown["low"], shown["high"], color=colour, alpha=0.35, linewidth=4)
    panel.plot(shown["mean"], places, "o", color=colour, markersize=4.5, label=label or None)
