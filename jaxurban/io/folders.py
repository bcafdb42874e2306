"""Folders that a run writes: its own, its unfinished work, and the maps that are there already."""

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.chunks import Each, broken_chunks, has_whole_metadata, metadata_file
from jaxurban.io.files import (
    LOCK_FILE,
    SCRATCH_SUFFIX,
    check_writable,
    digest_of,
    only_writer,
    put_in_place,
    read_json,
    read_npz,
    remove,
    sweep_scraps,
    write_json,
    write_npz,
    write_whole,
)

KEY_FILE, ZARR_NAME, ARRAY_FOLDER, DONE_FOLDER = "key.txt", "zarr", "arrays", "done"


@dataclass(frozen=True)
class WorkFolder:
    """A folder that a killed run leaves behind and the same job goes on with. Processes may share it.

    Attributes:
      path: the folder.
    """

    path: Path

    def begin(self, key: str) -> list[Path]:
        """Make the folder ready for the job of ``key``: keep that job's work, remove any other's.

        Returns:
          Damaged files of that job's work, which are removed, so that they are made again.
        """
        if (self.path / KEY_FILE).is_file() and (self.path / KEY_FILE).read_bytes() == key.encode():
            self._sweep()
            return self._remove_damaged()
        shutil.rmtree(self.path, ignore_errors=True)
        for name in (ARRAY_FOLDER, DONE_FOLDER):
            (self.path / name).mkdir(parents=True)
        write_whole(self.path / KEY_FILE, key)
        return []

    def _remove_damaged(self) -> list[Path]:
        damaged = []
        for folder, read in ((ARRAY_FOLDER, read_npz), (DONE_FOLDER, read_json)):
            (self.path / folder).mkdir(exist_ok=True)
            for path in sorted((self.path / folder).iterdir()):
                try:
                    read(path)
                except (OSError, ValueError):
                    damaged.append(path)
                    remove(path)
        return damaged

    def _sweep(self) -> None:
        """Remove what killed processes left half-written: our own scraps and those of the Zarr library."""
        for pattern in (f".*{SCRATCH_SUFFIX}", "*.partial"):
            for scrap in list(self.path.rglob(pattern)):
                remove(scrap)

    @property
    def zarr(self) -> Path:
        """Where the maps are assembled."""
        return self.path / ZARR_NAME

    def _array_path(self, name: str) -> Path:
        return self.path / ARRAY_FOLDER / f"{name}.npz"

    def has_arrays(self, name: str) -> bool:
        """Return whether `save_arrays` has finished under this name."""
        return self._array_path(name).is_file()

    def save_arrays(self, name: str, **arrays: np.ndarray) -> None:
        """Keep arrays under a name."""
        write_npz(self._array_path(name), arrays)

    def load_arrays(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Return those of the ``wanted`` arrays that were kept under a name.

        Raises:
          InputError: they are missing or damaged.
        """
        path = self._array_path(name)
        try:
            return read_npz(path, wanted)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{str(path)!r} is missing or damaged ({error}): run the same command again, which makes it anew"
            ) from error

    def mark_done(self, name: str, facts: dict[str, Any]) -> None:
        """Note that a task is finished and all of it written, with what it found."""
        write_json(self._mark(name), facts)

    def _mark(self, name: str) -> Path:
        return self.path / DONE_FOLDER / f"{name}.json"

    def done(self, name: str) -> dict[str, Any] | None:
        """Return what a finished task found, None if it is not finished, or its mark is damaged."""
        with suppress(OSError, ValueError):
            return read_json(self._mark(name))
        return None

    def unmark(self, names: Iterable[str]) -> None:
        """Forget that tasks are finished."""
        for name in names:
            self._mark(name).unlink(missing_ok=True)

    def remove_maps(self, names: Iterable[str]) -> None:
        """Remove the maps, and the marks of the tasks that they were made of."""
        self.unmark(names)
        shutil.rmtree(self.zarr)

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name and remove the rest."""
        self._sweep()
        target.parent.mkdir(parents=True, exist_ok=True)
        put_in_place(self.zarr, target)
        shutil.rmtree(self.path)


RECORD_FILE = "made.json"  # whose folder it is, under which settings, and what was written
ELSEWHERE = "choose another folder with -o"


@contextmanager
def own_folder(folder: Path, command: str, settings: Mapping[str, Any], *, overwrite: bool = False) -> Iterator[None]:
    """Hold a folder, made if it is not there, for one run that writes all its files under it.

    Args:
      folder: where the run writes.
      command: that runs.
      settings: what decides its result, as JSON holds it; the same again goes on, or writes the same again.
      overwrite: remove what this command wrote there under other settings.

    Raises:
      InputError: the folder cannot be written to, another run holds it, it is another command's or of other
        settings, or it holds files that this command did not write, or that were changed since.
    """
    record = json.loads(json.dumps({"command": command, "asked": settings}))
    check_writable(folder)
    with only_writer(folder, ELSEWHERE):
        _claim(folder, record, overwrite)
        write_json(folder / RECORD_FILE, {**record, "written": None}, indent=2)
        try:
            yield
        finally:
            written = {name: digest_of(folder / name) for name in _names(folder)}
            write_json(folder / RECORD_FILE, {**record, "written": written}, indent=2)


def _names(folder: Path) -> list[str]:
    files = sorted(path for path in folder.rglob("*") if not path.is_dir())
    return [
        path.relative_to(folder).as_posix()
        for path in files
        if path.name not in (RECORD_FILE, LOCK_FILE) and not path.name.endswith(SCRATCH_SUFFIX)
    ]


def _claim(folder: Path, record: Mapping[str, Any], overwrite: bool) -> None:
    """Raise InputError unless the folder is empty or this run's; with ``overwrite``, empty one of other settings."""
    names, command = _names(folder), record["command"]
    try:
        held = read_json(folder / RECORD_FILE)
        before, written = held["asked"], held["written"]
    except FileNotFoundError:
        if names:
            raise InputError(
                f"{str(folder / names[0])!r} is there already, and not from `jaxurban {command}`: {ELSEWHERE}"
            ) from None
        return
    except (OSError, ValueError, LookupError) as error:
        raise InputError(
            f"{str(folder / RECORD_FILE)!r}, which tells whose folder it is, cannot be read ({error}): {ELSEWHERE}, or "
            "remove this one"
        ) from error
    if held["command"] != command:
        raise InputError(f"{str(folder)!r} holds what `jaxurban {held['command']}` wrote: {ELSEWHERE}")
    # Where a run was killed nobody wrote down what it made; it began in a folder without others' files.
    foreign = [name for name in names if written is not None and written.get(name) != digest_of(folder / name)]
    if foreign:
        raise InputError(
            f"{str(folder / foreign[0])!r} is not as `jaxurban {command}` wrote it: move it, or {ELSEWHERE}"
        )
    differing = [name for name in record["asked"] if record["asked"][name] != before.get(name)]
    if differing and not overwrite:
        name = differing[0]
        was, now = str(before.get(name)), str(record["asked"][name])
        said = f"its {name} is {was}, now {now}" if len(was + now) <= LONGEST_SAID else f"other {name}"
        raise InputError(
            f"{str(folder)!r} holds another run of `jaxurban {command}` ({said}): {ELSEWHERE}, or pass --overwrite to "
            "replace it"
        )
    if overwrite:
        for name in names:
            (folder / name).unlink()


LONGEST_SAID = 200  # characters of two settings that differ, in an error
HEAD_BYTES = 1 << 16  # of a GeoTIFF: its tags


def stored_key(folder: Path, resolution_m: float) -> str | None:
    """Return the run key of the maps that lie under ``folder``, None without any, or where they are damaged."""
    if resolution_m not in store.stored_resolutions(folder):
        return None
    with suppress(InputError):
        return store.open_zarr(folder, resolution_m).attrs.get("run_key")
    return None


def _witnesses(folder: Path, resolution_m: float) -> Iterator[Path]:
    """Yield files that name the run which made the maps of a resolution."""
    yield store.zarr_path(folder, resolution_m) / ".zattrs"
    yield metadata_file(store.zarr_path(folder, resolution_m))
    yield folder / store.RUN_FILE
    yield from (folder / store.GEOTIFF_FOLDER).glob(f"*_{store.short_number(resolution_m)}m.tif")


def _is_of(folder: Path, resolution_m: float, key: str) -> bool:
    """Return whether the maps of a resolution are a job's; damaged ones are, where a file still names it."""
    found = stored_key(folder, resolution_m)
    if found is not None:
        return found == key
    for file in _witnesses(folder, resolution_m):
        with suppress(OSError), file.open("rb") as stream:
            if key.encode() in stream.read(HEAD_BYTES):
                return True
    return False


def has_other_maps(folder: Path, key: str) -> bool:
    """Return whether a folder holds maps of other settings or inputs than those of the run of a key."""
    return not all(_is_of(folder, resolution_m, key) for resolution_m in store.stored_resolutions(folder))


def prepare_folder(folder: Path, key: str, resolutions_m: Iterable[float]) -> None:
    """Make the output folder ready: remove another job's maps, sweep what a killed run left but for its tiles.

    Args:
      folder: of the maps.
      key: of the job.
      resolutions_m: of its maps.

    Raises:
      InputError: a file is where a folder of maps belongs.
    """
    for path in (folder / store.ZARR_FOLDER, folder / store.GEOTIFF_FOLDER):
        if path.exists() and not path.is_dir():
            raise InputError(f"{str(path)!r} is a file where the maps' folder belongs: move it")
    unfinished = [resolution_m for resolution_m in resolutions_m if stored_key(folder, resolution_m) != key]
    kept = [store.work_path(folder, resolution_m) for resolution_m in unfinished]
    sweep_scraps(folder, folder / store.ZARR_FOLDER, folder / store.GEOTIFF_FOLDER, keep=kept)
    if has_other_maps(folder, key):
        store.remove_maps(folder)


def broken_files(folder: Path, resolution_m: float, each: Each = map) -> list[Path]:
    """Return the files of the maps of a resolution that are missing or not as they were written; all are read.

    ``each`` calls a function with each of many pieces of that.
    """
    path = store.zarr_path(folder.resolve(), resolution_m)  # others may work in another folder
    if not path.exists():
        return []
    if not has_whole_metadata(path):
        return [metadata_file(path)]
    return [chunk.file for chunk in broken_chunks(path, each)]
