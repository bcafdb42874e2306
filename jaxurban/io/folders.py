"""The folder of unfinished maps, with which the same job goes on after a kill."""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

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
from jaxurban.io.stored import DONE_FOLDER, ZARR
from jaxurban.io.workspace import Each, Workspace, is_inside

KEY_FILE = "key.txt"
ARRAY_FOLDER = "arrays"
STEP = rf"({ZARR}|[a-z]+_\d+_\d+\w*)"
OF_STEPS = re.compile(  # what steps write, before they leave their mark too
    rf"{KEY_FILE}|{ZARR}/([^/]+/)?(\.z\w+|\d+(\.\d+)*)|{ARRAY_FOLDER}/{STEP}\.npz|{DONE_FOLDER}/{STEP}\.json"
)
# Our own, and the Zarr library's.
SCRAP = re.compile(rf"\..*{re.escape(SCRATCH_SUFFIX)}|.*\.[0-9a-f]{{32}}\.partial")
_PARSING = Lock()  # headers of arrays are Python text, and 3.11 fails now and then where threads parse (CPython 106905)


def _is_of_steps(name: str) -> bool:
    """Return whether a name in the folder is one that steps write."""
    return OF_STEPS.fullmatch(name) is not None and is_inside(name)


@dataclass(frozen=True)
class WorkFolder:
    """Unfinished maps. Each step leaves a mark with the checksums of what it wrote. Processes may share the folder.

    Attributes:
      path: the folder.
    """

    path: Path

    def begin(self, key: str, each: Each = map) -> list[Path]:
        """Make the folder ready for a job: keep that job's work, remove any other's.

        Args:
          key: stands for the job; it is written into the folder.
          each: calls a function with each of many marks, as `map` does, or on several threads.

        Returns:
          The damaged files of the job's work. They are removed, and the steps that wrote them have no mark any more.

        Raises:
          InputError: a link is in the place of the folder, or a file of the user's cannot be moved out of it.
        """
        self._check_is_folder()
        if is_as_written(self.path / KEY_FILE, [checksum_of(key.encode())]):
            self._sweep()
        else:
            self.discard()
            write_whole(self.path / KEY_FILE, key)

        # All steps are checked before a file is removed.
        marks = self._marks("*")
        damaged: list[Path] = []
        for mark, files in zip(marks, list(each(self._damaged, marks)), strict=True):
            damaged += files
            for path in (mark, *files) if files else ():
                remove(path)

        if not self.is_done(ZARR):  # tiles are written into it
            for path in (self.zarr, *self._marks("tile_*")):
                remove(path)
        return damaged

    def _check_is_folder(self) -> None:
        """Raise InputError if a link is in the place of the folder."""
        if self.path.is_symlink():
            raise InputError(
                f"{str(self.path)!r} is a link in the place of unfinished maps: move it, or {ELSEWHERE}"
            )

    def _sweep(self) -> None:
        """Remove what killed processes left half-written, and set aside what no step writes, as it is a user's.

        What is set aside goes to `KEPT_FOLDER` of the output folder, see `Workspace.set_aside`.
        """
        for path in list(self.path.rglob("*")):
            if SCRAP.fullmatch(path.name):
                remove(path)
        paths = self.path.rglob("*")
        for path in [path for path in paths if path.is_symlink() or not path.is_dir()]:
            name = path.relative_to(self.path).as_posix()
            if path.is_symlink() or not _is_of_steps(name):
                with Workspace.shared(self.path.parents[1], "maps") as workspace:
                    workspace.set_aside(path, name)

    def discard(self) -> None:
        """Remove the folder with all that steps wrote; files of the user's in it are set aside before.

        Raises:
          InputError: as of `begin`.
        """
        self._check_is_folder()
        self._sweep()
        remove(self.path)

    def _marks(self, pattern: str) -> list[Path]:
        """Return the marks of finished steps whose names match a pattern, sorted."""
        return sorted((self.path / DONE_FOLDER).glob(pattern))

    def _damaged(self, mark: Path) -> list[Path]:
        """Return the files of a finished step that are not as its mark says.

        The mark itself is returned where it cannot be read, or names files that no step writes: these are not looked at
        then.
        """
        try:
            checksums = dict(read_json(mark)["checksums"])
        except (OSError, ValueError, LookupError, TypeError):
            return [mark]
        if not all(map(_is_of_steps, checksums)):
            return [mark]
        return [
            self.path / name
            for name, checksum in checksums.items()
            if not is_as_written(self.path / name, [checksum])
        ]

    @property
    def zarr(self) -> Path:
        """Where the maps are assembled."""
        return self.path / ZARR

    def save_arrays(self, name: str, **arrays: np.ndarray) -> None:
        """Keep arrays, by their names, in a file of the step that made them, and mark the step done.

        Raises:
          InputError: they cannot be written.
        """
        path = self.path / ARRAY_FOLDER / f"{name}.npz"
        with whole_file(path) as scratch, scratch.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        self.mark_done(name, {f"{ARRAY_FOLDER}/{path.name}": checksum_of(path)})

    def load_arrays(self, name: str, *wanted: str) -> dict[str, np.ndarray]:
        """Return arrays that a step kept, by their names; of the ``wanted`` ones it may have kept only some.

        Raises:
          InputError: the step's file is missing or damaged.
        """
        path = self.path / ARRAY_FOLDER / f"{name}.npz"
        if self._damaged(self._mark(name)):
            raise InputError(
                f"{str(path)!r} is missing or damaged: run the same command again, which makes it again"
            )
        with _PARSING, np.load(path, allow_pickle=False) as arrays:
            return {array: arrays[array] for array in arrays.files if array in wanted}

    def _mark(self, name: str) -> Path:
        """Return the path of the mark of a step."""
        return self.path / DONE_FOLDER / f"{name}.json"

    def mark_done(self, name: str, checksums: dict[str, str], **facts: int) -> None:
        """Note that a step is finished and all of it is written.

        Args:
          name: of the step.
          checksums: of the files that it wrote, by their names in the folder.
          facts: numbers to keep too, by name.
        """
        write_json(self._mark(name), {"checksums": checksums, **facts})

    def mark_zarr(self, num_tiles: int = 0) -> None:
        """Note that the Zarr is there, in a mark of all of its files: the chunks of maps come later, with tiles."""
        files = filter(Path.is_file, self.zarr.rglob("*"))
        names = {file.relative_to(self.path).as_posix() for file in files}
        own = sorted(filter(_is_of_steps, names))
        checksums = {name: checksum_of(self.path / name) for name in own}
        self.mark_done(ZARR, checksums, num_tiles=num_tiles)

    def is_done(self, name: str) -> bool:
        """Return whether a step is finished, and its mark is whole."""
        with suppress(OSError, ValueError):
            read_json(self._mark(name))
            return True
        return False

    def finish(self, target: Path) -> None:
        """Put the assembled maps in their place, and remove the folder.

        Args:
          target: their path to be, see `jaxurban.io.stored.zarr_path`.

        Raises:
          InputError: a file of others is in the way.
        """
        self._sweep()
        # By names in the Zarr. Marks name other files too, whose checksums `put_zarr` passes over.
        checksums = {}
        for mark in self._marks("*"):
            for name, checksum in read_json(mark)["checksums"].items():
                checksums[name.removeprefix(f"{ZARR}/")] = checksum
        store.put_zarr(self.zarr, target, checksums)
        remove(self.path)
