"""Maps in a Zarr that are all there and as they were written: how that is made sure, and told.

Chunks carry the checksum of Zstandard, metadata a CRC-32. Every chunk is written, so that one that is missing is
damage; were it read all the same, it would be blocked cells or NaN, never free air.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
import zarr
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing
from zarr.codecs import ZstdCodec

from jaxurban.errors import InputError
from jaxurban.io.seal import BLANK, FIELD, is_whole, seal

COMPRESSORS = (ZstdCodec(level=0, checksum=True),)
FILL_VALUES = {"obstacle": 1}  # of others by type: NaN, False, 0


class Chunk(NamedTuple):
    """A chunk of an array: its place, and the file that holds it."""

    array: Any
    place: tuple[int, ...]
    file: Path


def encoding_of(name: str, dtype: np.dtype) -> dict[str, Any]:
    """Return how a variable is written, but for its chunks."""
    encoding: dict[str, Any] = {"compressors": COMPRESSORS}
    if dtype.kind in "fiub":
        encoding["fill_value"] = FILL_VALUES.get(name, np.nan if dtype.kind == "f" else dtype.type(0).item())
    return encoding


def _metadata(path: Path) -> list[Path]:
    return [path / "zarr.json", *sorted(path.glob("*/zarr.json"))]


def seal_metadata(path: Path) -> None:
    """Write the checksum of a Zarr's metadata into its attributes."""
    zarr.open_group(path, mode="r+", use_consolidated=False).attrs[FIELD] = BLANK
    seal(*_metadata(path))


def has_whole_metadata(path: Path) -> bool:
    """Return whether the metadata of a Zarr, of all its arrays together, are as they were written."""
    return is_whole(*_metadata(path))


def _sizes(folder: Path, prefix: str = "") -> Iterator[tuple[str, int]]:
    """Yield the files under a folder by their path in it, with their sizes."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _sizes(Path(entry.path), f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.stat().st_size


def _chunks(path: Path, name: str | None = None) -> Iterator[Chunk]:
    """Yield the chunks that a Zarr, or one array of it, should hold."""
    for own, array in zarr.open_group(path, mode="r", use_consolidated=False).arrays():
        if name is None or own == name:
            for place in np.ndindex(array.cdata_shape):
                yield Chunk(array, place, path / own / array.metadata.encode_chunk_key(place))


def missing_chunks(path: Path) -> Iterator[Chunk]:
    """Yield the chunks of a Zarr of whole metadata that are not there, or empty; folders are listed, no file read."""
    sizes = dict(_sizes(path))
    for chunk in _chunks(path):
        if not sizes.get(chunk.file.relative_to(path).as_posix()):
            yield chunk


def _is_decodable(chunk: Chunk) -> bool:
    if not chunk.file.is_file():  # it would be read as its fill value
        return False
    try:
        _ = chunk.array.get_block_selection(chunk.place) if chunk.place else chunk.array[()]
    except Exception:  # what decoders raise at damaged bytes is in no list
        return False
    return chunk.file.stat().st_size > 0


def broken_chunks(path: Path, num_threads: int = 1, name: str | None = None) -> list[Chunk]:
    """Return the chunks of a Zarr of whole metadata, or of one array, that are missing or cannot be decoded.

    All are read: at 1 to 2 GiB/s of values a thread.
    """
    chunks = list(_chunks(path, name))
    with ThreadPoolExecutor(num_threads) as pool:
        return [chunk for chunk, is_good in zip(chunks, pool.map(_is_decodable, chunks), strict=True) if not is_good]


def damaged(file: Path, what: str) -> InputError:
    """Return the error that names a file of maps and the remedy."""
    return InputError(
        f"{str(file)!r} {what}: run the same `jaxurban maps` command again, which makes anew what is broken (maps that "
        "were saved from Python: save them again)"
    )


def _error_in(path: Path, error: Exception, name: str | None = None) -> Exception:
    """Return the error that names the damaged file of a Zarr that could not be read; the one given where none is."""
    if not has_whole_metadata(path):
        return damaged(path / "zarr.json", "and the zarr.json of the arrays beside it are not as they were written")
    broken = broken_chunks(path, name=name)
    return damaged(broken[0].file, "is damaged or cannot be read") if broken else error


class _Map(BackendArray):
    """A map in a Zarr, read when it is looked at; one that cannot be read is an InputError."""

    def __init__(self, variable: xr.Variable, path: Path, name: str) -> None:
        self.variable, self.path, self.name = variable, path, name
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple) -> np.ndarray:
        try:
            return self.variable[key].values
        except Exception as error:
            raise _error_in(self.path, error, self.name) from error


class _Maps(BackendEntrypoint):
    """How xarray opens the Zarr: as it always does, with `_Map` around every map."""

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: Any = None) -> xr.Dataset:
        ds = xr.open_dataset(filename_or_obj, engine="zarr", consolidated=False, chunks=None, cache=False)
        maps = {
            name: xr.Variable(
                ds[name].dims,
                indexing.LazilyIndexedArray(_Map(ds[name].variable, Path(filename_or_obj), str(name))),
                ds[name].attrs,
                ds[name].encoding,
            )
            for name in ds.data_vars
        }
        attrs = {name: value for name, value in ds.attrs.items() if name != FIELD}
        return xr.Dataset(maps, ds.coords.to_dataset().load().coords, attrs)  # small, and damage is told at once


def open_whole(path: Path) -> xr.Dataset:
    """Return the maps in a Zarr, every file of which is there; values are read, and decoded, when they are looked at.

    Raises:
      InputError: metadata are not as they were written, a chunk is missing or empty; later, one cannot be decoded.
    """
    try:
        if not has_whole_metadata(path):
            raise ValueError("metadata")
        for chunk in missing_chunks(path):
            raise damaged(chunk.file, "is missing or empty")
        return xr.open_dataset(path, engine=_Maps)
    except InputError:
        raise
    except Exception as error:
        found = _error_in(path, error)
        if found is error:
            found = InputError(f"the maps in {str(path)!r} cannot be read ({error})")
        raise found from error
