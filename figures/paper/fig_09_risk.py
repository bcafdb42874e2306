"""Figure 9 of the paper: proximity risk maps at 20, 60 and 122 m, 2 m cells."""

from figures.paper.common import Caption, Town, draw_metric, means, shares
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.risk import Risk
from jaxurban.studies.montecarlo.sampling import STRATA, strata_of

PAPER = (
    'Maps without a number. At 20 m, but for the river, New Jersey and Central Park, "a building can be found '
    "within 10 m "
    'in most grids"; at 60 m large parts of the outer boroughs and of Uptown are free of risk; at 122 m only '
    "Downtown and "
    'Midtown remain, and "the risk is one at the building".'
)
NEAR_M = 10.0


def caption(town: Town, maps: MetricMaps) -> Caption:
    threshold_m = Risk().threshold_m
    is_near = maps.m("risk", 20.0) <= NEAR_M / threshold_m
    is_free = maps.is_free(20.0, "centre")
    strata = strata_of(maps)
    cells = {name: is_free & (strata == number) for number, name in enumerate(STRATA)}
    near = {name: is_near[chosen].mean() for name, chosen in cells.items() if chosen.any()}
    clear = shares(maps, lambda z: maps.m("risk", z) >= 1)
    return Caption(
        PAPER,
        f"Cells {threshold_m:g} m or more from any wall: {clear} of the free ones in "
        f"{town.title}; mean m_risk {means(maps, 'risk')}. A wall within {NEAR_M:g} m "
        "at 20 m: "
        + ", ".join(f"{100 * share:.0f} % of {name}" for name, share in near.items())
        + " cells.",
        "What is drawn is m, which is 0 at a wall and 1 in the clear; the sentence that risk is one at the building "
        f"is about the cost 1 - m. The paper names no threshold (here {threshold_m:g} m) and measures from any "
        "building; here a roof below the drone is no wall (as its obstacle map has it), so houses lower than the "
        "flight do not count.",
    )


def main() -> None:
    draw_metric(9, "risk", caption)
