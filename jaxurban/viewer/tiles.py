"""Maps as the page gets them: tiles of a pyramid, and polynomials for the longitude and latitude of any place.

At stride n it gets every n-th cell, the middle one of n x n, as it is.
"""

import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from operator import attrgetter
from threading import Lock
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.world.grid import Grid

TILE = 256  # cells a side of a tile
MOST_BYTES = 256 * 2**20  # of layers that are kept
LEVEL = 4  # of deflating: tiles have a fifth less than at level 1, and some milliseconds more
DEGREE, NUM_FITTED = 4, 17  # of the polynomials, and places a side that they are fitted to


def strides_of(shape: tuple[int, int]) -> list[int]:
    """Return the strides 1, 2, 4 ... up to the first at which the whole map is one tile."""
    strides = [1]
    while max(shape) > TILE * strides[-1]:
        strides.append(2 * strides[-1])
    return strides


def middles(size: int, stride: int) -> np.ndarray:
    """Return the cells ``[ceil(size / stride)]`` that stand for runs of ``stride``: the middle ones, or the last."""
    return np.minimum(np.arange(0, size, stride) + stride // 2, size - 1)


def packed_tile(values: np.ndarray, stride: int, row: int, col: int) -> bytes:
    """Return a tile of a layer as `packed` numbers: up to `TILE` rows, from the south, of as many cells.

    Args:
      values: ``[Y, X]`` the layer.
      stride: the tile has every n-th cell of the layer.
      row, col: number of the tile, from 0 in the southwest.

    Raises:
      InputError: there is no such stride or tile.
    """
    strides = strides_of(values.shape)
    if stride not in strides:
        raise InputError(f"stride must be one of {', '.join(map(str, strides))}, got {stride}")
    num_rows, num_cols = values.shape
    rows = middles(num_rows, stride)[row * TILE :][:TILE]
    cols = middles(num_cols, stride)[col * TILE :][:TILE]
    if min(row, col) < 0 or not (rows.size and cols.size):
        raise InputError(
            f"there is no tile {row}, {col} at stride {stride}: tiles are numbered from 0"
        )
    return packed(values[np.ix_(rows, cols)])


def packed(values: np.ndarray) -> bytes:
    """Return numbers as the deflated bytes of float32, little-endian.

    The four bytes of a number lie apart, all first ones, all second ones, and so on, which deflates to two thirds.
    """
    numbers = np.ascontiguousarray(values, "<f4")
    return zlib.compress(numbers.view(np.uint8).reshape(-1, 4).T.tobytes(), LEVEL)


def lonlat_fit(grid: Grid) -> dict[str, np.ndarray]:
    """Return the longitude and the latitude of places on a grid as polynomials, fitted by least squares.

    They are polynomials of u and v, which go from -1 at the west and south border to 1 at the east and north border.

    Returns:
      ``powers``, ``[P, 2]`` of u and v in each term; ``lon`` and ``lat``, ``[P]`` its coefficients in degrees.
    """
    # All terms up to `DEGREE`, and the places that they are fitted to.
    powers = np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
    line = np.linspace(-1, 1, NUM_FITTED)
    uv = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    low_m, high_m = np.reshape(grid.bounds_m, (2, 2))  # x and y at the southwest and northeast
    lonlat = grid.lonlat_at((low_m + high_m) / 2 + uv * (high_m - low_m) / 2)

    # The value of each term at each place, and the coefficients of the terms.
    terms = np.prod(uv[:, None] ** powers, axis=-1)
    lon, lat = np.linalg.lstsq(terms, lonlat, rcond=None)[0].T
    return {"powers": powers, "lon": lon, "lat": lat}


class Kept:
    """Things that were made, of which those used last are kept, up to a sum of their sizes. Threads may share it.

    Attributes:
      most: the largest sum of sizes; the thing that was asked for last is kept even if it is larger.
      size_of: returns the size of one thing; left out, the bytes of an array.
    """

    def __init__(
        self, most: int = MOST_BYTES, size_of: Callable[[Any], int] = attrgetter("nbytes")
    ) -> None:
        self.most, self.size_of = most, size_of
        self._held: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return what is kept under a key; what is not kept is made by ``make``, while other threads wait.

        What was not used for the longest time is forgotten where all is too much.
        """
        with self._lock:
            if key not in self._held:
                self._held[key] = make()
            self._held.move_to_end(key)
            while len(self._held) > 1 and self.size > self.most:
                self._held.popitem(last=False)
            return self._held[key]

    @property
    def size(self) -> int:
        """Sum of the sizes of what is kept."""
        return sum(map(self.size_of, self._held.values()))
