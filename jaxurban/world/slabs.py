"""Slabs: what hangs over the ground (bridge decks, parts of buildings above an underside), sparse, in finer cells."""

from typing import NamedTuple

import numpy as np

from jaxurban.world.grid import Grid

# Subcells of a cell along a side, odd, so that one has the cell's centre. Against Embree, under a deck 18 m wide and
# 12 m up, at 2 m cells (tests/metrics/test_slabs_embree.py): 1 makes 93.6 % of the answers right at worst, 3 97.7 %, 5
# 98.4 %, in twice the time of 3.
PER_CELL = 5


class Slabs(NamedTuple):
    """What hangs over the ground, from floor to top. ``H`` slabs, each over one subcell; several may hang over one.

    Nothing that rests on a roof is one: it is a part of that roof.

    Attributes:
      row, col: ``[H]`` int64 subcell of each, counted from the CRS's origin in sides of `PER_CELL` to a cell.
      floor_m: ``[H]`` float32 height of the underside above the ground of its cell, above the cell's roof.
      top_m: ``[H]`` float32 height of the top above the ground of its cell.
      ground_m: ``[H]`` float32 elevation of that ground; 0 where the ground is flat.
      is_of_cell: ``[H]`` bool: it hangs over the whole cell for all but shadows, by the rule of roofs.
    """

    row: np.ndarray
    col: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    ground_m: np.ndarray
    is_of_cell: np.ndarray

    @classmethod
    def joined(cls, parts: list["Slabs"]) -> "Slabs":
        """Return the slabs of several grids that share no cell."""
        return cls(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def take(self, index: np.ndarray) -> "Slabs":
        """Return the slabs at ``index`` (integers or a mask)."""
        return Slabs(*(values[index] for values in self))

    def over_cells(self, grid: Grid) -> tuple["Slabs", tuple[np.ndarray, np.ndarray]]:
        """Return the slabs that hang over whole cells of a grid, and row and column of each there."""
        row, col = self.row // PER_CELL - grid.first_row, self.col // PER_CELL - grid.first_col
        inside = self.is_of_cell & (row >= 0) & (row < grid.num_rows) & (col >= 0) & (col < grid.num_cols)
        return self.take(inside), (row[inside], col[inside])

    def lowest_floors(self, grid: Grid) -> np.ndarray:
        """Return the height of the lowest underside over each cell of a grid, float32, 0 where nothing hangs."""
        here, cells = self.over_cells(grid)
        floors_m = np.full(grid.shape, np.inf, np.float32)
        np.minimum.at(floors_m, cells, here.floor_m)
        return np.where(np.isinf(floors_m), np.float32(0), floors_m)

    def raised(self, roof_m: np.ndarray, grid: Grid) -> np.ndarray:
        """Return the roofs of a grid's cells, ``[Y, X]``, with these slabs as if they reached the ground."""
        here, cells = self.over_cells(grid)
        raised_m = np.array(roof_m)
        np.maximum.at(raised_m, cells, here.top_m.astype(raised_m.dtype))
        return raised_m
