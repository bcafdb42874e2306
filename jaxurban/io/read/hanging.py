"""What hangs over the ground, burnt into the subcells of a grid, sparse: `Slabs`."""

import math

import numpy as np

from jaxurban.io.read.burn import burn_by_rule
from jaxurban.io.read.near import meets
from jaxurban.kernels.slabs import settle
from jaxurban.world.city import Buildings
from jaxurban.world.grid import Grid
from jaxurban.world.slabs import PER_CELL, Slabs


def burn_hanging(
    buildings: Buildings, grid: Grid, roof_m: np.ndarray, terrain_m: np.ndarray | None, all_touched: bool
) -> Slabs:
    """Return what hangs freely over the cells of a grid; what rests on a roof raises it.

    A slab covers subcells, and cells, as a roof does: those whose centre lies in its outline (``all_touched``: every
    one that it shares area with). Every cell depends on its own place alone.

    Args:
      buildings: of which those with an underside above the ground hang.
      grid: where to burn.
      roof_m: ``[Y, X]`` float32 roofs of those that stand; raised in place.
      terrain_m: ``[Y, X]`` elevation of the ground; None for flat ground.
      all_touched: see above.
    """
    is_near = meets(buildings.boxes_m.T, grid.bounds_m)
    finer = grid.refined(PER_CELL)
    places, heights = [np.empty((2, 0), np.int64)], [np.empty((2, 0), np.float32)]
    for i in np.flatnonzero(is_near & (buildings.min_height_m > 0)):
        window = _window(finer, buildings.boxes_m[:, i])
        held = np.stack(np.nonzero(burn_by_rule(buildings.polygons[i : i + 1], np.ones(1), window, all_touched)))
        places.append(held + np.array([[window.first_row], [window.first_col]]))
        of_one = np.array([[buildings.min_height_m[i]], [buildings.height_m[i]]], np.float32)
        heights.append(np.broadcast_to(of_one, held.shape))
    (row, col), (floor_m, top_m) = (np.concatenate(values, axis=1) for values in (places, heights))
    cell = (row // PER_CELL - grid.first_row) * grid.num_cols + col // PER_CELL - grid.first_col
    order = np.lexsort((floor_m, cell))
    row, col, cell, floor_m, top_m = (values[order] for values in (row, col, cell, floor_m, top_m))
    is_of_cell = (row % PER_CELL == PER_CELL // 2) & (col % PER_CELL == PER_CELL // 2) | all_touched
    hangs = settle(roof_m.reshape(-1), cell, floor_m, top_m, is_of_cell)
    ground_m = np.zeros(len(cell), np.float32) if terrain_m is None else terrain_m.reshape(-1)[cell]
    return Slabs(row, col, floor_m, top_m, ground_m, is_of_cell).take(hangs)


def _window(grid: Grid, box_m: np.ndarray) -> Grid:
    """Return the part of a grid around a box, which meets it, with a cell more on each side."""
    west, south, east, north = box_m / grid.resolution_m
    first_row = max(math.floor(south) - 1, grid.first_row)
    first_col = max(math.floor(west) - 1, grid.first_col)
    end_row = min(math.ceil(north) + 1, grid.first_row + grid.num_rows)
    end_col = min(math.ceil(east) + 1, grid.first_col + grid.num_cols)
    return Grid(grid.crs, grid.resolution_m, first_row, first_col, end_row - first_row, end_col - first_col)
