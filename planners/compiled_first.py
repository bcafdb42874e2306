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
    """Return a decorator of planners, and of what alters their paths: all that one runs is compiled before its clock.

    That is done by a plan across a few cells, or with a path there. Paths carry as ``setup_s`` how long it took,
    loading from Numba's cache included.

    Args:
      options: of the plan across a few cells, beside the heuristic.
    """

    def decorate(planner: Callable[..., Path]) -> Callable[..., Path]:
        """Return the planner, which compiles off the clock before its first problem of each kind."""
        warmed: set[Hashable] = set()  # kinds of problems for which nothing is left to compile

        @functools.wraps(planner)
        def run(problem: Problem, *alteration: Any, **query: Any) -> Path:
            chosen = {"heuristic": query["heuristic"]} if "heuristic" in query else {}
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
      planner: or what alters a planner's path.
      problem: gives the types of the few cells.
      alteration: the path and what follows it in the arguments, where one is altered; a path of a few points stands
        for it.
      options: of the planner.
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
    """Return a problem of the same types where only length costs, and the straight way is blocked: all code runs."""
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
    """Return a path around the blocked cells of a problem of a few, so near to them that it has to be moved."""
    x_m = 1.0 - max(few.leg_margin_m, 0.01)
    points_m = np.array([[2.5, 0.5], [x_m, 0.5], [x_m, 4.5], [2.5, 4.5]])
    points_m = points_m if few.levels_m is None else np.column_stack([points_m, np.zeros(4)])
    return Path.of(few, points_m, Status.FEASIBLE, 0.0, 0.0, num_expanded=0, planner="")
