"""Bounds on the cost to go: over tiles that cost what their cheapest cell does, and h_plus as the paper prints it.

Lattice points lie `TILE` cells apart, in cells' centres; the tile between four of them holds the cells on its rim too.
A function that nowhere in a tile falls by more from cell to cell than a step over the tile's cheapest cell costs is a
consistent bound, less what it is at the goal. Dijkstra's search along sides and diagonals of tiles gives the steepest
such values at the lattice points; in each tile four planes, one at each side, join them and meet in the middle.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import Heap, drop_top, push

TILE = 8  # cells along a side: 4 make for four times the lattice points, 16 for a looser bound, and both take longer
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


@compiled(nogil=True)
def tile_minima(cost, is_free):
    """Return ``[I + 2, J + 2]`` the cheapest free cell of every tile, inf without one and in the frame.

    Args:
      cost: ``[Y, X]`` float64, anything in cells that are not free.
      is_free: ``[Y, X]`` bool.
    """
    num_rows, num_cols = cost.shape
    num_i, num_j = (num_rows - 1) // TILE + 1, (num_cols - 1) // TILE + 1
    minima = np.full((num_i + 2, num_j + 2), np.inf)
    least = np.empty(num_j * TILE + 1)
    for i in range(num_i):
        least[:] = np.inf
        for row in range(i * TILE, min((i + 1) * TILE + 1, num_rows)):
            for col in range(num_cols):
                value = cost[row, col] if is_free[row, col] else np.inf
                least[col] = value if value < least[col] else least[col]
        for j in range(num_j):
            value = least[j * TILE]
            for k in range(1, TILE + 1):
                value = least[j * TILE + k] if least[j * TILE + k] < value else value
            minima[1 + i, 1 + j] = value
    return minima


@compiled(nogil=True)
def costs_at_corners(minima, straight, diagonal, start, goal):
    """Return what Dijkstra's search from the goal's tile over sides and diagonals of tiles gives at lattice points.

    Args:
      minima: ``[I + 2, J + 2]`` cheapest cell of every tile, inf without one and in the frame.
      straight, diagonal: a side, and a diagonal, of a tile of cheapest cell c costs ``straight[0] + straight[1] * c``.
      start, goal: tiles.

    Returns:
      ``[I + 1, J + 1]`` float64 the costs to the goal's tile, at most the search's limit, and whether a way joins
      start and goal; without one the costs are 0.
    """
    num_i, num_j = minima.shape[0] - 2, minima.shape[1] - 2
    corners = np.full((num_i + 1, num_j + 1), np.inf)
    # Each point is opened anew at most once by each of its neighbours; memory that is not written to is not taken.
    most = 8 * corners.size + 4
    heap = Heap(np.empty(most), np.empty(most, np.int32), np.zeros(1, np.int64))
    for i in range(goal[0], goal[0] + 2):
        for j in range(goal[1], goal[1] + 2):
            corners[i, j] = 0.0
            push(heap, 0.0, i * (num_j + 1) + j)
    num_left = 4  # corners of the start's tile that the search has not come to
    limit = np.inf  # where it ends: `BEYOND` times the cost at the last of these
    cost, width = corners.reshape(-1), num_j + 1
    while heap.size[0] > 0 and heap.f[0] <= limit:
        value, node = heap.f[0], heap.item[0]
        drop_top(heap)
        if value > cost[node]:
            continue
        i, j = node // width, node % width
        if 0 <= i - start[0] <= 1 and 0 <= j - start[1] <= 1:
            num_left -= 1
            if num_left == 0:
                limit = BEYOND * value
        sw, se, nw, ne = minima[i, j], minima[i, j + 1], minima[i + 1, j], minima[i + 1, j + 1]
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
            side, across = _steps(straight, diagonal, minimum)
            to_cost = value + (across if is_diagonal else side)
            if to_cost < cost[to]:
                cost[to] = to_cost
                push(heap, to_cost, to)
    is_joined = num_left == 0
    for k in range(cost.size):
        cost[k] = min(cost[k], limit) if is_joined else 0.0
    return corners, is_joined


@compiled(nogil=True)
def tile_bound(minima, straight, diagonal, start, goal):
    """Return the bound on the cost to the goal, for a search from start to goal.

    Args:
      minima: of `tile_minima`.
      straight: the least that a straight step over cells of cost c takes is ``straight[0] + straight[1] * c``.
      diagonal: the same of a diagonal one: no less than a straight one, and no more than two.
      start, goal: cells.
    """
    straight, diagonal = (
        (TILE * straight[0], TILE * straight[1]),
        (TILE * diagonal[0], TILE * diagonal[1]),
    )
    first, last = (start[0] // TILE, start[1] // TILE), (goal[0] // TILE, goal[1] // TILE)
    corners, is_joined = costs_at_corners(minima, straight, diagonal, first, last)
    centres = np.empty((corners.shape[0] - 1, corners.shape[1] - 1))
    for i in range(centres.shape[0]):
        for j in range(centres.shape[1]):
            side, across = _steps(straight, diagonal, minima[i + 1, j + 1])
            sw, se, nw, ne = (
                corners[i, j],
                corners[i, j + 1],
                corners[i + 1, j],
                corners[i + 1, j + 1],
            )
            # The highest middle to which no plane is too steep; it need not lie above all corners.
            value = max(max(sw, se), max(nw, ne))
            for one, other in ((sw, se), (nw, ne), (sw, nw), (se, ne)):
                highest = 0.5 * (one + other + min(side, across - abs(one - other)))
                value = highest if highest < value else value
            centres[i, j] = value
    at_goal = tile_estimate(TileBound(corners, centres, 0.0), goal[0], goal[1])
    return TileBound(corners, centres, at_goal if is_joined else -np.inf)


@compiled(forceinline=True)
def _steps(straight, diagonal, minimum):
    """Return what going along a side, and along a diagonal, of a tile costs at least."""
    return straight[0] + straight[1] * minimum, diagonal[0] + diagonal[1] * minimum


@compiled(forceinline=True)
def tile_estimate(bound, row, col):
    """Return the bound at a cell."""
    i, j = row // TILE, col // TILE
    y, x = (row - i * TILE) * (1 / TILE) - 0.5, (col - j * TILE) * (1 / TILE) - 0.5
    sw, se, nw, ne = (
        bound.corners[i, j],
        bound.corners[i, j + 1],
        bound.corners[i + 1, j],
        bound.corners[i + 1, j + 1],
    )
    is_beside = abs(x) >= abs(y)  # the plane of the west or the east side
    out, along = (x, y) if is_beside else (y, x)
    first = (se if is_beside else nw) if out > 0 else sw
    last = ne if out > 0 else (nw if is_beside else se)
    share = 2 * abs(out)
    return (
        (1 - share) * bound.centres[i, j]
        + share * 0.5 * (first + last)
        + along * (last - first)
        - bound.at_goal
    )


def printed_plus_field(layers: np.ndarray, goal: tuple[int, ...], first_index: int) -> np.ndarray:
    """Return ``[Y, X]`` the map part of h_plus as the paper prints it, for every node: **not** admissible.

    For each layer the larger of the sum of column minima and the sum of row minima within the box
    between node and goal; then the sum over layers (Ochoa & Atkins, eq. h_plus and s_k). Columns are
    numbered from the box's west side and rows from its south side, wherever the goal lies. The paper's
    sum runs over i = 1..dx while its index map starts at 0, which leaves two readings:

    - ``first_index=1``: indices 1..dx, the line at the low side is left out;
    - ``first_index=0``: the dx lines from the low side on, the one at the high side is left out.

    All nodes together cost O(L Y X): minima run away from the goal's row (column), sums away from its
    column (row). Obstacle cells take part with whatever cost they carry, as printed; NaN counts as inf.

    Args:
      layers: ``[L, Y, X]`` float64 weighted cost layers.
      goal: row and column.
      first_index: 1 or 0.
    """
    field = np.zeros(layers.shape[1:])
    for layer in layers:
        _add_printed_layer(np.ascontiguousarray(layer), goal[0], goal[1], first_index, field)
    return field


@compiled()
def _add_printed_layer(layer, goal_row, goal_col, first_index, field):
    """Add one layer's larger sum to the field, going away from the goal's row, north and then south."""
    num_rows, num_cols = layer.shape
    box_min = np.empty(num_cols)  # minimum over the box's rows, by column
    row_sum = np.empty(
        num_cols
    )  # sum over the box's rows of their minimum between the goal's column and each column
    for step in (1, -1):
        # The box's low side is the goal's when the node lies north (east), else the node's own.
        skips_goal_row = (step == 1) == (first_index == 1)
        box_min[:] = np.inf
        row_sum[:] = 0.0
        row = goal_row
        while 0 <= row < num_rows:
            for side in (1, -1):
                skips_goal_col = (side == 1) == (first_index == 1)
                line_min = np.inf
                col_sum = 0.0
                col = goal_col
                while 0 <= col < num_cols:
                    value = layer[row, col]
                    if value < box_min[col]:
                        box_min[col] = value
                    if value < line_min:
                        line_min = value
                    # What is skipped is the goal's line; else the node's own line is left for the nodes beyond.
                    row_total = row_sum[col]
                    if skips_goal_row and row != goal_row:
                        row_total += line_min
                    col_total = col_sum
                    if skips_goal_col and col != goal_col:
                        col_total += box_min[col]
                    if (side == 1 or col != goal_col) and (step == 1 or row != goal_row):
                        field[row, col] += max(row_total, col_total)
                    if side == 1 or col != goal_col:
                        row_sum[col] = row_total if skips_goal_row else row_total + line_min
                    col_sum = col_total if skips_goal_col else col_total + box_min[col]
                    col += side
            row += step
