"""BIT*: batch informed trees, an anytime planner that leaves the grid (Gammell, Srinivasa & Barfoot 2015)."""

import time
from functools import partial

import numpy as np

from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import EXHAUSTED, FULL, Heap
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.bitstar.batched import solve_batched
from jaxurban.planners.bitstar.batches import (
    DEFAULTS,
    Batches,
    BitStarOptions,
    Budget,
    begun,
    check_limits,
    ended,
)
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.bitstar.search import EDGE, NOT_COSTED, BatchGraph, advance
from jaxurban.planners.compiled_first import compiled_first

CHUNK = 20_000  # queue entries between two looks at the clock: some 20 ms
FIRST_QUEUE = 4096  # entries; doubled when full


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
        tree, start, goal, buckets = batches.tree.in_buckets(batches.radius, batches.start, batches.goal)
        batches.tree, batches.start, batches.goal = tree, start, goal
        nodes = tree.nodes(batches.radius, buckets)
        graph = BatchGraph(goal, batches.radius, batches.bounds.per_side, buckets)
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
