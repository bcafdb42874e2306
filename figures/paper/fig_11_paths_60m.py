"""Figure 11 of the paper: example paths 60 m above ground, 5 m cells."""

from collections.abc import Sequence

import numpy as np

from figures.paper.common import Caption
from figures.paper.example_paths import NUM_SAMPLES, draw_paths
from jaxurban.paths.path import PlannedPath

PAPER = (
    "(a) Across Midtown: the planners go around the towers, bitstar-dist by shortcuts, bitstar-plus over fewer "
    "people. (b) Over the Hudson: bitstar and ptp fly straight, 5625 m for ptp against 6092 m for astar-dist. (c) "
    "Much the same."
)


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    b = paths[1]
    theirs, most = 6092 / 5625 - 1, np.sqrt(4 - 2 * np.sqrt(2)) - 1
    return Caption(
        PAPER,
        f"{found} On (b) ptp flies {b['ptp'].length_m:,.0f} m, astar-dist {b['astar-dist'].length_m:,.0f} m "
        f"(+{100 * (b['astar-dist'].length_m / b['ptp'].length_m - 1):.1f} %)."
        if b["ptp"].status.has_path
        else found,
        f"6092 over 5625 m is +{100 * theirs:.2f} %, a little above the {100 * most:.2f} % that eight directions can "
        "add at most, so the paper's path bent for something else as well. How much they add depends on the "
        f"direction of flight. BIT* has {NUM_SAMPLES:,} samples a query here, three minutes in the paper.",
    )


def main() -> None:
    draw_paths(11, 60.0, caption)
