"""What cells cost under weights: layers times their weights, added up in their order, row by row.

The layers lie apart, so that one pass reads each of them once. Sums are float64; the same weights give the same bits
whoever sums them.
"""

import math

import numpy as np

from jaxurban.kernels.compiled import compiled


@compiled()
def _weigh_rows(costs, weights, sums):
    """Add the weighted sums of layers ``[L, Y, X]`` to ``sums`` ``[Y, X]``; layers of weight 0 are not read."""
    for row in range(sums.shape[0]):
        total = sums[row]
        for layer in range(weights.size):
            weight = weights[layer]
            if weight != 0.0:
                line = costs[layer, row]
                for col in range(total.size):
                    total[col] += weight * line[col]


def weighted_sum(costs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[*cells]`` float64 the weighted sum of layers, added in their order.

    Args:
      costs: ``[L, *cells]`` layers.
      weights: ``[L]``; a layer of weight 0 is not read.
    """
    shape = costs.shape[1:]
    layers = np.ascontiguousarray(costs).reshape(len(costs), math.prod(shape[:-1]), shape[-1])
    layers.flags.writeable = False  # always, since Numba compiles again for another kind of array
    sums = np.zeros(layers.shape[1:])
    _weigh_rows(layers, np.asarray(weights, np.float64), sums)
    return sums.reshape(shape)
