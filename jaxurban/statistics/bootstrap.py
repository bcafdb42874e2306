"""Intervals of nominally 95 % by the bootstrap over groups: what belongs to one group is drawn together.

Plain percentiles of few groups are too narrow: of 8 normal values they contain the mean in 88 % of the cases. Here
n - 1 of n groups are drawn, so that draws scatter as n groups do (Rao and Wu, J. Am. Stat. Assoc. 83, 1988), and ends
are taken as far out as Student's t is wider than the normal law (Hesterberg, Am. Stat. 69, 2015), and sqrt(n / (n - 1))
more, for medians and for groups of unequal sizes. Coverage in simulations with a known truth:
docs/studies/montecarlo.md.
"""

from collections.abc import Sequence
from copy import copy
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from jaxurban.checks import at_least, typed
from jaxurban.kernels.tolerances import SAME_COUNT

NUM_DRAWS = 2000
LEVEL = 0.95
FEWEST_GROUPS = 8  # of fewer Student's t asks for ends that so many draws do not reach

Values = np.ndarray | pd.Series | pd.Index
Statistic = Literal["mean", "median", "share"]  # the last of values that are 0 or 1


class Interval(NamedTuple):
    """A statistic and its 95 % interval; NaN without values, the interval also with fewer than `FEWEST_GROUPS`."""

    value: float
    low: float
    high: float


def named(name: str, interval: Interval) -> dict[str, float]:
    """Return an interval as columns."""
    return dict(zip(interval_columns(name), interval, strict=True))


def interval_columns(*names: str) -> list[str]:
    """Return the columns of statistics, each followed by the ends of its interval (`named`)."""
    return [f"{name}{end}" for name in names for end in ("", "_low", "_high")]


class Clusters:
    """Draws of ``N`` values in groups: whole groups are drawn, within cities where there are several.

    Attributes:
      num_groups: degrees of freedom and 1: one less for each city but the first.

    Examples:
      >>> clusters = ju.studies.Clusters(np.arange(40) // 2)  # 20 groups of 2 values
      >>> clusters.num_groups, [round(end, 1) for end in clusters.interval(np.arange(40.0))]
      (20, [19.5, 13.8, 25.2])
    """

    @typed
    def __init__(self, groups: Values, cities: Values | None = None, seed: int = 0) -> None:
        """Draw the groups `NUM_DRAWS` times, in each city for itself.

        Values of one group (an instance at several altitudes) are not independent, so they are drawn together. Groups
        and cities are numbered in the order in which they come, so that draws do not depend on their names.

        Args:
          groups: ``[N]`` the group of each value; groups of one name in two cities are two groups.
          cities: ``[N]`` the city of each value; None: all are in one.
          seed: of the draws.
        """
        at_least("seed", seed)
        groups = np.asarray(groups)
        names = np.zeros(len(groups)) if cities is None else np.asarray(cities, str)
        self._city, present = pd.factorize(names)  # [N] number of each value's city
        # [N] number of each value's group, counted over all cities.
        self._group = np.zeros(len(groups), int)

        # City after city: the numbers of its groups, which follow those of earlier cities, and draws of them.
        draws = [np.empty((NUM_DRAWS, 0))]
        num_before = 0
        for city in range(len(present)):
            is_inside = self._city == city
            group, members = pd.factorize(groups[is_inside])
            self._group[is_inside] = num_before + group
            num_before += len(members)
            drawn = draws_of(len(members), [seed, city])

            # One group less is drawn than there are: without this factor a city would weigh less than its groups do.
            draws.append(drawn * (len(members) / drawn[0].sum()))
        self._draws = np.hstack(draws)  # [NUM_DRAWS, G] how often each draw holds each group
        self._column = self._group  # [N] column of the draws that counts each value

        # At most one for each value, as `groups_of` cuts at this number.
        self.num_groups = len(groups)
        self.num_groups = self.groups_of(np.ones(len(groups), bool))

    def groups_of(self, chosen: np.ndarray) -> int:
        """Return how many groups the chosen values ``[N]`` bool belong to, counted as `num_groups` is.

        Returns:
          A whole number.

        Examples:
          >>> ju.studies.Clusters(np.arange(40) // 2).groups_of(np.arange(40) < 10)
          5
        """
        num_groups = self.count(chosen)
        num_cities = len(np.unique(self._city[chosen]))
        return min(self.num_groups, num_groups - max(num_cities - 1, 0))

    def count(self, chosen: np.ndarray) -> int:
        """Return how many groups the chosen values ``[N]`` bool belong to.

        Returns:
          A whole number.

        Examples:
          >>> ju.studies.Clusters(np.arange(40) // 2).count(np.arange(40) < 10)
          5
        """
        return len(np.unique(self._group[chosen]))

    def crossed(self, other: "Clusters") -> "Clusters":
        """Return draws of the same values in which these groups and the other ones are both drawn.

        This is Owen's pigeonhole bootstrap (Ann. Appl. Stat. 1(2), 2007): a value counts as often as the draws of its
        two groups multiplied.

        Returns:
          `Clusters` of the same values.

        Examples:
          >>> routes, maps_drawn = np.divmod(np.arange(40), 4)
          >>> both = ju.studies.Clusters(routes).crossed(ju.studies.Clusters(maps_drawn, seed=1))
          >>> both.num_groups
          4
        """
        both = copy(self)
        both._draws = self._draws[:, self._column] * other._draws[:, other._column]
        both._column = np.arange(len(self._column))
        both.num_groups = min(self.num_groups, other.num_groups)
        return both

    def drawn(self, values: np.ndarray, statistic: Statistic = "mean") -> np.ndarray:
        """Return ``[NUM_DRAWS]`` the statistic of the values ``[N]`` in each draw.

        Values that are NaN do not count. The statistic of a draw that holds no other value is NaN. A share is a mean.

        Args:
          values: ``[N]`` in the order of the groups.
          statistic: ``"mean"``, ``"share"`` or ``"median"``.

        Returns:
          An array, in the order of the draws.

        Examples:
          >>> drawn = ju.studies.Clusters(np.arange(40)).drawn(np.arange(40.0))
          >>> drawn.shape, round(float(drawn.mean()))
          ((2000,), 19)
        """
        is_known = ~np.isnan(values)
        known = values[is_known]
        columns = self._column[is_known]
        if statistic == "median":
            return median_of(known, self._draws[:, columns])

        # A mean: the sum of the values in each group, and their number, as often as each draw holds the group.
        num = self._draws.shape[1]
        total = self._draws @ np.bincount(columns, minlength=num)
        sums = self._draws @ np.bincount(columns, known, num)
        return np.divide(sums, total, out=np.full(len(total), np.nan), where=total > 0)

    @typed
    def interval(self, values: Values, statistic: Statistic = "mean") -> Interval:
        """Return a statistic of the values ``[N]``, and its 95 % interval.

        Values that are NaN do not count, and without any other all three numbers are NaN. The median of an even number
        of values is the lower one of the two in the middle. A share of values that are all 0, or all 1, is the same in
        every draw, which says nothing about its interval. There the interval ends at the share under which all groups
        would be alike once in twenty times.

        Args:
          values: ``[N]`` in the order of the groups.
          statistic: ``"mean"``, ``"share"`` (a mean of zeros and ones) or ``"median"``.

        Returns:
          ``value``, ``low`` and ``high``; the ends are NaN with fewer groups than 8.

        Examples:
          >>> clusters = ju.studies.Clusters(np.arange(40))
          >>> clusters.interval(np.zeros(40), "share")
          Interval(value=0.0, low=0.0, high=0.0721...)
        """
        values = np.asarray(values, np.float64)
        is_known = ~np.isnan(values)
        known = values[is_known]
        if not len(known):
            return Interval(np.nan, np.nan, np.nan)

        # The statistic; a share that is wholly 0 or 1 has an interval without draws.
        num_groups = self.groups_of(is_known)
        value = known.mean()
        if statistic == "median":
            value = np.quantile(known, 0.5, method="inverted_cdf")
        if statistic == "share" and num_groups >= FEWEST_GROUPS:
            least = (1 - LEVEL) ** (1 / num_groups)  # least**num_groups is one in twenty
            if value == 0:
                return Interval(0.0, 0.0, 1 - least)
            if value == 1:
                return Interval(1.0, least, 1.0)
        return interval_of(value, self.drawn(values, statistic), num_groups)


def interval_of(value: float, drawn: np.ndarray, num_groups: int) -> Interval:
    """Return a statistic and its 95 % interval.

    The ends are NaN with fewer groups than `FEWEST_GROUPS`, or where the statistic is finite in less than 95 % of the
    draws.

    Args:
      value: of the statistic, without draws.
      drawn: ``[B]`` the statistic over the draws of `draws_of`; NaN where a draw does not define it.
      num_groups: degrees of freedom and 1: one less for each city but the first, where groups are drawn within cities.
    """
    known = drawn[np.isfinite(drawn)]
    ends = [np.nan, np.nan]
    if num_groups >= FEWEST_GROUPS and len(known) >= LEVEL * len(drawn):
        # How many standard errors of the draws it reaches to each side, and the share of normal values beyond.
        student = special.stdtrit(num_groups - 1, (1 + LEVEL) / 2)
        tail = special.ndtr(-student * np.sqrt(num_groups / (num_groups - 1)))
        ends = np.quantile(known, [tail, 1 - tail]).tolist()
    return Interval(float(value), *ends)


def draws_of(num_groups: int, seed: int | Sequence[int] = 0) -> np.ndarray:
    """Return ``[NUM_DRAWS, G]`` how often each group is drawn, G - 1 in all (a single group is always drawn)."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(max(1, num_groups - 1), np.full(num_groups, 1 / num_groups), NUM_DRAWS)


def median_of(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` medians of values under several counts; of an even number the lower one of the two in the middle.

    Args:
      values: ``[N]``.
      counts: ``[B, N]`` how often each value counts; where all are 0 the median is NaN.
    """
    # The first value in rising order up to which half of the counts lie.
    order = np.argsort(values)
    passed = np.cumsum(counts[:, order], axis=-1)
    half_passed = passed * 2 >= passed[:, -1:] * (1 - SAME_COUNT)
    return np.where(passed[:, -1] > 0, values[order][np.argmax(half_passed, axis=-1)], np.nan)
