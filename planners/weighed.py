"""What the cells of a map cost under its weights, weighed part by part, as searches come to them."""

import math
import threading

import numpy as np

from jaxurban.kernels.search.tiles import PART, TILE, weigh_part
from jaxurban.kernels.search.weighing import in_rows, weigh_rows

_MAKING = threading.Lock()  # one for all maps: a lock of a map's own would keep problems from being sent to processes


class WeighedMap:
    """The costs of a map of one altitude under its weights, of which some parts may not be made yet.

    A part is a rectangle of `PART` cells. Once made, what its cells and those around it cost is there, and its tiles.
    All searches on the map share it, in threads too: what one of them may read it learns by `readiness`.

    Attributes:
      cost: ``[Y, X]`` float64, read-only; anything in parts that are not made.
      minima: ``[I + 2, J + 2]`` float64 each tile's cheapest free cell, read-only: NaN where it is not known yet, inf
        where there is none, and in the frame (see `kernels.search.tiles`).
    """

    def __init__(self, layers: np.ndarray, weights: np.ndarray, is_free: np.ndarray) -> None:
        self._layers, self._weights, self._is_free = in_rows(layers), weights, is_free
        self._cost = np.empty(is_free.shape)
        self._minima = np.full([(size - 1) // TILE + 3 for size in is_free.shape], np.inf)
        self._minima[1:-1, 1:-1] = np.nan
        self._is_made = np.zeros(
            [math.ceil(size / side) for size, side in zip(is_free.shape, PART, strict=True)], np.bool_
        )
        self.cost, self.minima = self._cost.view(), self._minima.view()
        self.cost.flags.writeable = self.minima.flags.writeable = False

    def make(self, part: tuple[int, int]) -> None:
        """Weigh a part (row and column among parts) and find what its tiles cost."""
        with _MAKING:
            weigh_part(self._layers, self._weights, self._is_free, *part, self._cost, self._minima)
            self._is_made[part] = True

    def readiness(self) -> np.ndarray:
        """Return ``[P, Q]`` bool, a copy: the parts whose costs may be read."""
        with _MAKING:
            return self._is_made.copy()

    def whole(self) -> np.ndarray:
        """Return ``[Y, X]`` the costs of all cells; tiles are left as they are."""
        with _MAKING:
            if not self._is_made.all():
                weigh_rows(self._layers, self._weights, self._cost)
                self._is_made[:] = True
        return self.cost
