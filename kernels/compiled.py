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
from numba.core import event  # documented (Numba's event API)

from jaxurban.programs import say_compiling

config: Any = numba.config


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator: `numba.njit` with these options, and a cache on disk that knows of inner functions.

    Every function so decorated releases Python's lock while it runs (``nogil``); options that differ from function to
    function would make Numba compile its own inner functions once for each set of options.

    Numba's own ``cache=True`` compiles again when the file of the outer function changes, but goes on with the old
    machine code when a compiled function that it calls, or a constant that it reads, changes in another file. Here
    the folder is named by all files of the package that the function's own file imports from, so that compiled
    functions can be shared between files. They must be imported at the file's top, each from its own module.

    Args:
      options: of `numba.njit`.
    """
    options = {"nogil": True} | options

    def decorate(function: Callable[..., Any]) -> Any:
        """Return the function compiled at its first call; Numba reads the cache's folder from its configuration."""
        # No argument of Numba names the folder: it reads its configuration, once, while it decorates. What was there is
        # put back at once, so nothing of the process is changed for others.
        configured = config.CACHE_DIR
        with suppress(RuntimeError, OSError):
            config.CACHE_DIR = str(_folder(function.__module__, configured))
            try:
                return numba.njit(cache=True, **options)(function)
            finally:
                config.CACHE_DIR = configured
        # No folder can be written to (a read-only install without a home): each process compiles.
        return numba.njit(**options)(function)

    return decorate


def host_array(values: Any) -> np.ndarray:
    """Return values for compiled functions, read-only as those of JAX are: Numba compiles again for another kind."""
    array = np.ascontiguousarray(values).view()
    array.flags.writeable = False
    return array


@functools.cache
def _folder(module: str, chosen: str) -> Path:
    """Return a writable folder for the machine code of a module; it is made where it does not exist.

    It lies in ``chosen`` alone if that is given; else beside the module, or where that cannot be written to, in the
    user's cache.

    Args:
      module: name of an imported module.
      chosen: path of the folder that Numba's configuration names; empty without one.

    Raises:
      OSError: none of these folders can be written to.
    """
    beside = Path(sys.modules[module].__file__ or "").parent / "__pycache__"
    cache_home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    parents = [beside, Path(cache_home, "jaxurban", "numba")]
    if chosen:
        parents = [Path(chosen)]
    for parent in parents:
        with suppress(OSError):
            folder = parent / f"numba-{_digest(module)}"
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    raise OSError("no folder can be written to")


@functools.cache
def _digest(module: str) -> str:
    """Return a hash of the source of a module and of those of its package that it imports from."""
    source = Path(sys.modules[module].__file__ or "").read_text(encoding="utf-8")
    inner = re.findall(rf"^from ({module.partition('.')[0]}\.[\w.]+) import", source, re.MULTILINE)
    return hashlib.sha256("".join([source, *map(_digest, inner)]).encode()).hexdigest()[:16]


class _CompileNotice(event.Listener):
    """Says once that kernels of this package are compiled."""

    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"].py_func.__module__.startswith("jaxurban."):
            say_compiling()

    def on_end(self, event: Any) -> None: ...


# At import, as Numba tells of compiling only those who listen before it begins, and whatever compiles imports this
# module. Listening changes nothing of Numba; the log is told once (`say_compiling`).
event.register("numba:compile", _CompileNotice())
