"""Figure 10 of the paper: example paths 20 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import NUM_SAMPLES, draw_paths
from jaxurban.paths.path import PlannedPath

PAPER = (
    "(a) A long flight through Manhattan: only astar-dist ends within three minutes. (b) A short one over New Jersey: "
    "all five find a path. (c) A middle one from Queens: three of five do; the BIT* variants go more directly than "
    "A*."
)


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    return Caption(
        PAPER,
        f"{found} The two A* cost the same to the last digit, as two exact searches must.",
        "The paper's astar-plus runs out of three minutes, we suppose for reducing a box of cells at every node; here "
        "its bound, another one, takes one pass over the map, and both A* end. ptp is blocked by a single roof "
        f"above the line, also over low houses. BIT* has {NUM_SAMPLES:,} samples a query, no time limit.",
    )


def main() -> None:
    draw_paths(10, 20.0, caption)
