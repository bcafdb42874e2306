"""Weighted sums of layers against NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxurban.kernels.search.weighing import weighted_sum

SHAPES = [
    (4, 7, 19),
    (2, 3, 5, 7),
    (2, 1, 0),
    (2, 0, 4),
    (2, 2, 0, 3),
    (0, 7, 19),
]  # of layers, and their cells


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    dtype=st.sampled_from([np.float32, np.float64]),
    shape=st.sampled_from(SHAPES),
)
def test_sums_are_those_of_numpy_bit_for_bit_over_cells_of_any_shape(seed, dtype, shape):
    rng = np.random.default_rng(seed)
    costs = (rng.random(shape) ** 3).astype(dtype)
    costs[rng.random(shape) < 0.2] = 0
    costs[:, rng.random(shape[1:]) < 0.15] = np.nan  # as inside obstacles
    weights = 3 * rng.random(len(costs)) * (rng.random(len(costs)) < 0.75)
    total = np.zeros(shape[1:])
    for layer, weight in zip(costs, weights, strict=True):
        if weight:
            total += layer.astype(np.float64) * weight
    np.testing.assert_array_equal(weighted_sum(costs, weights), total)
