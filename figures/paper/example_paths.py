"""Example paths: three queries at one altitude, each for the paper's five planners (Figures 10 to 13).

They are planned under the preset ``paper``: its cost model, obstacles and clearance. Panels show the normalised total
cost around the paths, day at 20 and 60 m, night above.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from figures.paper.common import IS_SMALL, PATH_M, TOWNS, Caption, Town, save
from jaxurban.draw.frame import (
    BLOCKED_COLOUR,
    NO_DATA_COLOUR,
    NO_DATA_PATCH,
    DrawnMap,
    MapPanel,
    draw_maps,
    flat_layer,
    joined,
    rules_said,
)
from jaxurban.draw.metrics import obstacle_patches
from jaxurban.draw.paths import cost_layers
from jaxurban.draw.routes import draw_paths as add_paths
from jaxurban.draw.routes import grid_said, named_paths, outcome_line, path_entries, planner_colours
from jaxurban.maps.scenario import PAPER_PLANNERS
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.finish import finish
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY
from jaxurban.paths.plan import cost_map
from jaxurban.paths.search import PathSearch
from jaxurban.planners.registry import SAMPLING_PLANNERS, find_planner
from jaxurban.world.grid import Grid

NAMES = {  # of the paper; its two A* find one path, which is drawn once
    "ptp": "PTP",
    "astar": "A* dist and plus",
    "astar-dist": "A* dist",
    "astar-plus": "A* plus",
    "bitstar-dist": "BIT* dist",
    "bitstar-plus": "BIT* plus",
}
DAY_UP_TO_M = 60.0  # the paper draws day at 20 and 60 m, night above
# Of BIT*: the pictures repeat exactly, as under a budget in seconds they would not.
NUM_SAMPLES = 500 if IS_SMALL else 10_000
MARGIN = 0.12
DIAGONALS = (  # of all captions
    "Under the paper's cost a diagonal step pays for one cell, as a straight one does, so a path on the grid is "
    "cheaper than one of the same course off it."
)
Share = tuple[float, float]  # of the region's width and height, from its southwest corner
# Number of the figure, town, shares of start and goal, and what the query stands for.
CASES = """
10 shinjuku 0.08 0.12 0.92 0.90 from the southwest to the northeast
10 shinjuku 0.30 0.55 0.72 0.72 across the railway to Kabukicho
10 shinjuku 0.62 0.10 0.90 0.42 along the park in the southeast
10 manhattan 0.10 0.30 0.92 0.93 Battery to the East Village
10 manhattan 0.66 0.70 0.93 0.88 low houses in the northeast
10 manhattan 0.88 0.05 0.52 0.50 from Brooklyn to Chinatown
11 shinjuku 0.06 0.40 0.50 0.66 among the towers of the west
11 shinjuku 0.78 0.08 0.20 0.92 across the railway
11 shinjuku 0.55 0.85 0.95 0.80 north of Kabukicho
11 manhattan 0.05 0.30 0.46 0.12 across the Financial District
11 manhattan 0.42 0.10 0.97 0.36 along the East River
11 manhattan 0.08 0.70 0.93 0.80 from the Hudson to the East Village
12 shinjuku 0.05 0.62 0.45 0.30 through the towers
12 shinjuku 0.20 0.45 0.33 0.62 a short way among them
12 shinjuku 0.95 0.95 0.05 0.05 the whole region
12 manhattan 0.02 0.85 0.27 0.22 over the Hudson to Wall Street
12 manhattan 0.15 0.45 0.36 0.18 a short way downtown
12 manhattan 0.95 0.95 0.08 0.12 the whole region
13 manhattan 0.25 0.25 0.45 0.40 a short way downtown
13 manhattan 0.40 0.06 0.97 0.34 along the East River
13 manhattan 0.05 0.55 0.95 0.80 from the Hudson to the East Village
"""


class Case(NamedTuple):
    """A query: what it stands for, and where it starts and ends."""

    title: str
    start: Share
    goal: Share


def cases_of(number: int, town: Town) -> list[Case]:
    """Return the three queries of a figure in a town."""
    rows = [line.split(maxsplit=6) for line in CASES.strip().splitlines()]
    found = []
    for figure, name, *shares, title in rows:
        if (int(figure), name) == (number, town.name):
            x, y, goal_x, goal_y = map(float, shares)
            found.append(Case(title, (x, y), (goal_x, goal_y)))
    return found


def weighed(town: Town, altitude_m: float) -> CostMap:
    """Return the map that the planners of one figure share, under the paper's rules and the default weights."""
    maps = town.maps(PATH_M)
    time_of_day = ("day" if altitude_m <= DAY_UP_TO_M else "night") if maps.times_of_day else None
    return cost_map(maps, altitude_m, preset="paper", time_of_day=time_of_day)


def plan_case(shared: CostMap, case: Case) -> list[PlannedPath]:
    """Return the path of each of the paper's planners."""
    ends = (place(shared, "start", case.start), place(shared, "goal", case.goal))
    problem = shared.problem.between(ends[0].cell, ends[1].cell)
    paths = []
    for planner in PAPER_PLANNERS:
        limits = {"max_samples": NUM_SAMPLES} if planner in SAMPLING_PLANNERS else {}
        found = find_planner(planner)(problem, budget_s=math.inf, seed=0, **limits)
        paths.append(finish(shared, found, ends, PathSearch.of(planner=planner, budget_s=math.inf)))
    return paths


def place(shared: CostMap, name: str, share: Share):
    grid = shared.grid
    x_m = grid.x_min_m + share[0] * (grid.x_max_m - grid.x_min_m)
    y_m = grid.y_min_m + share[1] * (grid.y_max_m - grid.y_min_m)
    # A share of the region may lie in any building.
    return shared.free_space.places_near(name, XY(x_m, y_m), math.inf, False)[0]


def window(grid: Grid, paths: Sequence[PlannedPath]) -> Grid:
    """Return the square part of a grid around paths, moved into the grid where it is no larger than that."""
    found = [path.xy_m for path in paths if path.status.has_path]
    points = np.concatenate(found or [np.reshape(grid.bounds_m, (2, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    half = math.ceil((0.5 + MARGIN) * float((high - low).max()) / grid.resolution_m)
    middle = np.array(grid.cell_of_xy(*((low + high) / 2)))
    room = np.subtract(grid.shape, 2 * half)
    row, col = np.where(room > 0, np.clip(middle - half, 0, room), room // 2).tolist()
    return replace(
        grid,
        first_row=grid.first_row + row,
        first_col=grid.first_col + col,
        num_rows=2 * half,
        num_cols=2 * half,
    )


def crop(layer: DrawnMap, grid: Grid, part: Grid) -> DrawnMap:
    """Return what a layer on ``grid`` shows in ``part``; NaN, or class -1, beyond the grid."""
    beyond = np.int8(-1) if layer.values.dtype.kind == "i" else np.float32(np.nan)
    values = np.full(part.shape, beyond, layer.values.dtype)
    row, col = part.first_row - grid.first_row, part.first_col - grid.first_col
    rows = slice(max(row, 0), min(row + part.num_rows, grid.num_rows))
    cols = slice(max(col, 0), min(col + part.num_cols, grid.num_cols))
    values[rows.start - row : rows.stop - row, cols.start - col : cols.stop - col] = layer.values[
        rows, cols
    ]
    return layer._replace(values=values)


def draw(
    town: Town, shared: CostMap, cases: Sequence[Case], results: Sequence[list[PlannedPath]]
) -> Figure:
    maps, altitude_m = shared.maps, shared.altitude_m
    parts = [window(maps.grid, paths) for paths in results]
    layers = cost_layers(maps, altitude_m, shared.time, shared.time_of_day)
    is_closed = ~shared.is_free & (layers[1].values < 0) & maps.ds["has_data"].values
    closed = flat_layer(is_closed, BLOCKED_COLOUR)
    named = [
        named_paths(paths, None) for paths in results
    ]  # two exact searches of one cost are one
    panels = []
    for case, part, paths in zip(cases, parts, named, strict=True):
        outcomes = [outcome_line(path, NAMES[name]) for path, name in paths]
        cut = [crop(layer, maps.grid, part) for layer in layers]
        foot = "\n".join(["cost, length:", *outcomes])
        hatched = crop(closed, maps.grid, part).values == 0
        panels.append(MapPanel(case.title, cut, foot, part, hatched))
    heading = f"Example paths {altitude_m:g} m above ground: {town.title}"
    heading = joined(heading, shared.time_of_day, by=", ")
    note = joined(f"{PATH_M:g} m cells", maps.attribution)
    legend = obstacle_patches(maps, BLOCKED_COLOUR, panels)
    if any(not _holds(maps.grid, part) for part in parts):
        legend = [entry for entry in legend if entry != NO_DATA_PATCH]
        legend.insert(1, ("beyond the\nregion, or\nno data", NO_DATA_COLOUR))
    drawn = [[each for each in paths if each.path.status.has_path] for paths in named]
    colours = planner_colours(each.name for each in chain(*drawn))
    entries = path_entries({NAMES[name]: colours[name] for name in colours}, *results)
    look = {"legend": [*legend, *entries], "colours": layers[0].colours, "has_ticks": False}
    figure, axes = draw_maps(
        parts[0],
        panels,
        heading,
        joined(
            f"{note}\npreset paper  ·  {rules_said(shared.record)}",
            grid_said(each._replace(name=NAMES[each.name]) for each in chain(*named)),
            by="\n",
        ),
        **look,
    )
    for panel, paths in zip(axes, drawn, strict=True):
        add_paths(panel, [each.path for each in paths], [colours[each.name] for each in paths])
    return figure


def _holds(grid: Grid, part: Grid) -> bool:
    outer, inner = grid.bounds_m, part.bounds_m
    return (
        outer[0] <= inner[0]
        and outer[1] <= inner[1]
        and inner[2] <= outer[2]
        and inner[3] <= outer[3]
    )


def by_planner(paths: Sequence[PlannedPath]) -> dict[str, PlannedPath]:
    """Return paths by the planner's name."""
    return {path.search.planner: path for path in paths}


def found_by(paths: Sequence[PlannedPath]) -> str:
    """Return which planners found a path and how their costs compare."""
    found = [path for path in paths if path.status.has_path]
    if not found:
        return "none finds a path"
    missing = [path.search.planner for path in paths if not path.status.has_path]
    who = "all find a path" if not missing else f"all but {', '.join(missing)} find a path"
    best, worst = (choose(found, key=lambda path: path.cost) for choose in (min, max))
    if worst.cost <= best.cost * (1 + 1e-9):
        return f"{who}, all at the same cost"
    excess = 100 * (worst.cost / best.cost - 1)
    return (
        f"{who}, {best.search.planner} the cheapest, {worst.search.planner} {excess:.1f} % costlier"
    )


def found_text(results: Sequence[list[PlannedPath]]) -> str:
    """Return `found_by` for the three queries."""
    return (
        "; ".join(
            f"({letter}) {found_by(paths)}" for letter, paths in zip("abc", results, strict=True)
        )
        + "."
    )


def detour_of(path: PlannedPath) -> float:
    """Return how much longer a path is than the straight line between its ends, as a share."""
    return path.length_m / float(np.hypot(*(path.xy_m[-1] - path.xy_m[0]))) - 1


def draw_paths(
    number: int,
    altitude_m: float,
    caption: Callable[[Sequence[dict[str, PlannedPath]], str], Caption],
) -> None:
    """Draw a figure for every town; ``caption`` has the three queries' paths by planner, and `found_text`."""
    for town in TOWNS:  # Shinjuku has no people: at 600 m nothing but the distance would count
        if not (cases := cases_of(number, town)):
            continue
        shared = weighed(town, altitude_m)
        results = [plan_case(shared, case) for case in cases]
        for paths in results:  # two exact searches
            dist, plus = (by_planner(paths)[name].cost for name in ("astar-dist", "astar-plus"))
            if not math.isclose(dist, plus, rel_tol=1e-12):
                raise ArithmeticError(f"astar-dist found {dist}, astar-plus {plus}")
        told = caption([by_planner(paths) for paths in results], found_text(results))
        told = told._replace(why=f"{told.why} {DIAGONALS}")
        save(
            draw(town, shared, cases, results),
            f"fig_{number}_paths_{altitude_m:g}m_{town.name}",
            told,
        )
