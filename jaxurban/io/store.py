"""Metric maps on disk: Zarr and cloud-optimised GeoTIFF, each file whole or not there at all."""

import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import rasterio
import xarray as xr
from affine import Affine
from rasterio.io import MemoryFile

from jaxurban.errors import InputError

RUN_FILE = "run.json"
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
SCRATCH_SUFFIX = ".jaxurban-part"  # of what is being written: ours to sweep, and nobody else's
NEEDED = ("obstacle", "gps", "has_data")  # without these it is no folder of maps
GEOTIFF_METRICS = ("obstacle", "gps", "lidar", "population", "risk")


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


def sweep_scraps(folder: Path) -> None:
    """Remove what a killed run left half-written under ``folder``."""
    for part in (folder, folder / ZARR_FOLDER, folder / GEOTIFF_FOLDER):
        for scrap in part.glob(f".*{SCRATCH_SUFFIX}"):
            _remove(scrap)


def remove_maps(folder: Path) -> None:
    """Remove the maps that a job wrote under ``folder`` and its record, and nothing else.

    The Zarr goes last: while it stands the folder is known to hold that job's maps.
    """
    for part in (RUN_FILE, GEOTIFF_FOLDER, ZARR_FOLDER):
        _remove(folder / part)


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps under ``folder`` and return its place (``maps.zarr/5m``)."""
    path = zarr_path(folder, ds.attrs["resolution_m"])
    encoding = {
        name: {"chunks": (*(1 for _ in array.dims[:-2]), *(min(1024, size) for size in array.shape[-2:]))}
        for name, array in ds.data_vars.items()
    }
    with whole_file(path) as scratch:
        ds.to_zarr(scratch, mode="w", zarr_format=3, consolidated=False, encoding=encoding)
    return path


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps under ``folder``, loaded.

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
        ds = xr.open_zarr(path, consolidated=False, chunks=None).load()
        if lost := [name for name in NEEDED if name not in ds]:
            raise ValueError(f"no {', no '.join(lost)} there")
        return ds
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"the maps in {str(path)!r} cannot be read ({error}): remove them and make them again"
        ) from error


def geotiff_layers(ds: xr.Dataset) -> Iterator[tuple[str, str, xr.DataArray]]:
    """Yield file name, metric and ``[y, x]`` array of each GeoTIFF of a dataset."""
    resolution = f"{short_number(ds.attrs['resolution_m'])}m.tif"
    several_times = ds.sizes["time"] > 1
    for metric in GEOTIFF_METRICS:
        if metric not in ds:
            continue
        array = ds[metric]
        outer = array.stack(layer=[dim for dim in array.dims if dim not in ("y", "x")]).transpose("layer", ...)
        for layer in outer:
            parts = [metric]
            if "altitude" in array.dims:
                parts.append(f"{short_number(float(layer['altitude']))}m")
            if "time_of_day" in array.dims:
                parts.append(str(layer["time_of_day"].item()))
            if "time" in array.dims and several_times:
                parts.append(
                    np.datetime_as_string(layer["time"].values, unit="s").translate({45: None, 58: None}) + "Z"
                )
            yield "_".join((*parts, resolution)), metric, layer


def write_geotiffs(ds: xr.Dataset, folder: Path, skip_key: str | None = None) -> list[Path]:
    """Write each metric map as a cloud-optimised GeoTIFF (float32, ZSTD, north-up, NaN = no data).

    Args:
      ds: the maps.
      folder: files go to its ``geotiff`` folder.
      skip_key: leave a file alone whose ``run_key`` tag says this already.

    Returns:
      The files, written or left alone.
    """
    resolution_m, has_data = ds.attrs["resolution_m"], ds["has_data"].values
    y_max_m = (ds.attrs["first_row"] + ds.sizes["y"]) * resolution_m
    transform = Affine(resolution_m, 0, ds.attrs["first_col"] * resolution_m, 0, -resolution_m, y_max_m)
    norm_name = next((name for name in ("pop_norm_per_km2", "pop_norm_per_block") if name in ds.attrs), "")
    norms = dict(zip(ds["time_of_day"].values, ds.attrs[norm_name], strict=True)) if norm_name else {}
    files = []
    for name, metric, layer in geotiff_layers(ds):
        path = folder / GEOTIFF_FOLDER / name
        files.append(path)
        if skip_key is not None and _run_key(path) == skip_key:
            continue
        values = np.where(has_data, layer.values.astype(np.float32), np.float32(np.nan))
        tags = {"metric": metric, "units": ds[metric].attrs["units"], "one_means": ds[metric].attrs["one_means"]}
        if metric == "population":
            tags[norm_name] = repr(float(norms[layer["time_of_day"].item()]))
        if skip_key is not None:
            tags["run_key"] = skip_key
        with whole_file(path) as scratch:
            # Averaged obstacles would be neither 0 nor 1 in the overviews.
            overviews = "nearest" if metric == "obstacle" else "average"
            _write_cog(scratch, values[::-1], transform, ds.attrs["crs"], tags, overviews)
    return files


def _write_cog(
    path: Path, values: np.ndarray, transform: Affine, crs: str, tags: dict[str, str], overviews: str
) -> None:
    # In memory first: where the disk is full GDAL tells nobody, and Python's own writing does.
    with MemoryFile() as memory:
        with memory.open(
            driver="COG",
            width=values.shape[1],
            height=values.shape[0],
            count=1,
            dtype="float32",
            crs=crs,
            transform=transform,
            nodata=float("nan"),
            compress="ZSTD",
            predictor="YES",
            blocksize=512,
            overview_resampling=overviews,
            num_threads="ALL_CPUS",
        ) as file:
            file.write(values, 1)
            file.update_tags(**tags)
        path.write_bytes(memory.getbuffer())


def _run_key(path: Path) -> str | None:
    try:
        with rasterio.open(path) as file:
            return file.tags().get("run_key")
    except rasterio.RasterioIOError:
        return None
