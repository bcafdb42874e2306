"""The cheapest path whose exposure keeps budgets: Lagrange's search between weights, then labels, with a lower bound.

The exposure to a layer is what its weight multiplies, (1 / l0) x integral of c ds. For any prices >= 0 the cheapest
path under weights + prices, less prices x budgets, is a lower bound on every path within the budgets. The prices that
raise it most lie where known paths tie (Handler & Zang 1980; Kelley 1960); one search there finds a further path, or
none, and then the bound is as high as prices take it. Of one budget, labels (cost, exposure) close what is left, in
order of the least cost that they may end at (Ahmadi et al. 2022); exact fields say what each still needs at least.
"""

import heapq
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.tolerances import SAME_EXPOSURE
from jaxurban.planners.astar import exact_cost_to_go
from jaxurban.planners.base import Path, Planner, Problem, Status, cell_index
from jaxurban.planners.grid_search import graph_of

ENOUGH = 1e-6  # relative: what prices are not known better for
# Prices, in the highest cost of a known path for the exposure of the path without budgets.
STEEPEST = 1e3
MOST_SEARCHES = 100
MOST_LABELS = 2_000_000  # some 200 MB
LABELS_PER_S = 1_000_000
COMPARED = 10  # pairs for each of them, at most: of several budgets a node may hold many labels


class _Known(NamedTuple):
    """A path found on the way: its points, cost, exposures over their budgets ``[K]``, and whether it keeps all."""

    points_m: np.ndarray
    cost: float
    excess: np.ndarray
    is_within: bool


class _Search:
    """The searches of one query under prices, what they found, and what they prove. ``K`` budgets.

    Prices are of exposures in units, those of the path without budgets.
    """

    def __init__(
        self,
        problem: Problem,
        planner: Planner,
        layers: Sequence[int],
        budgets: Iterable[float],
        seed: int,
        end_s: float,
    ) -> None:
        """Begin with no path known and no search done.

        Args:
          problem: the query.
          planner: a grid planner.
          layers: ``[K]`` numbers of the layers whose exposures have budgets.
          budgets: ``[K]`` the budgets.
          seed: of the planner.
          end_s: time of `time.perf_counter` after which no search begins.
        """
        self.problem = problem
        self.planner = planner
        self.seed = seed
        self.end_s = end_s
        # Of weights and features, of which the first is distance.
        self.columns = 1 + np.array(layers)
        # No larger than what can be exceeded: sums stay precise.
        self.budgets = np.minimum([*budgets], _most_exposures(problem)[layers])
        self.units = np.ones(len(self.budgets))
        self.known: list[_Known] = []
        self.paths: list[Path] = []
        self.bound = -np.inf
        self.has_cut_labels = False  # for want of time

    def run(self, prices: np.ndarray, *, is_of_cost: bool = True) -> float:
        """Search for the path of least cost + prices . excess, and return a lower bound of that sum over all paths.

        The excess of a path is its exposures less the budgets, in units. The path found becomes known, and a higher
        lower bound of cost is kept.

        Args:
          prices: ``[K]`` not negative, of exposures in units.
          is_of_cost: whether the cost counts; without it the sum is of the excess alone, and proves no bound of cost.
        """
        weights = self.problem.weights * is_of_cost
        weights[self.columns] += prices / self.units
        left_s = max(self.end_s - time.perf_counter(), 0.0)
        path = self.planner(self.problem.with_weights(weights), budget_s=left_s, seed=self.seed)
        self.end_s += path.setup_s  # compiling is of no budget
        self.paths.append(path)
        if path.status.has_path:
            self.add(path.points_m)
        least = path.lower_bound - float(prices @ (self.budgets / self.units))
        if is_of_cost:
            self.bound = max(self.bound, least)
        return least

    def add(self, points_m: np.ndarray) -> None:
        """Add a path ``[N, 2]`` or ``[N, 3]`` to those known; the first one's exposures become the units."""
        phi = self.problem.features(points_m).phi
        exposure = phi[self.columns]
        if not self.known:
            self.units = np.where(exposure > 0, exposure, 1.0)
        is_within = bool((exposure <= self.budgets * (1 + SAME_EXPOSURE)).all())
        excess = (exposure - self.budgets) / self.units
        self.known.append(_Known(points_m, float(self.problem.weights @ phi), excess, is_within))

    def best(self) -> _Known | None:
        """Return the cheapest known path within the budgets."""
        within = [known for known in self.known if known.is_within]
        return min(within, key=lambda known: known.cost, default=None)

    def least_exposures(self) -> np.ndarray:
        """Return ``[K]`` lower bounds on the exposures of every path."""
        least = np.array([self.run(unit, is_of_cost=False) for unit in np.eye(len(self.budgets))])
        return least * self.units + self.budgets

    @property
    def is_late(self) -> bool:
        """Whether no further search may begin."""
        return self.is_out_of_time or len(self.paths) >= MOST_SEARCHES

    @property
    def is_out_of_time(self) -> bool:
        """Whether more seconds would have let the search go further."""
        return self.has_cut_labels or time.perf_counter() >= self.end_s

    def close(self, prices: np.ndarray) -> tuple[int, bool]:
        """Search by labels for a path cheaper than the best one known, on one altitude, and raise the bound.

        Args:
          prices: ``[K]`` of exposures in units, under which the bound is as high as prices take it.

        Returns:
          How many labels were made, and whether they prove that no path keeps the budgets.
        """
        problem = self.problem
        limits = self.budgets * (1 + SAME_EXPOSURE / 2)
        prices = prices / self.units

        # Exact costs to go: of each exposure alone, of cost, and of cost under prices.
        of_exposures = np.eye(len(problem.weights))[self.columns]
        weights = np.concatenate([of_exposures, [problem.weights] * 2])
        weights[-1, self.columns] += prices
        weighed = [problem.with_weights(row) for row in weights]
        try:
            to_go = np.array([exact_cost_to_go(query, self.end_s).ravel() for query in weighed])
        except TimeoutError:
            return 0, False

        # As many labels as memory and the time left allow.
        left_s = max(self.end_s - time.perf_counter(), 0.0)
        most = 1 + int(min(MOST_LABELS, LABELS_PER_S * left_s))
        self.has_cut_labels = most <= MOST_LABELS  # by time, not by memory

        layers = problem.costs[self.columns - 1].reshape(len(limits), -1).astype(np.float64)
        best = self.best()
        way, num_labels, least = _advance(
            graph_of(problem),
            layers,
            to_go,
            cell_index(problem, problem.start),
            cell_index(problem, problem.goal),
            limits,
            prices,
            np.inf if best is None else best.cost,
            most,
        )

        # A path that labels found becomes known; a bound of inf proves that none keeps the budgets.
        self.bound = max(self.bound, float(least))
        if way:
            rows, cols = np.unravel_index(way[::-1], problem.is_free.shape)
            self.add((np.column_stack([cols, rows]) + 0.5) * problem.resolution_m)
        return num_labels, least == np.inf

    def prices(self) -> tuple[np.ndarray, float] | None:
        """Return the prices ``[K]`` that make the least cost + prices . excess of known paths largest, and that sum.

        None where the solver fails, as where exposures differ by more than 20 powers of ten.
        """
        from scipy.optimize import linprog

        # Unknowns are the prices and the bound, which is at most cost + prices . excess of every known path. Costs are
        # divided by the highest one, so that numbers are near 1.
        excess = np.array([known.excess for known in self.known])
        costs = np.array([known.cost for known in self.known])
        unit = costs.max() or 1.0  # 1 if all paths cost nothing
        num = excess.shape[1]
        solution = linprog(
            np.append(np.zeros(num), -1.0),
            A_ub=np.column_stack([-excess, np.ones(len(excess))]),
            b_ub=costs / unit,
            bounds=[(0, STEEPEST)] * num + [(None, None)],
        )
        if solution.x is None:
            return None
        return np.maximum(solution.x[:-1], 0.0) * unit, float(solution.x[-1]) * unit

    def raise_bound(self) -> np.ndarray:
        """Search again and again under the prices that raise the bound most; return the last ones, ``[K]``.

        This ends where a search raises the bound to what known paths allow (but for `ENOUGH`), where the solver fails,
        or where no further search may begin; without any search the prices are 0.
        """
        prices = np.zeros(len(self.budgets))
        while not self.is_late:
            solution = self.prices()
            if solution is None:
                break
            prices, most = solution
            enough = most - ENOUGH * abs(most)
            if self.bound >= enough or self.run(prices) >= enough:
                break
        return prices


def _most_exposures(problem: Problem) -> np.ndarray:
    """Return ``[L]`` what no path exceeds that is nowhere twice, so that a larger budget asks for nothing more."""
    climb_m = 0.0 if problem.levels_m is None else np.diff(problem.levels_m).max(initial=0.0)
    step_m = np.hypot(np.sqrt(2) * problem.resolution_m, climb_m)
    axes = tuple(range(1, problem.costs.ndim))
    sums = problem.costs.sum(axes, np.float64, where=problem.is_free)
    return 2 * sums * step_m / problem.cost_model.reference_length_m  # twice, for rounding


def within_budgets(
    problem: Problem,
    planner: Planner,
    budgets: Mapping[str, float],
    names: Sequence[str],
    *,
    budget_s: float,
    seed: int,
) -> Path:
    """Return the cheapest path of a grid planner whose exposures keep their budgets, with a lower bound of all of them.

    The status is OPTIMAL where prices or labels close the gap, OVER_EXPOSURE where every path exceeds a budget, and
    UNDECIDED where neither a path nor such a proof was found and more seconds would change nothing.

    Args:
      problem: the query, under the ``line`` model.
      planner: a grid planner; its lower bounds must hold for all paths of the grid.
      budgets: largest exposure allowed, >= 0, by name of the layer.
      names: of the problem's layers, in their order.
      budget_s: seconds for all searches together.
      seed: of the planner.
    """
    # The path without budgets is the answer if it keeps them, or if there is none.
    begin_s = time.perf_counter()
    columns = [names.index(name) for name in budgets]
    search = _Search(problem, planner, columns, budgets.values(), seed, begin_s + budget_s)
    search.run(np.zeros(len(budgets)))
    first = search.paths[0]
    if not search.known or search.best() is not None:
        return first

    # Raise the bound by prices. With no path within the budgets, look whether one budget alone is below what any path
    # has, and, if not, go on. Labels close what is left on one altitude.
    num_labels = 0
    is_over = False
    prices = search.raise_bound()
    if search.best() is None and not search.is_late:
        is_over = bool((search.least_exposures() > search.budgets * (1 + SAME_EXPOSURE)).any())
        if not is_over:
            prices = search.raise_bound()
    best = search.best()
    has_gap = best is None or best.cost > search.bound * (1 + SAME_EXPOSURE)
    if not is_over and problem.levels_m is None and has_gap:
        num_labels, is_over = search.close(prices)

    status, note = _end_of(search, num_labels, is_over, budgets)
    best = search.best()
    num_expanded = sum(path.num_expanded for path in search.paths) + num_labels
    return Path.of(
        problem,
        np.empty(0) if best is None else best.points_m,
        status,
        np.inf if is_over else search.bound,
        begin_s + first.setup_s,
        **first.ran | {"num_expanded": num_expanded, "note": note},
    )


def _end_of(
    search: _Search, num_labels: int, is_over: bool, budgets: Mapping[str, float]
) -> tuple[Status, str]:
    """Return how a search within budgets ended, and the sentence that says so.

    Args:
      search: after its last search.
      num_labels: labels that it made.
      is_over: whether it is proven that every path exceeds a budget.
      budgets: by name of the layer, for the sentence.
    """
    best = search.best()
    is_spent = search.is_out_of_time
    limits = " and ".join(f"{name} <= {most:g}" for name, most in budgets.items())
    if best is not None:
        status = Status.BUDGET_FEASIBLE if is_spent else Status.FEASIBLE
        if best.cost * (1 - 2 * SAME_EXPOSURE) <= search.bound:
            status = Status.OPTIMAL
        counts = f"searches: {len(search.paths)}, labels: {num_labels:,}"
        return status, f"That is of the paths that keep {limits} ({counts})."
    if is_over:
        least = zip(budgets, search.least_exposures(), strict=True)
        exposures = ", ".join(f"{value:.10g} to {name}" for name, value in least)
        alone = " to each alone" if len(budgets) > 1 else ""
        return Status.OVER_EXPOSURE, f"The least exposure that any path has{alone} is {exposures}."
    remedy = "raise budget_s, or a budget of exposure" if is_spent else "raise a budget of exposure"
    status = Status.BUDGET_EMPTY if is_spent else Status.UNDECIDED
    return status, f"Whether any path keeps {limits} is not known: {remedy}."


@compiled()
def _advance(graph, layers, to_go, start, goal, limits, prices, most_cost, most_labels):
    """Expand labels in order of the least cost that a path through them may have, until one is at the goal.

    A label is a way from the start to a node, with its cost and its exposures so far.

    Args:
      graph: of the problem (`graph_of`), on one altitude. ``M`` nodes.
      layers: ``[K, M]`` cost of each cell in each layer whose exposure has a limit.
      to_go: ``[K + 2, M]`` the least exposures from each cell to the goal, then cost, then cost under prices.
      start, goal: nodes.
      limits: ``[K]`` largest exposures allowed.
      prices: ``[K]`` cost per exposure.
      most_cost: cost of a known path, inf for none: only a cheaper one is looked for.
      most_labels: how many labels may be made.

    Returns:
      The nodes of the path from the goal back to the start, empty if no cheaper path was found; the number of labels
      made; and a lower bound of the cost of every path within the limits, or ``most_cost`` if that is lower.
    """
    num = len(limits)
    size = 1  # labels made
    num_compared = 0

    # Of each label: node, parent label, next older label at the node, cost and exposures so far.
    # Memory that is not written to is not taken.
    node = np.empty(most_labels, np.int64)
    parent = np.empty(most_labels, np.int64)
    older = np.empty(most_labels, np.int64)
    cost = np.empty(most_labels)
    spent = np.empty((most_labels, num))
    node[0] = start
    parent[0] = -1
    cost[0] = 0.0
    spent[0] = 0.0
    newest = np.full(graph.cost.size, -1)  # the label expanded last at each node, -1 for none
    offsets = graph.steps[:, 0] * graph.num_cols + graph.steps[:, 1]
    queue = [(to_go[num, start], 0)]
    way = [0 for _ in range(0)]  # an empty list of whole numbers, as Numba has to know the type

    while queue:
        # At the goal, follow the parents back; where there is no room for more, what is open bounds the cost.
        least, label = heapq.heappop(queue)
        at = node[label]
        if at == goal:
            while label >= 0:
                way.append(node[label])
                label = parent[label]
            return way, size, least
        if size + len(offsets) > most_labels or num_compared > COMPARED * most_labels:
            return way, size, least

        # Drop a label if one expanded before at its node, at no higher cost, has spent no more of any exposure.
        other = newest[at]
        while other >= 0 and not (spent[other] <= spent[label]).all():
            other = older[other] if num > 1 else -1  # of one budget the newest has spent least
            num_compared += 1
        if other >= 0:
            continue
        older[label] = newest[at]
        newest[at] = label

        # Make a label of each step that may still keep the limits and end below the known path's cost.
        for k in range(len(offsets)):
            if not (graph.moves[at] >> k) & 1:
                continue
            to = at + offsets[k]
            here = graph.from_share[k]
            there = graph.to_share[k]
            to_cost = (
                cost[label] + graph.step_cost[k] + here * graph.cost[at] + there * graph.cost[to]
            )
            to_spent = spent[label] + here * layers[:, at] + there * layers[:, to]
            priced = to_cost + np.sum(prices * (to_spent - limits)) + to_go[num + 1, to]
            if (to_spent + to_go[:num, to] > limits).any() or max(
                priced, to_cost + to_go[num, to]
            ) >= most_cost:
                continue

            node[size], parent[size], cost[size] = to, label, to_cost
            for layer in range(num):  # a row at once takes Numba 1.5 s more to compile
                spent[size, layer] = to_spent[layer]
            heapq.heappush(queue, (to_cost + to_go[num, to], size))
            size += 1
    return way, size, most_cost
