"""Weighted sums of layers against NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxurban.kernels.search.weighing import weighted_sum


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), dtype=st.sampled_from([np.float32, np.float64]))
def test_sums_are_those_of_numpy_bit_for_bit(seed, dtype):
    rng = np.random.default_rng(seed)
    costs = (rng.random((4, 7, 19)) ** 3).astype(dtype)
    costs[rng.random(costs.shape) < 0.2] = 0
    costs[:, rng.random((7, 19)) < 0.15] = np.nan  # as inside obstacles
    weights = rng.random(4) * 3
    weights[rng.integers(4)] = 0
    total = np.zeros(costs.shape[1:])
    for layer, weight in zip(costs, weights, strict=True):
        if weight:
            total += layer.astype(np.float64) * weight
    np.testing.assert_array_equal(weighted_sum(costs, weights), total)


@pytest.mark.parametrize("cells", [(3, 5, 7), (1, 0), (0, 4), (2, 0, 3)])
def test_sums_are_taken_over_cells_of_any_shape(cells):
    costs, weights = np.ones((2, *cells), np.float32), np.array([0.5, 2.0])
    np.testing.assert_array_equal(weighted_sum(costs, weights), np.full(cells, 2.5))
    np.testing.assert_array_equal(weighted_sum(costs[:0], weights[:0]), np.zeros(cells))
