"""Columns of equal length beside polygons: the base of footprints and census blocks."""

from dataclasses import fields
from functools import cached_property
from typing import Self

import numpy as np
import shapely

from jaxurban.world.grid import Bounds


class Rows:
    """Columns of equal length, one a field; ``polygons`` is one of them."""

    polygons: np.ndarray

    def __len__(self) -> int:
        return len(self.polygons)

    @cached_property
    def boxes_m(self) -> np.ndarray:
        """``[4, N]`` x_min, y_min, x_max, y_max of each polygon, kept as each tile looks for the polygons near it."""
        return np.ascontiguousarray(shapely.bounds(self.polygons).T)

    def touches(self, bounds_m: Bounds) -> np.ndarray:
        """Return ``[N]`` bool: which rows touch the box x_min, y_min, x_max, y_max of the CRS."""
        return shapely.intersects(self.polygons, shapely.box(*bounds_m))

    def inside(self, bounds_m: Bounds) -> Self:
        """Return the rows that touch a box, as of `touches`."""
        return self.take(self.touches(bounds_m))

    def take(self, index: np.ndarray) -> Self:
        """Return the rows at ``index`` (integers or a mask)."""
        columns = (getattr(self, column.name) for column in fields(self))  # type: ignore[arg-type]
        return type(self)(*(None if column is None else column[index] for column in columns))
