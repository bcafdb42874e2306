"""Rasters on the cells of a Grid, and where their pixels lie; maps of outlines need no more of rasters than this."""

import itertools
from dataclasses import replace
from typing import Literal

import numpy as np
from affine import Affine

from jaxurban.world.grid import Grid, transformer
from jaxurban.world.raster import Raster

Resampling = Literal["nearest", "bilinear", "max"]

_ROWS_AT_ONCE = 256  # bounds the memory that coordinates take
_EDGE = 1e-6  # of a pixel: nearer than this a point lies on a border, and what overlaps by less only touches it


def transformed(
    transform: Affine, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return transformed coordinates (the operator for it changed between versions of affine)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * first + b * second + c, d * first + e * second + f


def resample_raster(raster: Raster, grid: Grid, method: Resampling = "nearest") -> np.ndarray:
    """Return a raster's values on a grid, ``[Y, X]`` float32, row 0 in the south; NaN without data.

    Every cell is computed from its own coordinates alone, so that a sub-box equals the crop of a larger grid bit
    for bit. GDAL's warper does not give that: it interpolates coordinates and scales kernels by the window (tried on
    Bilbao's buildings into the neighbouring UTM zone: 71 of 93,300 cells of a crop differed by ``nearest``).

    Args:
      raster: what `read_raster` gave.
      grid: in any CRS.
      method: ``"nearest"``, the pixel that holds the cell's centre: for heights, as outlines are rasterised at
        cell centres (an average would invent roofs that no building has). A centre on a border between pixels, as
        every one is where a cell's side is an even number of pixels, is held by all of them, and the highest counts:
        to take always the one on the same side shifts the map by half a pixel. ``"max"``, the highest of all pixels
        that overlap the cell: for heights on the cautious side. ``"bilinear"``, between pixel centres: for terrain;
        pixels without data get no weight, and the result is NaN where the pixel that holds the centre has none.
    """
    # The cell's centre, or its corners, once around; in cells from the centre, up and to the right.
    points = [(0.0, 0.0)]
    if method == "max":
        points = [(-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)]
    values = np.full(grid.shape, np.nan, np.float32)
    for start in range(0, grid.num_rows, _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        row, col = np.empty((2, len(points), *values[rows].shape))  # of the file
        for i, (up, right) in enumerate(points):
            x_m, y_m = np.meshgrid(
                grid.x_m + right * grid.resolution_m, grid.y_m[rows] + up * grid.resolution_m
            )
            row[i], col[i] = _pixel_at(raster, x_m, y_m, grid.crs)
        if method == "max":
            values[rows] = _highest(raster, row, col)
        else:
            values[rows] = SAMPLERS[method](raster, row[0], col[0])
    return values


def raster_values(
    raster: Raster, x: np.ndarray, y: np.ndarray, crs: str, method: Resampling
) -> np.ndarray:
    """Return a raster's values at places, NaN where it has none, as `resample_raster` takes them at cells' centres.

    Args:
      raster: from `jaxurban.cities.raster.read_raster`.
      x, y: coordinates of the places in ``crs``, arrays of one shape, which is that of the result.
      crs: any that pyproj knows.
      method: ``"nearest"`` or ``"bilinear"``.
    """
    return SAMPLERS[method](raster, *_pixel_at(raster, x, y, crs))


def _pixel_at(
    raster: Raster, x: np.ndarray, y: np.ndarray, crs: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns, with fractions, of places in ``crs``, counted in the whole file of a raster.

    A pixel's centre is at a half. They are infinite beyond a projection's reach.
    """
    with np.errstate(invalid="ignore"):
        x, y = transformer(crs, raster.crs).transform(x, y)
        col, row = transformed(~Affine(*raster.transform), x, y)
    return row, col


def pixel_xy(
    raster: Raster, row: np.ndarray, col: np.ndarray, crs: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates in ``crs``, x and y, of places in a raster.

    The places are given by rows and columns of its values, arrays of one shape; the first pixel's centre is 0.5, 0.5.
    """
    x, y = transformed(Affine(*raster.transform), col + raster.first_col, row + raster.first_row)
    return transformer(raster.crs, crs).transform(x, y)


def heights_above(surface: Raster, ground: Raster) -> Raster:
    """Return a surface's height above the ground on the surface's pixels, float32 metres; NaN where either is unknown.

    Args:
      surface: elevation of roofs, trees and bare ground, metres.
      ground: elevation of the ground, metres, on any grid and in any CRS; interpolated between its pixel centres.
    """
    num_rows, num_cols = surface.values.shape
    values = np.empty((num_rows, num_cols), np.float32)
    for start in range(0, num_rows, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, num_rows))
        col, row = np.meshgrid(np.arange(num_cols), np.arange(rows.start, rows.stop))
        x, y = pixel_xy(surface, row + 0.5, col + 0.5, ground.crs)
        ground_m = raster_values(ground, x, y, ground.crs, "bilinear")
        values[rows] = surface.values[rows] - ground_m
    return replace(surface, values=values)


def _pixels(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the values of pixels, float64, NaN outside the raster.

    The pixels are given by rows and columns of the whole file: whole numbers as floats, in arrays of one shape, as the
    result. Infinite ones and NaN are outside.
    """
    row = row - raster.first_row
    col = col - raster.first_col
    num_rows, num_cols = raster.values.shape
    is_inside = (row >= 0) & (row < num_rows) & (col >= 0) & (col < num_cols)
    values = np.full(row.shape, np.nan)
    pixels = row[is_inside].astype(np.intp), col[is_inside].astype(np.intp)
    values[is_inside] = raster.values[pixels]
    return values


def _nearest(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the highest of the pixels that hold each point: one, or up to four where it lies on their border.

    Args:
      raster: the pixels.
      row, col: of the points in the whole file, with fractions, arrays of one shape.
    """
    values = _pixels(raster, np.floor(row), np.floor(col))
    with np.errstate(invalid="ignore"):
        is_tied = (np.abs(row - np.round(row)) < _EDGE) | (np.abs(col - np.round(col)) < _EDGE)
    # Of a point on a border, or so near to it that rounding may have moved it across, the pixels on all sides.
    for down, right in itertools.product((-_EDGE, _EDGE), repeat=2):
        pixel = _pixels(raster, np.floor(row[is_tied] + down), np.floor(col[is_tied] + right))
        values[is_tied] = np.fmax(values[is_tied], pixel)
    return values


def _highest(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the highest of all pixels that overlap each cell, ``[Y, X]``, NaN where none has data.

    The pixels of a box around each cell are gone through, the same place in all boxes at once. Two convex shapes are
    apart where a line along a side of one of them has them on its two sides: of the pixel's sides the box decides, of
    the cell's the loop over its corners.

    Args:
      raster: the pixels.
      row, col: ``[4, Y, X]`` of the cells' corners, once around, in the whole file, with fractions.
    """
    # The box of pixels around each cell, from its first row and column to before its end.
    low_row, low_col = (np.floor(part.min(axis=0) + _EDGE) for part in (row, col))
    end_row, end_col = (np.ceil(part.max(axis=0) - _EDGE) for part in (row, col))
    counts = np.stack([end_row - low_row, end_col - low_col]).reshape(2, -1)
    most = np.max(counts, axis=1, where=np.isfinite(counts), initial=0.0)
    num_rows, num_cols = most.astype(int)

    # The cell's sides, from each corner to the next, and whether the corners go round one way (1) or the other (-1).
    along_row = np.roll(row, -1, 0) - row
    along_col = np.roll(col, -1, 0) - col
    turn = np.sign(along_col[0] * along_row[1] - along_row[0] * along_col[1])

    values = np.full(low_row.shape, np.nan)
    for down, right in itertools.product(range(num_rows), range(num_cols)):
        pixel_row = low_row + down
        pixel_col = low_col + right
        overlaps = (pixel_row < end_row) & (pixel_col < end_col)
        for side_row, side_col, from_row, from_col in zip(
            along_row, along_col, row, col, strict=True
        ):
            # How far the pixel's centre is inside of this side, and how far its corners are from the centre; both are
            # measured across the side and multiplied by its length.
            inward = turn * (
                side_col * (pixel_row + 0.5 - from_row) - side_row * (pixel_col + 0.5 - from_col)
            )
            reach = (np.abs(side_row) + np.abs(side_col)) / 2
            overlaps &= inward + reach > _EDGE * np.hypot(side_row, side_col)
        pixel = _pixels(raster, pixel_row[overlaps], pixel_col[overlaps])
        values[overlaps] = np.fmax(values[overlaps], pixel)
    return values


def _bilinear(raster: Raster, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the means of the four pixels around each place, weighted by how near their centres are.

    Pixels without data have no weight. The mean is NaN where the pixel in which the place lies has no data.

    Args:
      raster: the pixels.
      row, col: of the places in the whole file, with fractions, arrays of one shape, which the result has too. The
        centre of the first pixel is at 0.5, 0.5.
    """
    # Of the four pixels the one with the lowest row and column, and how far (0 to 1) the place is from its centre.
    low_row = np.floor(row - 0.5)
    low_col = np.floor(col - 0.5)
    along_row = row - 0.5 - low_row
    along_col = col - 0.5 - low_col

    # The sum of the four weighted pixels, and that of their weights.
    total = np.zeros(row.shape)
    weights = np.zeros(row.shape)
    for down, row_weight in ((0, 1 - along_row), (1, along_row)):
        for right, col_weight in ((0, 1 - along_col), (1, along_col)):
            pixel = _pixels(raster, low_row + down, low_col + right)
            weight = np.where(np.isnan(pixel), 0.0, row_weight * col_weight)
            total += weight * np.nan_to_num(pixel)
            weights += weight

    # Where the place's own pixel has data, its weight is above 0; elsewhere 1 stands for it in the division.
    has_data = ~np.isnan(_pixels(raster, np.floor(row), np.floor(col)))
    return np.where(has_data, total, np.nan) / np.where(has_data, weights, 1.0)


SAMPLERS = {"nearest": _nearest, "bilinear": _bilinear}  # by a place
