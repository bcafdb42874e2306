"""Confidence intervals by the bootstrap over groups: what belongs to one group is drawn together."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NUM_DRAWS = 2000
LEVEL = 0.95
FEWEST_GROUPS = 8  # fewer are drawn too much alike for an interval to mean anything

Statistic = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of values [N], each counted [B, N] times: [B]
TimesOf = Callable[[np.random.Generator, int], np.ndarray]


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


def counts_within(groups: np.ndarray, cities: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, N]`` how often each of ``[N]`` values counts: whole groups drawn, the cities as they are."""
    return _counts(groups, cities, lambda rng, num: np.ones((NUM_DRAWS, num), np.int64), seed)


def counts_over(groups: np.ndarray, cities: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, N]`` how often each value counts: cities drawn, and in each drawn one whole groups.

    With few cities this is too narrow: no draw holds a city that differs more than those that are there.
    """

    def drawn(rng: np.random.Generator, num: int) -> np.ndarray:
        return rng.multinomial(num, np.full(num, 1 / num), NUM_DRAWS)

    return _counts(groups, cities, drawn, seed)


def _counts(groups: np.ndarray, cities: np.ndarray, times_of: TimesOf, seed: int) -> np.ndarray:
    """Return the counts where ``times_of(rng, num)`` says how often each of the cities is drawn."""
    rng = np.random.default_rng(seed)
    names, city = np.unique(np.asarray(cities, str), return_inverse=True)
    times = times_of(rng, len(names))
    counts = np.zeros((NUM_DRAWS, len(city)), np.int64)
    for number in range(len(names)):
        inside = np.flatnonzero(city == number)
        _, group = np.unique(np.asarray(groups)[inside], return_inverse=True)
        num = int(group.max()) + 1
        counts[:, inside] = rng.multinomial(num * times[:, number], np.full(num, 1 / num))[:, group]
    return counts


def mean_of(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` means of ``[N]`` values, each counted ``[B, N]`` times; NaN where none counts."""
    total = counts.sum(axis=-1)
    return np.divide(counts @ values, total, out=np.full(len(counts), np.nan), where=total > 0)


def share_of(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` the shares of ``[N]`` values, 0 or 1, that are 1, each counted ``[B, N]`` times."""
    return mean_of(values, counts)


def median_of(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` medians of ``[N]`` values (the lower of two in the middle), each counted ``[B, N]`` times."""
    order = np.argsort(values)
    passed = np.cumsum(counts[:, order], axis=-1)
    return np.where(passed[:, -1] > 0, values[order][np.argmax(passed * 2 >= passed[:, -1:], axis=-1)], np.nan)


def interval_of(values: np.ndarray, counts: np.ndarray, num_groups: int, statistic: Statistic = mean_of) -> Interval:
    """Return a statistic of ``[N]`` values, and its percentile interval over draws ``[B, N]`` of them."""
    if not len(values):
        return Interval(np.nan, np.nan, np.nan)
    (found,) = statistic(values, np.ones((1, len(values)), np.int64))
    return Interval(float(found), *ends_of(statistic(values, counts), num_groups))


def share_interval(values: np.ndarray, counts: np.ndarray, num_groups: int) -> Interval:
    """Return the share of ``[N]`` values that are 1, the others 0, and its interval (`interval_of`).

    Where all are alike every draw is, which says nothing: there the interval ends where so many groups would all be
    alike once in twenty times.
    """
    found = interval_of(values, counts, num_groups)
    if num_groups < FEWEST_GROUPS or found.mean not in (0.0, 1.0):
        return found
    least = (1 - LEVEL) ** (1 / num_groups)
    return found._replace(high=1 - least) if found.mean == 0 else found._replace(low=least)
