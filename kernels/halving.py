"""Rasters of half as many rows and columns, as GDAL makes overviews, from a part of the rows at a time.

A side of n cells has n // 2 in the overview, so that an odd one is brought down by a little more than 2. Sums run in
GDAL's order (``GDALResampleChunk_AverageOrRMS`` and ``GDALResampleChunk_Near`` of its ``gcore/overview.cpp``), so that
the values are GDAL's to the last bit.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from jaxurban.kernels.compiled import compiled

EPSILON_CELLS = 1e-8  # GDAL's, against a ratio that comes out a little off
MOST_CELLS = 3  # of a row or a column under one of the overview: 2, and of an odd side a part of one more


class Halving(NamedTuple):
    """How a raster becomes its overview.

    Attributes:
      shape: rows and columns of the raster.
      is_averaged: whether cells hold the mean of those that they cover, NaN left out; else the one in the middle.
    """

    shape: tuple[int, int]
    is_averaged: bool

    @property
    def halved(self) -> tuple[int, int]:
        """Rows and columns of the overview."""
        return max(1, self.shape[0] // 2), max(1, self.shape[1] // 2)

    @property
    def ratio(self) -> tuple[float, float]:
        """Rows of the raster to one of the overview, and columns."""
        return self.shape[0] / self.halved[0], self.shape[1] / self.halved[1]

    def needed(self, row: int) -> tuple[int, int]:
        """Return the first row of the raster that a row of the overview is made of, and the one after the last."""
        ratio = self.ratio[0]
        if not self.is_averaged:
            middle = int(0.5 + row * ratio)
            return middle, middle + 1
        first, stop = int(row * ratio + EPSILON_CELLS), math.ceil((row + 1) * ratio - EPSILON_CELLS)
        return first, min(stop, self.shape[0])

    def num_ready(self, num_rows: int) -> int:
        """Return how many rows of the overview can be made of the first rows of the raster."""
        most = min(int(num_rows / self.ratio[0]) + 1, self.halved[0])
        return next((row for row in range(most, 0, -1) if self.needed(row - 1)[1] <= num_rows), 0)

    def rows(
        self, values: Shaped[np.ndarray, "part X"], first: int, start: int, stop: int
    ) -> Shaped[np.ndarray, "rows half"]:
        """Return rows of the overview.

        Args:
          values: rows of the raster, all that are `needed`.
          first: the number of their first one.
          start, stop: which rows of the overview.
        """
        if self.is_averaged and self.ratio == (2.0, 2.0):
            return _means_of_four(values[2 * start - first : 2 * stop - first])
        if self.is_averaged:
            return _means(values, first, start, stop, self.halved[1], self.shape[0], *self.ratio)
        rows, cols = (
            (0.5 + numbers * ratio).astype(np.intp)
            for numbers, ratio in zip((np.arange(start, stop), np.arange(self.halved[1])), self.ratio, strict=True)
        )
        return values[(rows - first)[:, None], cols]


@compiled(nogil=True)
def _means_of_four(values):
    """Return the rows of means of all of them, for sides that 2 divides: as `_means` does, without its shares."""
    means = np.empty((values.shape[0] // 2, values.shape[1] // 2), values.dtype)
    for row in range(means.shape[0]):
        for col in range(means.shape[1]):
            total, num = 0.0, 0
            for y in range(2 * row, 2 * row + 2):
                line = 0.0
                for x in range(2 * col, 2 * col + 2):
                    value = values[y, x]
                    is_value = value == value
                    line += np.float64(value) if is_value else 0.0
                    num += is_value
                total += line
            means[row, col] = total / num if num > 0 else np.nan
    return means


@compiled(nogil=True)
def _shares(start, stop, ratio, size):
    """Return the first cell under each of the overview, and the shares of it and of the next two: 0 of one beyond."""
    firsts, shares = np.empty(stop - start, np.int64), np.zeros((MOST_CELLS, stop - start))
    for i in range(stop - start):
        begin, end = (start + i) * ratio, (start + i + 1) * ratio
        first, after = int(begin + EPSILON_CELLS), min(math.ceil(end - EPSILON_CELLS), size)
        firsts[i], last = first, after - first - 1
        shares[: last + 1, i] = 1.0
        shares[last, i] = 1.0 - (after - end)
        shares[0, i] = 1.0 if last == 0 else 1.0 - (begin - first)
    return firsts, shares


@compiled(nogil=True)
def _means(values, first, start, stop, num_cols, num_rows, ratio_y, ratio_x):
    """Return rows of means; a cell that only part of lies under the overview's counts with that part."""
    means = np.empty((stop - start, num_cols), values.dtype)
    rows, row_shares = _shares(start, stop, ratio_y, num_rows)
    cols, col_shares = _shares(0, num_cols, ratio_x, values.shape[1])
    total, weight, end = np.empty(num_cols), np.empty(num_cols), values.shape[1] - 1
    for i in range(stop - start):
        total[:], weight[:] = 0.0, 0.0
        for k in range(MOST_CELLS):
            row_share = row_shares[k, i]
            if row_share == 0.0:
                break
            row = values[rows[i] - first + k]
            for j in range(num_cols):
                line, line_weight = 0.0, 0.0
                for n in range(MOST_CELLS):
                    value, share = np.float64(row[min(cols[j] + n, end)]), col_shares[n, j]
                    is_under = value == value and share > 0.0
                    line += value * share if is_under else 0.0
                    line_weight += share if is_under else 0.0
                total[j] += line * row_share
                weight[j] += line_weight * row_share
        for j in range(num_cols):
            means[i, j] = total[j] / weight[j] if weight[j] > 0.0 else np.nan
    return means
