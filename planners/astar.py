"""A* on the grid, 4- or 8-connected, and through a stack of levels, and its estimates of the cost to the goal, by name.

Landmarks are a few cells whose distances to all others bound the cost between any two (differential heuristics): with
S(L, n) the cost between landmark L and node n, the triangle inequality gives |S(L, n) - S(L, t)| as a bound from n to
t, admissible and consistent (Goldberg & Harrelson 2005; Sturtevant et al. 2009). S must be symmetric. The ``line``
model is; under ``cell`` a step costs the cell entered, so S counts half of each of its two cells, and a path from n to
t costs S plus (c(t) - c(n)) / 2: one field serves both ways.
"""

import time
from functools import partial

import numpy as np

from jaxurban.checks import one_of
from jaxurban.kernels.search.bounds import LandmarkBound, TileBound, printed_plus_field, tile_bound
from jaxurban.kernels.search.heap import CLOSED, EXHAUSTED, FOUND, PAUSED
from jaxurban.planners.base import Cell, Path, Problem, Status, islands_of
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.grid_search import (
    NO_HEURISTIC,
    GridSearch,
    Heuristic,
    cell_of,
    estimate,
    graph_of,
    height_cost,
    path_points_m,
    rises_m,
)

# All of them consistent too, but for rounding: landmarks' costs are float32.
ADMISSIBLE = ("none", "euclidean", "octile", "tiles", "landmarks", "exact")
PRINTED = ("plus-printed", "plus-printed-from-0")
HEURISTICS = ADMISSIBLE + PRINTED
VOLUME_HEURISTICS = ("none", "octile", "plus")  # all admissible and consistent
AUTO = "auto"  # "tiles" for one query; of many, `planners.registry` chooses by what they share
NUM_LANDMARKS = 8  # 8 float32 fill half a cache line
LARGEST = np.finfo(np.float32).max
FEW = 2_000  # expansions, where the end may be near


@compiled_first()
def astar(
    problem: Problem,
    *,
    budget_s: float = np.inf,
    seed: int = 0,
    heuristic: str = "octile",
    reopen: bool = False,
    planner: str = "astar",
) -> Path:
    """Return the cheapest path over the grid, or through the volume, or why there is none.

    The status is OPTIMAL where the heuristic is admissible, else FEASIBLE. The search runs in chunks, so
    that the budget and Ctrl-C are heeded within some 50 ms; it is deterministic, and the seed plays no part.

    Args:
      problem: the query.
      budget_s: seconds of search and of the tables that its heuristic needs.
      seed: taken for the planner contract.
      heuristic: a name of `HEURISTICS`, or ``"auto"``: ``tiles``; in a volume one of `VOLUME_HEURISTICS`.
        The path says which ran.
      reopen: expand a node again when a cheaper way to it turns up after it was closed, also with a printed heuristic:
        it mends some of its paths, at up to exponential cost. With all others that is done anyway.
      planner: the name that the path carries.

    Raises:
      InputError: an unknown heuristic.
    """
    begin_s = time.perf_counter()
    end_s = begin_s + budget_s
    name = "tiles" if heuristic == AUTO else heuristic

    # Where the budget ends before the heuristic's tables are made, nothing is searched.
    note = ""
    try:
        bound = make_heuristic(name, problem, end_s)
    except TimeoutError:
        bound = make_heuristic("octile", problem)
        note = f"The tables of the heuristic {name!r} were not done in time."

    start = cell_of(problem, problem.start)
    goal = cell_of(problem, problem.goal)
    search = GridSearch(graph_of(problem), bound, start, goal)
    ended = search.run(reopen=reopen or name not in PRINTED, end_s=end_s) if not note else PAUSED

    points_m = np.empty(0)
    lower_bound = search.low_f if ended == PAUSED else np.inf
    if ended == FOUND:
        status = Status.FEASIBLE if name in PRINTED else Status.OPTIMAL
        points_m = path_points_m(problem, search.states, search.graph.steps)
    else:
        status = Status.NO_PATH if ended == EXHAUSTED else Status.BUDGET_EMPTY
    if name in PRINTED:  # which are no lower bounds
        lower_bound = heuristic_at(make_heuristic("octile", problem), start, goal)
    return Path.of(
        problem,
        points_m,
        status,
        lower_bound,
        begin_s,
        num_expanded=search.num_expanded,
        planner=planner,
        heuristic=name,
        note=note,
    )


astar_auto = partial(astar, heuristic=AUTO)  # the bound that suits the queries
# The paper's two: guided by the straight distance, and by distance and map costs, with an admissible bound.
astar_dist = partial(astar, heuristic="euclidean", planner="astar-dist")
astar_plus = partial(astar, heuristic=AUTO, planner="astar-plus")
# Through a stack of levels, 26-connected.
volume_astar = partial(astar, heuristic="plus", planner="astar-volume")


def make_heuristic(name: str, problem: Problem, end_s: float = np.inf) -> Heuristic:
    """Return a heuristic for a problem's goal, map, weights and cost model.

    - ``none``: 0, which makes A* Dijkstra's search.
    - ``euclidean``: ``distance_weight`` times the straight distance (the paper's h_dist).
    - ``octile``: the cost of the least length of an 8-connected path (at connectivity 4 of the Manhattan distance). In
    a
      volume it adds the least cost of changing to the goal's level: a step that rises by d is longer than its
      horizontal part s by ``sqrt(s^2 + d^2) - s``, which is least for the longest s (a diagonal).
    - ``tiles``: octile or, where larger, the cost to go over tiles of 8 x 8 cells that cost what their cheapest cell
      does (admissible, consistent).
    - ``landmarks``: octile or, where larger, the best landmark's bound (admissible, consistent).
    - ``exact``: the cost to go itself.
    - ``plus-printed``, ``plus-printed-from-0``: octile, plus the paper's box minima, summed over indices
      1..dx or 0..dx-1: **not** admissible. Under the ``line`` model every line counts in full.
    - ``plus``, of volumes: octile or, where larger, the cost to the goal over the map of each column's cheapest level,
      plus the same for the change of level; as far as that search came before ``end_s``.

    Args:
      name: of `HEURISTICS`, or of `VOLUME_HEURISTICS`.
      problem: the query.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      InputError: an unknown name.
      TimeoutError: the clock passed ``end_s`` before the tables that all queries share were made.
    """
    one_of("heuristic", name, HEURISTICS if problem.levels_m is None else VOLUME_HEURISTICS)
    per_side = problem.distance_weight * problem.resolution_m
    # With dr, dc rows and columns to the goal: the larger one in straight steps, and what each of the smaller one's
    # steps costs more, as part of a diagonal or, with 4 neighbours, as a step of its own.
    more = np.sqrt(2) - 1 if problem.cost_model.connectivity == 8 else 1
    octile = NO_HEURISTIC._replace(straight=per_side, diagonal=per_side * more)

    if problem.levels_m is not None:
        return _volume_heuristic(name, problem, octile, end_s)
    if name == "none":
        return NO_HEURISTIC
    if name == "exact":
        return NO_HEURISTIC._replace(field=exact_cost_to_go(problem, end_s))
    if name == "euclidean":
        return NO_HEURISTIC._replace(euclidean=per_side)
    if name == "landmarks":
        landmarks = make_landmarks(problem, end_s=end_s)
        goal_term = landmarks.cost_share * float(problem.cost[problem.goal]) + landmarks.goal_term
        at_goal = landmarks.costs[problem.goal]
        return octile._replace(landmarks=landmarks._replace(at_goal=at_goal, goal_term=goal_term))
    if name == "tiles":
        return octile._replace(tiles=_tile_bound(problem))
    if name == "octile":
        return octile

    # What the paper prints.
    layers = problem.costs * problem.layer_weights[:, None, None]
    field = printed_plus_field(layers, problem.goal, first_index=int(name == "plus-printed"))
    if problem.cost_model.kind == "line":
        field *= problem.resolution_m / problem.cost_model.reference_length_m
    # Costs of NaN inside obstacles give inf here, which the search would take for a proof that there is no way.
    return octile._replace(field=np.minimum(field, np.finfo(np.float64).max / 2, out=field))


def _tile_bound(problem: Problem) -> TileBound:
    """Return the tiles' bound on the cost to the problem's goal.

    A step costs a constant plus a share of the map costs of its two cells, so over a tile whose cheapest cell costs c
    it costs at least ``base + share * c``; the pairs (base, share) are of a straight and of a diagonal step.
    """
    graph = graph_of(problem)
    share = graph.from_share + graph.to_share
    # Of `STEPS` the first is straight, and with 8 neighbours the last is diagonal; with 4 two steps make a diagonal.
    straight, diagonal = ((float(graph.step_cost[step]), float(share[step])) for step in (0, -1))
    if problem.cost_model.connectivity == 4:
        diagonal = (2 * straight[0], 2 * straight[1])
    return tile_bound(problem.tile_minima, straight, diagonal, problem.start, problem.goal)


def _volume_heuristic(name: str, problem: Problem, octile: Heuristic, end_s: float) -> Heuristic:
    """Return a heuristic in a volume: length and map cost, if the name asks for them, and the change of level.

    Args:
      name: of `VOLUME_HEURISTICS` (see `make_heuristic`).
      problem: the query in a volume.
      octile: the octile heuristic on one altitude.
      end_s: time of `time.perf_counter` to give up at.
    """
    goal, goal_row, goal_col = problem.goal
    _, num_rows, num_cols = problem.is_free.shape

    # The least that changing from each level to the goal's costs beside horizontal length: of each level ``[H, 3]`` to
    # the one below, to itself and to the one above, then summed level by level away from the goal's.
    longest_m = problem.resolution_m * (np.sqrt(2) if problem.cost_model.connectivity == 8 else 1)
    rise_m = rises_m(problem)
    change = problem.distance_weight * (np.hypot(longest_m, rise_m) - longest_m) + height_cost(
        problem, rise_m
    )
    up = change[:-1, 2]
    down = change[1:, 0]
    rise = np.concatenate([np.cumsum(up[:goal][::-1])[::-1], [0.0], np.cumsum(down[goal:])])

    if name == "none":
        return NO_HEURISTIC._replace(num_rows=num_rows, rise=np.zeros(len(rise_m)))
    if name == "octile":
        return octile._replace(num_rows=num_rows, rise=rise)

    # "plus": the larger of length and map cost, in one field for all levels.
    rows = np.abs(np.arange(num_rows) - goal_row)[:, None]
    cols = np.abs(np.arange(num_cols) - goal_col)
    length = octile.straight * np.maximum(rows, cols) + octile.diagonal * np.minimum(rows, cols)
    field = np.maximum(length, _seen_from_above(problem, end_s))
    return NO_HEURISTIC._replace(field=field, num_rows=num_rows, rise=rise)


def _seen_from_above(problem: Problem, end_s: float) -> np.ndarray:
    """Return ``[Y, X]`` the cost to the goal's cell if every cell could be crossed at its cheapest level.

    The search ends soon after it has reached the start, or at ``end_s`` (of `time.perf_counter`). Costs above the
    highest one reached by then are cut to it: the lesser of two consistent bounds is a consistent bound too.
    """
    # The map as seen from above: the cheapest level of each cell, free if any level is.
    cost = problem.cost.min(axis=0)
    is_free = np.any(problem.is_free, axis=0)
    weights = [problem.distance_weight, 1.0]
    model = problem.cost_model
    plan = Problem(
        cost[None],
        is_free,
        problem.start[1:],
        problem.goal[1:],
        problem.resolution_m,
        weights,
        model,
    )

    # Backwards from the goal: shares of the cells that a step leaves and enters change places.
    graph = graph_of(plan)
    backwards = graph._replace(from_share=graph.to_share, to_share=graph.from_share)
    search = GridSearch(backwards, NO_HEURISTIC, plan.goal, None)
    ended, is_reached = PAUSED, False
    while ended == PAUSED and not is_reached and time.perf_counter() < end_s:
        is_reached = bool(search.states[plan.start] & CLOSED)  # then one chunk more is searched
        ended = search.run(end_s=0.0, chunk=FEW + search.num_expanded // 4)

    low_f = search.low_f  # inf after the whole search
    return np.minimum(search.costs_from_start().reshape(is_free.shape), low_f)


def heuristic_at(heuristic: Heuristic, cell: Cell, goal: Cell) -> float:
    """Return ``h`` at a cell."""
    return float(estimate(heuristic, *cell, *goal))


def symmetric_costs(problem: Problem, end_s: float = np.inf) -> np.ndarray:
    """Return ``[Y, X]`` the costs between a problem's goal and every cell, inf without a way, by Dijkstra's search.

    Under the ``cell`` model half of each of a step's two cells is counted (see above), so that the cost is the
    same both ways.

    Args:
      problem: of any map and weights; its start plays no part.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      TimeoutError: the clock passed ``end_s``.
    """
    search = GridSearch(graph_of(problem, is_symmetric=True), NO_HEURISTIC, problem.goal, None)
    if search.run(end_s=end_s) != EXHAUSTED:
        raise TimeoutError
    return search.costs_from_start().reshape(problem.is_free.shape)


def exact_cost_to_go(problem: Problem, end_s: float = np.inf) -> np.ndarray:
    """Return ``[Y, X]`` the exact cost from every cell to a problem's goal, inf without a way.

    The costs are kept with the map for all queries to the same goal, until those to another goal take their place: a
    search with ``heuristic="exact"`` then only walks down on them.

    Args:
      problem, end_s: as in `symmetric_costs`.

    Raises:
      TimeoutError: the clock passed ``end_s``; nothing new is kept.
    """
    cache = problem.cache
    costs_to_go = cache.costs_to_go  # another thread may replace it meanwhile
    if problem.goal not in costs_to_go:
        costs = symmetric_costs(problem, end_s)
        if problem.cost_model.kind == "cell":
            # Symmetric costs count half of both cells of a step, the problem's all of the cell entered.
            half = 0.5 * (problem.cost[problem.goal] - np.where(problem.is_free, problem.cost, 0.0))
            costs = np.maximum(costs + half, 0.0)  # rounding might leave less
        costs_to_go = cache.costs_to_go = {problem.goal: costs}
    return costs_to_go[problem.goal]


def make_landmarks(problem: Problem, end_s: float = np.inf) -> LandmarkBound:
    """Return landmarks for a problem's map and weights, built once for all its queries (`Problem.between`).

    Landmarks that the map has already are returned. Their bound is lowered by one unit in the
    last place of the largest cost for every cell, which is more than the sums along any path can lose, and by two in
    the last place of float32, in which costs are kept (each of the two costs and their difference lose half a unit at
    most), so that rounding never lifts it above the true cost.

    Args:
      problem: the query; its start and goal play no part.
      end_s: time of `time.perf_counter` to give up at.

    Raises:
      TimeoutError: the clock passed ``end_s``.
    """
    if problem.cache.landmarks is None:
        cells = landmark_cells(problem, NUM_LANDMARKS)
        costs = np.empty((*problem.is_free.shape, len(cells)), np.float32)
        for k, cell in enumerate(cells):
            costs_to_cell = symmetric_costs(problem.between(cell, cell), end_s)
            # Cut where float32 ends: inf would prove that there is no way.
            np.minimum(costs_to_cell, LARGEST, out=costs_to_cell, where=costs_to_cell < np.inf)
            costs[..., k] = costs_to_cell
        largest = np.max(costs, where=np.isfinite(costs), initial=0.0)
        rounding = problem.is_free.size * np.finfo(np.float64).eps + 2 * np.finfo(np.float32).eps
        slack = float(largest) * rounding
        cost_share = 0.5 if problem.cost_model.kind == "cell" else 0.0
        problem.cache.landmarks = LandmarkBound(
            costs, costs[cells[0]], problem.cost, cost_share, -slack
        )
    return problem.cache.landmarks


def landmark_cells(problem: Problem, num: int) -> list[Cell]:
    """Return up to ``num`` cells of the largest connected part of the map, far from its middle and from each other.

    The first is the cell farthest from the part's mean, each next one the cell farthest from the nearest cell before,
    in a straight line. Choosing by cost instead, or by the share of shortest paths left uncovered (avoid, Goldberg
    & Werneck 2005), saved no more expansions on Lower Manhattan and needs searches of its own.
    """
    # A diagonal step between two free neighbours joins what they join already.
    parts = islands_of(problem.is_free, problem.cost_model.joins_corners)
    largest = 1 + np.argmax(np.bincount(parts.ravel())[1:])  # part 0 is what is not free
    rows, cols = np.nonzero(parts == largest)
    away = np.hypot(rows - rows.mean(), cols - cols.mean())
    cells: list[Cell] = []
    nearest = np.full(rows.size, np.inf)
    while len(cells) < min(num, rows.size):
        i = np.argmax(nearest if cells else away)
        cells.append((int(rows[i]), int(cols[i])))
        nearest = np.minimum(nearest, np.hypot(rows - rows[i], cols - cols[i]))
    return cells
