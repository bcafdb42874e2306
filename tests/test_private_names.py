"""Source files name nothing private of libraries: their next release may rename it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path for folder in ("jaxurban", "kernels", "planners") for path in (ROOT / folder).rglob("*.py"))
OF_NAMEDTUPLE = {"_replace", "_fields", "_asdict", "_make"}  # documented
EXCEPTIONS = {
    "jaxurban/cli/main.py: ._exit": "Python documents os._exit",
    "kernels/compiled.py: numba.core": "Numba documents its event API under this name; without it a message is lost",
}


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def own_names(nodes: list[ast.AST]) -> set[str]:
    """Return the names that a file defines itself: functions, classes, fields, attributes set on ``self``."""
    set_here = [node for node in nodes if isinstance(getattr(node, "ctx", None), ast.Store)]
    found = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    found |= {node.id for node in set_here if isinstance(node, ast.Name)}
    of_self = [node for node in set_here if isinstance(node, ast.Attribute)]
    return found | {node.attr for node in of_self if ast.unparse(node.value) in ("self", "cls")}


def private_names(source: str) -> list[str]:
    """Return what a source names of others that is private."""
    nodes, modules, names = list(ast.walk(ast.parse(source))), [], []
    for node in nodes:
        if isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute):
            names.append(node.attr)
            modules += ["numba.core"] * (ast.unparse(node) == "numba.core")
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "setattr", "hasattr"):
            names.append(str(getattr(node.args[1], "value", "")))
    known = own_names(nodes) | OF_NAMEDTUPLE
    found = [f".{name}" for name in names if is_private(name) and name not in known]
    found += [name for name in modules if any(map(is_private, name.split("."))) and not name.startswith("jaxurban.")]
    return found + ["numba.core" for name in modules if name.startswith("numba.core")]


@pytest.mark.parametrize(
    "source",
    [
        "import numba\nnumba.jit(f)._cache = 3",
        "from numba.core import types",
        "import numba\nnumba.core.types",
        "from rasterio._err import CPLE_BaseError",
        "import jax._src.core",
        "import multiprocessing\ngetattr(multiprocessing.current_process(), '_inheriting', False)",
    ],
)
def test_a_private_name_of_a_library_is_found(source):
    assert private_names(source)


def test_private_names_of_ones_own_and_of_named_tuples_are_none():
    assert not private_names(
        "class A:\n    def f(self):\n        self._b = 1\n        return self._b, self.t._replace(x=1)"
    )


def test_no_source_names_a_private_attribute_of_a_library():
    assert len(FILES) > 150
    found = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in FILES
        for name in private_names(path.read_text(encoding="utf-8"))
    }
    assert found == set(EXCEPTIONS)
