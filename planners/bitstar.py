"""BIT*: batch informed trees, an anytime planner that leaves the grid (Gammell, Srinivasa & Barfoot 2015)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError, nearest_name
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.bitstar_bounds import HEURISTICS, Bounds, make_bounds
from jaxurban.planners.bitstar_bulk import BULK, BulkCosts, chosen_backend
from jaxurban.planners.bitstar_samples import InformedSet, graph_radius
from jaxurban.planners.bitstar_search import (
    BATCH_DONE,
    COSTS_WANTED,
    NOT_COSTED,
    QUEUE_FULL,
    Ground,
    Queue,
    advance,
    put_back,
)
from jaxurban.planners.bitstar_tree import Tree
from jaxurban.planners.evaluate import evaluate_on
from jaxurban.planners.evaluate import warm_up as warm_up_evaluation

CHUNK = 20_000  # queue entries between two looks at the clock: some 20 ms
FIRST_QUEUE = 4096  # entries; doubled when full
MOST_IN_A_BATCH = 100_000  # samples, so that the clock is looked at between them
ROUNDING = 1 + 1e-12  # a path that much above the lower bound is the best one


@dataclass(frozen=True)
class Settings:
    """How batches are made, and what ends a search (see `bitstar`)."""

    budget_s: float
    batch_samples: int
    growth: float
    eta: float
    max_batches: int | None
    max_samples: int | None
    target_cost: float
    min_improvement: float

    def __post_init__(self) -> None:
        if not self.budget_s > 0:
            raise InputError(f"budget_s must be a positive number of seconds, got {self.budget_s}")
        if self.budget_s == np.inf and self.max_batches is None and self.max_samples is None:
            raise InputError("budget_s is inf and nothing else ends the search: give it, max_batches or max_samples")
        if not 1 <= self.batch_samples < np.inf:
            raise InputError(f"batch_samples must be a whole number >= 1, got {self.batch_samples}")
        if not 0 < self.eta < np.inf:
            raise InputError(f"eta must be a positive number, got {self.eta}")
        for name in ("growth", "target_cost", "min_improvement"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a number >= 0, got {getattr(self, name)}")
        for name in ("max_batches", "max_samples"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise InputError(f"{name} must be a whole number >= 0, got {value}")

    def next_samples(self, num_nodes: int, num_batches: int, num_drawn: int) -> int:
        """Return how many samples the next batch adds, 0 where a limit is reached."""
        if self.max_batches is not None and num_batches >= self.max_batches:
            return 0
        most = MOST_IN_A_BATCH if self.max_samples is None else min(MOST_IN_A_BATCH, self.max_samples - num_drawn)
        return min(max(self.batch_samples, int(self.growth * num_nodes)), most)


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
    batch_samples: int = 100,
    growth: float = 1.0,
    eta: float = 1.1,
    max_batches: int | None = None,
    max_samples: int | None = None,
    target_cost: float = 0.0,
    min_improvement: float = 0.0,
    backend: str = "numba",
    planner: str = "bitstar",
    on_batch: Callable[[Batch], None] | None = None,
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
    ``connectivity`` plays none. Under the ``cell`` model a step of any length is charged one cell, so that
    A*'s diagonals, of 1.41 cell sides, are cheaper than any longer edge, which is charged every cell
    side: to compare planners use ``line``.

    Differs from the paper: a queued edge that was costed goes back into the queue with its true cost, so
    that nodes join the tree in order of cost; improved nodes are expanded again, those of earlier batches
    too; and batches grow, so that the work stays in proportion to the samples.

    Args:
      problem: the question.
      budget_s: seconds of search.
      seed: of the samples.
      heuristic: ``"euclidean"`` or ``"plus"`` (see `bitstar_bounds.make_bounds`).
      batch_samples: samples of a batch, at least.
      growth: samples of a batch per sample in use, at least; up to 100,000. 0 keeps batches even.
      eta: factor of the radius, > 1 for paths that come ever nearer to the optimum.
      max_batches, max_samples: end after so many; samples outside the free or informed set do not count.
      target_cost: end with a path this cheap.
      min_improvement: end with the first batch that improves a path by a smaller share of its cost.
      backend: what costs the edges: ``"numba"`` one by one as each comes first in the queue, ``"jax"`` up to
        1024 at a time on JAX's device, some of them in vain; ``"auto"`` picks (`bitstar_bulk.chosen_backend`).
      planner: the name that the path carries.
      on_batch: called with each `Batch` when it ends, to draw or record it; its time counts towards the budget.

    Raises:
      InputError: an unknown heuristic or backend, a number out of its range, or no limit of time, batches or samples.
    """
    if heuristic not in HEURISTICS:
        raise InputError(
            f"unknown heuristic {heuristic!r}{nearest_name(heuristic, HEURISTICS)}: "
            f"choose one of {', '.join(HEURISTICS)}"
        )
    settings = Settings(budget_s, batch_samples, growth, eta, max_batches, max_samples, target_cost, min_improvement)
    backend = chosen_backend(backend)
    _warm_up()
    begin_s = time.perf_counter()
    points_m, cost, note = np.empty((0, 2)), np.inf, ""
    islands = problem.islands
    if islands[problem.start] != islands[problem.goal]:
        status, lower_bound, found = Status.NO_PATH, np.inf, Found(points_m, False, 0, [])
    else:
        is_reachable = islands == islands[problem.start]
        bounds = make_bounds(heuristic, problem, is_reachable)
        lower_bound = bounds.from_start_to_goal()
        if problem.start == problem.goal:
            found = Found(bounds.start[None], False, 0, [])
        else:
            ground = _ground(problem, is_reachable)
            bulk = None
            if backend == "jax":
                compile_s = time.perf_counter()
                bulk = BulkCosts(ground)
                begin_s += time.perf_counter() - compile_s
            found = _search(ground, bounds, is_reachable, settings, seed, begin_s, bulk, on_batch)
        points_m = found.xy * problem.resolution_m
        if len(points_m):
            cost = evaluate_on(problem, points_m).total
            lower_bound = min(lower_bound, cost)
            status = Status.BUDGET_FEASIBLE if found.is_spent else Status.FEASIBLE
            if cost <= lower_bound * ROUNDING:
                status = Status.OPTIMAL
            if problem.distance_weight == 0 and cost == 0:
                note = "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."
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
    ground: Ground,
    bounds: Bounds,
    is_reachable: np.ndarray,
    settings: Settings,
    seed: int,
    begin_s: float,
    bulk: BulkCosts | None,
    on_batch: Callable[[Batch], None] | None = None,
) -> Found:
    """Return what the batches found, until something ends them."""
    end_s = begin_s + settings.budget_s
    good_cost = max(bounds.from_start_to_goal() * ROUNDING, settings.target_cost)
    wanted = np.empty((0 if bulk is None else BULK, 2), np.int32)
    informed = InformedSet(bounds, is_reachable)
    rng = np.random.default_rng(seed)
    tree, start, goal, radius = Tree.of_ends(bounds), 0, 1, np.inf
    queue = _queue(FIRST_QUEUE)
    history: list[tuple[float, int, float]] = []
    num_costed = num_drawn = 0
    cost, is_spent, xy = np.inf, False, np.empty((0, 2))
    while True:
        tree, start, goal, buckets = tree.in_buckets(radius, start, goal)
        nodes = tree.nodes(radius, buckets)
        queue, size = _filled(queue, nodes.g[nodes.state > 0] + nodes.to_goal[nodes.state > 0])
        while True:
            ended, size, num_new = advance(
                ground, nodes, queue, size, goal, buckets, radius, bounds.per_side, CHUNK, wanted
            )
            num_costed += num_new
            if ended == QUEUE_FULL:
                queue = Queue(*(np.concatenate([values, np.empty_like(values)]) for values in queue))
            if ended == COSTS_WANTED and bulk is not None:
                edges = wanted[:num_new]
                size = put_back(nodes, queue, size, goal, edges, bulk(tree.xy[edges[:, 0]], tree.xy[edges[:, 1]]))
            if ended == BATCH_DONE or time.perf_counter() >= end_s:
                break
        path = tree.path(goal)
        last_cost, cost = cost, min(cost, tree.path_cost(path))
        history.append((time.perf_counter() - begin_s, num_drawn, cost))
        if on_batch is not None:
            on_batch(Batch(len(history) - 1, xy, tree, path, cost))
        if cost <= good_cost:
            break
        if cost < np.inf and last_cost < np.inf and last_cost - cost < settings.min_improvement * last_cost:
            break
        tree, start, goal = tree.pruned(start, goal)
        informed.shrink(cost)
        num_wanted = settings.next_samples(len(tree.xy), len(history) - 1, num_drawn)
        is_spent = num_wanted == 0 or time.perf_counter() >= end_s
        if is_spent:
            break
        xy = informed.sample(num_wanted, rng)
        if not len(xy):
            break
        num_drawn += len(xy)
        tree = tree.with_samples(xy, bounds)
        radius = graph_radius(len(tree.xy), informed.measure, settings.eta)
    return Found(tree.xy[tree.path(goal)], is_spent, num_costed, history)


def _ground(problem: Problem, is_reachable: np.ndarray) -> Ground:
    is_line = problem.cost_model.kind == "line"
    per_side = problem.resolution_m / problem.cost_model.reference_length_m if is_line else 1.0
    charge = np.where(is_reachable, problem.cost, np.inf) * per_side
    return Ground(
        charge, float(problem.distance_weight * problem.resolution_m), is_line, problem.cost_model.passes_corners
    )


def _queue(size: int) -> Queue:
    return Queue(np.empty(size), np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size))


def _filled(queue: Queue, f: np.ndarray) -> tuple[Queue, int]:
    """Return a queue that asks for the expansion of the tree's nodes, by ``[T]`` their f, and its entries."""
    if len(queue.f) < 2 * len(f):
        queue = _queue(4 * len(f))
    order = np.argsort(f, kind="stable")  # sorted is a heap
    queue.f[: len(f)] = f[order]
    queue.origin[: len(f)] = queue.target[: len(f)] = order
    queue.cost[: len(f)] = NOT_COSTED
    return queue, len(f)


@cache
def _warm_up() -> None:
    """Compile what a search runs, so that its time is its own."""
    problem = Problem(np.zeros((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0)
    is_reachable = np.ones((1, 2), bool)
    bounds = make_bounds("plus", problem, is_reachable)
    bounds.through_cells(np.flatnonzero(is_reachable))
    settings = Settings(np.inf, 1, 0.0, 1.1, 0, 0, 0.0, 0.0)
    _search(_ground(problem, is_reachable), bounds, is_reachable, settings, 0, 0.0, None)
    warm_up_evaluation()
