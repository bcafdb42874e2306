"""What cells cost under weights: layers times their weights, added up in their order, row by row.

The layers lie apart, so that one pass reads each of them once. Sums are float64; the same weights give the same bits
whoever sums them.
"""

import math

import numpy as np

from jaxurban.kernels.compiled import compiled


@compiled(forceinline=True)
def add_up(costs, weights, row, sums):
    """Set ``sums`` ``[X]`` to the weighted sums of the cells of a row.

    Layers ``costs`` ``[L, Y, X]`` of weight 0 (``weights`` ``[L]`` float64) are not read.
    """
    sums[:] = 0.0
    for layer in range(weights.size):
        weight = weights[layer]
        if weight != 0.0:
            line = costs[layer, row]
            for k in range(sums.size):
                sums[k] += weight * line[k]


def in_rows(layers: np.ndarray) -> np.ndarray:
    """Return layers ``[L, *cells]`` as ``[L, Y, X]``, the last axis in ``X``: read-only, as compiled loops expect."""
    rows = np.ascontiguousarray(layers).reshape(len(layers), math.prod(layers.shape[1:-1]), layers.shape[-1])
    rows.flags.writeable = False
    return rows


@compiled(nogil=True)
def weigh_rows(costs, weights, sums):
    """Set ``sums`` ``[Y, X]`` to the weighted sums of layers ``[L, Y, X]``."""
    for row in range(sums.shape[0]):
        add_up(costs, weights, row, sums[row])


def weighted_sum(costs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[*cells]`` float64 the weighted sum of layers ``[L, *cells]``, added in their order."""
    layers = in_rows(costs)
    sums = np.empty(layers.shape[1:])
    weigh_rows(layers, np.asarray(weights, np.float64), sums)
    return sums.reshape(costs.shape[1:])


@compiled(nogil=True)
def weighted_line_minima(costs, weights, is_free):
    """Return the cheapest free cell of every row ``[Y]`` and of every column ``[X]``, inf without one.

    No map of the sums is made.

    Args:
      costs: ``[L, Y, X]``, not negative on free cells.
      weights: ``[L]`` float64, not negative.
      is_free: ``[Y, X]`` bool.
    """
    num_rows, num_cols = is_free.shape
    rows, cols, sums = np.full(num_rows, np.inf), np.full(num_cols, np.inf), np.empty(num_cols)
    # As whole numbers, whose order is that of numbers that are not negative: the processor then takes several at once.
    row_bits, sum_bits = rows.view(np.int64), sums.view(np.int64)
    for row in range(num_rows):
        add_up(costs, weights, row, sums)
        for col in range(num_cols):
            sums[col] = sums[col] if is_free[row, col] else np.inf
            cols[col] = sums[col] if sums[col] < cols[col] else cols[col]
        least = row_bits[row]
        for col in range(num_cols):
            least = min(least, sum_bits[col])
        row_bits[row] = least
    return rows, cols


@compiled(nogil=True)
def are_costs(costs, is_free):
    """Return whether layers ``[L, Y, X]`` are finite and not negative on free cells ``[Y, X]``."""
    num_wrong = 0
    for row in range(is_free.shape[0]):
        for layer in range(costs.shape[0]):
            for col in range(is_free.shape[1]):
                cost = costs[layer, row, col]
                num_wrong += is_free[row, col] & (not ((cost >= 0) & (cost < np.inf)))
    return num_wrong == 0
