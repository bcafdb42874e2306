"""Figure 13 of the paper: example paths 600 m above ground, 5 m cells."""

from collections.abc import Sequence

from figures.paper.common import Caption
from figures.paper.example_paths import draw_paths
from jaxurban.paths.path import PlannedPath

PAPER = (
    "Only distance and people cost anything. (a) Short: all do well. (b) Along the Hudson distance alone counts and "
    "ptp is the best planner. (c) Into Manhattan bitstar-plus is the better choice, over fewer people."
)


def caption(paths: Sequence[dict[str, PlannedPath]], found: str) -> Caption:
    c = paths[2]
    return Caption(
        PAPER,
        f"{found} Mean m_pop under the path on (c): ptp {c['ptp'].metrics['population']:.3f}, bitstar-plus "
        f"{c['bitstar-plus'].metrics['population']:.3f}, at "
        f"{100 * (c['bitstar-plus'].length_m / c['ptp'].length_m - 1):+.1f} % length.",
        "At this height GPS and lidar cost the same everywhere and nothing blocks. Eight directions cost A* some "
        "length; the straight line is hard to beat, because m_pop is relative to the densest block of the region, so "
        "that most people weigh little.",
    )


def main() -> None:
    draw_paths(13, 600.0, caption)
