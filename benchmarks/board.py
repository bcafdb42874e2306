"""The first entries of the board: our planners and whichever peers are installed, each by its own way of costing steps.

``python -m benchmarks.board BENCH [-o out/board]`` writes a submission an entrant and ``board.csv``. A grid planner's
route enters both tracks; where it cuts a corner past one closed cell, the cell on the other side is put in. OMPL's BIT*
and ours get the same seconds a query.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from matplotlib.figure import Figure
from tqdm import tqdm

import jaxurban as ju
from benchmarks.score import city_maps, problem_of, score, unpacked
from jaxurban.draw.style import (
    MARKERS,
    SERIES_COLOURS,
    chart,
    dress,
    legend_above,
    letter_all,
    name_rows,
    styled,
)
from jaxurban.draw.write import write_picture
from jaxurban.io.tables import records_of
from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.planners.any_angle import theta_star
from jaxurban.planners.astar import astar_plus
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.bitstar.bounds import cost_grid_of, reachable_cells
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.refine import refine
from jaxurban.studies.demonstrations import demonstration_from_line

MOST_GAP = 0.8  # that is drawn
ROW_IN, CITY_GAP = 0.42, 0.22  # height of a method's row; between its cities, as a share of it
LIFT = 0.1  # of the legend over the title, as a share of a panel
SAMPLING_S = 1.0  # of each query
TCOD_UNIT, TCOD_STEPS = (
    100,
    (70, 99),
)  # of cost in whole numbers, and of a straight and a diagonal step
TITLES = {"grid": "routes by steps between cells", "any-angle": "routes at any angle"}
GRID, ANY_ANGLE = ("grid", "any-angle"), ("any-angle",)


def on_grid(solve: Callable[[np.ndarray, Cell, Cell], np.ndarray], problem: Problem) -> np.ndarray:
    """Return centres ``[N, 2]``, metres, of the way of a peer that cuts corners, mended to keep the board's rule.

    A step past one closed cell goes round by the other side. A cell from which one passes between two closed cells is
    closed, and the peer plans again.

    Args:
      solve: the peer, which takes what crossing each cell straight costs, inf where it is closed, start and goal, and
        returns cells.
      problem: the query.
    """
    rate = problem.distance_weight + problem.cost / problem.cost_model.reference_length_m
    cost, is_pinched = (
        np.where(problem.is_free, rate * problem.resolution_m, np.inf),
        np.array([True]),
    )
    while is_pinched.any():
        cells = np.array(solve(cost, problem.start, problem.goal))
        (row, col), (to_row, to_col) = cells[:-1].T, cells[1:].T
        sides = np.array([[row, to_col], [to_row, col]])
        is_open = problem.is_free[sides[:, 0], sides[:, 1]]
        is_pinched = ~is_open.any(axis=0)
        cost[row[is_pinched], col[is_pinched]] = np.inf
    way = [cells[:1]]
    for k, cell in enumerate(cells[1:]):
        way += [sides[[int(is_open[1, k])], :, k]] * (not is_open[:, k].all()) + [cell[None]]
    return (np.concatenate(way)[:, ::-1] + 0.5) * problem.resolution_m


def pyastar2d(cost: np.ndarray, start: Cell, goal: Cell) -> np.ndarray:
    from pyastar2d import astar_path

    return astar_path((cost / cost.min()).astype(np.float32), start, goal, allow_diagonal=True)


def scikit_image(cost: np.ndarray, start: Cell, goal: Cell) -> np.ndarray:
    from skimage.graph import route_through_array

    return route_through_array(cost, start, goal)[0]


def tcod(cost: np.ndarray, start: Cell, goal: Cell) -> np.ndarray:
    from tcod.path import Pathfinder, SimpleGraph

    whole = np.where(np.isfinite(cost), np.rint(cost * TCOD_UNIT), 0).astype(np.int32)
    finder = Pathfinder(SimpleGraph(cost=whole, cardinal=TCOD_STEPS[0], diagonal=TCOD_STEPS[1]))
    finder.add_root(start)
    return finder.path_to(goal)


def ompl(problem: Problem) -> np.ndarray:
    """Return the route of OMPL's BITstar, whose edges are costed by our compiled function."""
    from ompl import base, geometric

    ground = cost_grid_of(problem, reachable_cells(problem))

    class Cost(base.OptimizationObjective):
        def stateCost(self, _):  # noqa: N802
            return base.Cost(0.0)

        def motionCost(self, a, b):  # noqa: N802
            return base.Cost(segment_cost(ground, a[0], a[1], b[0], b[1], np.inf))

        def motionCostHeuristic(self, a, b):  # noqa: N802
            return base.Cost(ground.per_side * np.hypot(a[0] - b[0], a[1] - b[1]))

    space, box = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    for axis, size in enumerate(problem.is_free.shape[::-1]):
        box.setLow(axis, 0.0)
        box.setHigh(axis, size - 1e-6)
    space.setBounds(box)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: bool(problem.is_free[int(state[1]), int(state[0])]))
    ends = [space.allocState(), space.allocState()]
    for state, (row, col) in zip(ends, (problem.start, problem.goal), strict=True):
        state[0], state[1] = col + 0.5, row + 0.5
    setup.setStartAndGoalStates(*ends)
    setup.setOptimizationObjective(Cost(information))
    setup.setPlanner(geometric.BITstar(information))
    setup.solve(SAMPLING_S)
    states = setup.getSolutionPath().getStates() if setup.haveExactSolutionPath() else []
    return (
        np.array([[state[0], state[1]] for state in states]).reshape(-1, 2) * problem.resolution_m
    )


ENTRANTS = {  # tracks, what must be installed, and the planner
    "astar-plus": (GRID, "jaxurban", lambda problem: astar_plus(problem).points_m),
    "pyastar2d": (GRID, "pyastar2d", partial(on_grid, pyastar2d)),
    "scikit-image": (GRID, "skimage", partial(on_grid, scikit_image)),
    "tcod": (GRID, "tcod", partial(on_grid, tcod)),
    "theta-star": (ANY_ANGLE, "jaxurban", lambda problem: theta_star(problem).points_m),
    "theta-star refined": (
        ANY_ANGLE,
        "jaxurban",
        lambda problem: refine(problem, theta_star(problem)).points_m,
    ),
    "bitstar-plus": (
        ANY_ANGLE,
        "jaxurban",
        lambda problem: bitstar_plus(problem, budget_s=SAMPLING_S).points_m,
    ),
    "OMPL BIT*": (ANY_ANGLE, "ompl", ompl),
}


def fitted(folder: Path) -> list[dict[str, str]]:
    """Return the submission of `fit_weights` on the demonstrations."""
    shown, rows = pd.read_csv(folder / "demonstrations.csv"), []
    for city, maps in city_maps().items():
        on = ju.cost_map(maps, maps.altitudes_m[0], cost_model="line")
        corner_m, lines = (
            np.array(on.grid.bounds_m[:2]),
            shapely.from_wkt(shown.route[shown.city == city]),
        )
        routes = [
            demonstration_from_line(on, shapely.get_coordinates(line) + corner_m) for line in lines
        ]
        weights = ju.fit.fit_weights(routes, bootstrap=0).weights
        route = ",".join(f"{name}={weights[name]!r}" for name in ("distance", *on.names))
        rows.append({"track": "weights", "query": city, "route": route})
    return rows


@styled
def picture(board: pd.DataFrame) -> Figure:
    """Return the gap of each method by track and city: a dot at the median, a line to 90 %, an arrow beyond."""
    note = (
        "The bound is what no route can cost less than. Marks: half of the routes cost at most this much more; lines "
        "reach to what 90 % of them stay below, and arrows beyond the axis."
    )
    num_rows = max(board[board.track == track].method.nunique() for track in GRID)
    figure = chart(
        ROW_IN * num_rows + 0.3, "How much more routes cost than the proven bound, by method", note
    )
    axes = figure.subplots(1, 2, sharex=True)
    for panel, track in zip(axes, GRID, strict=True):
        lines = board[board.track == track]
        methods = (
            lines.groupby("method")[["asked", "valid", "gap_median"]]
            .sum()
            .sort_values("gap_median")
        )
        dress(panel)
        for number, (city, of_city) in enumerate(lines.groupby("city")):
            at = methods.index.get_indexer(of_city.method) + CITY_GAP * (number - 1)
            most = of_city.gap_90.clip(upper=MOST_GAP)
            look = {"color": SERIES_COLOURS[number], "markersize": 4.0}
            panel.hlines(at, 100 * of_city.gap_median, 100 * most, color=look["color"])
            name = city.replace("-", " ").title()
            panel.plot(100 * of_city.gap_median, at, MARKERS[number], label=name, **look)
            is_beyond = of_city.gap_90 > MOST_GAP
            if is_beyond.any():  # a line without a point would take room at the figure's corner
                panel.plot(100 * most[is_beyond], at[is_beyond], ">", clip_on=False, **look)
        failed = methods.asked - methods.valid
        labels = [
            name + f"\n{num} of {methods.asked[name]} fail" * (num > 0)
            for name, num in failed.items()
        ]
        name_rows(panel, labels)
        panel.set(
            title=f"{TITLES[track]} (track {track})",
            xlabel="cost above the bound (%), 0 is best",
            xlim=(-1, 100 * MOST_GAP),
        )
    letter_all(axes)
    legend_above(axes[0], LIFT)
    return figure


def main() -> None:
    """Run the entrants that are installed, and score them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bench", type=Path, help="folder of `python -m benchmarks.score --make`")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/board"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    queries = records_of(pd.read_csv(options.bench / "queries.csv"))
    cities = {
        city: unpacked(options.bench / f"{city}.npz") for city in {row["city"] for row in queries}
    }
    submissions = {"fit_weights": fitted(options.bench)}
    for name, (tracks, package, plan) in ENTRANTS.items():
        asked = [row for row in queries if row["track"] in tracks and find_spec(package)]
        for row in tqdm(asked, desc=name):
            problem, begin_s = problem_of(*cities[row["city"]], row), time.process_time()
            line = shapely.LineString(plan(problem))
            facts = {
                "track": row["track"],
                "query": row["query"],
                "route": line.wkt if len(line.coords) else "",
            }
            submissions.setdefault(name, []).append(
                facts | {"cpu_s": time.process_time() - begin_s}
            )
    for name, rows in submissions.items():
        file = options.output / f"{name}.csv"
        pd.DataFrame(rows).to_csv(file, index=False)
        print(score(options.bench, file, options.output / "board.csv")[0].to_string())
    board = pd.read_csv(options.output / "board.csv")
    write_picture(picture(board), options.output / "board.png")


if __name__ == "__main__":
    main()
