"""The steps of a grid planner and where each of them is allowed."""

import operator
from collections.abc import Callable

import numpy as np

# (row, column) of the eight steps; bit k of a cell's moves stands for step k.
STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


def steps_back(start: tuple[int, ...], goal: tuple[int, ...], step_to: Callable[..., tuple[int, ...]]) -> np.ndarray:
    """Return ``[N, D]`` the cells (or nodes) from start to goal, given the step by which each one was reached."""
    cells = [goal]
    while cells[-1] != start:
        cells.append(tuple(map(operator.sub, cells[-1], step_to(*cells[-1]))))
    return np.array(cells[::-1])


def allowed_moves(is_free: np.ndarray, connectivity: int, needs_both_free: bool) -> np.ndarray:
    """Return ``[Y, X]`` uint8 whose bit k is set where step k of `STEPS` leads from a free cell to a free cell.

    Args:
      is_free: ``[Y, X]`` bool; all outside is taken as not free.
      connectivity: 4 (the first four steps) or 8.
      needs_both_free: a diagonal step also needs both orthogonal neighbours free.
    """
    num_rows, num_cols = is_free.shape
    framed = np.pad(is_free, 1)

    def shifted(rows: int, cols: int) -> np.ndarray:
        return framed[1 + rows : 1 + rows + num_rows, 1 + cols : 1 + cols + num_cols]

    moves = np.zeros(is_free.shape, np.uint8)
    for k, (rows, cols) in enumerate(STEPS[:connectivity]):
        is_allowed = is_free & shifted(rows, cols)
        if rows and cols and needs_both_free:
            is_allowed &= shifted(rows, 0)
            is_allowed &= shifted(0, cols)
        moves |= is_allowed.view(np.uint8) << np.uint8(k)
    return moves
