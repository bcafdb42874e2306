"""Figure 6 of the paper: GPS metric maps at 20, 60 and 122 m, 2 m cells."""

from figures.paper.common import (
    ALTITUDES_M,
    MAP_M,
    TOWNS,
    Caption,
    Town,
    by_altitude,
    free_means,
    in_strata,
    listed,
    save,
    shares,
)
from jaxurban.metrics.gps import GpsParams
from jaxurban.plotting import plot_metric
from jaxurban.studies.complementarity import GOOD

PAPER = (
    "Maps without a number. Accuracy is highest over the river, over Central Park and over low houses, and low among "
    "tall buildings at 20 m; at 60 m only the Financial District and Midtown stay poor; at 122 m it is near perfect."
)


def caption(town: Town) -> Caption:
    maps = town.maps(MAP_M)
    best = float(maps.m("gps", ALTITUDES_M[-1]).max())
    poor = shares(maps, ALTITUDES_M, lambda z: maps.m("gps", z) < GOOD)
    worst = GpsParams().gdop_threshold
    gdop = worst - (worst - 1) * best
    return Caption(
        PAPER,
        f"The same order in {town.title}. Mean over free cells: {by_altitude(free_means(maps, 'gps', ALTITUDES_M))}. "
        f"Poor (below {GOOD:g}): {by_altitude(poor, '.1%')}. By surroundings at 20 m (open: hardly a roof within 125 "
        f"m; wide-open: none within 250 m, mostly river): {listed(in_strata(maps, 'gps', 20.0))}. No cell is above "
        f"{best:.2f}.",
        "The paper gives no date, no mask angle and no scale. Here satellites count from 5 degrees up, on "
        f"{maps.times[0][:10]} at {maps.times[0][11:16]} UTC ({orbits(town)}); their best geometry under an open sky "
        f"is a GDOP of {gdop:.1f}, and m is 1 only at a GDOP of 1, which no real sky reaches."
        + (
            " The city is made up, with Manhattan's plan and heights."
            if town.name == "embedded"
            else " The box is Manhattan's southern end only: no Midtown, no Central Park."
        ),
    )


def orbits(town: Town) -> str:
    """Return which satellites were seen, in words."""
    return "a nominal constellation" if "orbits" not in town.scenario["gps"] else "element sets of that day"


def main() -> None:
    for town in TOWNS:
        save(plot_metric(town.maps(MAP_M), "gps", altitudes_m=town.drawn_m), f"fig_06_gps_{town.name}", caption(town))
