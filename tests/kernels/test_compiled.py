"""Compiled functions are kept on disk until a file that they are made of changes, by public names of Numba alone."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from jaxurban.kernels.line.traversal import walk_edge
from jaxurban.kernels.search.heap import Heap, place
from tests.compile_first import paths

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
