"""Many problems at once: in threads with the compiled searches, or all together in JAX."""

import os
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Literal, get_args

import jax
import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Cell, Path, Problem
from jaxurban.planners.bitstar.batched import solve_batched
from jaxurban.planners.checks import check_budget
from jaxurban.planners.heuristics import AUTO
from jaxurban.planners.landmarks import FEW_QUERIES, make_landmarks
from jaxurban.planners.registry import PLANNERS, find_planner
from jaxurban.planners.search.fields import share_cost_to_go
from jaxurban.planners.search.frontier import solve_by_frontier

Backend = Literal["auto", "numba", "jax"]
Outcome = tuple[int, Path | Exception]

EXACT_PLANNERS = ("astar-dist", "astar-plus")  # which the frontier search can stand for
FRONTIER_HEURISTICS = (None, AUTO, "octile")
SAMPLING_PLANNERS = ("bitstar-dist", "bitstar-plus")  # whose batches `solve_batched` searches in bulk
FEW_TO_ONE_GOAL = 8  # queries to one goal from which the costs to it are computed for the whole map
GPU_BATCH = 32  # queries from which a GPU is worth its start


def solve_many(
    problems: Sequence[Problem],
    *,
    planner: str = "astar-plus",
    heuristic: str | None = None,
    backend: Backend = "auto",
    budget_s: float = np.inf,
    seed: int = 0,
    num_threads: int | None = None,
) -> Generator[Outcome]:
    """Yield ``(index, path)`` of every problem as it is done; a planner's crash is an exception in the path's place.

    Close the iterator, or let Ctrl-C end the loop over it, to stop: no further search begins, and what was
    yielded is yours.

    - ``"numba"``: the planner itself, query by query, on ``num_threads`` threads. The compiled A* leaves them
      free to run side by side.
    - ``"jax"``: all queries together; for ``astar-dist`` and ``astar-plus`` by the frontier search, which gives their
      results (see `solve_by_frontier`), for ``bitstar-dist`` and ``bitstar-plus`` batch by batch (see `solve_batched`).
    - ``"auto"``: ``"jax"`` where JAX has a GPU, the planner is ``astar-dist`` or ``astar-plus`` and there are at least
      `GPU_BATCH` queries; else ``"numba"``, which is several times as fast on a CPU.

    Where the planner chooses its heuristic itself, as ``astar-plus`` does, what queries share is made first,
    within half of the budgets of those that share it: the cost to go to a goal that at least `FEW_TO_ONE_GOAL`
    queries on a map share (``"exact"``; with ``"jax"`` by row sweeps), and the landmarks of a map with more than
    `FEW_QUERIES` others (``"numba"`` only). Each path's backend and heuristic say what ran.

    Args:
      problems: the queries; those on one map should come from one `Problem` by `Problem.between`.
      planner, heuristic: names as in the registry.
      backend: see above.
      budget_s: seconds for each query.
      seed: for each query.
      num_threads: of ``"numba"``; left out, one for every processor that this process may use.

    Raises:
      InputError: an unknown planner, heuristic or backend, a planner or heuristic that ``"jax"`` does not
        have, or a budget or number of threads that is not positive.
    """
    search = find_planner(planner, heuristic)
    if backend not in get_args(Backend):
        raise InputError(f"backend must be one of {', '.join(get_args(Backend))}, got {backend!r}")
    check_budget(budget_s)
    if num_threads is not None and num_threads < 1:
        raise InputError(f"num_threads must be at least 1, got {num_threads}")
    own_heuristic = heuristic or PLANNERS[planner].default_heuristic
    if backend == "jax" and planner in SAMPLING_PLANNERS:
        seeds = [seed] * len(problems)
        return solve_batched(problems, planner=planner, heuristic=own_heuristic, seeds=seeds, budget_s=budget_s)
    is_for_frontier = planner in EXACT_PLANNERS and heuristic in FRONTIER_HEURISTICS
    if backend == "jax" and not is_for_frontier:
        raise InputError(
            f"backend 'jax' runs {' and '.join(EXACT_PLANNERS)} with heuristic octile, and "
            f"{' and '.join(SAMPLING_PLANNERS)}, not {planner!r} with {heuristic or 'its own'}: take backend='numba'"
        )
    if backend == "auto":
        has_gpu = is_for_frontier and len(problems) >= GPU_BATCH and jax.default_backend() != "cpu"
        backend = "jax" if has_gpu else "numba"
    return _solve(
        problems, planner, search, own_heuristic == AUTO, backend, budget_s, seed, num_threads or _num_processors()
    )


def _num_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _solve(
    problems: Sequence[Problem],
    planner: str,
    search: Callable[..., Path],
    chooses: bool,
    backend: str,
    budget_s: float,
    seed: int,
    num_threads: int,
) -> Generator[Outcome]:
    by_goal: dict[tuple[int, Cell], list[int]] = {}
    if chooses and planner in EXACT_PLANNERS:
        for index, problem in enumerate(problems):
            by_goal.setdefault((id(problem.cost), problem.goal), []).append(index)
    to_one_goal = [indices for indices in by_goal.values() if len(indices) >= FEW_TO_ONE_GOAL]
    alone = sorted(set(range(len(problems))) - set(chain.from_iterable(to_one_goal)))
    run = partial(_in_threads, problems, num_threads=num_threads)
    walk = partial(find_planner(planner, "exact" if to_one_goal else None), budget_s=budget_s, seed=seed)
    for indices in to_one_goal:
        end_s = time.perf_counter() + 0.5 * budget_s * len(indices)
        try:
            share_cost_to_go(problems[indices[0]], backend, end_s)
        except TimeoutError:
            alone += indices
            continue
        for index, outcome in run(indices, walk):
            yield index, replace(outcome, backend=backend) if isinstance(outcome, Path) else outcome
    if backend == "jax":
        together = [problems[index] for index in alone]
        for k, path in solve_by_frontier(together, planner=planner, budget_s=budget_s):
            yield alone[k], path
        return
    if chooses:
        _make_landmarks([problems[index] for index in alone], budget_s)
    yield from run(alone, partial(search, budget_s=budget_s, seed=seed))


def _make_landmarks(problems: list[Problem], budget_s: float) -> None:
    """Make the landmarks of every map with more than a few queries, unless they take half of the budgets."""
    for key, count in Counter(id(problem.cost) for problem in problems).items():
        if count > FEW_QUERIES:
            first = next(problem for problem in problems if id(problem.cost) == key)
            with suppress(TimeoutError):
                make_landmarks(first, end_s=time.perf_counter() + 0.5 * budget_s * count)


def _in_threads(
    problems: Sequence[Problem], indices: list[int], search: Callable[[Problem], Path], num_threads: int
) -> Iterator[Outcome]:
    """Yield the outcome of each search as it ends; few are begun ahead, so that closing stops soon."""
    waiting = iter(indices)
    running: dict[Future[Path], int] = {}
    pool = ThreadPoolExecutor(num_threads, thread_name_prefix="planner")
    try:
        while True:
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
