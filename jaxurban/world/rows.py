"""Columns of equal length beside polygons: the base of footprints and census blocks."""

from dataclasses import fields
from functools import cached_property
from typing import Self

import numpy as np
import shapely


class Rows:
    """Columns of equal length, one a field; ``polygons`` is one of them."""

    polygons: np.ndarray

    def __len__(self) -> int:
        return len(self.polygons)

    @cached_property
    def boxes_m(self) -> np.ndarray:
        """``[4, N]`` x_min, y_min, x_max, y_max of each polygon, kept as each tile looks for the polygons near it."""
        return np.ascontiguousarray(shapely.bounds(self.polygons).T)

    def take(self, index: np.ndarray) -> Self:
        """Return the rows at ``index`` (integers or a mask)."""
        columns = (getattr(self, column.name) for column in fields(self))  # type: ignore[arg-type]
        return type(self)(*(None if column is None else column[index] for column in columns))
