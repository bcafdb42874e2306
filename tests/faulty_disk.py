"""A disk that fails at a counted step of the package (by Python's audit events), or damages a file."""

import errno
import os
import random
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

import jaxurban

PACKAGE = str(Path(jaxurban.__file__).parent)
WRITES = ("open", "os.rename", "os.mkdir")
REMOVALS = ("os.remove", "os.rmdir", "shutil.rmtree")
DAMAGES = ("deleted", "cut", "flipped")
WAYS = ("failed", "full", "memory", "killed")
_watched: list["Steps"] = []


class Killed(BaseException):
    """What a step raises in the place of SIGKILL."""


@dataclass
class Steps:
    """Changes under a folder: openings for writing, moves, new folders and, where a kill is meant, removals.

    Attributes:
      folder: that is watched.
      at: the number of the step that does not come off, from 1; 0: all do.
      way: ``"failed"``: that step alone fails, as on a full disk; ``"full"``: and all later writing; ``"memory"``: that
        step alone, as memory runs out; ``"killed"``: nothing changes any more, whatever clears up afterwards.
      places: the lines of the package that each step so far is taken in, innermost first.
    """

    folder: str
    at: int = 0
    way: str = "killed"
    places: list[tuple[str, ...]] = field(default_factory=list)
    lock: Lock = field(default_factory=Lock)

    @property
    def is_over(self) -> bool:
        """Whether the step that does not come off was reached."""
        return 0 < self.at <= self.num

    @property
    def num(self) -> int:
        """The number of steps so far."""
        return len(self.places)

    def take(self, event: str, args: tuple) -> None:
        """Count an event if it is a step; raise where it must not come off."""
        events = (*WRITES, *REMOVALS) if self.way == "killed" else WRITES
        if (
            event not in events
            or not str(args[0]).startswith(self.folder)
            or not _changes(event, args)
        ):
            return
        with self.lock:
            was_over = self.is_over
            lines = (
                f"{frame.f_code.co_filename}:{line}" for frame, line in traceback.walk_stack(None)
            )
            if place := tuple(line for line in lines if line.startswith(PACKAGE)):
                self.places.append(place)
            is_now = not was_over and self.is_over
        if is_now and self.way == "killed":
            raise Killed
        if is_now and self.way == "memory":
            raise MemoryError
        if is_now or (was_over and self.way in ("full", "killed")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(args[0]))


def _changes(event: str, args: tuple) -> bool:
    if event == "open":
        return bool(args[2] & (os.O_WRONLY | os.O_RDWR))
    return os.path.lexists(args[0]) == (event != "os.mkdir")


def _take(event: str, args: tuple) -> None:
    for steps in _watched:
        steps.take(event, args)


sys.addaudithook(_take)


@contextmanager
def counted(folder: Path, at: int = 0, way: str = "killed") -> Iterator[Steps]:
    """Count the steps under a folder in the block; the one of number ``at`` does not come off, in one of `WAYS`."""
    steps = Steps(str(folder), at, way)
    _watched.append(steps)
    try:
        yield steps
    finally:
        _watched.remove(steps)


def flipped(data: bytes, bit: int) -> bytes:
    """Return data with another value of a bit."""
    damaged = bytearray(data)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def harm(file: Path, damage: str, rng: random.Random) -> None:
    """Do one of `DAMAGES` to a file, or put a folder in its place."""
    data = file.read_bytes()
    if damage in ("deleted", "a folder"):
        file.unlink()
        if damage == "a folder":
            file.mkdir()
    else:
        cut = data[: rng.randrange(len(data))]
        file.write_bytes(cut if damage == "cut" else flipped(data, rng.randrange(8 * len(data))))


def values_of(folder: Path) -> dict[str, bytes]:
    """Return all that is read of the maps in a folder."""
    maps = jaxurban.open_maps(folder).ds.load()
    return {
        str(name): array.values.tobytes()
        for name, array in maps.variables.items()
        if array.dtype.kind != "T"
    }
