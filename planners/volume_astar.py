"""26-connected A* through a stack of levels."""

import time

import numpy as np

from jaxurban.kernels.search.bounds import sums_to
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, FULL, PAUSED, Heap, push
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.checks import check_budget, check_name
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.moves import STEPS, allowed_moves, steps_back
from jaxurban.planners.search.volume import (
    CLOSED,
    NO_PARENT,
    PARENT_STEP,
    VolumeBound,
    VolumeGraph,
    advance_in_volume,
)

VOLUME_HEURISTICS = ("none", "octile", "plus")  # all admissible and consistent
CHUNK = 50_000  # expansions between two looks at the clock: some 50 ms
FIRST_HEAP = 4096  # entries; doubled when full
ALL_STEPS = np.array([*STEPS, (0, 0)])
SHORT_CHUNK = 2_000  # expansions, where the end may be near
MARGIN = 1.15  # paths over Lower Manhattan cost up to 1.14 times what the cheapest levels beneath them would
NOWHERE = -1  # as a goal: visit all that can be reached


@compiled_first()
def volume_astar(problem: Problem, *, budget_s: float = np.inf, seed: int = 0, heuristic: str = "plus") -> Path:
    """Return the cheapest path through the volume, or why there is none; ``points_m`` is ``[N, 3]``: x, y, altitude.

    The status is OPTIMAL where a path is found. The search runs in chunks, so that the budget and Ctrl-C are
    heeded within some 50 ms; it is deterministic, and the seed plays no part.

    Args:
      problem: the query.
      budget_s: seconds of search.
      seed: taken for the planner contract.
      heuristic: a name of `VOLUME_HEURISTICS` (see `make_bound`).

    Raises:
      InputError: an unknown heuristic, or a budget that is not positive.
    """
    check_budget(budget_s)
    begin_s = time.perf_counter()
    bound = make_bound(heuristic, problem, begin_s + budget_s)
    start, goal = (int(np.ravel_multi_index(node, problem.is_free.shape)) for node in (problem.start, problem.goal))
    search = _Search(_graph(problem), bound, start)
    ended = search.run(goal, begin_s + budget_s)
    ways = {FOUND: Status.OPTIMAL, EXHAUSTED: Status.NO_PATH}
    return Path.of(
        problem,
        _points_m(problem, search.state) if ended == FOUND else np.empty(0),
        ways.get(ended, Status.BUDGET_EMPTY),
        float(search.heap.f[0]),
        begin_s,
        num_expanded=search.num_expanded,
        planner="astar-volume",
        heuristic=heuristic,
    )


def make_bound(name: str, problem: Problem, end_s: float = np.inf) -> VolumeBound:
    """Return a lower bound of the cost to a problem's goal; every one is admissible and consistent.

    - ``none``: 0, which makes A* Dijkstra's search.
    - ``octile``: the least horizontal length, plus what changing to the goal's level costs at least: a step
      that rises by d is longer than its horizontal part s by ``sqrt(s^2 + d^2) - s``, which is least for the
      longest s (a diagonal).
    - ``plus``: the exact cost to the goal over the map of each column's cheapest level, where it is more than
      the horizontal length, plus the same for the change of level. Where the clock passes ``end_s`` (of
      `time.perf_counter`) first, the cost of what was reached until then.

    Raises:
      InputError: an unknown name.
    """
    check_name("heuristic", name, VOLUME_HEURISTICS)
    if name == "none":
        return VolumeBound(0.0, 0.0, np.empty((0, 0)), np.zeros(len(problem.levels_m)))
    per_side = problem.distance_weight * problem.resolution_m
    return VolumeBound(
        straight=per_side,
        diagonal=per_side * (np.sqrt(2) - 1 if problem.cost_model.connectivity == 8 else 1),
        plan=_seen_from_above(problem, end_s) if name == "plus" else np.empty((0, 0)),
        rise=_costs_of_rising(problem),
    )


def _rises_m(problem: Problem) -> np.ndarray:
    """Return ``[K, 3]`` metres from each level to the one below, to itself, and to the one above (NaN: none)."""
    framed = np.pad(problem.levels_m, 1, constant_values=np.nan)
    return np.stack([framed[:-2], framed[1:-1], framed[2:]], axis=1) - problem.levels_m[:, None]


def _height_costs(problem: Problem) -> np.ndarray:
    """Return ``[K, 3]`` cost of the height alone of a step down, level, or up."""
    rise_m = _rises_m(problem)
    climb_cost, descent_cost = problem.height_costs
    return np.where(rise_m > 0, climb_cost * rise_m, -descent_cost * rise_m)


def _costs_of_rising(problem: Problem) -> np.ndarray:
    """Return ``[K]`` the least that changing from each level to the goal's costs beside horizontal length."""
    longest_m = problem.resolution_m * (np.sqrt(2) if problem.cost_model.connectivity == 8 else 1)
    extra_m = np.hypot(longest_m, _rises_m(problem)) - longest_m
    change = problem.distance_weight * extra_m + _height_costs(problem)
    return sums_to(problem.goal[0], change[:-1, 2], change[1:, 0])


def _graph(problem: Problem) -> VolumeGraph:
    """Return the volume as the search sees it."""
    length_m = np.hypot(_rises_m(problem)[:, :, None], problem.resolution_m * np.hypot(*ALL_STEPS.T))
    step_cost = problem.distance_weight * length_m + _height_costs(problem)[:, :, None]
    shares = _shares(problem, length_m)
    return _make_graph(problem.cost, problem.moves, step_cost, *shares)


def _seen_from_above(problem: Problem, end_s: float) -> np.ndarray:
    """Return ``[Y, X]`` the cost to the goal's cell if every cell could be crossed at its cheapest level.

    Costs beyond `MARGIN` times the start's, or beyond what is reached before ``end_s``, are cut there: the lesser
    of two consistent bounds is one too, and it is sooner done.
    """
    is_free = np.any(problem.is_free, axis=0)
    length_m = np.repeat(problem.resolution_m * np.hypot(*ALL_STEPS.T)[None, None], 3, axis=1)
    from_share, to_share = _shares(problem, length_m)
    backwards = _make_graph(
        problem.cost.min(axis=0)[None],
        allowed_moves(is_free, problem.cost_model.connectivity, problem.cost_model.diagonal == "both-free")[None],
        problem.distance_weight * length_m,
        to_share,
        from_share,
    )
    goal, start = (row * is_free.shape[1] + col for _, row, col in (problem.goal, problem.start))
    search = _Search(backwards, VolumeBound(0.0, 0.0, np.empty((0, 0)), np.zeros(1)), goal)
    g = search.g
    while search.run(NOWHERE, max_expanded=SHORT_CHUNK) == PAUSED:
        low_f = search.heap.f[0]
        if (search.state[start] & CLOSED and low_f >= MARGIN * g[start]) or time.perf_counter() >= end_s:
            g = np.minimum(g, low_f)
            break
    return g.reshape(is_free.shape)


def _shares(problem: Problem, length_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of the map cost of its first and of its last node a step of each length costs."""
    if problem.cost_model.kind == "cell":
        return np.zeros(length_m.shape), np.ones(length_m.shape)
    half = length_m / (2 * problem.cost_model.reference_length_m)
    return half, half


def _make_graph(
    cost: np.ndarray, moves: np.ndarray, step_cost: np.ndarray, from_share: np.ndarray, to_share: np.ndarray
) -> VolumeGraph:
    num_levels, num_rows, num_cols = cost.shape
    return VolumeGraph(
        np.ascontiguousarray(cost).reshape(-1),
        np.ascontiguousarray(moves).reshape(-1),
        (num_levels, num_rows, num_cols),
        ALL_STEPS,
        step_cost,
        from_share,
        to_share,
    )


class _Search:
    """A search that can be resumed: every node's g and state, and the open nodes."""

    def __init__(self, graph: VolumeGraph, bound: VolumeBound, start: int) -> None:
        self.graph, self.bound = graph, bound
        self.g = np.full(graph.cost.size, np.inf)
        self.state = np.full(graph.cost.size, NO_PARENT, np.uint8)
        self.heap = Heap.empty(FIRST_HEAP, np.int64)
        self.num_expanded = 0
        self.g[start] = 0.0
        push(self.heap, 0.0, start)

    def run(self, goal: int, end_s: float = np.inf, max_expanded: float = np.inf) -> int:
        """Search on to the goal, the end of all, the time ``end_s``, or so many more nodes; return which it was."""
        last = self.num_expanded + max_expanded
        while True:
            most = int(min(CHUNK, last - self.num_expanded))
            ended, num_done = advance_in_volume(self.graph, self.bound, goal, self.g, self.state, self.heap, most)
            self.num_expanded += num_done
            if ended == FULL:
                self.heap = self.heap.grown()
            elif ended != PAUSED or time.perf_counter() >= end_s or self.num_expanded >= last:
                return ended


def _points_m(problem: Problem, state: np.ndarray) -> np.ndarray:
    """Return ``[N, 3]`` the nodes from start to goal in metres, by the steps that led to each."""
    state = state.reshape(problem.is_free.shape) & PARENT_STEP
    steps = [(up, *cells) for up in (-1, 0, 1) for cells in ALL_STEPS.tolist()]
    nodes = steps_back(problem.start, problem.goal, lambda *node: steps[state[node]])
    xy_m = (nodes[:, :0:-1] + 0.5) * problem.resolution_m
    return np.column_stack([xy_m, problem.levels_m[nodes[:, 0]]])
