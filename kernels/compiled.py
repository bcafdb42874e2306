"""Functions compiled by Numba, kept on disk until a file that they are made of changes."""

import functools
import hashlib
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numpy as np

from jaxurban.programs import say_compiling

try:
    from numba.core import (
        event,
    )  # documented (Numba's event API); without it nothing is said of compiling
except ImportError:
    event = None  # type: ignore[assignment]

config: Any = numba.config


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator: `numba.njit` with these options, and a cache on disk that knows of inner functions.

    Python's lock is released in all of them. Options that differ from function to function would have Numba resolve,
    and compile, all that they take from it once for each choice.

    Numba's own ``cache=True`` compiles again when the file of the outer function changes, but goes on with the old
    machine code when a compiled function that it calls, or a constant that it reads, changes in another file. Here
    the folder is named by all files of the package that the function's own file imports from, so that compiled
    functions can be shared between files. They are imported at its top, from their modules.
    """
    options = {"nogil": True} | options

    def decorate(function: Callable[..., Any]) -> Any:
        before = config.CACHE_DIR
        with suppress(
            RuntimeError, OSError
        ):  # a read-only install without a home: each process compiles
            config.CACHE_DIR = str(_folder(function.__module__, before))
            try:
                return numba.njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = before
        return numba.njit(**options)(function)

    return decorate


def on_host(values: Any) -> np.ndarray:
    """Return values for compiled functions, read-only as those of JAX are: Numba compiles again for another kind."""
    array = np.ascontiguousarray(values).view()
    array.flags.writeable = False
    return array


@functools.cache
def _folder(module: str, chosen: str) -> Path:
    """Return the folder for the machine code of a module, made: in ``chosen``, beside it, or in the user's cache."""
    beside = Path(sys.modules[module].__file__ or "").parent / "__pycache__"
    own = Path(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "jaxurban", "numba"
    )
    for folder in (Path(chosen),) if chosen else (beside, own):
        with suppress(OSError):
            found = folder / f"numba-{_digest(module)}"
            found.mkdir(parents=True, exist_ok=True)
            if os.access(found, os.W_OK | os.X_OK):
                return found
    raise OSError("no folder can be written to")


@functools.cache
def _digest(module: str) -> str:
    """Return a hash of the source of a module and of those of its package that it imports from."""
    source = Path(sys.modules[module].__file__ or "").read_text(encoding="utf-8")
    inner = re.findall(rf"^from ({module.partition('.')[0]}\.[\w.]+) import", source, re.MULTILINE)
    return hashlib.sha256("".join([source, *map(_digest, inner)]).encode()).hexdigest()[:16]


class _CompileNotice(event.Listener if event else object):  # type: ignore[misc]
    """Says once that kernels of this package are compiled."""

    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"].py_func.__module__.startswith("jaxurban."):
            say_compiling()

    def on_end(self, event: Any) -> None: ...


if event is not None:
    event.register("numba:compile", _CompileNotice())
