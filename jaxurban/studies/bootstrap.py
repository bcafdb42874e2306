"""Confidence intervals by the bootstrap over groups: what belongs to one group is drawn together."""

from typing import NamedTuple

import numpy as np

NUM_DRAWS = 2000
LEVEL = 0.95
FEWEST_GROUPS = 8  # fewer are drawn too much alike for an interval to mean anything


class Interval(NamedTuple):
    """A mean and its 95 % interval; NaN without values, the interval also with fewer than `FEWEST_GROUPS` groups."""

    mean: float
    low: float
    high: float


def mean_interval(values: np.ndarray, groups: np.ndarray, seed: int = 0) -> Interval:
    """Return the mean of ``[N]`` values and its percentile interval, ``[N]`` groups drawn with replacement.

    Values of one group (an instance at several altitudes) are not independent, so whole groups are drawn.
    """
    if not len(values):
        return Interval(np.nan, np.nan, np.nan)
    _, number = np.unique(groups, return_inverse=True)
    sums, counts = np.bincount(number, values), np.bincount(number)
    draws = draws_of(len(counts), seed)
    return Interval(float(np.mean(values)), *ends_of((draws @ sums) / (draws @ counts), len(counts)))


def ends_of(drawn: np.ndarray, num_groups: int) -> tuple[float, float]:
    """Return the 95 % interval of a statistic drawn ``[B]`` times; NaN with too few groups, or where it is unknown."""
    known = drawn[np.isfinite(drawn)]
    if num_groups < FEWEST_GROUPS or len(known) < LEVEL * len(drawn):
        return np.nan, np.nan
    low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def draws_of(num_groups: int, seed: int = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, G]`` how often each group is drawn."""
    return np.random.default_rng(seed).multinomial(num_groups, np.full(num_groups, 1 / num_groups), NUM_DRAWS)
