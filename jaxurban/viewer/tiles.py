"""Layers cut into tiles of a pyramid: at stride n the page gets every n-th cell, the middle one of n x n, as it is."""

import zlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock

import numpy as np

from jaxurban.errors import InputError

TILE = 256  # cells a side of a tile
MOST_BYTES = 256 * 2**20  # of layers that are kept


def strides_of(shape: tuple[int, int]) -> list[int]:
    """Return the strides 1, 2, 4 ... up to the first at which the whole map is one tile."""
    strides = [1]
    while max(shape) > TILE * strides[-1]:
        strides.append(2 * strides[-1])
    return strides


def middles(size: int, stride: int) -> np.ndarray:
    """Return the cells ``[ceil(size / stride)]`` that stand for runs of ``stride``: the middle ones, or the last."""
    return np.minimum(np.arange(0, size, stride) + stride // 2, size - 1)


def tile_bytes(values: np.ndarray, stride: int, row: int, col: int) -> bytes:
    """Return a tile of a layer ``[Y, X]`` float32, rows from the south: its bytes by significance, deflated.

    The four bytes of a number lie apart, all first ones, all second ones, and so on (little-endian), which deflates to
    two thirds.

    Raises:
      InputError: no such tile.
    """
    if stride not in strides_of(values.shape):
        raise InputError(f"stride must be one of {', '.join(map(str, strides_of(values.shape)))}, got {stride}")
    rows, cols = (
        middles(size, stride)[at * TILE : (at + 1) * TILE] if at >= 0 else np.empty(0, int)
        for size, at in zip(values.shape, (row, col), strict=True)
    )
    if not (rows.size and cols.size):
        raise InputError(f"there is no tile {row}, {col} at stride {stride}: tiles are numbered from 0")
    cells = np.ascontiguousarray(values[np.ix_(rows, cols)], "<f4")
    return zlib.compress(cells.view(np.uint8).reshape(-1, 4).T.tobytes(), 1)


class Kept:
    """Arrays that were made, the latest used ones up to a number of bytes; several threads may ask.

    Attributes:
      most_bytes: what all of them may take; the one asked for last is always kept.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most_bytes = most_bytes
        self._held: OrderedDict[Hashable, np.ndarray] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the array of a key, made by ``make`` if it is not here; no two are made at once."""
        with self._lock:
            if key not in self._held:
                self._held[key] = make()
            self._held.move_to_end(key)
            while len(self._held) > 1 and self.num_bytes > self.most_bytes:
                self._held.popitem(last=False)
            return self._held[key]

    @property
    def num_bytes(self) -> int:
        """How much is kept."""
        return sum(array.nbytes for array in self._held.values())
