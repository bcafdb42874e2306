"""Rasters of people: every pixel, with the people who live in it, is a census block."""

from pathlib import Path

import numpy as np
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.raster import open_raster, raster_window
from jaxurban.io.read.sampling import pixel_xy
from jaxurban.world.city import Raster
from jaxurban.world.grid import Bounds

PEOPLE = "people in each pixel"


def read_people(
    path: str | Path, crs: str, bounds_m: Bounds | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels of a raster of people as polygons in ``crs``, with their people and their ids.

    WorldPop, GHSL and LandScan give such rasters. Pixels that share a corner share it in ``crs`` too, so that they
    cover the ground without gap or overlap, and nobody is lost or counted twice. Pixels without data are left out.

    Args:
      path: a single-band file whose name ends as in `DRIVERS`, with a CRS; values are counts of people, not densities.
      crs: projected CRS in metres.
      bounds_m: read only the pixels around this box of ``crs``; left out, all.

    Returns:
      Polygons ``[N]``, night counts ``[N]`` float64, and ids ``[N]`` such as ``"12,7"``: the file's row and column.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the bounds, or
        holds negative counts that are not declared empty.
    """
    name = repr(str(path))
    with open_raster(path, PEOPLE) as source:
        window = raster_window(name, source, crs, bounds_m)
        values = source.read(1, window=window) * source.scales[0] + source.offsets[0]
        has_data = (source.read_masks(1, window=window) != 0) & np.isfinite(values)
        transform, raster_crs = tuple(source.transform)[:6], source.crs.to_wkt()
    if num_bad := int((values[has_data] < 0).sum()):
        raise InputError(
            f"{name} holds {num_bad} pixels of less than 0 people: declare their value as nodata with `gdal_edit.py "
            "-a_nodata VALUE`"
        )
    row, col = np.nonzero(has_data)
    raster = Raster(values, transform, raster_crs, int(window.row_off), int(window.col_off))
    corners = [(row + down, col + right) for down, right in ((1, 0), (1, 1), (0, 1), (0, 0), (1, 0))]
    rings = np.stack([np.stack(pixel_xy(raster, *corner, crs), axis=-1) for corner in corners], axis=1)
    ids = np.array([f"{r + raster.first_row},{c + raster.first_col}" for r, c in zip(row, col, strict=True)], object)
    return shapely.polygons(rings), values[has_data].astype(np.float64), ids
