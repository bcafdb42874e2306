"""The work of an unfinished run: arrays and finished marks on disk, each whole or not there at all."""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io import seal
from jaxurban.io.store import SCRATCH_SUFFIX, put_in_place, remove, whole_file

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
        with whole_file(self.path / KEY_FILE) as scratch:
            scratch.write_text(key, encoding="utf-8")
        return []

    def _remove_damaged(self) -> list[Path]:
        damaged = []
        for folder, read in ((ARRAY_FOLDER, seal.read_npz), (DONE_FOLDER, seal.read_json)):
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
        with whole_file(self._array_path(name)) as scratch:
            seal.write_npz(scratch, arrays)

    def load_arrays(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Return those of the ``wanted`` arrays that were kept under a name.

        Raises:
          InputError: they are missing or damaged.
        """
        path = self._array_path(name)
        try:
            kept = seal.read_npz(path)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{str(path)!r} is missing or damaged ({error}): run the same command again, which makes it anew"
            ) from error
        return {key: kept[key] for key in wanted if key in kept}

    def mark_done(self, name: str, facts: dict[str, Any]) -> None:
        """Say that a piece of work is finished and all of it written, with what it found."""
        with whole_file(self._mark(name)) as scratch:
            seal.write_json(scratch, facts)

    def _mark(self, name: str) -> Path:
        return self.path / DONE_FOLDER / f"{name}.json"

    def done(self, name: str) -> dict[str, Any] | None:
        """Return what a finished piece of work found, None if it is not finished, or its mark is damaged."""
        try:
            return seal.read_json(self._mark(name))
        except (OSError, ValueError):
            return None

    def unmark(self, names: Iterable[str]) -> None:
        """Say that pieces of work are not finished."""
        for name in names:
            self._mark(name).unlink(missing_ok=True)

    def remove_maps(self, names: Iterable[str]) -> None:
        """Remove the maps, and the marks of the pieces that they were made of."""
        self.unmark(names)
        shutil.rmtree(self.zarr)

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name and remove the rest."""
        self._sweep()
        target.parent.mkdir(parents=True, exist_ok=True)
        put_in_place(self.zarr, target)
        shutil.rmtree(self.path)
