"""Figure 12 of the paper: example paths 122 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import NUM_SAMPLES, Case, make
from jaxurban.planned import PlannedPath

PAPER = (
    "(a) From New Jersey over the Hudson into Midtown, far: only astar-dist and the BIT* variants end. (b) A short "
    "flight into Midtown: astar-plus ends too, and flies safer. (c) Far: the two BIT* paths differ, bitstar-plus "
    "having had fewer batches."
)
CASES = {
    "embedded": [
        Case("over the wide river into Midtown", (0.1, 0.62), (0.33, 0.32)),
        Case("a short way within Midtown", (0.24, 0.28), (0.38, 0.37)),
        Case("the whole region", (0.9, 0.9), (0.12, 0.1)),
    ],
    "manhattan": [
        Case("over the Hudson to Wall Street", (0.02, 0.85), (0.27, 0.22)),
        Case("a short way downtown", (0.15, 0.45), (0.36, 0.18)),
        Case("the whole region", (0.95, 0.95), (0.08, 0.12)),
    ],
}


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    c = paths[2]
    both = c["bitstar-plus"].status.has_path and c["bitstar-dist"].status.has_path
    return Caption(
        PAPER,
        f"{found} On (c) bitstar-plus is {100 * (c['bitstar-plus'].cost / c['bitstar-dist'].cost - 1):+.2f} % in cost "
        "against bitstar-dist."
        if both
        else found,
        "Here astar-plus ends on all three; the paper blames range and obstacles, we suppose the cost of its "
        f"heuristic. With the same number of samples ({NUM_SAMPLES:,}) bitstar-plus has as many batches as "
        "bitstar-dist; the paper's had fewer, as it had more nodes to search.",
    )


def main() -> None:
    make(12, 122.0, CASES, caption)
