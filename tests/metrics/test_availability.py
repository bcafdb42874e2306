"""Statistics over time against NumPy's, and the sums that tiles add up."""

import numpy as np
import pytest

from jaxurban.metrics.variables import SCALE, TimeTotals, series_statistics


@pytest.mark.parametrize("num_times", [1, 2, 7, 24, 288])
def test_statistics_equal_numpys_quantiles(num_times):
    m = np.random.default_rng(num_times).random((num_times, 3, 50), np.float32)
    found = series_statistics(m, 0.5)
    np.testing.assert_allclose(found["median"], np.median(m, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["p05"], np.quantile(m, 0.05, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["availability"], (m > 0.5).mean(axis=0), atol=1e-6)
    assert all(values.dtype == np.float32 for values in found.values())


def test_an_epoch_exactly_at_the_threshold_is_not_available():
    m = np.array([[0.5], [0.75]], np.float32)
    assert series_statistics(m, 0.5)["availability"] == [0.5]


def test_statistics_do_not_depend_on_how_cells_are_cut():
    m = np.random.default_rng(0).random((30, 20_000), np.float32)
    whole, part = series_statistics(m, 0.3), series_statistics(m[:, 5_000:9_001], 0.3)
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][5_000:9_001])


def test_totals_give_means_and_the_worst_epoch_in_any_order():
    m = np.random.default_rng(0).random((5, 2, 100))
    m[3, 1] /= 10
    parts = [
        TimeTotals(np.rint(m[..., i : i + 10] * SCALE).astype(int).sum(axis=2), np.full(2, 10))
        for i in range(0, 100, 10)
    ]
    forward, backward = (TimeTotals(np.zeros((5, 2), int), np.zeros(2, int)) for _ in range(2))
    for part in parts:
        forward += part
    for part in parts[::-1]:
        backward += part
    np.testing.assert_array_equal(forward.mean, backward.mean)
    np.testing.assert_allclose(forward.mean, m.mean(axis=2), atol=1e-4)
    assert forward.worst[1] == 3
