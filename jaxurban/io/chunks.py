"""The files of a Zarr: its chunks and metadata, and whether they are as they were written."""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr

from jaxurban.errors import InputError
from jaxurban.io.files import holds_bytes, is_whole

Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]  # `map`, or who works like it
BATCH = 64  # chunks that are checked as one piece of work


def metadata_file(path: Path) -> Path:
    """Return the file that holds the metadata of a Zarr and of its arrays once more, and the checksum of them all."""
    return path / ".zmetadata"


class Chunk(NamedTuple):
    """A chunk of an array: its place, and the file that holds it."""

    array: Any
    place: tuple[int, ...]
    file: Path


def metadata_of(path: Path) -> list[Path]:
    """Return the files of a Zarr's metadata, but for the one that holds them all; arrays of others are not in it.

    Raises:
      OSError, ValueError, TypeError: that one is missing or damaged.
    """
    return [path / str(name) for name in dict(dict(json.loads(metadata_file(path).read_bytes())).get("metadata", {}))]


def has_whole_metadata(path: Path) -> bool:
    """Return whether the metadata of a Zarr, of all its arrays together, are as they were written."""
    with suppress(OSError, ValueError, TypeError):
        return is_whole(metadata_file(path), *metadata_of(path))
    return False


def array_of(path: Path) -> Any:
    """Return an array of a Zarr, to be looked at; opening one takes as long as writing half a million cells."""
    return _opened(path, (path / ".zarray").stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _opened(path: Path, changed_ns: int) -> Any:
    return zarr.open_array(path, mode="r", zarr_format=2)


def chunks_of(path: Path, name: str | None = None) -> Iterator[Chunk]:
    """Yield the chunks that a Zarr, or one array of it, should hold."""
    for own, array in zarr.open_group(path, mode="r", zarr_format=2, use_consolidated=True).arrays():
        if name is None or own == name:
            for place in np.ndindex(array.cdata_shape):
                yield Chunk(array, place, path / own / array.metadata.encode_chunk_key(place))


def _is_decodable(chunk: Chunk) -> bool:
    if not holds_bytes(chunk.file):  # it would be read as its fill value
        return False
    try:
        _ = chunk.array.get_block_selection(chunk.place) if chunk.place else chunk.array[()]
    except Exception:  # what decoders raise at damaged bytes is in no list
        return False
    return True


def _undecodable(chunks: list[Chunk]) -> list[Chunk]:
    return [chunk for chunk in chunks if not _is_decodable(chunk)]


def broken_chunks(path: Path, each: Each = map, name: str | None = None) -> list[Chunk]:
    """Return the chunks of a Zarr of whole metadata, or of one array, that are missing or cannot be decoded.

    All are read: at 1 to 2 GiB/s of values a thread.

    Args:
      path: of the Zarr; absolute where ``each`` works elsewhere.
      each: calls a function with each of many batches.
      name: of the array.
    """
    chunks = list(chunks_of(path, name))
    batches = [chunks[start : start + BATCH] for start in range(0, len(chunks), BATCH)]
    return list(chain.from_iterable(each(_undecodable, batches)))


def damaged(file: Path, what: str) -> InputError:
    """Return the error that names a file of maps and the remedy."""
    return InputError(
        f"{str(file)!r} {what}: run the same `jaxurban maps` command again, which makes anew what is broken (maps that "
        "were saved from Python: save them again)"
    )


def error_in(path: Path, error: Exception, names: Iterable[str | None] = (None,)) -> Exception:
    """Return the error that names the damaged file of a Zarr that could not be read, else the one given."""
    if not has_whole_metadata(path):
        return damaged(metadata_file(path), "and the metadata of the arrays beside it are not as they were written")
    broken = [chunk for name in names for chunk in broken_chunks(path, name=name)]
    return damaged(broken[0].file, "is damaged or cannot be read") if broken else error
