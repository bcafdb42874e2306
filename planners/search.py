"""The compiled A* search: a 4-ary heap, run in bounded chunks that the caller resumes.

All that is compiled together stays in this file: Numba's cache looks only at the file of the outer function.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

FOUND, EXHAUSTED, PAUSED, HEAP_FULL = 0, 1, 2, 3  # how a chunk of search ended
PARENT_STEP = 0x0F  # bits of a node's state: the step by which it was reached ...
NO_PARENT = 0x08  # ... or this, at the start
CLOSED = 0x10
MAX_STEPS = 8
ROUNDING = 1 - 1e-12  # a closed node is not worth expanding again for a gain that rounding explains


class Graph(NamedTuple):
    """A grid as the search sees it; nodes are flat cell numbers. ``M`` nodes, ``K`` steps.

    Step k from P to Q costs ``step_cost[k] + from_share[k] * cost[P] + to_share[k] * cost[Q]``.

    Attributes:
      cost: ``[M]`` float64 map cost.
      moves: ``[M]`` uint8, bit k: step k is allowed.
      num_cols: cells in a row.
      steps: ``[K, 2]`` int64 rows and columns of each step.
      step_cost, from_share, to_share: ``[K]`` float64.
    """

    cost: np.ndarray
    moves: np.ndarray
    num_cols: int
    steps: np.ndarray
    step_cost: np.ndarray
    from_share: np.ndarray
    to_share: np.ndarray


@njit(cache=True)
def _push(heap_f, heap_node, size, f, node):
    """Put a node into a heap of ``size`` entries."""
    i = size
    while i > 0:
        up = (i - 1) >> 2
        if heap_f[up] <= f:
            break
        heap_f[i] = heap_f[up]
        heap_node[i] = heap_node[up]
        i = up
    heap_f[i] = f
    heap_node[i] = node


@njit(cache=True)
def _drop_top(heap_f, heap_node, size):
    """Remove the lowest entry of a heap of ``size`` entries; ``size - 1`` remain."""
    last = size - 1
    f, node = heap_f[last], heap_node[last]
    i = 0
    while True:
        first = 4 * i + 1
        if first >= last:
            break
        low = first
        for j in range(first + 1, min(first + 4, last)):
            if heap_f[j] < heap_f[low]:
                low = j
        if heap_f[low] >= f:
            break
        heap_f[i] = heap_f[low]
        heap_node[i] = heap_node[low]
        i = low
    heap_f[i] = f
    heap_node[i] = node


@njit(cache=True)
def estimate(heuristic, row, col, goal_row, goal_col):
    """Return ``h`` at a cell (fields: see `heuristics.Heuristic`)."""
    dr, dc = abs(row - goal_row), abs(col - goal_col)
    value = heuristic.straight * max(dr, dc) + heuristic.diagonal * min(dr, dc)
    if heuristic.euclidean > 0.0:
        value += heuristic.euclidean * np.sqrt(float(dr * dr + dc * dc))
    if heuristic.field.size:
        return value + heuristic.field[row, col]
    return value + max(heuristic.rows[row], heuristic.cols[col])


@njit(cache=True)
def advance(graph, heuristic, goal, may_reopen, g, state, heap_f, heap_node, size, max_expanded):
    """Expand nodes in order of f until the goal is met, none is open, or ``max_expanded`` are done.

    The heap holds outdated entries, which are skipped: a node's newest entry is its lowest. Equal f
    come in an order that only the problem decides, so runs repeat.

    Returns: how the chunk ended, the entries left in the heap, and the nodes expanded.
    """
    goal_row, goal_col = goal // graph.num_cols, goal % graph.num_cols
    num_expanded = 0
    while size > 0:
        if num_expanded >= max_expanded:
            return PAUSED, size, num_expanded
        if size + MAX_STEPS > heap_f.size:
            return HEAP_FULL, size, num_expanded
        node = heap_node[0]
        _drop_top(heap_f, heap_node, size)
        size -= 1
        if state[node] & CLOSED:
            continue
        state[node] |= CLOSED
        if node == goal:
            return FOUND, size, num_expanded
        num_expanded += 1
        row, col = node // graph.num_cols, node % graph.num_cols
        moves = graph.moves[node]
        for k in range(MAX_STEPS):
            if not (moves >> k) & 1:
                continue
            to_row, to_col = row + graph.steps[k, 0], col + graph.steps[k, 1]
            to = to_row * graph.num_cols + to_col
            is_closed = state[to] & CLOSED
            if is_closed and not may_reopen:
                continue
            to_g = g[node] + (
                graph.step_cost[k] + graph.from_share[k] * graph.cost[node] + graph.to_share[k] * graph.cost[to]
            )
            if to_g < (g[to] * ROUNDING if is_closed else g[to]):
                g[to] = to_g
                state[to] = k
                _push(heap_f, heap_node, size, to_g + estimate(heuristic, to_row, to_col, goal_row, goal_col), to)
                size += 1
    return EXHAUSTED, size, num_expanded
