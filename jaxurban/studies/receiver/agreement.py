"""How well one quantity ranks another: Spearman's coefficient and the AUC, with intervals by a block bootstrap.

Legend: ``N`` values, ``B`` draws, in each of which a value counts so many times.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxurban.studies.bootstrap import draws_of, ends_of

DRAWS_AT_ONCE = 100  # so that what they need stays small

Agreement = Callable[[np.ndarray], np.ndarray]  # of how often each value counts, [B, N]: [B]


class Scored(NamedTuple):
    """A coefficient, its 95 % interval, and its draws ``[B]``; NaN where it is not defined.

    The interval is also NaN with fewer blocks than `jaxurban.studies.bootstrap.FEWEST_GROUPS`.
    """

    value: float
    low: float
    high: float
    drawn: np.ndarray


def scored(agreement: Agreement, blocks: np.ndarray, seed: int = 0) -> Scored:
    """Return a coefficient with its percentile interval, whole blocks drawn with replacement.

    Args:
      agreement: what is drawn.
      blocks: ``[N]`` the block of each value.
      seed: of the draws: with the same blocks and seed two coefficients are drawn on the same data.
    """
    if not len(blocks):
        return Scored(np.nan, np.nan, np.nan, np.empty(0))
    _, number = np.unique(blocks, return_inverse=True)
    num_blocks = int(number.max()) + 1
    (value,) = agreement(np.ones((1, len(blocks)), np.int64))
    draws = draws_of(num_blocks, seed)
    parts = [draws[first : first + DRAWS_AT_ONCE] for first in range(0, len(draws), DRAWS_AT_ONCE)]
    drawn = np.concatenate([agreement(part[:, number]) for part in parts])
    return Scored(float(value), *ends_of(drawn, num_blocks), drawn)


def midranks(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B, N]`` the mean rank, from 0 up and less a half, of values ``[N]`` that count ``[B, N]`` times."""
    _, level = np.unique(values, return_inverse=True)
    order = np.argsort(level, kind="stable")
    first = np.flatnonzero(np.diff(level[order], prepend=-1))
    of_level = np.add.reduceat(counts[:, order], first, axis=1)
    return (np.cumsum(of_level, axis=1) - of_level / 2)[:, level]


def spearman(a: np.ndarray, b: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` Spearman's rank correlation of values ``[N]`` that count ``[B, N]`` times, ties by mean ranks.

    NaN where either does not vary.
    """
    total = counts.sum(axis=1)
    of_a, of_b = (midranks(values, counts) - total[:, None] / 2 for values in (a, b))  # the mean rank is half the total
    aa, ab, bb = (np.sum(counts * product, axis=1) for product in (of_a * of_a, of_a * of_b, of_b * of_b))
    varies = (aa > 0) & (bb > 0)
    return np.divide(ab, np.sqrt(aa * bb), out=np.full(len(counts), np.nan), where=varies)


def auc(scores: np.ndarray, is_positive: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return ``[B]`` how likely a positive scores higher than a negative, ties by half; values count ``[B, N]`` times.

    The area under the receiver operating characteristic, by the ranks of Mann and Whitney. NaN without either kind.
    """
    of_positives = counts * is_positive
    positives = of_positives.sum(axis=1)
    negatives = counts.sum(axis=1) - positives
    above = np.sum(of_positives * midranks(scores, counts), axis=1) - positives**2 / 2
    pairs = positives * negatives
    return np.divide(above, pairs, out=np.full(len(counts), np.nan), where=pairs > 0)
