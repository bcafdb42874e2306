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


def own_names(tree: ast.AST) -> set[str]:
    """Return the names that a file defines itself: functions, classes, fields, attributes set on ``self``."""
    found = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            if isinstance(node, ast.Name):
                found.add(node.id)
            elif ast.unparse(node.value) in ("self", "cls"):
                found.add(node.attr)
    return found


def private_names(source: str) -> list[str]:
    """Return what a source names of others that is private."""
    tree, found = ast.parse(source), []
    known = own_names(tree) | OF_NAMEDTUPLE
    for node in ast.walk(tree):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        for module in modules:
            parts = module.split(".")
            if parts[0] != "jaxurban" and any(map(is_private, parts)):
                found.append(module)
            if parts[:2] == ["numba", "core"]:
                found.append("numba.core")
        if isinstance(node, ast.Attribute) and is_private(node.attr) and node.attr not in known:
            found.append(f".{node.attr}")
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "numba.core":
            found.append("numba.core")
        is_text_access = isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "setattr", "hasattr")
        if is_text_access and isinstance(node.args[1], ast.Constant) and is_private(str(node.args[1].value)):
            found.append(f".{node.args[1].value}")
    return found


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
