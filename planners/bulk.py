"""Many queries solved together in JAX: on the grid by the batched frontier search, BIT*'s by searching all graphs."""

import math
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import chain, islice

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
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
from jaxurban.kernels.search.sample_graph import NO_PARENT, NO_QUERY, Samples, Sizes, search_samples
from jaxurban.planners.astar import make_heuristic
from jaxurban.planners.base import Path, Problem, ProblemCache, Status, index_of
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.bitstar.planner import DEFAULTS, Batches, BitStarOptions, check_limits
from jaxurban.planners.cost import STEPS
from jaxurban.planners.grid_search import graph_of, path_points_m

BAND_STEPS = 8.0  # a band that spans this many steps over the map's median cell
ROUNDS_AT_ONCE = 64  # between two looks at the clock: some 0.1 s
CELLS_TOGETHER = 128  # expanded in one round for each query that runs, at most
QUERIES_TOGETHER = {"cpu": 16, "gpu": 256}
BYTES_OF_G = {"cpu": 2**30, "gpu": 24 * 2**30}  # of what the queries that run together may hold
BYTES_OF_MAPS = {"cpu": 2**30, "gpu": 8 * 2**30}
BYTES_A_CELL = 9  # cost and moves of a map; g and step of a query
SAMPLED_TOGETHER = {"cpu": 64, "gpu": 256}  # queries whose sample graphs are searched together
MOST_NODES = {"cpu": 2**18, "gpu": 2**21}  # of all queries that run together: some 2 kB each
# Room for so many, and for 4, 16 ... times as many, so that few shapes are compiled.
FEWEST_NODES = 1024
# What a turn does together: on a CPU what fits into its caches.
NODES_TOGETHER = {"cpu": 256, "gpu": 2**16}
EDGES_TOGETHER = {"cpu": 2**12, "gpu": 2**20}
CANDIDATES, EDGES = 256, 64  # room at first (see `Sizes`); doubled where needed


def power_of_two(number: int) -> int:
    """Return the least power of two that is not below a number, so that few shapes are compiled."""
    return 1 << (number - 1).bit_length()


def solve_by_frontier(
    problems: Sequence[Problem],
    *,
    planner: str,
    budget_s: float = np.inf,
    band_steps: float = BAND_STEPS,
) -> Iterator[tuple[int, Path]]:
    """Yield ``(index, path)`` of every problem when it is done: the cheapest path, or a status that says why not.

    Queries share the device: as many as fit run together, and the next one begins when one is done. The bound
    is octile, sums are float64, and the results are those of `astar` up to the order of additions. A path's
    ``elapsed_s``, to which the budget applies, is the wall time from its begin to its end, and so it grows with
    the number of queries that run together; compiling is left out. If the budget ends first, the best path so far
    comes back as BUDGET_FEASIBLE, with the bound proven so far.

    Args:
      problems: the queries. Queries made by `Problem.between` share their map on the device, too.
      planner: the name that the paths carry.
      budget_s: seconds for each.
      band_steps: how far above its lowest f a query expands cells, in steps over the map's median cell. Every
        band gives the same results; a wide one does more together and more twice.
    """
    kind = "cpu" if jax.default_backend() == "cpu" else "gpu"

    # Queries on one map together, and maps of one shape, since a program is compiled for a shape.
    by_shape: dict[tuple[int, ...], dict[int, list[int]]] = {}
    for index, problem in enumerate(problems):
        by_map = by_shape.setdefault(problem.cost.shape, {})
        by_map.setdefault(id(problem.cost), []).append(index)
    for shape, by_map in sorted(by_shape.items()):
        most_maps = max(1, BYTES_OF_MAPS[kind] // (BYTES_A_CELL * math.prod(shape)))
        waiting = iter(by_map.values())
        while together := list(islice(waiting, most_maps)):
            queries = [(index, problems[index]) for index in chain(*together)]
            yield from _in_turns(queries, planner, budget_s, band_steps, kind)


def _in_turns(
    queries: list[tuple[int, Problem]], planner: str, budget_s: float, band_steps: float, kind: str
) -> Iterator[tuple[int, Path]]:
    """Yield ``(index, path)`` of queries on maps of one shape: a few places on the device are filled as they fall free.

    JAX works in a thread of its own, which finishes its turn after a Ctrl-C here: a compilation that is cut off
    goes on in JAX's threads and crashes if the interpreter ends meanwhile. The thread also keeps the
    setting for float64 to itself, which a generator would hand to its caller.

    Args:
      queries: indices and problems.
      planner, budget_s, band_steps: as in `solve_by_frontier`.
      kind: ``"cpu"`` or ``"gpu"``.
    """
    turns = _turns(queries, planner, budget_s, band_steps, kind)

    def turn() -> list[tuple[int, Path]] | None:
        with jax.enable_x64(True):
            return next(turns, None)

    with ThreadPoolExecutor(1, thread_name_prefix="frontier") as worker:
        while (done := worker.submit(turn).result()) is not None:
            yield from done


@dataclass
class _Running:
    """A query that has a place on the device: its number, and when it began, compiling left out."""

    index: int
    problem: Problem
    begin_s: float


def _turns(
    queries: list[tuple[int, Problem]], planner: str, budget_s: float, band_steps: float, kind: str
) -> Iterator[list[tuple[int, Path]]]:
    """Yield after every few rounds a list of ``(index, path)`` of the queries that are done, maybe empty.

    Each turn first begins the queries that there is room for. Arguments are those of `_in_turns`.
    """
    search = _Places(queries, band_steps, kind)
    while search.waiting or search.running:
        search.fill()
        search.advance(ROUNDS_AT_ONCE)
        search.make_room()
        yield [
            (query.index, _path(search.frontier, place, query, planner))
            for place, query in search.ended(budget_s)
        ]


class _Places:
    """The places on the device: the queries that wait, those that run, by place, and the search of all of these."""

    def __init__(self, queries: list[tuple[int, Problem]], band_steps: float, kind: str) -> None:
        """Put the maps on the device, make places for as many queries as fit, and compile the search.

        Args:
          queries: indices and problems, on maps of one shape.
          band_steps: as in `solve_by_frontier`.
          kind: ``"cpu"`` or ``"gpu"``.
        """
        # Problems on one map share its cost array.
        maps = list({id(problem.cost): problem for _, problem in queries}.values())
        self.map_index = {id(problem.cost): k for k, problem in enumerate(maps)}
        self.grids = _grids(maps)
        self.bands = [_band(problem, band_steps) for problem in maps]

        # Places are a power of two, so that few shapes are compiled.
        num_cells = maps[0].cost.size
        fitting = max(1, BYTES_OF_G[kind] // (BYTES_A_CELL * num_cells))
        self.num = min(power_of_two(len(queries)), QUERIES_TOGETHER[kind], fitting)
        self.num_together = CELLS_TOGETHER * self.num

        self.waiting = queries[::-1]  # the first one is taken from the end
        self.running: dict[int, _Running] = {}
        list_size = 2 * len(STEPS) * self.num_together + self.num
        self.frontier = empty_frontier(self.num, num_cells, list_size)
        self._compile()

    def fill(self) -> None:
        """Begin a waiting query in each free place, as long as one waits; its clock begins now."""
        for place in range(self.num):
            if place not in self.running and self.waiting:
                index, problem = self.waiting.pop()
                k = self.map_index[id(problem.cost)]
                start = index_of(problem, problem.start)
                goal = index_of(problem, problem.goal)
                self.frontier = begin(
                    self.frontier, self.grids, place, k, start, goal, self.bands[k]
                )
                self.running[place] = _Running(index, problem, time.perf_counter())

    def advance(self, num_rounds: int) -> None:
        """Expand cells of all queries together."""
        self.frontier = advance(self.frontier, self.grids, num_rounds, self.num_together)

    def make_room(self) -> None:
        """Double the list of open cells if it is crowded; the time for that counts for no query."""
        if not is_crowded(self.frontier, self.grids, self.num_together):
            return
        begin_s = time.perf_counter()
        self.frontier = with_list_of(2 * self.frontier.open_f.size, self.frontier)
        self._compile()
        compile_s = time.perf_counter() - begin_s
        for query in self.running.values():
            query.begin_s += compile_s

    def ended(self, budget_s: float) -> Iterator[tuple[int, "_Running"]]:
        """Yield the place of each query that is done or out of time, and the query; afterwards the place is free."""
        lowest_f = np.asarray(self.frontier.lowest_f)
        for place, query in list(self.running.items()):
            if np.isinf(lowest_f[place]) or time.perf_counter() - query.begin_s >= budget_s:
                yield place, query
                self.frontier = drop(self.frontier, place)
                del self.running[place]

    def _compile(self) -> None:
        """Compile the search for the size of its list: with no round allowed it ends at once."""
        self.advance(0)
        jax.block_until_ready(self.frontier)


def _path(frontier: Frontier, place: int, query: _Running, planner: str) -> Path:
    """Return the path of the query in a place, as far as it is known; the query is done if nothing of it is open."""
    problem = query.problem
    lowest_f = float(frontier.lowest_f[place])
    is_reached = bool(frontier.g[place, index_of(problem, problem.goal)] < np.inf)
    if np.isinf(lowest_f):
        status = Status.OPTIMAL if is_reached else Status.NO_PATH
    else:
        status = Status.BUDGET_FEASIBLE if is_reached else Status.BUDGET_EMPTY
    reached_by = np.asarray(frontier.reached_by[place]).reshape(problem.cost.shape)
    return Path.of(
        problem,
        path_points_m(problem, reached_by, np.array(STEPS)) if is_reached else np.empty(0),
        status,
        lowest_f,
        query.begin_s,
        num_expanded=int(frontier.num_expanded[place]),
        planner=planner,
        heuristic="octile",
        backend="jax",
    )


def _grids(maps: list[Problem]) -> Grids:
    """Return maps of one shape on the device.

    The first one is repeated until the number of maps is a power of two, so that few shapes are compiled.
    """
    maps = maps + maps[:1] * (power_of_two(len(maps)) - len(maps))
    graphs = [graph_of(problem) for problem in maps]
    bounds = [make_heuristic("octile", problem) for problem in maps]
    # A cell that no path may cross can cost anything, NaN too, which would spread.
    cost = np.stack([np.where(problem.is_free, problem.cost, 0.0).ravel() for problem in maps])
    arrays = {
        "cost": cost,
        "steps": np.array(STEPS, np.int32),
        "num_cols": np.int32(graphs[0].num_cols),
    }
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


def solve_batched(
    problems: Sequence[Problem],
    *,
    planner: str,
    heuristic: str,
    seeds: Sequence[int],
    budget_s: float = np.inf,
    max_samples: int | None = None,
    options: BitStarOptions = DEFAULTS,
) -> Generator[tuple[int, Path]]:
    """Yield ``(index, path)`` of every problem as it is done: BIT* whose graphs are searched by `search_samples`.

    Batches are those of `bitstar`, and so is the informed set. Each search gives the cheapest path over a batch's graph
    and the tree of the batches before, at the cost that Dijkstra's search gives, which never rises from batch to batch.
    All edges that may help are costed, which are more than `bitstar` costs with ``"numba"``.

    Queries on one map run together, up to `SAMPLED_TOGETHER`; ``elapsed_s``, to which the budget applies, is then the
    wall time of all, compiling left out. A batch is made no larger than the time left is likely to suffice for, but
    once begun it is searched to its end. With a limit of batches or samples a run repeats exactly for its seed,
    whatever runs beside it.

    Args:
      problems: the queries. Queries made by `Problem.between` share their map on the device.
      planner: the name that the paths carry.
      heuristic: as in `bitstar`.
      seeds: of the samples, one for each query.
      budget_s: seconds for each.
      max_samples: of each.
      options: as in `bitstar`.

    Raises:
      InputError: as in `bitstar`, or more or fewer seeds than problems, or problems with a margin of legs.
    """
    check_limits(budget_s, max_samples, options)
    if len(seeds) != len(problems):
        raise InputError(
            f"seeds must be one for each of {len(problems)} problems, got {len(seeds)}"
        )
    if any(problem.leg_margin_m for problem in problems):
        raise InputError(
            "BIT* with backend 'jax' tests no legs for this clearance: take backend='numba'"
        )

    kind = "cpu" if jax.default_backend() == "cpu" else "gpu"
    by_map: dict[ProblemCache, list[int]] = {}
    for index, problem in enumerate(problems):
        by_map.setdefault(problem.cache, []).append(index)

    def search(index: int) -> Batches:
        """Return the batches of one query, whose clock begins now."""
        problem = problems[index]
        return Batches(problem, heuristic, options, seeds[index], budget_s, max_samples)

    def paths() -> Generator[tuple[int, Path]]:
        """Yield paths map by map; the queries of a map run together in groups."""
        for indices in by_map.values():
            waiting = iter(indices)
            first = problems[indices[0]]
            graphs = _Graphs(cost_grid_of(first, first.is_free), kind)
            while group := list(islice(waiting, SAMPLED_TOGETHER[kind])):
                queries = {index: search(index) for index in group}
                for index in _run_together(graphs, queries):
                    yield index, queries[index].path(planner, "jax")

    return paths()


def _run_together(graphs: "_Graphs", queries: dict[int, Batches]) -> Iterator[int]:
    """Search the queries' graphs batch by batch; yield the index of each query when it is done.

    JAX works in a thread of its own, for the reasons given in `_in_turns`.

    Args:
      graphs: the search on the map of all queries.
      queries: by index; altered.
    """
    running = {index: batches for index, batches in queries.items() if not batches.is_done}
    yield from (index for index in queries if index not in running)
    most_nodes = MOST_NODES[graphs.kind] // max(1, len(running))
    with ThreadPoolExecutor(1, thread_name_prefix="bitstar") as worker:
        while running:
            begin_s = time.perf_counter()
            # Even the smallest graphs take the time of the smallest arrays.
            num_nodes = max(FEWEST_NODES, sum(len(batches.tree.xy) for batches in running.values()))
            compile_s = worker.submit(graphs.search, list(running.values())).result()
            now_s = time.perf_counter()

            # Compiling is of no budget. The next batch gets as many nodes as the time left, at this batch's speed,
            # suffices for, shared evenly by the queries that run.
            for index, batches in list(running.items()):
                batches.begin_s += compile_s
                batches.end_s += compile_s
                left_s = max(0.0, batches.end_s - now_s)
                nodes_left = num_nodes * left_s / (now_s - begin_s - compile_s)
                batches.end(min(most_nodes, nodes_left / len(running)))
                if batches.is_done:
                    yield index
            running = {index: batches for index, batches in running.items() if not batches.is_done}


class _Graphs:
    """The search of sample graphs on one map, which stays on the device, and the room that its arrays need."""

    def __init__(self, cost_grid: CostGrid, kind: str) -> None:
        self.kind = kind
        self._cell_cost: np.ndarray | jax.Array = cost_grid.cell_cost
        _, self._per_side, self._is_line, self._passes_corners, _ = cost_grid
        self._candidates, self._edges = CANDIDATES, EDGES

    def search(self, queries: list[Batches]) -> float:
        """Grow the tree of each query over its graph to the cheapest paths; return the seconds that compiling took.

        Args:
          queries: whose ``tree`` and ``num_costed`` are altered.
        """
        # Search, again with more room if there was too little.
        with jax.enable_x64(True):
            cell_cost = self._cell_cost = jnp.asarray(self._cell_cost)
            samples = _samples(queries)
            compile_s = 0.0
            while True:
                sizes = Sizes(
                    self._candidates,
                    self._edges,
                    min(NODES_TOGETHER[self.kind], len(samples.g)),
                    min(EDGES_TOGETHER[self.kind], self._edges * len(samples.g)),
                )
                begin_s = time.perf_counter()
                _compile(len(samples.g), cell_cost.shape, self._is_line, sizes)
                compile_s += time.perf_counter() - begin_s
                trees = search_samples(
                    samples,
                    cell_cost,
                    self._per_side,
                    self._passes_corners,
                    is_line=self._is_line,
                    sizes=sizes,
                )
                edges = -(-int(trees.num_edges) // len(samples.g))
                if trees.most_candidates <= sizes.candidates and edges <= sizes.edges:
                    break
                self._candidates = max(self._candidates, power_of_two(int(trees.most_candidates)))
                self._edges = max(self._edges, power_of_two(edges))
            g, parent, edge_cost, num_costed = (np.asarray(values) for values in trees[:4])

        # Hand each query its own part of the arrays, parents numbered within it.
        first = 0
        for batches in queries:
            own = slice(first, first + len(batches.tree.xy))
            batches.tree = batches.tree._replace(
                g=g[own].copy(),
                parent=_moved(parent[own], -first),
                edge_cost=edge_cost[own].copy(),
            )
            batches.num_costed += int(num_costed[own].sum())
            first = own.stop
        return compile_s


def _moved(parent: np.ndarray, num: int) -> np.ndarray:
    """Return the numbers of parents, ``[N]`` int32, after all nodes moved by ``num`` places."""
    return np.where(parent == NO_PARENT, NO_PARENT, parent + num).astype(np.int32)


@cache
def _compile(num_nodes: int, shape: tuple[int, ...], is_line: bool, sizes: Sizes) -> None:
    """Compile the search for a number of nodes on a map of a shape, by a search in which all nodes are of no query."""
    trees = search_samples(
        _padded([], num_nodes), jnp.zeros(shape), 1.0, False, is_line=is_line, sizes=sizes
    )
    jax.block_until_ready(trees)


def _samples(queries: list[Batches]) -> Samples:
    """Return the nodes of all queries, one query after the other, filled up to one of few sizes.

    A query is numbered by its place in the list. Columns are those of `Samples`: some are the same for all nodes of a
    query, some are the tree's own.
    """
    parts: list[dict[str, np.ndarray]] = []
    num_nodes = 0
    for query, batches in enumerate(queries):
        tree = batches.tree
        of_query = {
            "query": np.int32(query),
            "radius": batches.radius,
            "incumbent": tree.g[tree.goal],
            "least_per_side": batches.bounds.per_side,
        }
        part = {name: np.full(len(tree.xy), value) for name, value in of_query.items()}
        part |= {name: getattr(tree, name) for name in Samples._fields if hasattr(tree, name)}
        part["from_start"] = tree.least_f - tree.to_goal
        part["parent"] = _moved(tree.parent, num_nodes)
        parts.append(part)
        num_nodes += len(tree.xy)

    room = FEWEST_NODES
    while room < num_nodes:
        room *= 4
    return _padded(parts, room)


def _padded(parts: list[dict[str, np.ndarray]], num_nodes: int) -> Samples:
    """Return the samples of all parts, one part after the other, followed by nodes of no query.

    Args:
      parts: columns of `Samples`, by name.
      num_nodes: N, how many nodes there are then in all.
    """
    num_missing = num_nodes - sum(len(part["g"]) for part in parts)
    nothing = {name: np.ones(num_missing) for name in Samples._fields}
    nothing["query"] = np.full(num_missing, NO_QUERY, np.int32)
    nothing["xy"] = np.ones((num_missing, 2))
    nothing["parent"] = np.full(num_missing, NO_PARENT, np.int32)
    parts = [*parts, nothing]
    columns = [np.concatenate([part[name] for part in parts]) for name in Samples._fields]
    return Samples(*map(jnp.asarray, columns))
