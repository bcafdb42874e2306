"""Folders that a run writes: its own, its unfinished work, and the maps that are there already."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.chunks import Each, broken_chunks, has_whole_metadata, metadata_file
from jaxurban.io.files import (
    SCRATCH_SUFFIX,
    is_whole,
    read_json,
    read_npz,
    remove,
    sweep_scraps,
    write_json,
    write_npz,
    write_whole,
)
from jaxurban.io.geotiff import is_of_run
from jaxurban.io.workspace import Workspace
from jaxurban.progress import LOG

KEY_FILE, ZARR_NAME, ARRAY_FOLDER, DONE_FOLDER = "key.txt", "zarr", "arrays", "done"
OF_JOBS = re.compile(
    rf"{KEY_FILE}|{ZARR_NAME}/([^/]+/)?(\.z\w+|\d+(\.\d+)*)|{ARRAY_FOLDER}/\w+\.npz|{DONE_FOLDER}/\w+\.json"
    rf"|(.*/)?(\.[^/]*{re.escape(SCRATCH_SUFFIX)}|[^/]*\.partial)"
)


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
        self.discard()
        for name in (ARRAY_FOLDER, DONE_FOLDER):
            (self.path / name).mkdir(parents=True, exist_ok=True)
        write_whole(self.path / KEY_FILE, key)
        return []

    def _remove_damaged(self) -> list[Path]:
        damaged: list[Path] = []
        for folder in (self.path / ARRAY_FOLDER, self.path / DONE_FOLDER):
            folder.mkdir(exist_ok=True)
            damaged += [path for path in sorted(folder.iterdir()) if not is_whole(path)]
        for path in damaged:
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
        self._remove(self.zarr)

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name ``target`` and remove the rest."""
        self._sweep()
        store.put_zarr(self.zarr, target)
        self.discard()

    def discard(self) -> None:
        """Remove the folder, but for files that no job writes there: those stay, and are reported."""
        self._remove(self.path)
        if self.path.exists():
            LOG.warning(f"{str(self.path)!r} stays: it holds files that `jaxurban maps` did not write")

    def _remove(self, folder: Path) -> None:
        for path in [*sorted(folder.rglob("*"), reverse=True), folder]:
            is_folder = path.is_dir() and not path.is_symlink()
            if is_folder or OF_JOBS.fullmatch(path.relative_to(self.path).as_posix()):
                with suppress(OSError):  # a folder in which others have files
                    path.rmdir() if is_folder else path.unlink()


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
    return any(is_of_run(file, key) for file in _witnesses(folder, resolution_m))


def has_other_maps(folder: Path, key: str) -> bool:
    """Return whether a folder holds maps of other settings or inputs than those of the run of a key."""
    return not all(_is_of(folder, resolution_m, key) for resolution_m in store.stored_resolutions(folder))


def prepare_folder(workspace: Workspace, key: str, resolutions_m: Sequence[float]) -> None:
    """Make the output folder ready: remove another job's maps, sweep what a killed run left but for its tiles.

    Args:
      workspace: in the folder of the maps.
      key: of the job.
      resolutions_m: of its maps.

    Raises:
      InputError: a file of others is where the maps belong.
    """
    folder = workspace.folder
    for path in (folder / store.ZARR_FOLDER, folder / store.GEOTIFF_FOLDER):
        if path.exists() and not path.is_dir():
            raise InputError(f"{str(path)!r} is a file where the maps' folder belongs: move it")
    unfinished = [resolution_m for resolution_m in resolutions_m if stored_key(folder, resolution_m) != key]
    for resolution_m in unfinished:
        path = store.zarr_path(folder, resolution_m)
        workspace.check_way((path / name for name in store.OF_ZARR), is_mended=True)
    kept = [store.work_path(folder, resolution_m) for resolution_m in unfinished]
    for path in (folder / store.ZARR_FOLDER).glob(f".*m{SCRATCH_SUFFIX}"):
        if path not in kept:
            WorkFolder(path).discard()
    sweep_scraps(folder, folder / store.ZARR_FOLDER, folder / store.GEOTIFF_FOLDER)
    if has_other_maps(folder, key):
        # The Zarr goes last: while it stands the folder is known to hold that job's maps.
        workspace.remove(name for name in workspace.written if not name.startswith(f"{store.ZARR_FOLDER}/"))
        workspace.remove_all()


def broken_files(folder: Path, resolution_m: float, each: Each = map) -> list[Path]:
    """Return the files of the maps of a resolution that are missing or not as they were written; all are read.

    ``each`` calls a function with each of many pieces of that.
    """
    path = store.zarr_path(folder.resolve(), resolution_m)  # others may work in another folder
    if path not in store.stored_resolutions(folder.resolve()).values():
        return []
    if not has_whole_metadata(path):
        return [metadata_file(path)]
    return [chunk.file for chunk in broken_chunks(path, each)]
