"""BIT*: batch informed trees, an anytime planner that leaves the grid (Gammell, Srinivasa & Barfoot 2015).

One query's graphs are searched in order of lower bounds, compiled by Numba; between two searches is decided what is
drawn, kept and reported. `planners.bulk` searches many queries' in bulk.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from jaxurban.checks import at_least, positive
from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.search.heap import EXHAUSTED, FULL, Heap
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status
from jaxurban.planners.bitstar.bounds import (
    Bounds,
    InformedSet,
    cost_grid_of,
    graph_radius,
    make_bounds,
    reachable_cells,
)
from jaxurban.planners.bitstar.tree import EDGE, NOT_COSTED, BatchGraph, Tree, take_edges
from jaxurban.planners.compiled_first import compiled_first

CHUNK = 20_000  # queue entries between two looks at the clock: some 20 ms
FIRST_QUEUE = 4096  # entries; doubled when full
MOST_IN_A_BATCH = 100_000  # samples, so that the clock is looked at between them


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
      on_batch: called with the `Batches` when one ends, to draw or record it; its time counts towards the budget.

    Raises:
      InputError: a number out of its range.
    """

    batch_samples: int = 100
    growth: float = 1.0
    eta: float = 1.1
    max_batches: int | None = None
    target_cost: float = 0.0
    min_improvement: float = 0.0
    on_batch: "Callable[[Batches], None] | None" = None

    def __post_init__(self) -> None:
        """Check all numbers, and raise InputError for one out of its range."""
        at_least("batch_samples", self.batch_samples, 1)
        positive("eta", self.eta)
        for name in ("growth", "target_cost", "min_improvement"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a number >= 0, got {getattr(self, name)}")
        if self.max_batches is not None:
            at_least("max_batches", self.max_batches)


DEFAULTS = BitStarOptions()


def check_limits(budget_s: float, max_samples: int | None, options: BitStarOptions) -> None:
    """Refuse limits with which no search can be run.

    Args:
      budget_s: seconds of search; inf for no limit.
      max_samples: limit of samples; None for no limit.
      options: of the batches, which may limit their number.

    Raises:
      InputError: a number of samples out of its range, or no limit of time, batches or samples.
    """
    if max_samples is not None:
        at_least("max_samples", max_samples)
    if budget_s == np.inf and options.max_batches is None and max_samples is None:
        raise InputError(
            "budget_s is inf and nothing else ends the search: give it, max_batches or max_samples"
        )


class Batches:
    """One query between two searches of its graph; whoever searches it puts what was found into the tree.

    Attributes:
      problem: the query, and ``bounds`` of its paths.
      tree: start, goal and samples; a search alters it.
      samples: ``[K, 2]`` x, y of what the last batch added, in cell sides, as all of the tree.
      radius: nodes this near each other are joined.
      cost: of the best path, inf without one.
      num_costed: edges whose cost was computed; the search counts them.
      history: after each batch, that of the straight segment first: seconds, samples drawn, cost.
      is_done, is_spent: whether the search has ended, and whether a limit of time, batches or samples ended it.
      is_reachable: ``[Y, X]`` bool cells that paths may cross.
      begin_s, end_s: of `time.perf_counter`, between which the search may run.
    """

    def __init__(
        self,
        problem: Problem,
        heuristic: str,
        options: BitStarOptions,
        seed: int,
        budget_s: float,
        max_samples: int | None,
    ) -> None:
        """Begin a query with a tree of its start and goal alone, and no batch.

        Args:
          problem: the query.
          heuristic: one of `bitstar.bounds.HEURISTICS`.
          options: how batches are made, and what else ends the search.
          seed: of the samples.
          budget_s: seconds of search from now on.
          max_samples: limit of samples; None for no limit.
        """
        self.begin_s = time.perf_counter()
        self.end_s = self.begin_s + budget_s
        self.max_samples = max_samples
        self.problem = problem
        self.options = options
        self._heuristic = heuristic
        self.is_reachable = reachable_cells(problem)
        self.bounds: Bounds = make_bounds(heuristic, problem, self.is_reachable)
        self.tree = Tree.of_ends(self.bounds)
        self.radius = np.inf
        self.cost = np.inf
        self.num_costed = self._num_drawn = 0
        self.history: list[tuple[float, int, float]] = []
        self._is_joined = bool(self.is_reachable[problem.goal])
        self.is_done = problem.start == problem.goal or not self._is_joined
        self.is_spent = False
        self.samples = np.empty((0, 2))
        self._informed = InformedSet(self.bounds, self.is_reachable)
        self._rng = np.random.default_rng(seed)

    def end(self, most_nodes: float = np.inf) -> None:
        """Record the batch whose graph was searched; then begin the next batch, or set ``is_done``.

        Args:
          most_nodes: limit of the tree's nodes in the next batch, samples included.
        """
        last_cost = self.cost
        self.cost = min(self.cost, self.tree.path_cost(self.tree.path()))
        self.history.append((time.perf_counter() - self.begin_s, self._num_drawn, self.cost))
        if self.options.on_batch is not None:
            self.options.on_batch(self)

        # End where the cost is good enough, or fell by too little.
        self.is_done = True
        if self.cost <= max(self.bounds.from_start_to_goal() * SAME_COST, self.options.target_cost):
            return
        if last_cost < np.inf and last_cost - self.cost < self.options.min_improvement * last_cost:
            return

        # Leave out what cannot lead to a cheaper path, and end where a limit is reached.
        self.tree = self.tree.pruned()
        self._informed.shrink(self.cost)
        num_wanted = self._num_wanted(most_nodes)
        self.is_spent = num_wanted <= 0 or time.perf_counter() >= self.end_s
        if self.is_spent:
            return

        # Add samples; a set too thin to give any ends the search.
        self.samples = self._informed.sample(num_wanted, self._rng)
        self._num_drawn += len(self.samples)
        self.tree = self.tree.with_samples(self.samples, self.bounds)
        self.radius = graph_radius(len(self.tree.xy), self._informed.measure, self.options.eta)
        self.is_done = not len(self.samples)

    def _num_wanted(self, most_nodes: float) -> int:
        """Return how many samples the next batch is to have, 0 or less where a limit is reached.

        The smallest of what the options ask for, `MOST_IN_A_BATCH`, and what the limits of samples and nodes leave.
        """
        if self.options.max_batches is not None and len(self.history) > self.options.max_batches:
            return 0
        num_left = np.inf if self.max_samples is None else self.max_samples - self._num_drawn
        num_wanted = max(self.options.batch_samples, int(self.options.growth * len(self.tree.xy)))
        return int(min(num_wanted, MOST_IN_A_BATCH, num_left, most_nodes - len(self.tree.xy)))

    def path(self, planner: str, backend: str) -> Path:
        """Return the path when the batches have ended, costed again along the exact cells that it crosses.

        Args:
          planner, backend: names that the path carries.
        """
        xy = np.empty(0)
        status = Status.NO_PATH
        lower_bound = np.inf
        if self._is_joined:
            is_there = (self.bounds.start == self.bounds.goal).all()
            xy = self.bounds.start[None] if is_there else self.tree.xy[self.tree.path()]
            lower_bound = self.bounds.from_start_to_goal()
            status = Status.BUDGET_EMPTY
            if len(xy):
                status = Status.BUDGET_FEASIBLE if self.is_spent else Status.FEASIBLE
        return Path.of(
            self.problem,
            xy * self.problem.resolution_m,
            status,
            lower_bound,
            self.begin_s,
            graph=EVERY_PATH,
            backend=backend,
            planner=planner,
            heuristic=self._heuristic,
            num_expanded=self.num_costed,
            history=tuple(self.history),
        )


@compiled_first(budget_s=np.inf, max_samples=20)
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

    Each batch adds samples where a cheaper path may lead, joins all nodes within the radius of `graph_radius`, and
    searches that graph in order of lower bounds, keeping the tree. Batch 0 is the straight segment.
    Edges are costed, and tested for obstacles, over the exact cells that they cross. With a limit of
    batches or samples a run repeats exactly for its seed; the budget and Ctrl-C are heeded within some
    20 ms of search, and between batches.

    The status is OPTIMAL where the cost meets the lower bound, NO_PATH where obstacles separate start and
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
    batches = Batches(problem, heuristic, options, seed, budget_s, max_samples)
    if not batches.is_done:
        _search(cost_grid_of(problem, batches.is_reachable), batches)
    return batches.path(planner, "numba")


# The paper's two: guided by the straight distance, and by distance and map costs.
bitstar_dist = partial(bitstar, heuristic="euclidean", planner="bitstar-dist")
bitstar_plus = partial(bitstar, heuristic="plus", planner="bitstar-plus")


def _search(cost_grid: CostGrid, batches: Batches) -> None:
    """Search the graph of one batch after the other, until the batches are done; their tree is altered."""
    queue = Heap.empty(FIRST_QUEUE, EDGE)
    while not batches.is_done:
        graph = BatchGraph.of(batches.tree.xy, batches.radius, batches.bounds.per_side)
        nodes = batches.tree = batches.tree.ready(graph)
        queue = _filled(queue, nodes.g[nodes.state > 0] + nodes.to_goal[nodes.state > 0])
        while True:
            chunk, num_costed = take_edges(cost_grid, nodes, queue, graph, CHUNK)
            batches.num_costed += num_costed
            if chunk == FULL:
                queue = queue.grown()
            if chunk == EXHAUSTED or time.perf_counter() >= batches.end_s:
                break
        batches.end()


def _filled(queue: Heap, f: np.ndarray) -> Heap:
    """Return a queue in which each of the tree's nodes waits for its expansion.

    Args:
      queue: from the last batch; its memory is used again if it is large enough.
      f: ``[T]`` f of the tree's nodes 0 to T - 1.
    """
    if len(queue.f) < 2 * len(f):
        queue = Heap.empty(4 * len(f), EDGE)
    order = np.argsort(f, kind="stable")  # sorted is a heap
    edges = queue.item[: len(f)]
    queue.f[: len(f)] = f[order]
    edges["origin"] = order
    edges["target"] = order
    edges["cost"] = NOT_COSTED
    queue.size[0] = len(f)
    return queue
