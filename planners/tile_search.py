"""Many queries solved together in JAX on the grid, by the tiles that their paths may cross (`kernels.search.tiles`)."""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxurban.kernels.search.tiles import SIDE, Search, TileGrid, advance_tiles, begin
from jaxurban.planners.astar import astar, make_heuristic
from jaxurban.planners.base import Path, Problem, Status, grouped
from jaxurban.planners.bulk import device_kind, power_of_two
from jaxurban.planners.cost import STEPS
from jaxurban.planners.grid_search import graph_of

BAND_STEPS = 8.0  # a band that spans this many steps over the map's median cell
ROUNDS_AT_ONCE = 32  # between two looks at the clock: some 0.1 s
FEWEST_TOGETHER = 8  # tiles of a round, else for each query:
# What fits into a CPU's caches. Of 4 places for each of 64 queries in Lower Manhattan 0.6 are filled.
TILES_TOGETHER = {"cpu": 1, "gpu": 4}
BYTES_OF_G = {"cpu": 2**26, "gpu": 2**33}  # of the queries that run together
NOWHERE = 2**30  # row and column of a start or goal that is never met


class _Ended(NamedTuple):
    """What is known of a query that is done, or out of time.

    Attributes:
      costs: ``[Y, X]`` to its goal, those of cells on cheapest paths exact if it is done.
      low_f: its lowest open f, inf if it is done.
      num_visits: of tiles.
      begin_s: when it began.
    """

    costs: np.ndarray
    low_f: float
    num_visits: int
    begin_s: float


def solve_by_tiles(
    problems: Sequence[Problem], *, planner: str, budget_s: float = np.inf
) -> Iterator[tuple[int, Path]]:
    """Yield ``(index, path)`` of every problem when it is done: the cheapest path, or a status that says why not.

    Queries on one map run together, as many as fit. The bound is octile, or that of landmarks where the map has some;
    sums are float64, and the results are those of `astar` up to the order of additions. A path's ``elapsed_s``, to
    which the budget applies, is the wall time since its group began, compiling left out, and so it grows with the
    number of queries that run together. If the budget ends first, the best path so far comes back as BUDGET_FEASIBLE,
    with the bound proven so far.

    Args:
      problems: the queries; those made by `Problem.between` share their map.
      planner: the name that the paths carry.
      budget_s: seconds for each.
    """
    for indices in grouped(problems, range(len(problems)), lambda problem: problem.cache):
        starts = np.array([problems[index].start for index in indices], np.int32)
        grid, bound, band = _tiled(problems[indices[0]], starts)
        num_fitting = BYTES_OF_G[device_kind()] // (8 * problems[indices[0]].cost.size)
        num_together = power_of_two(num_fitting // 2 + 1)
        for first in range(0, len(indices), num_together):
            group = indices[first : first + num_together]
            own = slice(first, first + num_together)
            queries = [problems[index] for index in group]
            for k, ended in _in_turns(queries, starts[own], (grid, bound[own], band), budget_s):
                yield group[k], _path(queries[k], ended, planner)


def costs_by_tiles(problem: Problem) -> np.ndarray:
    """Return ``[Y, X]`` the exact cost from every cell to a problem's goal, as `astar.exact_cost_to_go`."""
    start = np.full((1, 2), NOWHERE, np.int32)
    ((_, ended),) = _in_turns([problem], start, _tiled(problem.alone(), start), np.inf)
    return ended.costs


def _path(problem: Problem, ended: _Ended, planner: str) -> Path:
    """Return the path of a query by walking down on its costs to the goal."""
    alone = problem.alone()
    alone.cache.costs_to_go = {problem.goal: ended.costs}
    path = astar(alone, heuristic="exact", planner=planner)
    status, lower_bound = path.status, path.lower_bound
    if ended.low_f < np.inf:
        status = Status.BUDGET_FEASIBLE if status.has_path else Status.BUDGET_EMPTY
        lower_bound = min(ended.low_f, path.cost)
    return replace(
        path,
        status=status,
        lower_bound=lower_bound,
        num_expanded=ended.num_visits * SIDE**2,
        elapsed_s=time.perf_counter() - ended.begin_s,
        heuristic="octile" if problem.cache.landmarks is None else "landmarks",
        backend="jax",
    )


def _in_turns(
    queries: list[Problem],
    starts: np.ndarray,
    tiled: tuple[TileGrid, np.ndarray, float],
    budget_s: float,
) -> Iterator[tuple[int, _Ended]]:
    """Yield the number of each query on a map, and what is known of it, when it ends.

    JAX works in a thread of its own, which finishes its turn after a Ctrl-C here: a compilation that is cut off
    goes on in JAX's threads and crashes if the interpreter ends meanwhile. The thread also keeps the
    setting for float64 to itself, which a generator would hand to its caller.

    Args:
      queries: on one map.
      starts: ``[Q, 2]`` where they end, or `NOWHERE`.
      tiled: from `_tiled`.
      budget_s: seconds for all of them, compiling left out.
    """
    # The number of places is a power of two, so that few shapes are compiled; those left over are done from the first.
    num_places = power_of_two(len(queries))
    goals = np.array([query.goal for query in queries], np.int32)
    missing = ((0, num_places - len(queries)), (0, 0))
    start, goal = (np.pad(cells, missing, constant_values=NOWHERE) for cells in (starts, goals))
    grid, bound, band = tiled
    bound = np.pad(bound, (*missing, (0, 0)))
    num_together = max(FEWEST_TOGETHER, TILES_TOGETHER[device_kind()] * num_places)
    num_rows, num_cols = queries[0].cost.shape

    def turn(search: Search | None, num_rounds: int) -> tuple[Search, np.ndarray]:
        """Return the search, a new one for None, after some rounds, and the lowest open f of each query."""
        with jax.enable_x64(True):
            search = begin(start, goal, bound) if search is None else search
            search, low_f = advance_tiles(search, grid, band, num_rounds, num_together=num_together)
            return search, np.asarray(low_f)

    with ThreadPoolExecutor(1, thread_name_prefix="tiles") as worker:
        search, _ = worker.submit(turn, None, 0).result()  # compiles
        begin_s = time.perf_counter()
        running = list(range(len(queries)))
        while running:
            search, low_f = worker.submit(turn, search, ROUNDS_AT_ONCE).result()
            is_over = time.perf_counter() - begin_s >= budget_s
            for k in [k for k in running if is_over or np.isinf(low_f[k])]:
                running.remove(k)
                costs = np.asarray(search.g[k])[1 : num_rows + 1, 1 : num_cols + 1]
                yield k, _Ended(costs, float(low_f[k]), int(search.num_visits[k]), begin_s)


def _tiled(problem: Problem, start: np.ndarray) -> tuple[TileGrid, np.ndarray, float]:
    """Return a problem's map on the device, the ``bound`` of queries, and the ``band`` (`advance_tiles`).

    Args:
      problem: any query on the map.
      start: ``[Q, 2]`` of the queries.
    """
    # The map, filled up with closed cells to whole tiles. A cell that no path may cross can cost anything, NaN too.
    graph = graph_of(problem)
    frame = [(0, -cells % SIDE) for cells in problem.cost.shape]
    cost = np.pad(np.where(problem.is_free, problem.cost, 0.0), frame)
    prices = zip(graph.step_cost, graph.from_share, graph.to_share, strict=True)
    steps = {
        step: (1 << k, *price) for k, (step, price) in enumerate(zip(STEPS, prices, strict=True))
    }
    framed = (np.pad(cost, 1), np.pad(problem.moves, frame))

    num_i, num_j = (cells // SIDE for cells in cost.shape)
    # From a start to the nearest row and column of each tile, ``[2, Q, I, J]``.
    octile = make_heuristic("octile", problem)
    first = np.indices((num_i, num_j))[:, None] * SIDE
    at = start.T[:, :, None, None]
    away = np.maximum(0, np.maximum(first - at, at - first - SIDE + 1)) * (at != NOWHERE)
    bound = octile.straight * away.max(axis=0) + octile.diagonal * away.min(axis=0)

    # Or, where larger, what separates the start's cost to a landmark from those of all the tile's cells. NaN: no bound.
    landmarks = problem.cache.landmarks
    if landmarks is not None:
        cells = tuple(start.T)
        term = landmarks.goal_term - landmarks.cost_share * problem.cost[cells]
        costs = np.where(landmarks.costs < np.inf, landmarks.costs, np.nan)
        for to in np.moveaxis(costs, -1, 0):
            tiles = np.pad(to, frame, constant_values=np.nan).reshape(num_i, SIDE, num_j, SIDE)
            nearest, farthest = (pick.reduce(tiles, (1, 3)) for pick in (np.fmin, np.fmax))
            of_start = to[cells][:, None, None]
            apart = np.maximum(nearest - of_start, of_start - farthest)
            bound = np.fmax(bound, apart + term[:, None, None])

    share = graph.from_share[0] + graph.to_share[0]
    step_cost = graph.step_cost[0] + share * np.median(problem.cost[problem.is_free])
    with jax.enable_x64(True):
        cost, moves = jax.device_put(framed)
        grid = TileGrid(cost, moves, steps)
        return grid, bound, BAND_STEPS * float(step_cost)
