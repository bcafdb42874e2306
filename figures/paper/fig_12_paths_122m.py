"""Figure 12 of the paper: example paths 122 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import NUM_SAMPLES, draw_paths
from jaxurban.paths.path import PlannedPath

PAPER = (
    "(a) From New Jersey over the Hudson into Midtown, far: only astar-dist and the BIT* variants end. (b) A short "
    "flight into Midtown: astar-plus ends too, and flies safer. (c) Far: the two BIT* paths differ, bitstar-plus "
    "having had fewer batches."
)


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
    draw_paths(12, 122.0, caption)
