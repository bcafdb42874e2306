"""Metric maps as cloud-optimised GeoTIFF with their QGIS styles; each whole, or missing."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import rasterio
import xarray as xr
from affine import Affine
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.checks import one_of
from jaxurban.io.files import SCRATCH_SUFFIX, whole_file, write_whole
from jaxurban.io.stored import GEOTIFF_FOLDER, short_number
from jaxurban.io.workspace import Each
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, Variable
from jaxurban.metrics.custom import held_metrics, held_variables
from jaxurban.metrics.variables import CAVEAT, HIGHEST, SERIES, no_value
from jaxurban.world.grid import Grid, grid_of

BLOCK = 512  # cells of a block's side
LEVEL = 1  # of Zstandard: on these maps a predictor takes more time and more bytes, a higher level twice the time
ALL = "all"  # stands for every map that is held
CREDIT = "attribution"  # attribute of the maps
RUN_KEY = "run_key"
# Attributes of variables that become tags.
TEXTS = ("long_name", "units", "one_means", "flag_meanings", CAVEAT)
NUM_PLACES = 17  # of a colour map in QGIS styles, from low to high


def geotiff_names(ds: xr.Dataset, layers: Sequence[str]) -> list[str]:
    """Return the variables that are written as GeoTIFF: obstacles, the metrics, and further layers.

    Where the maps hold no variable of a metric's or a layer's own name but summaries of it over the times (`SERIES`),
    these are written in its place.

    Args:
      ds: the maps.
      layers: further names, or ``("all",)`` for all variables.

    Returns:
      Names of variables that are maps, each once.

    Raises:
      InputError: a layer that the maps do not hold.
    """
    names = ["obstacle"]
    variables = held_variables(ds)
    further = sorted(variables) if tuple(layers) == (ALL,) else layers
    for name in [*held_metrics(ds, costs_only=False), *further]:
        summaries = (*SERIES, HIGHEST)
        candidates = [name] if name in variables else [f"{name}_{what}" for what in summaries]
        known = [candidate for candidate in candidates if candidate in variables]
        if not known:
            one_of("layer", name, sorted({*variables, ALL}))  # raises InputError
        names += known
    return list(dict.fromkeys(names))


class _Layer(NamedTuple):
    """One GeoTIFF.

    Attributes:
      file: its name.
      name: of the variable.
      place: along the variable's axes before y and x.
      dtype: of the file's values.
      is_averaged, is_inf_missing: see `jaxurban.metrics.base.Variable`.
      tags: what the file says.
    """

    file: str
    name: str
    place: tuple[int, ...]
    dtype: np.dtype
    is_averaged: bool
    is_inf_missing: bool
    tags: dict[str, str]

    @property
    def title(self) -> str:
        """What the band is called in QGIS: the variable, its altitude and its times, where it has them."""
        words = [self.tags.get("long_name", self.name)]
        if "altitude_m" in self.tags:
            words.append(f"{self.tags['altitude_m']} m above ground")
        words += [self.tags[name] for name in ("time_of_day", "time") if name in self.tags]
        return ", ".join(words)


def _layers(ds: xr.Dataset, layers: Sequence[str]) -> Iterator[_Layer]:
    """Yield what goes into each GeoTIFF of a dataset: a file for each place along a variable's axes before y and x.

    Such an axis is an altitude, a time of day or a time. A variable without any of them has one file.

    Args:
      ds: the maps; their values are not read.
      layers: as of `geotiff_names`, whose errors are raised.
    """
    # What all files share.
    resolution = f"{short_number(ds.attrs['resolution_m'])}m"
    times = [f"{time}Z" for time in np.datetime_as_string(ds["time"].values, unit="s")]
    common = {"credit": ds.attrs[CREDIT]} if CREDIT in ds.attrs else {}
    metrics = held_metrics(ds, costs_only=False)
    variables = held_variables(ds)
    for name in geotiff_names(ds, layers):
        # What all files of a variable share. A summary over times, such as `gps_mean`, begins with its metric's name.
        metric = metrics.get(name.rpartition("_")[0])
        array = ds[name]
        texts = {key: str(array.attrs[key]) for key in TEXTS if key in array.attrs}
        is_of_bytes = array.dtype in (np.bool_, np.uint8)

        # A file for each place: parts of its name and tags for each axis that the variable has.
        for place in np.ndindex(array.shape[:-2]):
            index = dict(zip(array.dims[:-2], place, strict=True))  # by axis
            parts = [name]
            tags = {"metric": name, **texts, **common}
            if ALTITUDE in index:
                tags["altitude_m"] = short_number(float(ds["altitude"][index[ALTITUDE]]))
                tags["altitude_reference"] = "above ground"
                parts.append(f"{tags['altitude_m']}m")
            if TIME_OF_DAY in index:
                tags["time_of_day"] = str(ds["time_of_day"].values[index[TIME_OF_DAY]])
                parts.append(tags["time_of_day"])
                for norm in ("pop_norm_per_km2", "pop_norm_per_block"):
                    if name == "population" and norm in ds.attrs:  # of m = 1 at this time of day
                        tags[norm] = repr(float(ds.attrs[norm][index[TIME_OF_DAY]]))
            if TIME in index:
                tags["time"] = times[index[TIME]]
                if len(times) > 1:
                    parts.append(tags["time"].replace("-", "").replace(":", ""))
            elif metric is not None and TIME in metric.dims:  # a summary over all times
                tags |= {"time": f"{times[0]}/{times[-1]}", "num_times": str(len(times))}
            if "time" in tags and "constellations" in ds.attrs:
                tags["constellation"] = ds.attrs["constellations"]
            yield _Layer(
                file="_".join((*parts, f"{resolution}.tif")),
                name=name,
                place=place,
                dtype=np.dtype(np.uint8 if is_of_bytes else np.float32),
                is_averaged=variables[name].is_averaged,
                is_inf_missing=variables[name].is_inf_missing,
                tags=tags,
            )


def _styles(ds: xr.Dataset, layers: Sequence[str]) -> dict[str, str]:
    """Return the name of the variable of each QGIS style, by the name of the style's file; arguments as `_layers`."""
    resolution = short_number(ds.attrs["resolution_m"])
    return {f"{name}_{resolution}m.qml": name for name in geotiff_names(ds, layers)}


def geotiff_paths(ds: xr.Dataset, folder: Path, layers: Sequence[str]) -> list[Path]:
    """Return where the GeoTIFFs and styles of maps go; arguments as for `write_geotiffs`."""
    names = [*(layer.file for layer in _layers(ds, layers)), *_styles(ds, layers)]
    return [folder / GEOTIFF_FOLDER / name for name in names]


def write_geotiffs(
    ds: xr.Dataset,
    folder: Path,
    each: Each = map,
    only: Collection[Path] | None = None,
    layers: Sequence[str] = (),
) -> list[Path]:
    """Write maps as cloud-optimised GeoTIFF (ZSTD, north-up), and the QGIS style of each variable.

    Values are float32 with NaN as no data, or uint8 with 255 as no data, which stands where nothing is known of a cell.

    Args:
      ds: the maps; read some rows at a time, so that they need not fit in memory.
      folder: files go to its ``geotiff`` folder.
      each: calls a function with each of many layers, as `map` does, or on several threads.
      only: the files to write; left out, all.
      layers: variables that are written beside obstacles and the metrics; ``("all",)``: every one.

    Returns:
      The files written.

    Raises:
      InputError: a layer that the maps do not hold, or a folder that cannot be written to.
    """
    home = folder / GEOTIFF_FOLDER
    grid = grid_of(ds)

    def write(layer: _Layer) -> None:
        """Write one GeoTIFF, whole or not at all; InputError where it cannot be written."""
        with whole_file(home / layer.file) as scratch:
            write_cog(
                scratch,
                grid,
                layer.dtype,
                _parts(ds, layer),
                # The mean of two classes is no class.
                is_averaged=layer.is_averaged and layer.dtype == np.float32,
                tags=layer.tags,
                title=layer.title,
                unit=layer.tags.get("units", ""),
            )

    chosen = [each for each in _layers(ds, layers) if only is None or home / each.file in only]
    for _ in each(write, chosen):  # `map` writes nothing until its results are taken
        pass
    written = [home / layer.file for layer in chosen]

    # The styles.
    for file, name in _styles(ds, layers).items():
        if only is None or home / file in only:
            write_whole(home / file, style(ds, name))
            written.append(home / file)
    return written


def _parts(ds: xr.Dataset, layer: _Layer) -> Iterator[np.ndarray]:
    """Yield a map ``[y, x]`` in parts of two blocks' rows, from the north to the south, as `write_cog` takes them.

    Cells without data hold what stands for no value; the map of where data are is written as it stands.
    """
    for stop in range(ds.sizes["y"], 0, -2 * BLOCK):
        rows = slice(max(0, stop - 2 * BLOCK), stop)  # counted from the south
        values = ds.variables[layer.name][(*layer.place, rows)].values[::-1].astype(layer.dtype)
        if layer.name != "has_data":
            has_data = ds.variables["has_data"][rows].values[::-1]
            np.copyto(values, no_value(layer.dtype), where=~has_data)
        if layer.is_inf_missing:
            np.copyto(values, no_value(layer.dtype), where=np.isinf(values))
        yield values


@contextmanager
def _writing(folder: str, num_bytes: int) -> Iterator[None]:
    """Raise OSError where GDAL fails; rasterio has no public class for all that it raises then.

    GDAL does not say that the disk is full, so that the system is asked, by as many bytes in the folder as it may need.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, SystemError) or type(error).__module__.partition(".")[0] == "rasterio":
            with TemporaryFile(dir=folder) as file:
                file.write(bytes(num_bytes))  # of zeros, which take no memory
            raise OSError(f"GDAL could not write it ({error})") from error
        raise


def missing_geotiffs(ds: xr.Dataset, folder: Path) -> list[Path]:
    """Return the paths of the GeoTIFFs and styles of obstacles and metrics at which no file is, or an empty one."""
    return [
        path
        for path in geotiff_paths(ds, folder, ())
        if not (path.is_file() and path.stat().st_size)
    ]


def raster_profile(grid: Grid, dtype: np.dtype) -> dict[str, Any]:
    """Return the arguments by which rasterio opens a new GeoTIFF of one band on a grid.

    It is tiled and north-up, and ``nodata`` is what stands for no value in maps of this dtype.
    """
    return {
        "driver": "GTiff",
        "width": grid.num_cols,
        "height": grid.num_rows,
        "count": 1,
        "dtype": dtype,
        "crs": grid.crs,
        "transform": Affine(
            grid.resolution_m, 0, grid.x_min_m, 0, -grid.resolution_m, grid.y_max_m
        ),
        "nodata": no_value(dtype),
        "tiled": True,
        "bigtiff": "IF_SAFER",
    }


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
      dtype: of its values; what stands for no value is `jaxurban.metrics.variables.no_value`.
      rows: parts ``[y, x]`` of the map, all its rows from the north to the south; each but the last has a multiple of
        `BLOCK` rows, as GDAL writes a block that is full once.
      is_averaged: whether overviews hold means of the cells that they cover, NaN left out, else the nearest cell.
      tags: of the file.
      title: of its band.
      unit: of its values.

    Raises:
      OSError: the file cannot be written.
    """
    # Overviews go through a scratch file of GDAL's own, on which Zstandard would spend a third of all time; without
    # compression GDAL chooses other cells as the nearest.
    quick = rasterio.Env(COG_TMP_COMPRESSION="PACKBITS")
    with (
        quick,
        TemporaryDirectory(SCRATCH_SUFFIX, ".plain.", path.parent) as folder,
        _writing(folder, 2 * grid.num_rows * grid.num_cols * dtype.itemsize),
    ):
        plain = Path(folder) / "plain.tif"
        row = 0
        with rasterio.open(
            plain, "w", **raster_profile(grid, dtype), blockxsize=BLOCK, blockysize=BLOCK
        ) as file:
            for part in rows:
                file.write(part, 1, window=Window(0, row, part.shape[1], len(part)))
                row += len(part)
            file.update_tags(**tags)
            file.set_band_description(1, title)
            file.set_band_unit(1, unit)
        copy_raster(
            plain,
            path,
            driver="COG",
            overview_resampling="average" if is_averaged else "nearest",
            num_threads=1,
            compress="ZSTD",
            level=LEVEL,
            predictor="NO",
            blocksize=BLOCK,
            bigtiff="IF_SAFER",
        )
        # GDAL does not report every disk that fills up; the map is the file's end.
        with rasterio.open(path) as file:
            for _, window in file.block_windows(1):
                file.read(1, window=window)


def ramp_of(ds: xr.Dataset, variable: Variable) -> tuple[np.ndarray, list[str]]:
    """Return `NUM_PLACES` ascending values of a variable and their colours, ``#rrggbb``, to be linear in between.

    The maps' values are read only if the range of the variable's scale depends on them.
    """
    import matplotlib
    from matplotlib.colors import to_hex

    scale = variable.scale
    places = np.linspace(0, 1, NUM_PLACES)  # along the colour map
    low, span = scale.range(ds.attrs, lambda: _ends(ds, variable.name))
    # Where on the scale these colours stand; a logarithmic one spans a factor of 1,000.
    shares = {"linear": places, "sqrt": places**2, "log": 1000 ** (places - 1)}[scale.stretch]
    colours = matplotlib.colormaps[scale.colour_map](places)
    return low + span * shares, list(map(to_hex, colours))


def _ends(ds: xr.Dataset, name: str) -> tuple[float, float]:
    """Return the lowest and the highest finite value of a variable, 0 and 0 without any.

    One layer is read at a time, so that the variable need not fit in memory.
    """
    ends: list[float] = []
    for index in np.ndindex(ds[name].shape[:-2]):
        values = ds[name].variable[index].values
        values = values[np.isfinite(values)]
        if values.size:
            ends += [float(values.min()), float(values.max())]
    return min(ends, default=0.0), max(ends, default=0.0)


def style(ds: xr.Dataset, name: str) -> str:
    """Return the QGIS style of a variable of maps, the text of a QML file.

    Args:
      ds: the maps.
      name: of the variable; one of classes gets a palette, any other a colour ramp (see `ramp_of`).
    """
    variable = held_variables(ds)[name]
    if variable.classes:
        entries = "".join(
            f'<paletteEntry value="{value}" color="{colour}" alpha="255" label={quoteattr(label)}/>'
            for value, (label, colour) in enumerate(variable.classes)
        )
        renderer = f'type="paletted"><rasterTransparency/><colorPalette>{entries}</colorPalette>'
    else:
        values, colours = ramp_of(ds, variable)
        low, *_, high = values.tolist()
        items = "".join(
            f'<item value="{value!r}" color="{colour}" alpha="255" label="{value:.4g}"/>'
            for value, colour in zip(values.tolist(), colours, strict=True)
        )
        renderer = (
            f'type="singlebandpseudocolor" classificationMin="{low!r}" classificationMax="{high!r}">'
            '<rasterTransparency/><rastershader><colorrampshader colorRampType="INTERPOLATED" classificationMode="1" '
            f'clip="0" minimumValue="{low!r}" maximumValue="{high!r}">{items}</colorrampshader></rastershader>'
        )
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        f'<qgis version="3.28.0" styleCategories="Symbology">\n<pipe>\n'
        f'<rasterrenderer band="1" opacity="1" alphaBand="-1" nodataColor="" {renderer}</rasterrenderer>\n'
        "</pipe>\n<blendMode>0</blendMode>\n</qgis>\n"
    )
