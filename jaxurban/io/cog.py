"""A cloud-optimised GeoTIFF of one map, written in one pass: rows in, overviews made on the way, no plain file before.

As GDAL's COG driver lays it out: the header, what tells readers of the layout, the directories, and then the blocks of
every image, the smallest overview's first, each between its size and its last four bytes. Georeferencing and texts
are those that GDAL writes into a file of one block, whose tags are taken over.
"""

import shutil
import struct
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import IO, Any, NamedTuple

import numpy as np
from numcodecs import Zstd
from rasterio.io import MemoryFile

from jaxurban.io.bands import profile_of
from jaxurban.kernels.halving import Halving
from jaxurban.world.grid import Grid

BLOCK = 512  # cells of a block's side
COMPRESSOR = Zstd(level=1)  # on these maps a predictor takes more time and more bytes, a higher level twice the time
HELD_BYTES = 8 * 2**20  # of an image's compressed blocks in memory; the others wait in a file without a name
MOST_CLASSIC = 2**32 - 1  # bytes that offsets of four bytes reach
LAYOUT = b"""GDAL_STRUCTURAL_METADATA_SIZE=000140 bytes
LAYOUT=IFDS_BEFORE_DATA
BLOCK_ORDER=ROW_MAJOR
BLOCK_LEADER=SIZE_AS_UINT4
BLOCK_TRAILER=LAST_4_BYTES_REPEATED
KNOWN_INCOMPATIBLE_EDITION=NO
 \0"""

# Tags of TIFF 6.0 and of GDAL, and types of their values.
SUBFILE, WIDTH, HEIGHT, OFFSETS, BYTE_COUNTS = 254, 256, 257, 324, 325
NO_DATA = 42113
OF_OVERVIEWS = (258, 259, 262, 277, 284, 317, 322, 323, 339, NO_DATA)  # beside these: how blocks are to be read
LONG, LONG8 = 4, 16
TYPE_BYTES = {1: 1, 2: 1, 3: 2, LONG: 4, 5: 8, 12: 8, LONG8: 8}


class _Tag(NamedTuple):
    """An entry of a directory: type, number of values, and their bytes."""

    kind: int
    num: int
    data: bytes


class _Words(NamedTuple):
    """What differs between classic TIFF and BigTIFF: header, struct codes, bytes of a value that needs no offset."""

    header: bytes
    offset: str
    length: str  # of a directory
    entry: str
    offset_kind: int

    @property
    def inline(self) -> int:
        return struct.calcsize(self.offset)


_REDUCED = _Tag(LONG, 1, struct.pack("<I", 1))  # of `SUBFILE`: an overview
CLASSIC = _Words(b"II*\0", "<I", "<H", "<HHI", LONG)
BIG = _Words(b"II+\0\x08\0\0\0", "<Q", "<Q", "<HHQ", LONG8)


class _Image:
    """One image of the file, the map or an overview: takes rows from the north, keeps the blocks made of them.

    Attributes:
      halving: its shape, and how its overview is made.
      overview: the next smaller image; None for the smallest.
      sizes: bytes of each block, from the north and there from the west.
    """

    def __init__(
        self, halving: Halving, dtype: np.dtype, no_value: Any, blocks: IO[bytes], overview: "_Image | None"
    ) -> None:
        self.halving, self.overview, self.sizes = halving, overview, list[int]()
        self._dtype, self._no_value, self._blocks = dtype, no_value, blocks
        nothing = np.empty((0, halving.shape[1]), dtype)
        self._waiting = nothing  # rows until there are enough for blocks
        self._kept = nothing  # rows, the last ones before those, that the next of the overview needs too
        self._num_written = 0  # rows in blocks
        self._num_halved = 0  # rows of the overview

    def add(self, rows: np.ndarray) -> None:
        """Take the next rows ``[y, x]``."""
        rows = np.concatenate([self._waiting, rows]) if len(self._waiting) else rows
        while len(rows) >= BLOCK or len(rows) == self.halving.shape[0] - self._num_written > 0:
            self._write(rows[:BLOCK])
            rows = rows[BLOCK:]
        self._waiting = rows.copy()

    def _write(self, band: np.ndarray) -> None:
        for col in range(0, band.shape[1], BLOCK):
            block = band[:, col : col + BLOCK]
            if block.shape != (BLOCK, BLOCK):
                whole = np.full((BLOCK, BLOCK), self._no_value, self._dtype)
                whole[: block.shape[0], : block.shape[1]] = block
                block = whole
            data = COMPRESSOR.encode(np.ascontiguousarray(block))
            self.sizes.append(len(data))
            for part in (struct.pack("<I", len(data)), data, data[-4:]):
                self._blocks.write(part)
        if self.overview is not None:
            self._halve(band, self.overview)
        self._num_written += len(band)

    def _halve(self, band: np.ndarray, overview: "_Image") -> None:
        """Hand on the rows of the overview that can be made by now."""
        values = np.concatenate([self._kept, band]) if len(self._kept) else band
        first, start = self._num_written - len(self._kept), self._num_halved
        stop = self._num_halved = self.halving.num_ready(self._num_written + len(band))
        overview.add(self.halving.rows(values, first, start, stop))
        is_last = stop == self.halving.halved[0]
        self._kept = values[len(values) if is_last else self.halving.needed(stop)[0] - first :].copy()

    def copy_blocks(self, file: IO[bytes]) -> None:
        """Write the blocks to a file."""
        self._blocks.seek(0)
        shutil.copyfileobj(self._blocks, file, 2**20)


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
      dtype: of its values; what stands for no value is `jaxurban.io.store.no_value`.
      rows: parts ``[y, x]`` of the map, all its rows from the north to the south.
      is_averaged: whether overviews hold means, else the cell in the middle.
      tags: of the file.
      title: of its band.
      unit: of its values.

    Raises:
      OSError: the file cannot be written.
    """
    profile = profile_of(grid, dtype)
    with ExitStack() as stack:
        images: list[_Image] = []
        for halving in reversed(_halvings(grid.shape, is_averaged)):
            spool = SpooledTemporaryFile(HELD_BYTES, dir=str(path.parent))  # noqa: SIM115
            blocks = stack.enter_context(spool)
            images.insert(0, _Image(halving, dtype, profile["nodata"], blocks, images[0] if images else None))
        for part in rows:
            images[0].add(part)
        head = _head(images, _tags_of(profile, tags, title, unit))
        with path.open("wb") as file:
            file.write(head)
            for image in reversed(images):
                image.copy_blocks(file)


def _halvings(shape: tuple[int, int], is_averaged: bool) -> list[Halving]:
    """Return the images of a map of a shape, the map itself first: overviews until one is a single block."""
    found = [Halving(shape, is_averaged)]
    while max(found[-1].shape) > BLOCK:
        found.append(Halving(found[-1].halved, is_averaged))
    return found


def _tags_of(profile: Mapping[str, Any], tags: Mapping[str, str], title: str, unit: str) -> dict[int, _Tag]:
    """Return the directory that GDAL writes for a file of one block, in which no data are."""
    small = {**profile, "width": BLOCK, "height": BLOCK, "blockxsize": BLOCK, "blockysize": BLOCK, "bigtiff": "NO"}
    with MemoryFile() as memory:
        with memory.open(**small, compress="ZSTD", predictor=1, sparse_ok=True) as file:
            file.update_tags(**tags)
            file.set_band_description(1, title)
            file.set_band_unit(1, unit)
        data = memory.read()
    found = {}
    (at,) = struct.unpack_from("<I", data, 4)
    (num,) = struct.unpack_from(CLASSIC.length, data, at)
    for entry in range(at + 2, at + 2 + 12 * num, 12):
        number, kind, count, offset = struct.unpack_from("<HHII", data, entry)
        size = TYPE_BYTES[kind] * count
        begin = offset if size > CLASSIC.inline else entry + 8
        found[number] = _Tag(kind, count, data[begin : begin + size])
    return found


def _head(images: list[_Image], tags: dict[int, _Tag]) -> bytes:
    """Return all that comes before the blocks."""
    num_bytes = sum(sum(image.sizes) + 8 * len(image.sizes) for image in images)
    for words in (CLASSIC, BIG):
        length = len(_directories(images, tags, words, 0))
        if length + num_bytes <= MOST_CLASSIC:
            break
    return _directories(images, tags, words, length)


def _directories(images: list[_Image], tags: dict[int, _Tag], words: _Words, length: int) -> bytes:
    """Return header, layout and directories of a file whose blocks begin at ``length``."""
    offsets = {}
    for image in reversed(images):
        sizes = np.array(image.sizes, np.int64) + 8
        offsets[image] = length + 4 + np.cumsum(sizes) - sizes
        length += int(sizes.sum())
    head = words.header + struct.pack(words.offset, len(words.header) + words.inline + len(LAYOUT)) + LAYOUT
    for image in images:
        num, own = len(image.sizes), tags
        if image is not images[0]:
            own = {SUBFILE: _REDUCED} | {number: tags[number] for number in OF_OVERVIEWS if number in tags}
        height, width = (_Tag(LONG, 1, struct.pack("<I", size)) for size in image.halving.shape)
        own = own | {
            WIDTH: width,
            HEIGHT: height,
            OFFSETS: _Tag(words.offset_kind, num, offsets[image].astype(f"<u{words.inline}").tobytes()),
            BYTE_COUNTS: _Tag(LONG, num, np.array(image.sizes, "<u4").tobytes()),
        }
        head += _directory(own, words, len(head), image is images[-1])
    return head


def _directory(tags: Mapping[int, _Tag], words: _Words, at: int, is_last: bool) -> bytes:
    """Return a directory that stands at a place of the file, with its values behind it."""
    size = struct.calcsize(words.length) + len(tags) * (struct.calcsize(words.entry) + words.inline) + words.inline
    fields, values = {}, b""
    for number in sorted(tags, key=lambda number: (number in (OFFSETS, BYTE_COUNTS), number)):  # these may be long
        data = tags[number].data
        if len(data) > words.inline:
            fields[number] = struct.pack(words.offset, at + size + len(values))
            values += data + b"\0" * (len(data) % 2)
        else:
            fields[number] = data.ljust(words.inline, b"\0")
    entries = b"".join(struct.pack(words.entry, number, *tags[number][:2]) + fields[number] for number in sorted(tags))
    after = struct.pack(words.offset, 0 if is_last else at + size + len(values))
    return struct.pack(words.length, len(tags)) + entries + after + values
