"""GeoTIFFs of a grid: what all of them have, and several maps as the bands of one, whole or not there at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from rasterio._err import CPLE_BaseError
from rasterio.errors import RasterioError

from jaxurban.io.files import whole_file
from jaxurban.io.hidden import no_value
from jaxurban.world.grid import Grid

OF_WRITING = (RasterioError, CPLE_BaseError, SystemError)  # GDAL's errors, as of a full disk, as rasterio raises them


def profile_of(grid: Grid, dtype: np.dtype, count: int = 1) -> dict[str, Any]:
    """Return how rasterio opens a new GeoTIFF of so many bands on a grid: tiled, north-up, with what is no data."""
    return {
        "driver": "GTiff",
        "width": grid.num_cols,
        "height": grid.num_rows,
        "count": count,
        "dtype": dtype,
        "crs": grid.crs,
        "transform": Affine(grid.resolution_m, 0, grid.x_min_m, 0, -grid.resolution_m, grid.y_max_m),
        "nodata": no_value(dtype),
        "tiled": True,
        "bigtiff": "IF_SAFER",
    }


def write_bands(
    file: Path, grid: Grid, bands: Mapping[str, np.ndarray], unit: str = "1", tags: Mapping[str, str] | None = None
) -> Path:
    """Write maps as bands (float32, Zstandard, north-up, NaN = no data) and return the file.

    Args:
      file: named ``.tif``.
      grid: of the maps.
      bands: ``[Y, X]`` by description, rows south to north.
      unit: of their values.
      tags: of the file.

    Raises:
      InputError: the folder cannot be written to.
    """
    with whole_file(file) as scratch:
        try:
            profile = profile_of(grid, np.dtype(np.float32), len(bands))
            with rasterio.open(scratch, "w", **profile, compress="ZSTD") as raster:
                raster.update_tags(**(tags or {}))
                raster.units = [unit] * len(bands)
                for number, (description, values) in enumerate(bands.items(), start=1):
                    raster.write(np.asarray(values, np.float32)[::-1], number)
                    raster.set_band_description(number, description)
        except OF_WRITING as error:
            raise OSError(f"GDAL could not write it ({error})") from error
    return file
