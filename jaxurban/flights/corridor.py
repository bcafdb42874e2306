"""The cells of a coarse grid that a corridor around a line touches, and the means of a map over them."""

import math
from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.errors import InputError
from jaxurban.io.zone import cell_boxes
from jaxurban.world.grid import Grid, covering_grid

MOST_CELLS = 1_000_000  # of a grid around a line


class Cells(NamedTuple):
    """The cells of a grid that a corridor touches. ``C`` of them.

    Attributes:
      grid: around the corridor; its cells begin at multiples of its side in the CRS.
      row_col: ``[C, 2]`` their rows and columns.
      boxes: ``[C]`` their squares.
    """

    grid: Grid
    row_col: np.ndarray
    boxes: np.ndarray


def cells_within(shape: shapely.Geometry, reach_m: float, side_m: float, grid: Grid) -> Cells:
    """Return the cells of a coarse grid that are within a distance of a line or a box, borders included.

    Args:
      shape: the line or box, in the CRS of ``grid``.
      reach_m: the distance.
      side_m: of the coarse grid's cells, which begin at its multiples.
      grid: of the maps, whose CRS is taken.

    Raises:
      InputError: more than `MOST_CELLS` cells in the box around the shape.
    """
    box_m = tuple(np.add(shape.bounds, [-reach_m, -reach_m, reach_m, reach_m]))
    coarse = covering_grid(box_m, side_m, grid.crs)
    coarse = coarse.padded(1, 1, 1, 1)  # for cells that touch the reach with their border
    num = math.prod(coarse.shape)
    if num > MOST_CELLS:
        raise InputError(
            f"cell_m {side_m:g} makes {num:,} cells around the path or the maps: choose a larger one"
        )
    all_cells = np.argwhere(np.ones(coarse.shape, bool))
    boxes = cell_boxes(coarse, all_cells, 1)
    is_near = shapely.dwithin(boxes, shape, reach_m)
    return Cells(coarse, all_cells[is_near], boxes[is_near])


def cell_means(values: np.ndarray, grid: Grid, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of a map over each of ``C`` cells, and the share of the cell's area over which it is known.

    Both are ``[C]``. The mean is over the known area alone, NaN where nothing is known.

    Args:
      values: ``[Y, X]`` on ``grid``, NaN where it is not known.
      grid: of the map.
      cells: of another grid in the same CRS.
    """
    coarse = cells.grid
    integrals = np.zeros(coarse.shape)  # of the known values over each cell
    areas_m2 = np.zeros(coarse.shape)  # over which they are known
    row_overlaps_m = overlaps_m(_edges_m(coarse, 0), _edges_m(grid, 0))
    col_overlaps_m = overlaps_m(_edges_m(coarse, 1), _edges_m(grid, 1))
    for coarse_row in np.unique(cells.row_col[:, 0]).tolist():
        rows = np.flatnonzero(row_overlaps_m[coarse_row])
        heights_m = row_overlaps_m[coarse_row, rows]
        strip = values[rows].astype(float)
        is_known = np.isfinite(strip)
        integrals[coarse_row] = heights_m @ np.where(is_known, strip, 0.0) @ col_overlaps_m.T
        areas_m2[coarse_row] = heights_m @ is_known @ col_overlaps_m.T
    integral, known_m2 = integrals[*cells.row_col.T], areas_m2[*cells.row_col.T]
    means = np.divide(integral, known_m2, out=np.full(len(known_m2), np.nan), where=known_m2 > 0)
    return means, known_m2 / coarse.resolution_m**2


def overlaps_m(coarse_m: np.ndarray, fine_m: np.ndarray) -> np.ndarray:
    """Return ``[K, F]`` the length that each of K coarse intervals shares with each of F fine ones, 0 where none.

    Args:
      coarse_m, fine_m: ``[K + 1]`` and ``[F + 1]`` the edges of neighbouring intervals, ascending.
    """
    low_m = np.maximum(coarse_m[:-1, None], fine_m[:-1])
    return (np.minimum(coarse_m[1:, None], fine_m[1:]) - low_m).clip(0.0)


def _edges_m(grid: Grid, axis: int) -> np.ndarray:
    """Return the edges of a grid's rows (axis 0, northings) or columns (axis 1, eastings), ascending."""
    first = (grid.first_row, grid.first_col)[axis]
    return (first + np.arange(grid.shape[axis] + 1)) * grid.resolution_m
