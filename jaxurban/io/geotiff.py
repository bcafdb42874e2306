"""Metric maps as cloud-optimised GeoTIFF, each file whole or not there at all."""

from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import rasterio
import xarray as xr
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.io.files import BLANK, FIELD, SCRATCH_SUFFIX, holds_bytes, is_whole, seal, whole_file
from jaxurban.io.store import GEOTIFF_FOLDER, short_number
from jaxurban.metrics.availability import STATISTICS
from jaxurban.metrics.custom import held_metrics
from jaxurban.world.grid import Grid
from jaxurban.world.tiling import Tiling, tile_shape

GDAL_CACHE_MIB = 64


def geotiff_metrics(ds: xr.Dataset) -> list[str]:
    """Return the variables of a dataset that are written as GeoTIFF: obstacles and the metrics of the cost.

    Spreads by uncertain heights, whose 5th percentile has the name of a statistic over time, stay in the Zarr.
    """
    names = ["obstacle"]
    for name in held_metrics(ds):
        names += [name] if name in ds else list(STATISTICS)
    return names


def geotiff_layers(ds: xr.Dataset) -> Iterator[tuple[str, str, xr.DataArray]]:
    """Yield file name, metric and ``[y, x]`` array of each GeoTIFF of a dataset."""
    resolution = f"{short_number(ds.attrs['resolution_m'])}m.tif"
    several_times = ds.sizes["time"] > 1
    for metric in geotiff_metrics(ds):
        array = ds[metric]
        outer = array.dims[:-2]
        for index in np.ndindex(*(array.sizes[dim] for dim in outer)):
            layer = array.isel(dict(zip(outer, index, strict=True)))  # stacking would read all of them
            parts = [metric]
            if "altitude" in array.dims:
                parts.append(f"{short_number(float(layer['altitude']))}m")
            if "time_of_day" in array.dims:
                parts.append(str(layer["time_of_day"].item()))
            if "time" in array.dims and several_times:
                time = str(np.datetime_as_string(layer["time"].values, unit="s"))
                parts.append(time.translate({45: None, 58: None}) + "Z")
            yield "_".join((*parts, resolution)), metric, layer


def _paths(ds: xr.Dataset, folder: Path) -> list[Path]:
    return [folder / GEOTIFF_FOLDER / name for name, _, _ in geotiff_layers(ds)]


def missing_geotiffs(ds: xr.Dataset, folder: Path) -> list[Path]:
    """Return the GeoTIFFs of maps that are not there, or empty."""
    return [path for path in _paths(ds, folder) if not holds_bytes(path)]


def stale_geotiffs(ds: xr.Dataset, folder: Path, run_key: str, num_threads: int = 1) -> list[Path]:
    """Return the GeoTIFFs of maps that are missing, damaged, or not of this run; every byte is read."""

    def is_stale(path: Path) -> bool:
        return not is_whole(path) or _run_key(path) != run_key

    paths = _paths(ds, folder)
    with ThreadPoolExecutor(num_threads) as pool:
        return [path for path, stale in zip(paths, pool.map(is_stale, paths), strict=True) if stale]


def write_geotiffs(
    ds: xr.Dataset,
    folder: Path,
    run_key: str | None = None,
    num_threads: int = 1,
    only: Collection[Path] | None = None,
) -> list[Path]:
    """Write each metric map as a cloud-optimised GeoTIFF (float32, ZSTD, north-up, NaN = no data).

    Args:
      ds: the maps; read chunk by chunk, so that they need not fit in memory.
      folder: files go to its ``geotiff`` folder.
      run_key: what the tag of this name says; None for no such tag.
      num_threads: files written at the same time.
      only: leave the others alone.

    Returns:
      The files written.
    """
    norm_name = next((name for name in ("pop_norm_per_km2", "pop_norm_per_block") if name in ds.attrs), "")
    norms = dict(zip(ds["time_of_day"].values, ds.attrs[norm_name], strict=True)) if norm_name else {}

    def write(named: tuple[str, str, xr.DataArray]) -> Path:
        name, metric, layer = named
        path = folder / GEOTIFF_FOLDER / name
        tags = {"metric": metric, "units": ds[metric].attrs["units"], "one_means": ds[metric].attrs["one_means"]}
        if metric == "population":
            tags[norm_name] = repr(float(norms[layer["time_of_day"].item()]))
        if run_key is not None:
            tags["run_key"] = run_key
        with whole_file(path) as scratch:
            _write_cog(scratch, layer, ds, tags | {FIELD: BLANK})
            seal(scratch)
        return path

    layers = (each for each in geotiff_layers(ds) if only is None or folder / GEOTIFF_FOLDER / each[0] in only)
    with ThreadPoolExecutor(num_threads) as pool:
        return list(pool.map(write, layers))


def _write_cog(path: Path, layer: xr.DataArray, ds: xr.Dataset, tags: dict[str, str]) -> None:
    """Write one map: chunk by chunk into a plain tiled file, which GDAL then turns into a cloud-optimised one."""
    corner = (ds.attrs["first_row"], ds.attrs["first_col"])
    grid = Grid(ds.attrs["crs"], ds.attrs["resolution_m"], *corner, ds.sizes["y"], ds.sizes["x"])
    tiling = Tiling.over(grid, grid, tile_shape(grid.shape))
    plain = path.with_name(f"{path.name.removesuffix(SCRATCH_SUFFIX)}.plain{SCRATCH_SUFFIX}")
    try:
        with rasterio.Env(GDAL_CACHEMAX=GDAL_CACHE_MIB):
            with rasterio.open(
                plain,
                "w",
                driver="GTiff",
                width=grid.num_cols,
                height=grid.num_rows,
                count=1,
                dtype="float32",
                crs=grid.crs,
                transform=Affine(grid.resolution_m, 0, grid.x_min_m, 0, -grid.resolution_m, grid.y_max_m),
                nodata=float("nan"),
                tiled=True,
                blockxsize=512,
                blockysize=512,
                bigtiff="IF_SAFER",
            ) as file:
                for rows, cols in map(tiling.reported, tiling.region_tiles):
                    part = {"y": rows, "x": cols}
                    values = layer.isel(part).values.astype(np.float32)
                    values[~ds["has_data"].isel(part).values] = np.nan
                    window = Window.from_slices(
                        (grid.num_rows - rows.stop, grid.num_rows - rows.start), (cols.start, cols.stop)
                    )
                    file.write(values[::-1], 1, window=window)
                file.update_tags(**tags)
            copy_raster(
                plain,
                path,
                driver="COG",
                compress="ZSTD",
                level=1,  # on these maps a predictor takes more time and more bytes, a higher level twice the time
                predictor="NO",
                blocksize=512,
                bigtiff="IF_SAFER",
                # Averaged obstacles would be neither 0 nor 1 in the overviews.
                overview_resampling="nearest" if tags["metric"] == "obstacle" else "average",
                num_threads=1,
            )
            with rasterio.open(path) as file:
                file.checksum(1)  # reads every block: GDAL tells nobody of a disk that fills up
    except (RasterioError, SystemError) as error:
        raise OSError(f"GDAL could not write it ({error})") from error
    finally:
        plain.unlink(missing_ok=True)


def _run_key(path: Path) -> str | None:
    try:
        with rasterio.open(path) as file:
            return file.tags().get("run_key")
    except rasterio.RasterioIOError:
        return None
