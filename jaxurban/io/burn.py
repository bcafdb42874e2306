"""Outlines burnt into the cells of a grid."""

import math

import numpy as np
import shapely

from jaxurban.world.extent import meets
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import Grid

# Below all real ground: what stands where the terrain is unknown shadows nothing.
UNKNOWN_GROUND_M = -500.0


def burn(
    polygons: np.ndarray,
    values: np.ndarray,
    grid: Grid,
    fill: float,
    dtype: str,
    *,
    boxes_m: np.ndarray | None = None,
    has_touched: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``values`` burnt at the cells whose centre lies in ``polygons``, and at those that share area with them.

    Of polygons that overlap the highest value counts. Every cell depends on its own place alone: a part of a grid is
    burnt as the whole is. Threads may burn at once. A polygon that ends on a border of cells does not touch the next
    one. GDAL's ``all_touched`` is not used: it misses cells that an edge enters by less than a hundredth of a side,
    along up to a whole side.

    Args:
      polygons: ``[N]`` shapely Polygons and MultiPolygons in the grid's CRS.
      values: ``[N]`` numbers, none below ``fill``.
      grid: where to burn.
      fill: value of cells that no polygon holds; not below 0 for floats.
      dtype: of the result, ``"int32"`` or ``"float32"``.
      boxes_m: ``[4, N]`` x_min, y_min, x_max, y_max of the polygons, from those who keep them; left out, computed.
      has_touched: False leaves the second array empty.

    Returns:
      Two ``[Y, X]`` arrays of ``dtype``, row 0 in the south.
    """
    from jaxurban.kernels.outlines import burn_outlines  # imported here: it brings Numba

    # Only polygons whose boxes touch the grid's are burnt.
    centre = np.full(grid.shape, fill, dtype)
    touched = np.full(grid.shape if has_touched else (0, 0), fill, dtype)
    boxes = shapely.bounds(polygons) if boxes_m is None else boxes_m.T
    near = np.flatnonzero(meets(boxes, grid.bounds_m))
    if not near.size:
        return centre, touched
    # The most cells that an edge crosses, and that lie in the box of an outline with two more on each side.
    x_min, y_min, x_max, y_max = boxes[near].T / grid.resolution_m
    width, height = x_max - x_min + 4, y_max - y_min + 4
    most_parts = math.ceil(np.max(width + height))
    most_cells = np.max(np.minimum(width, grid.num_cols) * np.minimum(height, grid.num_rows))

    # The rings of all parts, those of polygons of one ring first: `shapely.to_ragged_array` makes a geometry of every
    # ring, in ten times the time.
    is_single = shapely.get_type_id(polygons[near]) == shapely.GeometryType.POLYGON
    is_single &= shapely.get_num_interior_rings(polygons[near]) == 0
    single = near[is_single]
    others = near[~is_single]
    parts, owner = shapely.get_parts(polygons[others], return_index=True)
    rings, outline = shapely.get_rings(parts, return_index=True)
    lines = np.append(polygons[single], rings)
    num_rings = np.bincount(outline, minlength=len(parts))  # of each part

    # Coordinates in cells, where each ring begins in them, where each part begins in the rings, and each part's value:
    # int32 for all, of which Numba compiles one form, as the bits of floats from 0 on have the floats' order.
    burn_outlines(
        shapely.get_coordinates(lines) / grid.resolution_m,
        _starts(shapely.get_num_coordinates(lines)),
        _starts(np.append(np.ones(len(single), np.int64), num_rings)),
        values[np.append(single, others[owner])].astype(dtype).view(np.int32),
        grid.first_row,
        grid.first_col,
        centre.view(np.int32),
        touched.view(np.int32),
        np.zeros(math.ceil(most_cells), bool),
        np.empty(most_parts, np.int64),
        np.empty(most_parts, np.int64),
        np.empty(most_parts),
    )
    if has_touched:
        np.maximum(centre, touched, out=touched)
    return centre, touched


def burn_heights(
    buildings: Footprints, grid: Grid, has_touched: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return roofs by centres and by touch (see `burn`), ``[Y, X]`` float32 metres each, 0 without a building."""
    return burn(
        buildings.polygons,
        buildings.height_m,
        grid,
        0.0,
        "float32",
        boxes_m=buildings.boxes_m,
        has_touched=has_touched,
    )


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return where each of ``[N]`` runs begins, and the end, ``[N + 1]`` int64."""
    return np.append(0, np.cumsum(counts, dtype=np.int64))
