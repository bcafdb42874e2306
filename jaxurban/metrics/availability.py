"""A metric over a series of times: how often it is enough, its median, its worst."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.metrics.variables import SERIES

LOW_SHARE = 0.05  # of the times: the percentile kept beside the median
CELLS_AT_ONCE = 2**13  # a block's values at all times stay in a core's cache
SCALE = 2.0**14  # means over cells add up whole numbers of 1 / SCALE, so that no order of tiles changes them


def series_statistics(
    m: np.ndarray, availability_threshold: float, is_available: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Return statistics over time of each cell, float32, by the names of `SERIES`.

    ``availability`` is the share of times whose m is above the threshold, ``median`` the median, ``p05`` the value
    that 5 % of the times stay below; between two times the last two interpolate linearly (definition 7 of Hyndman
    and Fan 1996). Inside obstacles m is 0 at every time, and so are they. No gradient.

    Args:
      m: ``[T, ...]`` metric at each time, any axes of cells behind.
      availability_threshold: m above which a position counts as available.
      is_available: ``[T, ...]`` uint8: 1 where a position is available, whatever m is; left out, m decides.
    """
    num_times, *shape = m.shape
    flat = m.reshape(num_times, -1)
    found = {name: np.empty(flat.shape[1], np.float32) for name in SERIES}
    for start in range(0, flat.shape[1], CELLS_AT_ONCE):
        block = slice(start, start + CELLS_AT_ONCE)
        # A sort along contiguous memory takes a quarter of the time of a partition, a fourteenth of one along time.
        ordered = np.sort(np.ascontiguousarray(flat[:, block].T), axis=1)
        found["availability"][block] = np.mean(ordered > availability_threshold, axis=1)
        if is_available is not None:
            found["availability"][block] = np.mean(is_available.reshape(num_times, -1)[:, block], axis=0)
        found["median"][block] = _quantile(ordered, 0.5)
        found["p05"][block] = _quantile(ordered, LOW_SHARE)
    return {name: values.reshape(shape) for name, values in found.items()}


def _quantile(ordered: np.ndarray, share: float) -> np.ndarray:
    """Return a quantile of each row of ``[C, T]`` ascending values."""
    place = share * (ordered.shape[1] - 1)
    below = int(place)
    low, high = ordered[:, below], ordered[:, min(below + 1, ordered.shape[1] - 1)]
    return low + np.float32(place - below) * (high - low)


@jax.jit
def row_sums(m: jax.Array, is_counted: jax.Array) -> jax.Array:
    """Return the sum of round(m x `SCALE`) over the counted cells of each row, int32 ``[y]``."""
    return jnp.sum(jnp.where(is_counted, jnp.rint(m * SCALE).astype(jnp.int32), 0), axis=-1)


@dataclass
class TimeTotals:
    """Sums of m over free cells, time by time, gathered tile by tile in any order.

    Attributes:
      m_sum: ``[T, A]`` int64 sum of round(m x `SCALE`).
      num_free: ``[A]`` int64 cells that are not obstacles and have data.
    """

    m_sum: np.ndarray
    num_free: np.ndarray

    @classmethod
    def zero(cls, num_times: int, num_altitudes: int) -> "TimeTotals":
        """Return the sums over no cell."""
        return cls(np.zeros((num_times, num_altitudes), np.int64), np.zeros(num_altitudes, np.int64))

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> "TimeTotals":
        """Return the sums in `facts`, which JSON can hold."""
        return cls(np.array(facts["m_sum"], np.int64), np.array(facts["num_free"], np.int64))

    @property
    def facts(self) -> dict[str, Any]:
        """The sums as lists of numbers."""
        return {"m_sum": self.m_sum.tolist(), "num_free": self.num_free.tolist()}

    def __add__(self, other: "TimeTotals") -> "TimeTotals":
        return TimeTotals(self.m_sum + other.m_sum, self.num_free + other.num_free)

    @property
    def mean(self) -> np.ndarray:
        """Mean m of each time over free cells, ``[T, A]`` float64; 0 where no cell is free."""
        return self.m_sum / SCALE / np.maximum(self.num_free, 1)

    @property
    def worst(self) -> np.ndarray:
        """Index of the time of least mean, ``[A]``; the earliest of several."""
        return self.m_sum.argmin(axis=0)
