"""The compiled A* search through a stack of levels, run in bounded chunks that the caller resumes."""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, FULL, PAUSED, drop_top, push

STAY = 8  # the horizontal step after the eight of `moves.STEPS`: none
NUM_STEPS = 27  # a step's number: 9 * (levels up + 1) + horizontal step
NO_PARENT = 9 + STAY  # no step at all: the start's
PARENT_STEP = 0x1F  # bits of a node's state: the step by which it was reached
CLOSED = 0x20


class VolumeGraph(NamedTuple):
    """A stack of grids as the search sees it; nodes are flat numbers of ``[K, Y, X]``. ``M`` of them.

    Step ``j`` with ``up`` levels (-1, 0, 1) from P on level k to Q costs, all tables at ``[k, up + 1, j]``:
    ``step_cost + from_share * cost[P] + to_share * cost[Q]``.

    Attributes:
      cost: ``[M]`` float64 map cost, inf where a node is not free.
      moves: ``[M]`` uint8, bit j: horizontal step j is allowed on its level; with a change of level it
        must be allowed on both.
      shape: K, Y, X.
      steps: ``[9, 2]`` int64 rows and columns of each horizontal step, the last one none.
      step_cost, from_share, to_share: ``[K, 3, 9]`` float64.
    """

    cost: np.ndarray
    moves: np.ndarray
    shape: tuple[int, int, int]
    steps: np.ndarray
    step_cost: np.ndarray
    from_share: np.ndarray
    to_share: np.ndarray


class VolumeBound(NamedTuple):
    """A bound ``h(n)``, evaluated node by node.

    With ``dr, dc`` rows and columns to the goal: ``rise[k]`` plus ``straight * max(dr, dc) + diagonal * min(dr, dc)``
    or, where ``plan`` has any cells, the larger of that and ``plan[r, c]``.

    Attributes:
      straight, diagonal: cost per cell side.
      plan: ``[Y, X]`` float64 cost to the goal as seen from above, or ``[0, 0]``.
      rise: ``[K]`` float64 cost of changing to the goal's level.
    """

    straight: float
    diagonal: float
    plan: np.ndarray
    rise: np.ndarray


@compiled(nogil=True)
def estimate_in_volume(bound, level, row, col, goal_row, goal_col):
    """Return ``h`` at a node."""
    dr, dc = abs(row - goal_row), abs(col - goal_col)
    value = bound.straight * max(dr, dc) + bound.diagonal * min(dr, dc)
    if bound.plan.size:
        value = max(value, bound.plan[row, col])
    return value + bound.rise[level]


@compiled(nogil=True)
def advance_in_volume(graph, bound, goal, g, state, heap, max_expanded):
    """Expand nodes in order of f until the goal is met, no cell is open, or ``max_expanded`` are done.

    No node is expanded twice, which is exact with a consistent bound. The heap holds outdated entries,
    which are skipped: a node's newest entry is its lowest.

    Args:
      graph, bound: what is searched, and how it is guided.
      goal: flat number of the goal; negative to visit all that can be reached.
      g: ``[M]`` float64 cost from the start, filled as the search goes.
      state: ``[M]`` uint8.
      heap: the open nodes.
      max_expanded: end of this chunk.

    Returns: how the chunk ended, and the nodes expanded.
    """
    num_levels, num_rows, num_cols = graph.shape
    plane = num_rows * num_cols
    goal_row, goal_col = goal % plane // num_cols, goal % num_cols
    num_expanded = 0
    while heap.size[0] > 0:
        if num_expanded >= max_expanded:
            return PAUSED, num_expanded
        if heap.size[0] + NUM_STEPS > heap.f.size:
            return FULL, num_expanded
        node = heap.item[0]
        drop_top(heap)
        if state[node] & CLOSED:
            continue
        state[node] |= CLOSED
        if node == goal:
            return FOUND, num_expanded
        num_expanded += 1
        level, row, col = node // plane, node % plane // num_cols, node % num_cols
        for up in range(-1, 2):
            to_level = level + up
            if not 0 <= to_level < num_levels:
                continue
            above = node + up * plane  # the node over, at, or under this one
            moves = graph.moves[node] & graph.moves[above]
            for j in range(STAY + 1):
                if j < STAY:
                    if not (moves >> j) & 1:
                        continue
                elif up == 0 or graph.cost[above] == np.inf:
                    continue
                to_row, to_col = row + graph.steps[j, 0], col + graph.steps[j, 1]
                to = (to_level * num_rows + to_row) * num_cols + to_col
                if state[to] & CLOSED:
                    continue
                to_g = g[node] + (
                    graph.step_cost[level, up + 1, j]
                    + graph.from_share[level, up + 1, j] * graph.cost[node]
                    + graph.to_share[level, up + 1, j] * graph.cost[to]
                )
                if to_g < g[to]:
                    g[to] = to_g
                    state[to] = 9 * (up + 1) + j
                    f = to_g + estimate_in_volume(bound, to_level, to_row, to_col, goal_row, goal_col)
                    push(heap, f, to)
    return EXHAUSTED, num_expanded
