"""Bootstrap intervals, against the normal law."""

import numpy as np
import pytest
from scipy.stats import binom

from jaxurban.studies.bootstrap import (
    counts_over,
    counts_within,
    interval_of,
    mean_interval,
    mean_of,
    median_of,
    share_interval,
)


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


def test_draws_within_cities_leave_the_differences_of_cities_out_and_draws_of_cities_hold_them():
    rng = np.random.default_rng(2)
    num_cities, num_groups = 40, 50
    levels, cities = rng.normal(0, 3.0, num_cities), np.repeat(np.arange(num_cities), num_groups)
    values, groups = levels[cities] + rng.normal(0, 1.0, cities.size), np.tile(np.arange(num_groups), num_cities)
    within = interval_of(values, counts_within(groups, cities), cities.size)
    over = interval_of(values, counts_over(groups, cities), cities.size)
    residual = values - np.array([values[cities == city].mean() for city in range(num_cities)])[cities]
    half = 1.96 * residual.std() / np.sqrt(cities.size)
    assert (within.high - within.low) / 2 == pytest.approx(half, rel=0.1)
    of_means = [values[cities == city].mean() for city in range(num_cities)]
    assert (over.high - over.low) / 2 == pytest.approx(1.96 * np.std(of_means) / np.sqrt(num_cities), rel=0.15)


def test_every_draw_within_cities_holds_each_city_as_often_as_it_is_there():
    cities = np.repeat(["a", "b"], [6, 10])
    counts = counts_within(np.repeat(np.arange(8), 2), cities)
    assert (counts[:, :6].sum(axis=1) == 6).all()
    assert (counts[:, 6:].sum(axis=1) == 10).all()
    assert (counts[:, 0::2] == counts[:, 1::2]).all(), "both values of a group are drawn together"


def test_medians_and_means_of_counted_values_are_those_of_the_values_repeated():
    rng = np.random.default_rng(3)
    values, counts = rng.normal(size=15), rng.integers(0, 4, (20, 15))
    for statistic, plain in ((mean_of, np.mean), (median_of, lambda v: np.quantile(v, 0.5, method="inverted_cdf"))):
        expected = [plain(np.repeat(values, each)) for each in counts]
        np.testing.assert_allclose(statistic(values, counts), expected, rtol=1e-12)


def test_a_share_of_none_is_bounded_where_as_many_would_be_none_once_in_twenty_times():
    values, groups = np.zeros(60), np.arange(60)
    found = share_interval(values, counts_within(groups, np.zeros(60)), 60)
    assert found[:2] == (0.0, 0.0)
    assert binom.pmf(0, 60, found.high) == pytest.approx(0.05)
    full = share_interval(values + 1, counts_within(groups, np.zeros(60)), 60)
    assert full.mean == full.high == 1.0
    assert full.low == pytest.approx(1 - found.high)
