"""Many queries of BIT* solved together in JAX, by searching all their sample graphs."""

import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import islice

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.kernels.search.sample_graph import NO_QUERY, Samples, Sizes, search_samples
from jaxurban.planners.base import Path, Problem, grouped
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.bitstar.planner import DEFAULTS, Batches, BitStarOptions, check_limits

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


def device_kind() -> str:
    """Return ``"cpu"`` or ``"gpu"``: where JAX computes."""
    return "cpu" if jax.default_backend() == "cpu" else "gpu"


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

    kind = device_kind()

    def paths() -> Generator[tuple[int, Path]]:
        """Yield paths map by map; the queries of a map run together in groups."""
        for indices in grouped(problems, range(len(problems)), lambda problem: problem.cache):
            waiting = iter(indices)
            first = problems[indices[0]]
            graphs = _Graphs(cost_grid_of(first, first.is_free), kind)
            while group := list(islice(waiting, SAMPLED_TOGETHER[kind])):
                # The clock of each query begins now.
                queries = {
                    k: Batches(problems[k], heuristic, options, seeds[k], budget_s, max_samples)
                    for k in group
                }
                for index in _run_together(graphs, queries):
                    yield index, queries[index].path(planner, "jax")

    return paths()


def _run_together(graphs: "_Graphs", queries: dict[int, Batches]) -> Iterator[int]:
    """Search the queries' graphs batch by batch; yield the index of each query when it is done.

    JAX works in a thread of its own, for the reasons given in `tile_search._in_turns`.

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
