"""Rasters from files: building heights and terrain, read where they are needed and sampled onto a Grid."""

import itertools
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import pyproj
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from jaxurban.city import Raster
from jaxurban.errors import InputError
from jaxurban.grid import Bounds, Grid, transformer

Resampling = Literal["nearest", "bilinear", "max"]

TERRAIN_LIMITS_M = (-500.0, 9000.0)  # the shore of the Dead Sea lies at -430 m, the top of Everest at 8,849 m
_MARGIN_PIXELS = 2  # bilinear sampling reaches half a pixel beyond the bounds, a curved border a little more
_ROWS_AT_ONCE = 256  # bounds the memory that coordinates take
_INSIDE = 0.5 - 1e-6  # of a cell: a pixel that only shares the cell's border is not touched


def read_raster(
    path: str | Path, crs: str, bounds_m: Bounds | None = None, *, limits_m: tuple[float, float] = TERRAIN_LIMITS_M
) -> Raster:
    """Return a single-band raster file, or the part of it that covers some bounds.

    The file's scale and offset are applied. Cells that it declares empty (by a nodata value or a mask) are NaN.

    Args:
      path: a single-band file that GDAL reads, with a CRS, in metres.
      crs: projected CRS of ``bounds_m``.
      bounds_m: x_min, y_min, x_max, y_max; the window is two pixels wider on each side. None: the whole file.
      limits_m: a value beyond these is no height but, most likely, an undeclared nodata value.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the
        bounds, or holds values that are not finite or beyond the limits and not declared empty.
    """
    name = repr(str(path))
    with _open(path) as source:
        window = _window(name, source, crs, bounds_m)
        stored = source.read(1, window=window)
        is_empty = source.read_masks(1, window=window) == 0
        values = np.where(is_empty, np.nan, stored * source.scales[0] + source.offsets[0]).astype(np.float32)
        transform, raster_crs = source.transform, source.crs.to_string()
    if num_bad := int(np.sum(~np.isfinite(stored) & ~is_empty)):
        raise InputError(
            f"{name} holds {num_bad} cells that are NaN or infinite and not declared as nodata: fill them, or declare "
            "NaN with `gdal_edit.py -a_nodata nan`"
        )
    if num_bad := int(np.sum((values < limits_m[0]) | (values > limits_m[1]))):
        raise InputError(
            f"{name} holds {num_bad} cells outside {limits_m[0]:g} to {limits_m[1]:g} m: declare their value as nodata "
            "with `gdal_edit.py -a_nodata VALUE`, or convert the heights to metres"
        )
    return Raster(values, tuple(transform)[:6], raster_crs, int(window.row_off), int(window.col_off))


def raster_extent_m(path: str | Path, crs: str) -> Bounds:
    """Return x_min, y_min, x_max, y_max in ``crs`` of the box around a raster file.

    Raises:
      InputError: as for `read_raster`.
    """
    with _open(path) as source:
        col, row = np.array([0, source.width, 0, source.width]), np.array([0, 0, source.height, source.height])
        x, y = _apply(source.transform, col, row)
        to_city = transformer(source.crs.to_string(), crs)
    x_min, y_min, x_max, y_max = to_city.transform_bounds(x.min(), y.min(), x.max(), y.max())
    return x_min, y_min, x_max, y_max


@contextmanager
def _open(path: str | Path) -> Iterator[rasterio.DatasetReader]:
    """Open a raster whose kind is right; every failure of reading it in the block is an InputError."""
    name = repr(str(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # said better below
            with rasterio.open(path) as source:
                if source.count != 1:
                    raise InputError(f"{name} has {source.count} bands: give a raster with one band, heights in metres")
                if np.dtype(source.dtypes[0]).kind not in "iuf":
                    raise InputError(f"{name} holds {source.dtypes[0]} values: give real numbers, heights in metres")
                if source.crs is None or source.transform == Affine.identity():
                    raise InputError(
                        f"{name} has no CRS or no position: set them with `gdal_edit.py -a_srs EPSG:... -a_ullr ...`"
                    )
                yield source
    except RasterioError as error:
        reason = " ".join(str(error).split())  # some libraries' messages have several lines
        raise InputError(f"{name} cannot be read as a raster ({reason}): give a file that GDAL opens") from error


def _apply(transform: Affine, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return transformed coordinates (the operator for it changed between versions of affine)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * first + b * second + c, d * first + e * second + f


def _window(name: str, source: rasterio.DatasetReader, crs: str, bounds_m: Bounds | None) -> Window:
    """Return the window of pixels that covers ``bounds_m``, cut to the raster."""
    if bounds_m is None:
        return Window(0, 0, source.width, source.height)
    x_m, y_m = (np.linspace(low, high, 22) for low, high in zip(bounds_m[:2], bounds_m[2:], strict=True))
    border_x_m, border_y_m = (v.ravel() for v in np.meshgrid(x_m, y_m))
    x, y = transformer(crs, source.crs.to_string()).transform(border_x_m, border_y_m)
    col, row = _apply(~source.transform, x, y)
    if np.all(np.isfinite(col) & np.isfinite(row)):
        first_col, first_row = (max(0, math.floor(v.min()) - _MARGIN_PIXELS) for v in (col, row))
        end_col = min(source.width, math.ceil(col.max()) + _MARGIN_PIXELS)
        end_row = min(source.height, math.ceil(row.max()) + _MARGIN_PIXELS)
        if first_col < end_col and first_row < end_row:
            return Window(first_col, first_row, end_col - first_col, end_row - first_row)
    raise InputError(f"{name} does not reach the region: give a raster that covers it, or change [region] bounds")


def resample_raster(raster: Raster, grid: Grid, how: Resampling = "nearest") -> np.ndarray:
    """Return a raster's values on a grid, ``[Y, X]`` float32, row 0 in the south; NaN without data.

    Every cell is computed from its own coordinates alone, so that a sub-box equals the crop of a larger grid bit
    for bit. GDAL's warper does not give that: it interpolates coordinates and scales kernels by the window (tried on
    Bilbao's buildings into the neighbouring UTM zone: 71 of 93,300 cells of a crop differed by ``nearest``).

    Args:
      raster: what `read_raster` gave.
      grid: in any CRS.
      how: ``"nearest"``, the pixel that holds the cell's centre: for heights, as outlines are rasterised at
        cell centres (an average would invent roofs that no building has). ``"max"``, the highest pixel that the cell
        touches: for heights on the cautious side; looks at points at most a pixel apart, so a pixel that reaches
        into the cell by a corner only may be missed. ``"bilinear"``, between pixel centres: for terrain; pixels
        without data get no weight, and the result is NaN where the pixel that holds the centre has none.
    """
    to_raster, to_pixel = transformer(grid.crs, raster.crs), ~Affine(*raster.transform)
    points = np.linspace(-_INSIDE, _INSIDE, _points_a_side(grid, to_raster, to_pixel)) if how == "max" else np.zeros(1)
    sample = _bilinear if how == "bilinear" else _nearest
    values = np.full(grid.shape, np.nan, np.float32)
    for start in range(0, grid.num_rows, _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        for dy_m, dx_m in itertools.product(points * grid.resolution_m, repeat=2):
            x_m, y_m = np.meshgrid(grid.x_m + dx_m, grid.y_m[rows] + dy_m)
            with np.errstate(invalid="ignore"):  # PROJ gives infinity beyond a projection's reach
                col, row = _apply(to_pixel, *to_raster.transform(x_m, y_m))
                values[rows] = np.fmax(values[rows], sample(raster, row, col))
    return values


def _points_a_side(grid: Grid, to_raster: pyproj.Transformer, to_pixel: Affine) -> int:
    """Return how many points along a cell's side look at every pixel, one more than a power of two.

    Measured at the file's first pixel, so that it is the same for every part of a larger grid.
    """
    x_m, y_m = to_raster.transform(*_apply(~to_pixel, np.zeros(()), np.zeros(())), direction="INVERSE")
    east_m, north_m = grid.resolution_m * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    col, row = _apply(to_pixel, *to_raster.transform(x_m + east_m, y_m + north_m))
    pixels_a_side = max(float(np.abs(v[1:] - v[0]).max()) for v in (col, row))
    return 1 + 2 ** max(0, math.ceil(math.log2(pixels_a_side) - 1e-6))


def _pixels(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the values of pixels by the file's whole rows and columns, NaN outside the raster (float64)."""
    row, col = row - raster.first_row, col - raster.first_col
    # Written this way round so that a coordinate that PROJ could not transform (infinite) is outside.
    is_inside = (row >= 0) & (row < raster.values.shape[0]) & (col >= 0) & (col < raster.values.shape[1])
    values = np.full(row.shape, np.nan)
    values[is_inside] = raster.values[row[is_inside].astype(np.intp), col[is_inside].astype(np.intp)]
    return values


def _nearest(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    return _pixels(raster, np.floor(row), np.floor(col))


def _bilinear(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    low_row, low_col = np.floor(row - 0.5), np.floor(col - 0.5)
    along_row, along_col = row - 0.5 - low_row, col - 0.5 - low_col
    total, weights = np.zeros(row.shape), np.zeros(row.shape)
    for down, row_weight in ((0, 1 - along_row), (1, along_row)):
        for right, col_weight in ((0, 1 - along_col), (1, along_col)):
            pixel = _pixels(raster, low_row + down, low_col + right)
            weight = np.where(np.isnan(pixel), 0.0, row_weight * col_weight)
            total += weight * np.nan_to_num(pixel)
            weights += weight
    has_data = ~np.isnan(_nearest(raster, row, col))
    return np.where(has_data, total, np.nan) / np.where(has_data, weights, 1.0)
