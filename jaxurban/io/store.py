"""Metric maps on disk as Zarr: each file whole or not there at all, and all of them as they were written.

Chunks carry the checksum of Zstandard, metadata a CRC-32. Every chunk is written, so that one that is missing is
damage; were it read all the same, it would be blocked cells or NaN, never free air.
"""

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
import zarr
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing
from zarr.codecs import ZstdCodec

from jaxurban.errors import InputError
from jaxurban.io.files import BLANK, FIELD, SCRATCH_SUFFIX, holds_bytes, is_whole, remove, seal, whole_file
from jaxurban.world.tiling import tile_shape

RUN_FILE = "run.json"
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
COMPRESSORS = (ZstdCodec(level=0, checksum=True),)
FILL_VALUES = {"obstacle": 1}  # of others by type: NaN, False, 0
NEEDED = ("obstacle", "has_data")  # without these it is not a folder of maps


def short_number(value: float) -> str:
    """Return a number as file names carry it: ``5``, ``2.5``."""
    return f"{value:g}"


def zarr_path(folder: Path, resolution_m: float) -> Path:
    """Return where the maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f"{short_number(resolution_m)}m"


def stored_resolutions(folder: Path) -> dict[float, Path]:
    """Return where the maps under ``folder`` lie, by resolution in metres."""
    named = ((re.fullmatch(r"([0-9.e+-]+)m", path.name), path) for path in sorted((folder / ZARR_FOLDER).glob("*m")))
    return {float(match[1]): path for match, path in named if match and path.is_dir()}


def are_of_a_run(folder: Path) -> bool:
    """Return whether maps under ``folder`` are those of ``jaxurban maps``, which writes `RUN_FILE` too."""
    files = (path / "zarr.json" for path in stored_resolutions(folder).values())
    return any(b'"run_key"' in file.read_bytes() for file in files if file.is_file())


def work_path(folder: Path, resolution_m: float) -> Path:
    """Return where the unfinished maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f".{short_number(resolution_m)}m{SCRATCH_SUFFIX}"


def remove_maps(folder: Path) -> None:
    """Remove the maps that a job wrote under ``folder`` and its record, and nothing else.

    The Zarr goes last: while it stands the folder is known to hold that job's maps.
    """
    for part in (RUN_FILE, GEOTIFF_FOLDER, ZARR_FOLDER):
        remove(folder / part)


def _encoding(name: str, array: xr.Variable, tile: tuple[int, int] | None) -> dict[str, Any]:
    """Return how a variable is written: a map in tiles, one layer a chunk; without a tile, all in one chunk."""
    encoding: dict[str, Any] = {"compressors": COMPRESSORS}
    if array.dtype.kind in "fiub":
        encoding["fill_value"] = FILL_VALUES.get(
            name, np.nan if array.dtype.kind == "f" else array.dtype.type(0).item()
        )
    if tile is not None and array.dims[-2:] == ("y", "x"):
        encoding["chunks"] = (*(1 for _ in array.dims[:-2]), *tile)
    return encoding


def _to_zarr(
    ds: xr.Dataset, path: Path, mode: Literal["w", "a"], tile: tuple[int, int] | None = None, compute: bool = True
) -> None:
    """Write a dataset, and the checksum of the Zarr's metadata into its attributes."""
    encoding = {str(name): _encoding(str(name), array, tile) for name, array in ds.variables.items()}
    how: dict[str, Any] = {"zarr_format": 3, "consolidated": False, "write_empty_chunks": True, "compute": compute}
    ds.to_zarr(path, mode=mode, encoding=encoding, **how)
    zarr.open_group(path, mode="r+", use_consolidated=False).attrs[FIELD] = BLANK
    seal(*_metadata(path))


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps under ``folder`` and return its place (``maps.zarr/5m``)."""
    path = zarr_path(folder, ds.attrs["resolution_m"])
    plain = ds.drop_encoding()  # of the files that maps were opened from
    with whole_file(path) as scratch:
        _to_zarr(plain, scratch, "w", tile_shape((ds.sizes["y"], ds.sizes["x"])))
    return path


def create_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int]) -> None:
    """Write the Zarr of a dataset of dask arrays: coordinates, attributes, and maps without values.

    Args:
      ds: the dataset.
      path: where to.
      tile: rows and columns of a chunk, what one `write_layer` fills.
    """
    with whole_file(path) as scratch:
        _to_zarr(ds, scratch, "w", tile, compute=False)


def write_layer(path: Path, name: str, index: tuple[int, ...], window: tuple[slice, slice], values: np.ndarray) -> None:
    """Write a tile of one map into a Zarr: its values, as far as the window reaches."""
    rows, cols = window
    # A tile without a value is written too: what is missing on disk counts as lost. Given to `open_array`, Zarr 3.1
    # does not take the setting.
    array = zarr.open_array(path / name, mode="r+").with_config({"write_empty_chunks": True})
    place: Any = (*index, rows, cols)
    array[place] = values[: rows.stop - rows.start, : cols.stop - cols.start]


def add_to_zarr(ds: xr.Dataset, path: Path) -> None:
    """Add the variables of a dataset to a Zarr."""
    _to_zarr(ds.drop_vars(list(ds.coords)), path, "a")


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps under ``folder``; values are read when they are looked at.

    Raises:
      InputError: no maps there, several resolutions and none chosen, or maps that are damaged (see `open_whole`).
    """
    found = stored_resolutions(folder)
    listed = ", ".join(map(short_number, sorted(found)))
    if not found:
        raise InputError(f"{str(folder)!r} holds no metric maps: make them with `jaxurban maps SCENARIO -o {folder}`")
    if resolution_m is None and len(found) > 1:
        raise InputError(f"{str(folder)!r} holds maps at {listed} m: choose one with resolution_m (--resolution)")
    if resolution_m is not None and resolution_m not in found:
        raise InputError(f"{str(folder)!r} holds no maps at {short_number(resolution_m)} m, only at {listed} m")
    path = found[resolution_m] if resolution_m is not None else next(iter(found.values()))
    ds = open_whole(path)
    if lost := [name for name in NEEDED if name not in ds]:
        raise InputError(f"the maps in {str(path)!r} lack {', '.join(lost)}: remove them and make them again")
    return ds


class Chunk(NamedTuple):
    """A chunk of an array: its place, and the file that holds it."""

    array: Any
    place: tuple[int, ...]
    file: Path


def _metadata(path: Path) -> list[Path]:
    return [path / "zarr.json", *sorted(path.glob("*/zarr.json"))]


def has_whole_metadata(path: Path) -> bool:
    """Return whether the metadata of a Zarr, of all its arrays together, are as they were written."""
    return is_whole(*_metadata(path))


def _chunks(path: Path, name: str | None = None) -> Iterator[Chunk]:
    """Yield the chunks that a Zarr, or one array of it, should hold."""
    for own, array in zarr.open_group(path, mode="r", use_consolidated=False).arrays():
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
    """Return the error that names the damaged file of a Zarr that could not be read, else the one given."""
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
        return xr.Dataset(maps, ds.coords.to_dataset().load().coords, attrs)  # small, and damage shows at once


def open_whole(path: Path) -> xr.Dataset:
    """Return the maps in a Zarr, every file of which is there; values are read, and decoded, when they are looked at.

    Raises:
      InputError: metadata are not as they were written, a chunk is missing or empty; later, one cannot be decoded.
    """
    try:
        if not has_whole_metadata(path):
            raise ValueError("metadata")
        for chunk in _chunks(path):  # looked at, not read
            if not holds_bytes(chunk.file):
                raise damaged(chunk.file, "is missing or empty")
        return xr.open_dataset(path, engine=_Maps)
    except InputError:
        raise
    except Exception as error:
        found = _error_in(path, error)
        if found is error:
            found = InputError(f"the maps in {str(path)!r} cannot be read ({error})")
        raise found from error
