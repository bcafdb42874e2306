"""Bounds on the cost to go: over tiles that cost what their cheapest cell does, and h_plus as the paper prints it.

Lattice points lie `TILE` cells apart, in cells' centres; the tile between four of them holds the cells on its rim too.
A function that nowhere in a tile falls by more from cell to cell than a step over the tile's cheapest cell costs is a
consistent bound, less what it is at the goal. Dijkstra's search along sides and diagonals of tiles gives the steepest
such values at the lattice points; in each tile four planes, one at each side, join them and meet in the middle.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import AS_HEAP, Heap, drop_top, place

TILE = 8  # cells along a side: 4 make for four times the lattice points, 16 for a looser bound, and both take longer
ONE = np.uint64(1)
BEYOND = 1.25  # times the start's cost: lattice points that lie farther from the goal are taken to lie there


class LandmarkBound(NamedTuple):
    """Costs to a few cells, which bound the cost to the goal (see `astar.make_landmarks`). ``K`` landmarks.

    The bound is the greatest ``|costs[r, c, k] - at_goal[k]|``, plus ``goal_term - cost_share * cost[r, c]``.

    Attributes:
      costs: ``[Y, X, K]`` float32, which takes half the memory to read; inf where there is no way.
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
    # Tiles along each axis, the last of which may reach beyond the map.
    num_i, num_j = ((size - 1) // TILE + 1 for size in cost.shape)
    minima = np.full((num_i + 2, num_j + 2), np.inf)
    _lower_minima(cost, is_free, minima, np.empty(num_j * TILE + 1))
    return minima


@compiled()
def _lower_minima(cost, is_free, minima, least):
    """Set the cheapest free cell of every tile; a tile holds the cells on its rim, so neighbours share a row or column.

    Args:
      cost, is_free: ``[Y, X]`` as in `tile_minima`.
      minima: ``[I + 2, J + 2]`` filled in place but for its frame.
      least: ``[J * TILE + 1]`` working memory: the cheapest free cell of each column within a row of tiles.
    """
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
    """Return the costs from lattice points to the goal's tile, by Dijkstra's search over sides and diagonals of tiles.

    Args:
      minima: ``[I + 2, J + 2]`` cheapest cell of every tile, inf without one and in the frame.
      straight: a side of a tile whose cheapest cell costs c costs ``straight[0] + straight[1] * c``; of the two tiles
        that share the side the cheaper one counts.
      diagonal: the same of a tile's diagonal.
      start, goal: tiles, by row and column.

    Returns:
      ``[I + 1, J + 1]`` float64 the costs to the goal's tile, at most the search's limit, and whether a way joins
      start and goal; without one the costs are 0.
    """
    width = minima.shape[1] - 1
    corners = np.full((minima.shape[0] - 1, width), np.inf)
    cost = corners.reshape(-1)
    first = goal[0] * width + goal[1]  # southwest corner of the goal's tile

    # All four corners of the goal's tile are open at cost 0; with equal keys any order is a heap.
    # Each point is opened again at most once by each of its neighbours; memory that is not written to is not taken.
    most = 8 * cost.size + 4
    heap = Heap(np.empty(most), np.empty(most, np.int32), np.array([4]))  # of size 4
    heap.item[:4] = first, first + 1, first + width, first + width + 1
    heap.f[:4] = cost[heap.item[:4]] = 0.0
    limit = _search_corners(minima, straight, diagonal, start, cost, heap)
    is_joined = limit < np.inf
    return np.minimum(corners, limit if is_joined else 0.0, out=corners), is_joined


@compiled()
def _search_corners(minima, straight, diagonal, start, cost, heap):
    """Lower the costs at lattice points to those of Dijkstra's search, and return the cost at which the search ended.

    It ends at `BEYOND` times the highest cost at a corner of the start's tile, or where no point is open; then the
    limit is inf if a corner was not reached.

    Args:
      minima, straight, diagonal, start: as in `costs_at_corners`.
      cost: ``[N]`` costs at lattice points, row by row; altered.
      heap: the open points; altered.
    """
    width = minima.shape[1] - 1
    num_left = 4  # corners of the start's tile that the search has not come to
    limit = np.inf  # where it ends: `BEYOND` times the cost at the last of these
    while heap.size[0] > 0 and heap.f[0] <= limit:
        value, node = heap.f[0], heap.item[0]
        drop_top(heap)
        if value > cost[node]:  # outdated
            continue
        i = node // width
        j = node % width
        if 0 <= i - start[0] <= 1 and 0 <= j - start[1] <= 1:
            num_left -= 1
            if num_left == 0:
                limit = BEYOND * value

        # The four tiles around the point; a side costs as the cheaper tile beside it, a diagonal as its own tile.
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
                heap.item[place(heap, to_cost, AS_HEAP)] = to
    return limit


def tile_bound(
    minima: np.ndarray,
    straight: tuple[float, float],
    diagonal: tuple[float, float],
    start: tuple[int, ...],
    goal: tuple[int, ...],
) -> TileBound:
    """Return the bound on the cost to the goal, for a search from start to goal (see the top of this file).

    Args:
      minima: of `tile_minima`.
      straight: the least that a straight step over cells of cost c takes is ``straight[0] + straight[1] * c``.
      diagonal: the same of a diagonal one: no less than a straight one, and no more than two.
      start, goal: cells.
    """
    # Of a whole tile: TILE steps, then the costs at its corners.
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

    # Less the estimate at the goal itself, so that the bound is 0 there.
    at_goal = tile_estimate(TileBound(corners, centres, 0.0), *goal)
    return TileBound(corners, centres, at_goal if is_joined else -np.inf)


@compiled(forceinline=True)
def tile_estimate(bound, row, col):
    """Return the bound at a cell, on the plane through the centre of its tile and the tile's nearest side.

    Args:
      bound: `TileBound`.
      row, col: the cell.
    """
    # The tile, and the cell's place in it, from -1/2 to 1/2 from its middle.
    # Unsigned: else Numba asks each time whether an index counts from the end.
    i, j = np.uint32(row) // np.uint32(TILE), np.uint32(col) // np.uint32(TILE)
    north, east = np.uint64(i) + ONE, np.uint64(j) + ONE
    y = (row - np.int64(i) * TILE) * (1 / TILE) - 0.5
    x = (col - np.int64(j) * TILE) * (1 / TILE) - 0.5
    sw = bound.corners[i, j]
    se = bound.corners[i, east]
    nw = bound.corners[north, j]
    ne = bound.corners[north, east]

    # The side's two corners, in the order of `along`; `out` leads from the middle toward the side.
    is_beside = abs(x) >= abs(y)  # the plane of the west or the east side
    out, along = (x, y) if is_beside else (y, x)
    first = (se if is_beside else nw) if out > 0 else sw
    last = ne if out > 0 else (nw if is_beside else se)
    share = 2 * abs(out)  # 0 in the middle, 1 at the side
    return (
        (1 - share) * bound.centres[i, j]
        + share * 0.5 * (first + last)
        + along * (last - first)
        - bound.at_goal
    )


def printed_plus_field(layers: np.ndarray, goal: tuple[int, ...], first_index: int) -> np.ndarray:
    """Return ``[Y, X]`` the map part of h_plus as the paper prints it, for every node: **not** admissible.

    For each layer it is the larger of the sum of column minima and the sum of row minima within the box
    between node and goal; these are summed over layers (Ochoa & Atkins, eq. h_plus and s_k). Columns are
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
    """Add one layer's larger sum (see `printed_plus_field`) to the field, in place.

    Rows are visited from the goal's row away, first to the north and then to the south; in each, columns from the
    goal's column away, first to the east and then to the west. So the box between node and goal grows by a row or a
    column at a time, and its minima and sums are carried on. The goal's own row and column come in both passes, and
    count in the first one only.

    Args:
      layer: ``[Y, X]`` weighted costs.
      goal_row, goal_col: the goal.
      first_index: 1 or 0.
      field: ``[Y, X]`` altered.
    """
    num_rows, num_cols = layer.shape
    box_min = np.empty(num_cols)  # minimum over the box's rows, by column
    # Sum over the box's rows of their minimum between the goal's column and each column.
    row_sum = np.empty(num_cols)
    for row_step in (1, -1):
        # The line left out is the box's low or high side, by `first_index`. The low side is the goal's when the node
        # lies north (east) of it, else the node's own.
        skips_goal_row = (row_step == 1) == (first_index == 1)
        box_min[:] = np.inf
        row_sum[:] = 0.0
        row = goal_row
        while 0 <= row < num_rows:
            is_new_row = row_step == 1 or row != goal_row
            for col_step in (1, -1):
                skips_goal_col = (col_step == 1) == (first_index == 1)
                line_min = np.inf  # minimum of this row from the goal's column on
                col_sum = 0.0  # sum of the minima over the box's columns so far
                col = goal_col
                while 0 <= col < num_cols:
                    is_new_col = col_step == 1 or col != goal_col
                    value = layer[row, col]
                    if value < box_min[col]:
                        box_min[col] = value
                    if value < line_min:
                        line_min = value

                    # The sums for this node. Where the goal's line is left out, its own line counts; else its own line
                    # is left out, and counts only for the nodes beyond.
                    row_total = row_sum[col]
                    if skips_goal_row and row != goal_row:
                        row_total += line_min
                    col_total = col_sum
                    if skips_goal_col and col != goal_col:
                        col_total += box_min[col]
                    if is_new_col and is_new_row:
                        field[row, col] += max(row_total, col_total)

                    # Carry the sums on: by column to the next row, and to the next column.
                    if is_new_col:
                        row_sum[col] = row_total if skips_goal_row else row_total + line_min
                    col_sum = col_total if skips_goal_col else col_total + box_min[col]
                    col += col_step
            row += row_step
