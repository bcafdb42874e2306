"""Folders of compiled programs: whoever can write to one can run code here, so only this user and root may."""

import functools
import os
import pickle
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time

from jaxurban.progress import LOG

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
# What is swept in a folder of programs: patterns of names, and after how many seconds without use.
MOST_S = {
    "[0-9a-f]" * 64: 2_592_000,  # programs of JAX, after 30 days
    "numba-" + "[0-9a-f]" * 16: 2_592_000,  # folders of Numba, with all that it left there
    "tmp????????": 3_600,  # what killed sessions were writing, in some milliseconds
}
# What writing, reading, packing or unpacking a program raises where it cannot be kept or used.
UNUSABLE = (
    OSError,
    EOFError,
    RuntimeError,
    ValueError,
    TypeError,
    AttributeError,
    pickle.PickleError,
)
_warn = functools.cache(LOG.warning)


def cache_home() -> Path:
    """Return the folder of the user's caches: ``$XDG_CACHE_HOME``, or ``~/.cache`` where that is not absolute.

    The XDG Base Directory Specification says that relative paths are to be ignored.

    Raises:
      RuntimeError: the user has no home.
    """
    chosen = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return chosen if chosen.is_absolute() else Path.home().absolute() / ".cache"


def closed_folder(place: Path, num_own: int) -> Path:
    """Return a folder that nobody but this user and root can change or exchange, marked as used now.

    Each folder from ``/`` down is own or root's, and others may not write to it. Above the own ones two more kinds
    pass: a sticky folder (``/tmp``), as others cannot rename there what is not theirs, and a link that is own or root's
    if all that leads to its target passes as well. Each is looked at only once all above it has passed, and what has
    passed nobody else can exchange. So what holds when this returns holds until this user or root gives rights away,
    and the path may then be opened by its name. What is missing is made, and nothing in a folder that fails.

    Windows keeps rights elsewhere than in modes: there every folder passes.

    Args:
      place: its path, absolute.
      num_own: how many of the path's last folders are for programs alone: no links, and this user writes to them.

    Raises:
      PermissionError: another user could change it, or this one may not write to it.
      OSError: it cannot be made for another reason.
    """
    if place.parent != place:
        closed_folder(place.parent, num_own - 1)
    if not os.path.lexists(place):
        place.mkdir(0o700, exist_ok=True)
    refuse_unsafe(place, place.lstat(), leads_only=num_own <= 0)
    if num_own > 0:
        os.utime(place)
    elif place.is_symlink():
        closed_folder(place.parent / os.readlink(place), 0)
    return place


def refuse_unsafe(place: Path, status: os.stat_result, *, leads_only: bool = False) -> None:
    """Raise PermissionError where another user could have changed a file, or what lies in a folder.

    Args:
      place: for the error, which is said once a place: the folder, or the one that holds the file.
      status: of the file or folder.
      leads_only: it lies above the folders of programs, where it may be a link or sticky.
    """
    mode = status.st_mode
    is_shut = (stat.S_ISREG(mode) or stat.S_ISDIR(mode)) and not mode & OTHERS_WRITE
    if leads_only:
        is_shut |= stat.S_ISLNK(mode) or bool(mode & stat.S_ISVTX)
    if os.name != "nt" and not (is_shut and status.st_uid in (0, os.geteuid())):
        raise PermissionError(
            f"{str(place)!r} is or holds a link, a pipe or what another user owns or may write to"
        )


def read_kept(file: Path) -> bytes:
    """Return the content of a file in a closed folder; the file is marked as used now.

    The folder is held open and the file is opened within it; no link is followed, no pipe is waited for, and what was
    opened decides. So it does not matter what a name leads to at another time.

    Raises:
      PermissionError: another user could have written it.
      OSError: there is none, or it cannot be read.
    """
    refuse_unsafe(file.parent, file.lstat())
    with suppress(OSError):  # it is root's
        os.utime(file)
    if os.name == "nt":
        return file.read_bytes()
    folder = os.open(file.parent, os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        refuse_unsafe(file.parent, os.fstat(folder))
        opened = os.open(file.name, os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)
    with open(opened, "rb") as stream:
        refuse_unsafe(file.parent, os.fstat(opened))
        return stream.read()


@functools.cache
def sweep_unused(folder: Path) -> None:
    """Remove, once a session, what in a closed folder has a program's name and was not used for long."""
    for names, most_s in MOST_S.items():
        for place in folder.glob(names):
            with suppress(OSError):  # another user's, or swept by another session
                if time() - place.lstat().st_mtime < most_s:
                    continue
                if place.is_dir():
                    shutil.rmtree(place)
                else:
                    place.unlink()


@contextmanager
def or_compile() -> Iterator[None]:
    """Go on after a block that cannot load or keep a program, which is then compiled.

    Where others could write, or this user may not, the log says so with the remedy, once a place.
    """
    try:
        yield
    except PermissionError as error:
        _warn(
            f"compiled programs are neither loaded nor kept here ({error}), as whoever can change one can run code. "
            "They are compiled instead. Let only yourself write to that place and what it holds (chown, chmod go-w), "
            "or set XDG_CACHE_HOME to a folder of yours alone."
        )
    except UNUSABLE:
        pass
