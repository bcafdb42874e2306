"""Metric maps on disk as Zarr: each file whole or not there at all, and all of them as they were written.

A group of Zarr v2 for each resolution, which GDAL and xarray read by their ordinary ways, alone or by the group above
them: rows from north to south, and from south to north in what is opened here. The record of the folder
(`jaxurban.io.workspace`) has the checksum of every file, and chunks carry that of Zstandard too. Every chunk is
written, so that a missing one is damage; were it read all the same, it would be blocked cells, NaN or no satellite, not
free air.
"""

import json
import numbers
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

import dask.array
import numpy as np
import xarray as xr
from numcodecs import Zstd
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

from jaxurban.errors import InputError, RemadeError
from jaxurban.io.files import (
    SCRATCH_SUFFIX,
    checksum_of,
    is_as_written,
    read_json,
    scratch_for,
    whole_file,
    write_whole,
)
from jaxurban.io.workspace import Workspace, recorded
from jaxurban.metrics.variables import NEEDED, no_value
from jaxurban.world.grid import tile_shape

RUN_FILE = "run.json"
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
COMPRESSOR = Zstd(level=1, checksum=True)
# Attributes that are no map's: the CRS for GDAL, as 1.0.0 wrote it, and no value.
FOREIGN = ("_CRS", "_FillValue")
NO_BYTE = np.iinfo(np.int8).max  # what stands for no value in bytes: NetCDF 3 has signed ones only
PLAIN_KINDS = "biufcmMSU"  # of NumPy's types: numbers, times, and text of one length
TEXT_KINDS = "OU"  # of text of any length
TEXT_FILTERS = [{"id": "vlen-utf8"}]  # of it; Zarr 3.0 has the filter for all text
OPENED = "opened"  # encoding of an opened dataset: what checks that its files are unchanged
METADATA = ".zmetadata"  # of a Zarr: its metadata and those of its arrays once more
LAYOUT_KEY = "jaxurban_layout"
LAYOUT = 1  # of maps in a folder; those without the entry have the first
# Files by which a Zarr is known, of version 3 the last.
OF_ZARR = (METADATA, ".zattrs", ".zgroup", "zarr.json")
OTHER_VERSION = (
    "comes from another version of jaxurban, or without its checksums.json: "
    "make the maps again in a new folder"
)
TIMES = {"units": "seconds since 1970-01-01", "calendar": "proleptic_gregorian", "dtype": "int64"}


def short_number(value: float) -> str:
    """Return a number as file names carry it: ``5``, ``2.5``."""
    return f"{value:g}"


def zarr_path(folder: Path, resolution_m: float) -> Path:
    """Return where the maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f"{short_number(resolution_m)}m"


NUMBER_M = r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)m"  # as `short_number` writes it


def stored_resolutions(folder: Path) -> dict[float, Path]:
    """Return where the maps under ``folder`` lie that the record of the folder names, by resolution in metres.

    Raises:
      InputError: the record cannot be read.
    """
    pattern = re.compile(rf"{ZARR_FOLDER}/{NUMBER_M}/{METADATA}")
    matches = filter(None, map(pattern.fullmatch, recorded(folder)))
    paths = {float(match[1]): (folder / match[0]).parent for match in matches}
    return {resolution_m: path for resolution_m, path in sorted(paths.items()) if path.is_dir()}


def check_version(folder: Path) -> None:
    """Raise InputError if a folder holds maps, or the record of a run, and its own record names none of these."""
    run = folder / RUN_FILE
    inside = folder.glob(f"{ZARR_FOLDER}/[0-9]*m/*")
    files = [file.parent for file in inside if file.name in OF_ZARR]
    if run.is_file() and b'"run_key"' in run.read_bytes():
        files.append(run)
    written = {Path(folder, *Path(name).parts[:2]) for name in recorded(folder)}
    if files and written.isdisjoint(files):
        raise InputError(f"{str(folder)!r} {OTHER_VERSION}")


def stored_key(folder: Path, resolution_m: float) -> str | None:
    """Return the run key of the maps that lie under ``folder``, None without any, or where they are damaged."""
    if resolution_m not in stored_resolutions(folder):
        return None
    with suppress(InputError):
        return open_zarr(folder, resolution_m).attrs.get("run_key")
    return None


def are_of_a_run(folder: Path) -> bool:
    """Return whether maps under ``folder`` are those of ``jaxurban maps``, which writes `RUN_FILE` too."""
    files = [path / METADATA for path in stored_resolutions(folder).values()]
    return any(b'"run_key"' in file.read_bytes() for file in files if file.is_file())


def settings_of(folder: Path) -> dict[str, Any]:
    """Return the settings that made the maps in ``folder``, empty where they were saved from Python.

    Raises:
      InputError: the record of the run that made them is damaged or missing, and with it their weights.
    """
    remedy = "run the same `jaxurban maps` command again, which writes it again"
    try:
        return read_json(folder / RUN_FILE)["settings"]
    except FileNotFoundError as error:
        if are_of_a_run(folder):
            raise InputError(
                f"{str(folder / RUN_FILE)!r}, with the settings of the maps, is missing: {remedy}"
            ) from error
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{str(folder / RUN_FILE)!r} cannot be read ({error}): {remedy}"
        ) from error


def work_path(folder: Path, resolution_m: float) -> Path:
    """Return where the unfinished maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f".{short_number(resolution_m)}m{SCRATCH_SUFFIX}"


def _is_map(array: xr.Variable) -> bool:
    return array.dims[-2:] == ("y", "x")


def _encoding(array: xr.Variable, tile: tuple[int, int]) -> dict[str, Any]:
    """Return how a variable is written: a map in tiles, one layer per chunk."""
    missing = NO_BYTE if array.dtype == np.uint8 else no_value(array.dtype)
    encoding: dict[str, Any] = {"compressors": (COMPRESSOR,), "_FillValue": missing}
    if _is_map(array):
        encoding["chunks"] = (1,) * (array.ndim - 2) + tile
    if array.dtype.kind == "M":
        encoding |= TIMES
    return encoding


def _to_zarr(
    ds: xr.Dataset, path: Path, mode: Literal["w", "a"], tile: tuple[int, int] = (1, 1)
) -> None:
    """Write a dataset without the values of its maps, and the metadata of all of the Zarr."""
    # Without the encoding of files that were opened before.
    ds = ds.drop_encoding().assign_attrs({LAYOUT_KEY: LAYOUT})
    for name, array in list(ds.variables.items()):
        if array.dtype.kind == "T" and name in ds.coords:
            texts = np.array(array.values.tolist(), str)
            ds = ds.assign_coords({name: (array.dims, texts, array.attrs)})
        elif _is_map(array):
            no_values = dask.array.zeros(array.shape, dtype=array.dtype, chunks=-1)
            ds[name] = (array.dims, no_values, array.attrs)
    if "y" in ds.coords:
        ds = ds.assign_coords(y=ds["y"][::-1])
    encoding = {str(name): _encoding(array, tile) for name, array in ds.variables.items()}
    ds.to_zarr(
        path,
        mode=mode,
        encoding=encoding,
        zarr_format=2,
        consolidated=False,
        write_empty_chunks=True,
        compute=False,
    )
    of_arrays = sorted((*path.glob("*/.zarray"), *path.glob("*/.zattrs")))
    files = [path / ".zattrs", path / ".zgroup", *of_arrays]
    parts = {file.relative_to(path).as_posix(): json.loads(file.read_bytes()) for file in files}
    (path / METADATA).write_bytes(_consolidated(parts))


def _consolidated(parts: Mapping[str, Any]) -> bytes:
    return json.dumps({"metadata": parts, "zarr_consolidated_format": 1}).encode()


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps under ``folder`` and return its place (``maps.zarr/5m``)."""
    path = zarr_path(folder, ds.attrs["resolution_m"])
    num_rows = ds.sizes["y"]
    num_cols = ds.sizes["x"]
    rows, cols = tile_shape((num_rows, num_cols))
    checksums = dict[str, str]()
    with scratch_for(path) as scratch:
        _to_zarr(ds, scratch, "w", (rows, cols))
        maps = {str(name): array for name, array in ds.variables.items() if _is_map(array)}
        for name, array in maps.items():
            for place in np.ndindex(array.shape[:-2]):
                values = array[place].values
                for stop in range(num_rows, 0, -rows):
                    part_rows = slice(max(0, stop - rows), stop)
                    for start in range(0, num_cols, cols):
                        part = part_rows, slice(start, min(start + cols, num_cols))
                        checksums |= write_layer(scratch, name, place, part, values[part])
        put_zarr(scratch, path, checksums)
    return path


def create_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int]) -> None:
    """Write the Zarr of a dataset: coordinates, attributes, and maps without values.

    Args:
      ds: the dataset; the values of its maps are not looked at.
      path: where to.
      tile: rows and columns of a chunk, what one `write_layer` fills.
    """
    with whole_file(path) as scratch:
        _to_zarr(ds, scratch, "w", tile)


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
      index: place along its axes before y and x.
      window: rows, from the south, and columns; they end where chunks do.
      values: ``[y, x]`` rows south to north; may stick out of the window in the south and in the east.

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
    chunk = np.full((num_rows, num_cols), array["fill_value"] or 0, array["dtype"])
    chunk[: len(values), : values.shape[1]] = values
    from_north = (array["shape"][-2] - rows.stop) // num_rows
    key = ".".join(map(str, (*index, from_north, cols.start // num_cols)))
    data = bytes(COMPRESSOR.encode(chunk))
    write_whole(path / name / key, data)
    return {f"{name}/{key}": checksum_of(data)}


def put_zarr(made: Path, path: Path, checksums: Mapping[str, str]) -> None:
    """Give a finished Zarr its name, its files recorded; of an older one only what is own goes.

    Args:
      made: the finished Zarr.
      path: its name to be.
      checksums: of its files that are known, by their names in it; the others are read.

    Raises:
      InputError: a file of others is in the way.
    """
    files = {file.relative_to(made).as_posix(): file for file in made.rglob("*") if file.is_file()}
    of_files = {name: checksums.get(name) or checksum_of(file) for name, file in files.items()}
    with Workspace.shared(path.parents[1], "maps") as workspace:
        # The metadata of all resolutions name the older maps too: they are written again, last.
        workspace.remove([f"{ZARR_FOLDER}/{METADATA}"])
        workspace.put_folder(made, path, of_files, METADATA)
        put_root(workspace.folder)


def root_files(folder: Path) -> list[Path]:
    """Return the files of the group above the resolutions, by which xarray and GDAL open all of them."""
    return [folder / ZARR_FOLDER / name for name in (".zgroup", METADATA)]


def put_root(folder: Path) -> None:
    """Write the group above the resolutions, with the metadata of all that are as they were written, if it is not so.

    Raises:
      InputError: a file of others is in the way.
    """
    written = recorded(folder)
    group = {"zarr_format": 2}
    parts: dict[str, Any] = {".zgroup": group}
    for path in stored_resolutions(folder).values():
        file = path / METADATA
        if is_as_written(file, written[file.relative_to(folder).as_posix()]):
            of_group = json.loads(file.read_bytes())["metadata"]
            parts |= {f"{path.name}/{name}": part for name, part in of_group.items()}
    contents = json.dumps(group).encode(), _consolidated(parts)
    for file, content in zip(root_files(folder), contents, strict=True):
        if not is_as_written(file, [checksum_of(content)]):
            write_whole(file, content)


def add_to_zarr(ds: xr.Dataset, path: Path) -> None:
    """Add variables that are not maps to a Zarr; InputError as of `open_whole` where its arrays are not ours."""
    for file in path.glob("*/.zarray"):
        _check_arrays(file, {file.name: json.loads(file.read_bytes())})
    _to_zarr(ds.drop_vars(list(ds.coords)), path, "a")


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps under ``folder``; values are read when they are looked at.

    Raises:
      InputError: no maps there, several resolutions and none chosen, or maps that are damaged (see `open_whole`).
    """
    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    paths = stored_resolutions(folder)
    listed = ", ".join(map(short_number, paths))
    check_version(folder)
    if not paths:
        raise InputError(
            f"{str(folder)!r} holds no metric maps: make them with `jaxurban maps SCENARIO -o {folder}`"
        )
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
    """A Zarr when it was opened: which file its metadata were, when written, and with which bytes."""

    path: Path
    place: tuple[int, int]
    metadata: bytes

    @classmethod
    def at(cls, path: Path) -> "_Opened":
        place = (path / METADATA).stat()
        return cls(path, (place.st_ino, place.st_mtime_ns), (path / METADATA).read_bytes())

    def check(self) -> None:
        """Raise RemadeError unless the Zarr is still the one that was opened, or was repaired by the same run."""
        with suppress(OSError):
            now = _Opened.at(self.path)
            # Maps that were saved from Python have no key of a run: the same metadata may go with other values.
            is_mended = b'"run_key"' in self.metadata and self.metadata == now.metadata
            if is_mended or self.place == now.place:
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
        self.array = array
        self.opened = opened
        self.name = name
        self.missing = missing
        self.shape = array.shape
        self.dtype = array.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._read
        )

    def _read(self, key: tuple) -> np.ndarray:
        """Return values of a chunk; InputError where files have changed since opening."""
        try:
            values = np.asarray(self.array[key].values, order="C")
            if values.dtype.kind == "u":  # of a chunk that went after opening
                values[values == self.missing] = self.name == "obstacle"
        except Exception as error:
            self.opened.check()
            raise _damage_in(self.opened.path, self.name) or error from error
        self.opened.check()  # after reading: metadata go first where maps are removed, and come last
        return values


class _Maps(BackendEntrypoint):
    """How xarray opens the Zarr: as it always does, with rows from the south and `_Map` around every map."""

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: Any = None) -> xr.Dataset:
        """Return the maps of a Zarr from south to north; values are read, and checked, when they are looked at."""
        # Of these maps, no array of others, and by the metadata that `open_whole` has looked at alone.
        options: dict[str, Any] = {"consolidated": True, "zarr_format": 2, "mask_and_scale": False}
        opened = _Opened.at(Path(filename_or_obj))
        ds = xr.open_dataset(filename_or_obj, engine="zarr", chunks=None, cache=False, **options)
        missing = {name: array.attrs.get("_FillValue") for name, array in ds.data_vars.items()}
        for variable in ds.variables.values():
            own = {key: value for key, value in variable.attrs.items() if key not in FOREIGN}
            variable.attrs = own
        ds = ds.isel({"y": slice(None, None, -1)}, missing_dims="ignore")
        maps = {}
        for name, array in ds.data_vars.items():
            values = _Map(array.variable, opened, str(name), missing[name])
            lazy = indexing.LazilyIndexedArray(values)
            maps[name] = xr.Variable(array.dims, lazy, array.attrs, array.encoding)
        coords = ds.coords.to_dataset().load()  # small, and damage shows at once
        opened.check()
        for name, coord in list(coords.variables.items()):
            if coord.dtype.kind == "U":
                coords[name] = coords[name].astype(np.dtypes.StringDType())
        ds = xr.Dataset(maps, coords.coords, ds.attrs)
        ds.encoding[OPENED] = opened
        return ds


def open_whole(path: Path) -> xr.Dataset:
    """Return the maps in a Zarr, every file of which is there; values are read, and decoded, when they are looked at.

    Raises:
      InputError: metadata are not as they were written, a chunk is missing or cut, an array is not coded as ours are,
        or a newer jaxurban wrote them in another layout; later, a chunk cannot be decoded.
    """
    try:
        for file, checksums in _recorded(path).items():
            if file.name.startswith(".z"):
                if not is_as_written(file, checksums):
                    what = "and the metadata of the arrays beside it are not as they were written"
                    raise _damaged(path / METADATA, what)
                continue
            sizes = {checksum.partition("-")[2] for checksum in checksums}
            if not file.is_file() or f"{file.stat().st_size}" not in sizes:  # it is not read
                raise _damaged(file, "is missing or cut")
        _check_arrays(path / METADATA, json.loads((path / METADATA).read_bytes())["metadata"])
        ds = xr.open_dataset(path, engine=_Maps)
        layout = ds.attrs.pop(LAYOUT_KEY, LAYOUT)
        if layout != LAYOUT:
            raise InputError(
                f"the maps in {str(path)!r} have layout {layout!r}, and this version of jaxurban reads {LAYOUT}: "
                "update jaxurban, or make the maps again in a new folder"
            )
        _check_facts(path, ds.attrs)
        return ds
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


def _check_facts(path: Path, attributes: Mapping[str, Any]) -> None:
    """Raise InputError unless the attributes of maps that others compute with are of their kinds."""
    guesses = json.loads(attributes.get("guesses", "{}"))
    if not isinstance(attributes["resolution_m"], numbers.Real) or not isinstance(guesses, dict):
        raise InputError(
            f"the attributes of {str(path)!r} are not those of maps: make the maps again in a new folder"
        )


def _is_ours(array: Mapping[str, Any]) -> bool:
    """Return whether an array of these metadata is coded as `_to_zarr` codes arrays."""
    dtype = array.get("dtype")
    filters = array.get("filters")
    compressor = array.get("compressor")
    if not isinstance(dtype, str) or not isinstance(compressor, dict):
        return False
    if compressor.get("id") != COMPRESSOR.codec_id:
        return False
    kind = np.dtype(dtype).kind
    return (kind in PLAIN_KINDS and not filters) or (kind in TEXT_KINDS and filters == TEXT_FILTERS)


def _recorded(path: Path) -> dict[Path, set[str]]:
    """Return the checksums that the files of a Zarr may have."""
    folder = path.parents[1]
    prefix = f"{ZARR_FOLDER}/{path.name}/"
    return {
        folder / name: checksums
        for name, checksums in recorded(folder).items()
        if name.startswith(prefix)
    }


def _damage_in(path: Path, name: str = "") -> InputError | None:
    """Return the error that names a damaged file of a Zarr, of one array or of all, if any is."""
    for file, checksums in _recorded(path).items():
        if (file.parent.name == name or not name) and not is_as_written(file, checksums):
            return _damaged(file, "is damaged or cannot be read")
    return None


def _damaged(file: Path, what: str) -> InputError:
    return InputError(
        f"{str(file)!r} {what}: run the same `jaxurban maps` command again, which repairs what is broken (maps that "
        "were saved from Python: save them again)"
    )
