"""Draw what climbing is worth: over a wall or around it, and across the synthetic city. Writes figures/volume.png.

Above: a wall of 30 m that ends before the edge; a route with cheap climbing goes over it, one with expensive climbing
goes around. Below: the same two choices across the city, with the roofs under each route.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import jaxurban as ju
from jaxurban.draw.style import chart, letter_all, styled
from jaxurban.draw.write import write_picture
from jaxurban.planners.astar import volume_astar
from jaxurban.planners.base import Problem

FILE = Path(__file__).with_suffix(".png")
ROOF, COLOURS, LEVELS_M = "#8a8a8a", "plasma", (10.0, 80.0)
AT = {"A": 0.3, "B": 0.6}  # shares of each path at which its letter stands
SHOWN = np.s_[:160, :180]  # of the synthetic city's rows and columns
CIRCLE = {"boxstyle": "circle,pad=0.2", "facecolor": "white", "linewidth": 0.8}
LETTER = {"size": 9, "weight": "bold", "ha": "center", "va": "center", "bbox": CIRCLE, "zorder": 6}
START_M, GOAL_M = np.array([380.0, 500.0]), np.array([780.0, 500.0])  # in the synthetic city


def wall() -> tuple[np.ndarray, float, dict[str, np.ndarray], np.ndarray]:
    """Return roofs, resolution, a path for each price of climbing, and the levels."""
    roof_m = np.zeros((41, 41))
    roof_m[:29, 20] = 30.0
    levels_m = np.arange(10.0, 51.0, 10.0)
    is_free = roof_m < levels_m[:, None, None]
    paths = {}
    for climb_cost in (1.0, 10.0):
        flat, weights = np.zeros((0, *is_free.shape)), [1.0, climb_cost, 0.0]
        problem = Problem(flat, is_free, (0, 8, 3), (0, 8, 37), 5.0, weights, "cell", levels_m)
        paths[f"a metre of climb costs {climb_cost:g}"] = volume_astar(problem).points_m
    return roof_m, 5.0, paths, levels_m


def city() -> tuple[np.ndarray, float, dict[str, np.ndarray], np.ndarray]:
    """Return the same for the synthetic city."""
    maps = ju.build_maps(
        ju.demo_city(1_200, 1_200), resolution_m=5.0, altitudes_m=(20.0, 40.0, 60.0, 80.0)
    )
    grid, paths = maps.grid, {}
    corner = np.array([grid.x_min_m, grid.y_min_m])
    for climb_cost in (0.1, 2.0):
        levels = ju.Levels(level_step_m=10.0, climb_cost=climb_cost)
        volume = ju.cost_map(maps, levels, weights=ju.Weights(lidar=0.3))
        path = volume.plan(ju.XY(*(corner + START_M)), ju.XY(*(corner + GOAL_M)), snap=True)
        paths[f"a metre of climb costs {climb_cost:g}"] = np.column_stack(
            [path.xy_m - corner, path.z_m]
        )
        print(
            f"climb cost {climb_cost:g}: cost {path.cost:.1f}, {path.length_m:.0f} m, up to {path.z_m.max():g} m"
        )
    return maps.m("roof")[SHOWN], grid.resolution_m, paths, volume.altitudes_m


def draw_plan(panel: Axes, roof_m: np.ndarray, resolution_m: float, paths, norm: Normalize) -> None:
    """Draw the roofs, darker where higher, and the paths coloured by altitude."""
    size_m = resolution_m * np.array(roof_m.shape[::-1])
    shade = np.where(roof_m > 0, roof_m, np.nan)
    panel.imshow(
        shade, origin="lower", extent=(0, size_m[0], 0, size_m[1]), cmap="Greys", vmin=-30, vmax=90
    )
    for letter, points in zip("AB", paths.values(), strict=True):
        pieces = np.stack([points[:-1, :2], points[1:, :2]], axis=1)
        panel.plot(*points[:, :2].T, color="black", linewidth=4.2, solid_capstyle="round")
        middle_m = (points[:-1, 2] + points[1:, 2]) / 2
        panel.add_collection(
            LineCollection(pieces, array=middle_m, cmap=COLOURS, norm=norm, linewidth=2.8, zorder=3)
        )
        panel.text(*points[round(AT[letter] * len(points)), :2], letter, **LETTER)
    ends = next(iter(paths.values()))[[0, -1], :2]
    panel.plot(*ends[0], "o", color="white", markeredgecolor="black", markersize=7, zorder=5)
    panel.plot(*ends[1], "*", color="white", markeredgecolor="black", markersize=13, zorder=5)
    panel.set(
        aspect="equal",
        anchor="N",  # its title is as high as that beside it
        xlim=(0, size_m[0]),
        ylim=(0, size_m[1]),
        xlabel="east (m)",
        ylabel="north (m)",
    )


def draw_profile(
    panel: Axes, roof_m: np.ndarray, resolution_m: float, points: np.ndarray, norm: Normalize
) -> None:
    """Draw the altitudes of a path over the way flown, with the roofs beneath."""
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T)))
    cols, rows = np.floor(points[:, :2] / resolution_m).astype(int).T
    panel.fill_between(along_m, roof_m[rows, cols], step="mid", color=ROOF, linewidth=0)
    pieces = np.stack([points[:-1], points[1:]], axis=1)[:, :, [0, 2]]
    pieces[:, 0, 0], pieces[:, 1, 0] = along_m[:-1], along_m[1:]
    middle_m = (points[:-1, 2] + points[1:, 2]) / 2
    panel.plot(along_m, points[:, 2], color="black", linewidth=3.6)
    panel.add_collection(
        LineCollection(pieces, array=middle_m, cmap=COLOURS, norm=norm, linewidth=2.2, zorder=3)
    )
    climbed_m = np.maximum(np.diff(points[:, 2]), 0).sum()
    length_m = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    title = f"{panel.get_title(loc='left')}\n{length_m:,.0f} m flown, {climbed_m:.0f} m climbed"
    panel.set(title=title, xlabel="flown, seen from above (m)")


@styled
def picture() -> Figure:
    """Return the figure."""
    figure = chart(5.2, "Over or around: what a metre of climb costs decides")
    cities = {"a wall of 30 m": wall(), "the synthetic city": city()}
    axes = figure.subplots(2, 3)
    norm = Normalize(*LEVELS_M)
    for row, (name, (roof_m, resolution_m, paths, levels_m)) in zip(
        axes, cities.items(), strict=True
    ):
        draw_plan(row[0], roof_m, resolution_m, paths, norm)
        row[0].set_title(f"{name}, from above")
        for profile, letter, (label, points) in zip(row[1:], "AB", paths.items(), strict=True):
            profile.set_title(f"{letter}: {label}")
            draw_profile(profile, roof_m, resolution_m, points, norm)
            profile.set(ylim=(0, 1.2 * levels_m[-1]), xlim=(0, None))
            profile.set_yticks(levels_m)
            profile.grid(axis="y", linewidth=0.5)
        row[1].set_ylabel("above ground (m)")
    letter_all(axes.ravel())
    bar = figure.colorbar(ScalarMappable(norm, COLOURS), ax=axes, location="bottom", aspect=50)
    bar.set_label("altitude above ground (m)")
    bar.outline.set(linewidth=0.4)
    return figure


def main() -> None:
    write_picture(picture(), FILE)


if __name__ == "__main__":
    main()
