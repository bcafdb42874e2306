"""Bootstrap intervals, against the normal law and by how often they contain a known truth."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from jaxurban.studies.bootstrap import FEWEST_GROUPS, Clusters, Interval, draws_of, ends_of, median_of
from jaxurban.studies.montecarlo.analysis import correlation_of


def test_the_interval_of_independent_values_is_that_of_the_normal_law():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    found = Clusters(np.arange(400)).interval(values)
    half = 1.96 * values.std() / 20
    assert found.value == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_repeats_within_a_group_add_nothing():
    values = np.random.default_rng(1).normal(size=100)
    once = Clusters(np.arange(100)).interval(values)
    thrice = Clusters(np.repeat(np.arange(100), 3)).interval(np.repeat(values, 3))
    assert thrice == pytest.approx(once)


def test_draws_within_cities_leave_the_differences_of_cities_out_and_draws_of_cities_contain_them():
    rng = np.random.default_rng(2)
    num_cities, num_groups = 40, 50
    levels, cities = rng.normal(0, 3.0, num_cities), np.repeat(np.arange(num_cities), num_groups)
    values, groups = levels[cities] + rng.normal(0, 1.0, cities.size), np.tile(np.arange(num_groups), num_cities)
    within, over = Clusters(groups, cities).interval(values), Clusters(cities).interval(values)
    residual = values - np.array([values[cities == city].mean() for city in range(num_cities)])[cities]
    half = 1.96 * residual.std() / np.sqrt(cities.size - num_cities)
    assert (within.high - within.low) / 2 == pytest.approx(half, rel=0.1)
    of_means = [values[cities == city].mean() for city in range(num_cities)]
    assert (over.high - over.low) / 2 == pytest.approx(2.02 * np.std(of_means, ddof=1) / np.sqrt(num_cities), rel=0.1)


def test_every_draw_within_cities_holds_each_city_as_often_as_it_is_there():
    cities, group = np.repeat(["a", "b"], [6, 10]), np.repeat(np.arange(8), 2)
    clusters = Clusters(group, cities)
    np.testing.assert_allclose(clusters.drawn((cities == "a").astype(float)), 6 / 16)
    noise = np.random.default_rng(5).normal(size=8)[group]
    signs = np.tile([1.0, -1.0], 8)
    np.testing.assert_allclose(clusters.drawn(noise * signs), 0, atol=1e-12)  # both of a group are drawn together


def test_medians_and_means_of_drawn_values_are_those_of_the_values_repeated():
    rng = np.random.default_rng(3)
    values, counts = rng.normal(size=15), rng.integers(0, 4, (20, 15))
    expected = [np.quantile(np.repeat(values, each), 0.5, method="inverted_cdf") for each in counts]
    np.testing.assert_allclose(median_of(values, counts), expected, rtol=1e-12)
    drawn = [np.repeat(values, each).mean() for each in draws_of(15, [0, 0])]
    np.testing.assert_allclose(Clusters(np.arange(15)).drawn(values), drawn, rtol=1e-12)


def test_a_share_of_none_is_bounded_where_as_many_would_be_none_once_in_twenty_times():
    values, groups = np.zeros(60), np.arange(60)
    found = Clusters(groups).interval(values, "share")
    assert found[:2] == (0.0, 0.0)
    assert binom.pmf(0, 60, found.high) == pytest.approx(0.05)
    full = Clusters(groups).interval(values + 1, "share")
    assert full.value == full.high == 1.0
    assert full.low == pytest.approx(1 - found.high)


def test_no_values_and_those_of_few_pairs_have_no_interval_however_many_pairs_a_table_has():
    """Of 60 pairs the values of 7 are known; with 8 there is an interval."""
    assert np.isnan(Clusters(np.empty(0)).interval(np.empty(0))).all()
    pair, rng = np.arange(60), np.random.default_rng(15)
    drawn, values = Clusters(pair), pd.Series(rng.normal(size=60))
    for num, is_known in ((FEWEST_GROUPS - 1, False), (FEWEST_GROUPS, True)):
        assert np.isfinite(drawn.interval(values.where(pair < num)).low) == is_known
        assert np.isfinite(drawn.interval((values > 0).astype(float).where(pair < num), "share").low) == is_known


def independent(num, statistic, truth, draw):
    """Return what draws as many values as groups, and gives their interval and the truth."""
    clusters = Clusters(np.arange(num))
    return lambda rng: (clusters.interval(draw(rng, num), statistic), truth)


def uneven(num):
    """Groups of 1 to 12 values that are alike within a group."""

    def drawn(rng):
        groups = np.repeat(np.arange(num), rng.integers(1, 13, num))
        return Clusters(groups).interval(rng.normal(size=num)[groups] + rng.normal(size=groups.size)), 0.0

    return drawn


def correlated(num, truth):
    draws = draws_of(num)

    def drawn(rng):
        gps = rng.normal(size=num)
        lidar = truth * gps + np.sqrt(1 - truth**2) * rng.normal(size=num)
        sums = np.stack([np.ones(num), gps, lidar, gps**2, lidar**2, gps * lidar], axis=1)
        return Interval(truth, *ends_of(correlation_of(draws @ sums), num)), truth

    return drawn


def of_cities(num):
    """Means over pairs of places at two altitudes in three cities that differ; each more costs a degree of freedom."""
    pair = np.repeat(np.arange(2 * (num + 2)), 2)
    level, is_in = (pair % 3).astype(float), pair % 2 == 0
    part = Clusters(pair[is_in], np.array(["a", "b", "c"])[pair % 3][is_in])
    assert part.num_groups == num

    def drawn(rng):
        values = level + rng.normal(size=2 * (num + 2))[pair] + 0.5 * rng.normal(size=pair.size)
        return part.interval(values[is_in]), level[is_in].mean()

    return drawn


def of_routes_and_heights(num):
    route, draw = (part.ravel() for part in np.indices((12, num)))
    clusters = Clusters(route).crossed(Clusters(draw, seed=1))

    def drawn(rng):
        values = rng.normal(size=12)[route] + rng.normal(size=num)[draw] + rng.normal(size=route.size)
        return clusters.interval(values), 0.0

    return drawn


SEEDS = {"uncorrelated": 12, "correlated": 12, "of cities": 13, "of routes and heights": 14}
MADE = {
    "normal": lambda num: independent(num, "mean", 0.0, lambda rng, num: rng.normal(size=num)),
    "skewed": lambda num: independent(num, "mean", np.exp(0.25**2 / 2), lambda rng, num: rng.lognormal(0, 0.25, num)),
    "exponential": lambda num: independent(num, "mean", 1.0, lambda rng, num: rng.exponential(size=num)),
    "median": lambda num: independent(num, "median", 0.0, lambda rng, num: rng.normal(size=num)),
    "share": lambda num: independent(num, "share", 0.3, lambda rng, num: (rng.random(num) < 0.3).astype(float)),
    "uneven": uneven,
    "uncorrelated": lambda num: correlated(num, 0.0),
    "correlated": lambda num: correlated(num, 0.5),
    "of cities": of_cities,
    "of routes and heights": of_routes_and_heights,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "num_groups"),
    [*itertools.product([*MADE][:-1], (FEWEST_GROUPS, 15, 30)), ([*MADE][-1], FEWEST_GROUPS)],
)
def test_intervals_contain_the_truth_in_93_of_100_cases_and_less_often_where_values_are_skewed(made, num_groups):
    rng, drawn, inside = np.random.default_rng(SEEDS.get(made, 11)), MADE[made](num_groups), 0
    for _ in range(2000):
        interval, truth = drawn(rng)
        inside += interval.low <= truth <= interval.high
    assert inside >= (0.91 if made == "exponential" else 0.93) * 2000, inside / 2000
