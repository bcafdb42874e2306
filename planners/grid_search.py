"""The compiled A* search over a grid, or over a stack of them, run in bounded chunks that the caller resumes."""

import time
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.bounds import LandmarkBound, TileBound, tile_estimate
from jaxurban.kernels.search.heap import (
    AS_HEAP,
    CLOSED,
    EXHAUSTED,
    FOUND,
    FULL,
    IS_HEAP,
    NO_STEP,
    NUM_FAR,
    PARENT_STEP,
    PAUSED,
    REACHED,
    UNREACHED,
    drop_top,
    empty_queue,
    grown,
    insert,
    place,
    refill,
)
from jaxurban.kernels.tolerances import CHEAPER
from jaxurban.planners.base import Cell, Problem, cell_index
from jaxurban.planners.cost import STEPS

# (levels up, rows, columns): the eight steps of a level, those that also climb, and descend, straight up, and down.
ALL_STEPS = np.array([(up, *step) for up in (0, 1, -1) for step in STEPS] + [(1, 0, 0), (-1, 0, 0)])
MAX_STEPS = len(ALL_STEPS)
NOWHERE = -1  # a goal that is never met
CHUNK = 50_000  # expansions between two looks at the clock: some 15 ms on one level
FIRST_ENTRIES = 4096  # of a queue; doubled when full
# A search takes a heap when more nodes were opened again than these: of few expansions, and one in so many.
FEW_AGAIN, OFTEN = 50, 50
SAMPLES = 4093  # cells of a map that stand for all


class Graph(NamedTuple):
    """A grid as the search sees it; nodes are flat cell numbers. ``M`` nodes, ``K`` steps, ``H`` levels.

    A volume is one grid, its levels stacked row upon row. On level l step k from P to Q costs
    ``step_cost[l * K + k] + from_share[l * K + k] * cost[P] + to_share[l * K + k] * cost[Q]``.

    Attributes:
      cost: ``[M]`` float64 map cost; inf where a node of a volume is not free.
      moves: ``[M]`` uint8, bit k: step k of the first eight is allowed on the node's level. In a volume a step to
        another level is where it is allowed on both.
      num_cols: cells in a row.
      steps: ``[K, 2]`` int64 rows and columns of each step: eight, or in a volume all of `ALL_STEPS`.
      step_cost, from_share, to_share: ``[H * K]`` float64.
      sample: ``[S]`` float64 costs of cells all over the map from which steps lead.
      plane: nodes of a level of a volume; None on one altitude.
    """

    cost: np.ndarray
    moves: np.ndarray
    num_cols: int
    steps: np.ndarray
    step_cost: np.ndarray
    from_share: np.ndarray
    to_share: np.ndarray
    sample: np.ndarray
    plane: int | None = None


class Heuristic(NamedTuple):
    """A bound ``h(n)`` on the cost to the goal, evaluated node by node. ``Y`` rows, ``X`` columns.

    With ``dr, dc`` rows and columns to the goal: a distance part ``euclidean * hypot(dr, dc)
    + straight * max(dr, dc) + diagonal * min(dr, dc)``, plus ``field[r, c]`` where it has any cells. Landmarks or
    tiles may raise it. In a volume rows and columns are those of the plan, and ``rise`` of the level is added.

    Attributes:
      euclidean, straight, diagonal: cost per cell side.
      field: ``[Y, X]`` float64 map cost to the goal, or ``[0, 0]``. With a distance part of 0 it may hold
        the whole cost to go; inf proves that there is no way.
      landmarks, tiles: further bounds, of which the largest counts. A type of its own where there is one, so
        that the search is compiled without it for all others.
      num_rows: of a level of a volume.
      rise: ``[H]`` float64 the least cost of changing from each level to the goal's; None on one altitude.
    """

    euclidean: float
    straight: float
    diagonal: float
    field: np.ndarray
    landmarks: LandmarkBound | None = None
    tiles: TileBound | None = None
    num_rows: int = 0
    rise: np.ndarray | None = None


NO_HEURISTIC = Heuristic(0.0, 0.0, 0.0, np.empty((0, 0)))  # 0, which makes A* Dijkstra's search


def graph_of(problem: Problem, *, is_symmetric: bool = False) -> Graph:
    """Return the problem's map as the search sees it.

    Args:
      problem: the query.
      is_symmetric: under the ``cell`` model, count half of each of a step's two cells instead of the one
        entered. A path from P to Q then costs ``(cost[P] - cost[Q]) / 2`` more than it does in truth.
    """
    # Costs of some cells from which steps lead, evenly spread over the map.
    cost = problem.cost
    moves = problem.moves.reshape(-1)
    stride = max(1, moves.size // SAMPLES)
    sample = cost.reshape(-1)[::stride][moves[::stride] > 0]

    # Rise and length of each step, ``[H, K]`` by level and step, and the shares of its two cells' costs.
    num_rows, num_cols = cost.shape[-2:]
    is_volume = problem.levels_m is not None
    up, rows, cols = (ALL_STEPS if is_volume else ALL_STEPS[: len(STEPS)]).T
    rise_m = rises_m(problem)[:, 1 + up]
    length_m = np.hypot(rise_m, np.hypot(rows, cols) * problem.resolution_m)
    if problem.cost_model.kind == "line":
        # Half of an edge lies in each of its two cells.
        from_share = to_share = length_m / (2 * problem.cost_model.reference_length_m)
    else:
        from_share = np.full(length_m.shape, 0.5 if is_symmetric else 0.0)
        to_share = 1.0 - from_share

    return Graph(
        cost=cost.reshape(-1),
        moves=moves,
        num_cols=num_cols,
        steps=np.stack([up * num_rows + rows, cols], axis=1),
        step_cost=(problem.distance_weight * length_m + height_cost(problem, rise_m)).reshape(-1),
        from_share=from_share.reshape(-1),
        to_share=to_share.reshape(-1),
        sample=sample,
        plane=num_rows * num_cols if is_volume else None,
    )


def rises_m(problem: Problem) -> np.ndarray:
    """Return ``[H, 3]`` metres from each level to the one below, to itself, and to the one above (0: none)."""
    levels_m = np.zeros(1) if problem.levels_m is None else problem.levels_m
    up_m = np.diff(levels_m)
    rise_m = np.zeros((levels_m.size, 3))
    rise_m[1:, 0] = -up_m
    rise_m[:-1, 2] = up_m
    return rise_m


def height_cost(problem: Problem, rise_m: np.ndarray) -> np.ndarray:
    """Return the cost of the change of height alone of steps that rise by ``rise_m`` metres (negative: descend)."""
    climb_cost, descent_cost = problem.height_costs
    return np.where(rise_m > 0, climb_cost * rise_m, -descent_cost * rise_m)


def cell_of(problem: Problem, node: Cell) -> Cell:
    """Return row and column of a cell, or of a volume's node, in a grid of all levels, row upon row."""
    if problem.levels_m is None:
        return node
    return (node[0] * problem.is_free.shape[1] + node[1], node[2])


def path_points_m(problem: Problem, states: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` (in a volume ``[N, 3]``) x, y (and altitude) of the cells' centres from start to goal, metres.

    The goal must have been reached.

    Args:
      problem: the query.
      states: ``[Y, X]`` uint8 whose bits `PARENT_STEP` number the step that led to each cell; in a volume the rows of
        all levels, one level upon the other.
      steps: ``[K, 2]`` rows and columns of each step, in the same rows.
    """
    # Undo steps from the goal back, by flat numbers and Python's own: NumPy's took ten times as long.
    num_cols = states.shape[1]
    offsets = (steps @ [num_cols, 1]).tolist()
    state = states.reshape(-1).data
    start = cell_index(problem, problem.start)
    nodes = [cell_index(problem, problem.goal)]
    while nodes[-1] != start:
        nodes.append(nodes[-1] - offsets[state[nodes[-1]] & PARENT_STEP])

    row, col = np.divmod(nodes[::-1], num_cols)
    level, row = np.divmod(row, problem.is_free.shape[-2])
    xy_m = (np.stack([col, row], axis=1) + 0.5) * problem.resolution_m
    return xy_m if problem.levels_m is None else np.column_stack([xy_m, problem.levels_m[level]])


# Inlined by force: LLVM would not, and counting references to the arrays took four fifths of the time.
@compiled(forceinline=True)
def _raised(value, landmarks, tiles, row, col):
    """Return the larger of a bound, ``value``, and of what landmarks or tiles prove at a cell, where there are any."""
    if tiles is not None:  # decided when it is compiled
        return max(value, tile_estimate(tiles, row, col))
    if landmarks is None:  # likewise
        return value
    # The greatest difference of the costs to a landmark (see `LandmarkBound`).
    apart = 0.0
    # Unsigned: else Numba asks each time whether an index counts from the end.
    row, col = np.uint64(row), np.uint64(col)
    for k in range(landmarks.at_goal.size):
        # A landmark that reaches only one of the two proves that there is no way (inf); one that reaches
        # neither says nothing (inf - inf is NaN, and greater than nothing).
        difference = abs(landmarks.costs[row, col, k] - landmarks.at_goal[k])
        if difference > apart:
            apart = difference
    return max(value, apart + landmarks.goal_term - landmarks.cost_share * landmarks.cost[row, col])


@compiled(forceinline=True)
def _on_plan(num_rows, rise, row, goal_row):
    """Return the rows of a cell and of the goal on their levels, and what changing from one level to the other adds."""
    if rise is None:  # likewise
        return row, goal_row, 0.0
    return row % num_rows, goal_row % num_rows, rise[row // num_rows]


@compiled(forceinline=True)
def estimate(heuristic, row, col, goal_row, goal_col):
    """Return ``h`` at a cell: the distance part, the change of level, and the field, landmarks or tiles.

    Args:
      heuristic: `Heuristic`, of which a part that is None or has no cells is left out.
      row, col: the cell; in a volume the rows of all levels, one level upon the other.
      goal_row, goal_col: the goal, likewise.
    """
    row, goal_row, value = _on_plan(heuristic.num_rows, heuristic.rise, row, goal_row)
    dr, dc = abs(row - goal_row), abs(col - goal_col)
    value += heuristic.straight * max(dr, dc) + heuristic.diagonal * min(dr, dc)
    if heuristic.euclidean > 0.0:
        value += heuristic.euclidean * np.sqrt(float(dr * dr + dc * dc))
    if heuristic.field.size:
        return value + heuristic.field[row, col]
    return _raised(value, heuristic.landmarks, heuristic.tiles, row, col)


@compiled(forceinline=True)
def _steps_from(plane, moves, cost, node):
    """Return the steps that lead from a node.

    Args:
      plane: nodes of a level of a volume; None on one altitude.
      moves: ``[M]`` uint8 bits of the eight horizontal steps allowed from each node.
      cost: ``[M]``, inf where a node of a volume is not free.
      node: uint64 number of the node.

    Returns:
      The bits of the steps that are allowed, in the order of `ALL_STEPS`; how many steps there are; and where the steps
      of the node's level begin in the graph's tables by level and step.
    """
    if plane is None:  # likewise
        return moves[node], len(STEPS), 0
    here = np.uint32(moves[node])
    above = node + np.uint64(plane)
    below = node - np.uint64(plane)

    # A step up (bits 8 to 15) or down (16 to 23) is allowed where its horizontal part is on both levels; straight up
    # (24) and down (25) where the other node is free.
    bits = here
    if above < np.uint64(moves.size):
        bits |= (here & moves[above]) << 8 | np.uint32(cost[above] < np.inf) << 24
    if node >= np.uint64(plane):
        bits |= (here & moves[below]) << 16 | np.uint32(cost[below] < np.inf) << 25
    return bits, MAX_STEPS, np.int64(node // np.uint64(plane)) * MAX_STEPS


@compiled()
def advance(graph, heuristic, goal, reopen, g, state, queue, max_expanded):
    """Expand nodes about in order of f until the goal's cost is proven, none is open, or ``max_expanded`` are expanded.

    ``f = g + h``. The queue holds outdated entries, which are skipped. With ``reopen`` a cheaper way to a closed node
    opens it again, and the search ends when no open f is below the goal's g, so that its cost is exact for every
    admissible bound, in whatever order nodes come. That depends on the problem alone, so runs repeat.

    All neighbours are looked at before any is changed, without branches, half of which would be mispredicted.

    Args:
      graph: `Graph` to search.
      heuristic: `Heuristic`, the bound to the goal.
      goal: a node, or `NOWHERE`.
      reopen: see above.
      g: ``[M]`` float64 cost of the cheapest way known to each node, of no meaning where it is `UNREACHED`; altered.
      state: ``[M]`` uint8 bits `CLOSED`, `REACHED` and the step from the parent (`PARENT_STEP`); altered.
      queue: `Queue` of the open nodes; altered.
      max_expanded: nodes to expand at most.

    Returns:
      How the chunk ended (FOUND, EXHAUSTED, PAUSED, or FULL for want of room in the queue), and the nodes expanded.
    """
    goal_row = goal // graph.num_cols
    goal_col = goal % graph.num_cols
    offsets = graph.steps[:, 0] * graph.num_cols + graph.steps[:, 1]
    near = queue.near
    tally = queue.tally
    goal_g = CHEAPER * g[goal] if goal != NOWHERE and state[goal] & CLOSED else np.inf
    # A way to a closed node must cost less than this times the way known; none costs less than a negative number.
    if_closed = CHEAPER if reopen else -1.0
    # The steps of one expansion that are cheaper than the way known, and g by them.
    cheaper_steps = np.empty(MAX_STEPS, np.uint64)
    cheaper_gs = np.empty(MAX_STEPS)
    num_expanded, num_again = 0, 0

    while True:
        if near.size[0] == 0:
            if goal_g < np.inf:
                return FOUND, num_expanded
            refill(queue, state)
        if near.size[0] == 0:
            return EXHAUSTED, num_expanded
        if num_expanded >= max_expanded:
            return PAUSED, num_expanded
        if near.size[0] + tally[NUM_FAR] + MAX_STEPS > queue.far_f.size:
            return FULL, num_expanded
        # The stack becomes a heap, for the rest of the search.
        if num_again > FEW_AGAIN + num_expanded // OFTEN and not tally[IS_HEAP]:
            tally[IS_HEAP] = AS_HEAP
            num_near, near.size[0] = near.size[0], 0
            for index in range(num_near):
                near_f, near_node = near.f[index], near.item[index]
                near.item[place(near, near_f, AS_HEAP)] = near_node

        # Close the next node (unsigned, as above).
        index = 0 if tally[IS_HEAP] else near.size[0] - 1
        f, node = near.f[index], np.uint64(near.item[index])
        if tally[IS_HEAP]:
            drop_top(near)
        else:
            near.size[0] -= 1
        if state[node] & CLOSED:
            continue
        if not f < goal_g:
            if tally[IS_HEAP]:
                near.size[0] = 0
            continue
        row = np.uint32(node) // np.uint32(graph.num_cols)
        col = np.uint32(node) % np.uint32(graph.num_cols)
        state[node] |= CLOSED
        if node == goal:
            goal_g = CHEAPER * g[node]
            continue
        num_expanded += 1

        # Look at all steps. One that is not allowed leads to the node itself, and is not counted; what it wrote is then
        # written over.
        steps, num_steps, first = _steps_from(graph.plane, graph.moves, graph.cost, node)
        node_g = g[node]
        node_cost = graph.cost[node]
        num_cheaper = 0
        for k in range(num_steps):
            is_allowed = (steps >> k) & 1
            i = first + k
            to = np.uint64(np.int64(node) + offsets[k] * is_allowed)
            to_g = node_g + (
                graph.step_cost[i]
                + graph.from_share[i] * node_cost
                + graph.to_share[i] * graph.cost[to]
            )
            known_g, to_state = g[to], state[to]
            limit = known_g * (if_closed if to_state & CLOSED else 1.0)
            limit = np.inf if to_state == UNREACHED else limit
            cheaper_steps[num_cheaper], cheaper_gs[num_cheaper] = k, to_g
            num_cheaper += is_allowed & (to_g < limit)

        # Open the nodes to which these steps lead.
        for i in range(num_cheaper):
            k, to_g = cheaper_steps[i], cheaper_gs[i]
            to = np.uint64(np.int64(node) + offsets[k])
            g[to] = to_g
            num_again += state[to] >= CLOSED | REACHED
            state[to] = k | REACHED
            to_row = np.int64(row) + graph.steps[k, 0]
            to_col = np.int64(col) + graph.steps[k, 1]
            to_h = estimate(heuristic, to_row, to_col, goal_row, goal_col)
            if to_g + to_h < goal_g:
                insert(queue, to_g + to_h, np.int64(to))  # the type of all nodes in a queue


class GridSearch:
    """A search in progress: what is known of each node, and the queue of open ones. ``M`` nodes.

    Attributes:
      graph, heuristic: what is searched, by which bound.
      start, goal: nodes, given as row and column (`cell_of`); the goal `NOWHERE` is never met.
      num_expanded: nodes expanded so far.
    """

    def __init__(self, graph: Graph, heuristic: Heuristic, start: Cell, goal: Cell | None) -> None:
        """Begin a search with the start alone open.

        Args:
          graph: what is searched.
          heuristic: the bound to the goal.
          start: row and column (`cell_of`).
          goal: likewise; None for a search of all nodes.
        """
        self.graph, self.heuristic = graph, heuristic
        self.start = start[0] * graph.num_cols + start[1]
        self.goal = NOWHERE if goal is None else goal[0] * graph.num_cols + goal[1]
        self.num_expanded = 0
        num_nodes = graph.cost.size
        cost = float(np.median(graph.sample) or graph.sample.mean()) if graph.sample.size else 0.0
        # Buckets are fitted to what a step over a cell of mean cost costs.
        queue = empty_queue(
            FIRST_ENTRIES,
            float(np.mean(graph.step_cost + (graph.from_share + graph.to_share) * cost)),
        )
        # Memory that is not written to is not taken: what the search does not come to costs nothing.
        self._g = np.empty(num_nodes)
        self._state = np.zeros(num_nodes, np.uint8)
        self._queue = queue
        self._g[self.start] = 0.0
        self._state[self.start] = NO_STEP | REACHED
        insert(queue, 0.0 if goal is None else estimate(heuristic, *start, *goal), self.start)

    @property
    def states(self) -> np.ndarray:
        """``[Y, X]`` uint8 of each node, levels stacked row upon row."""
        return self._state.reshape(-1, self.graph.num_cols)

    def costs_from_start(self) -> np.ndarray:
        """Return ``[M]`` float64 the cost of the cheapest way known to each node, inf without one.

        The search's own array is altered and returned, so the search cannot be run on afterwards.
        """
        np.copyto(self._g, np.inf, where=self._state == UNREACHED)
        return self._g

    @property
    def low_f(self) -> float:
        """The least f in the queue, inf where it is empty."""
        near = self._queue.near
        if not near.size[0]:
            refill(self._queue, self._state)
        return float(near.f[: near.size[0]].min(initial=np.inf))

    def run(self, *, reopen: bool = True, end_s: float = np.inf, chunk: int = 0) -> int:
        """Search on and return FOUND (the goal was met), EXHAUSTED (no node is open) or PAUSED.

        Args:
          reopen: expand a closed node again where a cheaper way to it turns up; else nodes come in the order of f.
          end_s: time of `time.perf_counter` at which to pause; heeded within some 50 ms.
          chunk: expansions between two looks at it; left out, `CHUNK`.
        """
        if not reopen:
            self._queue.tally[IS_HEAP] = AS_HEAP  # of no entry but the start yet
        while True:
            arrays = self._g, self._state, self._queue
            ended, num_done = advance(
                self.graph, self.heuristic, self.goal, reopen, *arrays, chunk or CHUNK
            )
            self.num_expanded += num_done
            if ended in (FOUND, EXHAUSTED):
                return int(ended)
            if ended == FULL:
                self._queue = grown(self._queue)
            if time.perf_counter() >= end_s:
                return PAUSED
