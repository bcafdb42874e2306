"""BIT*: batch informed trees, an anytime planner that leaves the grid (Gammell, Srinivasa & Barfoot 2015)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import EXHAUSTED, FULL, Heap
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.bitstar.bounds import HEURISTICS, Bounds, make_bounds
from jaxurban.planners.bitstar.bulk import BULK, BulkCosts, chosen_backend
from jaxurban.planners.bitstar.samples import InformedSet, graph_radius
from jaxurban.planners.bitstar.search import COSTS_WANTED, EDGE, NOT_COSTED, BatchGraph, advance, put_back
from jaxurban.planners.bitstar.tree import Tree
from jaxurban.planners.checks import check_budget, check_name, free_ride
from jaxurban.planners.cost import warm_up as warm_up_features
from jaxurban.planners.cost_grid import cost_grid_of, reachable_cells

CHUNK = 20_000  # queue entries between two looks at the clock: some 20 ms
FIRST_QUEUE = 4096  # entries; doubled when full
MOST_IN_A_BATCH = 100_000  # samples, so that the clock is looked at between them
ROUNDING = 1 + 1e-12  # a path that much above the lower bound is the best one


@dataclass(frozen=True)
class BitStarOptions:
    """How batches are made, what ends a search beside time and samples, and how it is run.

    Attributes:
      batch_samples: samples of a batch, at least.
      growth: samples of a batch per sample in use, at least; up to 100,000. 0 keeps batches even.
      eta: factor of the radius, > 1 for paths that come ever nearer to the optimum.
      max_batches: end after so many.
      target_cost: end with a path this cheap.
      min_improvement: end with the first batch that improves a path by a smaller share of its cost.
      backend: what costs the edges: ``"numba"`` one by one as each comes first in the queue, ``"jax"`` up to
        1024 at a time on JAX's device, some of them in vain; ``"auto"`` picks (`bitstar.bulk.chosen_backend`).
      on_batch: called with each `Batch` when it ends, to draw or record it; its time counts towards the budget.

    Raises:
      InputError: a number out of its range.
    """

    batch_samples: int = 100
    growth: float = 1.0
    eta: float = 1.1
    max_batches: int | None = None
    target_cost: float = 0.0
    min_improvement: float = 0.0
    backend: str = "numba"
    on_batch: "Callable[[Batch], None] | None" = None

    def __post_init__(self) -> None:
        if not 1 <= self.batch_samples < np.inf:
            raise InputError(f"batch_samples must be a whole number >= 1, got {self.batch_samples}")
        if not 0 < self.eta < np.inf:
            raise InputError(f"eta must be a positive number, got {self.eta}")
        for name in ("growth", "target_cost", "min_improvement"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a number >= 0, got {getattr(self, name)}")
        _check_count("max_batches", self.max_batches)


def _check_count(name: str, value: int | None) -> None:
    if value is not None and not value >= 0:
        raise InputError(f"{name} must be a whole number >= 0, got {value}")


class Budget(NamedTuple):
    """What ends a search beside its options.

    Attributes:
      begin_s, end_s: of `time.perf_counter`.
      max_samples: None: no limit.
    """

    begin_s: float
    end_s: float
    max_samples: int | None = None


class Found(NamedTuple):
    """What a search found. ``N`` points.

    Attributes:
      xy: ``[N, 2]`` in cell sides; none without a path.
      is_spent: whether a limit of time, batches or samples ended it.
      num_costed: edges whose cost was computed.
      history: after each batch: seconds, samples drawn, cost.
    """

    xy: np.ndarray
    is_spent: bool
    num_costed: int
    history: list[tuple[float, int, float]]


class Batch(NamedTuple):
    """What an observer is shown when a batch ends. ``K`` samples, ``P`` nodes of the path.

    Attributes:
      number: 0 for the straight segment, then 1, 2 ...
      samples: ``[K, 2]`` x, y of what the batch added, in cell sides, as all of the tree.
      tree: start, goal and samples as the search left them, before any is pruned; those with an infinite ``g``
        are not joined. Not to be altered.
      path: ``[P]`` nodes of the best path, the start first; none without a path.
      cost: of that path, inf without one.
    """

    number: int
    samples: np.ndarray
    tree: Tree
    path: np.ndarray
    cost: float


def bitstar(
    problem: Problem,
    *,
    budget_s: float = 10.0,
    seed: int = 0,
    heuristic: str = "plus",
    max_samples: int | None = None,
    options: BitStarOptions = BitStarOptions(),
    planner: str = "bitstar",
) -> Path:
    """Return the best path found through random samples of the free cells, better the longer it runs.

    Each batch adds samples where a cheaper path may lead, joins all within the radius of theory, and
    searches that graph in order of lower bounds, keeping the tree. Batch 0 is the straight segment.
    Edges are costed, and tested for obstacles, over the exact cells that they cross. With a limit of
    batches or samples a run repeats exactly for its seed; the budget and Ctrl-C are heeded within some
    20 ms of search, and between batches.

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
      InputError: an unknown heuristic or backend, a number out of its range, or no limit of time, batches or samples.
    """
    check_name("heuristic", heuristic, HEURISTICS)
    check_budget(budget_s)
    _check_count("max_samples", max_samples)
    if budget_s == np.inf and options.max_batches is None and max_samples is None:
        raise InputError("budget_s is inf and nothing else ends the search: give it, max_batches or max_samples")
    backend = chosen_backend(options.backend)
    _warm_up()
    begin_s = time.perf_counter()
    points_m, cost, note = np.empty((0, 2)), np.inf, ""
    is_reachable = reachable_cells(problem)
    if is_reachable is None:
        status, lower_bound, found = Status.NO_PATH, np.inf, Found(points_m, False, 0, [])
    else:
        bounds = make_bounds(heuristic, problem, is_reachable)
        lower_bound = bounds.from_start_to_goal()
        if problem.start == problem.goal:
            found = Found(bounds.start[None], False, 0, [])
        else:
            cost_grid = cost_grid_of(problem, is_reachable)
            bulk = None
            if backend == "jax":
                compile_s = time.perf_counter()
                bulk = BulkCosts(cost_grid)
                begin_s += time.perf_counter() - compile_s
            budget = Budget(begin_s, begin_s + budget_s, max_samples)
            found = _search(cost_grid, bulk, bounds, is_reachable, options, budget, seed)
        points_m = found.xy * problem.resolution_m
        if len(points_m):
            cost = problem.cost_of(points_m)
            lower_bound = min(lower_bound, cost)
            status = Status.BUDGET_FEASIBLE if found.is_spent else Status.FEASIBLE
            if cost <= lower_bound * ROUNDING:
                status = Status.OPTIMAL
            note = free_ride(problem.distance_weight, cost)
        else:
            status = Status.BUDGET_EMPTY
    return Path(
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=lower_bound,
        num_expanded=found.num_costed,
        elapsed_s=time.perf_counter() - begin_s,
        planner=planner,
        heuristic=heuristic,
        backend=backend,
        note=note,
        history=tuple(found.history),
    )


# The paper's two: guided by the straight distance, and by distance and map costs.
bitstar_dist = partial(bitstar, heuristic="euclidean", planner="bitstar-dist")
bitstar_plus = partial(bitstar, heuristic="plus", planner="bitstar-plus")


def _search(
    cost_grid: CostGrid,
    bulk: BulkCosts | None,
    bounds: Bounds,
    is_reachable: np.ndarray,
    options: BitStarOptions,
    budget: Budget,
    seed: int,
) -> Found:
    """Return what the batches found, until something ends them."""
    good_cost = max(bounds.from_start_to_goal() * ROUNDING, options.target_cost)
    wanted = np.empty((0 if bulk is None else BULK, 2), np.int32)
    informed = InformedSet(bounds, is_reachable)
    rng = np.random.default_rng(seed)
    tree, start, goal, radius = Tree.of_ends(bounds), 0, 1, np.inf
    queue = Heap.empty(FIRST_QUEUE, EDGE)
    history: list[tuple[float, int, float]] = []
    num_costed = num_drawn = 0
    cost, is_spent, xy = np.inf, False, np.empty((0, 2))
    while True:
        tree, start, goal, buckets = tree.in_buckets(radius, start, goal)
        nodes = tree.nodes(radius, buckets)
        graph = BatchGraph(goal, radius, bounds.per_side, buckets)
        queue = _filled(queue, nodes.g[nodes.state > 0] + nodes.to_goal[nodes.state > 0])
        while True:
            ended, num_new = advance(cost_grid, nodes, queue, graph, CHUNK, wanted)
            num_costed += num_new
            if ended == FULL:
                queue = queue.grown()
            if ended == COSTS_WANTED and bulk is not None:
                edges = wanted[:num_new]
                put_back(nodes, queue, goal, edges, bulk(tree.xy[edges[:, 0]], tree.xy[edges[:, 1]]))
            if ended == EXHAUSTED or time.perf_counter() >= budget.end_s:
                break
        path = tree.path(goal)
        last_cost, cost = cost, min(cost, tree.path_cost(path))
        history.append((time.perf_counter() - budget.begin_s, num_drawn, cost))
        if options.on_batch is not None:
            options.on_batch(Batch(len(history) - 1, xy, tree, path, cost))
        if cost <= good_cost:
            break
        if cost < np.inf and last_cost < np.inf and last_cost - cost < options.min_improvement * last_cost:
            break
        tree, start, goal = tree.pruned(start, goal)
        informed.shrink(cost)
        num_wanted = 0
        if options.max_batches is None or len(history) - 1 < options.max_batches:
            num_left = np.inf if budget.max_samples is None else budget.max_samples - num_drawn
            num_wanted = max(options.batch_samples, int(options.growth * len(tree.xy)))
            num_wanted = int(min(num_wanted, MOST_IN_A_BATCH, num_left))
        is_spent = num_wanted == 0 or time.perf_counter() >= budget.end_s
        if is_spent:
            break
        xy = informed.sample(num_wanted, rng)
        if not len(xy):
            break
        num_drawn += len(xy)
        tree = tree.with_samples(xy, bounds)
        radius = graph_radius(len(tree.xy), informed.measure, options.eta)
    return Found(tree.xy[tree.path(goal)], is_spent, num_costed, history)


def _filled(queue: Heap, f: np.ndarray) -> Heap:
    """Return a queue for the expansion of the tree's nodes, by ``[T]`` their f."""
    if len(queue.f) < 2 * len(f):
        queue = Heap.empty(4 * len(f), EDGE)
    order = np.argsort(f, kind="stable")  # sorted is a heap
    edges = queue.item[: len(f)]
    queue.f[: len(f)], edges["origin"], edges["target"], edges["cost"] = f[order], order, order, NOT_COSTED
    queue.size[0] = len(f)
    return queue


@cache
def _warm_up() -> None:
    """Compile what a search runs, so that its time is its own."""
    problem = Problem(np.zeros((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0)
    is_reachable = np.ones((1, 2), bool)
    bounds = make_bounds("plus", problem, is_reachable)
    bounds.through_cells(np.flatnonzero(is_reachable))
    budget = Budget(0.0, np.inf)
    _search(cost_grid_of(problem, is_reachable), None, bounds, is_reachable, BitStarOptions(max_batches=0), budget, 0)
    warm_up_features()
