"""Weighted sums of layers against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxurban.kernels.search.weighing import weighted_sum


def random_layers(seed, dtype=np.float32, cells=(7, 19), num_layers=4):
    """Layers, NaN inside some of the cells that are not free, and weights of which one is 0."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(cells) < 0.7
    costs = (rng.random((num_layers, *cells)) ** 3).astype(dtype)
    costs[rng.random(costs.shape) < 0.2] = 0
    costs[:, ~is_free & (rng.random(cells) < 0.5)] = np.nan
    weights = rng.random(num_layers) * 3
    weights[rng.integers(num_layers)] = 0
    return costs, weights


def added_in_order(costs, weights):
    total = np.zeros(costs.shape[1:])
    for layer, weight in zip(costs, weights, strict=True):
        if weight:
            total += layer.astype(np.float64) * weight
    return total


@given(seed=st.integers(0, 10**6), dtype=st.sampled_from([np.float32, np.float64]))
def test_sums_are_those_of_numpy_bit_for_bit(seed, dtype):
    costs, weights = random_layers(seed, dtype)
    np.testing.assert_array_equal(weighted_sum(costs, weights), added_in_order(costs, weights))


@pytest.mark.parametrize("cells", [(3, 5, 7), (1, 0), (0, 4), (2, 0, 3)])
def test_sums_are_taken_over_cells_of_any_shape(cells):
    costs, weights = np.ones((2, *cells), np.float32), np.array([0.5, 2.0])
    np.testing.assert_array_equal(weighted_sum(costs, weights), np.full(cells, 2.5))
    np.testing.assert_array_equal(weighted_sum(costs[:0], weights[:0]), np.zeros(cells))
