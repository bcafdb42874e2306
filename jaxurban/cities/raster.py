"""Rasters from files: building heights, terrain and surface models (roofs, trees and ground above sea level)."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
import shapely
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window, intersect

from jaxurban.cities.companions import check_companions, companions
from jaxurban.errors import InputError, readable, warn
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.sampling import heights_above, pixel_xy, transformed
from jaxurban.knowledge import Guesses, GuessKind, guessed
from jaxurban.world.grid import WGS84, Bounds, check_on_earth, known_crs, transformer, where_it_lies
from jaxurban.world.raster import Raster

# By the end of their names, the drivers of GDAL that may open them: others (as of .vrt) read what a file names.
DRIVERS = {
    ".tif": "GTiff",
    ".tiff": "GTiff",
    ".bil": "EHdr",
    ".flt": "EHdr",
    ".dt0": "DTED",
    ".dt1": "DTED",
    ".dt2": "DTED",
    ".asc": "AAIGrid",
    ".img": "HFA",
    ".hgt": "SRTMHGT",
    ".png": "PNG",
}
RASTER_SUFFIXES = tuple(DRIVERS)
TIFF_MARKS = b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"  # first bytes
OWN_VALUES = "in a unit of your own"
HEIGHTS = "heights in metres"
# The shore of the Dead Sea lies at -430 m, the top of Everest at 8,849 m.
TERRAIN_RANGE_M = (-500.0, 9000.0)
# Bilinear sampling reaches half a pixel beyond the bounds, a curved border a little more.
_MARGIN_PIXELS = 2
MOST_PIXELS = 2**30  # 4 GiB; some steps take twice as much again
STRIP_PIXELS = 2**22  # at once
# Of a pixel, in squares of the CRS's unit, and 1 by it is the least: from a millionth of a metre to the whole Earth.
MOST_PIXEL_AREA = 1e16

# What a file may call its vertical unit (lower case), in metres.
_NAMES = {
    1.0: "m, metre, metres, meter, meters",
    0.3048: "ft, foot, feet, international foot, international feet",
    1200 / 3937: "us-ft, ftus, us survey foot, us survey feet, foot_us, us foot, survey foot",
}
UNITS_M = {name: unit_m for unit_m, names in _NAMES.items() for name in names.split(", ")}

# Surface models.
# Nothing this low above the terrain is a building: noise of two models, cars, hedges.
GROUND_M = 2.0
BLOCK_M = 100.0  # wider than most halls: a street, a yard or a clearing lies in almost every block of a city
SAMPLES_A_SIDE = 20  # of a block
LOW_SHARE = 0.05  # of a block's samples lie below its low level: pits, noise and holes
RELIEF_M = 3.0  # of a block on which something stands: water and fields tell nothing
# Shares of blocks whose low level is more than GROUND_M from 0. Heights above ground: Bilbao 0.002, Gothenburg (surface
# less terrain) 0; surfaces: Gothenburg 0.62 (a quay), Bilbao 0.83 (a river and hills).
MOST_RAISED = 0.4


def read_raster(path: str | Path, crs: str, bounds_m: Bounds | None = None) -> Raster:
    """Return a single-band raster file, or the part of it that covers some bounds.

    The file's scale and offset are applied, then its vertical unit: that of the band, or of a CRS with a vertical axis
    (see `UNITS_M`); without any, values are metres. Cells that it declares empty (by a nodata value or a mask) are NaN.

    Args:
      path: a single-band file whose name ends as in `DRIVERS`, with a CRS.
      crs: projected CRS of ``bounds_m``.
      bounds_m: x_min, y_min, x_max, y_max; the window is two pixels wider on each side. None: the whole file.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the
        bounds, holds values that are not finite or beyond the limits and not declared empty, or whose vertical unit
        is unknown: an invalid name, two that differ, or a CRS in feet that says nothing of heights.
    """
    (raster,) = read_bands(path, crs, bounds_m, holds=HEIGHTS)
    check_range(repr(str(path)), raster.values, TERRAIN_RANGE_M)
    return raster


def read_bands(
    path: str | Path,
    crs: str,
    bounds_m: Bounds | None = None,
    *,
    holds: str = OWN_VALUES,
    dtype: type = np.float32,
) -> list[Raster]:
    """Return every band of a raster file, or of the part of it that covers some bounds, NaN where it has no data.

    The file's scales and offsets are applied.

    Args:
      path, crs, bounds_m: as for `read_raster`.
      holds: what the values are, for messages. Only a file of `OWN_VALUES`, in a unit of their own, may have several
        bands. `HEIGHTS` are returned in metres, and any that is not finite must be declared empty.
      dtype: of the result.

    Raises:
      InputError: a file that cannot be read, has no CRS or no position, or does not reach the bounds; of heights as for
        `read_raster`.
    """
    name = repr(str(path))
    unit_m = None
    with open_raster(path, holds) as source:
        if holds == HEIGHTS:
            unit_m = unit_of_heights_m(name, source.crs.to_wkt(), source.units[0])
        window = raster_window(name, source, crs, bounds_m)
        height, width = int(window.height), int(window.width)
        shape = source.count, height, width
        if math.prod(shape) > MOST_PIXELS:
            raise InputError(
                f"{name} has {width:,} x {height:,} pixels in and around the region, more than the "
                f"{MOST_PIXELS:,} that memory is to hold: make a coarser one, as with `gdalwarp -r max -tr 5 5 IN OUT` "
                "(terrain: `-r average`), or cut it with `gdal_translate -projwin`"
            )

        bands = np.empty(shape, dtype)
        num_bad = _read_into(bands, source, window, unit_m)
        transform = tuple(source.transform)[:6]
        raster_crs = _horizontal_crs(source)

    # Heights that are not finite are refused; other such values count as empty.
    if unit_m is not None and num_bad:
        raise InputError(
            f"{name} holds {num_bad} cells that are NaN or infinite and not declared as nodata: fill them, or "
            "declare NaN with `gdal_edit.py -a_nodata nan`"
        )
    return [
        Raster(band, transform, raster_crs, int(window.row_off), int(window.col_off))
        for band in bands
    ]


def _read_into(
    bands: np.ndarray, source: rasterio.DatasetReader, window: Window, unit_m: float | None
) -> int:
    """Read a window in strips of rows, so that memory holds only the result as a whole.

    Args:
      bands: ``[B, Y, X]``, which get the values.
      source, unit_m: as of `_read_strip`.
      window: of ``Y`` rows and ``X`` columns.

    Returns:
      How many values are not finite and not declared empty.
    """
    _, height, width = bands.shape
    strip_rows = max(1, STRIP_PIXELS // width)
    num_bad = 0
    for row in range(0, height, strip_rows):
        num_rows = min(strip_rows, height - row)
        strip = Window(window.col_off, window.row_off + row, width, num_rows)
        bands[:, row : row + num_rows], is_bad = _read_strip(source, strip, unit_m)
        num_bad += num_of(is_bad)
    return num_bad


def _read_strip(
    source: rasterio.DatasetReader, strip: Window, unit_m: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of a window ``[B, Y, X]``, NaN without data, and which are not finite and not declared empty.

    Args:
      source: the open raster.
      strip: the window.
      unit_m: metres in a unit of heights; None of other values.
    """
    stored = source.read(window=strip)
    is_empty = source.read_masks(window=strip) == 0
    # Heights stay in float32 where the file has that: twice the precision would take twice the time.
    precision = np.float64 if unit_m is None else np.result_type(stored, 0.0)
    scale, offset = np.array([source.scales, source.offsets], precision)
    values = stored * scale[:, None, None] + offset[:, None, None]
    if unit_m is not None:
        values *= unit_m
    is_bad = ~np.isfinite(values) & ~is_empty
    return np.where(is_empty | is_bad, np.nan, values), is_bad


def check_range(name: str, values: np.ndarray, range_m: tuple[float, float]) -> None:
    """Raise InputError if a raster holds values below the first or above the second limit, in metres; NaN passes."""
    low_m, high_m = range_m
    num_bad = num_of((values < low_m) | (values > high_m))
    if num_bad:
        raise InputError(
            f"{name} holds {num_bad} cells outside {low_m:g} to {high_m:g} m: declare their value as nodata with "
            "`gdal_edit.py -a_nodata VALUE` (lidar points: as noise, class 7), or convert the heights to metres"
        )


def raster_extent_m(path: str | Path, crs: str) -> Bounds:
    """Return x_min, y_min, x_max, y_max in ``crs`` of the box around a raster file.

    Raises:
      InputError: as for `read_raster`.
    """
    with open_raster(path) as source:
        return _extent_of(source, crs)


def _extent_of(source: rasterio.DatasetReader, crs: str) -> Bounds:
    """Return x_min, y_min, x_max, y_max in a CRS of the box around an open raster, by its four corners."""
    box = shapely.box(*source.bounds).bounds  # in order, however rows and columns run
    return transformer(_horizontal_crs(source), crs).transform_bounds(*box)


@contextmanager
def open_raster(path: str | Path, holds: str = HEIGHTS) -> Iterator[rasterio.DatasetReader]:
    """Open a raster for the block, and make an InputError of every failure of reading it there.

    Args:
      path: of the file; its suffix, of `DRIVERS`, says which driver of GDAL may open it.
      holds: what its values are, for messages; only a file of `OWN_VALUES` may have several bands.

    Raises:
      InputError: no raster of these formats, several bands, values that are not real numbers, no CRS or no position,
        pixels without area, a place that is not on the Earth or far from where its CRS is used, or a mask beside it
        that may name other files.
    """
    name = repr(str(path))
    with (
        readable(path, "a raster", "give a file that GDAL opens", RasterioError),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # said better below
        suffix = Path(path).suffix.lower()
        if suffix not in DRIVERS:
            raise ValueError(
                f"of rasters {', '.join(DRIVERS)} are read: convert it with `gdal_translate`"
            )
        _check_mask(Path(path))
        check_companions(Path(path))

        offline = rasterio.Env(CPL_VSIL_CURL_ALLOWED_FILENAME="none")  # asks servers for no file
        with offline, rasterio.open(path, driver=DRIVERS[suffix]) as source:
            if source.count != 1 and holds != OWN_VALUES:
                raise InputError(
                    f"{name} has {source.count} bands: give a raster with one band, {holds}"
                )
            if np.dtype(source.dtypes[0]).kind not in "iuf":
                raise InputError(
                    f"{name} holds {source.dtypes[0]} values: give real numbers, {holds}"
                )
            if source.crs is None or source.transform == Affine.identity():
                raise InputError(
                    f"{name} has no CRS or no position: set them with `gdal_edit.py -a_srs EPSG:... -a_ullr ...`"
                )
            pixel_area = abs(source.transform.determinant)
            has_area = 1 / MOST_PIXEL_AREA < pixel_area < MOST_PIXEL_AREA
            if not (has_area and np.isfinite(source.transform).all()):
                raise InputError(
                    f"{name} has pixels without area, or out of range, by its geotransform "
                    f"{source.transform[:6]}: set its position with `gdal_edit.py -a_ullr ...`"
                )
            check_on_earth(name, known_crs(source.crs.to_string(), f" of {name}"), source.bounds)
            yield source


def _check_mask(path: Path) -> None:
    """Raise InputError unless the mask beside a raster, if there is one, is a TIFF.

    GDAL opens a file of the raster's name with .msk behind it in any format, and some formats name any other file.
    """
    for mask in companions(path, f"{path.name}.msk"):
        is_tiff = mask.is_file() and np.fromfile(mask, np.uint8, 4).tobytes() in TIFF_MARKS
        if not is_tiff:
            raise InputError(
                f"{str(mask)!r}, the mask of {str(path)!r}, is no GeoTIFF and may name other files: remove it, or "
                "convert it with `gdal_translate`"
            )


def _horizontal_crs(source: rasterio.DatasetReader) -> str:
    """Return a file's CRS without its vertical axis."""
    name = source.crs.to_string()
    crs = known_crs(name)
    return crs.sub_crs_list[0].to_wkt() if crs.is_compound else name


SAME_UNIT = 1e-9  # metres between two units that are one


def unit_of_heights_m(name: str, crs: str, written: str | None) -> float:
    """Return the metres in one unit of a file's heights.

    The file may name the unit, and so may the vertical axis of the CRS. Where neither does, heights are metres, unless
    the CRS is projected in another unit.

    Args:
      name: of the file, for messages.
      crs: with a vertical axis or without.
      written: the unit that a band or a header names, if it names one.

    Raises:
      InputError: the unit is not known: an unknown name, two that differ, or none beside a CRS in another unit.
    """
    parsed = known_crs(crs)
    axes = parsed.axis_info
    said_m = [axis.unit_conversion_factor for axis in axes[2:] if axis.direction == "up"]
    is_known = True
    if written:
        unit = written.strip().lower()
        is_known = unit in UNITS_M
        said_m.insert(0, UNITS_M.get(unit, 1.0))
    elif not said_m and parsed.is_projected:
        is_known = abs(axes[0].unit_conversion_factor - 1.0) < SAME_UNIT
    unit_m = said_m[0] if said_m else 1.0
    agree = all(abs(other_m - unit_m) <= SAME_UNIT for other_m in said_m)
    if not (is_known and agree):
        raise InputError(
            f"{name} does not say plainly in which unit its heights are (it says {written!r}, and its CRS "
            f"{', '.join(axis.unit_name for axis in axes)}): say it with `gdal_edit.py -units m` (or ft, or 'US survey "
            'foot\'), or for lidar points with a CRS of heights in [buildings] crs, as in "EPSG:2263+6360"'
        )
    return unit_m


def raster_window(
    name: str, source: rasterio.DatasetReader, crs: str, bounds_m: Bounds | None
) -> Window:
    """Return the window of pixels that covers a box, `_MARGIN_PIXELS` wider on each side and cut to the raster.

    Args:
      name: of the file, for messages.
      source: the open raster.
      crs: projected CRS of the box.
      bounds_m: x_min, y_min, x_max, y_max of the box; None: the whole raster.

    Raises:
      InputError: the raster does not reach the box.
    """
    whole = Window(0, 0, source.width, source.height)
    if bounds_m is None:
        return whole

    # The pixels at 22 x 22 places, evenly spread over the box and its border: as straight sides bend in another CRS,
    # the corners alone would not do.
    x_min, y_min, x_max, y_max = bounds_m
    x_m, y_m = np.meshgrid(np.linspace(x_min, x_max, 22), np.linspace(y_min, y_max, 22))
    x, y = transformer(crs, _horizontal_crs(source)).transform(x_m, y_m)
    col, row = transformed(~source.transform, x, y)
    if np.all(np.isfinite(col) & np.isfinite(row)):
        spans = (
            (math.floor(place.min()) - _MARGIN_PIXELS, math.ceil(place.max()) + _MARGIN_PIXELS)
            for place in (row, col)
        )
        window = Window.from_slices(*spans, boundless=True)
        if intersect(window, whole):
            return window.intersection(whole)

    where = where_it_lies(
        _extent_of(source, WGS84), transformer(crs, WGS84).transform_bounds(*bounds_m)
    )
    raise InputError(
        f"{name} does not reach the region: {where}; give a raster that covers it, or change [region] bounds"
    )


def heights_of_surface(
    name: str, surface: Raster, terrain: Raster | None, crs: str
) -> tuple[Raster, ReadIssues]:
    """Return the heights of a surface model above the terrain, and how many cells were taken for ground, by issue.

    What stands less than `GROUND_M` above the terrain, or below it, is ground: its height is 0.

    Args:
      name: of the file, for messages.
      surface: elevations of roofs, trees and bare ground, metres.
      terrain: elevations of the ground, metres, on any grid.
      crs: projected CRS in metres.

    Warns:
      UserWarning: that trees, bridges and cranes count as buildings.

    Raises:
      InputError: no terrain, or surface and terrain do not belong together.
    """
    if terrain is None:
        raise InputError(
            f'[buildings] kind = "surface" takes the ground from below {name}: give its elevation as [terrain] source'
        )
    above = heights_above(surface, terrain)
    num_sunken = num_of(above.values < -GROUND_M)
    num_known = num_of(np.isfinite(above.values))
    raised = _raised_share(above, crs)
    if num_sunken > num_known / 2 or raised > MOST_RAISED:
        raise InputError(
            f"{name} does not stand on the terrain ({num_sunken / num_known:.0%} of its cells lie below it, "
            f"{raised:.0%} of its blocks of {BLOCK_M:g} m are off it all over, streets and yards included): bring both "
            'to one vertical datum and unit, or leave out [buildings] kind = "surface" if it holds heights above ground'
        )
    warn(
        f"heights are {name} less the terrain: trees, bridges and cranes in it count as buildings (of classified lidar "
        f"points what is neither ground nor plants), and what is lower than {GROUND_M:g} m as ground"
    )
    is_ground = above.values < GROUND_M
    issues = {
        ReadIssue.CELLS_BELOW_GROUND: num_of(above.values < 0),
        ReadIssue.CELLS_NEAR_GROUND: num_of(is_ground),
    }
    return replace(above, values=np.where(is_ground, np.float32(0), above.values)), issues


def zero_is_ground(path: str | Path, heights: Raster) -> tuple[Raster, Guesses]:
    """Return heights above ground whose cells without data are ground if the file's nodata value is 0, and that guess.

    Args:
      path: of the file.
      heights: that were read from it.
    """
    with open_raster(path) as source:
        if source.nodata != 0:
            return heights, ()
    share = np.isnan(heights.values).mean()
    guesses = guessed(GuessKind.NODATA_ZERO, share, file=repr(str(path)))
    return replace(heights, values=np.nan_to_num(heights.values)), guesses


def check_is_no_surface(name: str, heights: Raster, crs: str) -> None:
    """Raise InputError if a raster of heights above ground looks like a surface model.

    In a city's heights almost every block of 100 m has some ground, which is near 0.

    Args:
      name: of the file, for messages.
      heights: the raster.
      crs: projected CRS in metres.
    """
    raised = _raised_share(heights, crs)
    if raised > MOST_RAISED:
        raise InputError(
            f"{name} looks like a surface model, elevations and not heights above ground: {raised:.0%} of its blocks "
            f'of {BLOCK_M:g} m with something on them have no ground near 0; set [buildings] kind = "surface" and give '
            "the elevation of the ground as [terrain] source, or give heights above ground (0 where nothing stands, "
            "also in streets that hold no data)"
        )


def pixel_m(raster: Raster, crs: str) -> np.ndarray:
    """Return how far the pixel in the middle of a raster reaches down and to the right, two lengths in metres.

    Args:
      raster: on any grid.
      crs: projected CRS in metres, to measure in.
    """
    num_rows, num_cols = raster.values.shape
    row = num_rows / 2 + np.array([0, 1, 0])
    col = num_cols / 2 + np.array([0, 0, 1])
    x_m, y_m = pixel_xy(raster, row, col, crs)
    return np.hypot(x_m[1:] - x_m[0], y_m[1:] - y_m[0])


def _raised_share(raster: Raster, crs: str) -> float:
    """Return which share of the blocks on which something stands have no ground near 0; 0 where nothing stands.

    Ground is the low level of a block of 100 m, below which `LOW_SHARE` of its samples lie. Something stands where the
    highest sample is at least `RELIEF_M` above it. Blocks with data in less than a quarter of their samples are left
    out.

    Args:
      raster: elevations or heights, metres.
      crs: projected CRS in metres, to measure pixels in.
    """
    num_rows, num_cols = raster.values.shape
    height, width = (max(1, round(BLOCK_M / side_m)) for side_m in pixel_m(raster, crs))

    # Blocks [row, column, row within, column within], and of each some `SAMPLES_A_SIDE` rows and columns.
    padded = np.pad(
        raster.values, ((0, -num_rows % height), (0, -num_cols % width)), constant_values=np.nan
    )
    blocks = padded.reshape(len(padded) // height, height, -1, width).swapaxes(1, 2)
    samples = blocks[..., :: -(-height // SAMPLES_A_SIDE), :: -(-width // SAMPLES_A_SIDE)]

    # A block a row, its samples sorted with NaN last.
    by_block = np.sort(samples.reshape(samples.shape[0] * samples.shape[1], -1), axis=1)
    num_finite = np.isfinite(by_block).sum(axis=1)
    known = np.flatnonzero(num_finite >= by_block.shape[1] / 4)
    low_m = by_block[known, (LOW_SHARE * num_finite[known]).astype(int)]
    high_m = by_block[known, num_finite[known] - 1]
    level_m = low_m[high_m - low_m >= RELIEF_M]
    return float(np.mean(np.abs(level_m) > GROUND_M)) if len(level_m) else 0.0
