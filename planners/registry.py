"""The planners by name, on one altitude and between levels; many problems at once, in threads or together in JAX."""

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

import numpy as np

from jaxurban.checks import at_least, nearest_name, one_of, values_given
from jaxurban.errors import InputError
from jaxurban.planners.any_angle import ptp, theta_star
from jaxurban.planners.astar import (
    AUTO,
    HEURISTICS,
    NUM_LANDMARKS,
    VOLUME_HEURISTICS,
    astar_auto,
    astar_dist,
    astar_plus,
    exact_cost_to_go,
    make_landmarks,
    volume_astar,
)
from jaxurban.planners.base import Cell, Path, Problem, ProblemCache, grouped
from jaxurban.planners.bitstar.bounds import HEURISTICS as OFF_GRID_HEURISTICS
from jaxurban.planners.bitstar.planner import bitstar_dist, bitstar_plus
from jaxurban.settings import DEFAULTS, Backend

Outcome = tuple[int, Path | Exception]

EXACT_PLANNERS = ("astar", "astar-dist", "astar-plus")  # which the search by tiles can stand for
TILED_HEURISTICS = (None, AUTO, "octile")
# Whose batches `solve_batched` searches in bulk.
SAMPLING_PLANNERS = ("bitstar-dist", "bitstar-plus")
FEW_TO_ONE_GOAL = 8  # queries to one goal from which the costs to it are computed for the whole map
# Others on one map and weights beyond which landmarks are made. On Lower Manhattan making them costs what some 50
# queries save (docs/algorithms/search.md).
FEW_QUERIES = 16
# Of one field, cautious: 7e6 on half a million cells, less where the map outgrows the cache.
NODES_PER_S = 3e6
GPU_BATCH = 32  # queries from which a GPU is worth its start


@dataclass(frozen=True)
class PlannerEntry:
    """A planner and the heuristics that it takes.

    Attributes:
      run: the planner; takes ``heuristic=`` beside the contract's arguments if it has heuristics.
      summary: one line for help texts and tables.
      default_heuristic: ``"none"`` for a planner that uses none.
      heuristics: names it accepts as ``heuristic=``; empty for a planner that uses none.
    """

    run: Callable[..., Path]
    summary: str
    default_heuristic: str = "none"
    heuristics: tuple[str, ...] = ()


PLANNERS = {
    "ptp": PlannerEntry(ptp, "the straight segment from start to goal"),
    "astar": PlannerEntry(
        astar_auto, "A*: the cheapest path on the grid, with a proof", AUTO, (AUTO, *HEURISTICS)
    ),
    "astar-dist": PlannerEntry(
        astar_dist, "A* guided by the straight distance", "euclidean", (AUTO, *HEURISTICS)
    ),
    "astar-plus": PlannerEntry(
        astar_plus, "A* guided by distance and map costs", AUTO, (AUTO, *HEURISTICS)
    ),
    "bitstar-dist": PlannerEntry(
        bitstar_dist,
        "batch informed trees guided by the straight distance",
        "euclidean",
        OFF_GRID_HEURISTICS,
    ),
    "bitstar-plus": PlannerEntry(
        bitstar_plus,
        "batch informed trees guided by distance and map costs",
        "plus",
        OFF_GRID_HEURISTICS,
    ),
    "theta-star": PlannerEntry(
        theta_star, "any-angle search, for the line cost model only", "plus", OFF_GRID_HEURISTICS
    ),
}
# One planner of each method: what A* finds costs the same under either heuristic of the paper, by proof.
BY_METHOD = tuple(name for name in PLANNERS if name not in ("astar-dist", "astar-plus"))
VOLUME_PLANNERS = {
    "astar-volume": PlannerEntry(
        volume_astar,
        "A* between levels, for paths that climb and descend",
        "plus",
        VOLUME_HEURISTICS,
    ),
}


def find_planner(
    name: str,
    heuristic: str | None = None,
    *,
    is_for_volumes: bool = False,
    backend: Backend = "auto",
) -> Callable[..., Path]:
    """Return the planner of a name, with its own heuristic or the one given.

    Args:
      name: a key of `PLANNERS`, or of `VOLUME_PLANNERS` if ``is_for_volumes``.
      heuristic: name of the heuristic; left out, the planner's own.
      is_for_volumes: whether the planner must fly between levels, rather than on one altitude.
      backend: ``"jax"`` for one that searches in JAX, as `solve_many` does; else one in Numba.

    Raises:
      InputError: an unknown planner or backend, or a heuristic or backend that it does not take.
    """
    fitting = VOLUME_PLANNERS if is_for_volumes else PLANNERS
    where = "in a volume" if is_for_volumes else "on one altitude"
    entry = fitting[one_of(f"planner {where}", name, fitting)]
    if heuristic is not None and heuristic not in entry.heuristics:
        remedy = "leave it out"
        if entry.heuristics:
            remedy = f"choose one of {', '.join(entry.heuristics)}"
        nearest = nearest_name(heuristic, entry.heuristics)
        raise InputError(f"planner {name!r} takes no heuristic {heuristic!r}{nearest}: {remedy}")
    one_of("backend", backend, get_args(Backend))
    if backend == "jax":
        is_for_tiles = name in EXACT_PLANNERS and heuristic in TILED_HEURISTICS
        if name not in SAMPLING_PLANNERS and not is_for_tiles:
            raise InputError(
                f"backend 'jax' runs {' and '.join(EXACT_PLANNERS)} with heuristic octile, and "
                f"{' and '.join(SAMPLING_PLANNERS)}, not {name!r} with {heuristic or 'its own'}: take backend='numba'"
            )
        return partial(_in_jax, planner=name, heuristic=heuristic)
    return entry.run if heuristic is None else partial(entry.run, heuristic=heuristic)


def _in_jax(problem: Problem, **query: Any) -> Path:
    """Return the path of a single query by a planner in JAX; arguments are those of `solve_many`."""
    ((_, path),) = solve_many([problem], backend="jax", **query)
    if isinstance(path, Exception):
        raise path
    return path


def solve_many(
    problems: Sequence[Problem],
    *,
    planner: str = DEFAULTS.planner,
    heuristic: str | None = None,
    backend: Backend = "auto",
    budget_s: float = np.inf,
    max_samples: int | None = None,
    seed: int = 0,
    num_threads: int | None = None,
    only: Sequence[int] | None = None,
) -> Generator[Outcome]:
    """Yield ``(index, path)`` of every problem as it is done; a planner's crash is an exception in the path's place.

    Close the iterator, or let Ctrl-C end the loop over it, to stop: no further search begins, and what was
    yielded is yours.

    - ``"numba"``: the planner itself, query by query, on ``num_threads`` threads. The compiled A* leaves them free to
      run side by side.
    - ``"jax"``: the queries on a map together; for those of A* by tiles, which gives their
      results (see `solve_by_tiles`), for ``bitstar-dist`` and ``bitstar-plus`` batch by batch (see `solve_batched`).
    - ``"auto"``: ``"jax"`` where JAX has a GPU, the planner is of A* and there are at least
      `GPU_BATCH` queries; else ``"numba"``, which is several times as fast on a CPU.

    Where the planner chooses its heuristic itself, as ``astar`` does, `choose_heuristics` does so from all
    problems, and what queries share is made first: fields, by Dijkstra's search in Numba, on which ``"exact"`` walks in
    Numba too. Each path's backend and heuristic say what ran.

    Args:
      problems: the queries; those on one map should come from one `Problem` by `Problem.between`.
      planner, heuristic: names as in the registry.
      backend: see above.
      budget_s: seconds for each query.
      max_samples: for each query, of planners that draw samples.
      seed: for each query.
      num_threads: of ``"numba"``; left out, one for every processor that this process may use.
      only: the problems to solve, by number; what is chosen depends on all of them.

    Raises:
      InputError: an unknown planner, heuristic or backend, a planner or heuristic that ``"jax"`` does not
        have, or a wrong number of threads.
    """
    find_planner(planner, heuristic, backend=backend)  # raises the errors
    import jax  # here, like all that it computes with: the names of planners are checked without it

    from jaxurban.kernels.engine import num_cores
    from jaxurban.planners.bulk import solve_batched
    from jaxurban.planners.tile_search import solve_by_tiles

    if num_threads is not None:
        at_least("num_threads", num_threads, 1)
    only = range(len(problems)) if only is None else only
    if backend == "jax" and planner in SAMPLING_PLANNERS:
        some = [problems[k] for k in only]
        paths = solve_batched(
            some,
            planner=planner,
            heuristic=heuristic or PLANNERS[planner].default_heuristic,
            seeds=[seed] * len(some),
            budget_s=budget_s,
            max_samples=max_samples,
        )
        return ((only[k], path) for k, path in paths)

    # All else is chosen now, from all problems, and run as the iterator goes on.
    runs_in_jax = backend == "jax"
    if backend == "auto" and planner in EXACT_PLANNERS and heuristic in TILED_HEURISTICS:
        runs_in_jax = len(problems) >= GPU_BATCH and jax.default_backend() != "cpu"
    num_threads = num_threads or num_cores()
    heuristics = choose_heuristics(problems, planner, heuristic, budget_s)
    run = partial(_in_threads, problems, num_threads=num_threads)
    samples = values_given({"max_samples": max_samples})

    def outcomes() -> Generator[Outcome]:
        """Yield the outcomes: first of queries that share a goal, then of all others by heuristic, or together in JAX.

        The fields that queries share are made before these queries run, and kept in the cache of their map.
        """
        # Queries that share a goal. Under "exact" by name each query makes its goal's field itself, in its thread.
        shared = []
        if heuristic != "exact":
            shared = [k for k in only if heuristics[k] == "exact"]
        for same_goal in grouped(problems, shared, _map_and_goal):
            # This fills the cache with the goal's field, on which the searches only walk down.
            exact_cost_to_go(problems[same_goal[0]])
            walk = partial(find_planner(planner, "exact"), budget_s=budget_s, seed=seed)
            yield from run(same_goal, walk)

        # Landmarks are made next, once for each map that needs them, into its cache.
        alone = sorted(set(only) - set(shared))
        for k in alone:
            if heuristics[k] == "landmarks":
                make_landmarks(problems[k])

        # All others together in JAX, or by heuristic.
        if runs_in_jax:
            together = [problems[k] for k in alone]
            for k, path in solve_by_tiles(together, planner=planner, budget_s=budget_s):
                yield alone[k], path
            return

        for name in dict.fromkeys(heuristics[k] for k in alone):
            search = partial(find_planner(planner, name), budget_s=budget_s, seed=seed, **samples)
            yield from run([k for k in alone if heuristics[k] == name], search)

    return outcomes()


def _map_and_goal(problem: Problem) -> tuple[ProblemCache, Cell]:
    return problem.cache, problem.goal


def choose_heuristics(
    problems: Sequence[Problem], planner: str, heuristic: str | None, budget_s: float
) -> list[str | None]:
    """Return the heuristic of each problem; it depends on all problems, on no clock and on nothing solved before.

    For a planner that chooses its heuristic: ``"exact"`` for goals that at least `FEW_TO_ONE_GOAL` queries on a map
    share (A* alone), ``"landmarks"`` on a map with more than `FEW_QUERIES` other queries; but only if making the fields
    should take no more than half of the budgets of the queries that share them. Otherwise the heuristic given; None
    stands for the planner's default.

    Args:
      problems: all queries.
      planner: name of the planner.
      heuristic: name of the heuristic asked for; None for the planner's own.
      budget_s: seconds for each query.
    """
    heuristics = [heuristic] * len(problems)
    if (heuristic or PLANNERS[planner].default_heuristic) != AUTO:
        return heuristics
    others: list[int] = []

    def choose(name: str, indices: list[int], fewest: int, num_fields: int) -> bool:
        """Set a heuristic for problems on one map if they are enough for its fields; return whether it was set."""
        expected_s = num_fields * problems[indices[0]].is_free.size / NODES_PER_S
        is_chosen = len(indices) >= fewest and expected_s <= 0.5 * budget_s * len(indices)
        for index in indices if is_chosen else ():
            heuristics[index] = name
        return is_chosen

    for indices in grouped(problems, range(len(problems)), _map_and_goal):
        if planner not in EXACT_PLANNERS or not choose("exact", indices, FEW_TO_ONE_GOAL, 1):
            others += indices
    for indices in grouped(problems, others, lambda problem: problem.cache):
        choose("landmarks", indices, FEW_QUERIES + 1, NUM_LANDMARKS)
    return heuristics


def _in_threads(
    problems: Sequence[Problem],
    indices: list[int],
    search: Callable[[Problem], Path],
    num_threads: int,
) -> Iterator[Outcome]:
    """Yield ``(index, path)`` of each search as it ends, or the exception that it raised in the path's place.

    Only twice as many searches as threads are begun ahead, so that closing the generator ends soon. A KeyboardInterrupt
    or the like in a search is raised here.

    Args:
      problems: all queries.
      indices: which of these to search.
      search: the planner.
      num_threads: threads that search at a time.
    """
    waiting = iter(indices)
    running: dict[Future[Path], int] = {}
    pool = ThreadPoolExecutor(num_threads, thread_name_prefix="planner")
    try:
        while True:
            # Begin searches up to the limit, then wait for one or more to end.
            for index in waiting:
                running[pool.submit(search, problems[index])] = index
                if len(running) >= 2 * num_threads:
                    break
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                index = running.pop(future)
                error = future.exception()
                if error is not None and not isinstance(error, Exception):
                    raise error
                yield index, future.result() if error is None else error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
