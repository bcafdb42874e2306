"""Metric maps as cloud-optimised GeoTIFF with their QGIS styles, each file whole or not there at all."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio
import xarray as xr
from rasterio.errors import RasterioError
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.errors import one_of
from jaxurban.io.attributes import IN_OBSTACLES
from jaxurban.io.bands import profile_of
from jaxurban.io.files import BLANK, FIELD, SCRATCH_SUFFIX, holds_bytes, is_whole, seal, whole_file
from jaxurban.io.qgis import style
from jaxurban.io.store import GEOTIFF_FOLDER, no_value, short_number
from jaxurban.metrics.availability import STATISTICS
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.gps import DOPS
from jaxurban.world.grid import Grid
from jaxurban.world.tiling import Tiling, tile_shape

GDAL_CACHE_MIB = 64
ALL = "all"  # stands for every map that is held
CREDIT = "attribution"  # attribute of the maps
RUN_KEY = "run_key"


def geotiff_names(held: Collection[str], metrics: Iterable[str], layers: Sequence[str] = ()) -> list[str]:
    """Return the maps that are written as GeoTIFF: obstacles, the metrics of the cost, and what is asked for.

    Args:
      held: the variables that are maps.
      metrics: names of the metrics of the cost.
      layers: further variables, or ``("all",)``.

    Raises:
      InputError: a layer that the maps do not hold.
    """
    names = ["obstacle"]
    for name in [*metrics, *(sorted(held) if tuple(layers) == (ALL,) else layers)]:
        found = [name] if name in held else [one for one in STATISTICS if one in held] if name == "gps" else []
        if not found:
            one_of("layer", name, sorted({*held, ALL}))
        names += [one for one in found if one not in names]
    return names


class _Layer(NamedTuple):
    """One GeoTIFF: its file's name, variable, place along the variable's axes before y and x, and how it is tagged."""

    file: str
    name: str
    at: dict[str, int]
    tags: dict[str, str]

    @property
    def title(self) -> str:
        where = (f"{self.tags['altitude_m']} m above ground",) if "altitude_m" in self.tags else ()
        when = (self.tags[name] for name in ("time_of_day", "time") if name in self.tags)
        return ", ".join((self.tags.get("long_name", self.name), *where, *when))


def held_maps(ds: xr.Dataset) -> list[str]:
    """Return the variables of a dataset that are maps."""
    return [str(name) for name, array in ds.data_vars.items() if array.dims[-2:] == ("y", "x")]


def _layers(ds: xr.Dataset, layers: Sequence[str]) -> Iterator[_Layer]:
    """Yield what goes into each GeoTIFF of a dataset."""
    resolution = f"{short_number(ds.attrs['resolution_m'])}m"
    times = [f"{time}Z" for time in np.datetime_as_string(ds["time"].values, unit="s")]
    common = {"credit": ds.attrs[CREDIT]} if CREDIT in ds.attrs else {}
    norm_name = next((name for name in ("pop_norm_per_km2", "pop_norm_per_block") if name in ds.attrs), "")
    for name in geotiff_names(held_maps(ds), held_metrics(ds), layers):
        array = ds[name]
        told = {key: str(array.attrs[key]) for key in ("long_name", "units", "one_means") if key in array.attrs}
        for index in np.ndindex(array.shape[:-2]):
            at = {str(dim): place for dim, place in zip(array.dims[:-2], index, strict=True)}
            parts, tags = [name], {"metric": name, **told, **common}
            if ALTITUDE in at:
                tags["altitude_m"] = short_number(float(ds["altitude"][at[ALTITUDE]]))
                tags["altitude_reference"] = "above ground"
                parts.append(f"{tags['altitude_m']}m")
            if TIME_OF_DAY in at:
                tags["time_of_day"] = str(ds["time_of_day"].values[at[TIME_OF_DAY]])
                parts.append(tags["time_of_day"])
                if name == "population" and norm_name:
                    tags[norm_name] = repr(float(ds.attrs[norm_name][at[TIME_OF_DAY]]))
            if TIME in at:
                tags["time"] = times[at[TIME]]
                if len(times) > 1:
                    parts.append(tags["time"].translate({45: None, 58: None}))
            elif name in STATISTICS:
                tags |= {"time": f"{times[0]}/{times[-1]}", "num_times": str(len(times))}
            if "time" in tags and "constellations" in ds.attrs:
                tags["constellation"] = ", ".join(ds.attrs["constellations"])
            yield _Layer("_".join((*parts, f"{resolution}.tif")), name, at, tags)


def _styles(ds: xr.Dataset, layers: Sequence[str]) -> dict[str, str]:
    """Return the variable of each QGIS style by its file's name."""
    resolution = short_number(ds.attrs["resolution_m"])
    return {f"{name}_{resolution}m.qml": name for name in geotiff_names(held_maps(ds), held_metrics(ds), layers)}


def _paths(ds: xr.Dataset, folder: Path, layers: Sequence[str]) -> list[Path]:
    names = [*(layer.file for layer in _layers(ds, layers)), *_styles(ds, layers)]
    return [folder / GEOTIFF_FOLDER / name for name in names]


def missing_geotiffs(ds: xr.Dataset, folder: Path) -> list[Path]:
    """Return the GeoTIFFs and styles of obstacles and metrics that are not there, or empty."""
    return [path for path in _paths(ds, folder, ()) if not holds_bytes(path)]


def stale_geotiffs(
    ds: xr.Dataset, folder: Path, run_key: str, num_threads: int = 1, layers: Sequence[str] = ()
) -> list[Path]:
    """Return the GeoTIFFs and styles of maps that are missing, damaged, or not of this run; every byte is read."""

    def is_stale(path: Path) -> bool:
        return not is_whole(path) or _run_key(path) != run_key

    paths = _paths(ds, folder, layers)
    with ThreadPoolExecutor(num_threads) as pool:
        return [path for path, stale in zip(paths, pool.map(is_stale, paths), strict=True) if stale]


def write_geotiffs(
    ds: xr.Dataset,
    folder: Path,
    run_key: str | None = None,
    num_threads: int = 1,
    only: Collection[Path] | None = None,
    layers: Sequence[str] = (),
) -> list[Path]:
    """Write maps as cloud-optimised GeoTIFF (ZSTD, north-up), and the QGIS style of each variable.

    Values are float32 with NaN as no data, or uint8 with 255 as no data. There is no data where nothing is known of
    a cell and, of what the engine sets to one value inside obstacles (`IN_OBSTACLES`), there.

    Args:
      ds: the maps; read chunk by chunk, so that they need not fit in memory.
      folder: files go to its ``geotiff`` folder.
      run_key: what the tag of this name says; None for no such tag.
      num_threads: files written at the same time.
      only: leave the others alone.
      layers: variables that are written beside obstacles and the metrics of the cost; ``("all",)``: every one.

    Returns:
      The files written.

    Raises:
      InputError: a layer that the maps do not hold, or a folder that cannot be written to.
    """

    def path_of(name: str) -> Path | None:
        path = folder / GEOTIFF_FOLDER / name
        return path if only is None or path in only else None

    def write(layer: _Layer) -> Path | None:
        if (path := path_of(layer.file)) is not None:
            tags = layer.tags if run_key is None else layer.tags | {RUN_KEY: run_key}
            with whole_file(path) as scratch:
                _write_cog(scratch, ds, layer._replace(tags=tags | {FIELD: BLANK}))
                seal(scratch)
        return path

    def write_style(file: str, name: str) -> Path | None:
        if (path := path_of(file)) is not None:
            with whole_file(path) as scratch:
                note = BLANK if run_key is None else f"{RUN_KEY}={run_key} {BLANK}"
                scratch.write_text(style(ds, name, note), encoding="utf-8")
                seal(scratch)
        return path

    with ThreadPoolExecutor(num_threads) as pool:
        written = list(pool.map(write, _layers(ds, layers)))
    written += [write_style(file, name) for file, name in _styles(ds, layers).items()]
    return [path for path in written if path is not None]


def _values(ds: xr.Dataset, layer: _Layer, part: dict[str, slice]) -> np.ndarray:
    """Return a part of a map ``[y, x]`` as GeoTIFFs hold it."""
    array = ds[layer.name]
    values = array.isel(layer.at | part).values.astype(_file_type(array.dtype))
    if layer.name == "has_data":
        return values
    is_hidden = ~ds["has_data"].isel(part).values
    if IN_OBSTACLES in array.attrs:
        obstacle = ds["obstacle"]
        at = {dim: place for dim, place in layer.at.items() if dim in obstacle.dims}
        is_hidden |= obstacle.isel(at | part).values != 0
    values[is_hidden] = no_value(values.dtype)
    return values


def _file_type(dtype: np.dtype) -> np.dtype:
    return np.dtype(np.uint8 if dtype in (np.bool_, np.uint8) else np.float32)


def _write_cog(path: Path, ds: xr.Dataset, layer: _Layer) -> None:
    """Write one map: chunk by chunk into a plain tiled file, which GDAL then turns into a cloud-optimised one."""
    corner = (ds.attrs["first_row"], ds.attrs["first_col"])
    grid = Grid(ds.attrs["crs"], ds.attrs["resolution_m"], *corner, ds.sizes["y"], ds.sizes["x"])
    tiling = Tiling.over(grid, grid, tile_shape(grid.shape))
    dtype = _file_type(ds[layer.name].dtype)
    # Averages of classes, of counts and of infinite DOPs would be none of them in the overviews.
    is_averaged = dtype == np.float32 and layer.name not in DOPS
    plain = path.with_name(f"{path.name.removesuffix(SCRATCH_SUFFIX)}.plain{SCRATCH_SUFFIX}")
    try:
        with rasterio.Env(GDAL_CACHEMAX=GDAL_CACHE_MIB):
            with rasterio.open(plain, "w", **profile_of(grid, dtype), blockxsize=512, blockysize=512) as file:
                for rows, cols in map(tiling.reported, tiling.region_tiles):
                    values = _values(ds, layer, {"y": rows, "x": cols})
                    window = Window.from_slices(
                        (grid.num_rows - rows.stop, grid.num_rows - rows.start), (cols.start, cols.stop)
                    )
                    file.write(values[::-1], 1, window=window)
                file.update_tags(**layer.tags)
                file.set_band_description(1, layer.title)
                file.set_band_unit(1, layer.tags.get("units", ""))
            copy_raster(
                plain,
                path,
                driver="COG",
                compress="ZSTD",
                level=1,  # on these maps a predictor takes more time and more bytes, a higher level twice the time
                predictor="NO",
                blocksize=512,
                bigtiff="IF_SAFER",
                overview_resampling="average" if is_averaged else "nearest",
                num_threads=1,
            )
            with rasterio.open(path) as file:
                file.checksum(1)  # reads every block: GDAL tells nobody of a disk that fills up
    except (RasterioError, SystemError) as error:
        raise OSError(f"GDAL could not write it ({error})") from error
    finally:
        plain.unlink(missing_ok=True)


def _run_key(path: Path) -> str | None:
    """Return the run that a GeoTIFF or a style says it is of."""
    if path.suffix == ".qml":
        found = re.search(rf"{RUN_KEY}=(\w+)", path.read_text(encoding="utf-8"))
        return found and found[1]
    try:
        with rasterio.open(path) as file:
            return file.tags().get(RUN_KEY)
    except rasterio.RasterioIOError:
        return None
