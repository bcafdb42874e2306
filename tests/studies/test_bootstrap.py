"""Bootstrap intervals, against the normal law."""

import numpy as np
import pytest

from jaxurban.studies.bootstrap import mean_interval


def test_the_interval_of_independent_values_is_that_of_the_normal_law():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    found = mean_interval(values, np.arange(400))
    half = 1.96 * values.std() / 20
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_repeats_within_a_group_add_nothing():
    values = np.random.default_rng(1).normal(size=100)
    once = mean_interval(values, np.arange(100))
    thrice = mean_interval(np.repeat(values, 3), np.repeat(np.arange(100), 3))
    assert thrice == pytest.approx(once)


def test_no_values_have_no_interval():
    assert np.isnan(mean_interval(np.empty(0), np.empty(0))).all()
