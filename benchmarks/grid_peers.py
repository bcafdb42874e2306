"""A* on a city of 2000 x 4000 cells against pyastar2d, scikit-image's MCP and tcod, each on its own cost model.

Every side is timed on the same random queries, in turn, and query by query both find the same cost. Each peer stops at
the goal, and what either side needs once for a map is made before the clock starts; in the row of one-off queries it is
made within.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import label
from tqdm import tqdm

import jaxurban as ju
from benchmarks.common import Row, Timing
from benchmarks.scenes import Scene
from jaxurban.planners.astar import astar, make_landmarks
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.cost import STEPS, CostModel
from jaxurban.planners.grid_search import (
    NO_HEURISTIC,
    Graph,
    GridSearch,
    Heuristic,
    graph_of,
    path_points_m,
)

CITY_M = (10_000.0, 20_000.0)
RESOLUTION_M = 5.0
QUERIES_A_RUN = 10
ALTITUDE_M = 20.0
FLOAT32_ROUNDING = 1e-5  # pyastar2d adds float32 costs over some thousand steps
TCOD_CARDINAL, TCOD_DIAGONAL = 5, 7
TCOD_UNIT = 1000  # of cost 1, in tcod's whole numbers: the longest paths stay below 2^31


@dataclass(frozen=True)
class City:
    """Weighted layers ``[L, Y, X]``, free cells ``[Y, X]``, and what entering each cell of 5 m costs ``[Y, X]``."""

    layers: np.ndarray
    is_free: np.ndarray
    enter: np.ndarray
    distance_weight: float


def load_city(side_m: tuple[float, float]) -> City:
    """Return the synthetic city by day, at the default weights."""
    maps = ju.build_maps(
        ju.demo_city(*side_m), resolution_m=RESOLUTION_M, altitudes_m=(ALTITUDE_M,)
    )
    weights, costs = ju.Weights().checked(), maps.costs(ALTITUDE_M, time_of_day="day")
    layers = [
        weights[name] * np.nan_to_num(np.asarray(cost, float), nan=1.0)
        for name, cost in costs.items()
    ]
    distance_weight = float(weights.distance)
    enter = distance_weight * RESOLUTION_M + np.sum(layers, axis=0)
    return City(np.stack(layers), maps.is_free(ALTITUDE_M), enter, distance_weight)


def random_queries(is_free: np.ndarray, num_queries: int, seed: int) -> list[tuple[Cell, Cell]]:
    """Return pairs of cells of the largest free part that hangs together by sides."""
    parts, _ = label(is_free)
    cells = np.argwhere(parts == np.bincount(parts[is_free]).argmax())
    pairs = np.random.default_rng(seed).choice(len(cells), (num_queries, 2))
    return [tuple(tuple(int(v) for v in cells[k]) for k in pair) for pair in pairs]


@dataclass(frozen=True)
class Contest:
    """A peer and A* set to its cost model. Each solver takes start and goal and returns the path's cost.

    Attributes:
      peer: its name and function.
      model: what a step costs.
      bar: how many times faster ours is asked to be.
      ours, theirs: the solvers; ``prepare`` is theirs too, and left out of the time.
      rtol: how far the costs may differ.
    """

    peer: str
    model: str
    bar: float | None
    ours: Callable[[Cell, Cell], float]
    theirs: Callable[[Cell, Cell], float]
    rtol: float
    prepare: Callable[[], object] = lambda: None


def against_pyastar2d(city: City, heuristic: str = "tiles", bar: float | None = 1.0) -> Contest:
    """Entering a cell costs its weight, diagonal or not. The weights are scaled so that the least is 1.

    That is the least that pyastar2d takes, and what its bound counts for each step. Its compiled function is
    called without the wrapper, which checks and copies the weights.
    """
    import pyastar2d

    weights = np.where(city.is_free, city.enter / city.enter[city.is_free].min(), np.inf).astype(
        np.float32
    )
    height, width = weights.shape
    flat = weights.reshape(-1)

    def theirs(start: Cell, goal: Cell) -> float:
        ends = (row * width + col for row, col in (start, goal))
        cells = pyastar2d.astar.astar(flat, height, width, *ends, True, 0)
        return float(weights[tuple(cells[1:].T)].sum(dtype=np.float64))

    problem = problem_of(weights, city.is_free, 1.0, 0.0)
    if heuristic == "landmarks":
        make_landmarks(problem)
    model = f"the cell entered, diagonals alike, {heuristic}"
    return Contest("pyastar2d", model, bar, solver(problem, heuristic), theirs, FLOAT32_ROUNDING)


def against_pyastar2d_once(city: City) -> Contest:
    """As above, with all that either side makes of the costs of cells (float32) counted in every query."""
    import pyastar2d

    cost = city.enter.astype(np.float32)

    def theirs(start: Cell, goal: Cell) -> float:
        least = cost[city.is_free].min()
        weights = np.where(city.is_free, cost / least, np.float32(np.inf))
        ends = (row * cost.shape[1] + col for row, col in (start, goal))
        cells = pyastar2d.astar.astar(weights.reshape(-1), *cost.shape, *ends, True, 0)
        return float(cost[tuple(cells[1:].T)].sum(dtype=np.float64))

    def ours(start: Cell, goal: Cell) -> float:
        problem = Problem(
            cost[None], city.is_free, start, goal, 1.0, 0.0, CostModel("cell", diagonal="always")
        )
        return astar(problem, heuristic="tiles").cost

    return Contest(
        "pyastar2d",
        "as above, one-off: all preparation counted",
        1.8,
        ours,
        theirs,
        FLOAT32_ROUNDING,
    )


def against_mcp(city: City) -> Contest:
    """As pyastar2d's model, in float64."""
    from skimage.graph import MCP

    mcp = MCP(np.where(city.is_free, city.enter, np.inf))
    problem = problem_of(city.enter, city.is_free, 1.0, 0.0)
    return Contest(
        "scikit-image MCP",
        "the cell entered, diagonals alike",
        5.0,
        solver(problem),
        mcp_solver(mcp),
        1e-9,
    )


def against_mcp_geometric(city: City) -> Contest:
    """A step costs its length times the mean of its two cells: the `line` model."""
    from skimage.graph import MCP_Geometric

    per_metre = city.enter / RESOLUTION_M
    mcp = MCP_Geometric(
        np.where(city.is_free, per_metre, np.inf), sampling=(RESOLUTION_M, RESOLUTION_M)
    )
    cost = city.layers.sum(axis=0)
    problem = problem_of(cost, city.is_free, RESOLUTION_M, city.distance_weight, "line")
    return Contest(
        "scikit-image MCP_Geometric",
        "length x mean of both cells",
        5.0,
        solver(problem),
        mcp_solver(mcp),
        1e-9,
    )


def mcp_solver(mcp) -> Callable[[Cell, Cell], float]:
    """Return a solver that stops at the goal; MCP counts the start's cell too, which is taken off again."""

    def solve(start: Cell, goal: Cell) -> float:
        costs, _ = mcp.find_costs([start], [goal], find_all_ends=False)
        mcp.traceback(goal)
        return float(costs[goal] - costs[start])

    return solve


def against_tcod(city: City) -> Contest:
    """Entering a cell costs its whole number, times 5 straight and times 7 diagonally.

    tcod's bound is set to the least cost of a cell, as its manual advises, and ours is the same. Making its
    arrays anew for each query is left out of its time; making ours is in.
    """
    import tcod.path

    cost = np.where(city.is_free, np.rint(city.enter * TCOD_UNIT), 0).astype(np.int32)
    least = int(cost[city.is_free].min())
    graph = tcod.path.SimpleGraph(
        cost=cost, cardinal=TCOD_CARDINAL, diagonal=TCOD_DIAGONAL, greed=least
    )
    finder = tcod.path.Pathfinder(graph)

    def theirs(start: Cell, goal: Cell) -> float:
        finder.add_root(start)
        finder.path_to(goal)
        return float(finder.distance[goal])

    problem = problem_of(cost, city.is_free, 1.0, 0.0)
    bound = NO_HEURISTIC._replace(
        straight=float(TCOD_CARDINAL * least),
        diagonal=float((TCOD_DIAGONAL - TCOD_CARDINAL) * least),
    )
    is_diagonal = np.abs(STEPS).sum(axis=1) == 2
    ours_graph = graph_of(problem)._replace(
        step_cost=np.zeros(len(STEPS)),
        from_share=np.zeros(len(STEPS)),
        to_share=np.where(is_diagonal, float(TCOD_DIAGONAL), float(TCOD_CARDINAL)),
    )
    model = "the cell entered x 5, diagonally x 7, whole numbers"

    def ours(start: Cell, goal: Cell) -> float:
        return solve_graph(problem.between(start, goal), ours_graph, bound)

    return Contest("tcod", model, 3.0, ours, theirs, 0.0, finder.clear)


def problem_of(
    cost: np.ndarray, is_free: np.ndarray, resolution_m, distance_weight, cost_model="cell"
) -> Problem:
    """Return a problem whose diagonals may cut corners, as all peers' do; costs inside obstacles are left out."""
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    layer = np.where(is_free, cost, 0.0).astype(np.float64)
    problem = Problem(
        layer[None],
        is_free,
        anywhere,
        anywhere,
        resolution_m,
        distance_weight,
        CostModel(cost_model, reference_length_m=RESOLUTION_M, diagonal="always"),
    )
    astar(problem, heuristic="tiles")  # what serves all queries on the map is made now
    return problem


def solver(problem: Problem, heuristic: str = "tiles") -> Callable[[Cell, Cell], float]:
    return lambda start, goal: astar(problem.between(start, goal), heuristic=heuristic).cost


def solve_graph(problem: Problem, graph: Graph, bound: Heuristic) -> float:
    """Return the cost of the cheapest path over a graph whose steps are costed as no problem's are; makes the path."""
    search = GridSearch(graph, bound, problem.start, problem.goal)
    search.run()
    path_points_m(problem, search.states, graph.steps)
    return float(search.costs_from_start()[search.goal])


def run(contest: Contest, queries: list[tuple[Cell, Cell]]) -> Row:
    """Return the row of one peer over all queries; the last one warms both sides up and does not count.

    Raises:
      AssertionError: the costs differ.
    """
    seconds: dict[str, list[tuple[float, float]]] = {"ours": [], "theirs": []}
    worst = 0.0
    for k, query in enumerate(
        tqdm([queries[-1], *queries[:-1]], desc=contest.peer, file=sys.stderr)
    ):
        contest.prepare()
        costs = {}
        for side in seconds:
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            costs[side] = getattr(contest, side)(*query)
            if k:
                seconds[side].append((time.perf_counter() - wall_s, time.process_time() - cpu_s))
        worst = max(worst, abs(costs["ours"] / costs["theirs"] - 1))
        assert worst <= contest.rtol, f"{contest.peer}: {costs} from {query[0]} to {query[1]}"
    ours, theirs = (
        Timing(*(list(values) for values in zip(*pairs, strict=True))) for pairs in seconds.values()
    )
    ratios = np.divide(theirs.cpu_s, ours.cpu_s)
    note = f"{contest.model}; costs differ by {worst:.1e} at most; ratio by query {np.median(ratios):.3g} (median), "
    note += f"{ratios.min():.3g} to {ratios.max():.3g}; ours {1e3 * ours.median_cpu_s:.0f} ms"
    return Row("A*", contest.peer, "searches", 1, 1, ours, theirs, contest.bar, note)


def measure(_: Scene, num_runs: int) -> list[Row]:
    """Return a row for each peer, over ten queries a run of the others."""
    city = load_city(CITY_M)
    queries = random_queries(city.is_free, QUERIES_A_RUN * num_runs + 1, 0)
    contests = (
        against_pyastar2d,
        against_pyastar2d_once,
        partial(against_pyastar2d, heuristic="landmarks", bar=None),
        against_mcp,
        against_mcp_geometric,
        against_tcod,
    )
    return [run(contest(city), queries) for contest in contests]
