"""BIT*: batch informed trees, an anytime planner that leaves the grid (Gammell, Srinivasa & Barfoot 2015).

One query's graphs are searched in order of lower bounds, compiled by Numba; many queries' in bulk, in JAX.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from itertools import islice

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import EXHAUSTED, FULL, Heap
from jaxurban.kernels.search.sample_graph import NO_PARENT, NO_QUERY, Samples, Sizes, search_samples
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.bitstar.batches import DEFAULTS, Batches, BitStarOptions, Budget, begun, check_limits, ended
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.bitstar.tree import EDGE, NOT_COSTED, BatchGraph, advance
from jaxurban.planners.compiled_first import compiled_first, power_of_two

CHUNK = 20_000  # queue entries between two looks at the clock: some 20 ms
FIRST_QUEUE = 4096  # entries; doubled when full
QUERIES_TOGETHER = {"cpu": 64, "gpu": 256}
MOST_NODES = {"cpu": 2**18, "gpu": 2**21}  # of all queries that run together: some 2 kB each
FEWEST_NODES = 1024  # room for so many, and for 4, 16 ... times as many, so that few shapes are compiled
# What a turn does together: on a CPU what fits into its caches.
NODES_TOGETHER = {"cpu": 256, "gpu": 2**16}
EDGES_TOGETHER = {"cpu": 2**12, "gpu": 2**20}
CANDIDATES, EDGES = 256, 64  # room at first (see `Sizes`); doubled where needed


def bitstar(
    problem: Problem,
    *,
    budget_s: float = 10.0,
    seed: int = 0,
    heuristic: str = "plus",
    max_samples: int | None = None,
    options: BitStarOptions = DEFAULTS,
    planner: str = "bitstar",
) -> Path:
    """Return the best path found through random samples of the free cells, better the longer it runs.

    Each batch adds samples where a cheaper path may lead, joins all within the radius of theory, and
    searches that graph in order of lower bounds, keeping the tree. Batch 0 is the straight segment.
    Edges are costed, and tested for obstacles, over the exact cells that they cross. With a limit of
    batches or samples a run repeats exactly for its seed; the budget and Ctrl-C are heeded within some
    20 ms of search, and between batches (with the ``"jax"`` backend only there).

    The status is OPTIMAL where the cost meets the lower bound, NO_PATH where obstacles part start and
    goal, FEASIBLE where ``target_cost`` or ``min_improvement`` ended the search. Of ``diagonal`` only
    ``"always"`` plays a part: then a path may pass between two obstacles that touch at a corner.
    ``connectivity`` plays none. Under the ``cell`` model a step of any length costs one cell, so that
    A*'s diagonals, of 1.41 cell sides, are cheaper than any longer edge, which costs every cell
    side: to compare planners use ``line``.

    Differs from the paper: a queued edge that was costed goes back into the queue with its true cost, so
    that nodes join the tree in order of cost; improved nodes are expanded again, those of earlier batches
    too; and batches grow, so that the work stays in proportion to the samples.

    Args:
      problem: the query.
      budget_s: seconds of search.
      seed: of the samples.
      heuristic: ``"euclidean"`` or ``"plus"`` (see `bitstar.bounds.make_bounds`).
      max_samples: end after so many; samples outside the free or informed set do not count.
      options: how batches are made, and what else ends the search.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic, a number out of its range, or no limit of time, batches or samples.
    """
    check_limits(budget_s, max_samples, options)
    if options.backend == "jax":
        paths = solve_batched(
            [problem],
            planner=planner,
            heuristic=heuristic,
            seeds=[seed],
            budget_s=budget_s,
            max_samples=max_samples,
            options=options,
        )
        return next(paths)[1]
    limits = {"budget_s": budget_s, "max_samples": max_samples}
    return _in_order(problem, heuristic=heuristic, seed=seed, options=options, planner=planner, **limits)


# The paper's two: guided by the straight distance, and by distance and map costs.
bitstar_dist = partial(bitstar, heuristic="euclidean", planner="bitstar-dist")
bitstar_plus = partial(bitstar, heuristic="plus", planner="bitstar-plus")


@compiled_first(budget_s=np.inf, max_samples=20)
def _in_order(
    problem: Problem,
    *,
    heuristic: str,
    budget_s: float,
    max_samples: int | None,
    seed: int = 0,
    options: BitStarOptions = DEFAULTS,
    planner: str = "bitstar",
) -> Path:
    """Return the path of `bitstar`, whose graphs are searched in order of lower bounds."""
    begin_s = time.perf_counter()
    batches = begun(problem, heuristic, options, seed)
    if batches is not None and not batches.is_done:
        _search(cost_grid_of(problem, batches.is_reachable), batches, Budget(begin_s, begin_s + budget_s, max_samples))
    return ended(problem, batches, begin_s, planner, heuristic, "numba")


def _search(cost_grid: CostGrid, batches: Batches, budget: Budget) -> None:
    """Search the graph of one batch after the other, until something ends them."""
    queue = Heap.empty(FIRST_QUEUE, EDGE)
    while not batches.is_done:
        graph = BatchGraph.of(batches.tree.xy, batches.radius, batches.bounds.per_side)
        nodes = batches.tree = batches.tree.ready(graph)
        queue = _filled(queue, nodes.g[nodes.state > 0] + nodes.to_goal[nodes.state > 0])
        while True:
            chunk, num_costed = advance(cost_grid, nodes, queue, graph, CHUNK)
            batches.num_costed += num_costed
            if chunk == FULL:
                queue = queue.grown()
            if chunk == EXHAUSTED or time.perf_counter() >= budget.end_s:
                break
        batches.end(budget)


def _filled(queue: Heap, f: np.ndarray) -> Heap:
    """Return a queue for the expansion of the tree's nodes, by ``[T]`` their f."""
    if len(queue.f) < 2 * len(f):
        queue = Heap.empty(4 * len(f), EDGE)
    order = np.argsort(f, kind="stable")  # sorted is a heap
    edges = queue.item[: len(f)]
    queue.f[: len(f)], edges["origin"], edges["target"], edges["cost"] = f[order], order, order, NOT_COSTED
    queue.size[0] = len(f)
    return queue


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

    Batches are those of `bitstar`, and so is the informed set. Of a batch's graph, and of the tree that the batches
    before left, the cheapest path is found: the cost that Dijkstra's search gives, which never rises from batch to
    batch. All edges that may help are costed, which are more than `bitstar` takes up with ``"numba"``.

    Queries on one map run together, up to `QUERIES_TOGETHER`; ``elapsed_s``, to which the budget applies, is then the
    wall time of all, compiling left out. A batch is made no larger than what the time left is likely to search, but
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
        raise InputError(f"seeds must be one for each of {len(problems)} problems, got {len(seeds)}")
    if any(problem.leg_margin_m for problem in problems):
        raise InputError("BIT* with backend 'jax' tests no legs for this clearance: take backend='numba'")
    budget = Budget(0.0, budget_s, max_samples)

    def paths() -> Generator[tuple[int, Path]]:
        kind = "cpu" if jax.default_backend() == "cpu" else "gpu"
        by_map: dict[int, list[int]] = {}
        for index, problem in enumerate(problems):
            by_map.setdefault(problem.map_key, []).append(index)
        for indices in by_map.values():
            waiting = iter(indices)
            graphs = _Graphs(cost_grid_of(problems[indices[0]], problems[indices[0]].is_free), kind)
            while group := list(islice(waiting, QUERIES_TOGETHER[kind])):
                begin_s = time.perf_counter()
                queries = {index: begun(problems[index], heuristic, options, seeds[index]) for index in group}
                for index, now in _run_together(graphs, queries, budget.later(begin_s)):
                    yield index, ended(problems[index], queries[index], now.begin_s, planner, heuristic, "jax")

    return paths()


def _run_together(
    graphs: "_Graphs", queries: dict[int, Batches | None], budget: Budget
) -> Iterator[tuple[int, Budget]]:
    """Search the queries' graphs batch by batch; yield the number of each that is done, and the budget as it is then.

    JAX works in a thread of its own, as in `planners.frontier`: a Ctrl-C lets it end its turn, and the setting
    for float64 stays there.
    """
    running = {index: batches for index, batches in queries.items() if batches is not None and not batches.is_done}
    yield from ((index, budget) for index in queries if index not in running)
    most_nodes = MOST_NODES[graphs.kind] // max(1, len(running))
    with ThreadPoolExecutor(1, thread_name_prefix="bitstar") as worker:
        while running:
            begin_s = time.perf_counter()
            # Even the smallest graphs take the time of the smallest arrays.
            num_nodes = max(FEWEST_NODES, sum(len(batches.tree.xy) for batches in running.values()))
            compile_s = worker.submit(graphs.search, list(running.values())).result()
            budget = budget.later(compile_s)
            now_s = time.perf_counter()
            nodes_left = num_nodes * max(0.0, budget.end_s - now_s) / (now_s - begin_s - compile_s)
            for index, batches in list(running.items()):
                batches.end(budget, min(most_nodes, nodes_left / len(running)))
                if batches.is_done:
                    yield index, budget
            running = {index: batches for index, batches in running.items() if not batches.is_done}


class _Graphs:
    """The search of sample graphs on one map, which stays on the device, and the room that its arrays need."""

    def __init__(self, cost_grid: CostGrid, kind: str) -> None:
        self.kind = kind
        self._cell_cost: np.ndarray | jax.Array = cost_grid.cell_cost
        _, self._per_side, self._is_line, self._passes_corners, _ = cost_grid
        self._candidates, self._edges = CANDIDATES, EDGES

    def search(self, queries: list[Batches]) -> float:
        """Grow the tree of each query over its graph to the cheapest paths; return the seconds that compiling took."""
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
                    samples, cell_cost, self._per_side, self._passes_corners, is_line=self._is_line, sizes=sizes
                )
                edges = -(-int(trees.num_edges) // len(samples.g))
                if trees.most_candidates <= sizes.candidates and edges <= sizes.edges:
                    break
                self._candidates = max(self._candidates, power_of_two(int(trees.most_candidates)))
                self._edges = max(self._edges, power_of_two(edges))
            g, parent, edge_cost, num_costed = (np.asarray(values) for values in trees[:4])
        first = 0
        for batches in queries:
            here = slice(first, first + len(batches.tree.xy))
            own = np.where(parent[here] == NO_PARENT, NO_PARENT, parent[here] - first).astype(np.int32)
            batches.tree = batches.tree._replace(g=g[here].copy(), parent=own, edge_cost=edge_cost[here].copy())
            batches.num_costed += int(num_costed[here].sum())
            first = here.stop
        return compile_s


@cache
def _compile(num_nodes: int, shape: tuple[int, ...], is_line: bool, sizes: Sizes) -> None:
    """Compile the search for so many nodes on a map of a shape, by a search of none."""
    trees = search_samples(_padded([], num_nodes), jnp.zeros(shape), 1.0, False, is_line=is_line, sizes=sizes)
    jax.block_until_ready(trees)


def _samples(queries: list[Batches]) -> Samples:
    """Return the nodes of all queries, one query after the other."""
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
        parts.append(
            {name: np.full(len(tree.xy), value) for name, value in of_query.items()}
            | {name: getattr(tree, name) for name in Samples._fields if hasattr(tree, name)}
            | {
                "from_start": tree.least_f - tree.to_goal,
                "parent": np.where(tree.parent == NO_PARENT, NO_PARENT, tree.parent + num_nodes).astype(np.int32),
            }
        )
        num_nodes += len(tree.xy)
    room = FEWEST_NODES
    while room < num_nodes:
        room *= 4
    return _padded(parts, room)


def _padded(parts: list[dict[str, np.ndarray]], num_nodes: int) -> Samples:
    """Return the parts in a row, followed by nodes of no query."""
    num_missing = num_nodes - sum(len(part["g"]) for part in parts)
    nothing = {name: np.ones(num_missing) for name in Samples._fields} | {
        "query": np.full(num_missing, NO_QUERY, np.int32),
        "xy": np.ones((num_missing, 2)),
        "parent": np.full(num_missing, NO_PARENT, np.int32),
    }
    return Samples(
        **{name: jnp.asarray(np.concatenate([part[name] for part in [*parts, nothing]])) for name in nothing}
    )
