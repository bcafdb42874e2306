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

from jaxurban.kept_folders import cache_home, closed_folder, or_compile, refuse_unsafe, sweep_unused
from jaxurban.programs import say_compiling

config: Any = numba.config
# The access control list u::rwx,g::---,o::--- as Linux takes it: the version, then tag, permissions and id of each
# entry (linux/posix_acl_xattr.h). A folder's default holds in the place of the umask for what is made in it (acl(5)).
ONLY_OURS = b"\2\0\0\0\1\0\7\0\xff\xff\xff\xff\4\0\0\0\xff\xff\xff\xff\x20\0\0\0\xff\xff\xff\xff"


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
        """Return the function, compiled or loaded at its first call."""
        kept = None
        with or_compile():
            kept = _kept(function, options)
        return kept or numba.njit(**options)(function)

    return decorate


def host_array(values: Any) -> np.ndarray:
    """Return values for compiled functions, read-only as those of JAX are: Numba compiles again for another kind."""
    array = np.ascontiguousarray(values).view()
    array.flags.writeable = False
    return array


def _kept(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return a function that Numba compiles at its first call and keeps, or loads then.

    Raises:
      OSError, RuntimeError: no folder can be used: a read-only install without a home, or others may write to it.
    """
    # No argument of Numba names the folder: it reads its configuration, once, while it decorates. What was there is
    # put back at once, so nothing of the process is changed for others.
    chosen = config.CACHE_DIR
    folder = _folder(function.__module__, chosen)
    config.CACHE_DIR = str(folder)
    try:
        kept: Any = numba.njit(cache=True, **options)(function)
    finally:
        config.CACHE_DIR = chosen
    if folder not in Path(kept.stats.cache_path).parents:
        raise OSError("Numba cannot write to the folder and has taken another one")
    return kept


def _folder(module: str, chosen: str) -> Path:
    """Return a folder for the machine code of a module; it is made where it does not exist.

    It lies in ``chosen`` alone if that is given; else beside the module, or where that cannot be used, in the user's
    cache.

    Args:
      module: name of an imported module.
      chosen: path of the folder that Numba's configuration names, which is not looked at; empty without one.

    Raises:
      OSError, RuntimeError: none of these folders can be used.
    """
    name = f"numba-{_digest(module)}"
    if chosen:
        folder = Path(chosen, name)
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    package = Path(sys.modules[module].__file__ or "").parent
    with suppress(OSError):
        return _looked_at(package / "__pycache__", 1, name)
    return _looked_at(cache_home() / "jaxurban" / "numba", 2, name)


def _looked_at(above: Path, num_own: int, name: str) -> Path:
    """Return a folder for machine code that nobody else can change, and in which Numba finds nothing of anybody else.

    Numba opens its files by their names, at the first call. From here on nobody but this user and root can write to the
    folder or exchange it (`closed_folder`), so that what is looked at here is what Numba reads then. Where it is empty,
    unused folders beside it are swept.

    Args:
      above, num_own: the folder that it lies in, as `closed_folder` takes it, which errors on what it holds name.
      name: of the folder.

    Raises:
      PermissionError: another user could have written the folder or something in it, or this one may not write.
      OSError: it cannot be made for another reason.
    """
    folder = closed_folder(above / name, num_own + 1)
    kept = [*folder.rglob("*")]
    for place in kept:
        refuse_unsafe(above, place.lstat())
    # Numba writes by the umask, which may let others in: they do not get into a folder that is closed while empty, and
    # in one with such a list, if the disk knows lists, what it writes is closed too.
    if not kept:
        folder.chmod(0o700)
        sweep_unused(above)
    with suppress(AttributeError, OSError):
        os.setxattr(folder, "system.posix_acl_default", ONLY_OURS)
    return folder


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
