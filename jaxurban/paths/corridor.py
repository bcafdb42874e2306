"""The cells of a coarse grid that a corridor around a line touches, and the means of a map over them."""

import math
from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.zone import cell_boxes
from jaxurban.world.grid import Grid

MOST_CELLS = 1_000_000  # of a grid around a line


class Cells(NamedTuple):
    """The cells of a grid that a corridor touches. ``C`` of them.

    Attributes:
      grid: around the corridor; its cells begin at multiples of its side in the CRS.
      at: ``[C, 2]`` their rows and columns.
      boxes: ``[C]`` their squares.
    """

    grid: Grid
    at: np.ndarray
    boxes: np.ndarray


def grid_over(crs: str, side_m: float, low_m: np.ndarray, high_m: np.ndarray) -> Grid:
    """Return the grid of the fewest cells, at multiples of their side, over a box from a corner ``[2]`` to another."""
    first_col, first_row = np.floor(low_m / side_m).astype(int).tolist()
    end_col, end_row = np.ceil(high_m / side_m).astype(int).tolist()
    return Grid(crs, side_m, first_row, first_col, end_row - first_row, end_col - first_col)


def cells_within(shape: shapely.Geometry, reach_m: float, side_m: float, grid: Grid) -> Cells:
    """Return the cells of a grid of another side that are within a distance of a line or a box, borders included.

    Raises:
      InputError: more than `MOST_CELLS` around it.
    """
    low_m, high_m = np.reshape(shape.bounds, (2, 2))
    coarse = grid_over(grid.crs, side_m, low_m - reach_m, high_m + reach_m).padded(1, 1, 1, 1)
    num = math.prod(coarse.shape)
    if num > MOST_CELLS:
        raise InputError(
            f"cell_m {side_m:g} makes {num:,} cells around the path or the maps: choose a larger one"
        )
    at = np.argwhere(np.ones(coarse.shape, bool))
    boxes = cell_boxes(coarse, at, 1)
    is_near = shapely.dwithin(boxes, shape, reach_m)
    return Cells(coarse, at[is_near], boxes[is_near])


def cell_means(values: np.ndarray, grid: Grid, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[C]`` the mean of a map over each cell as far as it is known, NaN where nothing is, and known shares.

    Args:
      values: ``[Y, X]`` on ``grid``, NaN where it is not known.
      grid: of the map.
      cells: of another grid in the same CRS.
    """
    coarse = cells.grid
    sums = np.zeros((2, *coarse.shape))
    of_rows = overlaps_m(_edges_m(coarse, 0), _edges_m(grid, 0))
    of_cols = overlaps_m(_edges_m(coarse, 1), _edges_m(grid, 1))
    for number in np.unique(cells.at[:, 0]).tolist():
        rows = np.flatnonzero(of_rows[number])
        strip = values[rows].astype(float)
        is_known = np.isfinite(strip)
        for total, part in zip(sums, (np.where(is_known, strip, 0.0), is_known), strict=True):
            total[number] = of_rows[number, rows] @ part @ of_cols.T
    weighted, known_m2 = sums[:, *cells.at.T]
    means = np.divide(weighted, known_m2, out=np.full(len(known_m2), np.nan), where=known_m2 > 0)
    return means, known_m2 / coarse.resolution_m**2


def overlaps_m(coarse_m: np.ndarray, fine_m: np.ndarray) -> np.ndarray:
    """Return ``[K, F]`` by how much each of K intervals overlaps each of F, from the edges of both, ascending."""
    low_m = np.maximum(coarse_m[:-1, None], fine_m[:-1])
    return (np.minimum(coarse_m[1:, None], fine_m[1:]) - low_m).clip(0.0)


def _edges_m(grid: Grid, axis: int) -> np.ndarray:
    first = (grid.first_row, grid.first_col)[axis]
    return (first + np.arange(grid.shape[axis] + 1)) * grid.resolution_m
