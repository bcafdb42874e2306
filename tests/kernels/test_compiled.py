import importlib
import os
import pickle
import subprocess
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

KERNEL = """
import numpy as np
from jaxurban.kernels.compiled import compiled

@compiled()
def doubled(x):
    made = np.empty(len(x))
    total = 0.0
    for i in range(len(x)):
        made[i] = 2 * x[i]
        total += made[i]
    if np.isnan(total):
        raise ValueError("the sum is no number")
    return made, total
"""
USE = """
import sys
import numpy as np
from numba import njit
from kernel_of_test import doubled

made, total = doubled(np.arange(3.0))
print(made.tolist(), total)
try:
    doubled(np.array([np.nan]))
except ValueError as error:
    print(error)
print("numba.np.arraymath" in sys.modules)  # of what Numba loads to compile
print(bool(doubled.stats.cache_hits))
print(njit(lambda x: doubled(x)[1] + 1.0)(np.arange(3.0)))
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


@pytest.mark.slow
def test_a_process_that_finds_all_in_the_cache_neither_loads_what_compiles_nor_answers_differently(tmp_path):
    """And one that then compiles a function which calls what it found does."""
    (tmp_path / "kernel_of_test.py").write_text(KERNEL)
    own = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    for cached in (False, True):
        run = subprocess.run([sys.executable, "-c", USE], env=own, capture_output=True, text=True, check=True)
        *answers, loaded, is_hit, later = run.stdout.splitlines()
        assert is_hit == str(cached)
        assert answers == ["[0.0, 2.0, 4.0] 6.0", "the sum is no number"]
        assert later == "7.0"
        if cached:
            assert loaded == "False"


@pytest.mark.parametrize("pattern", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("damage", [lambda data: b"", lambda data: data[:100], lambda data: b"\x95" + 64 * b"\xff"])
def test_a_damaged_cache_is_made_anew(load_outer, tmp_path, pattern, damage):
    assert load_outer(2, 10)(1.5) == 13.0
    for file in (tmp_path / "__pycache__").glob(pattern):
        file.write_bytes(damage(file.read_bytes()))
    assert load_outer(2, 10)(1.5) == 13.0
    outer = load_outer(2, 10)
    assert outer(1.5) == 13.0
    assert sum(outer.stats.cache_hits.values()) == 1
