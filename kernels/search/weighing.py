"""What cells cost under weights: layers times their weights, added up in their order, row by row.

The layers lie apart, so that one pass reads each of them once. Sums are float64; the same weights give the same bits
whoever sums them.
"""

import math

import numpy as np

from jaxurban.kernels.compiled import compiled


def in_rows(layers: np.ndarray) -> np.ndarray:
    """Return layers ``[L, *cells]`` as ``[L, Y, X]``, the last axis in ``X``: read-only, as compiled loops expect."""
    rows = np.ascontiguousarray(layers).reshape(len(layers), math.prod(layers.shape[1:-1]), layers.shape[-1])
    rows.flags.writeable = False
    return rows


@compiled(nogil=True)
def weigh_rows(costs, weights, sums):
    """Set ``sums`` ``[Y, X]`` to the weighted sums of layers ``costs`` ``[L, Y, X]``.

    Layers of weight 0 (``weights`` ``[L]`` float64) are not read.
    """
    for row in range(sums.shape[0]):
        total = sums[row]
        total[:] = 0.0
        for layer in range(weights.size):
            weight = weights[layer]
            if weight != 0.0:
                line = costs[layer, row]
                for k in range(total.size):
                    total[k] += weight * line[k]


def weighted_sum(costs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[*cells]`` float64 the weighted sum of layers ``[L, *cells]``, added in their order."""
    layers = in_rows(costs)
    sums = np.empty(layers.shape[1:])
    weigh_rows(layers, np.asarray(weights, np.float64), sums)
    return sums.reshape(costs.shape[1:])


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
