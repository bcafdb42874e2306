"""The batches of one BIT* query: what is drawn, kept and reported between two searches of the sample graph."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError, at_least, one_of, positive
from jaxurban.planners.base import EVERY_PATH, ROUNDING, Path, Problem, Status
from jaxurban.planners.bitstar.bounds import Bounds, InformedSet, graph_radius, make_bounds, reachable_cells
from jaxurban.planners.bitstar.tree import Tree

MOST_IN_A_BATCH = 100_000  # samples, so that the clock is looked at between them
BACKENDS = ("numba", "jax", "auto")


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
      backend: what searches the graph of a batch: ``"numba"`` in order of lower bounds, costing each edge as it comes
        first in the queue; ``"jax"`` all at once on JAX's device (`solve_batched`); ``"auto"`` picks numba: on a CPU
        it is several times as fast (docs/benchmarks.md), and on a GPU nothing was measured.
      on_batch: called with each `Batch` when it ends, to draw or record it; its time counts towards the budget.

    Raises:
      InputError: a number out of its range, or an unknown backend.
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
        at_least("batch_samples", self.batch_samples, 1)
        positive("eta", self.eta)
        one_of("backend", self.backend, BACKENDS)
        for name in ("growth", "target_cost", "min_improvement"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a number >= 0, got {getattr(self, name)}")
        if self.max_batches is not None:
            at_least("max_batches", self.max_batches)


DEFAULTS = BitStarOptions()


def check_limits(budget_s: float, max_samples: int | None, options: BitStarOptions) -> None:
    """Refuse what no search can be run with.

    Raises:
      InputError: a number of samples out of its range, or no limit of time, batches or samples.
    """
    if max_samples is not None:
        at_least("max_samples", max_samples)
    if budget_s == np.inf and options.max_batches is None and max_samples is None:
        raise InputError("budget_s is inf and nothing else ends the search: give it, max_batches or max_samples")


class Budget(NamedTuple):
    """What ends a search beside its options.

    Attributes:
      begin_s, end_s: of `time.perf_counter`.
      max_samples: None: no limit.
    """

    begin_s: float
    end_s: float
    max_samples: int | None = None

    def later(self, away_s: float) -> "Budget":
        """Return the budget where some seconds of what was done do not count."""
        return self._replace(begin_s=self.begin_s + away_s, end_s=self.end_s + away_s)


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


class Batches:
    """One query between two searches of its graph; whoever searches it puts what was found into the tree.

    Attributes:
      bounds: of the query.
      tree: start, goal and samples; a search alters it.
      radius: nodes this near each other are joined.
      cost: of the best path, inf without one.
      num_costed: edges whose cost was computed; the search counts them.
      history: after each batch: seconds, samples drawn, cost.
      is_done, is_spent: whether the search has ended, and whether a limit of time, batches or samples ended it.
      is_reachable: ``[Y, X]`` bool cells that paths may cross.
    """

    def __init__(
        self, problem: Problem, heuristic: str, is_reachable: np.ndarray, options: BitStarOptions, seed: int
    ) -> None:
        self.options, self.is_reachable = options, is_reachable
        self.bounds: Bounds = make_bounds(heuristic, problem, is_reachable)
        self.tree, self.radius = Tree.of_ends(self.bounds), np.inf
        self.cost = np.inf
        self.num_costed = self._num_drawn = 0
        self.history: list[tuple[float, int, float]] = []
        self.is_done, self.is_spent = problem.start == problem.goal, False
        self._samples = np.empty((0, 2))
        self._informed = InformedSet(self.bounds, is_reachable)
        self._rng = np.random.default_rng(seed)

    @property
    def xy(self) -> np.ndarray:
        """``[N, 2]`` the best path in cell sides; none without one."""
        if (self.bounds.start == self.bounds.goal).all():
            return self.bounds.start[None]
        return self.tree.xy[self.tree.path()]

    def end(self, budget: Budget, most_nodes: float = np.inf) -> None:
        """Record the batch whose graph was searched; begin the next, of up to so many nodes, or end."""
        path = self.tree.path()
        last_cost, self.cost = self.cost, min(self.cost, self.tree.path_cost(path))
        self.history.append((time.perf_counter() - budget.begin_s, self._num_drawn, self.cost))
        if self.options.on_batch is not None:
            self.options.on_batch(Batch(len(self.history) - 1, self._samples, self.tree, path, self.cost))
        self.is_done = True
        if self.cost <= max(self.bounds.from_start_to_goal() * ROUNDING, self.options.target_cost):
            return
        if last_cost < np.inf and last_cost - self.cost < self.options.min_improvement * last_cost:
            return
        self.tree = self.tree.pruned()
        self._informed.shrink(self.cost)
        num_wanted = self._num_wanted(budget, most_nodes)
        self.is_spent = num_wanted <= 0 or time.perf_counter() >= budget.end_s
        if self.is_spent:
            return
        self._samples = self._informed.sample(num_wanted, self._rng)
        self._num_drawn += len(self._samples)
        self.tree = self.tree.with_samples(self._samples, self.bounds)
        self.radius = graph_radius(len(self.tree.xy), self._informed.measure, self.options.eta)
        self.is_done = not len(self._samples)

    def _num_wanted(self, budget: Budget, most_nodes: float) -> int:
        """Return how many samples the next batch is to have, 0 or less where a limit is reached."""
        if self.options.max_batches is not None and len(self.history) > self.options.max_batches:
            return 0
        num_left = np.inf if budget.max_samples is None else budget.max_samples - self._num_drawn
        num_wanted = max(self.options.batch_samples, int(self.options.growth * len(self.tree.xy)))
        return int(min(num_wanted, MOST_IN_A_BATCH, num_left, most_nodes - len(self.tree.xy)))


def begun(problem: Problem, heuristic: str, options: BitStarOptions, seed: int) -> Batches | None:
    """Return a query's batches before the first search, that of the straight segment; None where there is no path."""
    is_reachable = reachable_cells(problem)
    return None if is_reachable is None else Batches(problem, heuristic, is_reachable, options, seed)


def ended(
    problem: Problem, batches: Batches | None, begin_s: float, planner: str, heuristic: str, backend: str
) -> Path:
    """Return the path of a query whose batches have ended, costed anew along the exact cells that it crosses."""
    points_m, status, lower_bound = np.empty(0), Status.NO_PATH, np.inf
    if batches is not None:
        points_m = batches.xy * problem.resolution_m
        found = Status.BUDGET_FEASIBLE if batches.is_spent else Status.FEASIBLE
        status, lower_bound = found if len(points_m) else Status.BUDGET_EMPTY, batches.bounds.from_start_to_goal()
    return Path.of(
        problem,
        points_m,
        status,
        lower_bound,
        begin_s,
        graph=EVERY_PATH,
        num_expanded=0 if batches is None else batches.num_costed,
        planner=planner,
        heuristic=heuristic,
        backend=backend,
        history=() if batches is None else tuple(batches.history),
    )
