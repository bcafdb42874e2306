import importlib
import pickle
import sys

import pytest

INNER = """
from jaxurban.kernels.compiled import compiled

ADDED = {added}

@compiled()
def twice(x):
    return {factor} * x
"""
OUTER = """
from inner_of_test import ADDED, twice
from jaxurban.kernels.compiled import compiled

@compiled()
def outer(x):
    return twice(x) + ADDED
"""


@pytest.fixture
def load_outer(tmp_path, monkeypatch):
    """Return a function that writes the inner file and loads both anew, as a new process would."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "outer_of_test.py").write_text(OUTER)

    def load(factor, added):
        (tmp_path / "inner_of_test.py").write_text(INNER.format(factor=factor, added=added))
        for name in ("inner_of_test", "outer_of_test"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("outer_of_test").outer

    yield load
    for name in ("inner_of_test", "outer_of_test"):
        sys.modules.pop(name, None)


def test_an_edit_of_an_inner_function_or_constant_in_another_file_is_seen(load_outer, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of Python: its time stamps may be as coarse as a second
    for factor, added, expected in ((2, 10, 13.0), (3, 10, 14.5), (3, 20, 24.5)):
        outer = load_outer(factor, added)
        assert outer(1.5) == expected
        assert sum(outer.stats.cache_hits.values()) == 0


def test_what_is_unchanged_is_found_in_the_cache(load_outer):
    assert load_outer(2, 10)(1.5) == 13.0
    outer = load_outer(2, 10)
    assert outer(1.5) == 13.0
    assert sum(outer.stats.cache_hits.values()) == 1


def test_a_cache_that_names_a_type_which_is_gone_is_made_anew(load_outer, tmp_path):
    assert load_outer(2, 10)(1.5) == 13.0
    for index in (tmp_path / "__pycache__").glob("*.nbi"):
        with index.open("rb") as file:
            version = pickle.load(file)
        index.write_bytes(pickle.dumps(version) + b"cmodule_that_is_gone\nGround\n.")
    assert load_outer(2, 10)(1.5) == 13.0
