"""Draws why the paper's h_plus is not admissible: on nine cells it counts a wall that the best path goes around.

``python figures/heuristic_counterexample.py`` writes heuristic_counterexample.png beside it.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from jaxurban.draw.style import chart, styled
from jaxurban.draw.write import write_picture
from jaxurban.planners.astar import astar, heuristic_at, make_heuristic
from jaxurban.planners.base import Problem

WIDTH_MM = 162.0
COST = np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0]])  # row 0 in the south
START, CULPRIT, GOAL = (0, 0), (1, 0), (0, 2)
BEST, PRINTED = "#0b3c8c", "#b3400a"  # told apart by readers with any colour vision, and in grey


def counterexample() -> dict[str, object]:
    """Return both paths, their costs, and what the culprit node's value is and should be."""
    problem = Problem(
        COST[None],
        np.ones(COST.shape, bool),
        START,
        GOAL,
        resolution_m=1.0,
        weights=1.0,
        cost_model="cell",
    )
    best, printed = astar(problem), astar(problem, heuristic="plus-printed", reopen=True)
    return {
        "best": best,
        "printed": printed,
        "h_printed": heuristic_at(make_heuristic("plus-printed", problem), CULPRIT, GOAL),
        "cost_to_go": astar(problem.between(CULPRIT, GOAL)).cost,
        "g": astar(problem.between(START, CULPRIT)).cost,
    }


@styled
def draw(found: dict) -> Figure:
    """Return the figure."""
    heading = "The printed heuristic counts a wall that the best path goes around"
    figure = chart(3.1, heading, width=WIDTH_MM)
    axes = figure.add_subplot()
    for (row, col), cost in np.ndenumerate(COST):
        axes.add_patch(
            Rectangle((col, row), 1, 1, facecolor=str(1 - 0.07 * cost), edgecolor="0.55")
        )
        axes.text(
            col + (0.15, 0.15, 0.85)[col],
            row + 0.9,
            f"{cost:g}",
            ha="center",
            va="top",
            fontsize=11,
            color="0.15",
        )
    box = Rectangle(
        (0.04, 0.04), 2.92, 1.92, fill=False, linestyle=(0, (4, 3)), linewidth=1.8, edgecolor="0.2"
    )
    axes.add_patch(box)
    for path, colour, shift in ((found["best"], BEST, 0.06), (found["printed"], PRINTED, -0.06)):
        axes.plot(
            path.points_m[:, 0],
            path.points_m[:, 1] + shift,
            "-o",
            color=colour,
            linewidth=3,
            markersize=5,
        )
    row, col = CULPRIT
    axes.plot(
        col + 0.5,
        row + 0.56,
        "o",
        markersize=15,
        markerfacecolor="none",
        markeredgecolor="black",
        linewidth=2,
    )
    for (row, col), name in ((START, "start"), (GOAL, "goal")):
        axes.text(col + 0.5, row + 0.14, name, ha="center", fontsize=12, weight="bold")
    axes.text(0.24, 1.54, "n", fontsize=14, style="italic", weight="bold", ha="center", va="center")
    f = found["g"] + found["h_printed"]
    lines = [
        (f"around the wall: cost {found['best'].cost:.2f}", BEST),
        (f"through it: cost {found['printed'].cost:.2f},", PRINTED),
        ("found by A* with the printed $h_\\mathrm{plus}$", PRINTED),
        ("dashed: the box between $n$ and the goal, all", "0.2"),
        ("that $h_\\mathrm{plus}$ sees: a wall right across it", "0.2"),
        (
            f"$f(n) = g + h_\\mathrm{{plus}}$ = {found['g']:.0f} + {found['h_printed']:.2f} = {f:.2f}",
            "black",
        ),
        (f"true cost from $n$ to the goal: {found['cost_to_go']:.2f}", "black"),
        ("number in a cell: cost of entering it", "0.35"),
    ]
    for k, (text, colour) in enumerate(lines):
        axes.text(3.2, 2.8 - 0.37 * k, text, color=colour, fontsize=9.5, va="center")
    axes.set(xlim=(-0.05, 6.3), ylim=(-0.05, 3.05), aspect="equal")
    axes.axis("off")
    return figure


def main() -> None:
    write_picture(draw(counterexample()), Path(__file__).with_suffix(".png"), dpi=200)


if __name__ == "__main__":
    main()
