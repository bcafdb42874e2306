"""The values of cost layers of one's own on the cells of maps, from rasters and arrays."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.sampling import resample_raster
from jaxurban.metrics.custom import Layer
from jaxurban.world.city import Raster
from jaxurban.world.grid import Grid

Bands = tuple[Raster | np.ndarray, ...]


def bands_of(
    layers: Mapping[str, Layer], region: Grid, altitudes_m: Sequence[float], folder: Path | None = None
) -> dict[str, Bands]:
    """Return the bands of every layer that is a raster or an array, by name: one, or one for each flight altitude.

    Args:
      layers: by name.
      region: grid of the maps; of a raster file the part around it is read, and arrays have its shape.
      altitudes_m: of flight.
      folder: that a raster's relative path is relative to; left out, the working folder.

    Raises:
      InputError: a file that cannot be read, another number of bands or another shape than needed, or no band for an
        altitude.
    """
    return {
        name: _bands(name, layer, region, altitudes_m, folder or Path())
        for name, layer in layers.items()
        if not callable(layer.source)
    }


def _bands(name: str, layer: Layer, region: Grid, altitudes_m: Sequence[float], folder: Path) -> Bands:
    num = 1 if layer.altitudes_m is None else len(layer.altitudes_m)
    bands: Sequence[Raster | np.ndarray]
    if isinstance(layer.source, str):
        from jaxurban.io.read.raster import read_bands  # GDAL loads for files alone

        bands = read_bands(folder / layer.source, region.crs, region.bounds_m)
    else:
        given = np.ma.asarray(layer.source)  # what is masked holds no value
        if given.dtype.kind not in "biuf":
            raise InputError(f"layer {name!r} must be an array of real numbers, got {given.dtype}")
        values = np.ma.filled(given.astype(np.float32), np.nan)
        values[np.isinf(values)] = np.nan  # as in a raster
        bands = list(values if values.ndim == 3 else values[None])
        if values.ndim > 3 or values.shape[-2:] != region.shape:
            raise InputError(
                f"layer {name!r} has values of shape {values.shape} for maps of {region.num_rows} x {region.num_cols} "
                "cells: give one value for each cell, rows south to north"
            )
    if len(bands) != num:
        raise InputError(
            f"layer {name!r} has {len(bands)} band{'s' * (len(bands) > 1)} for {num} "
            f"altitude{'s' * (num > 1)}: name the altitude of each band in altitudes_m, or give one band for all"
        )
    if layer.altitudes_m is None:
        return tuple(bands)
    held = dict(zip(layer.altitudes_m, bands, strict=True))
    if lost := [z_m for z_m in altitudes_m if z_m not in held]:
        raise InputError(
            f"layer {name!r} has no band for {lost[0]:g} m, only for {', '.join(f'{z_m:g}' for z_m in held)} m: add "
            "one, or leave altitudes_m out and give one band for all altitudes"
        )
    return tuple(held[z_m] for z_m in altitudes_m)


def layer_values(bands: Bands, part: Grid, region: Grid, altitude: int | None = None) -> np.ndarray:
    """Return a layer's values ``[y, x]`` float32 on a part of the region, NaN beyond it and where there are none.

    Rasters are interpolated between pixel centres; every cell depends on its own place alone.

    Args:
      bands: from `bands_of`.
      part: may stick out of the region, as the last tiles do.
      region: grid of the maps.
      altitude: which of the flight altitudes; None where one band serves all.
    """
    band = bands[altitude or 0]
    if isinstance(band, Raster):
        return resample_raster(band, part, "bilinear")
    row, col = part.first_row - region.first_row, part.first_col - region.first_col
    south, west = max(-row, 0), max(-col, 0)  # rows and columns of the part before the region begins
    inside = band[max(row, 0) : max(row + part.num_rows, 0), max(col, 0) : max(col + part.num_cols, 0)]
    values = np.full(part.shape, np.nan, np.float32)
    values[south : south + inside.shape[0], west : west + inside.shape[1]] = inside
    return values
