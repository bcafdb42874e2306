"""What another user, or this one's own hand, can have done to a folder of compiled programs; for tests."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

OTHER = 1234  # a user's number
as_root = pytest.mark.skipif(
    getattr(os, "geteuid", lambda: 1)() != 0, reason="only root can give files to another user"
)


def _open_to(mode: int, at: int) -> Callable[[Path], None]:
    """Return a change of the mode of a file (0) or of a folder so far above it."""
    return lambda file: [file, *file.parents][at].chmod(mode)


def _given_away(at: int) -> Callable[[Path], None]:
    """Return a gift of a file (0), or of a folder so far above it, to another user."""
    return lambda file: os.lchown([file, *file.parents][at], OTHER, OTHER)


def _made_a_link(at: int) -> Callable[[Path], None]:
    """Return a move of a file (0), or of a folder so far above it, with a link of this user's left in its place."""

    def change(file: Path) -> None:
        place = [file, *file.parents][at]
        place.symlink_to(place.rename(place.with_name("moved")))

    return change


def _made_a_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file, 0o600)


def _linked_through_an_open_folder(file: Path) -> None:
    """Lead to the user's cache by own links, one of which lies where others can exchange it."""
    home = file.parents[2]
    moved = home.rename(home.with_name("moved"))
    shared = home.with_name("shared")
    shared.mkdir()
    shared.chmod(0o777)
    (shared / "link").symlink_to(moved)
    home.symlink_to(shared / "link")


# Of a file in ``home/jaxurban/FOLDER``.
BY_ANYONE: dict[str, Callable[[Path], None]] = {
    "a file for all": _open_to(0o666, 0),
    "a file for a group": _open_to(0o620, 0),
    "a folder for all": _open_to(0o777, 1),
    "a folder for a group": _open_to(0o770, 1),
    "a sticky folder": _open_to(0o1777, 1),
    "jaxurban for all": _open_to(0o777, 2),
    "the user's cache for all": _open_to(0o777, 3),
    "the user's cache for a group": _open_to(0o775, 3),
    "a link to a file": _made_a_link(0),
    "a link to a folder": _made_a_link(1),
    "a link to jaxurban": _made_a_link(2),
    "a link through a folder for all": _linked_through_an_open_folder,
    "a pipe": _made_a_pipe,
}
BY_ROOT: dict[str, Callable[[Path], None]] = {
    "another's file": _given_away(0),
    "another's folder": _given_away(1),
    "another's jaxurban": _given_away(2),
    "another's cache": _given_away(3),
}
ATTACKS = [
    *(pytest.param(change, id=name) for name, change in BY_ANYONE.items()),
    *(pytest.param(change, id=name, marks=as_root) for name, change in BY_ROOT.items()),
]
