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
from typing import get_args

import jax
import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Cell, Path, Problem
from jaxurban.planners.bitstar.batched import solve_batched
from jaxurban.planners.checks import check_budget
from jaxurban.planners.heuristics import AUTO
from jaxurban.planners.landmarks import FEW_QUERIES, NUM_LANDMARKS, make_landmarks
from jaxurban.planners.registry import PLANNERS, find_planner
from jaxurban.planners.search.fields import (
    FIELDS_TOGETHER,
    Backend,
    field_backend,
    share_costs_to_go,
    warm_up_fields,
)
from jaxurban.planners.search.frontier import solve_by_frontier

Outcome = tuple[int, Path | Exception]

EXACT_PLANNERS = ("astar-dist", "astar-plus")  # which the frontier search can stand for
FRONTIER_HEURISTICS = (None, AUTO, "octile")
SAMPLING_PLANNERS = ("bitstar-dist", "bitstar-plus")  # whose batches `solve_batched` searches in bulk
FEW_TO_ONE_GOAL = 8  # queries to one goal from which the costs to it are computed for the whole map
GOALS_TOGETHER = {"numba": 1, "jax": FIELDS_TOGETHER}  # whose fields are made, and held, at once
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
    within half of the budgets of those that share it: the costs to goals that at least `FEW_TO_ONE_GOAL` queries on a
    map share each (``"exact"``), and the landmarks of a map with more than `FEW_QUERIES` others (``"numba"`` only).
    Both are fields, which ``"auto"`` makes in JAX where it has a GPU (see `search.fields.field_backend`). Each path's
    backend and heuristic say what ran; of ``"exact"`` the backend is what made the costs.

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
    find_planner(planner, heuristic)
    if backend not in get_args(Backend):
        raise InputError(f"backend must be one of {', '.join(get_args(Backend))}, got {backend!r}")
    check_budget(budget_s)
    if num_threads is not None and num_threads < 1:
        raise InputError(f"num_threads must be at least 1, got {num_threads}")
    if backend == "jax" and planner in SAMPLING_PLANNERS:
        chosen, seeds = heuristic or PLANNERS[planner].default_heuristic, [seed] * len(problems)
        return solve_batched(problems, planner=planner, heuristic=chosen, seeds=seeds, budget_s=budget_s)
    makes_fields_by = backend
    is_for_frontier = planner in EXACT_PLANNERS and heuristic in FRONTIER_HEURISTICS
    if backend == "jax" and not is_for_frontier:
        raise InputError(
            f"backend 'jax' runs {' and '.join(EXACT_PLANNERS)} with heuristic octile, and "
            f"{' and '.join(SAMPLING_PLANNERS)}, not {planner!r} with {heuristic or 'its own'}: take backend='numba'"
        )
    if backend == "auto":
        has_gpu = is_for_frontier and len(problems) >= GPU_BATCH and jax.default_backend() != "cpu"
        backend = "jax" if has_gpu else "numba"
    num_threads = num_threads or _num_processors()
    return _solve(problems, planner, heuristic, backend, makes_fields_by, budget_s, seed, num_threads)


def _num_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _solve(
    problems: Sequence[Problem],
    planner: str,
    heuristic: str | None,
    backend: str,
    makes_fields_by: Backend,
    budget_s: float,
    seed: int,
    num_threads: int,
) -> Generator[Outcome]:
    search = find_planner(planner, heuristic)
    chooses = (heuristic or PLANNERS[planner].default_heuristic) == AUTO
    by_goal: dict[tuple[int, Cell], list[int]] = {}
    if chooses and planner in EXACT_PLANNERS:
        for index, problem in enumerate(problems):
            by_goal.setdefault((problem.map_key, problem.goal), []).append(index)
    to_one_goal = [indices for indices in by_goal.values() if len(indices) >= FEW_TO_ONE_GOAL]
    alone = sorted(set(range(len(problems))) - set(chain.from_iterable(to_one_goal)))
    run = partial(_in_threads, problems, num_threads=num_threads)
    walk = partial(find_planner(planner, "exact" if to_one_goal else None), budget_s=budget_s, seed=seed)
    made_by = field_backend(makes_fields_by) if to_one_goal else "numba"
    for first in range(0, len(to_one_goal), GOALS_TOGETHER[made_by]):
        groups = to_one_goal[first : first + GOALS_TOGETHER[made_by]]
        to_goals = [problems[indices[0]] for indices in groups]
        warm_up_fields(to_goals, made_by)
        end_s = time.perf_counter() + 0.5 * budget_s * sum(map(len, groups))
        try:
            share_costs_to_go(to_goals, made_by, end_s)
        except TimeoutError:
            alone += chain.from_iterable(groups)
            continue
        for index, outcome in run(list(chain.from_iterable(groups)), walk):
            yield index, replace(outcome, backend=made_by) if isinstance(outcome, Path) else outcome
    if backend == "jax":
        together = [problems[index] for index in alone]
        for k, path in solve_by_frontier(together, planner=planner, budget_s=budget_s):
            yield alone[k], path
        return
    if chooses:
        _make_landmarks([problems[index] for index in alone], makes_fields_by, budget_s)
    yield from run(alone, partial(search, budget_s=budget_s, seed=seed))


def _make_landmarks(problems: list[Problem], makes_fields_by: Backend, budget_s: float) -> None:
    """Make the landmarks of every map with more than a few queries, unless they take half of the budgets."""
    for key, count in Counter(problem.map_key for problem in problems).items():
        if count > FEW_QUERIES:
            first = next(problem for problem in problems if problem.map_key == key)
            warm_up_fields([first] * NUM_LANDMARKS, makes_fields_by)
            with suppress(TimeoutError):
                make_landmarks(first, backend=makes_fields_by, end_s=time.perf_counter() + 0.5 * budget_s * count)


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
