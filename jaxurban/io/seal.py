"""Files that tell whether they are as they were written, by a CRC-32 in their own text."""

import json
import mmap
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

MARK, DIGITS = b"jaxurban-crc32:", 8
BLANK = MARK.decode() + "0" * DIGITS  # what a writer leaves in a file's text (a tag, an attribute) for `seal`
FIELD = "checksum"  # the name of that text
BLOCK_BYTES = 1 << 22


def _sum(path: Path, more: tuple[Path, ...]) -> tuple[int, bytes, bytes] | None:
    """Return where the digits stand, those there, and those that belong there; None where there is no place."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            place = data.find(MARK) + len(MARK)
            if place < len(MARK) or place + DIGITS > len(data):
                return None
            held, crc = data[place : place + DIGITS], 0
            for start, stop in ((0, place), (place + DIGITS, len(data))):
                for begin in range(start, stop, BLOCK_BYTES):
                    crc = zlib.crc32(data[begin : min(begin + BLOCK_BYTES, stop)], crc)
    except ValueError:  # an empty file cannot be mapped
        return None
    for other in more:
        crc = zlib.crc32(other.read_bytes(), crc)
    return place, held, b"%08x" % crc


def seal(path: Path, *more: Path) -> None:
    """Write the CRC-32 of a file, and of ``more`` that belong to it, into the file's `BLANK`."""
    found = _sum(path, more)
    assert found is not None, f"no place for a checksum in {path}"
    with path.open("r+b") as file:
        file.seek(found[0])
        file.write(found[2])


def is_whole(path: Path, *more: Path) -> bool:
    """Return whether a file, with ``more`` that belong to it, is as `seal` left it; False where one is missing."""
    try:
        found = _sum(path, more)
    except OSError:
        return False
    return found is not None and found[1] == found[2]


def write_json(path: Path, value: Mapping[str, Any], indent: int | None = None) -> None:
    """Write a JSON object with its checksum into a scratch file."""
    path.write_text(json.dumps({**value, FIELD: BLANK}, indent=indent) + "\n", encoding="utf-8")
    seal(path)


def read_json(path: Path) -> dict[str, Any]:
    """Return what `write_json` wrote.

    Raises:
      OSError: the file is missing or cannot be read.
      ValueError: it is not as it was written.
    """
    data = path.read_bytes()
    if not is_whole(path):
        raise ValueError("not as it was written")
    value = json.loads(data)
    del value[FIELD]
    return value


def write_npz(path: Path, arrays: Mapping[str, np.ndarray], is_compressed: bool = False) -> None:
    """Write arrays as .npz, with the checksum as the archive's comment, into a scratch file.

    The CRC-32 of .npz itself covers each array, but no flipped bit that makes a reader overlook one.
    """
    with path.open("wb") as file:
        (np.savez_compressed if is_compressed else np.savez)(file, allow_pickle=False, **arrays)
    with zipfile.ZipFile(path, "a") as archive:
        archive.comment = BLANK.encode()
    seal(path)


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays that `write_npz` wrote.

    Raises:
      OSError: the file is missing or cannot be read.
      ValueError: it is not as it was written.
    """
    with path.open("rb") as file:
        if not is_whole(path):
            raise ValueError("not as it was written")
        with np.load(file, allow_pickle=False) as kept:
            return {name: kept[name] for name in kept.files}
