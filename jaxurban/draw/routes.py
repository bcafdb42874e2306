"""Routes in pictures: what they are called, their colours and widths, and what is said of them."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from jaxurban.draw.frame import (
    ENDS,
    MOST_RULES,
    joined,
    mark_ends,
)
from jaxurban.errors import InputError
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.base import EVERY_PATH, Status
from jaxurban.settings import DEFAULTS
from jaxurban.world.grid import Grid

# A family of planners has a hue, its members a dark and a light tone: the colour-blind see both.
PLANNER_COLOURS = {
    "astar-dist": "#0b3c8c",
    "astar": "#1b74d6",
    "astar-plus": "#3fa9f5",
    "bitstar-dist": "#b3400a",
    "bitstar-plus": "#ffb000",
    "ptp": "#c51b8a",
}
OTHER_COLOURS = ("#00857a", "#4a148c", "#7fc241", "#8c510a", "#59d8c8", "#d9a3ff", "#404040")
ON_A_GRID = (
    "{}: the best by steps from a cell to its neighbours; at other angles a route may be better."
)
MOST_LETTERS = 17  # of a path's name in the legend and below its panel
STEP_PT = 2.2  # by which a path is wider than the next one, or less
# Widths of the last of several paths of a panel, which lies over the others, and of the first of many.
LINE_PT, WIDEST_PT = 2.2, 7.5
MOST_LISTED = 12  # paths of a panel: more are a batch, whose lines are as narrow, and whose ends are all marked
BATCH_PT, BATCH_END = 1.2, 0.4
EDGED = "edged"  # gid of lines that have white edges
# Of their white edge, which parts them from the map and from lines below: of a lone line, and of how much less wide
# than the line below a line is, so that little of that is hidden.
EDGE_PT, EDGE_SHARE = 0.8, 0.18
Paths = PlannedPath | Sequence[PlannedPath | None] | Mapping[str, PlannedPath | None]


class CostChoice(NamedTuple):
    """Which map of the cost a path was planned on; without a time or a time of day the maps have none."""

    altitude_m: float
    time: str | None
    time_of_day: str | None


class DrawnPath(NamedTuple):
    """A path and what pictures call it."""

    path: PlannedPath
    name: str = ""

    @property
    def place(self) -> CostChoice:
        """The map of the cost that the path was planned on."""
        settings = self.path.settings
        return CostChoice(self.path.altitude_m, settings["time"], settings["time_of_day"])


def paths_in(paths: Paths) -> list[PlannedPath]:
    """Return the paths of one, several, a batch, or a dictionary.

    Raises:
      InputError: something else than paths.
    """
    if isinstance(paths, PlannedPath):
        return [paths]
    if isinstance(paths, Mapping):
        paths = [*paths.values()]
    planned = [path for path in paths if path is not None]
    for path in planned:
        if not isinstance(path, PlannedPath):
            raise InputError(f"paths must be paths from plan, got {type(path).__name__}")
    return planned


def check_over(grid: Grid, paths: Iterable[PlannedPath]) -> None:
    """Raise InputError where a path lies wholly beside the maps."""
    for path in paths:
        is_over = path.crs == grid.crs and grid.contains_xy(*path.xy_m.T).any()
        if path.status.has_path and not is_over:
            raise InputError(
                "a path lies nowhere over these maps: give the maps that it was planned on"
            )


def planner_colours(planners: Iterable[str]) -> dict[str, str]:
    """Return a colour for every planner, the paper's where it has one."""
    others = cycle(OTHER_COLOURS)
    return {name: PLANNER_COLOURS.get(name) or next(others) for name in dict.fromkeys(planners)}


def named_paths(paths: Paths, names: Sequence[str] | None) -> list[DrawnPath]:
    """Return paths with what they are called.

    Args:
      paths: one, several, a batch, or a dictionary by name.
      names: of the paths, in their order; None: each is called by its key, or else by its planner, with a number where
        that planned several between the same ends.

    Raises:
      InputError: something else than paths, or another number of names.
    """
    planned = paths_in(paths)
    if isinstance(paths, Mapping) and names is None:
        names = [name for name, path in paths.items() if path is not None]
    if names is not None and (isinstance(names, str) or len(names) != len(planned)):
        raise InputError(
            f"names must be a list of {len(planned)}, one for each path, got {names!r}"
        )
    if names is None:
        return _numbered(_by_proof([DrawnPath(path, path.search.planner) for path in planned]))

    # A dollar sign begins a formula.
    texts = [name.replace("$", r"\$") for name in names]
    return [DrawnPath(path, text) for path, text in zip(planned, texts, strict=True)]


def _numbered(named: Sequence[DrawnPath]) -> list[DrawnPath]:
    """Return paths; those of one planner between the same ends of a map, under other weights or rules, with numbers."""
    ends = [(each.path.xy_m[:1].tolist(), each.path.xy_m[-1:].tolist()) for each in named]
    keys = [str((each.name, each.place, *of_it)) for each, of_it in zip(named, ends, strict=True)]
    totals, counted = Counter(keys), Counter[str]()
    numbered: list[DrawnPath] = []
    for key, each in zip(keys, named, strict=True):
        counted[key] += 1
        is_one = totals[key] == 1 or not each.path.status.has_path
        numbered.append(each if is_one else each._replace(name=f"{each.name} {counted[key]}"))
    return numbered


def _by_proof(named: Sequence[DrawnPath]) -> list[DrawnPath]:
    """Return paths; those of one query that are all proven cheapest on one graph become one, ``astar``."""
    together: dict[Any, list[DrawnPath]] = {}
    for number, each in enumerate(named):
        path = each.path
        key: Any = number
        if path.status is Status.OPTIMAL:
            ends = path.xy_m[[0, -1]].tolist()
            rules = {**path.settings, "budget_s": 0, "seed": 0}
            key = str((each.place, path.search.graph, ends, rules, f"{path.cost:.9g}"))
        together.setdefault(key, []).append(each)
    return [
        DrawnPath(same[0].path, same[0].name if len(same) == 1 else DEFAULTS.planner)
        for same in together.values()
    ]


def draw_paths(panel: Axes, paths: Sequence[PlannedPath], colours: Sequence[str]) -> None:
    """Draw the paths that reach their goal, and start and goal of the first of them.

    Args:
      panel: a map.
      paths: the paths of the panel; those without a route are left out.
      colours: one for each path.
    """
    shown = zip(paths, colours, strict=True)
    found = [(path.xy_m, colour) for path, colour in shown if path.status.has_path]
    draw_lines(panel, [line_m for line_m, _ in found], [colour for _, colour in found])
    draw_ends(panel, paths)


def draw_lines(
    panel: Axes, lines_m: Sequence[np.ndarray], colours: Any, styles: Sequence[Any] = ("-",)
) -> None:
    """Draw lines with white edges where they are, the first widest, so that all are seen where they coincide.

    Args:
      panel: a map.
      lines_m: ``[N, 2]`` easting and northing of the points of each line, in metres.
      colours: one for each line.
      styles: of the lines, one after the other, as Matplotlib has them.
    """
    widths_pt = widths_of(len(lines_m))
    steps_pt = -np.diff(widths_pt)
    edge_pt = min(EDGE_PT, EDGE_SHARE * steps_pt[steps_pt > 0].min(initial=np.inf))
    for line_m, colour, style, width_pt in zip(
        lines_m, colours, cycle(styles), widths_pt, strict=False
    ):
        effect = withStroke(linewidth=width_pt + 2 * edge_pt, foreground="white")
        line = LineCollection(
            [line_m],
            linewidths=width_pt,
            colors=[colour],
            linestyles=[style],
            joinstyle="round",
            zorder=4,
            gid=EDGED,
            path_effects=[effect],
        )
        panel.add_collection(line, autolim=False)


def widths_of(num: int) -> np.ndarray:
    """Return the widths of lines in points, each less than the one before it; a lone line is wide, many are narrow."""
    if num > MOST_LISTED:  # of a batch, which seldom coincide
        return np.full(num, BATCH_PT)
    widest_pt = min(WIDEST_PT, LINE_PT + STEP_PT * max(num - 1, 1))
    return np.linspace(widest_pt, LINE_PT, num)


def path_entries(colours: Mapping[str, str], *paths_at: Sequence[PlannedPath]) -> list[Line2D]:
    """Return the entries of a legend: the names of paths, unless many (`MOST_LISTED`), and their ends if any is shown.

    Args:
      colours: of the paths, by their names.
      paths_at: the paths of each panel.
    """
    listed = colours if len(colours) <= MOST_LISTED else {}
    lines = [
        Line2D([], [], color=colour, linewidth=2.5, label=legend_name(name))
        for name, colour in listed.items()
    ]
    if any(path.status.has_path for path in chain(*paths_at)):
        lines += ENDS
    return lines


def outcome_line(path: PlannedPath, name: str, has_cost: bool = True) -> str:
    """Return a line of text: a path's name, with its cost and its length in km, or with its status without a route.

    Of one that climbs it also says between which altitudes, as it is drawn on the map of one.

    Args:
      path: the path.
      name: what pictures call it.
      has_cost: whether the cost is named.
    """
    if not path.status.has_path:
        return f"{legend_name(name)}: {path.status.value}"
    cost = f"{path.cost:,.1f}" if path.cost < 1000 else f"{path.cost:,.0f}"
    length = f"{path.length_m / 1000:.2f} km"
    low_m, high_m = path.z_m.min(), path.z_m.max()
    if high_m > low_m:
        length += f", {low_m:.0f} to {high_m:.0f} m up"
    graph = " (best on the grid)" if is_best_of_grid(path) else ""
    return f"{legend_name(name)}: {joined(cost if has_cost else '', length, by=', ')}{graph}"


def batch_line(paths: Sequence[PlannedPath]) -> str:
    """Return a line of text on many paths: how many have a route, and their lengths in km."""
    lengths_km = [path.length_m / 1000 for path in paths if path.status.has_path]
    line = f"{len(lengths_km)} of {len(paths)} have a route"
    if not lengths_km:
        return line
    return f"{line}, {min(lengths_km):.2f} to {max(lengths_km):.2f} km, median {np.median(lengths_km):.2f} km"


def is_best_of_grid(path: PlannedPath) -> bool:
    """Return whether a path is the cheapest of a grid, and one at any angle may cost less."""
    return path.status is Status.OPTIMAL and path.search.graph not in ("", EVERY_PATH)


def grid_said(named: Iterable[DrawnPath]) -> str:
    """Return what the cheapest path of a grid is, if any of some paths is one."""
    names = list(dict.fromkeys(each.name for each in named if is_best_of_grid(each.path)))
    if not names:
        return ""
    more = " ..." * (len(names) > MOST_RULES)
    return ON_A_GRID.format(joined(*names[:MOST_RULES], by=", ") + more)


def draw_ends(panel: Axes, paths: Sequence[PlannedPath]) -> None:
    """Mark start (circle) and goal (star) of the first path that was found; of many paths those of all."""
    found = [path for path in paths if path.status.has_path]
    if len(paths) > MOST_LISTED:
        for path in found:
            mark_ends(panel, path.xy_m[0], path.xy_m[-1], BATCH_END)
        return
    for path in found[:1]:
        mark_ends(panel, path.xy_m[0], path.xy_m[-1])


def legend_name(name: str) -> str:
    """Return a name of at most `MOST_LETTERS` letters, its end cut off where it is longer."""
    return name if len(name) <= MOST_LETTERS else f"{name[: MOST_LETTERS - 1]}…"
