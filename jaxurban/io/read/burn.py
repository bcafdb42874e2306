"""Polygons burnt into the cells of a grid, and what hangs over the ground into their subcells, sparse: `Slabs`."""

import math

import numpy as np
import shapely

from jaxurban.io.read.outlines import meets
from jaxurban.kernels.outlines import burn_outlines, settle
from jaxurban.world.city import Buildings
from jaxurban.world.grid import Grid
from jaxurban.world.surface import PER_CELL, Slabs


def burn(
    polygons: np.ndarray, values: np.ndarray, grid: Grid, fill: float, dtype: str, *, boxes_m: np.ndarray | None = None
) -> np.ndarray:
    """Return ``values`` burnt at the cells whose centre lies in ``polygons``, the highest value where they overlap.

    Every cell depends on its own place alone: a part of a grid is burnt as the whole is. Threads may burn at once.

    Args:
      polygons: ``[N]`` shapely Polygons and MultiPolygons in the grid's CRS.
      values: ``[N]`` numbers, none below ``fill``.
      grid: where to burn.
      fill: value of cells that no polygon holds.
      dtype: of the result.
      boxes_m: ``[4, N]`` x_min, y_min, x_max, y_max of the polygons, from those who keep them; left out, computed.

    Returns:
      ``[Y, X]`` array of ``dtype``, row 0 in the south.
    """
    return burn_touched(polygons, values, grid, fill, dtype, boxes_m=boxes_m, has_touched=False)[0]


def burn_touched(
    polygons: np.ndarray,
    values: np.ndarray,
    grid: Grid,
    fill: float,
    dtype: str,
    *,
    boxes_m: np.ndarray | None = None,
    has_touched: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what `burn` does, and the highest value among the polygons that share area with each cell.

    A polygon that ends on a border of cells does not touch the next one. GDAL's ``all_touched`` is not used: it
    misses cells that an edge enters by less than a hundredth of a side, along up to a whole side.

    Args:
      polygons, values, grid, fill, dtype, boxes_m: as there.
      has_touched: False leaves the second array empty.
    """
    centre, touched = (np.full(shape, fill, dtype) for shape in (grid.shape, grid.shape if has_touched else (0, 0)))
    boxes = shapely.bounds(polygons) if boxes_m is None else boxes_m.T
    near = np.flatnonzero(meets(boxes, grid.bounds_m))
    if not near.size:
        return centre, touched
    # Rings on their own come first: `shapely.to_ragged_array` makes a geometry of every ring, in ten times the time.
    is_single = shapely.get_type_id(polygons[near]) == shapely.GeometryType.POLYGON
    is_single &= shapely.get_num_interior_rings(polygons[near]) == 0
    single, others = near[is_single], near[~is_single]
    parts, owner = shapely.get_parts(polygons[others], return_index=True)
    rings, outline = shapely.get_rings(parts, return_index=True)
    both = polygons[single], rings
    num_rings = np.append(np.ones(len(single), np.int64), np.bincount(outline, minlength=len(parts)))
    burn_outlines(
        np.concatenate([shapely.get_coordinates(shapes) for shapes in both]) / grid.resolution_m,
        _starts(np.concatenate([shapely.get_num_coordinates(shapes) for shapes in both])),
        _starts(num_rings),
        values[np.append(single, others[owner])].astype(centre.dtype),
        grid.first_row,
        grid.first_col,
        centre,
        touched,
    )
    return centre, np.maximum(centre, touched, out=touched) if has_touched else touched


def burn_by_rule(
    polygons: np.ndarray, heights_m: np.ndarray, grid: Grid, all_touched: bool, *, boxes_m: np.ndarray | None = None
) -> np.ndarray:
    """Return heights burnt by centres or, ``all_touched``, by touch, float32, 0 where no polygon is."""
    if all_touched:
        return burn_touched(polygons, heights_m, grid, 0.0, "float32", boxes_m=boxes_m)[1]
    return burn(polygons, heights_m, grid, 0.0, "float32", boxes_m=boxes_m)


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return where each of ``[N]`` runs begins, and the end, ``[N + 1]`` int64."""
    return np.append(0, np.cumsum(counts, dtype=np.int64))


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
