"""GeoTIFFs of a grid: a cloud-optimised one of one map, and several maps as the bands of one."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.io.attributes import no_value
from jaxurban.io.files import SCRATCH_SUFFIX, whole_file
from jaxurban.world.grid import Grid

BLOCK = 512  # cells of a block's side
LEVEL = 1  # of Zstandard: on these maps a predictor takes more time and more bytes, a higher level twice the time


@contextmanager
def _writing() -> Iterator[None]:
    """Raise OSError where GDAL fails, as on a full disk; rasterio has no public class for all that it raises then."""
    try:
        yield
    except Exception as error:
        if isinstance(error, SystemError) or type(error).__module__.partition(".")[0] == "rasterio":
            raise OSError(f"GDAL could not write it ({error})") from error
        raise


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
    profile = profile_of(grid, np.dtype(np.float32), len(bands))
    with whole_file(file) as scratch, _writing(), rasterio.open(scratch, "w", **profile, compress="ZSTD") as raster:
        raster.update_tags(**(tags or {}))
        raster.units = [unit] * len(bands)
        for number, (description, values) in enumerate(bands.items(), start=1):
            raster.write(np.asarray(values, np.float32)[::-1], number)
            raster.set_band_description(number, description)
    return file


def write_cog(
    path: Path,
    grid: Grid,
    dtype: np.dtype,
    rows: Iterable[np.ndarray],
    *,
    is_averaged: bool,
    tags: Mapping[str, str],
    title: str,
    unit: str,
) -> None:
    """Write a map as a cloud-optimised GeoTIFF (ZSTD, north-up, the same bytes for the same map).

    Args:
      path: where to.
      grid: of the map.
      dtype: of its values; what stands for no value is `jaxurban.io.attributes.no_value`.
      rows: parts ``[y, x]`` of the map, all its rows from the north to the south; each but the last has a multiple of
        `BLOCK` rows, as GDAL writes a block that is full once.
      is_averaged: whether overviews hold means of the cells that they cover, NaN left out, else the nearest cell.
      tags: of the file.
      title: of its band.
      unit: of its values.

    Raises:
      OSError: the file cannot be written.
    """
    # Overviews go through a scratch file of GDAL's own, on which Zstandard would spend a third of all time.
    quick = rasterio.Env(COG_TMP_COMPRESSION="PACKBITS")
    with _writing(), quick, TemporaryDirectory(SCRATCH_SUFFIX, ".plain.", path.parent) as folder:
        plain, row = Path(folder) / "plain.tif", 0
        with rasterio.open(plain, "w", **profile_of(grid, dtype), blockxsize=BLOCK, blockysize=BLOCK) as file:
            for part in rows:
                file.write(part, 1, window=Window(0, row, part.shape[1], len(part)))
                row += len(part)
            file.update_tags(**tags)
            file.set_band_description(1, title)
            file.set_band_unit(1, unit)
        resampling = "average" if is_averaged else "nearest"
        how = {"compress": "ZSTD", "level": LEVEL, "predictor": "NO", "blocksize": BLOCK, "bigtiff": "IF_SAFER"}
        copy_raster(plain, path, driver="COG", overview_resampling=resampling, num_threads=1, **how)
        with rasterio.open(path) as file:  # GDAL does not report every disk that fills up; the map is the file's end
            for _, window in file.block_windows(1):
                file.read(1, window=window)
