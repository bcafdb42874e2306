"""The cost to go over tiles that cost what their cheapest cell does: a bound for a search from cell to cell.

Lattice points lie `TILE` cells apart, in cells' centres; the tile between four of them holds the cells on its rim too.
A function that nowhere in a tile falls by more from cell to cell than a step over the tile's cheapest cell costs is a
consistent bound, less what it is at the goal. Dijkstra's search along sides and diagonals of tiles gives the steepest
such values at the lattice points; in each tile four planes, one at each side, join them and meet in the middle.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import Heap, drop_top, push
from jaxurban.kernels.search.weighing import add_up

TILE = 8  # cells along a side: 4 make for four times the lattice points, 16 for a looser bound, and both take longer
PART = 64, 1024  # rows and columns of what is made of a map at once, whole tiles: long rows, which are read fast
BEYOND = 1.25  # times the start's cost: lattice points that lie farther from the goal are taken to lie there


class TileBound(NamedTuple):
    """The bound: planes through these values, less ``at_goal``. ``[I, J]`` tiles.

    Attributes:
      corners: ``[I + 1, J + 1]`` float64 at the lattice points.
      centres: ``[I, J]`` float64 in the middle of each tile.
      at_goal: at the goal; -inf where no way joins start and goal, which makes the bound inf.
    """

    corners: np.ndarray
    centres: np.ndarray
    at_goal: float


class StepCost(NamedTuple):
    """The least that a step over cells of cost c takes: ``straight[0] + straight[1] * c``, or ``diagonal`` so.

    A diagonal one takes no less than a straight one, and no more than two.
    """

    straight: tuple[float, float]
    diagonal: tuple[float, float]


@compiled(nogil=True)
def weigh_part(costs, weights, is_free, part_row, part_col, cost, minima):
    """Set what the cells in and around one part of a map cost, and what its tiles do.

    Args:
      costs, weights: layers ``[L, Y, X]`` and their weights ``[L]`` float64.
      is_free: ``[Y, X]`` bool.
      part_row, part_col: of the part, `PART` cells.
      cost: ``[Y, X]`` to be set.
      minima: ``[I + 2, J + 2]`` to be set: the cheapest free cell of every tile, inf without one, in a frame.
    """
    num_rows, num_cols = is_free.shape
    first_i, first_j = part_row * PART[0] // TILE, part_col * PART[1] // TILE
    num_i = min(PART[0] // TILE, minima.shape[0] - 2 - first_i)
    num_j = min(PART[1] // TILE, minima.shape[1] - 2 - first_j)
    # The cells that tiles hold, and one more on the low sides.
    first_col = first_j * TILE
    west, east = max(first_col - 1, 0), min(first_col + num_j * TILE + 1, num_cols)
    sums, least = np.empty(east - west), np.empty(num_j * TILE + 1)
    here = sums[first_col - west :]
    if first_i > 0:
        add_up(costs, weights, first_i * TILE - 1, west, sums)
        cost[first_i * TILE - 1, west:east] = sums
    for i in range(first_i, first_i + num_i):
        least[:] = np.inf
        for row in range(i * TILE, min((i + 1) * TILE + 1, num_rows)):
            if row > i * TILE or i == first_i:  # else it was the last tiles' last one
                add_up(costs, weights, row, west, sums)
                cost[row, west:east] = sums
            is_free_here = is_free[row, first_col:east]
            for k in range(here.size):
                value = here[k] if is_free_here[k] else np.inf
                least[k] = value if value < least[k] else least[k]
        for j in range(num_j):
            value = least[j * TILE]
            for k in range(1, TILE + 1):
                value = least[j * TILE + k] if least[j * TILE + k] < value else value
            minima[1 + i, 1 + first_j + j] = value


class CornerSearch(NamedTuple):
    """Dijkstra's search from the goal's tile over lattice points, in progress. ``[I + 1, J + 1]`` of them.

    Attributes:
      corners: ``[I + 1, J + 1]`` float64 least cost found to the goal's tile, inf without one.
      heap: the open ones, by flat number, int32.
      start, goal: row and column of their tiles.
      tally: ``[1]`` int64 corners of the start's tile that the search has not come to.
      limit: ``[1]`` float64 where it ends: `BEYOND` times the cost at the last of these.
    """

    corners: np.ndarray
    heap: Heap
    start: tuple[int, int]
    goal: tuple[int, int]
    tally: np.ndarray
    limit: np.ndarray


@compiled(nogil=True)
def begin_at_corners(num_i, num_j, start, goal):
    """Return the search over so many tiles, begun for a search from start to goal (cells)."""
    corners = np.full((num_i + 1, num_j + 1), np.inf)
    # Each point is opened anew at most once by each of its neighbours; memory that is not written to is not taken.
    most = 8 * corners.size + 4
    heap = Heap(np.empty(most), np.empty(most, np.int32), np.zeros(1, np.int64))
    start, goal = (start[0] // TILE, start[1] // TILE), (goal[0] // TILE, goal[1] // TILE)
    for i in range(goal[0], goal[0] + 2):
        for j in range(goal[1], goal[1] + 2):
            corners[i, j] = 0.0
            push(heap, 0.0, i * (num_j + 1) + j)
    return CornerSearch(corners, heap, start, goal, np.full(1, 4), np.full(1, np.inf))


@compiled(nogil=True)
def advance_at_corners(search, minima, step_cost):
    """Search on until the end, and return -1, -1; or a part (row, column) whose tiles must be made before going on.

    Args:
      search: `CornerSearch`, altered.
      minima: of `weigh_part`, NaN where it was not there yet.
      step_cost: `StepCost`.
    """
    heap, cost, width = search.heap, search.corners.reshape(-1), search.corners.shape[1]
    while heap.size[0] > 0 and heap.f[0] <= search.limit[0]:
        value, node = heap.f[0], heap.item[0]
        i, j = node // width, node % width
        sw, se, nw, ne = minima[i, j], minima[i, j + 1], minima[i + 1, j], minima[i + 1, j + 1]
        if np.isnan(sw + se + nw + ne):
            for to_i in range(i, i + 2):
                for to_j in range(j, j + 2):
                    if np.isnan(minima[to_i, to_j]):
                        return (to_i - 1) * TILE // PART[0], (to_j - 1) * TILE // PART[1]
        drop_top(heap)
        if value > cost[node]:
            continue
        if 0 <= i - search.start[0] <= 1 and 0 <= j - search.start[1] <= 1:
            search.tally[0] -= 1
            if search.tally[0] == 0:
                search.limit[0] = BEYOND * value
        for to, minimum, is_diagonal in (
            (node + width, min(nw, ne), False),
            (node - width, min(sw, se), False),
            (node + 1, min(se, ne), False),
            (node - 1, min(sw, nw), False),
            (node + width + 1, ne, True),
            (node + width - 1, nw, True),
            (node - width + 1, se, True),
            (node - width - 1, sw, True),
        ):
            if minimum == np.inf:
                continue
            side, across = _steps(step_cost, minimum)
            to_cost = value + (across if is_diagonal else side)
            if to_cost < cost[to]:
                cost[to] = to_cost
                push(heap, to_cost, to)
    return -1, -1


@compiled(nogil=True)
def tile_bound(search, minima, step_cost, goal):
    """Return the bound that a search at the corners, which has ended, gives.

    Args:
      search: `CornerSearch`; its corners are altered.
      minima: of `weigh_part`; NaN where the search has not come to.
      step_cost: `StepCost`.
      goal: cell.
    """
    is_joined = search.tally[0] == 0
    cost = search.corners.reshape(-1)
    for k in range(cost.size):
        cost[k] = min(cost[k], search.limit[0]) if is_joined else 0.0
    corners = search.corners
    centres = np.empty((corners.shape[0] - 1, corners.shape[1] - 1))
    for i in range(centres.shape[0]):
        for j in range(centres.shape[1]):
            side, across = _steps(step_cost, minima[i + 1, j + 1])
            sw, se, nw, ne = corners[i, j], corners[i, j + 1], corners[i + 1, j], corners[i + 1, j + 1]
            # The highest middle to which no plane is too steep; it need not lie above all corners.
            value = max(max(sw, se), max(nw, ne))
            for one, other in ((sw, se), (nw, ne), (sw, nw), (se, ne)):
                highest = 0.5 * (one + other + min(side, across - abs(one - other)))
                value = highest if highest < value else value  # NaN of a tile that is not known: all its corners agree
            centres[i, j] = value
    at_goal = tile_estimate(TileBound(corners, centres, 0.0), goal[0], goal[1])
    return TileBound(corners, centres, at_goal if is_joined else -np.inf)


@compiled(forceinline=True)
def _steps(step_cost, minimum):
    """Return what going along a side, and along a diagonal, of a tile costs at least."""
    straight, diagonal = step_cost.straight, step_cost.diagonal
    return TILE * (straight[0] + straight[1] * minimum), TILE * (diagonal[0] + diagonal[1] * minimum)


@compiled(forceinline=True)
def tile_estimate(bound, row, col):
    """Return the bound at a cell."""
    i, j = row // TILE, col // TILE
    y, x = (row - i * TILE) * (1 / TILE) - 0.5, (col - j * TILE) * (1 / TILE) - 0.5
    sw, se, nw, ne = bound.corners[i, j], bound.corners[i, j + 1], bound.corners[i + 1, j], bound.corners[i + 1, j + 1]
    is_beside = abs(x) >= abs(y)  # the plane of the west or the east side
    out, along = (x, y) if is_beside else (y, x)
    first = (se if is_beside else nw) if out > 0 else sw
    last = ne if out > 0 else (nw if is_beside else se)
    share = 2 * abs(out)
    return (1 - share) * bound.centres[i, j] + share * 0.5 * (first + last) + along * (last - first) - bound.at_goal
