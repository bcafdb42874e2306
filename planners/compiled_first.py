"""Compiling before the clock: a planner's budget and its times are of the search alone."""

import functools
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from jaxurban.planners.base import Path, Problem

_COMPILED: set[Hashable] = set()  # runs that compile nothing any more; no result depends on it
_COMPILING = threading.Lock()  # threads wait here, before their clocks start


def compiled_first(**options: Any) -> Callable[[Callable[..., Path]], Callable[..., Path]]:
    """Return a decorator of planners: all that one runs is compiled, by a plan across a few cells, before its clock.

    Paths carry as ``setup_s`` how long that took, loading from Numba's cache included.

    Args:
      options: of the plan across a few cells, beside the heuristic.
    """

    def decorate(planner: Callable[..., Path]) -> Callable[..., Path]:
        @functools.wraps(planner)
        def run(problem: Problem, **asked: Any) -> Path:
            setup_s = 0.0
            chosen = {"heuristic": asked["heuristic"]} if "heuristic" in asked else {}
            kinds = (planner, *chosen.values(), problem.costs.dtype, problem.is_free.ndim, problem.cost_model)
            kinds += (problem.leg_margin_m > 0,)
            with _COMPILING:
                if kinds not in _COMPILED:
                    begin_s = time.perf_counter()
                    planner(_few_cells(problem), **chosen, **options)
                    _COMPILED.add(kinds)
                    setup_s = time.perf_counter() - begin_s
            return replace(planner(problem, **asked), setup_s=setup_s)

        return run

    return decorate


def power_of_two(number: int) -> int:
    """Return the least power of two that is not below a number, so that few shapes are compiled."""
    return 1 << (number - 1).bit_length()


def _few_cells(problem: Problem) -> Problem:
    """Return a problem of the same types where only length costs, and the straight way is blocked: all code runs."""
    is_volume = problem.levels_m is not None
    is_free = np.ones((2, 5, 5) if is_volume else (5, 5), np.bool_)
    is_free[..., 2, 1:4] = False
    costs = np.zeros((len(problem.costs), *is_free.shape), problem.costs.dtype)
    start, goal = ((0, 0, 2), (1, 4, 2)) if is_volume else ((0, 2), (4, 2))
    levels_m = np.arange(2.0) if is_volume else None
    margin_m = 0.25 if problem.leg_margin_m else 0.0
    return Problem(costs, is_free, start, goal, 1.0, 1.0, problem.cost_model, levels_m, margin_m)
