"""The folder of unfinished maps, with which the same job goes on after a kill."""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.files import (
    ELSEWHERE,
    SCRATCH_SUFFIX,
    checksum_of,
    is_as_written,
    read_json,
    remove,
    whole_file,
    write_json,
    write_whole,
)
from jaxurban.io.workspace import Each, Workspace, is_inside

KEY_FILE = "key.txt"
ZARR = "zarr"
ARRAY_FOLDER = "arrays"
DONE_FOLDER = "done"
STEP = rf"({ZARR}|[a-z]+_\d+_\d+\w*)"
OF_STEPS = re.compile(  # what steps write, before they leave their mark too
    rf"{KEY_FILE}|{ZARR}/([^/]+/)?(\.z\w+|\d+(\.\d+)*)|{ARRAY_FOLDER}/{STEP}\.npz|{DONE_FOLDER}/{STEP}\.json"
)
# Our own, and the Zarr library's.
SCRAP = re.compile(rf"\..*{re.escape(SCRATCH_SUFFIX)}|.*\.[0-9a-f]{{32}}\.partial")
_PARSING = Lock()  # headers of arrays are Python text, and 3.11 fails now and then where threads parse (CPython 106905)


def _is_of_steps(name: str) -> bool:
    return OF_STEPS.fullmatch(name) is not None and is_inside(name)


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

        Raises:
          InputError: a link is in its place, or a file of the user's cannot be moved out of it.
        """
        self._check_is_folder()
        if is_as_written(self.path / KEY_FILE, [checksum_of(key.encode())]):
            self._sweep()
        else:
            self.discard()
            write_whole(self.path / KEY_FILE, key)
        marks = self._marks("*")
        damaged: list[Path] = []
        for mark, files in zip(marks, list(each(self._damaged, marks)), strict=True):
            damaged += files
            for path in (mark, *files) if files else ():
                remove(path)
        if self.done(ZARR) is None:  # tiles are written into it
            for path in (self.zarr, *self._marks("tile_*")):
                remove(path)
        return damaged

    def _check_is_folder(self) -> None:
        if self.path.is_symlink():
            raise InputError(
                f"{str(self.path)!r} is a link in the place of unfinished maps: move it, or {ELSEWHERE}"
            )

    def _sweep(self) -> None:
        """Remove what killed processes left half-written, and move what no step writes, a user's, to `KEPT_FOLDER`."""
        for scrap in [path for path in self.path.rglob("*") if SCRAP.fullmatch(path.name)]:
            remove(scrap)
        for path in [
            path for path in self.path.rglob("*") if path.is_symlink() or not path.is_dir()
        ]:
            name = path.relative_to(self.path).as_posix()
            if path.is_symlink() or not _is_of_steps(name):
                with Workspace.shared(self.path.parents[1], "maps") as workspace:
                    workspace.set_aside(path, name)

    def discard(self) -> None:
        """Remove the folder, but for what no step writes (`_sweep`).

        Raises:
          InputError: as of `begin`.
        """
        self._check_is_folder()
        self._sweep()
        remove(self.path)

    def _marks(self, pattern: str) -> list[Path]:
        return sorted((self.path / DONE_FOLDER).glob(pattern))

    def _damaged(self, mark: Path) -> list[Path]:
        """Return the files of a finished step that are not as its mark says; the mark itself where it is not ours."""
        try:
            checksums = dict(read_json(mark)["checksums"])
        except (OSError, ValueError, LookupError, TypeError):
            return [mark]
        if not all(map(_is_of_steps, checksums)):  # no mark of ours: what it names is not looked at
            return [mark]
        return [
            self.path / name
            for name, of in checksums.items()
            if not is_as_written(self.path / name, [of])
        ]

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
            raise InputError(
                f"{str(path)!r} is missing or damaged: run the same command again, which makes it again"
            )
        with _PARSING, np.load(path, allow_pickle=False) as kept:
            return {each: kept[each] for each in kept.files if each in wanted}

    def _mark(self, name: str) -> Path:
        return self.path / DONE_FOLDER / f"{name}.json"

    def mark_done(
        self, name: str, checksums: dict[str, str], facts: dict[str, Any] | None = None
    ) -> None:
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
        files = (
            file.relative_to(self.path).as_posix()
            for file in self.zarr.rglob("*")
            if file.is_file()
        )
        names = sorted(set(filter(_is_of_steps, files)) - of_tiles)
        self.mark_done(ZARR, {name: checksum_of(self.path / name) for name in names})

    def done(self, name: str) -> dict[str, Any] | None:
        """Return what a finished step found, None if it is not finished, or its mark is damaged."""
        with suppress(OSError, ValueError):
            return read_json(self._mark(name))["facts"]
        return None

    def finish(self, target: Path) -> None:
        """Give the assembled maps their name ``target`` and remove the rest as `discard` does."""
        self._sweep()
        checksums: dict[str, str] = {}
        for mark in self._marks("*"):
            checksums |= read_json(mark)["checksums"]
        store.put_zarr(
            self.zarr, target, {name.removeprefix(f"{ZARR}/"): of for name, of in checksums.items()}
        )
        remove(self.path)
