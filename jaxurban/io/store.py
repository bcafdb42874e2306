"""Metric maps on disk as Zarr, each file whole or not there at all."""

import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import xarray as xr
import zarr

from jaxurban.errors import InputError
from jaxurban.io.damage import encoding_of, open_whole, seal_metadata
from jaxurban.tiles import tile_shape

RUN_FILE = "run.json"
LOCK_FILE = ".jaxurban.lock"
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
SCRATCH_SUFFIX = ".jaxurban-part"  # of what is being written: ours to sweep, and nobody else's
NEEDED = ("obstacle", "has_data")  # without these it is no folder of maps


def short_number(value: float) -> str:
    """Return a number as file names carry it: ``5``, ``2.5``."""
    return f"{value:g}"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a scratch path beside ``path`` that takes its name only if the block succeeds.

    Works for a file and for a folder (an old folder of that name is replaced).

    Raises:
      InputError: the folder cannot be written to.
    """
    scratch = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{SCRATCH_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield scratch
        if path.is_dir() and not scratch.is_dir():
            raise InputError(f"cannot write {str(path)!r}: a folder of that name is in the way; move it")
        put_in_place(scratch, path)
    except OSError as error:
        raise InputError(
            f"cannot write {str(path)!r}: {error.strerror or error}; free space there, or choose another folder"
        ) from error
    finally:
        remove(scratch)


def put_in_place(made: Path, path: Path) -> None:
    """Give what was made its name, in place of an older file or folder."""
    if not path.is_dir():
        os.replace(made, path)
        return
    old = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.old{SCRATCH_SUFFIX}")
    path.rename(old)
    made.rename(path)
    shutil.rmtree(old)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there and can be."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


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


def check_writable(folder: Path) -> None:
    """Make ``folder`` and raise InputError if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"cannot write to the output folder {str(folder)!r}: {error.strerror or error}; choose another with -o"
        ) from error


def work_path(folder: Path, resolution_m: float) -> Path:
    """Return where the unfinished maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f".{short_number(resolution_m)}m{SCRATCH_SUFFIX}"


@contextmanager
def only_writer(folder: Path, remedy: str = "choose another folder") -> Iterator[None]:
    """Hold a folder for one run; the hold goes with the process, however it ends.

    Raises:
      InputError: another run holds it, or it cannot be written to; ``remedy`` ends the sentence.
    """
    try:
        import fcntl
    except ImportError:  # not a Unix: two runs in one folder are the user's to avoid
        yield
        return
    file = _locked(folder, remedy, fcntl)
    with file:
        try:
            yield
        finally:
            (folder / LOCK_FILE).unlink(missing_ok=True)


def _locked(folder: Path, remedy: str, fcntl: Any) -> IO[str]:
    """Return the folder's lock file, open and locked."""
    while True:
        try:
            file = (folder / LOCK_FILE).open("a")
        except OSError as error:
            raise InputError(f"cannot write to {str(folder)!r} ({error.strerror or error}): {remedy}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # An earlier holder may have removed the file between our opening and locking it: the lock on a file
            # without a name holds nothing.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), (folder / LOCK_FILE).stat()):
                    return file
            file.close()
        except BlockingIOError as error:
            file.close()
            raise InputError(f"another run is writing to {str(folder)!r}: wait for it, or {remedy}") from error


def sweep_scraps(folder: Path, keep: Iterable[Path] = ()) -> None:
    """Remove what a killed run left half-written under ``folder``, but for the work in ``keep``."""
    kept = set(keep)
    for part in (folder, folder / ZARR_FOLDER, folder / GEOTIFF_FOLDER):
        for scrap in part.glob(f".*{SCRATCH_SUFFIX}"):
            if scrap not in kept:
                remove(scrap)


def remove_maps(folder: Path) -> None:
    """Remove the maps that a job wrote under ``folder`` and its record, and nothing else.

    The Zarr goes last: while it stands the folder is known to hold that job's maps.
    """
    for part in (RUN_FILE, GEOTIFF_FOLDER, ZARR_FOLDER):
        remove(folder / part)


def _encoding(ds: xr.Dataset, tile: tuple[int, int] | None = None) -> dict[str, dict[str, Any]]:
    """Return how every variable is written: maps in the tiles of their region, one layer a chunk."""
    tile = tile or tile_shape((ds.sizes["y"], ds.sizes["x"]))
    encoding = {str(name): encoding_of(str(name), array.dtype) for name, array in ds.variables.items()}
    for name, array in ds.data_vars.items():
        if array.dims[-2:] == ("y", "x"):
            encoding[str(name)]["chunks"] = (*(1 for _ in array.dims[:-2]), *tile)
    return encoding


def _to_zarr(ds: xr.Dataset, path: Path, mode: Literal["w", "a"], **options: Any) -> None:
    ds.to_zarr(path, mode=mode, zarr_format=3, consolidated=False, write_empty_chunks=True, **options)
    seal_metadata(path)


def write_zarr(ds: xr.Dataset, folder: Path) -> Path:
    """Write a dataset of maps under ``folder`` and return its place (``maps.zarr/5m``)."""
    path = zarr_path(folder, ds.attrs["resolution_m"])
    plain = ds.drop_encoding()  # of the files that maps were opened from
    with whole_file(path) as scratch:
        _to_zarr(plain, scratch, "w", encoding=_encoding(plain))
    return path


def create_zarr(ds: xr.Dataset, path: Path, tile: tuple[int, int]) -> None:
    """Write the Zarr of a dataset of dask arrays: coordinates, attributes, and maps without values.

    Args:
      ds: the dataset.
      path: where to.
      tile: rows and columns of a chunk, what one `write_layer` fills.
    """
    with whole_file(path) as scratch:
        _to_zarr(ds, scratch, "w", encoding=_encoding(ds, tile), compute=False)


def write_layer(path: Path, name: str, index: tuple[int, ...], window: tuple[slice, slice], values: np.ndarray) -> None:
    """Write a tile of one map into a Zarr: its values, as far as the window reaches."""
    rows, cols = window
    array = zarr.open_array(path / name, mode="r+", config={"write_empty_chunks": True})
    place: Any = (*index, rows, cols)
    array[place] = values[: rows.stop - rows.start, : cols.stop - cols.start]


def add_to_zarr(ds: xr.Dataset, path: Path) -> None:
    """Add the variables of a dataset to a Zarr."""
    encoding = {str(name): encoding_of(str(name), array.dtype) for name, array in ds.data_vars.items()}
    _to_zarr(ds.drop_vars(list(ds.coords)), path, "a", encoding=encoding)


def open_zarr(folder: Path, resolution_m: float | None) -> xr.Dataset:
    """Return the maps under ``folder``; values are read when they are looked at.

    Raises:
      InputError: no maps there, several resolutions and none chosen, or maps that are damaged (see `open_whole`).
    """
    found = stored_resolutions(folder)
    listed = ", ".join(short_number(value) for value in sorted(found)) or "none"
    if not found:
        raise InputError(f"{str(folder)!r} holds no metric maps: make them with `jaxurban maps SCENARIO -o {folder}`")
    if resolution_m is None and len(found) > 1:
        raise InputError(f"{str(folder)!r} holds maps at {listed} m: choose one with resolution_m (--resolution)")
    if resolution_m is not None and resolution_m not in found:
        raise InputError(f"{str(folder)!r} holds no maps at {short_number(resolution_m)} m, only at {listed} m")
    path = found[resolution_m] if resolution_m is not None else next(iter(found.values()))
    ds = open_whole(path)
    if lost := [name for name in NEEDED if name not in ds]:
        raise InputError(f"the maps in {str(path)!r} hold no {', no '.join(lost)}: remove them and make them again")
    return ds
