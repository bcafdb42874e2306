"""Public names, fetched when they are first used, and how what bears them shows itself: one line, or a table.

JAX, Numba and the readers take seconds to import, and the command line must react, to ``--help`` and to Ctrl-C, before
that. A stub beside a module says to type checkers, and here, where each of its names is.
"""

import ast
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from jaxurban.knowledge import Caution, caution_lines
from jaxurban.spelling import MEANT, alike, near

# Modules of the package whose names are public too.
NAMESPACES = ("fit", "grad", "metrics", "studies")
PICTURES = "plot"  # the module of all functions that draw
TYPES = "typing"  # of classes that functions return, which completion leaves out
Function = TypeVar("Function", bound=Callable)


def public_names(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return a module's ``__getattr__``, ``__dir__`` and ``__all__``, as its stub names them: functions before classes.

    Args:
      package: full name of the module.
      file: its file; the stub lies beside it.
    """
    # The home of each public name: the module that it is imported from. The stub has lines ``from x import y as y``.
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    homes: dict[str, str | None] = {}
    for line in stub.body:
        if isinstance(line, ast.ImportFrom):
            homes |= {alias.name: line.module for alias in line.names}

    def fetch(name: str) -> Any:
        """Return what the package calls by a name, imported now.

        Raises:
          AttributeError: the module has no such name.
        """
        home = package if name == TYPES and "." not in package else homes.get(name)
        if name == "__version__" and "." not in package:
            return import_module("importlib.metadata").version(package)
        if home is None:
            raise _no_attribute(f"module {package!r}", name, _meant(name, homes))
        if home == package:  # a module of the package
            return import_module(f"{package}.{name}")
        return getattr(import_module(home), name)

    names = sorted(homes, key=lambda name: (name[0].isupper(), name))
    return fetch, lambda: names, names


def _meant(name: str, own: Iterable[str]) -> list[str]:
    """Return public names, with their modules, that a missing name of a module may mean: first the module's own."""
    known = {} if name.startswith("_") else _public_homes()
    name = MEANT.get(name, name)
    names = [name] if name in known else alike(name, known.keys() & set(own))
    names = names or near(name, known) or [each for each in known if name.startswith(each)]
    return [f"{known[each]}.{each}" for each in names]


def _no_attribute(owner: str, name: str, meant: Sequence[str]) -> AttributeError:
    """Return the error of a missing name with what it may mean, as notebooks show no hint of Python's own.

    Without an object Python adds none either.
    """
    hint = f" (did you mean {' or '.join(meant)}?)" if meant else ""
    return AttributeError(f"{owner} has no attribute {name!r}{hint}", name=name, obj=None)


def _public_homes() -> dict[str, str]:
    """Return the module of each public name: the package or one of its modules."""
    package = __name__.rpartition(".")[0]
    homes: dict[str, str] = {}
    spaces = (*NAMESPACES, PICTURES, TYPES)
    for home in (package, *(f"{package}.{each}" for each in spaces)):
        homes |= dict.fromkeys(import_module(home).__all__, home)
    return {name: home for name, home in homes.items() if name not in spaces}


def find_public(name: str) -> Any:
    """Return the function, class or constant that has a public name, or a method of it (``"Constraints.read"``).

    Raises:
      KeyError: neither the package nor one of its namespaces has the name.
    """
    name, _, method = name.partition(".")
    thing = getattr(import_module(_public_homes()[name]), name)
    return getattr(thing, method) if method else thing


LEVEL_STYLES = {
    "limit": "color:#b00020;font-weight:bold",
    "guess": "color:#5f4700;background:#fff1b8",
    "note": "",
}


class Hints:
    """Base of what names the attribute that a wrong one means."""

    if not TYPE_CHECKING:  # else a type checker knows no attribute

        def __getattr__(self, name: str) -> Any:
            """Raise AttributeError for a name that is missing; that of a property in its own words."""
            if name.startswith("_") or hasattr(type(self), name):
                return object.__getattribute__(self, name)
            public = (each for each in dir(self) if not each.startswith("_"))
            meant = near(name, public)
            if name in self._items:
                meant = [f'["{name}"]']
            raise _no_attribute(f"{type(self).__name__!r} object", name, meant)

    @property
    def _items(self) -> Collection[str]:
        """The names that ``[]`` takes."""
        return ()


class FactsRepr(Hints):
    """Base of what shows its `facts`, those that are empty left out, and what it knows to be uncertain or unsafe."""

    @property
    def facts(self) -> Mapping[str, str]:
        """What it is, fact by name."""
        raise NotImplementedError

    @property
    def known_cautions(self) -> Sequence[Caution]:
        """What whoever uses it must know first: its ``cautions``, if it has any."""
        return getattr(self, "cautions", ())

    def _cautions(self) -> Sequence[Caution]:
        try:
            return self.known_cautions
        except ValueError as error:  # its files were removed or made again: a repr must not fail
            return [Caution(f"What to be cautious of is not known: {error}", "guess")]

    def __repr__(self) -> str:
        facts = "; ".join(f"{name}: {fact}" for name, fact in self.facts.items() if fact)
        return "\n".join([f"{type(self).__name__}({facts})", *caution_lines(self._cautions())])

    def _repr_html_(self) -> str:
        """Return cautions and facts as a table for notebooks."""
        lines: list[tuple[str, str, str]] = [  # style, name and text of each row
            (LEVEL_STYLES[each.level], each.level, each) for each in self._cautions()
        ]
        lines += [("", name, fact) for name, fact in self.facts.items() if fact]
        rows = ""
        for style, name, text in lines:
            cells = f'<th>{escape(name)}</th><td style="text-align:left">{escape(text)}</td>'
            rows += f'<tr style="{style}">{cells}</tr>'
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


def listed(values: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Return values with commas; of many the first and the last ones, and how many there are."""
    if len(values) <= most:
        return ", ".join(values)
    return f"{', '.join(values[: most - 1])} ... {values[-1]} ({len(values)})"
