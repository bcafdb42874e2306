"""Metric maps on disk: Zarr and cloud-optimised GeoTIFF, each file whole or not there at all."""

import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import xarray as xr
import zarr
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.errors import InputError
from jaxurban.tiles import tile_shape

RUN_FILE = "run.json"
LOCK_FILE = ".jaxurban.lock"
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
SCRATCH_SUFFIX = ".jaxurban-part"  # of what is being written: ours to sweep, and nobody else's
NEEDED = ("obstacle", "has_data")  # without these it is no folder of maps
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


def short_number(value: float) -> str:
    """Return a number as file names carry it: ``5``, ``2.5``."""
    return f"{value:g}"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a scratch path beside ``path`` that takes its name only if the block succeeds.

    Works for a file and for a folder (an old folder of that name is replaced).

    Raises:
      InputError: the folder cannot be written to.
    """
    scratch = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{SCRATCH_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield scratch
        if path.is_dir() and not scratch.is_dir():
            raise InputError(f"cannot write {str(path)!r}: a folder of that name is in the way; move it")
        if path.is_dir():
            old = scratch.with_name(f"{scratch.stem}.old{SCRATCH_SUFFIX}")
            path.rename(old)
            scratch.rename(path)
            shutil.rmtree(old)
        else:
            os.replace(scratch, path)
    except OSError as error:
        raise InputError(
            f"cannot write {str(path)!r}: {error.strerror or error}; free space there, or choose another folder"
        ) from error
    finally:
        _remove(scratch)


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it is there and can be."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def zarr_path(folder: Path, resolution_m: float) -> Path:
    """Return where the maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f"{short_number(resolution_m)}m"


def stored_resolutions(folder: Path) -> dict[float, Path]:
    """Return where the maps under ``folder`` lie, by resolution in metres."""
    named = ((re.fullmatch(r"([0-9.e+-]+)m", path.name), path) for path in sorted((folder / ZARR_FOLDER).glob("*m")))
    return {float(match[1]): path for match, path in named if match and (path / "zarr.json").is_file()}


def check_writable(folder: Path) -> None:
    """Make ``folder`` and raise InputError if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"cannot write to the output folder {str(folder)!r}: {error.strerror or error}; choose another with -o"
        ) from error


def work_path(folder: Path, resolution_m: float) -> Path:
    """Return where the unfinished maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f".{short_number(resolution_m)}m{SCRATCH_SUFFIX}"


@contextmanager
def only_writer(folder: Path, remedy: str = "choose another folder") -> Iterator[None]:
    """Hold a folder for one run; the hold goes with the process, however it ends.

    Raises:
      InputError: another run holds it, or it cannot be written to; ``remedy`` ends the sentence.
    """
    try:
        import fcntl
    except ImportError:  # not a Unix: two runs in one folder are the user's to avoid
        yield
        return
    try:
        file = (folder / LOCK_FILE).open("w")
    except OSError as error:
        raise InputError(f"cannot write to {str(folder)!r} ({error.strerror or error}): {remedy}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"another run is writing to {str(folder)!r}: wait for it, or {remedy}") from error
        try:
            yield
        finally:
            (folder / LOCK_FILE).unlink(missing_ok=True)


def sweep_scraps(folder: Path, keep: Iterable[Path] = ()) -> None:
    """Remove what a killed run left half-written under ``folder``, but for the work in ``keep``."""
    kept = set(keep)
    for part in (folder, folder / ZARR_FOLDER, folder / GEOTIFF_FOLDER):
        for scrap in part.glob(f".*{SCRATCH_SUFFIX}"):
            if scrap not in kept:
                _remove(scrap)


def remove_maps(folder: Path) -> None:
    """Remove the maps that a job wrote under ``folder`` and its record, and nothing else.

    The Zarr goes last: while it stands the folder is known to hold that job's maps.
    """
    for part in (RUN_FILE, GEOTIFF_FOLDER, ZARR_FOLDER):
        _remove(folder / part)


def _chunks(ds: xr.Dataset) -> dict[str, dict[str, tuple[int, ...]]]:
    """Return the encoding that cuts every map into the tiles of its region, one layer a chunk."""
    tile = tile_shape((ds.sizes["y"], ds.sizes["x"]))
    return {
        str(name): {"chunks": (*(1 for _ in array.dims[:-2]), *tile)}
        for name, array in ds.data_vars.items()
        if array.dims[-2:] == ("y", "x")
    }


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps under ``folder`` and return its place (``maps.zarr/5m``)."""
    path = zarr_path(folder, ds.attrs["resolution_m"])
    with whole_file(path) as scratch:
        ds.to_zarr(scratch, mode="w", zarr_format=3, consolidated=False, encoding=_chunks(ds))
    return path


def create_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int]) -> None:
    """Write the Zarr of a dataset of dask arrays: coordinates, attributes, and maps without values.

    Args:
      ds: the dataset.
      path: where to.
      tile: rows and columns of a chunk, what one `write_layer` fills.
    """
    encoding = {name: {"chunks": (*each["chunks"][:-2], *tile)} for name, each in _chunks(ds).items()}
    with whole_file(path) as scratch:
        ds.to_zarr(scratch, mode="w", zarr_format=3, consolidated=False, encoding=encoding, compute=False)


def write_layer(path: Path, name: str, index: tuple[int, ...], window: tuple[slice, slice], values: np.ndarray) -> None:
    """Write a tile of one map into a Zarr: its values, as far as the window reaches."""
    rows, cols = window
    array = zarr.open_array(path / name, mode="r+")
    place: Any = (*index, rows, cols)
    array[place] = values[: rows.stop - rows.start, : cols.stop - cols.start]


def add_to_zarr(ds: xr.Dataset, path: Path) -> None:
    """Add the variables of a dataset to a Zarr."""
    ds.to_zarr(path, mode="a", zarr_format=3, consolidated=False)


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps under ``folder``; values are read when they are looked at.

    Raises:
      InputError: no maps there, or several resolutions and none chosen.
    """
    found = stored_resolutions(folder)
    listed = ", ".join(short_number(value) for value in sorted(found)) or "none"
    if not found:
        raise InputError(f"{str(folder)!r} holds no metric maps: make them with `jaxurban maps SCENARIO -o {folder}`")
    if resolution_m is None and len(found) > 1:
        raise InputError(f"{str(folder)!r} holds maps at {listed} m: choose one with resolution_m (--resolution)")
    if resolution_m is not None and resolution_m not in found:
        raise InputError(f"{str(folder)!r} holds no maps at {short_number(resolution_m)} m, only at {listed} m")
    path = found[resolution_m] if resolution_m is not None else next(iter(found.values()))
    try:
        ds = xr.open_zarr(path, consolidated=False, chunks=None)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"the maps in {str(path)!r} cannot be read ({error}): remove them and make them again"
        ) from error
    if lost := [name for name in NEEDED if name not in ds]:
        raise InputError(f"the maps in {str(path)!r} hold no {', no '.join(lost)}: remove them and make them again")
    return ds


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


def write_geotiffs(ds: xr.Dataset, folder: Path, skip_key: str | None = None, num_threads: int = 1) -> list[Path]:
    """Write each metric map as a cloud-optimised GeoTIFF (float32, ZSTD, north-up, NaN = no data).

    Args:
      ds: the maps; read chunk by chunk, so that they need not fit in memory.
      folder: files go to its ``geotiff`` folder.
      skip_key: leave a file alone whose ``run_key`` tag says this already.
      num_threads: files written at the same time.

    Returns:
      The files, written or left alone.
    """
    norm_name = next((name for name in ("pop_norm_per_km2", "pop_norm_per_block") if name in ds.attrs), "")
    norms = dict(zip(ds["time_of_day"].values, ds.attrs[norm_name], strict=True)) if norm_name else {}

    def write(named: tuple[str, str, xr.DataArray]) -> Path:
        name, metric, layer = named
        path = folder / GEOTIFF_FOLDER / name
        if skip_key is not None and _run_key(path) == skip_key:
            return path
        tags = {"metric": metric, "units": ds[metric].attrs["units"], "one_means": ds[metric].attrs["one_means"]}
        if metric == "population":
            tags[norm_name] = repr(float(norms[layer["time_of_day"].item()]))
        if skip_key is not None:
            tags["run_key"] = skip_key
        with whole_file(path) as scratch:
            _write_cog(scratch, layer, ds, tags)
        return path

    with ThreadPoolExecutor(num_threads) as pool:
        return list(pool.map(write, geotiff_layers(ds)))


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
