"""Metric maps on disk as Zarr: each file whole or not there at all, and all of them as they were written.

A group of Zarr v2 for each resolution, which GDAL and xarray read by their ordinary ways, alone or by the group above
them: rows from north to south, and from south to north in what is opened here. The record of the folder
(`jaxurban.io.workspace`) has the checksum of every file, and chunks carry that of Zstandard too. Every chunk is
written, so that a missing one is damage; were it read all the same, it would be blocked cells, NaN or no satellite, not
free air.
"""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numcodecs import Zstd
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

from jaxurban.errors import InputError, RemadeError
from jaxurban.io.files import (
    checksum_of,
    is_as_written,
    scratch_for,
    whole_file,
    write_whole,
)
from jaxurban.io.stored import (
    METADATA,
    ZARR_FOLDER,
    root_files,
    short_number,
    stored_maps,
    stored_resolutions,
    zarr_path,
)
from jaxurban.io.workspace import Workspace, recorded
from jaxurban.knowledge import guesses_from
from jaxurban.metrics.variables import NEEDED, no_value
from jaxurban.world.grid import tile_shape

COMPRESSOR = Zstd(level=1, checksum=True)
NO_BYTE = np.iinfo(np.int8).max  # what stands for no value in bytes: NetCDF 3 has signed ones only
PLAIN_KINDS = "biufcmMSU"  # of NumPy's types: numbers, times, and text of one length
TEXT_KINDS = "OU"  # of text of any length
TEXT_FILTERS = [{"id": "vlen-utf8"}]  # of it; Zarr 3.0 has the filter for all text
OPENED = "opened"  # encoding of an opened dataset: what checks that its files are unchanged
LAYOUT_KEY = "jaxurban_layout"
LAYOUT = 2  # of maps in a folder; those without the entry have the first
TIMES = {"units": "seconds since 1970-01-01", "calendar": "proleptic_gregorian", "dtype": "int64"}


def stored_key(folder: Path, resolution_m: float) -> str | None:
    """Return the run key of the maps at one resolution under ``folder``.

    None where there are no such maps, where they are damaged, and where they were saved from Python, without a key.
    """
    if resolution_m not in stored_resolutions(folder):
        return None
    with suppress(InputError):
        return open_zarr(folder, resolution_m).attrs.get("run_key")
    return None


def _is_map(array: xr.Variable) -> bool:
    """Return whether a variable has a value for each cell: its last axes are y and x."""
    return array.dims[-2:] == ("y", "x")


def _encoding(array: xr.Variable, tile: tuple[int, int]) -> dict[str, Any]:
    """Return how xarray is to write a variable into a Zarr.

    Args:
      array: the variable.
      tile: rows and columns of a tile. A chunk of a map holds one tile of one layer, that is of one place along the
        axes before y and x.
    """
    missing = NO_BYTE if array.dtype == np.uint8 else no_value(array.dtype)
    encoding: dict[str, Any] = {"compressors": (COMPRESSOR,), "_FillValue": missing}
    if _is_map(array):
        encoding["chunks"] = (1,) * (array.ndim - 2) + tile
    if array.dtype.kind == "M":
        encoding |= TIMES
    return encoding


def _to_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int] = (1, 1)) -> None:
    """Write a dataset into a new Zarr, and then the metadata of all of it in one file.

    The values of its maps are left out.

    Args:
      ds: rows from south to north; in the Zarr they go from north to south.
      path: of the Zarr.
      tile: rows and columns of a chunk of a map.
    """
    import dask.array

    # Without the encoding of files that were opened before.
    ds = ds.drop_encoding().assign_attrs({LAYOUT_KEY: LAYOUT})
    for name, array in list(ds.variables.items()):
        if array.dtype.kind == "T" and name in ds.coords:  # text of any length becomes text of one
            texts = np.array(array.values.tolist(), str)
            ds = ds.assign_coords({name: (array.dims, texts, array.attrs)})
        elif _is_map(array):
            no_values = dask.array.zeros(array.shape, dtype=array.dtype, chunks=-1)
            ds[name] = (array.dims, no_values, array.attrs)
    if "y" in ds.coords:
        ds = ds.assign_coords(y=ds["y"][::-1])

    # With `compute=False` xarray writes no array of Dask, which the maps are here.
    encoding = {str(name): _encoding(array, tile) for name, array in ds.variables.items()}
    ds.to_zarr(
        path,
        mode="a",
        encoding=encoding,
        zarr_format=2,
        consolidated=False,
        write_empty_chunks=True,
        compute=False,
    )

    # The metadata of all arrays in one file.
    of_arrays = sorted((*path.glob("*/.zarray"), *path.glob("*/.zattrs")))
    files = [path / ".zattrs", path / ".zgroup", *of_arrays]
    parts = {file.relative_to(path).as_posix(): json.loads(file.read_bytes()) for file in files}
    (path / METADATA).write_bytes(_consolidated(parts))


def _consolidated(parts: Mapping[str, Any]) -> bytes:
    """Return the bytes of a `METADATA` file: the metadata of many files by their names under its folder."""
    return json.dumps({"metadata": parts, "zarr_consolidated_format": 1}).encode()


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps, rows from south to north, under ``folder``, and return the path of its Zarr.

    Raises:
      InputError: the folder cannot be written to, or a file of others is in the way.
    """
    path = zarr_path(folder, ds.attrs["resolution_m"])
    num_rows = ds.sizes["y"]
    num_cols = ds.sizes["x"]
    tile_rows, tile_cols = tile_shape((num_rows, num_cols))
    checksums: dict[str, str] = {}
    with scratch_for(path) as scratch:
        _to_zarr(ds, scratch, (tile_rows, tile_cols))
        maps = {str(name): array for name, array in ds.variables.items() if _is_map(array)}
        for name, array in maps.items():
            for layer in np.ndindex(array.shape[:-2]):
                values = array[layer].values
                # Chunks are counted from the northwest and rows from the south: a smaller last chunk is in the south.
                for stop in range(num_rows, 0, -tile_rows):
                    rows = slice(max(0, stop - tile_rows), stop)
                    for start in range(0, num_cols, tile_cols):
                        window = rows, slice(start, min(start + tile_cols, num_cols))
                        checksums |= write_layer(scratch, name, layer, window, values[window])
        put_zarr(scratch, path, checksums)
    return path


def create_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int]) -> None:
    """Write the Zarr of a dataset: coordinates, attributes, and maps without values, which `write_layer` fills in.

    Args:
      ds: the dataset, rows from south to north; the values of its maps are not looked at.
      path: of the Zarr.
      tile: rows and columns of a chunk.

    Raises:
      InputError: it cannot be written.
    """
    with whole_file(path) as scratch:
        _to_zarr(ds, scratch, tile)


def write_layer(
    path: Path,
    name: str,
    index: tuple[int, ...],
    window: tuple[slice, slice],
    values: np.ndarray,
) -> dict[str, str]:
    """Write a tile of one map into a Zarr: one chunk, as the Zarr library writes it but without its threads for each.

    ``array[...] = values`` takes 18 % more CPU time for chunks of 1,024 x 1,024 cells, and twice as much for 256 x 256.
    A tile without a value is written too: what is missing on disk counts as lost.

    Args:
      path: of the Zarr.
      name: of the variable.
      index: of the map along the variable's axes before y and x.
      window: rows, counted from the south, and columns of the map; their borders are those of one chunk.
      values: ``[y, x]`` rows south to north; they may stick out of the window in the south and in the east, and what
        sticks out is not written.

    Returns:
      The checksum of the chunk by its name in the Zarr.

    Raises:
      InputError: it cannot be written.
    """
    array = json.loads((path / name / ".zarray").read_bytes())
    rows, cols = window
    num_rows, num_cols = array["chunks"][-2:]
    num_beyond = len(values) - (rows.stop - rows.start)  # rows south of the window
    values = values[num_beyond:, : cols.stop - cols.start][::-1]

    # Chunks have one size and are counted from the northwest: what the map does not fill of one holds no value.
    chunk = np.full((num_rows, num_cols), array["fill_value"] or 0, array["dtype"])
    chunk[: len(values), : values.shape[1]] = values
    from_north = (array["shape"][-2] - rows.stop) // num_rows
    key = ".".join(map(str, (*index, from_north, cols.start // num_cols)))
    data = bytes(COMPRESSOR.encode(chunk))
    write_whole(path / name / key, data)
    return {f"{name}/{key}": checksum_of(data)}


def put_zarr(made: Path, path: Path, checksums: Mapping[str, str]) -> None:
    """Record the files of a finished Zarr, and give it its name in place of an older one.

    Files of others stay where they are, as of `Workspace.put_folder`.

    Args:
      made: the finished Zarr.
      path: its name to be, see `zarr_path`.
      checksums: of some of its files, by their names in it; of the others they are computed from the files.

    Raises:
      InputError: a file of others is in the way.
    """
    names = [file.relative_to(made).as_posix() for file in made.rglob("*") if file.is_file()]
    of_files = {name: checksums.get(name) or checksum_of(made / name) for name in names}
    with Workspace.shared(path.parents[1], "maps") as workspace:
        # The metadata of all resolutions name the older maps too: they are written again, last.
        workspace.remove([f"{ZARR_FOLDER}/{METADATA}"])
        workspace.put_folder(made, path, of_files, METADATA)
        put_root(workspace.folder)


def put_root(folder: Path) -> None:
    """Write the group above the resolutions (see `root_files`), unless it is there already.

    It holds the metadata of all resolutions whose own metadata are as they were written.

    Raises:
      InputError: a file of others is in the way.
    """
    checksums = recorded(folder)
    group = {"zarr_format": 2}
    parts: dict[str, Any] = {".zgroup": group}
    for path in stored_resolutions(folder).values():
        file = path / METADATA
        if is_as_written(file, checksums[file.relative_to(folder).as_posix()]):
            of_resolution = json.loads(file.read_bytes())["metadata"]
            parts |= {f"{path.name}/{name}": part for name, part in of_resolution.items()}
    contents = json.dumps(group).encode(), _consolidated(parts)
    for file, content in zip(root_files(folder), contents, strict=True):
        if not is_as_written(file, [checksum_of(content)]):
            write_whole(file, content)


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps of one resolution under ``folder``, rows from south to north.

    Values are read when they are looked at.

    Args:
      folder: that `write_zarr` or ``jaxurban maps`` wrote into.
      resolution_m: of the maps; None takes the only one that is there.

    Raises:
      InputError: no maps there, not at this resolution, several resolutions and none chosen, maps of another version,
        maps that lack a needed variable, or damaged ones (see `open_whole`).
    """
    paths = stored_maps(folder)
    listed = ", ".join(map(short_number, paths))
    if resolution_m is None and len(paths) > 1:
        raise InputError(
            f"{str(folder)!r} holds maps at {listed} m: choose one with resolution_m (--resolution)"
        )
    if resolution_m is not None and resolution_m not in paths:
        raise InputError(
            f"{str(folder)!r} holds no maps at {short_number(resolution_m)} m, only at {listed} m"
        )
    path = next(iter(paths.values())) if resolution_m is None else paths[resolution_m]

    ds = open_whole(path)
    missing = [name for name in NEEDED if name not in ds]
    if missing:
        raise InputError(
            f"the maps in {str(path)!r} lack {', '.join(missing)}: remove them and make them again"
        )
    return ds


class _Opened(NamedTuple):
    """A Zarr when it was opened.

    Attributes:
      path: of the Zarr.
      place: number of the file of its metadata on the disk, and its time of writing in nanoseconds.
      metadata: the bytes of that file.
    """

    path: Path
    place: tuple[int, int]
    metadata: bytes

    @classmethod
    def at(cls, path: Path) -> "_Opened":
        """Return the Zarr at a path as it is now; OSError where it is not there."""
        place = (path / METADATA).stat()
        return cls(path, (place.st_ino, place.st_mtime_ns), (path / METADATA).read_bytes())

    def check(self) -> None:
        """Raise RemadeError unless the Zarr is still the one that was opened, or was repaired by the same run.

        The metadata of a repaired one are the same, with the key of the run in them. Maps that were saved from Python
        have no such key, and the same metadata may go with other values.
        """
        with suppress(OSError):
            now = _Opened.at(self.path)
            is_repaired = b'"run_key"' in self.metadata and self.metadata == now.metadata
            if is_repaired or self.place == now.place:
                return
        raise RemadeError(
            f"the maps in {str(self.path)!r} were made again or removed since they were opened: open them again"
        )


class _Map(BackendArray):
    """A map in a Zarr, read when it is looked at; one that cannot be read is an InputError.

    Attributes:
      array: the map as it is, rows south to north.
      opened: the Zarr when it was opened.
      name: of the map.
      missing: what a chunk that is not there is read as; None of maps whose dtype has no such value.
    """

    def __init__(self, array: xr.Variable, opened: "_Opened", name: str, missing: Any) -> None:
        """Wrap a variable as xarray's Zarr reader gives it; arguments as the attributes of this class."""
        self.array = array
        self.opened = opened
        self.name = name
        self.missing = missing
        self.shape = array.shape
        self.dtype = array.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        """Return the values at an index of xarray's, read from the file."""
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._read
        )

    def _read(self, key: tuple) -> np.ndarray:
        """Return the values at an index of xarray's, read from the chunks that it meets.

        A chunk of bytes that went after opening is read as `missing`: that becomes 1 of obstacles, and else 0.

        Raises:
          InputError: a file is damaged or cannot be read.
          RemadeError: the Zarr was made again or removed since it was opened.
        """
        try:
            values = np.asarray(self.array[key].values, order="C")
            if values.dtype.kind == "u":
                values[values == self.missing] = self.name == "obstacle"
        except Exception as error:
            self.opened.check()
            raise _damage_in(self.opened.path, self.name) or error from error
        self.opened.check()  # after reading: metadata go first where maps are removed, and come last
        return values


class _Maps(BackendEntrypoint):
    """How xarray opens the Zarr: as it always does, with rows from the south and `_Map` around every map."""

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: Any = None) -> xr.Dataset:
        """Return the maps of a Zarr from south to north; values are read, and checked, when they are looked at.

        Args:
          filename_or_obj: the path of the Zarr.
          drop_variables: not looked at; xarray asks for the argument.

        Raises:
          RemadeError: the Zarr was made again or removed in the meantime.
        """
        # By the consolidated metadata alone, at which `open_whole` has looked: so no array of others is opened.
        opened = _Opened.at(Path(filename_or_obj))
        ds = xr.open_dataset(
            filename_or_obj,
            engine="zarr",
            chunks=None,
            cache=False,
            consolidated=True,
            zarr_format=2,
            mask_and_scale=False,
        )

        # Undo what belongs to the file: its attributes, rows from the north, and its encoding but for the chunks, as
        # Zarr 3 lacks the compressors of Zarr 2 (`Dataset.to_zarr` would fail: xarray 10032).
        missing = {name: array.attrs.get("_FillValue") for name, array in ds.data_vars.items()}
        for variable in ds.variables.values():
            variable.attrs.pop("_FillValue", None)
            variable.encoding = {"chunks": variable.encoding["chunks"]}
        ds = ds.isel({"y": slice(None, None, -1)}, missing_dims="ignore")

        # Maps become lazy; coordinates are read at once.
        maps = {}
        for name, array in ds.data_vars.items():
            values = _Map(array.variable, opened, str(name), missing[name])
            lazy = indexing.LazilyIndexedArray(values)
            maps[name] = xr.Variable(array.dims, lazy, array.attrs, array.encoding)
        coords = ds.coords.to_dataset().load()  # small, and damage shows at once
        opened.check()
        for name, coord in list(coords.variables.items()):
            if coord.dtype.kind == "U":  # text has any length in memory
                coords[name] = coords[name].astype(np.dtypes.StringDType())
        ds = xr.Dataset(maps, coords.coords, ds.attrs)
        ds.encoding[OPENED] = opened
        return ds


def open_whole(path: Path) -> xr.Dataset:
    """Return the maps in a Zarr after a look at every file of it, with rows from south to north.

    Metadata are compared with their checksums. Of chunks only the sizes are compared, as their values are read and
    decoded later, when somebody uses them.

    Raises:
      InputError: metadata are not as they were written, a chunk is missing or cut, an array is not coded as ours are,
        a newer jaxurban wrote them in another layout, or their resolution is no length or their guesses are no object
        of JSON; later, a chunk cannot be decoded.
    """
    try:
        for file, checksums in _recorded(path).items():
            if file.name.startswith(".z"):
                if not is_as_written(file, checksums):
                    what = "and the metadata of the arrays beside it are not as they were written"
                    raise _damaged(path / METADATA, what)
                continue
            # A checksum ends with a hyphen and the size of the file in bytes.
            sizes = {checksum.partition("-")[2] for checksum in checksums}
            if not file.is_file() or f"{file.stat().st_size}" not in sizes:
                raise _damaged(file, "is missing or cut")

        # The codes of the arrays are checked before anything is decoded, as a code may run a program.
        _check_arrays(path / METADATA, json.loads((path / METADATA).read_bytes())["metadata"])
        ds = xr.open_dataset(path, engine=_Maps)
        layout = ds.attrs.pop(LAYOUT_KEY, 1)
        if layout != LAYOUT:
            raise InputError(
                f"the maps in {str(path)!r} have layout {layout!r}, and this version of jaxurban reads {LAYOUT}: "
                "update jaxurban, or make the maps again in a new folder"
            )
        with suppress(KeyError, TypeError, ValueError):
            guesses_from(ds.attrs.get("guesses", "[]"))
            if 0 < ds.attrs["resolution_m"] < math.inf:
                return ds
        raise InputError(
            f"the attributes of {str(path)!r} are not those of maps: make the maps again in a new folder"
        )
    except InputError:
        raise
    except Exception as error:
        unread = InputError(f"the maps in {str(path)!r} cannot be read ({error})")
        raise _damage_in(path) or unread from error


def _check_arrays(file: Path, metadata: Mapping[str, Any]) -> None:
    """Raise InputError unless all arrays of a Zarr are coded as `_to_zarr` codes them: other codecs may run code."""
    arrays = [array for name, array in metadata.items() if name.endswith(".zarray")]
    if not all(map(_is_ours, arrays)):
        raise InputError(
            f"{str(file)!r} names arrays that are not coded as jaxurban codes maps, and is not opened, as other codes "
            "may run programs: make the maps again in a new folder"
        )


def _is_ours(array: Mapping[str, Any]) -> bool:
    """Return whether an array of these metadata (of a ``.zarray`` file) is coded as `_to_zarr` codes arrays.

    Plain types have no filter, text of any length has the one of `TEXT_FILTERS`, and all have the compressor.
    """
    match array:
        case {"dtype": str(dtype), "compressor": {"id": COMPRESSOR.codec_id}}:
            kind = np.dtype(dtype).kind
            filters = array.get("filters")
            is_plain = kind in PLAIN_KINDS and not filters
            return is_plain or (kind in TEXT_KINDS and filters == TEXT_FILTERS)
    return False


def _recorded(path: Path) -> dict[Path, set[str]]:
    """Return the checksums that each recorded file of a Zarr may have: during a run the old and the new one."""
    folder = path.parents[1]
    prefix = f"{ZARR_FOLDER}/{path.name}/"
    return {
        folder / name: checksums
        for name, checksums in recorded(folder).items()
        if name.startswith(prefix)
    }


def _damage_in(path: Path, name: str = "") -> InputError | None:
    """Return the error that names the first damaged file of an array of a Zarr, None if all are as they were written.

    Without the name of an array the files of all arrays are read.
    """
    for file, checksums in _recorded(path).items():
        is_asked = not name or file.parent.name == name
        if is_asked and not is_as_written(file, checksums):
            return _damaged(file, "is damaged or cannot be read")
    return None


def _damaged(file: Path, what: str) -> InputError:
    """Return the error that says of a file of a Zarr what is wrong with it (``"is missing"``) and how to repair it."""
    return InputError(
        f"{str(file)!r} {what}: run the same `jaxurban maps` command again, which repairs what is broken (maps that "
        "were saved from Python: save them again)"
    )
