"""Which folders of compiled programs are used: nobody but this user and root could have written what is loaded."""

import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from jaxurban import kept_folders
from jaxurban.cities.download import cache_folder
from jaxurban.kept_folders import cache_home, closed_folder, or_compile, read_kept, sweep_unused
from tests.kept_attacks import ATTACKS, OTHER, as_root
from tests.logs import logged

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
NUM_OWN = 2


@pytest.fixture
def file(tmp_path) -> Iterator[Path]:
    """A kept file in a user's cache."""
    folder = closed_folder(tmp_path / "home" / "jaxurban" / "programs", NUM_OWN)
    kept = folder / "kept"
    kept.write_bytes(b"whole")
    kept.chmod(0o600)
    yield kept
    kept_folders._warn.cache_clear()


def content(file: Path) -> bytes | None:
    """Return what is read of a file as programs are read; None where it is not."""
    with or_compile():
        closed_folder(file.parent, NUM_OWN)
        return read_kept(file)
    return None


def everything_in(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*"))


def test_a_file_that_only_this_user_can_write_is_read_and_marked_as_used(file):
    os.utime(file, (0, 0))
    assert content(file) == b"whole"
    assert time.time() - file.stat().st_mtime < 60


@pytest.mark.parametrize("attack", ATTACKS)
def test_what_another_user_could_have_written_is_not_read_and_that_is_said_once(file, attack):
    attack(file)
    with logged() as lines:
        assert [content(file), content(file)] == [None, None]
    assert ["chmod go-w" in line and str(file.parents[3]) in line for line in lines] == [True]


def test_of_many_such_files_in_a_folder_one_line_is_said(file):
    others = [file.with_name(name) for name in ("second", "third")]
    for other in others:
        other.write_bytes(b"whole")
        other.chmod(0o666)
    with logged() as lines:
        assert [content(other) for other in others] == [None, None]
    assert len(lines) == 1
    assert content(file) == b"whole"


def test_a_link_of_this_user_may_lead_to_the_cache_and_so_may_a_sticky_folder(file):
    home = file.parents[2]
    sticky = home.with_name("sticky")
    sticky.mkdir()
    sticky.chmod(0o1777)
    home.rename(sticky / "home")
    home.symlink_to(sticky / "home")
    assert content(file) == b"whole"


@as_root
def test_what_is_roots_is_trusted_by_another_user(file, tmp_path, monkeypatch):
    file.chmod(0o644)
    monkeypatch.setattr(os, "geteuid", lambda: OTHER)
    assert content(file) == b"whole"


@as_root
@pytest.mark.parametrize("mode", [0o755, 0o777, 0o1777])
def test_nothing_is_made_in_a_folder_of_another_user(tmp_path, mode):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    theirs.chmod(mode)
    os.chown(theirs, OTHER, OTHER)
    with pytest.raises(PermissionError, match="what another user owns"):
        closed_folder(theirs / "home" / "jaxurban" / "programs", NUM_OWN)
    assert everything_in(theirs) == []


def test_nothing_is_made_in_a_folder_that_others_may_write_to_unless_it_is_sticky(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    with pytest.raises(PermissionError):
        closed_folder(shared / "jaxurban" / "programs", NUM_OWN)
    assert everything_in(shared) == []
    shared.chmod(0o1777)
    made = closed_folder(shared / "jaxurban" / "programs", NUM_OWN)
    assert [folder.stat().st_mode & 0o777 for folder in (made, made.parent)] == [0o700, 0o700]


@as_root
@pytest.mark.slow
def test_a_user_who_exchanges_the_folder_all_the_time_never_has_a_file_read(file):
    """The other user owns the folder above, and what lies in the place of the own one in turn is theirs."""
    jaxurban = file.parents[1]
    theirs = jaxurban / "theirs"
    theirs.mkdir()
    (theirs / file.name).write_bytes(b"evil")
    for place in (jaxurban, theirs, theirs / file.name):
        os.chown(place, OTHER, OTHER)
    stop = threading.Event()

    def exchange() -> None:
        aside = jaxurban / "aside"
        while not stop.is_set():
            for here, there in ((file.parent, aside), (theirs, file.parent)):
                here.rename(there)
            for here, there in ((file.parent, theirs), (aside, file.parent)):
                here.rename(there)

    thread = threading.Thread(target=exchange)
    thread.start()
    try:
        read = {content(file) for _ in range(1_000)}
    finally:
        stop.set()
        thread.join()
    assert read == {None}


def test_the_file_that_was_opened_decides_not_the_one_that_was_looked_at(file, monkeypatch):
    """Even if the name leads elsewhere from one moment to the next."""
    evil = file.with_name("evil")
    evil.write_bytes(b"evil")
    evil.chmod(0o666)
    os_open = os.open

    def open_another(path, flags, *args, **kwargs):
        if path == file.name:
            evil.replace(file)
        return os_open(path, flags, *args, **kwargs)

    monkeypatch.setattr(os, "open", open_another)
    with pytest.raises(PermissionError):
        read_kept(file)


@pytest.mark.parametrize("chosen", ["", "cache", "./cache", "../cache"])
def test_a_relative_folder_for_caches_is_ignored(tmp_path, monkeypatch, chosen):
    """As the XDG Base Directory Specification asks."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", chosen)
    assert cache_home() == tmp_path / ".cache"
    assert cache_folder() == tmp_path / ".cache" / "jaxurban" / "fetch"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))
    assert cache_home() == tmp_path / "own"


def test_what_kills_left_and_what_nobody_used_for_a_month_is_swept_and_nothing_else(file):
    folder = file.parent
    day_s = 86_400
    used = {
        "a" * 64: 29 * day_s,
        "b" * 64: 31 * day_s,
        "tmpab12_cd3": 600,
        "tmpab12_cd4": 7_200,
        "numba-0123456789abcdef": 29 * day_s,
        "numba-0123456789abcde0": 31 * day_s,
        "a.py": 400 * day_s,
        "numba-mine": 400 * day_s,
    }
    for name in used:
        place = folder / name
        if name.startswith("numba"):
            place.mkdir()
            (place / "f.nbi").touch()
        else:
            place.touch()
    for name, ago_s in used.items():
        os.utime(folder / name, (time.time() - ago_s,) * 2)
    sweep_unused(folder)
    left = ["a" * 64, "tmpab12_cd3", "numba-0123456789abcdef", "a.py", "numba-mine", file.name]
    assert sorted(place.name for place in folder.iterdir()) == sorted(left)


def test_a_link_that_is_called_like_a_folder_of_numba_is_not_followed_in_sweeping(file, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "work").touch()
    os.utime(mine, (0, 0))
    link = file.with_name("numba-0123456789abcdef")
    link.symlink_to(mine)
    os.utime(link, (0, 0), follow_symlinks=False)
    with or_compile():
        sweep_unused(file.parent)
    assert (mine / "work").exists()


def test_what_cannot_be_swept_stays_and_the_rest_is_swept(file, monkeypatch):
    names = "numba-0123456789abcdef", "numba-0123456789abcde0"
    for name in names:
        file.with_name(name).mkdir()
        os.utime(file.with_name(name), (0, 0))
    remove = shutil.rmtree

    def of_another(place: object) -> None:
        if str(place).endswith("f"):
            raise PermissionError(place)
        remove(place)

    monkeypatch.setattr(shutil, "rmtree", of_another)
    sweep_unused(file.parent)
    assert [file.with_name(name).exists() for name in names] == [True, False]


class WindowsOs:
    """What Windows lacks of `os`, and its name."""

    name = "nt"

    def __getattr__(self, name: str) -> object:
        if name in {"geteuid", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "setxattr"}:
            raise AttributeError(name)
        return getattr(os, name)


def test_on_windows_which_has_neither_modes_nor_such_openings_programs_are_kept(file, monkeypatch):
    file.chmod(0o666)
    monkeypatch.setattr(kept_folders, "os", WindowsOs())
    assert content(file) == b"whole"
