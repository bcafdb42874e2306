"""Rasters from files: building heights and terrain, read where they are needed and sampled onto a Grid."""

import itertools
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyproj
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from jaxurban.errors import InputError, reason_of
from jaxurban.world.city import Raster
from jaxurban.world.grid import Bounds, Grid, check_on_earth, transformer

Resampling = Literal["nearest", "bilinear", "max"]

RASTER_SUFFIXES = (".tif", ".tiff", ".vrt", ".asc", ".img")
OWN_VALUES = "in a unit of your own"
TERRAIN_RANGE_M = (-500.0, 9000.0)  # the shore of the Dead Sea lies at -430 m, the top of Everest at 8,849 m
_MARGIN_PIXELS = 2  # bilinear sampling reaches half a pixel beyond the bounds, a curved border a little more
_ROWS_AT_ONCE = 256  # bounds the memory that coordinates take
MOST_PIXEL = 1e16  # area of a pixel, in its CRS's units: of a millionth of a metre to the Earth's
_EDGE = 1e-6  # of a pixel: nearer than this a point lies on a border, and what overlaps by less only touches it

# What a file may call its vertical unit (lower case), in metres.
_METRES = dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0)
_FEET = dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048)
_SURVEY_FEET = dict.fromkeys(
    ("us-ft", "ftus", "us survey foot", "us survey feet", "foot_us", "us foot", "survey foot"), 1200 / 3937
)
UNITS_M = {**_METRES, **_FEET, **_SURVEY_FEET}


def read_raster(
    path: str | Path, crs: str, bounds_m: Bounds | None = None, *, range_m: tuple[float, float] = TERRAIN_RANGE_M
) -> Raster:
    """Return a single-band raster file, or the part of it that covers some bounds.

    The file's scale and offset are applied, then its vertical unit: that of the band, or of a CRS with a vertical axis
    (see `UNITS_M`); without any, values are metres. Cells that it declares empty (by a nodata value or a mask) are NaN.

    Args:
      path: a single-band file that GDAL reads, with a CRS.
      crs: projected CRS of ``bounds_m``.
      bounds_m: x_min, y_min, x_max, y_max; the window is two pixels wider on each side. None: the whole file.
      range_m: a value beyond these is not a height but, most likely, an undeclared nodata value.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the
        bounds, holds values that are not finite or beyond the limits and not declared empty, or whose vertical unit
        is unknown: a name that is none, two that differ, or a CRS in feet that says nothing of heights.
    """
    name = repr(str(path))
    with open_raster(path) as source:
        unit_m = _unit_m(name, source)
        window = raster_window(name, source, crs, bounds_m)
        stored = source.read(1, window=window)
        is_empty = source.read_masks(1, window=window) == 0
        values = stored * source.scales[0] + source.offsets[0]
        if unit_m != 1.0:
            values = values * unit_m
        values = np.where(is_empty, np.nan, values).astype(np.float32)
        transform, raster_crs = source.transform, _horizontal_crs(source)
    if num_bad := int(np.sum(~np.isfinite(stored) & ~is_empty)):
        raise InputError(
            f"{name} holds {num_bad} cells that are NaN or infinite and not declared as nodata: fill them, or declare "
            "NaN with `gdal_edit.py -a_nodata nan`"
        )
    check_range(name, values, range_m)
    return Raster(values, tuple(transform)[:6], raster_crs, int(window.row_off), int(window.col_off))


def read_bands(path: str | Path, crs: str, bounds_m: Bounds | None = None) -> list[Raster]:
    """Return every band of a raster of values in a unit of their own, NaN where it has none; arguments as above.

    The file's scales and offsets are applied.

    Raises:
      InputError: a file that cannot be read, has no CRS or no position, or does not reach the bounds.
    """
    name = repr(str(path))
    with open_raster(path, OWN_VALUES) as source:
        window = raster_window(name, source, crs, bounds_m)
        scale, offset = (np.array(values)[:, None, None] for values in (source.scales, source.offsets))
        values = source.read(window=window) * scale + offset
        is_empty = (source.read_masks(window=window) == 0) | ~np.isfinite(values)
        transform, raster_crs = tuple(source.transform)[:6], _horizontal_crs(source)
    first = int(window.row_off), int(window.col_off)
    return [
        Raster(band.astype(np.float32), transform, raster_crs, *first) for band in np.where(is_empty, np.nan, values)
    ]


def check_range(name: str, values: np.ndarray, range_m: tuple[float, float]) -> None:
    """Raise InputError if a raster holds values beyond the limits."""
    if num_bad := int(np.sum((values < range_m[0]) | (values > range_m[1]))):
        raise InputError(
            f"{name} holds {num_bad} cells outside {range_m[0]:g} to {range_m[1]:g} m: declare their value as nodata "
            "with `gdal_edit.py -a_nodata VALUE`, or convert the heights to metres"
        )


def raster_extent_m(path: str | Path, crs: str) -> Bounds:
    """Return x_min, y_min, x_max, y_max in ``crs`` of the box around a raster file.

    Raises:
      InputError: as for `read_raster`.
    """
    with open_raster(path) as source:
        col, row = np.array([0, source.width, 0, source.width]), np.array([0, 0, source.height, source.height])
        x, y = _apply(source.transform, col, row)
        to_city = transformer(_horizontal_crs(source), crs)
    x_min, y_min, x_max, y_max = to_city.transform_bounds(x.min(), y.min(), x.max(), y.max())
    return x_min, y_min, x_max, y_max


@contextmanager
def open_raster(path: str | Path, holds: str = "heights in metres") -> Iterator[rasterio.DatasetReader]:
    """Open a raster whose kind is right; every failure of reading it in the block is an InputError.

    Args:
      path: of the file.
      holds: what its values are; several bands are for values of one's own only.
    """
    name = repr(str(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # said better below
            with rasterio.open(path) as source:
                if source.count != 1 and holds != OWN_VALUES:
                    raise InputError(f"{name} has {source.count} bands: give a raster with one band, {holds}")
                if np.dtype(source.dtypes[0]).kind not in "iuf":
                    raise InputError(f"{name} holds {source.dtypes[0]} values: give real numbers, {holds}")
                if source.crs is None or source.transform == Affine.identity():
                    raise InputError(
                        f"{name} has no CRS or no position: set them with `gdal_edit.py -a_srs EPSG:... -a_ullr ...`"
                    )
                pixel_area = source.transform.determinant
                if not (np.isfinite(source.transform).all() and MOST_PIXEL > abs(pixel_area) > 1 / MOST_PIXEL):
                    raise InputError(
                        f"{name} has pixels without area, or beyond all measure, by its geotransform "
                        f"{source.transform[:6]}: set its position with `gdal_edit.py -a_ullr ...`"
                    )
                check_on_earth(name, source.crs.to_wkt())
                yield source
    except RasterioError as error:
        remedy = "give a file that GDAL opens"
        raise InputError(f"{name} cannot be read as a raster ({reason_of(error)}): {remedy}") from error


def _horizontal_crs(source: rasterio.DatasetReader) -> str:
    """Return a file's CRS without its vertical axis."""
    name = source.crs.to_string()
    crs = pyproj.CRS(name)
    return crs.sub_crs_list[0].to_wkt() if crs.is_compound else name


def _unit_m(name: str, source: rasterio.DatasetReader) -> float:
    """Return the metres in one unit of a file's heights.

    Raises:
      InputError: it is not known.
    """
    remedy = "say which with `gdal_edit.py -units m` (or ft, or 'US survey foot')"
    written = source.units[0]
    if written and written.strip().lower() not in UNITS_M:
        raise InputError(f"{name} gives its heights in {written!r}, a unit that is not known here: {remedy}")
    of_band = UNITS_M[written.strip().lower()] if written else None
    axes = pyproj.CRS(source.crs.to_wkt()).axis_info
    of_axis = next((axis.unit_conversion_factor for axis in axes[2:] if axis.direction == "up"), None)
    if of_band is not None and of_axis is not None and abs(of_band - of_axis) > 1e-9:
        raise InputError(f"{name} gives its heights in {written!r} but its CRS in units of {of_axis:.7g} m: {remedy}")
    known_m = of_band if of_band is not None else of_axis
    if known_m is None and source.crs.is_projected and abs(axes[0].unit_conversion_factor - 1.0) > 1e-9:
        raise InputError(
            f"{name} is in {axes[0].unit_name} on the ground and does not say whether its heights are too: {remedy}"
        )
    return 1.0 if known_m is None else known_m


def _apply(transform: Affine, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return transformed coordinates (the operator for it changed between versions of affine)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * first + b * second + c, d * first + e * second + f


def raster_window(name: str, source: rasterio.DatasetReader, crs: str, bounds_m: Bounds | None) -> Window:
    """Return the window of pixels that covers ``bounds_m``, cut to the raster."""
    if bounds_m is None:
        return Window(0, 0, source.width, source.height)
    x_m, y_m = (np.linspace(low, high, 22) for low, high in zip(bounds_m[:2], bounds_m[2:], strict=True))
    border_x_m, border_y_m = (v.ravel() for v in np.meshgrid(x_m, y_m))
    x, y = transformer(crs, _horizontal_crs(source)).transform(border_x_m, border_y_m)
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
        cell centres (an average would invent roofs that no building has). A centre on a border between pixels, as
        every one is where a cell's side is an even number of pixels, is held by all of them, and the highest counts:
        to take always the one on the same side shifts the map by half a pixel. ``"max"``, the highest of all pixels
        that overlap the cell: for heights on the cautious side. ``"bilinear"``, between pixel centres: for terrain;
        pixels without data get no weight, and the result is NaN where the pixel that holds the centre has none.
    """
    sample = _bilinear if how == "bilinear" else _nearest
    # The centre, or the corners, once around the cell.
    points = [(-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)] if how == "max" else [(0.0, 0.0)]
    to_raster, to_pixel = transformer(grid.crs, raster.crs), ~Affine(*raster.transform)
    values = np.full(grid.shape, np.nan, np.float32)
    for start in range(0, grid.num_rows, _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        row, col = np.empty((2, len(points), *values[rows].shape))
        for i, (up, right) in enumerate(points):
            x_m, y_m = np.meshgrid(grid.x_m + right * grid.resolution_m, grid.y_m[rows] + up * grid.resolution_m)
            with np.errstate(invalid="ignore"):  # PROJ gives infinity beyond a projection's reach
                col[i], row[i] = _apply(to_pixel, *to_raster.transform(x_m, y_m))
        values[rows] = _highest(raster, row, col) if how == "max" else sample(raster, row[0], col[0])
    return values


def pixel_xy(raster: Raster, row: np.ndarray, col: np.ndarray, crs: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates in ``crs`` of places in a raster, by rows and columns of its values (0.5: a centre)."""
    x, y = _apply(Affine(*raster.transform), col + raster.first_col, row + raster.first_row)
    return transformer(raster.crs, crs).transform(x, y)


def thinned(raster: Raster, most_pixels: int) -> Raster:
    """Return every k-th pixel of every k-th row, as pixels around the same centres: about ``most_pixels`` of them."""
    k = max(1, math.ceil(math.sqrt(raster.values.size / most_pixels)))
    a, b, c, d, e, f = raster.transform
    col, row = raster.first_col + 0.5 - k / 2, raster.first_row + 0.5 - k / 2
    transform = a * k, b * k, a * col + b * row + c, d * k, e * k, d * col + e * row + f
    return Raster(raster.values[::k, ::k], transform, raster.crs)


def heights_above(surface: Raster, ground: Raster) -> Raster:
    """Return a surface's height above the ground, on the surface's pixels; NaN where either is not known.

    Args:
      surface: elevation of roofs, trees and bare ground.
      ground: elevation of the ground, on any grid and in any CRS; taken between its pixel centres.
    """
    num_rows, num_cols = surface.values.shape
    to_pixel = ~Affine(*ground.transform)
    values = np.empty((num_rows, num_cols), np.float32)
    for start in range(0, num_rows, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, num_rows))
        col, row = np.meshgrid(np.arange(num_cols), np.arange(rows.start, rows.stop))
        with np.errstate(invalid="ignore"):
            ground_col, ground_row = _apply(to_pixel, *pixel_xy(surface, row + 0.5, col + 0.5, ground.crs))
        values[rows] = surface.values[rows] - _bilinear(ground, ground_row, ground_col)
    return replace(surface, values=values)


def _pixels(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the values of pixels by the file's whole rows and columns, NaN outside the raster (float64)."""
    row, col = row - raster.first_row, col - raster.first_col
    # Written this way round so that a coordinate that PROJ could not transform (infinite) is outside.
    is_inside = (row >= 0) & (row < raster.values.shape[0]) & (col >= 0) & (col < raster.values.shape[1])
    values = np.full(row.shape, np.nan)
    values[is_inside] = raster.values[row[is_inside].astype(np.intp), col[is_inside].astype(np.intp)]
    return values


def _nearest(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the highest of the pixels that hold a point: one, or up to four where it lies on their border."""
    values = _pixels(raster, np.floor(row), np.floor(col))
    with np.errstate(invalid="ignore"):
        is_tied = (np.abs(row - np.round(row)) < _EDGE) | (np.abs(col - np.round(col)) < _EDGE)
    for down, right in itertools.product((-_EDGE, _EDGE), repeat=2):
        pixel = _pixels(raster, np.floor(row[is_tied] + down), np.floor(col[is_tied] + right))
        values[is_tied] = np.fmax(values[is_tied], pixel)
    return values


def _highest(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the highest of all pixels that overlap cells, given the rows and columns of their corners, once around.

    Two convex shapes are apart where a line along a side of one of them has them on its two sides.
    """
    low_row, low_col = (np.floor(v.min(axis=0) + _EDGE) for v in (row, col))
    end_row, end_col = (np.ceil(v.max(axis=0) - _EDGE) for v in (row, col))
    along_row, along_col = np.roll(row, -1, 0) - row, np.roll(col, -1, 0) - col
    turn = np.sign(along_col[0] * along_row[1] - along_row[0] * along_col[1])  # which way the corners go around
    values = np.full(low_row.shape, np.nan)
    counts = (end - low for end, low in ((end_row, low_row), (end_col, low_col)))
    num_rows, num_cols = (int(np.max(count, where=np.isfinite(count), initial=0.0)) for count in counts)
    for down, right in itertools.product(range(num_rows), range(num_cols)):
        pixel_row, pixel_col = low_row + down, low_col + right
        overlaps = (pixel_row < end_row) & (pixel_col < end_col)
        for side_row, side_col, from_row, from_col in zip(along_row, along_col, row, col, strict=True):
            inward = turn * (side_col * (pixel_row + 0.5 - from_row) - side_row * (pixel_col + 0.5 - from_col))
            reach = (np.abs(side_row) + np.abs(side_col)) / 2  # of the pixel's corners from its centre
            overlaps &= inward + reach > _EDGE * np.hypot(side_row, side_col)
        values[overlaps] = np.fmax(values[overlaps], _pixels(raster, pixel_row[overlaps], pixel_col[overlaps]))
    return values


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
    has_data = ~np.isnan(_pixels(raster, np.floor(row), np.floor(col)))
    return np.where(has_data, total, np.nan) / np.where(has_data, weights, 1.0)
