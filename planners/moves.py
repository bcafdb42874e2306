"""The steps of a grid planner and where each of them is allowed."""

import numpy as np

from jaxurban.kernels.compiled import compiled

# (row, column) of the eight steps; bit k of a cell's moves stands for step k.
STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


def allowed_moves(is_free: np.ndarray, connectivity: int, needs_both_free: bool) -> np.ndarray:
    """Return ``[Y, X]`` uint8 whose bit k is set where step k of `STEPS` leads from a free cell to a free cell.

    Args:
      is_free: ``[Y, X]`` bool; all outside is taken as not free.
      connectivity: 4 (the first four steps) or 8.
      needs_both_free: a diagonal step also needs both orthogonal neighbours free.
    """
    moves = np.empty(is_free.shape, np.uint8)
    _find_moves(np.pad(is_free, 1).view(np.uint8), 0xFF if connectivity == 8 else 0x0F, needs_both_free, moves)
    return moves


@compiled(nogil=True)
def _find_moves(framed, steps, needs_both_free, moves):
    """Set moves, given cells ``[Y + 2, X + 2]`` of 1 (free) or 0, and the bits of the steps that there are."""
    for row in range(moves.shape[0]):
        # The rows around, as `STEPS` go: bits, not branches, so that the processor takes many cells at once.
        here, north, south = framed[row + 1], framed[row + 2], framed[row]
        for col in range(1, moves.shape[1] + 1):
            up, down, east, west = north[col], south[col], here[col + 1], here[col - 1]
            diagonals = north[col + 1] << 4 | north[col - 1] << 5 | south[col + 1] << 6 | south[col - 1] << 7
            if needs_both_free:
                diagonals &= (up & east) << 4 | (up & west) << 5 | (down & east) << 6 | (down & west) << 7
            moves[row, col - 1] = -here[col] & steps & (diagonals | up | down << 1 | east << 2 | west << 3)
