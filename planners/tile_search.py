"""Many queries solved together in JAX on the grid, by the tiles that their paths may cross (`kernels.search.tiles`)."""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxurban.kernels.search.tiles import SIDE, STEPS, Search, advance, begin
from jaxurban.planners.astar import astar, make_heuristic, make_landmarks
from jaxurban.planners.base import Path, Problem, ProblemCache, Status
from jaxurban.planners.bulk import power_of_two
from jaxurban.planners.grid_search import graph_of

BAND_STEPS = 8.0  # a band that spans this many steps over the map's median cell
ROUNDS_AT_ONCE = 32  # between two looks at the clock: some 0.1 s
TILES_TOGETHER = 1  # visited in one round for each query that runs, at most
FEWEST_TOGETHER = 8
BYTES_OF_G = {"cpu": 2**26}  # of the queries that run together, by the device
GPU_BYTES = 2**33
NOWHERE = 2**30  # row and column of a start or goal that is never met


def solve_by_tiles(
    problems: Sequence[Problem],
    *,
    planner: str,
    heuristic: str = "octile",
    budget_s: float = np.inf,
) -> Iterator[tuple[int, Path]]:
    """Yield ``(index, path)`` of every problem when it is done: the cheapest path, or a status that says why not.

    Queries on one map run together, as many as fit. Sums are float64, and the results are those of `astar` up to the
    order of additions. A path's ``elapsed_s``, to which the budget applies, is the wall time since its group began,
    compiling left out, and so it grows with the number of queries that run together. If the budget ends first, the best
    path so far comes back as BUDGET_FEASIBLE, with the bound proven so far.

    Args:
      problems: the queries; those made by `Problem.between` share their map.
      planner: the name that the paths carry.
      heuristic: ``"octile"`` or ``"landmarks"``, whose bounds leave out more tiles.
      budget_s: seconds for each.
    """
    by_map: dict[ProblemCache, list[int]] = {}
    for index, problem in enumerate(problems):
        by_map.setdefault(problem.cache, []).append(index)
    for indices in by_map.values():
        tiled = _Tiled(problems[indices[0]], heuristic)
        # Queries of about one length end together.
        away = [np.hypot(*np.subtract(problems[k].start, problems[k].goal)) for k in indices]
        indices = [indices[k] for k in np.argsort(away)]
        num_together = max(
            1, BYTES_OF_G.get(jax.default_backend(), GPU_BYTES) // (8 * tiled.edges[0].size)
        )
        for first in range(0, len(indices), num_together):
            group = indices[first : first + num_together]
            queries = [problems[index] for index in group]
            for k, ended in _in_turns(tiled, queries, budget_s):
                path = _walk(queries[k], ended)
                yield group[k], replace(path, planner=planner, heuristic=heuristic)


def costs_by_tiles(problem: Problem) -> np.ndarray:
    """Return ``[Y, X]`` the exact cost from every cell to a problem's goal, as `astar.cost_to_go`."""
    ((_, ended),) = _in_turns(_Tiled(problem, "none"), [problem], np.inf)
    return ended.costs


class _Tiled:
    """A map in tiles.

    Attributes:
      edges: ``[8, I * SIDE, J * SIDE]`` cost of each step from each cell.
      shape: I and J.
      band: of `advance`.
      is_from_all: whether searches end at no start.
    """

    def __init__(self, problem: Problem, heuristic: str) -> None:
        """Fill the map up with closed cells to whole tiles, and take the landmarks' bounds if they are asked for.

        Args:
          problem: any query on the map.
          heuristic: ``"octile"``, ``"landmarks"``, or ``"none"`` for costs from all cells.
        """
        graph = graph_of(problem)
        frame = [(0, -cells % SIDE) for cells in problem.cost.shape]
        # A cell that no path may cross can cost anything, NaN too.
        cost = np.pad(np.where(problem.is_free, problem.cost, 0.0), frame)
        moves = np.pad(problem.moves, frame)
        self.edges = np.full((len(STEPS), *cost.shape), np.inf)
        for k, step in enumerate(STEPS):
            there = np.roll(cost, np.negative(step), (0, 1))
            paid = graph.step_cost[k] + graph.from_share[k] * cost + graph.to_share[k] * there
            np.copyto(self.edges[k], paid, where=(moves >> k) & 1 == 1)
        share = graph.from_share[0] + graph.to_share[0]
        median = float(np.median(problem.cost[problem.is_free]))
        self.band = BAND_STEPS * float(graph.step_cost[0] + share * median)
        self.shape = cost.shape[0] // SIDE, cost.shape[1] // SIDE
        self.is_from_all = heuristic == "none"
        self._octile = make_heuristic("octile", problem)

        # The least and the greatest cost from each tile to each landmark, ``[I, J, K]``.
        self._landmarks = make_landmarks(problem) if heuristic == "landmarks" else None
        if self._landmarks is not None:
            costs = np.where(problem.is_free[..., None], self._landmarks.costs, np.nan)
            costs = np.pad(costs, [*frame, (0, 0)], constant_values=np.nan)
            costs = costs.reshape(self.shape[0], SIDE, self.shape[1], SIDE, -1)
            self._least = np.fmin.reduce(np.fmin.reduce(costs, axis=3), axis=1)
            self._greatest = np.fmax.reduce(np.fmax.reduce(costs, axis=3), axis=1)

    def bound(self, problem: Problem) -> np.ndarray:
        """Return ``[I, J]`` what a path from the problem's start to any cell of a tile costs at least."""
        if self.is_from_all:
            return np.zeros(self.shape)
        # From the start to the nearest row and column of each tile.
        first = np.indices(self.shape) * SIDE
        start = np.reshape(problem.start, (2, 1, 1))
        away = np.maximum(0, np.maximum(first - start, start - first - SIDE + 1))
        bound = self._octile.straight * away.max(axis=0) + self._octile.diagonal * away.min(axis=0)
        if self._landmarks is None:
            return bound
        of_start = self._landmarks.costs[problem.start]
        # What is not known, of tiles without a free cell or landmarks that reach neither, says nothing.
        with np.errstate(invalid="ignore"):
            apart = np.fmax(self._least - of_start, of_start - self._greatest)
        apart = np.fmax.reduce(apart, axis=2, initial=0.0) + self._landmarks.goal_term
        return np.maximum(bound, apart - self._landmarks.cost_share * problem.cost[problem.start])


class _Ended(NamedTuple):
    """What is found of a query that is done, or out of time.

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


def _walk(problem: Problem, ended: _Ended) -> Path:
    """Return the path of a query by walking down on its costs to the goal."""
    alone = problem.alone()
    alone.cache.costs_to_go = {problem.goal: ended.costs}
    path = astar(alone, heuristic="exact")
    if ended.low_f < np.inf:
        status = Status.BUDGET_FEASIBLE if path.status.has_path else Status.BUDGET_EMPTY
        path = replace(path, status=status, lower_bound=min(ended.low_f, path.cost))
    num_expanded = ended.num_visits * SIDE**2
    elapsed_s = time.perf_counter() - ended.begin_s
    return replace(path, num_expanded=num_expanded, elapsed_s=elapsed_s, backend="jax")


def _in_turns(
    tiled: _Tiled, queries: list[Problem], budget_s: float
) -> Iterator[tuple[int, _Ended]]:
    """Yield the number of each query on a map, and what is found of it, as it ends.

    JAX works in a thread of its own, which finishes its turn after a Ctrl-C here: a compilation that is cut off
    goes on in JAX's threads and crashes if the interpreter ends meanwhile. The thread also keeps the
    setting for float64 to itself, which a generator would hand to its caller.
    """
    # The number of places is a power of two, so that few shapes are compiled; those left over are done from the first.
    num_places = power_of_two(len(queries))
    start, goal = np.full((2, num_places, 2), NOWHERE, np.int32)
    bound = np.zeros((num_places, *tiled.shape))
    for k, query in enumerate(queries):
        goal[k] = query.goal
        bound[k] = tiled.bound(query)
        start[k] = NOWHERE if tiled.is_from_all else query.start
    num_together = max(FEWEST_TOGETHER, TILES_TOGETHER * num_places)

    def turn(search: Search, edges: jax.Array, num_rounds: int) -> tuple[Search, np.ndarray]:
        """Return the search after some rounds, and the lowest open f of each query."""
        with jax.enable_x64(True):
            search, low_f = advance(search, edges, tiled.band, num_rounds, num_together)
            return search, np.asarray(low_f)

    def prepared() -> tuple[Search, jax.Array]:
        """Return the search and the map on the device, with all compiled."""
        with jax.enable_x64(True):
            edges = jax.device_put(tiled.edges)
            search, _ = turn(begin(start, goal, bound), edges, 0)
            return search, edges

    with ThreadPoolExecutor(1, thread_name_prefix="tiles") as worker:
        search, edges = worker.submit(prepared).result()
        begin_s = time.perf_counter()
        running = list(range(len(queries)))
        while running:
            search, low_f = worker.submit(turn, search, edges, ROUNDS_AT_ONCE).result()
            is_over = time.perf_counter() - begin_s >= budget_s
            for k in [k for k in running if is_over or np.isinf(low_f[k])]:
                running.remove(k)
                num_rows, num_cols = queries[k].cost.shape
                costs = np.asarray(search.g[k])[1 : num_rows + 1, 1 : num_cols + 1]
                yield k, _Ended(costs, float(low_f[k]), int(search.num_visits[k]), begin_s)
