"""Figure 7 of the paper: lidar metric maps at 20, 60 and 122 m, 2 m cells."""

import math

from figures.paper.common import GOOD, Caption, Town, draw_metric, in_strata, means, shares
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.lidar import Lidar

PAPER = (
    "Maps without a number. Lidar is best low down: at 20 m in the dense high-rise quarters, weak over low and "
    "residential ones; at 60 m it drops, and of the strong areas only Midtown remains; poor GPS and good lidar lie in "
    "the same places."
)
HOUSE_M = 8.0  # a house of two floors


def caption(town: Town, maps: MetricMaps) -> Caption:
    lidar = Lidar()
    low_deg = lidar.field_of_view_deg[0]
    good = shares(maps, lambda z: maps.m("lidar", z) >= GOOD)
    return Caption(
        PAPER,
        f"The drop is there in {town.title}. Mean over free cells: "
        f"{means(maps, 'lidar')}; good ({GOOD:g} and above): "
        f"{good}. By surroundings at 20 m: {in_strata(maps, 'lidar', 20.0)}; at 60 m: "
        f"{in_strata(maps, 'lidar', 60.0)}.",
        f"The paper gives neither beams, nor angles, nor range. Here the lowest of {lidar.beams} beams falls by "
        f"{-low_deg:g} degrees and reaches {lidar.range_m:g} m: from 20 m up it meets a house of {HOUSE_M:g} m that "
        f"stands {(20 - HOUSE_M) / math.tan(math.radians(-low_deg)):.0f} m away or farther, so low quarters are "
        "weaker, not blind. A fan that looked level only would deepen the paper's contrast. The rings around towers at "
        "122 m are single beams: each falls by an angle of its own, and reaches a roof below at one distance.",
    )


def main() -> None:
    draw_metric(7, "lidar", caption)
