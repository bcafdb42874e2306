"""Draw figures/any_angle.png: the grid path, Theta*'s and the refined one, at two media and over the synthetic city.

``python figures/any_angle.py`` needs no data.
"""

from pathlib import Path as File

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from scipy.optimize import minimize_scalar

import jaxurban as ju
from jaxurban.planners.any_angle import refine, theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path, Problem

ALTITUDE_M, RESOLUTION_M = 20.0, 5.0
STYLES = {"A* on the grid": ("tab:red", 1.2), "Theta*": ("tab:orange", 1.4), "Theta*, refined": ("black", 1.6)}


def two_media() -> tuple[Problem, np.ndarray]:
    """Return a map of two media and the analytic optimum ``[3, 2]``, bent by Snell's law."""
    layers = np.zeros((1, 40, 40))
    layers[:, 20:] = 1.0
    problem = Problem(layers, np.ones((40, 40), bool), (4, 3), (36, 36), RESOLUTION_M, 0.2, "line")
    start, goal = np.array([17.5, 22.5]), np.array([182.5, 182.5])

    def cost(x_m: float) -> float:
        return 0.2 * np.hypot(x_m - start[0], 100 - start[1]) + 0.4 * np.hypot(goal[0] - x_m, goal[1] - 100)

    x_m = minimize_scalar(cost, bounds=(start[0], goal[0]), method="bounded").x
    return problem, np.array([start, [x_m, 100.0], goal])


def city() -> Problem:
    """Return a query across the synthetic city with the default weights."""
    maps = ju.build_maps(ju.demo_city(1500, 1200), resolution_m=RESOLUTION_M, altitudes_m=(ALTITUDE_M,))
    weights, is_free = ju.Weights(), maps.is_free(ALTITUDE_M)
    layers = np.stack([weights[name] * np.asarray(c, float) for name, c in maps.costs(ALTITUDE_M).items()])
    free = np.argwhere(is_free)
    start, goal = (
        tuple(int(v) for v in free[np.hypot(*(free - np.array(at) * is_free.shape).T).argmin()])
        for at in ((0.1, 0.08), (0.85, 0.93))
    )
    return Problem(layers, is_free, start, goal, RESOLUTION_M, weights.distance, "line")


def paths_of(problem: Problem) -> dict[str, Path]:
    """Return the three paths by label."""
    angled = theta_star(problem)
    return dict(zip(STYLES, (astar(problem), angled, refine(problem, angled)), strict=True))


def draw(axes: Axes, problem: Problem, paths: dict[str, Path], has_points: bool = False) -> None:
    """Draw the cost map and the paths."""
    extent = [0, problem.is_free.shape[1] * RESOLUTION_M, 0, problem.is_free.shape[0] * RESOLUTION_M]
    shown = np.where(problem.is_free, problem.cost, np.nan)
    image = axes.imshow(shown, origin="lower", extent=extent, cmap="Blues", vmin=0, interpolation="nearest")
    image.cmap.set_bad("0.35")
    plt.colorbar(image, ax=axes, label="map cost per 5 m", shrink=0.75)
    for label, path in paths.items():
        colour, width = STYLES[label]
        style = {"marker": ".", "markersize": 4} if has_points else {}
        axes.plot(*path.points_m.T, color=colour, lw=width, label=f"{label}: {path.cost:.2f}", **style)
    axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")


def main() -> None:
    """Draw the figure beside this script."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(17, 4.7), layout="constrained")
    problem, bent_m = two_media()
    paths = paths_of(problem)
    draw(left, problem, paths)
    best = np.hypot(*np.diff(bent_m, axis=0).T) @ (0.2, 0.4)
    left.plot(*bent_m.T, color="lime", lw=1.2, ls="--", label=f"Snell's law: {best:.2f}")
    left.set_title("Two media: cost of each path")
    left.legend(loc="upper left", fontsize=8)
    problem = city()
    paths = paths_of(problem)
    draw(middle, problem, paths)
    middle.set_title(f"Synthetic city, {ALTITUDE_M:g} m, default weights, line model")
    middle.legend(loc="lower right", fontsize=8)  # where no path runs
    draw(right, problem, paths, has_points=True)
    x_m, y_m = paths["A* on the grid"].points_m[len(paths["A* on the grid"].points_m) // 2]
    right.set(xlim=(x_m - 110, x_m + 110), ylim=(y_m - 110, y_m + 110), title="A part of it, with waypoints")
    figure.savefig(File(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
