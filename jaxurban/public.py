"""Public names, fetched when they are first used, and how what bears them shows itself: one line, or a table.

JAX, Numba and the readers take seconds to import, and the command line must react, to ``--help`` and to Ctrl-C, before
that. A stub beside a module says to type checkers, and here, where each of its names is.
"""

import ast
from collections.abc import Callable, Mapping
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

NAMESPACES = ("fit", "grad", "metrics", "studies")  # modules of the package whose names are public too


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return a module's ``__getattr__``, ``__dir__`` and ``__all__``, as its stub names them.

    Args:
      package: the module's name.
      file: its file; the stub lies beside.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    homes = {alias.name: line.module for line in stub.body if isinstance(line, ast.ImportFrom) for alias in line.names}

    def fetch(name: str) -> Any:
        home = homes.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{name}") if home == package else getattr(import_module(home), name)

    return fetch, lambda: sorted(homes), sorted(homes)


def find_public(name: str) -> Any:
    """Return what has a public name, at the top of the package or in one of its namespaces.

    Raises:
      KeyError: nothing has.
    """
    package = __name__.rpartition(".")[0]
    for home in (package, *(f"{package}.{namespace}" for namespace in NAMESPACES)):
        module = import_module(home)
        if name in module.__all__ and name not in NAMESPACES:
            return getattr(module, name)
    raise KeyError(name)


class Shown:
    """Base of what tells its `facts`; those that are empty are left out."""

    @property
    def facts(self) -> Mapping[str, str]:
        """What it is, fact by name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(f'{name}: {fact}' for name, fact in self.facts.items() if fact)})"

    def _repr_html_(self) -> str:
        rows = (f"<tr><th>{escape(name)}</th><td>{escape(fact)}</td></tr>" for name, fact in self.facts.items() if fact)
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"


def listed(values: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Return values with commas; of many the first and the last ones, and how many there are."""
    if len(values) <= most:
        return ", ".join(values)
    return f"{', '.join(values[: most - 1])} ... {values[-1]} ({len(values)})"
