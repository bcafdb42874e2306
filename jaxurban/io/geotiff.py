"""Metric maps as cloud-optimised GeoTIFF, each file whole or not there at all."""

import os
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np
import rasterio
import xarray as xr
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.io.seal import BLANK, FIELD, is_whole, seal
from jaxurban.io.store import GEOTIFF_FOLDER, SCRATCH_SUFFIX, short_number, whole_file
from jaxurban.tiles import tile_shape

GEOTIFF_METRICS = (
    "obstacle",
    "gps",
    "gps_availability",
    "gps_median",
    "gps_p05",
    "lidar",
    "population",
    "risk",
)
GDAL_CACHE_MIB = 64


def geotiff_layers(ds: xr.Dataset) -> Iterator[tuple[str, str, xr.DataArray]]:
    """Yield file name, metric and ``[y, x]`` array of each GeoTIFF of a dataset."""
    resolution = f"{short_number(ds.attrs['resolution_m'])}m.tif"
    several_times = ds.sizes["time"] > 1
    for metric in GEOTIFF_METRICS:
        # Spreads by uncertain heights, whose 5th percentile has that name too, stay in the Zarr.
        if metric not in ds or (metric == "gps_p05" and "gps_median" not in ds):
            continue
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


def _path_of(ds: xr.Dataset, folder: Path) -> dict[str, Path]:
    return {name: folder / GEOTIFF_FOLDER / name for name, _, _ in geotiff_layers(ds)}


def missing_geotiffs(ds: xr.Dataset, folder: Path) -> list[Path]:
    """Return the GeoTIFFs of maps that are not there, or empty."""
    sizes = {}
    if (folder / GEOTIFF_FOLDER).is_dir():
        with os.scandir(folder / GEOTIFF_FOLDER) as entries:
            sizes = {entry.name: entry.stat().st_size for entry in entries}
    return [path for name, path in _path_of(ds, folder).items() if not sizes.get(name)]


def stale_geotiffs(ds: xr.Dataset, folder: Path, run_key: str, num_threads: int = 1) -> list[Path]:
    """Return the GeoTIFFs of maps that are missing, damaged, or not of this run; every byte is read."""

    def is_stale(path: Path) -> bool:
        return not is_whole(path) or _run_key(path) != run_key

    paths = list(_path_of(ds, folder).values())
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


def _windows(shape: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    """Yield the rows and columns of the chunks of maps of a shape."""
    starts = (range(0, size, side) for size, side in zip(shape, tile_shape(shape), strict=True))
    for corner in product(*starts):
        rows, cols = (
            slice(start, min(start + side, size))
            for start, side, size in zip(corner, tile_shape(shape), shape, strict=True)
        )
        yield rows, cols


def _write_cog(path: Path, layer: xr.DataArray, ds: xr.Dataset, tags: dict[str, str]) -> None:
    """Write one map: chunk by chunk into a plain tiled file, which GDAL then turns into a cloud-optimised one."""
    num_rows, num_cols, resolution_m = ds.sizes["y"], ds.sizes["x"], ds.attrs["resolution_m"]
    y_max_m = (ds.attrs["first_row"] + num_rows) * resolution_m
    plain = path.with_name(f"{path.name.removesuffix(SCRATCH_SUFFIX)}.plain{SCRATCH_SUFFIX}")
    try:
        with rasterio.Env(GDAL_CACHEMAX=GDAL_CACHE_MIB):
            with rasterio.open(
                plain,
                "w",
                driver="GTiff",
                width=num_cols,
                height=num_rows,
                count=1,
                dtype="float32",
                crs=ds.attrs["crs"],
                transform=Affine(resolution_m, 0, ds.attrs["first_col"] * resolution_m, 0, -resolution_m, y_max_m),
                nodata=float("nan"),
                tiled=True,
                blockxsize=512,
                blockysize=512,
                bigtiff="IF_SAFER",
            ) as file:
                for rows, cols in _windows((num_rows, num_cols)):
                    part = {"y": rows, "x": cols}
                    values = layer.isel(part).values.astype(np.float32)
                    values[~ds["has_data"].isel(part).values] = np.nan
                    window = Window(cols.start, num_rows - rows.stop, cols.stop - cols.start, rows.stop - rows.start)
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
            _check_whole(path)
    except (RasterioError, SystemError) as error:
        raise OSError(f"GDAL could not write it ({error})") from error
    finally:
        plain.unlink(missing_ok=True)


def _check_whole(path: Path) -> None:
    """Raise RasterioError unless every block of a file can be read: GDAL tells nobody of a disk that fills up."""
    with rasterio.open(path) as file:
        file.checksum(1)


def _run_key(path: Path) -> str | None:
    try:
        with rasterio.open(path) as file:
            return file.tags().get("run_key")
    except rasterio.RasterioIOError:
        return None
