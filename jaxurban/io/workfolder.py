"""The work of an unfinished run: arrays and finished marks on disk, each whole or not there at all."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.io.store import SCRATCH_SUFFIX, whole_file

KEY_FILE, ZARR_NAME, ARRAY_FOLDER, DONE_FOLDER = "key.txt", "zarr", "arrays", "done"


@dataclass(frozen=True)
class WorkFolder:
    """A folder that a killed run leaves behind and the same job goes on with. Processes may share it.

    Attributes:
      path: the folder.
    """

    path: Path

    def begin(self, key: str) -> None:
        """Make the folder ready for the job of ``key``: keep that job's work, remove any other's."""
        if (self.path / KEY_FILE).is_file() and (self.path / KEY_FILE).read_text(encoding="utf-8") == key:
            self._sweep()
            return
        shutil.rmtree(self.path, ignore_errors=True)
        for name in (ARRAY_FOLDER, DONE_FOLDER):
            (self.path / name).mkdir(parents=True)
        with whole_file(self.path / KEY_FILE) as scratch:
            scratch.write_text(key, encoding="utf-8")

    def _sweep(self) -> None:
        """Remove what killed processes left half-written: our own scraps and those of the Zarr library."""
        for pattern in (f".*{SCRATCH_SUFFIX}", "*.partial"):
            for scrap in list(self.path.rglob(pattern)):
                if scrap.is_dir():
                    shutil.rmtree(scrap)
                else:
                    scrap.unlink()

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
        with whole_file(self._array_path(name)) as scratch, scratch.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    def load_arrays(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Return those of the ``wanted`` arrays that were kept under a name."""
        with np.load(self._array_path(name), allow_pickle=False) as kept:
            return {key: kept[key] for key in wanted if key in kept.files}

    def mark_done(self, name: str, facts: dict[str, Any]) -> None:
        """Say that a piece of work is finished and all of it written, with what it found."""
        with whole_file(self.path / DONE_FOLDER / f"{name}.json") as scratch:
            scratch.write_text(json.dumps(facts), encoding="utf-8")

    def done(self, name: str) -> dict[str, Any] | None:
        """Return what a finished piece of work found, None if it is not finished."""
        path = self.path / DONE_FOLDER / f"{name}.json"
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name and remove the rest."""
        self._sweep()
        target.parent.mkdir(parents=True, exist_ok=True)
        self.zarr.rename(target)
        shutil.rmtree(self.path)
