"""Compiling before the clock: a planner's budget and its times are of the search alone."""

import functools
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from jaxurban.planners.base import Cell, Path, Problem, Status

_COMPILING = threading.RLock()  # other threads wait here, before their clocks start


def compiled_first(**options: Any) -> Callable[[Callable[..., Path]], Callable[..., Path]]:
    """Return a decorator of planners, and of functions that alter paths: it compiles all that they run off the clock.

    Before its first problem of each kind the function is called with a problem (and a path) of a few cells. The path
    that it returns then carries as ``setup_s`` how long that took, loading from Numba's cache included.

    Args:
      options: of the call with a few cells, beside the heuristic.
    """

    def decorate(planner: Callable[..., Path]) -> Callable[..., Path]:
        """Return the planner, which compiles off the clock before its first problem of each kind."""
        # Kinds of problems for which nothing is left to compile. The set lives as long as what it tells of, the machine
        # code that Numba holds for the process, and decides only when to compile, never what a planner returns.
        warmed: set[Hashable] = set()

        @functools.wraps(planner)
        def run(problem: Problem, *alteration: Any, **query: Any) -> Path:
            """Return the planner's path, the function compiled for the problem's kind first.

            Args:
              problem: the query.
              alteration: of a function that alters paths, the path and what follows it.
              query: other arguments of the function.
            """
            chosen = {"heuristic": query["heuristic"]} if "heuristic" in query else {}
            # What Numba compiles for depends on these.
            kind = (
                *chosen.values(),
                problem.costs.dtype,
                problem.is_free.ndim,
                problem.cost_model,
                problem.leg_margin_m > 0,
            )
            setup_s = 0.0
            with _COMPILING:
                if kind not in warmed:
                    setup_s = warm_up(planner, problem, *alteration, **chosen, **options)
                    warmed.add(kind)
            path = planner(problem, *alteration, **query)
            return replace(path, setup_s=path.setup_s + setup_s) if setup_s else path

        return run

    return decorate


def warm_up(
    planner: Callable[..., Path], problem: Problem, *alteration: Any, **options: Any
) -> float:
    """Compile all that a planner runs on a problem, by a plan across a few cells, and return the seconds it took.

    Args:
      planner: a planner, or a function that alters a planner's path.
      problem: whose types and cost model the problem of a few cells has.
      alteration: empty for a planner; else the path, in whose place a path of a few points is altered, and the
        arguments that follow it.
      options: other arguments of the planner.
    """
    begin_s = time.perf_counter()
    few = _few_cells(problem)
    if alteration:
        _, *settings = alteration
        planner(few, _few_points(few), *settings, **options)
    else:
        planner(few, **options)
    return time.perf_counter() - begin_s


def _few_cells(problem: Problem) -> Problem:
    """Return a problem of 5 by 5 cells of 1 m, so small that planning takes no time.

    It has the types, the cost model and the number of layers of the problem given. Only length costs, and the straight
    way is blocked, so that all code of a planner runs.
    """
    is_free = np.ones((5, 5), np.bool_)
    is_free[2, 1:4] = False
    start: Cell = (0, 2)
    goal: Cell = (4, 2)
    levels_m = None
    if problem.levels_m is not None:
        levels_m = np.arange(2.0)
        is_free = np.stack([is_free, is_free])
        start = (0, *start)
        goal = (1, *goal)
    costs = np.zeros((len(problem.costs), *is_free.shape), problem.costs.dtype)
    margin_m = 0.25 if problem.leg_margin_m else 0.0
    return Problem(costs, is_free, start, goal, 1.0, 1.0, problem.cost_model, levels_m, margin_m)


def _few_points(few: Problem) -> Path:
    """Return a path around the blocked cells of `_few_cells`, so near to them that a function has to move it."""
    x_m = 1.0 - max(few.leg_margin_m, 0.01)
    points_m = np.array([[2.5, 0.5], [x_m, 0.5], [x_m, 4.5], [2.5, 4.5]])
    points_m = points_m if few.levels_m is None else np.column_stack([points_m, np.zeros(4)])
    return Path.of(few, points_m, Status.FEASIBLE, 0.0, 0.0, num_expanded=0, planner="")
