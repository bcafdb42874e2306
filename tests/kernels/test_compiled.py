"""Compiled functions are kept on disk until a file that they are made of changes, by public names of Numba alone."""

import importlib
import os
import pickle
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from jaxurban import kept_folders
from jaxurban.kernels.line.traversal import walk_edge
from jaxurban.kernels.search.heap import Heap, place
from tests.compile_first import paths
from tests.kept_attacks import ATTACKS, OTHER, as_root
from tests.logs import logged

INNER = """
from jaxurban.kernels.compiled import compiled

ADDED = {added}

@compiled()
def twice(x):
    return {factor} * x
"""
OUTER = """
from package_of_test.inner import ADDED, twice
from jaxurban.kernels.compiled import compiled

@compiled()
def outer(x):
    return twice(x) + ADDED
"""
USE = """
import numba
from package_of_test.outer import outer
print(outer(1.5), sum(outer.stats.cache_hits.values()), numba.config.CACHE_DIR)
"""


@pytest.fixture
def run_outer(tmp_path):
    """Return a function that writes both files and calls the outer one in a new process: its value, its cache's hits.

    With the folder for Numba's cache, if any.
    """
    folder = tmp_path / "package_of_test"
    folder.mkdir()
    (folder / "outer.py").write_text(OUTER)

    def run(factor, added, cache_dir=""):
        (folder / "inner.py").write_text(INNER.format(factor=factor, added=added))
        environment = {
            name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"
        }
        environment |= {
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        environment |= {"NUMBA_CACHE_DIR": str(cache_dir)} if cache_dir else {}
        command = [sys.executable, "-c", USE]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        value, hits, *chosen = ended.stdout.split()
        assert chosen == ([str(cache_dir)] if cache_dir else [])  # left as it was
        return float(value), int(hits)

    return run


@pytest.mark.slow
def test_an_edit_of_an_inner_function_or_constant_in_another_file_is_seen_and_else_the_cache_hits(
    run_outer,
):
    assert run_outer(2, 10) == (13.0, 0)
    assert run_outer(2, 10) == (13.0, 1)
    assert run_outer(3, 10) == (14.5, 0)
    assert run_outer(3, 20) == (24.5, 0)


@pytest.mark.slow
def test_the_users_cache_folder_is_used_and_one_that_cannot_be_written_does_no_harm(
    run_outer, tmp_path
):
    assert run_outer(2, 10, tmp_path / "own") == (13.0, 0)
    assert any((tmp_path / "own").rglob("outer*.nbi"))
    assert run_outer(2, 10, tmp_path / "own") == (13.0, 1)
    assert run_outer(2, 10, "/proc/nowhere") == (13.0, 0)


on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
MODULE = """
from jaxurban.kernels.compiled import compiled

@compiled()
def thrice(x):
    return 3 * x
"""


@pytest.fixture
def home(monkeypatch, tmp_path) -> Iterator[Path]:
    """An empty cache of the user, and a module of compiled functions beside which nothing can be kept."""
    package = tmp_path / "package"
    package.mkdir()
    (package / "module_of_test.py").write_text(MODULE)
    (package / "__pycache__").write_text("")
    monkeypatch.syspath_prepend(str(package))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    yield tmp_path / "home"
    sys.modules.pop("module_of_test", None)
    for known in (kept_folders._warn, kept_folders.sweep_unused):
        known.cache_clear()


def num_loaded() -> int:
    """Return how many programs a new session loads for one call, which must be right."""
    sys.modules.pop("module_of_test", None)
    thrice = importlib.import_module("module_of_test").thrice
    assert thrice(1.5) == 4.5
    return sum(thrice.stats.cache_hits.values())


def index_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbi"))


def harmful(file: Path, mark: Path) -> None:
    """Make the reading of an index leave a mark."""

    class Mark:
        def __reduce__(self):
            return os.makedirs, (str(mark), 0o777, True)

    file.write_bytes(pickle.dumps(Mark()))


@on_posix
def test_what_one_session_compiles_a_later_one_loads_from_the_users_cache_whatever_the_umask(home):
    before = os.umask(0)
    try:
        assert [num_loaded(), num_loaded()] == [0, 1]
    finally:
        os.umask(before)
    made = [home, *home.rglob("*")]
    assert [place for place in made if place.stat().st_mode & 0o077] == []


@on_posix
def test_an_empty_folder_that_others_may_enter_is_closed_before_numba_writes(home):
    num_loaded()
    (inner,) = {file.parent for file in index_files(home)}
    shutil.rmtree(inner)
    inner.parent.chmod(0o755)
    assert num_loaded() == 0
    assert inner.parent.stat().st_mode & 0o077 == 0


@on_posix
@pytest.mark.slow
@pytest.mark.parametrize("attack", ATTACKS)
def test_no_index_that_another_user_could_have_written_is_read_and_that_is_said_once(
    home, tmp_path, attack
):
    num_loaded()
    (file,) = index_files(home)
    harmful(file, tmp_path / "mark")
    attack(file)
    with logged() as lines:
        assert [num_loaded(), num_loaded()] == [0, 0]
    assert not (tmp_path / "mark").exists()
    assert ["chmod go-w" in line for line in lines] == [True]


@on_posix
def test_the_attack_runs_where_no_guard_stands_in_its_way(home, tmp_path):
    """So the test above says something."""
    num_loaded()
    (file,) = index_files(home)
    harmful(file, tmp_path / "mark")
    assert num_loaded() == 0  # what was read is no index
    assert (tmp_path / "mark").exists()


@as_root
@pytest.mark.parametrize("mode", [0o755, 0o777])
def test_nothing_is_kept_in_a_cache_that_another_user_made_first(home, mode):
    (home / "jaxurban").mkdir(parents=True)
    (home / "jaxurban").chmod(mode)
    os.chown(home / "jaxurban", OTHER, OTHER)
    with logged() as lines:
        assert [num_loaded(), num_loaded()] == [0, 0]
    assert [str(home / "jaxurban") in line for line in lines] == [True]
    assert [*(home / "jaxurban").iterdir()] == []


@on_posix
@pytest.mark.parametrize("open_part", ["__pycache__", "."])
def test_beside_a_module_nothing_is_loaded_or_kept_where_others_may_write(
    home, tmp_path, open_part
):
    """What is kept beside it by others is not read either; the user's cache serves, and nothing has to be said."""
    beside = tmp_path / "package" / "__pycache__"
    beside.unlink()
    assert [num_loaded(), num_loaded()] == [0, 1]
    (file,) = index_files(beside)
    harmful(file, tmp_path / "mark")
    (tmp_path / "package" / open_part).chmod(0o777)
    with logged() as lines:
        assert [num_loaded(), num_loaded()] == [0, 1]
    assert not (tmp_path / "mark").exists()
    assert lines == []
    assert len(index_files(home)) == 1


@on_posix
def test_where_numba_takes_another_folder_than_ours_nothing_is_kept(home, tmp_path):
    """As it does without a word where it cannot write to the one that its configuration names."""
    num_loaded()
    (file,) = index_files(home)
    elsewhere = home / "numba" / file.parent.name
    elsewhere.mkdir(parents=True)
    harmful(elsewhere / file.name, tmp_path / "mark")
    shutil.rmtree(file.parent)
    file.parent.write_text("in its place")
    assert [num_loaded(), num_loaded()] == [0, 0]
    assert not (tmp_path / "mark").exists()


@on_posix
def test_machine_code_that_no_session_used_for_a_month_is_swept_once_other_code_comes(home):
    num_loaded()
    (folder,) = home.glob("jaxurban/numba/numba-*")
    old = folder.with_name("numba-0123456789abcdef")
    shutil.copytree(folder, old)
    month_ago_s = time.time() - 31 * 86_400
    os.utime(old, (month_ago_s, month_ago_s))
    os.utime(folder, (month_ago_s, month_ago_s))
    assert num_loaded() == 1  # which marks the folder as used, and writes nothing
    assert old.exists()
    shutil.rmtree(folder)
    kept_folders.sweep_unused.cache_clear()
    assert num_loaded() == 0
    assert not old.exists()
    assert folder.exists()


def made_of(module):
    """Return a module and those of the package that it imports from: the folder of its cache is named by them."""
    source = Path(sys.modules[module].__file__).read_text(encoding="utf-8")
    return {module}.union(
        *map(made_of, re.findall(r"^from (jaxurban\.[\w.]+) import", source, re.MULTILINE))
    )


def named_tuples_in(kind):
    """Return the classes of named tuples that a type of Numba holds."""
    own = {kind.instance_class} if hasattr(kind, "instance_class") else set()
    return own.union(*map(named_tuples_in, getattr(kind, "types", ())))


def taken_from_elsewhere(dispatcher):
    """Return the classes of named tuples that a compiled function was called with and its module does not know."""
    kinds = [kind for signature in dispatcher.signatures for kind in signature]
    found = set().union(*map(named_tuples_in, kinds))
    return {each for each in found if each.__module__ not in made_of(dispatcher.py_func.__module__)}


def test_compiled_functions_take_named_tuples_of_modules_that_theirs_import():
    """The index of a cache names their classes: where one's module goes, it cannot be read any more."""
    stranger = SimpleNamespace(
        py_func=walk_edge.py_func, signatures=[(numba.typeof(Heap.empty(4)),)]
    )
    assert taken_from_elsewhere(stranger) == {Heap}
    paths()
    modules = [module for name, module in sys.modules.items() if name.startswith("jaxurban.")]
    called = {
        each for module in modules for each in vars(module).values() if hasattr(each, "py_func")
    }
    assert place in called
    assert {each: found for each in called if (found := taken_from_elsewhere(each))} == {}
