"""The folder of unfinished maps, with which the same job goes on after a kill."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.files import (
    SCRATCH_SUFFIX,
    checksum_of,
    is_as_written,
    read_json,
    remove,
    whole_file,
    write_json,
    write_whole,
)
from jaxurban.io.workspace import Each

KEY_FILE, ZARR, ARRAY_FOLDER, DONE_FOLDER = "key.txt", "zarr", "arrays", "done"
_PARSING = Lock()  # headers of arrays are Python text, and 3.11 fails now and then where threads parse (CPython 106905)


@dataclass(frozen=True)
class WorkFolder:
    """Unfinished maps. Each step leaves a mark with the checksums of what it wrote. Processes may share the folder.

    Attributes:
      path: the folder.
    """

    path: Path

    def begin(self, key: str, each: Each = map) -> list[Path]:
        """Make the folder ready for the job of ``key``: keep that job's work, remove any other's.

        Returns:
          Damaged files of that job's work, which are removed, and the steps that wrote them are to be done again.
        """
        if not is_as_written(self.path / KEY_FILE, [checksum_of(key.encode())]):
            remove(self.path)
            write_whole(self.path / KEY_FILE, key)
        for pattern in (f".*{SCRATCH_SUFFIX}", "*.partial"):  # half-written: our own, and those of the Zarr library
            for scrap in list(self.path.rglob(pattern)):
                remove(scrap)
        marks = self._marks("*")
        found = {mark: files for mark, files in zip(marks, each(self._damaged, marks), strict=True) if files}
        for mark, files in found.items():
            for path in (mark, *files):
                remove(path)
        if self.done(ZARR) is None:  # tiles are written into it
            for path in (self.zarr, *self._marks("tile_*")):
                remove(path)
        return [file for files in found.values() for file in files]

    def _marks(self, pattern: str) -> list[Path]:
        return sorted((self.path / DONE_FOLDER).glob(pattern))

    def _damaged(self, mark: Path) -> list[Path]:
        try:
            checksums = read_json(mark)["checksums"]
        except (OSError, ValueError):
            return [mark]
        return [self.path / name for name, of in checksums.items() if not is_as_written(self.path / name, [of])]

    @property
    def zarr(self) -> Path:
        """Where the maps are assembled."""
        return self.path / ZARR

    def save_arrays(self, name: str, **arrays: np.ndarray) -> None:
        """Keep arrays under the name of the step that made them, and mark it done."""
        path = self.path / ARRAY_FOLDER / f"{name}.npz"
        with whole_file(path) as scratch, scratch.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        self.mark_done(name, {f"{ARRAY_FOLDER}/{path.name}": checksum_of(path)})

    def load_arrays(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Return those of the ``wanted`` arrays that were kept under a name.

        Raises:
          InputError: they are missing or damaged.
        """
        path = self.path / ARRAY_FOLDER / f"{name}.npz"
        if self._damaged(self._mark(name)):
            raise InputError(f"{str(path)!r} is missing or damaged: run the same command again, which makes it anew")
        with _PARSING, np.load(path, allow_pickle=False) as kept:
            return {each: kept[each] for each in kept.files if each in wanted}

    def _mark(self, name: str) -> Path:
        return self.path / DONE_FOLDER / f"{name}.json"

    def mark_done(self, name: str, checksums: dict[str, str], facts: dict[str, Any] | None = None) -> None:
        """Note that a step is finished and all of it written.

        Args:
          name: of the step.
          checksums: of the files that it wrote, by their names in the folder.
          facts: what it found.
        """
        write_json(self._mark(name), {"checksums": checksums, "facts": facts or {}})

    def mark_zarr(self) -> None:
        """Note that the Zarr is there, without the values of its maps."""
        of_tiles = {name for mark in self._marks("tile_*") for name in read_json(mark)["checksums"]}
        names = {file.relative_to(self.path).as_posix() for file in self.zarr.rglob("*") if file.is_file()} - of_tiles
        self.mark_done(ZARR, {name: checksum_of(self.path / name) for name in sorted(names)})

    def done(self, name: str) -> dict[str, Any] | None:
        """Return what a finished step found, None if it is not finished, or its mark is damaged."""
        with suppress(OSError, ValueError):
            return read_json(self._mark(name))["facts"]
        return None

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name ``target`` and remove the rest."""
        checksums: dict[str, str] = {}
        for mark in self._marks("*"):
            checksums |= read_json(mark)["checksums"]
        store.put_zarr(self.zarr, target, {name.removeprefix(f"{ZARR}/"): of for name, of in checksums.items()})
        remove(self.path)
