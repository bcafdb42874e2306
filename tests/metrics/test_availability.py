"""Statistics over time against NumPy's, and the sums that tiles add up."""

import numpy as np
import pytest

from jaxurban.metrics.variables import SCALE, TimeTotals, series_statistics


@pytest.mark.parametrize("num_times", [1, 2, 7, 24, 288])
def test_statistics_equal_numpys_quantiles(num_times):
    m = np.random.default_rng(num_times).random((num_times, 3, 50), np.float32)
    m[0, 0] = 0.5  # exactly at the threshold: not available
    found = series_statistics(m, 0.5)
    np.testing.assert_allclose(found["median"], np.median(m, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["p05"], np.quantile(m, 0.05, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["availability"], (m > 0.5).mean(axis=0), atol=1e-6)
    assert all(values.dtype == np.float32 for values in found.values())


def test_totals_give_means_and_the_worst_epoch_in_any_order():
    m = np.random.default_rng(0).random((5, 2, 100))
    m[3, 1] /= 10
    cells = np.rint(m * SCALE).astype(int).reshape(5, 2, 10, 10)
    parts = [TimeTotals(cells[:, :, i].sum(axis=2), np.full(2, 10)) for i in range(10)]
    nothing = TimeTotals(np.zeros((5, 2), int), np.zeros(2, int))
    forward, backward = sum(parts, nothing), sum(parts[::-1], nothing)
    np.testing.assert_array_equal(forward.mean, backward.mean)
    np.testing.assert_allclose(forward.mean, m.mean(axis=2), atol=1e-4)
    assert forward.worst[1] == 3
