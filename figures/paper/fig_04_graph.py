"""Figure 4 of the paper: the steps between neighbouring cells, on open ground and past obstacles, and their costs."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from figures.paper.common import PATH_M, TOWNS, Caption, save
from jaxurban.draw.metrics import precise_percent
from jaxurban.draw.style import INK, SMALL_PT, TEXT_PT, chart, inches, wrapped
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.cost import STEPS, CostModel, allowed_moves
from jaxurban.planners.grid_search import graph_of

ALTITUDE_M = 20.0
# v_0 in the middle; v_1 north of it, then clockwise, so that straight neighbours are odd and diagonal ones even.
NODES: tuple[Cell, ...] = ((1, 1), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (2, 0))
OBSTACLES = (2, 5)
STRAIGHT, DIAGONAL, LOST, OTHER = "#1a1a1a", "#0b5fa5", "#c1272d", "#b8b8b8"

PAPER = (
    "The node v0 and its eight neighbours, straight ones odd, diagonal even: (a) all edges, (b) those left when v2 "
    "and v5 are obstacles. A step is 5 m or 7.07 m. Whether a diagonal step may cut the corner of an obstacle is not "
    "said. The picture is not part of the source that we have, so where v1 lies is our choice."
)


class Edge(NamedTuple):
    """An edge of the graph: the cells that it joins, and its cost at one per metre."""

    origin: Cell
    target: Cell
    cost: float

    @property
    def is_diagonal(self) -> bool:
        """Whether the cells touch at a corner only."""
        return self.origin[0] != self.target[0] and self.origin[1] != self.target[1]


def edges_of(problem: Problem) -> list[Edge]:
    """Return all edges that the grid planners see, each way once."""
    step_cost = graph_of(problem).step_cost
    return [
        Edge((row, col), (row + STEPS[k][0], col + STEPS[k][1]), float(step_cost[k]))
        for row, col in np.ndindex(*problem.is_free.shape)
        for k in range(len(STEPS))
        if problem.moves[row, col] >> k & 1
    ]


def query(obstacles: tuple[int, ...], diagonal: str) -> Problem:
    """Return the nine cells, some of them blocked, where only length costs."""
    is_free = np.ones((3, 3), bool)
    for node in obstacles:
        is_free[NODES[node]] = False
    centre = NODES[0]
    return Problem(
        np.zeros((1, 3, 3)), is_free, centre, centre, PATH_M, 1.0, CostModel(diagonal=diagonal)
    )


def draw(panel: Axes, title: str, problem: Problem, lost: set[tuple[Cell, Cell]]) -> None:
    """Draw cells, nodes and edges, with the costs of those from v_0; ``lost`` ones are allowed by (b) but not here."""
    panel.set(xlim=(-0.52, 2.52), ylim=(-0.52, 2.52), aspect="equal")
    panel.set_axis_off()
    panel.set_title(
        wrapped(title, inches("page") / 3, TEXT_PT), size=TEXT_PT, loc="left", color=INK
    )
    for row, col in np.ndindex(3, 3):
        look = {} if problem.is_free[row, col] else {"facecolor": "#7d7d7d", "hatch": "///"}
        panel.add_patch(
            Rectangle(
                (col - 0.5, row - 0.5),
                1,
                1,
                **{"facecolor": "white", "edgecolor": "#d5d5d5", "lw": 0.6} | look,
            )
        )
    for edge in edges_of(problem):
        is_own = NODES[0] in (edge.origin, edge.target)
        colour = (DIAGONAL if edge.is_diagonal else STRAIGHT) if is_own else OTHER
        line = {
            "linewidth": 2.0 if is_own else 0.9,
            "linestyle": (0, (4, 1.5)) if edge.is_diagonal else "-",
        }
        _line(panel, edge.origin, edge.target, color=colour, zorder=3 if is_own else 2, **line)
        if edge.origin == NODES[0]:
            at = 0.5 * (np.array(edge.origin) + edge.target)
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
            panel.text(
                at[1],
                at[0],
                f"{edge.cost:.3g} m",
                ha="center",
                va="center",
                size=6.8,
                zorder=5,
                bbox=box,
                color=colour,
            )
    for origin, target in lost:
        is_own = NODES[0] in (origin, target)
        _line(
            panel,
            origin,
            target,
            color=LOST,
            linewidth=1.6 if is_own else 0.8,
            linestyle=":",
            zorder=3 if is_own else 2,
        )
        if is_own:
            at = 0.5 * (np.array(origin) + target)
            panel.plot(at[1], at[0], "x", color=LOST, markersize=8, mew=2, zorder=5)
    for number, (row, col) in enumerate(NODES):
        is_free = problem.is_free[row, col]
        face = ("#ffe9a8" if number == 0 else "white") if is_free else "#4a4a4a"
        panel.plot(col, row, "o", markersize=19, mfc=face, mec=INK, mew=1.0, zorder=6)
        ink = INK if is_free else "white"
        panel.text(
            col,
            row,
            f"$v_{number}$",
            ha="center",
            va="center_baseline",
            size=TEXT_PT,
            color=ink,
            zorder=7,
        )


def _line(panel: Axes, origin: Cell, target: Cell, **look) -> None:
    panel.plot((origin[1], target[1]), (origin[0], target[0]), **look)


def corner_cuts(is_free: np.ndarray) -> tuple[float, float]:
    """Return the share of a map's diagonal steps that pass an obstacle's corner, and of those between two obstacles."""

    def num_diagonal(moves: np.ndarray) -> int:
        return int(np.bitwise_count(moves >> 4).sum())

    always, both_free = (
        allowed_moves(is_free, 8, needs_both_free) for needs_both_free in (False, True)
    )
    # Two free cells on one diagonal of a square of four, none on the other; each joins both ways.
    south_west, south_east, north_west, north_east = (
        is_free[:-1, :-1],
        is_free[:-1, 1:],
        is_free[1:, :-1],
        is_free[1:, 1:],
    )
    rising = south_west & north_east & ~south_east & ~north_west
    falling = south_east & north_west & ~south_west & ~north_east
    total = num_diagonal(always)
    return 1 - num_diagonal(both_free) / total, 2 * int(rising.sum() + falling.sum()) / total


def caption(own: list[list[Edge]], num_edges: list[int]) -> Caption:
    counts = [len(edges) for edges in own]
    costs = " or ".join(f"{cost:.3g} m" for cost in sorted({edge.cost for edge in own[0]}))
    reached = [
        ", ".join(f"v{NODES.index(edge.target)}" for edge in _ordered(edges)) for edges in own
    ]
    cuts = {town.title: corner_cuts(town.maps(PATH_M).is_free(ALTITUDE_M)) for town in TOWNS}
    shares = " and ".join(
        f"{precise_percent(past)} in {title} ({precise_percent(between)} lead between two obstacles)"
        for title, (past, between) in cuts.items()
    )
    return Caption(
        PAPER,
        f"Drawn from the graph of our planners. From v0 lead (a) {counts[0]} steps of {costs}, (b) {counts[1]}, to "
        f"{reached[1]}, and (c) {counts[2]}, to {reached[2]}. Among all nine nodes there are {num_edges[0]}, "
        f"{num_edges[1]} and {num_edges[2]} edges.",
        "Our rule (c) allows a diagonal step only where both cells beside it are free: a step past the corner of an "
        "obstacle touches it, and two obstacles that meet at a corner leave no gap. It takes away few: of the diagonal "
        f"steps between free {PATH_M:g} m cells at {ALTITUDE_M:g} m, {shares}. Rule (b) can be chosen instead.",
    )


def _ordered(edges: list[Edge]) -> list[Edge]:
    return sorted(edges, key=lambda edge: NODES.index(edge.target))


def main() -> None:
    problems = [query((), "both-free"), query(OBSTACLES, "always"), query(OBSTACLES, "both-free")]
    titles = [
        "(a) fully connected",
        "(b) partially connected: every free neighbour",
        "(c) our rule: both cells beside must be free",
    ]
    edges = [edges_of(problem) for problem in problems]
    own = [[edge for edge in found if edge.origin == NODES[0]] for found in edges]
    lost = {(edge.origin, edge.target) for edge in edges[1]} - {
        (edge.origin, edge.target) for edge in edges[2]
    }
    note = f"{PATH_M:g} m cells; v2 and v5 blocked in (b) and (c)"
    figure = chart(2.9, f"Steps between neighbouring cells, and their lengths ({note})")
    for number, (panel, title, problem) in enumerate(
        zip(figure.subplots(1, 3), titles, problems, strict=True)
    ):
        draw(panel, title, problem, lost if number == 2 else set())
    handles = {
        "straight step from $v_0$": Line2D([], [], color=STRAIGHT, linewidth=2),
        "diagonal step from $v_0$": Line2D(
            [], [], color=DIAGONAL, linewidth=2, linestyle=(0, (4, 1.5))
        ),
        "step between the others": Line2D([], [], color=OTHER, linewidth=1.2),
        "not allowed by our rule": Line2D(
            [], [], color=LOST, linewidth=1.6, linestyle=":", marker="x", markersize=6, mew=1.6
        ),
        "obstacle": Patch(facecolor="#7d7d7d", hatch="///", edgecolor="#d5d5d5"),
    }
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncol=len(handles),
        fontsize=SMALL_PT,
        frameon=False,
    )
    save(figure, "fig_04_graph", caption(own, [len(found) // 2 for found in edges]))
