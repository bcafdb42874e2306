"""Draw figures/any_angle.png: the grid path, Theta*'s and the refined one, at two media and over the synthetic city.

``python figures/any_angle.py`` needs no data.
"""

from pathlib import Path as File

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize as Linear
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke
from scipy.optimize import minimize_scalar

import jaxurban as ju
from jaxurban.draw.frame import BLOCKED_COLOUR, mark_ends
from jaxurban.draw.style import (
    FAINT_INK,
    INK,
    SMALL_PT,
    Colours,
    add_colour_bar,
    chart,
    legend_below,
    letter_all,
    styled,
)
from jaxurban.draw.write import Look, write_picture
from jaxurban.planners.any_angle import theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.refine import refine

ALTITUDE_M, RESOLUTION_M = 20.0, 5.0
PART_M = np.array(
    [137.5, 110.0]
)  # half the sides of what is drawn larger, as wide by its height as the city
EDGE = [Stroke(linewidth=3.6, foreground=INK), Normal()]
STYLES: dict[str, Look] = {  # each at its place, later ones thinner or dashed over earlier ones
    "A* on the grid": {"color": "#0b3c8c", "linewidth": 1.4},
    "Theta*": {"color": "#ffb000", "linewidth": 3.0, "path_effects": EDGE},
    "Theta*, refined": {"color": "#c51b8a", "linewidth": 1.6},
    "Snell's law": {"color": INK, "linewidth": 0.9, "linestyle": (0, (3, 3))},
}
COLOURS = Colours(
    "Greys",
    Linear(0, 2.5),
    f"map cost per {RESOLUTION_M:g} m",
    extend="max",
    ticks=(0, 0.5, 1, 1.5, 2, 2.5),
)


def two_media() -> tuple[Problem, np.ndarray]:
    """Return a map of two media and the analytic optimum ``[3, 2]``, bent by Snell's law."""
    layers = np.zeros((1, 40, 40))
    layers[:, 20:] = 1.0
    problem = Problem(layers, np.ones((40, 40), bool), (4, 3), (36, 36), RESOLUTION_M, 0.2, "line")
    start, goal = np.array([17.5, 22.5]), np.array([182.5, 182.5])

    def cost(x_m: float) -> float:
        return 0.2 * np.hypot(x_m - start[0], 100 - start[1]) + 0.4 * np.hypot(
            goal[0] - x_m, goal[1] - 100
        )

    x_m = minimize_scalar(cost, bounds=(start[0], goal[0]), method="bounded").x
    return problem, np.array([start, [x_m, 100.0], goal])


def city() -> Problem:
    """Return a query across the synthetic city with the default weights."""
    maps = ju.build_maps(
        ju.demo_city(1500, 1200), resolution_m=RESOLUTION_M, altitudes_m=(ALTITUDE_M,)
    )
    weights, is_free = ju.Weights(), maps.is_free(ALTITUDE_M)
    layers = np.stack(
        [weights[name] * np.asarray(c, float) for name, c in maps.costs(ALTITUDE_M).items()]
    )
    free = np.argwhere(is_free)
    start, goal = (
        tuple(int(v) for v in free[np.hypot(*(free - np.array(at) * is_free.shape).T).argmin()])
        for at in ((0.1, 0.08), (0.85, 0.93))
    )
    return Problem(layers, is_free, start, goal, RESOLUTION_M, weights.distance, "line")


def paths_of(problem: Problem) -> dict[str, Path]:
    """Return the three paths by label."""
    angled = theta_star(problem)
    return dict(zip(STYLES, (astar(problem), angled, refine(problem, angled)), strict=False))


def draw(panel: Axes, problem: Problem, lines: dict[str, np.ndarray]) -> None:
    """Draw the cost map, darker where a path pays more, and lines."""
    rows, cols = problem.is_free.shape
    shown = np.ma.masked_where(~problem.is_free, problem.cost)
    cmap = colormaps[COLOURS.cmap].with_extremes(bad=BLOCKED_COLOUR)
    extent = (0, cols * RESOLUTION_M, 0, rows * RESOLUTION_M)
    panel.imshow(
        shown, origin="lower", extent=extent, cmap=cmap, norm=COLOURS.norm, interpolation="nearest"
    )
    for name, line in lines.items():
        panel.plot(*line.T, label=name, **STYLES[name])
    panel.set(xlabel="east (m)", aspect="equal")
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)


@styled
def picture() -> Figure:
    """Return the figure."""
    figure = chart(2.6, "A path on the grid, that of Theta*, and that path refined")
    left, middle, right = axes = figure.subplots(1, 3, width_ratios=(1, 1.25, 1.25))
    problem, bent_m = two_media()
    paths = paths_of(problem)
    costs = {name: path.cost for name, path in paths.items()}
    costs["Snell's law"] = np.hypot(*np.diff(bent_m, axis=0).T) @ (0.2, 0.4)
    draw(
        left,
        problem,
        {name: path.points_m for name, path in paths.items()} | {"Snell's law": bent_m},
    )
    left.set_title("two media")
    for height_m, cost in ((8.0, 0), (183.0, 1)):
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        left.text(
            8 if cost else 192,
            height_m,
            f"{cost} per {RESOLUTION_M:g} m",
            ha="left" if cost else "right",
            size=SMALL_PT,
            bbox=box,
        )
    shown = [costs]
    problem = city()
    paths = paths_of(problem)
    lines = {name: path.points_m for name, path in paths.items()}
    shown.append({name: path.cost for name, path in paths.items()})
    draw(middle, problem, lines)
    middle.set_title(f"synthetic city, {ALTITUDE_M:g} m up")
    draw(right, problem, lines)
    x_m, y_m = lines["A* on the grid"][len(lines["A* on the grid"]) // 2]
    corner_m = np.array([x_m, y_m]) - PART_M
    look = {"fill": False, "edgecolor": INK, "linewidth": 1.0}
    middle.add_patch(Rectangle(tuple(corner_m), *(2 * PART_M), **look))
    right.set(
        xlim=(x_m - PART_M[0], x_m + PART_M[0]),
        ylim=(y_m - PART_M[1], y_m + PART_M[1]),
        title="the box in (b)",
    )
    for line in left.get_lines()[: len(STYLES)]:  # in the legend, with their costs
        name = str(line.get_label())
        sums = [
            f"{by_name[name]:.2f} in ({place})"
            for place, by_name in zip("ab", shown, strict=True)
            if name in by_name
        ]
        line.set_label(f"{name}: cost {', '.join(sums)}")
    left.set_ylabel("north (m)")
    for panel in (left, middle):
        ends = panel.get_lines()[0].get_xydata()
        mark_ends(panel, ends[0], ends[-1])
    letter_all(axes)
    add_colour_bar(figure, axes, COLOURS)
    legend_below(figure, left)
    return figure


def main() -> None:
    """Draw the figure beside this script."""
    write_picture(picture(), File(__file__).with_suffix(".png"))


if __name__ == "__main__":
    main()
