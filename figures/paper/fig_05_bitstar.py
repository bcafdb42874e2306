"""Figure 5 of the paper: how BIT* works, four moments of a real search on the synthetic city."""

from collections.abc import Sequence
from copy import copy

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import jaxurban as ju
from figures.paper.common import Caption, save
from jaxurban.draw.frame import (
    DrawnMap,
    MapPanel,
    draw_maps,
    flat_layer,
    frame_note,
    rules_said,
)
from jaxurban.draw.metrics import precise_percent
from jaxurban.draw.style import FAINT_INK, INK, Colours
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.planners.bitstar.bounds import make_bounds
from jaxurban.planners.bitstar.planner import Batches, BitStarOptions, bitstar_plus
from jaxurban.planners.bitstar.tree import Tree

ALTITUDE_M, RESOLUTION_M = 20.0, 5.0
ENDS = ((0.25, 0.20), (0.80, 0.70))  # start and goal as shares of the map, north and east
SEED, BATCH_SAMPLES, NUM_BATCHES = 1, 50, 10
# A metre costs as much as 5 m of the worst metric: with the usual tenth no cell can be left out (see the caption).
WEIGHTS = ju.Weights(distance=1.0)
OBSTACLE, TREE, SAMPLE, NEW, SET = "#8a8a8a", "#2b5c8a", "#6f6f6f", "#d95f02", "#1b7837"

PAPER = (
    "Four steps, adapted from Gammell et al. (2015): the search spreads out from the best solution; a solution ends "
    "the batch and leaves a smaller space; new samples fall into that space; the process repeats. The captions name no "
    "map and no number, and the picture itself is not part of the source that we have."
)


def query(maps: ju.MetricMaps, weights: ju.Weights) -> Problem:
    """Return the query of the figure, between the free cells nearest to `ENDS`."""
    problem = ju.cost_map(maps, ALTITUDE_M, weights=weights).problem
    free = np.argwhere(problem.is_free)
    start, goal = (
        tuple(
            int(v)
            for v in free[np.hypot(*(free - np.array(at) * problem.is_free.shape).T).argmin()]
        )
        for at in ENDS
    )
    return problem.between(start, goal)


def run(problem: Problem) -> list[Batches]:
    """Return a search that repeats exactly as it was after each batch."""
    batches: list[Batches] = []
    limits = {"growth": 0, "max_batches": NUM_BATCHES}
    options = BitStarOptions(
        BATCH_SAMPLES, **limits, on_batch=lambda now: batches.append(copy(now))
    )
    bitstar_plus(problem, seed=SEED, budget_s=np.inf, options=options)
    return batches


def bound_map(problem: Problem, heuristic: str = "plus") -> np.ndarray:
    """Return ``[Y, X]`` what a path through each cell costs at least."""
    bounds = make_bounds(heuristic, problem, problem.is_free)
    return bounds.through_cells(np.arange(problem.is_free.size)).reshape(problem.is_free.shape)


def share_left(problem: Problem, cost: float, heuristic: str = "plus") -> float:
    """Return the share of free cells through which a cheaper path may lead."""
    return float((bound_map(problem, heuristic)[problem.is_free] < cost).mean())


class Picture:
    """Draws moments of a search in the maps' frame."""

    def __init__(self, maps: ju.MetricMaps, problem: Problem) -> None:
        self.maps, self.problem = maps, problem
        self.corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])

    def at_m(self, xy: np.ndarray) -> np.ndarray:
        """Return points in cell sides as easting, northing."""
        return xy * RESOLUTION_M + self.corner_m

    def ground(self) -> list[DrawnMap]:
        """Return the map cost, faintly, and the obstacles."""
        problem = self.problem
        shown = np.where(problem.is_free, problem.cost, np.nan)
        norm = Normalize(0, 2.2 * np.nanmax(shown))
        return [DrawnMap(shown, Colours("Greys", norm)), flat_layer(~problem.is_free, OBSTACLE)]

    def space(self, panel: Axes, cost: float) -> None:
        """Draw the edge of the space that can still hold a cheaper path, and grey out the rest."""
        for heuristic, style in (("plus", "-"), ("euclidean", "--")):
            bound = bound_map(self.problem, heuristic)
            x_m, y_m = self.maps.grid.x_m, self.maps.grid.y_m
            panel.contour(
                x_m,
                y_m,
                bound,
                levels=[cost],
                colors=SET,
                linestyles=style,
                linewidths=1.6,
                zorder=5,
            )
            if heuristic == "plus":
                panel.contourf(
                    x_m, y_m, bound, levels=[cost, np.inf], colors="white", alpha=0.62, zorder=2
                )

    def tree(self, panel: Axes, tree: Tree, samples: bool = True) -> None:
        """Draw the tree's edges and the samples, joined (dots) or not (small rings)."""
        xy_m, is_child = self.at_m(tree.xy), tree.parent >= 0
        edges = np.stack([xy_m[is_child], xy_m[tree.parent[is_child]]], axis=1)
        panel.add_collection(LineCollection(edges, colors=TREE, linewidths=0.9, zorder=6))
        is_joined = np.isfinite(tree.g)
        panel.plot(*xy_m[is_joined].T, ".", color=TREE, markersize=3.5, zorder=7)
        if samples:
            panel.plot(
                *xy_m[~is_joined].T, "o", mfc="none", mec=SAMPLE, mew=0.7, markersize=3, zorder=6
            )

    def path(self, panel: Axes, batch: Batches) -> None:
        """Draw the batch's best path."""
        xy_m = self.at_m(batch.tree.xy[batch.tree.path()])
        panel.plot(*xy_m.T, color="white", linewidth=4.4, solid_joinstyle="round", zorder=8)
        panel.plot(*xy_m.T, color=INK, linewidth=2.4, solid_joinstyle="round", zorder=9)

    def ends(self, panel: Axes, batch: Batches) -> None:
        """Mark start and goal."""
        look = {
            "linestyle": "none",
            "markeredgecolor": "black",
            "markerfacecolor": "white",
            "zorder": 20,
        }
        start_m, goal_m = self.at_m(batch.tree.xy[batch.tree.path()[[0, -1]]])
        panel.plot(*start_m, marker="o", markersize=7, **look)
        panel.plot(*goal_m, marker="*", markersize=13, **look)


def num_edges(tree: Tree) -> int:
    """Return the edges of a tree."""
    return int((tree.parent >= 0).sum())


def panel_titles(problem: Problem, batches: Sequence[Batches], kept: Tree) -> list[str]:
    """Return what each panel shows, with its numbers."""
    first, second, last, number = batches[1], batches[2], batches[-1], len(batches) - 1
    drawn, num_dropped = (
        sum(len(batch.samples) for batch in batches),
        len(first.tree.xy) - len(kept.xy),
    )
    left = precise_percent(share_left(problem, first.cost))
    return [
        f"batch 1: {len(first.samples)} samples, {num_edges(first.tree)} tree edges, cost {first.cost:,.0f}",
        f"smaller space: {left} of free cells, {num_dropped} samples dropped",
        f"batch 2: {len(second.samples)} new samples, {num_edges(kept)} tree edges kept",
        f"batch {number}: {drawn} samples drawn, {num_edges(last.tree)} tree edges, cost {last.cost:,.0f}",
    ]


def legend() -> list[Artist]:
    """Return the legend's entries."""
    dot = {"linestyle": "none", "marker": "o"}
    handles = {
        "obstacle": Patch(facecolor=OBSTACLE),
        "free, darker where\nit costs more": Patch(
            facecolor="#dddddd", edgecolor=FAINT_INK, linewidth=0.4
        ),
        "sample, not joined": Line2D([], [], mfc="none", mec=SAMPLE, mew=0.7, markersize=4, **dot),
        "node of the tree": Line2D([], [], color=TREE, markersize=3, **dot),
        "edge of the tree": Line2D([], [], color=TREE, linewidth=1.2),
        "sample dropped": Line2D(
            [], [], color=SAMPLE, linestyle="none", marker="x", markersize=4, mew=0.8
        ),
        "new sample": Line2D([], [], mfc=NEW, mec=INK, mew=0.4, markersize=5, **dot),
        "best path": Line2D([], [], color=INK, linewidth=2.4),
        "edge of the space\nthat can hold a\ncheaper path": Line2D(
            [], [], color=SET, linewidth=1.6
        ),
        "the same by\ndistance alone\n(an ellipse)": Line2D(
            [], [], color=SET, linewidth=1.6, linestyle="--"
        ),
        "start": Line2D([], [], mfc="white", mec="black", markersize=6, **dot),
        "goal": Line2D(
            [], [], linestyle="none", marker="*", mfc="white", mec="black", markersize=10
        ),
    }
    for name, handle in handles.items():
        handle.set_label(name)
    return list(handles.values())


def caption(maps: ju.MetricMaps, problem: Problem, batches: Sequence[Batches]) -> Caption:
    last, cost = batches[-1], [batch.cost for batch in batches[1:]]
    on_grid, usual = astar(problem), query(maps, ju.Weights())
    usual_cost = run(usual)[-1].cost
    sides = [
        precise_percent(share_left(problem, last.cost, heuristic))
        for heuristic in ("plus", "euclidean")
    ]
    return Caption(
        PAPER,
        f"A real run of ours, which repeats exactly (seed {SEED}). The cost falls from {cost[0]:,.0f} to "
        f"{cost[-1]:,.0f} in {len(cost)} batches; the cheapest path on the grid of {RESOLUTION_M:g} m cells costs "
        f"{on_grid.cost:,.0f}, for it turns by 45 degrees only. In the end {sides[0]} of the free cells can still hold "
        f"a cheaper path; by distance alone it would be {sides[1]}.",
        "Ours leaves out what distance and the cheapest map costs on the way rule out (solid line), not distance alone "
        f"(dashed). A metre weighs {WEIGHTS.distance:g} here: with our usual {ju.Weights().distance:g} the maps rule "
        f"the cost, and {precise_percent(share_left(usual, usual_cost))} of the free cells are left after "
        f"{NUM_BATCHES} batches. A batch of ours does not end with its first solution, but when no edge left can "
        "improve it.",
    )


def main() -> None:
    maps = ju.build_maps(
        ju.demo_city(1500, 1200), resolution_m=RESOLUTION_M, altitudes_m=(ALTITUDE_M,)
    )
    problem = query(maps, WEIGHTS)
    batches = run(problem)
    first, second, last = batches[1], batches[2], batches[-1]
    kept = first.tree.pruned()
    picture = Picture(maps, problem)
    rules = rules_said(ju.cost_map(maps, ALTITUDE_M, weights=WEIGHTS).record)
    note = f"{frame_note(maps)}\n{ALTITUDE_M:g} m above ground  ·  {rules}"
    panels = [MapPanel(title, picture.ground()) for title in panel_titles(problem, batches, kept)]
    figure, axes = draw_maps(
        maps.grid, panels, "BIT*: a search in batches of samples", note, legend=legend()
    )
    for panel in axes:
        picture.ends(panel, last)
    growing, solved, resampled, later = axes
    picture.tree(growing, first.tree)
    picture.space(solved, first.cost)
    picture.tree(solved, kept)
    gone = first.tree.xy[~(first.tree.xy[:, None] == kept.xy).all(axis=2).any(axis=1)]
    solved.plot(*picture.at_m(gone).T, "x", color=SAMPLE, markersize=4, mew=0.8, zorder=6)
    picture.path(solved, first)
    picture.space(resampled, first.cost)
    picture.tree(resampled, kept)
    resampled.plot(
        *picture.at_m(second.samples).T, "o", mfc=NEW, mec=INK, mew=0.4, markersize=5, zorder=10
    )
    picture.space(later, last.cost)
    picture.tree(later, last.tree, samples=False)
    picture.path(later, last)
    save(figure, "fig_05_bitstar", caption(maps, problem, batches))
