"""Where a source of buildings knows what stands: coverage is read from where data are, not from the box around them."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely

from jaxurban.io.read.sampling import pixel_xy
from jaxurban.world.city import City, Raster
from jaxurban.world.grid import Bounds, Grid

GAP_M = 500.0  # side of the bins: buildings in bins that touch know what lies between them (streets, parks, rivers)
BLOCKS_A_SIDE = 64  # into which a raster with holes is cut
MOST_RAYS = 200_000  # followed to tell how many leave the data: a second or so


def area_of_outlines(polygons: np.ndarray, boxes: Sequence[Bounds]) -> shapely.Geometry:
    """Return the area that a file of outlines knows: the boxes that it declares, and a box around each settlement.

    A building far off has a box of its own, and does not make the land between known.

    Args:
      polygons: ``[N]`` the outlines.
      boxes: what the file declares to cover.
    """
    declared = shapely.union_all([shapely.box(*box) for box in boxes])
    is_inside, is_apart = shapely.covers(declared, polygons), ~shapely.intersects(declared, polygons)
    on_border = shapely.box(*shapely.bounds(polygons[~is_inside & ~is_apart]).T)
    declared = shapely.union_all([declared, *on_border])
    bounds = shapely.bounds(polygons[is_apart])
    if not len(bounds):
        return declared
    centre = (bounds[:, :2] + bounds[:, 2:]) / 2
    col, row = np.floor(centre / GAP_M).astype(np.int64).T
    _, first, owner = np.unique(col * 2**32 + row, return_index=True, return_inverse=True)
    low = np.stack([col[first], row[first]], axis=1) * GAP_M
    # Grown by a little, so that bins that touch at a corner are joined.
    grown = shapely.box(*(low - 1.0).T, *(low + GAP_M + 1.0).T)
    parts = shapely.get_parts(shapely.union_all(grown))
    part_of_bin = np.empty(len(low), int)
    found_bin, found_part = shapely.STRtree(parts).query(shapely.points(low + GAP_M / 2), predicate="within")
    part_of_bin[found_bin] = found_part
    hulls = pd.DataFrame(bounds).groupby(part_of_bin[owner]).agg({0: "min", 1: "min", 2: "max", 3: "max"})
    return shapely.union_all([declared, *shapely.box(*hulls.to_numpy().T)])


def area_of_raster(raster: Raster, crs: str) -> shapely.Geometry:
    """Return the area in ``crs`` where a raster holds data, in blocks."""
    num_rows, num_cols = raster.values.shape
    is_known = np.isfinite(raster.values)
    if is_known.all():
        shapes = [shapely.box(0, 0, num_cols, num_rows)]
    else:
        row, col = (np.unique(np.linspace(0, size, BLOCKS_A_SIDE + 1).astype(int)) for size in (num_rows, num_cols))
        has_any = np.logical_or.reduceat(np.logical_or.reduceat(is_known, row[:-1], axis=0), col[:-1], axis=1)
        i, j = np.nonzero(has_any)
        shapes = [shapely.union_all(shapely.box(col[j], row[i], col[j + 1], row[i + 1]))]
    area = shapely.segmentize(shapes[0], max(num_rows, num_cols) / BLOCKS_A_SIDE)
    return shapely.transform(area, lambda x, y: pixel_xy(raster, y, x, crs), interleaved=False)


def rays_leaving(city: City, region: Grid, east_m: np.ndarray, north_m: np.ndarray) -> np.ndarray:
    """Return which rays leave the place where buildings and terrain are known, ``[N, K]`` bool.

    Args:
      city: whose data are known.
      region: rays start at N of its cells' centres, evenly spread: all of them, or as many as make `MOST_RAYS`.
      east_m, north_m: ``[K]`` how far each ray runs.
    """
    known = city.known_area
    if city.terrain_extent_m is not None:
        known = shapely.intersection(known, shapely.box(*city.terrain_extent_m))
    shapely.prepare(known)
    stride = math.ceil(math.sqrt(region.num_rows * region.num_cols * max(len(east_m), 1) / MOST_RAYS))
    x_m, y_m = np.meshgrid(*(at_m[min(stride, len(at_m)) // 2 :: stride] for at_m in (region.x_m, region.y_m)))
    start_m = np.stack([x_m.ravel(), y_m.ravel()], axis=-1)[:, None]
    rays = np.stack(np.broadcast_arrays(start_m, start_m + np.stack([east_m, north_m], axis=-1)), axis=-2)
    stays = np.zeros(rays.shape[:2], bool)
    for part in shapely.get_parts(known):
        if shapely.equals(part, box := shapely.box(*part.bounds)):  # convex: both ends tell, without a geometry a ray
            stays |= ((rays >= box.bounds[:2]) & (rays <= box.bounds[2:])).all(axis=(2, 3))
    stays[~stays] = shapely.covers(known, shapely.linestrings(rays[~stays]))
    return ~stays
