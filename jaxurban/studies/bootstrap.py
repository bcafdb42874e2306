"""Intervals of nominally 95 % by the bootstrap over groups: what belongs to one group is drawn together.

Plain percentiles of few groups are too narrow: of 8 normal values they contain the mean in 88 % of the cases. Here
n - 1 of n groups are drawn, so that draws scatter as n groups do (Rao and Wu, J. Am. Stat. Assoc. 83, 1988), and ends
are taken as far out as Student's t is wider than the normal law (Hesterberg, Am. Stat. 69, 2015), and sqrt(n / (n - 1))
more, for medians and for groups of unequal sizes. Coverage in simulations with a known truth: docs/study.md.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

NUM_DRAWS = 2000
LEVEL = 0.95
FEWEST_GROUPS = 8  # of fewer Student's t asks for ends that so many draws do not reach
ROUNDING = 1e-9  # relative: counts that differ by less are the same

Statistic = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of values [N], each counted [B, N] times: [B]


class Interval(NamedTuple):
    """A statistic and its 95 % interval; NaN without values, the interval also with fewer than `FEWEST_GROUPS`."""

    mean: float
    low: float
    high: float


def mean_interval(values: np.ndarray, groups: np.ndarray, seed: int = 0) -> Interval:
    """Return the mean of ``[N]`` values and its interval, ``[N]`` groups drawn with replacement.

    Values of one group (an instance at several altitudes) are not independent, so whole groups are drawn.
    """
    if not len(values):
        return Interval(np.nan, np.nan, np.nan)
    _, number = np.unique(groups, return_inverse=True)
    sums, counts = np.bincount(number, values), np.bincount(number)
    draws = draws_of(len(counts), seed)
    return Interval(float(np.mean(values)), *ends_of((draws @ sums) / (draws @ counts), len(counts)))


def ends_of(drawn: np.ndarray, num_groups: int) -> tuple[float, float]:
    """Return the 95 % interval of a statistic drawn ``[B]`` times; NaN with too few groups, or where it is unknown.

    Args:
      drawn: over the draws of `draws_of` or `counts_within`.
      num_groups: degrees of freedom and 1: one less for each city but the first, where groups are drawn within cities.
    """
    known = drawn[np.isfinite(drawn)]
    if num_groups < FEWEST_GROUPS or len(known) < LEVEL * len(drawn):
        return np.nan, np.nan
    tail = special.ndtr(-reach_of(num_groups))
    low, high = np.quantile(known, [tail, 1 - tail])
    return float(low), float(high)


def reach_of(num_groups: int) -> float:
    """Return how many standard errors of its draws an interval reaches to each side."""
    return _student(num_groups) * np.sqrt(num_groups / (num_groups - 1))


def _student(num_groups: int) -> float:
    """Return how many standard errors Student's 95 % interval reaches to each side."""
    return float(special.stdtrit(num_groups - 1, (1 + LEVEL) / 2))


def draws_of(num_groups: int, seed: int | Sequence[int] = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, G]`` how often each group is drawn, G - 1 in all (a single group is always drawn)."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(max(1, num_groups - 1), np.full(num_groups, 1 / num_groups), NUM_DRAWS)


def counts_within(groups: np.ndarray, cities: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, N]`` how often each of ``[N]`` values counts: whole groups drawn, the cities as they are."""
    _, city = np.unique(np.asarray(cities, str), return_inverse=True)
    counts = np.zeros((NUM_DRAWS, len(city)))
    for number in np.unique(city):
        inside = np.flatnonzero(city == number)
        _, group = np.unique(np.asarray(groups)[inside], return_inverse=True)
        drawn = draws_of(int(group.max()) + 1, [seed, number])
        counts[:, inside] = drawn[:, group] * (drawn.shape[1] / drawn[0].sum())  # a city weighs what it has
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
    half_passed = passed * 2 >= passed[:, -1:] * (1 - ROUNDING)
    return np.where(passed[:, -1] > 0, values[order][np.argmax(half_passed, axis=-1)], np.nan)


def interval_of(values: np.ndarray, counts: np.ndarray, num_groups: int, statistic: Statistic = mean_of) -> Interval:
    """Return a statistic of ``[N]`` values, and its interval over draws ``[B, N]`` of them."""
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
    return Interval(0.0, 0.0, 1 - least) if found.mean == 0 else Interval(1.0, least, 1.0)


def p_value(interval: Interval, value: float, num_groups: int) -> float:
    """Return the two-sided p of a value that a statistic may have; NaN without an interval.

    It is Student's t, the standard error being that of the interval's arm on the value's side, so that p is below 0.05
    where the interval leaves the value out; and never less than 2 ** (1 - G), what G signs that are all alike give.
    """
    arm = interval.mean - interval.low if value < interval.mean else interval.high - interval.mean
    if not np.isfinite(arm) or value == interval.mean:
        return np.nan if not np.isfinite(arm) else 1.0
    errors = abs(value - interval.mean) / arm * _student(num_groups) if arm > 0 else np.inf
    return max(float(2 * special.stdtr(num_groups - 1, -errors)), 2.0 ** (1 - num_groups))


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Return Holm's adjusted p of several tests (Scand. J. Stat. 6, 1979): the chance that any is wrong; NaN stays."""
    p = np.asarray(p_values, np.float64)
    adjusted, known = np.full(p.shape, np.nan), np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    steps = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted
