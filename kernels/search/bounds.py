"""Bounds on the cost to go: over tiles that cost what their cheapest cell does, and h_plus as the paper prints it.

Lattice points lie `TILE` cells apart, in cells' centres; the tile between four of them holds the cells on its rim too.
A function that nowhere in a tile falls by more from cell to cell than a step over the tile's cheapest cell costs is a
consistent bound, less what it is at the goal. Dijkstra's search along sides and diagonals of tiles gives the steepest
such values at the lattice points; in each tile four planes, one at each side, join them and meet in the middle.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import Heap, drop_top, place

TILE = 8  # cells along a side: 4 make for four times the lattice points, 16 for a looser bound, and both take longer
BEYOND = 1.25  # times the start's cost: lattice points that lie farther from the goal are taken to lie there


class LandmarkBound(NamedTuple):
    """Costs to a few cells, which bound the cost to the goal (see `astar.make_landmarks`). ``K`` landmarks.

    The bound is the greatest ``|costs[r, c, k] - at_goal[k]|``, plus ``goal_term - cost_share * cost[r, c]``.

    Attributes:
      costs: ``[Y, X, K]`` float64, inf where there is no way.
      at_goal: ``[K]`` the same at the goal.
      cost: ``[Y, X]`` the problem's map cost.
      cost_share, goal_term: what turns symmetric costs into those of the problem's steps.
    """

    costs: np.ndarray
    at_goal: np.ndarray
    cost: np.ndarray
    cost_share: float
    goal_term: float


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


def tile_minima(cost: np.ndarray, is_free: np.ndarray) -> np.ndarray:
    """Return ``[I + 2, J + 2]`` the cheapest free cell of every tile, inf without one and in the frame.

    Args:
      cost: ``[Y, X]`` float64, anything in cells that are not free.
      is_free: ``[Y, X]`` bool.
    """
    num_i, num_j = ((size - 1) // TILE + 1 for size in cost.shape)
    minima = np.full((num_i + 2, num_j + 2), np.inf)
    _lower_minima(cost, is_free, minima, np.empty(num_j * TILE + 1))
    return minima


@compiled()
def _lower_minima(cost, is_free, minima, least):
    """Set the minima of tiles; ``least`` is memory for a row of cells, and one more."""
    num_rows, num_cols = cost.shape
    num_i, num_j = minima.shape[0] - 2, minima.shape[1] - 2
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


def costs_at_corners(
    minima: np.ndarray,
    straight: tuple[float, float],
    diagonal: tuple[float, float],
    start: tuple[int, ...],
    goal: tuple[int, ...],
) -> tuple[np.ndarray, bool]:
    """Return what Dijkstra's search from the goal's tile over sides and diagonals of tiles gives at lattice points.

    Args:
      minima: ``[I + 2, J + 2]`` cheapest cell of every tile, inf without one and in the frame.
      straight, diagonal: a side, and a diagonal, of a tile of cheapest cell c costs ``straight[0] + straight[1] * c``.
      start, goal: tiles.

    Returns:
      ``[I + 1, J + 1]`` float64 the costs to the goal's tile, at most the search's limit, and whether a way joins
      start and goal; without one the costs are 0.
    """
    width = minima.shape[1] - 1
    corners = np.full((minima.shape[0] - 1, width), np.inf)
    cost = corners.reshape(-1)
    first = goal[0] * width + goal[1]
    # Each point is opened again at most once by each of its neighbours; memory that is not written to is not taken.
    most = 8 * cost.size + 4
    heap = Heap(np.empty(most), np.empty(most, np.int32), np.array([4]))
    heap.item[:4] = first, first + 1, first + width, first + width + 1
    heap.f[:4] = cost[heap.item[:4]] = 0.0
    limit = _search_corners(minima, straight, diagonal, start, cost, heap)
    is_joined = limit < np.inf
    return np.minimum(corners, limit if is_joined else 0.0, out=corners), is_joined


@compiled()
def _search_corners(minima, straight, diagonal, start, cost, heap):
    """Lower the costs at lattice points, row by row, to those found, and return the limit, inf where no way joins."""
    width = minima.shape[1] - 1
    num_left = 4  # corners of the start's tile that the search has not come to
    limit = np.inf  # where it ends: `BEYOND` times the cost at the last of these
    while heap.size[0] > 0 and heap.f[0] <= limit:
        value, node = heap.f[0], heap.item[0]
        drop_top(heap)
        if value > cost[node]:
            continue
        i = node // width
        j = node % width
        if 0 <= i - start[0] <= 1 and 0 <= j - start[1] <= 1:
            num_left -= 1
            if num_left == 0:
                limit = BEYOND * value
        sw = minima[i, j]
        se = minima[i, j + 1]
        nw = minima[i + 1, j]
        ne = minima[i + 1, j + 1]
        for to, minimum, step in (
            (node + width, min(nw, ne), straight),
            (node - width, min(sw, se), straight),
            (node + 1, min(se, ne), straight),
            (node - 1, min(sw, nw), straight),
            (node + width + 1, ne, diagonal),
            (node + width - 1, nw, diagonal),
            (node - width + 1, se, diagonal),
            (node - width - 1, sw, diagonal),
        ):
            if minimum == np.inf:
                continue
            to_cost = value + (step[0] + step[1] * minimum)
            if to_cost < cost[to]:
                cost[to] = to_cost
                heap.item[place(heap, to_cost)] = to
    return limit


def tile_bound(
    minima: np.ndarray,
    straight: tuple[float, float],
    diagonal: tuple[float, float],
    start: tuple[int, ...],
    goal: tuple[int, ...],
) -> TileBound:
    """Return the bound on the cost to the goal, for a search from start to goal.

    Args:
      minima: of `tile_minima`.
      straight: the least that a straight step over cells of cost c takes is ``straight[0] + straight[1] * c``.
      diagonal: the same of a diagonal one: no less than a straight one, and no more than two.
      start, goal: cells.
    """
    straight, diagonal = ((TILE * base, TILE * share) for base, share in (straight, diagonal))
    first = (start[0] // TILE, start[1] // TILE)
    last = (goal[0] // TILE, goal[1] // TILE)
    corners, is_joined = costs_at_corners(minima, straight, diagonal, first, last)
    side, across = (base + share * minima[1:-1, 1:-1] for base, share in (straight, diagonal))
    num_i, num_j = side.shape
    # The highest middle to which no plane is too steep; it need not lie above all corners.
    highest = np.maximum(corners[:-1], corners[1:])
    centres = np.maximum(highest[:, :-1], highest[:, 1:])
    for one, other in ((corners[:-1], corners[1:]), (corners[:, :-1], corners[:, 1:])):
        total = one + other
        apart = abs(one - other)
        # West and east sides of the tiles, then south and north ones.
        for sides in (np.s_[:num_i, :num_j], np.s_[-num_i:, -num_j:]):
            highest = 0.5 * (total[sides] + np.minimum(side, across - apart[sides]))
            np.minimum(centres, highest, out=centres)
    at_goal = tile_estimate(TileBound(corners, centres, 0.0), *goal)
    return TileBound(corners, centres, at_goal if is_joined else -np.inf)


@compiled(forceinline=True)
def tile_estimate(bound, row, col):
    """Return the bound at a cell."""
    i, j = row // TILE, col // TILE
    y = (row - i * TILE) * (1 / TILE) - 0.5
    x = (col - j * TILE) * (1 / TILE) - 0.5
    sw = bound.corners[i, j]
    se = bound.corners[i, j + 1]
    nw = bound.corners[i + 1, j]
    ne = bound.corners[i + 1, j + 1]
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
    # Sum over the box's rows of their minimum between the goal's column and each column.
    row_sum = np.empty(num_cols)
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
