"""Figure 13 of the paper: example paths 600 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import Case, make
from jaxurban.planned import PlannedPath

PAPER = (
    "Only distance and people cost anything. (a) Short: all do well. (b) Along the Hudson distance alone counts and "
    "ptp is the best planner. (c) Into Manhattan bitstar-plus is the better choice, over fewer people."
)
CASES = {
    "embedded": [
        Case("a short way Uptown", (0.55, 0.62), (0.68, 0.7)),
        Case("along the wide river", (0.06, 0.33), (0.6, 0.97)),
        Case("from the river into the city", (0.08, 0.36), (0.62, 0.42)),
    ],
    "manhattan": [
        Case("a short way downtown", (0.25, 0.25), (0.45, 0.4)),
        Case("along the East River", (0.4, 0.06), (0.97, 0.34)),
        Case("from the Hudson to the East Village", (0.05, 0.55), (0.95, 0.8)),
    ],
}


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    c = paths[2]
    return Caption(
        PAPER,
        f"{found} Mean m_pop under the path on (c): ptp {c['ptp'].metrics['population']:.3f}, bitstar-plus "
        f"{c['bitstar-plus'].metrics['population']:.3f}, at "
        f"{100 * (c['bitstar-plus'].length_m / c['ptp'].length_m - 1):+.1f} % length.",
        "At this height GPS and lidar cost the same everywhere and nothing blocks. A* pays for its eight directions; "
        "the straight line is hard to beat, because m_pop is relative to the densest block of the region, so that "
        "most people weigh little.",
    )


def main() -> None:
    make(13, 600.0, CASES, caption)
