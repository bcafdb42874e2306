"""Costs to one goal from everywhere, for the queries that share it."""

import time
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from jaxurban.kernels.search.cost_to_go import cost_to_go
from jaxurban.planners import landmarks
from jaxurban.planners.base import Problem
from jaxurban.planners.graph import graph_of
from jaxurban.planners.moves import STEPS

ROUNDS_AT_ONCE = 4  # between two looks at the clock


def share_cost_to_go(problem: Problem, backend: str, end_s: float = np.inf) -> np.ndarray:
    """Return ``[Y, X]`` the exact cost from every cell to the goal, inf without a way.

    The field is kept with the map for all queries to the same goal, until another goal's takes its place: a
    search with ``heuristic="exact"`` then walks down on it.

    Args:
      problem: the query; its start plays no part.
      backend: ``"numba"`` (Dijkstra's search) or ``"jax"`` (row sweeps, which suit a GPU).
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      TimeoutError: the clock passed it.
    """
    if backend == "numba":
        return landmarks.cost_to_go(problem, end_s)
    # In a thread that a Ctrl-C lets end: see `frontier`.
    with ThreadPoolExecutor(1, thread_name_prefix="cost-to-go") as worker:
        field = worker.submit(_swept, problem, end_s).result()
    problem.shared["cost_to_go"] = problem.goal, field
    return field


def _swept(problem: Problem, end_s: float) -> np.ndarray:
    """Return the field by row sweeps in JAX."""
    graph = graph_of(problem)
    start = np.full((1, *problem.cost.shape), np.inf)
    start[0, *problem.goal] = 0.0
    with jax.enable_x64(True):
        cost, moves, field = jax.device_put((problem.cost, problem.moves, start))
        shares = (graph.step_cost, graph.from_share, graph.to_share)
        is_final = False
        while not is_final:
            if time.perf_counter() >= end_s:
                raise TimeoutError
            field, is_final = cost_to_go(field, cost, moves, *shares, STEPS, ROUNDS_AT_ONCE)
        return np.asarray(field[0])
