"""Figure 6 of the paper: GPS metric maps at 20, 60 and 122 m, 2 m cells."""

import numpy as np

from figures.paper.common import (
    ALTITUDES_M,
    GOOD,
    MANHATTAN,
    Caption,
    Town,
    draw_metric,
    in_strata,
    means,
    shares,
)
from jaxurban.knowledge import GuessKind
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import Gps

PAPER = (
    "Maps without a number. Accuracy is highest over the river, over Central Park and over low houses, and low among "
    "tall buildings at 20 m; at 60 m only the Financial District and Midtown stay poor; at 122 m it is near perfect."
)


def caption(town: Town, maps: MetricMaps) -> Caption:
    best = float(np.nanmax(maps.m("gps", ALTITUDES_M[-1])))
    poor = shares(maps, lambda z: maps.m("gps", z) < GOOD)
    worst = Gps().gdop_threshold
    gdop = worst - (worst - 1) * best
    is_nominal = any(guess.kind is GuessKind.NOMINAL_SKY for guess in maps.guesses)
    sky = "nominal satellites" if is_nominal else "element sets of that day"
    return Caption(
        PAPER,
        f"The same order in {town.title}. Mean over free cells: {means(maps, 'gps')}. "
        f"Poor (below {GOOD:g}): {poor}. By surroundings at 20 m (open: hardly a roof within 125 "
        f"m; wide-open: none within 250 m): {in_strata(maps, 'gps', 20.0)}. No cell is above "
        f"{best:.2f}.",
        "The paper gives no date, no mask angle and no scale. Here satellites count from 5 degrees up, on "
        f"{maps.times[0][:10]} at {maps.times[0][11:16]} UTC ({sky}); their best geometry under an "
        f"open sky is a GDOP of {gdop:.1f}, and m is 1 only at a GDOP of 1, which no real sky reaches."
        + (
            " The box is Manhattan's southern end only: no Midtown, no Central Park."
            if town is MANHATTAN
            else ""
        ),
    )


def main() -> None:
    draw_metric(6, "gps", caption)
