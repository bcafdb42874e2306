"""A cloud-optimised GeoTIFF of one map: rows in, overviews made on the way; every file is GDAL's.

GDAL takes files named ``.ovr`` after another as its overviews. So the map and each of its overviews are written once as
plain files, and its COG driver has only to lay them out and to compress them: its own overviews take twice that time.

Every block is written whole and once. GDAL's cache, which threads share, writes blocks that are not full yet, and parts
of those that are filled later were lost.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rasterio
from rasterio.shutil import copy as copy_raster
from rasterio.windows import Window

from jaxurban.io.bands import OF_WRITING, profile_of
from jaxurban.io.files import SCRATCH_SUFFIX
from jaxurban.io.gdal import without_cache
from jaxurban.kernels.halving import Halving
from jaxurban.world.grid import Grid

BLOCK = 512  # cells of a block's side
MARK_BYTES = 4  # of a block's size, which stands before it, and of its last bytes, which follow it again (GDAL on COG)
LEVEL = 1  # of Zstandard: on these maps a predictor takes more time and more bytes, a higher level twice the time


class _Image:
    """One image of the file, the map or an overview: takes rows from the north and writes them as they come.

    Attributes:
      halving: its shape, and how its overview is made.
      overview: the next smaller image; None for the smallest.
    """

    def __init__(self, halving: Halving, file: Any, overview: "_Image | None") -> None:
        self.halving, self.overview = halving, overview
        self._file = file
        nothing = np.empty((0, halving.shape[1]), file.dtypes[0])
        self._waiting = nothing  # rows until there are enough for blocks
        self._kept = nothing  # rows, the last ones before those, that the next of the overview needs too
        self._num_written = 0
        self._num_halved = 0  # rows of the overview

    def add(self, rows: np.ndarray) -> None:
        """Take the next rows ``[y, x]``."""
        while len(rows):
            num = BLOCK - len(self._waiting)
            band, rows = np.concatenate([self._waiting, rows[:num]]) if len(self._waiting) else rows[:num], rows[num:]
            if len(band) == BLOCK or self._num_written + len(band) == self.halving.shape[0]:
                self._write(band)
                band = band[:0]
            self._waiting = band.copy()

    def _write(self, band: np.ndarray) -> None:
        self._file.write(band, 1, window=Window(0, self._num_written, band.shape[1], len(band)))
        if self.overview is not None:
            self._halve(band, self.overview)
        self._num_written += len(band)

    def _halve(self, band: np.ndarray, overview: "_Image") -> None:
        """Hand on the rows of the overview that can be made by now."""
        values = np.concatenate([self._kept, band]) if len(self._kept) else band
        first, start = self._num_written - len(self._kept), self._num_halved
        stop = self._num_halved = self.halving.num_ready(self._num_written + len(band))
        overview.add(self.halving.rows(values, first, start, stop))
        self._kept = (
            values[self.halving.needed(stop)[0] - first :].copy() if stop < self.halving.halved[0] else band[:0]
        )


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
      dtype: of its values; what stands for no value is `jaxurban.io.hidden.no_value`.
      rows: parts ``[y, x]`` of the map, all its rows from the north to the south.
      is_averaged: whether overviews hold means, else the cell in the middle.
      tags: of the file.
      title: of its band.
      unit: of its values.

    Raises:
      OSError: the file cannot be written.
    """
    try:
        with (
            without_cache(),
            TemporaryDirectory(SCRATCH_SUFFIX, ".plain.", path.parent) as folder,
        ):
            plain = Path(folder) / "plain.tif"
            _write_plain(plain, grid, dtype, rows, is_averaged, {"tags": tags, "title": title, "unit": unit})
            copy_raster(
                plain,
                path,
                driver="COG",
                compress="ZSTD",
                level=LEVEL,
                predictor="NO",
                blocksize=BLOCK,
                bigtiff="IF_SAFER",
                overviews="FORCE_USE_EXISTING",
                num_threads=1,
            )
        _check_blocks(path, [halving.shape for halving in _halvings(grid.shape, is_averaged)])
    except OF_WRITING as error:
        raise OSError(f"GDAL could not write it ({error})") from error


def _write_plain(
    path: Path,
    grid: Grid,
    dtype: np.dtype,
    rows: Iterable[np.ndarray],
    is_averaged: bool,
    told: Mapping[str, Any],
) -> None:
    """Write a map as a plain GeoTIFF and its overviews beside it, each named ``.ovr`` after the next larger one."""
    profile = profile_of(grid, dtype) | {"blockxsize": BLOCK, "blockysize": BLOCK}
    with ExitStack() as stack:
        image: _Image | None = None
        for number, halving in reversed(list(enumerate(_halvings(grid.shape, is_averaged)))):
            name = path.with_name(path.name + number * ".ovr")
            size = {"height": halving.shape[0], "width": halving.shape[1]}
            file = stack.enter_context(rasterio.open(name, "w", **(profile | size)))
            image = _Image(halving, file, image)
        assert image is not None  # the map itself, which comes last
        for part in rows:
            image.add(part)
        file.update_tags(**told["tags"])
        file.set_band_description(1, told["title"])
        file.set_band_unit(1, told["unit"])


def _check_blocks(path: Path, shapes: Sequence[tuple[int, int]]) -> None:
    """Raise OSError unless every block of a file and its overviews is there to its end.

    GDAL does not tell everybody of a disk that fills up.
    """
    with rasterio.open(path) as file, path.open("rb") as data:
        for number, shape in enumerate(shapes):
            for row, col in np.ndindex(-(-shape[0] // BLOCK), -(-shape[1] // BLOCK)):
                of_overview = {"ovr": number - 1} if number else {}
                start, size = (
                    int(file.get_tag_item(f"BLOCK_{what}_{col}_{row}", "TIFF", bidx=1, **of_overview) or 0)
                    for what in ("OFFSET", "SIZE")
                )
                data.seek(max(0, start - MARK_BYTES))
                before = data.read(MARK_BYTES)
                data.seek(max(0, start + size - MARK_BYTES))
                after = data.read(2 * MARK_BYTES)
                if int.from_bytes(before, "little") != size or after != 2 * after[:MARK_BYTES].ljust(MARK_BYTES):
                    raise OSError("GDAL did not write all of it")


def _halvings(shape: tuple[int, int], is_averaged: bool) -> list[Halving]:
    """Return the images of a map of a shape, the map itself first: overviews until one is a single block."""
    found = [Halving(shape, is_averaged)]
    while max(found[-1].shape) > BLOCK:
        found.append(Halving(found[-1].halved, is_averaged))
    return found
