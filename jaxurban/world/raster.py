"""A raster as a file holds it: on its own grid, in its own CRS."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Raster:
    """A single-band raster read from a file, north-up, on its own grid and CRS.

    Attributes:
      values: ``[R, C]`` float32, row 0 in the north, NaN where the file declares no data.
      transform: affine coefficients (a, b, c, d, e, f): x = a * col + b * row + c, y = d * col + e * row + f,
        with the file's own row and col.
      crs: the raster's CRS.
      first_row, first_col: the file's row and column of ``values[0, 0]``. A window keeps the file's transform, so
        that a pixel's place does not depend on the window by rounding.
    """

    values: np.ndarray
    transform: tuple[float, float, float, float, float, float]
    crs: str
    first_row: int = 0
    first_col: int = 0
