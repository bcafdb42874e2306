"""Parts of the planners' bounds: cheapest cells of rows and columns, sums along a row, and the printed h_plus."""

import numpy as np

from jaxurban.kernels.compiled import compiled


def line_minima(cost: np.ndarray, is_free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cheapest free cell of every row ``[Y]`` and of every column ``[X]``, inf without one.

    Args:
      cost: ``[Y, X]`` float64.
      is_free: ``[Y, X]`` bool.
    """
    free_cost = np.where(is_free, cost, np.inf)
    return free_cost.min(axis=1), free_cost.min(axis=0)


def sums_to(goal: int, up: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the cost of going from each of N places in a row to the goal's, step by step.

    Args:
      goal: the goal's place.
      up, down: ``[N - 1]`` cost of the step from place i to i + 1, and back.
    """
    return np.concatenate([np.cumsum(up[:goal][::-1])[::-1], [0.0], np.cumsum(down[goal:])])


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
        _add_printed_layer(layer, goal[0], goal[1], first_index, field)
    return field


@compiled()
def _add_printed_layer(layer, goal_row, goal_col, first_index, field):
    """Add one layer's larger sum to the field, going away from the goal's row, north and then south."""
    num_rows, num_cols = layer.shape
    box_min = np.empty(num_cols)  # minimum over the box's rows, by column
    row_sum = np.empty(num_cols)  # sum over the box's rows of their minimum between the goal's column and each column
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
