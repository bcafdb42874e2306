"""Figure 10 of the paper: example paths 20 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import NUM_SAMPLES, Case, make
from jaxurban.planned import PlannedPath

PAPER = (
    "(a) A long flight through Manhattan: only astar-dist ends within three minutes. (b) A short one over New Jersey: "
    "all five find a path. (c) A middle one from Queens: three of five do; the BIT* variants go more directly than "
    "A*."
)
CASES = {
    "embedded": [
        Case("Downtown to Uptown", (0.1, 0.07), (0.75, 0.77)),
        Case("low houses in the northwest", (0.12, 0.74), (0.22, 0.87)),
        Case("from the east into Midtown", (0.72, 0.22), (0.42, 0.4)),
    ],
    "manhattan": [
        Case("Battery to the East Village", (0.1, 0.3), (0.92, 0.93)),
        Case("low houses in the northeast", (0.66, 0.7), (0.93, 0.88)),
        Case("from Brooklyn to Chinatown", (0.88, 0.05), (0.52, 0.5)),
    ],
}


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    return Caption(
        PAPER,
        f"{found} The two A* cost the same to the last digit, as two exact searches must.",
        "The paper's astar-plus runs out of three minutes, we suppose for reducing a box of cells at every node; here "
        "its bound, another one, takes one pass over the map, and both A* end. ptp is blocked by a single roof "
        f"above the line, also over low houses. BIT* has {NUM_SAMPLES:,} samples a question, no time limit.",
    )


def main() -> None:
    make(10, 20.0, CASES, caption)
