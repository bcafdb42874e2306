"""Ranks that count several times, against SciPy on the values written out."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, spearmanr

from jaxurban.studies.receiver.agreement import auc, scored, spearman

RNG = np.random.default_rng(4)
A, B = RNG.integers(0, 9, 60).astype(float), RNG.integers(0, 9, 60).astype(float)
COUNTS = RNG.integers(0, 4, (5, 60))


def test_spearman_is_scipys_on_values_as_often_as_they_count():
    wanted = [spearmanr(np.repeat(A, counts), np.repeat(B, counts)).statistic for counts in COUNTS]
    np.testing.assert_allclose(spearman(A, B, COUNTS), wanted, atol=1e-12)


def test_the_auc_is_mann_and_whitneys_u_over_the_pairs():
    is_positive = A > 4
    for counts, found in zip(COUNTS, auc(B, is_positive, COUNTS), strict=True):
        high, low = (np.repeat(B[chosen], counts[chosen]) for chosen in (is_positive, ~is_positive))
        assert found == pytest.approx(mannwhitneyu(high, low).statistic / (len(high) * len(low)), abs=1e-12)


def test_infinite_values_rank_last():
    values = np.array([1.0, 2.0, np.inf, np.inf])
    once = np.ones((1, 4), int)
    assert spearman(values, np.arange(4.0), once)[0] == pytest.approx(spearmanr([0, 1, 2, 2], range(4)).statistic)


def test_what_does_not_vary_and_one_kind_alone_have_no_coefficient():
    once = np.ones((1, 60), int)
    assert np.isnan(spearman(A, np.zeros(60), once)[0])
    assert np.isnan(auc(A, np.ones(60, bool), once)[0])


def test_the_interval_of_independent_values_is_about_that_of_fishers_transformation():
    rng = np.random.default_rng(0)
    x = rng.normal(size=400)
    y = 0.6 * x + 0.8 * rng.normal(size=400)
    found = scored(lambda counts: spearman(x, y, counts), np.arange(400))
    half = 1.96 * 1.06 / np.sqrt(397)  # of atanh; 1.06 for ranks (Fieller, Hartley and Pearson 1957)
    wanted = np.tanh(np.arctanh(found.value) + np.array([-half, half]))
    np.testing.assert_allclose([found.low, found.high], wanted, atol=0.02)


def test_alike_neighbours_make_the_interval_of_blocks_wider():
    rng = np.random.default_rng(1)
    x, y = (np.repeat(rng.normal(size=40), 10) for _ in range(2))
    alone = scored(lambda counts: spearman(x, y, counts), np.arange(400))
    together = scored(lambda counts: spearman(x, y, counts), np.repeat(np.arange(40), 10))
    assert together.value == alone.value
    assert together.high - together.low > 2.5 * (alone.high - alone.low)


def test_few_blocks_have_no_interval():
    found = scored(lambda counts: spearman(A, B, counts), np.repeat(np.arange(6), 10))
    assert np.isfinite(found.value)
    assert np.isnan(found.low)
