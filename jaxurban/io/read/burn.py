"""Polygons burnt into the cells of a grid."""

from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.io.read.near import meets
from jaxurban.kernels.outlines import burn_outlines
from jaxurban.world.grid import Grid


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
    centre = np.full(grid.shape, fill, dtype)
    _burn(polygons, values, grid, boxes_m, centre, np.empty((0, 0), dtype))
    return centre


def burn_touched(
    polygons: np.ndarray, values: np.ndarray, grid: Grid, fill: float, dtype: str, *, boxes_m: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return what `burn` does, and the highest value among the polygons that share area with each cell.

    A polygon that ends on a border of cells does not touch the next one. GDAL's ``all_touched`` is not used: it
    misses cells that an edge enters by less than a hundredth of a side, along up to a whole side.

    Args:
      polygons, values, grid, fill, dtype, boxes_m: as there.
    """
    centre, touched = (np.full(grid.shape, fill, dtype) for _ in range(2))
    _burn(polygons, values, grid, boxes_m, centre, touched)
    return centre, np.maximum(centre, touched, out=touched)


def burn_by_rule(
    polygons: np.ndarray, heights_m: np.ndarray, grid: Grid, all_touched: bool, *, boxes_m: np.ndarray | None = None
) -> np.ndarray:
    """Return heights burnt by centres or, ``all_touched``, by touch, float32, 0 where no polygon is."""
    if all_touched:
        return burn_touched(polygons, heights_m, grid, 0.0, "float32", boxes_m=boxes_m)[1]
    return burn(polygons, heights_m, grid, 0.0, "float32", boxes_m=boxes_m)


def _burn(
    polygons: np.ndarray,
    values: np.ndarray,
    grid: Grid,
    boxes_m: np.ndarray | None,
    centre: np.ndarray,
    touched: np.ndarray,
) -> None:
    """Burn the polygons whose box meets the grid, in place."""
    boxes = shapely.bounds(polygons) if boxes_m is None else boxes_m.T
    near = np.flatnonzero(meets(boxes, grid.bounds_m))
    if near.size:
        rings = _rings_of(polygons[near])
        burn_outlines(
            rings.points / grid.resolution_m,
            rings.ring_start,
            rings.outline_start,
            values[near].astype(centre.dtype)[rings.polygon],
            grid.first_row,
            grid.first_col,
            centre,
            touched,
        )


class _Rings(NamedTuple):
    """Polygons as flat arrays. ``P`` corners of ``R`` rings of ``N`` outlines, each an exterior ring and its holes.

    Attributes:
      points: ``[P, 2]`` x, y.
      ring_start: ``[R + 1]`` where each ring begins in ``points``, and the end.
      outline_start: ``[N + 1]`` where each outline begins in the rings, and the end.
      polygon: ``[N]`` number of the polygon that each outline is, or is a part of.
    """

    points: np.ndarray
    ring_start: np.ndarray
    outline_start: np.ndarray
    polygon: np.ndarray


def _rings_of(polygons: np.ndarray) -> _Rings:
    """Return the rings of polygons, those with a single ring first.

    `shapely.to_ragged_array` makes a geometry of every ring, which takes ten times as long.
    """
    is_single = shapely.get_type_id(polygons) == shapely.GeometryType.POLYGON
    is_single &= shapely.get_num_interior_rings(polygons) == 0
    single, others = np.flatnonzero(is_single), np.flatnonzero(~is_single)
    parts, owner = shapely.get_parts(polygons[others], return_index=True)
    rings, outline = shapely.get_rings(parts, return_index=True)
    both = polygons[single], rings
    num_rings = np.append(np.ones(len(single), np.int64), np.bincount(outline, minlength=len(parts)))
    return _Rings(
        points=np.concatenate([shapely.get_coordinates(shapes) for shapes in both]),
        ring_start=_starts(np.concatenate([shapely.get_num_coordinates(shapes) for shapes in both])),
        outline_start=_starts(num_rings),
        polygon=np.append(single, others[owner]),
    )


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return where each of ``[N]`` runs begins, and the end, ``[N + 1]`` int64."""
    return np.append(0, np.cumsum(counts, dtype=np.int64))
