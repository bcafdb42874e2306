"""Lidar points to rasters of what is built, what grows and the ground, by the classes of points."""

import math
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.fill import fillnodata

from jaxurban.cities.raster import heights_of_surface, unit_of_heights_m
from jaxurban.errors import InputError, readable
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.sniff import in_own_words
from jaxurban.world.grid import check_on_earth, known_crs
from jaxurban.world.raster import Raster

CHUNK = 1_000_000  # points at once
USED = 15  # layers of points, of laspy: place, class and flags
FEW = 500  # what remains of the last packed byte may pass for points, 70 of a lattice
NOT_WHOLE = "{} is not whole, as its number of points is {:,} by its header, and {} are in it: fetch it again"
POINTS_A_CELL = 4  # on average: of cells under evenly scattered points 2 % hold none
MOST_CELLS = 2**24
VOID_CELLS = 2  # so far from points are cells without any filled
# Ground so far below all around, but for so few cells, is none: in metres, and in sides of cells.
FAR_BELOW_M, FAR_BELOW_SIDES, MOST_LOW = 5.0, 2.0, 3
AROUND = 7  # cells
# What points are by their classes (ASPRS, LAS 1.4 R15, table 17). Any other class is built: bridges, wires, towers and
# what a publisher defines. Ground are also key points of its model, water, rails, roads and the bottom of waters;
# unclassified are also overlaps. Unclassified points and plants may count as built: so these come first, in this order.
BUILT, UNCLASSIFIED, PLANTS, GROUND, NOISE = range(5)
NOISE_CLASS = 7
LAYER_OF = np.full(256, BUILT)
LAYER_OF[[0, 1, 12]] = UNCLASSIFIED
LAYER_OF[[3, 4, 5]] = PLANTS
LAYER_OF[[2, 8, 9, 10, 11, 20, 21, *range(40, 46)]] = GROUND
LAYER_OF[[NOISE_CLASS, 18]] = NOISE
# The first format of points that are packed by layers, and of how many before colours.
LAYERED, POINT_LAYERS = 6, 9
TABLE_BYTES = 8  # before the first chunk: where the table of chunks is
# Keys of GeoTIFF for heights, their unit and their CRS, and what EPSG's codes of both mean.
UNIT_KEY, CRS_KEY = 4099, 4096
UNITS = {None: "", 9001: "m", 9002: "ft", 9003: "us-ft", 5703: "m", 6360: "us-ft", 8228: "ft"}


class Points(NamedTuple):
    """A file of points as rasters on one grid, metres above the sea, NaN without a point.

    Attributes:
      ground: the lowest points of the ground.
      surface: the highest points that are built, elsewhere the ground.
      plants: the highest points of plants, and of what is unclassified beside buildings.
      highest: of all points but noise.
      counts: points by class, of which withheld ones are noise, and cells whose ground is left out.
    """

    ground: Raster
    surface: Raster
    plants: Raster
    highest: Raster
    counts: dict[str, int]


def heights_of_points(
    name: str, points: Points, terrain: Raster | None, crs: str
) -> tuple[Raster, ReadIssues]:
    """Return heights of roofs above the terrain, and issues, as of `heights_of_surface`.

    Where points are neither built nor of the ground nothing stands. Cells without points take the heights around them.
    """
    roofs, issues = heights_of_surface(name, points.surface, terrain, crs)
    issues[ReadIssue.GROUND_FAR_BELOW] = points.counts[ReadIssue.GROUND_FAR_BELOW]
    is_bare = np.isnan(points.surface.values) & np.isfinite(points.highest.values)
    values = np.where(is_bare, np.float32(0), roofs.values)
    return replace(roofs, values=fillnodata(values, np.isfinite(values), VOID_CELLS)), issues


@lru_cache(maxsize=1)
def read_points(path: str | Path, kind: str, declared: str | None) -> Points:
    """Return the points of a LAS, LAZ or COPC file, in its own CRS on cells of `POINTS_A_CELL`.

    Without a point that is built what is unclassified is. The result is kept until ``read_points.cache_clear()``, as
    roofs, plants and the ground are made of one reading.

    Args:
      path: of the file.
      kind: as of `settings.Buildings`: of a ``"surface"`` all above the ground is built.
      declared: the CRS in place of the one that the header names.

    Raises:
      InputError: a library is missing, a damaged file, no points, points outside the box of the header, no CRS, or a
        unit of heights that is not known.
    """
    layers, counts, cells, crs = _read_layers(path, declared)
    first_growing = _first_growing(kind, counts)
    roofs = np.fmax.reduce(layers[:first_growing])
    plants = np.fmax.reduce(layers[first_growing:GROUND], initial=np.nan)
    is_low = _is_far_below(layers[GROUND], max(FAR_BELOW_M, FAR_BELOW_SIDES * cells.side))
    ground = np.where(is_low, np.float32(np.nan), layers[GROUND])
    transform = (cells.side, 0.0, cells.left, 0.0, cells.side, cells.low)
    on_grid = partial(Raster, transform=transform, crs=crs.to_2d().to_string())
    by_class = {f"of class {number}": int(count) for number, count in enumerate(counts)}
    return Points(
        on_grid(ground),
        on_grid(np.where(np.isnan(roofs), ground, roofs)),
        on_grid(plants),
        on_grid(np.fmax.reduce([roofs, plants, ground])),
        by_class | {ReadIssue.GROUND_FAR_BELOW: num_of(is_low)},
    )


def _first_growing(kind: str, counts: np.ndarray) -> int:
    """Return the first layer that grows: layers before it are built, and those from it to the ground grow.

    Args:
      kind: as of `read_points`.
      counts: ``[256]`` points by class.
    """
    if kind == "surface":
        return GROUND
    return UNCLASSIFIED if counts[LAYER_OF == BUILT].any() else PLANTS


def _read_layers(
    path: str | Path, declared: str | None
) -> tuple[np.ndarray, np.ndarray, "_Cells", CRS]:
    """Return the layers of a file and its points by class, as of `_heights_by_layer`, the cells and their CRS.

    Arguments and errors are those of `read_points`.
    """
    name = repr(str(path))
    try:
        import laspy
        import lazrs
    except ImportError as error:
        raise InputError(
            f"{name} holds lidar points: install what reads them with `pip install 'jaxurban[lidar]'`"
        ) from error
    used = laspy.DecompressionSelection(USED)
    with (
        readable(path, "lidar points", "fetch it again"),
        in_own_words(laspy.LaspyException),
        laspy.open(path, read_evlrs=False, decompression_selection=used) as reader,
    ):
        header = reader.header
        if header.are_points_compressed:
            _check_chunks(path, header, lazrs)
        else:
            _check_all_held(path, header)
        crs, unit_m = _crs_and_unit(name, header, declared)
        cells = _cells_over(name, header, crs)
        layers, counts = _heights_by_layer(reader, cells, unit_m)
        _check_no_more(name, reader, counts.sum())
    return layers, counts, cells, crs


class _Cells(NamedTuple):
    """The square cells over the box of a file's points, rows from the south.

    Attributes:
      left, low: their southwest corner, in the CRS of the points.
      side: of a cell, in the same unit.
      shape: numbers of rows and columns.
    """

    left: float
    low: float
    side: float
    shape: tuple[int, int]


def _cells_over(name: str, header: Any, crs: CRS) -> _Cells:
    """Return the cells over the box of a header, from half a cell outside of it.

    Args:
      name: of the file, for messages.
      header: of it.
      crs: of its points.

    Raises:
      InputError: the box is not on the Earth.
      ValueError: no points, or a box without area.
    """
    x_min, y_min, x_max, y_max = box = [*map(float, (*header.mins[:2], *header.maxs[:2]))]
    check_on_earth(name, crs, box)
    area = (x_max - x_min) * (y_max - y_min)
    if header.point_count == 0 or area <= 0:
        raise ValueError("it has no points, or a box without area")
    side = math.sqrt(area * max(POINTS_A_CELL / header.point_count, 1 / MOST_CELLS))
    shape = int((y_max - y_min) / side) + 2, int((x_max - x_min) / side) + 2
    return _Cells(x_min - side / 2, y_min - side / 2, side, shape)


def _heights_by_layer(reader: Any, cells: _Cells, unit_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[L, Y, X]`` the highest point of each layer, of `GROUND` the lowest, and ``[256]`` points by class.

    Args:
      reader: laspy's, before the first point.
      cells: over the points.
      unit_m: metres in a unit of their heights.

    Returns:
      Metres, float32, NaN without a point; withheld points count as noise.

    Raises:
      ValueError: a point lies outside the cells.
    """
    counts = np.zeros(256, int)
    shape = NOISE + 1, *cells.shape
    layers = np.full(shape, np.nan, np.float32)
    for points in reader.chunk_iterator(CHUNK):
        classes = np.where(points.withheld, NOISE_CLASS, points.classification)
        counts += np.bincount(classes, minlength=256)
        layer = LAYER_OF[classes]
        col = ((points.x - cells.left) / cells.side).astype(int)
        row = ((points.y - cells.low) / cells.side).astype(int)
        cell = np.ravel_multi_index((layer, row, col), shape)  # ValueError outside
        # The lowest of the ground is the highest upside down.
        height_m = points.z * unit_m * np.where(layer == GROUND, -1, 1)
        np.fmax.at(layers.reshape(-1), cell, np.float32(height_m))
    layers[GROUND] = -layers[GROUND]
    return layers, counts


def _check_no_more(name: str, reader: Any, num_read: int) -> None:
    """Raise InputError if packed points follow those that the header counts.

    Args:
      name: of the file, for messages.
      reader: laspy's, behind the last point; it reads as many as the header counts, which is therefore raised.
      num_read: points so far.
    """
    reader.header.point_count += FEW * reader.header.are_points_compressed
    has_more = False
    # Where none follow there is nothing to unpack, and lazrs fails.
    with suppress(ValueError), in_own_words():
        has_more = bool(reader.read_points(FEW))
    if has_more:
        raise InputError(NOT_WHOLE.format(name, num_read, "more"))


def _is_far_below(ground: np.ndarray, far_m: float) -> np.ndarray:
    """Return ``[Y, X]`` which cells of the ground are noise, as the ground around them lies more than ``far_m`` above.

    It does in the square of `AROUND` cells a side, but for fewer than `MOST_LOW` other cells; a pit has more.

    Args:
      ground: ``[Y, X]`` metres, NaN without a point.
      far_m: the least depth of noise.
    """
    width = ground.shape[1]
    beside_m = np.fmax.reduce([np.roll(ground, step) for step in (1, -1, width, -width)])
    is_low = beside_m - ground > far_m
    padded = np.pad(np.nan_to_num(ground, nan=np.inf), AROUND // 2, constant_values=np.inf)
    around = sliding_window_view(padded, (AROUND, AROUND))[is_low].reshape(-1, AROUND**2)
    others_m = np.partition(around, MOST_LOW)[:, MOST_LOW]
    is_low[is_low] = np.isfinite(others_m) & (others_m - ground[is_low] > far_m)
    return is_low


def _check_all_held(path: str | Path, header: Any) -> None:
    """Check that a file holds as many points, which are not packed, as its header says.

    Raises:
      InputError: it holds more or fewer.
    """
    # Points end where other records begin, or with the file; a rest shorter than a point is none.
    begin = header.offset_to_point_data
    size = Path(path).stat().st_size
    ends = header.start_of_first_evlr, header.start_of_waveform_data_packet_record, size
    num_bytes = min(end for end in ends if end > begin) - begin
    num_held = num_bytes // header.point_format.size
    if num_held != header.point_count:
        raise InputError(NOT_WHOLE.format(repr(str(path)), header.point_count, f"{num_held:,}"))


def _check_chunks(path: str | Path, header: Any, lazrs: Any) -> None:
    """Check that the chunks of packed points, and their layers, lie within their file.

    lazrs makes room for as many bytes as they claim, and where it gets none it ends the process.

    Args:
      path: of the file.
      header: of it.
      lazrs: the library.

    Raises:
      ValueError: they are longer, or there are more chunks than the file has bytes.
    """
    begin = header.offset_to_point_data
    size = Path(path).stat().st_size
    (table,) = np.fromfile(path, "<i8", 1, offset=begin)
    _, num_chunks = np.fromfile(path, "<u4", 2, offset=max(table, 0))
    if num_chunks > size:
        raise ValueError

    # A chunk is its first point and, of later formats, how many points it has, how long its layers are, and these.
    (record,) = header.vlrs.get("LasZipVlr")
    num_layers = POINT_LAYERS if header.point_format.id >= LAYERED else 0
    with Path(path).open("rb") as file:
        file.seek(begin)
        chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(record.record_data_bytes()))
        chunk_begin = begin + TABLE_BYTES
        for _, num_bytes in chunks:
            file.seek(chunk_begin + header.point_format.size + 4)
            layer_bytes = np.fromfile(file, "<u4", num_layers)
            chunk_begin += num_bytes
            if chunk_begin > size or layer_bytes.sum() > num_bytes:
                raise ValueError


def _crs_and_unit(name: str, header: Any, declared: str | None) -> tuple[CRS, float]:
    """Return the CRS of points, and how many metres the unit of their heights is.

    Args:
      name: of the file, for messages.
      header: of it.
      declared: the CRS in place of the one that the header names.

    Raises:
      InputError: no CRS, or a unit of heights that is not known.
    """
    parsed = None
    with suppress(CRSError):
        parsed = header.parse_crs()
    text = declared or (parsed and parsed.srs)
    if text is None:
        raise InputError(
            f"{name} declares no CRS that is known: set [buildings] crs to that of the plan and of the heights, as "
            'in "EPSG:28992+5709", or write it into the header with `pdal translate IN OUT --writers.las.a_srs=...`'
        )
    crs = known_crs(text, f" of {name}")
    records = header.vlrs.get("GeoKeyDirectoryVlr")
    keys = {key.id: key.value_offset for record in records for key in record.geo_keys}
    unit = UNITS.get(keys.get(UNIT_KEY, keys.get(CRS_KEY)), "an unknown one")
    return crs, unit_of_heights_m(name, crs.to_wkt(), unit)
