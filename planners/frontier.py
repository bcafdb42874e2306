"""Many grid queries solved together by the batched frontier search, in JAX."""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from operator import itemgetter

import jax
import numpy as np

from jaxurban.kernels.search.frontier import (
    Frontier,
    Grids,
    advance,
    begin,
    drop,
    empty_frontier,
    is_crowded,
    with_list_of,
)
from jaxurban.planners.base import Cell, Path, Problem, Status
from jaxurban.planners.bounds import make_heuristic
from jaxurban.planners.compiled_first import power_of_two
from jaxurban.planners.cost_model import STEPS
from jaxurban.planners.grid_search import graph_of, way_m

BAND_STEPS = 8.0  # a band that spans this many steps over the map's median cell
ROUNDS_AT_ONCE = 64  # between two looks at the clock: some 0.1 s
CELLS_TOGETHER = 128  # expanded in one round for each query that runs, at most
QUERIES_TOGETHER = {"cpu": 16, "gpu": 256}
BYTES_OF_G = {"cpu": 2**30, "gpu": 24 * 2**30}  # of what the queries that run together may hold
BYTES_OF_MAPS = {"cpu": 2**30, "gpu": 8 * 2**30}
BYTES_A_CELL = 9  # cost and moves of a map; g and step of a query


def solve_by_frontier(
    problems: Sequence[Problem], *, planner: str, budget_s: float = np.inf, band_steps: float = BAND_STEPS
) -> Iterator[tuple[int, Path]]:
    """Yield ``(index, path)`` of every problem as it is done, the cheapest path or why there is none.

    Queries share the device: as many as fit run together, and the next one begins when one is done. The bound
    is octile, sums are float64, and the results are those of `astar` up to the order of additions. A path's
    ``elapsed_s``, to which the budget applies, is the wall time from its begin to its end and so grows with
    the number that run together; compiling is left out. Where the budget ends first, what was found so far
    comes back as BUDGET_FEASIBLE, with the bound proven so far.

    Args:
      problems: the queries. Queries made by `Problem.between` share their map on the device, too.
      planner: the name that the paths carry.
      budget_s: seconds for each.
      band_steps: how far above its lowest f a query expands cells, in steps over the map's median cell. Every
        band gives the same results; a wide one does more together and more twice.
    """
    kind = "cpu" if jax.default_backend() == "cpu" else "gpu"
    first = {id(problem.cost): i for i, problem in reversed(list(enumerate(problems)))}
    by_map = sorted(range(len(problems)), key=lambda i: (problems[i].cost.shape, first[id(problems[i].cost)]))
    for _, same_shape in groupby(by_map, key=lambda i: problems[i].cost.shape):
        indices = list(same_shape)
        number = {key: k for k, key in enumerate(dict.fromkeys(id(problems[i].cost) for i in indices))}
        most = max(1, BYTES_OF_MAPS[kind] // (BYTES_A_CELL * problems[indices[0]].cost.size))
        parts = [(number[id(problems[i].cost)] // most, i) for i in indices]
        for _, part in groupby(parts, key=itemgetter(0)):
            yield from _in_turns([(i, problems[i]) for _, i in part], planner, budget_s, band_steps, kind)


def _in_turns(
    queries: list[tuple[int, Problem]], planner: str, budget_s: float, band_steps: float, kind: str
) -> Iterator[tuple[int, Path]]:
    """Yield the number and path of queries on maps of one shape: a few places on the device, filled as they fall free.

    JAX works in a thread of its own, which a Ctrl-C here lets end its turn: a compilation that is cut off
    goes on in JAX's threads and crashes if the interpreter ends meanwhile. The thread also keeps the
    setting for float64 to itself; a generator would hand it to its caller.
    """
    turns = _turns(queries, planner, budget_s, band_steps, kind)

    def turn() -> list[tuple[int, Path]] | None:
        with jax.enable_x64(True):
            return next(turns, None)

    with ThreadPoolExecutor(1, thread_name_prefix="frontier") as worker:
        while (done := worker.submit(turn).result()) is not None:
            yield from done


def _turns(
    queries: list[tuple[int, Problem]], planner: str, budget_s: float, band_steps: float, kind: str
) -> Iterator[list[tuple[int, Path]]]:
    """Yield what is done after every few rounds; each begins the queries that there is room for."""
    maps = list({id(problem.cost): problem for _, problem in queries}.values())
    map_index = {id(problem.cost): k for k, problem in enumerate(maps)}
    grids, bands, num_cells = _grids(maps), [_band(problem, band_steps) for problem in maps], maps[0].cost.size
    fitting = max(1, BYTES_OF_G[kind] // (BYTES_A_CELL * num_cells))
    num_places = min(power_of_two(len(queries)), QUERIES_TOGETHER[kind], fitting)
    num_together = CELLS_TOGETHER * num_places
    frontier = empty_frontier(num_places, num_cells, 2 * len(STEPS) * num_together + num_places)
    # With no round allowed the search ends at once, compiled for the size of its list.
    frontier = jax.block_until_ready(advance(frontier, grids, 0, num_together))
    waiting = queries[::-1]
    running: dict[int, tuple[int, Problem, float]] = {}  # by place: the query's number, problem and begin
    while waiting or running:
        for place in range(num_places):
            if place not in running and waiting:
                index, problem = waiting.pop()
                k = map_index[id(problem.cost)]
                cells = (_flat(cell, problem) for cell in (problem.start, problem.goal))
                frontier = begin(frontier, grids, place, k, *cells, bands[k])
                running[place] = index, problem, time.perf_counter()
        frontier = advance(frontier, grids, ROUNDS_AT_ONCE, num_together)
        if is_crowded(frontier, grids, num_together):  # a longer list is made off the clocks
            away_s = -time.perf_counter()
            frontier = with_list_of(2 * frontier.open_f.size, frontier)
            frontier = jax.block_until_ready(advance(frontier, grids, 0, num_together))
            away_s += time.perf_counter()
            running = {place: (index, problem, s + away_s) for place, (index, problem, s) in running.items()}
        done, lowest_f = [], np.asarray(frontier.lowest_f)
        for place, (index, problem, begin_s) in list(running.items()):
            if np.isinf(lowest_f[place]) or time.perf_counter() - begin_s >= budget_s:
                done.append((index, _path(frontier, place, problem, planner, begin_s)))
                frontier = drop(frontier, place)
                del running[place]
        yield done


def _path(frontier: Frontier, place: int, problem: Problem, planner: str, begin_s: float) -> Path:
    """Return the path of the query in a place, as far as it is known."""
    lowest_f = float(frontier.lowest_f[place])
    is_reached = bool(frontier.g[place, _flat(problem.goal, problem)] < np.inf)
    if np.isinf(lowest_f):
        status = Status.OPTIMAL if is_reached else Status.NO_PATH
    else:
        status = Status.BUDGET_FEASIBLE if is_reached else Status.BUDGET_EMPTY
    reached_by = np.asarray(frontier.reached_by[place]).reshape(problem.cost.shape)
    return Path.of(
        problem,
        way_m(problem, reached_by, np.array(STEPS)) if is_reached else np.empty(0),
        status,
        lowest_f,
        begin_s,
        num_expanded=int(frontier.num_expanded[place]),
        planner=planner,
        heuristic="octile",
        backend="jax",
    )


def _grids(maps: list[Problem]) -> Grids:
    """Return the maps on the device, the first one repeated to a power of two so that few shapes are compiled."""
    maps = maps + maps[:1] * (power_of_two(len(maps)) - len(maps))
    graphs = [graph_of(problem) for problem in maps]
    bounds = [make_heuristic("octile", problem) for problem in maps]
    # A cell that no path may cross can cost anything, NaN too, which would spread.
    cost = np.stack([np.where(problem.is_free, problem.cost, 0.0).ravel() for problem in maps])
    arrays = {"cost": cost, "steps": np.array(STEPS, np.int32), "num_cols": np.int32(graphs[0].num_cols)}
    for name in ("moves", "step_cost", "from_share", "to_share"):
        arrays[name] = np.stack([getattr(graph, name) for graph in graphs])
    for name in ("straight", "diagonal"):
        arrays[name] = np.array([getattr(bound, name) for bound in bounds])
    return Grids(**jax.device_put(arrays))


def _band(problem: Problem, band_steps: float) -> float:
    graph = graph_of(problem)
    share = graph.from_share[0] + graph.to_share[0]
    step = float(graph.step_cost[0] + share * np.median(problem.cost[problem.is_free]))
    return band_steps * step if step > 0 else 0.0  # 0 times a band without end is not a number


def _flat(cell: Cell, problem: Problem) -> int:
    return cell[0] * problem.cost.shape[1] + cell[1]
