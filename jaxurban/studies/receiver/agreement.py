"""How well one quantity ranks another along a track, and what chance leaves of it.

Legend: ``N`` values in the order of the track, ``G`` blocks of the track.

**Within blocks** the ranks are those of the whole track less their mean over the value's block. What is left says
whether the two quantities rise and fall together from one street to the next, and not that one quarter of the city is
denser than another. **Shifts** are the control: the maps' values are moved along the track, its end joined to its
beginning, by every number of places, so that both series stay what they are and only their pairing is lost.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.stats import rankdata
from scipy.stats import t as student

from jaxurban.studies.bootstrap import FEWEST_GROUPS, LEVEL

UNKNOWN = (np.nan, np.nan)


class Scored(NamedTuple):
    """A coefficient and its 95 % interval; NaN where it is not defined."""

    value: float
    low: float
    high: float


def spearman(a: np.ndarray, b: np.ndarray, blocks: np.ndarray | None = None) -> float:
    """Return Spearman's rank correlation of values ``[N]``, ties by mean ranks; NaN where either does not vary.

    Args:
      a, b: the values.
      blocks: ``[N]`` block of each value, for the correlation within blocks; None: over the whole track.
    """
    return _of_products(*(values.sum() for values in _products(a, b, blocks)))


def _of_products(aa: float, ab: float, bb: float) -> float:
    return float(ab / np.sqrt(aa * bb)) if aa * bb > 0 else np.nan


def _products(a: np.ndarray, b: np.ndarray, blocks: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``[G]`` sums over each block of the products of ranks, less their means: of a with a, a with b, b with b.

    Without blocks the whole track is one.
    """
    _, number = np.unique(np.zeros(len(a)) if blocks is None else blocks, return_inverse=True)
    of_a, of_b = (_centred(rankdata(values), number) for values in (a, b))
    aa, ab, bb = (np.bincount(number, product) for product in (of_a * of_a, of_a * of_b, of_b * of_b))
    return aa, ab, bb


def _centred(ranks: np.ndarray, number: np.ndarray) -> np.ndarray:
    return ranks - (np.bincount(number, ranks) / np.bincount(number))[number]


def without_each_block(a: np.ndarray, b: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return ``[G]`` the correlation within blocks (`spearman`) when one block after the other is left out."""
    products = np.stack(_products(a, b, blocks))
    return np.array([_of_products(*left) for left in (products.sum(axis=1, keepdims=True) - products).T])


def half_width(without_each: np.ndarray) -> float:
    """Return half the 95 % interval of a statistic by the jackknife over blocks: Student's t, G - 2 degrees of freedom.

    NaN with fewer blocks than `jaxurban.studies.bootstrap.FEWEST_GROUPS`, or where the statistic is not defined.

    Args:
      without_each: ``[G]`` the statistic when one block after the other is left out.
    """
    num = len(without_each)
    if num < FEWEST_GROUPS:
        return np.nan
    deviation = np.sqrt((num - 1) * np.var(without_each))
    return float(student.ppf((1 + LEVEL) / 2, num - 2) * deviation)


def within_blocks(a: np.ndarray, b: np.ndarray, blocks: np.ndarray) -> Scored:
    """Return the rank correlation within blocks of values ``[N]``, and its interval on Fisher's scale."""
    value = spearman(a, b, blocks)
    if not abs(value) < 1:
        return Scored(value, *UNKNOWN)
    half = half_width(np.arctanh(without_each_block(a, b, blocks)))
    low, high = np.tanh(np.arctanh(value) + np.array([-half, half]))
    return Scored(value, float(low), float(high))


def shifted(coefficient: Callable[[np.ndarray], float], values: np.ndarray) -> np.ndarray:
    """Return ``[N]`` a coefficient at every circular shift of the maps' values ``[N, ...]``, the first at none.

    At number ``s`` each place of the track is set against the values ``s`` places ahead.
    """
    return np.array([coefficient(np.roll(values, -shift, axis=0)) for shift in range(len(values))])
