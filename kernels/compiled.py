"""Functions compiled by Numba, kept on disk until anything that they are made of changes."""

import functools
import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import CodeType
from typing import Any

import numpy as np
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys

from jaxurban.progress import LOG

COMPILING = LOG.getChild("compiling")  # its level is the switch: warnings are seen where nobody has set logging up


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator: `numba.njit` with these options, and a cache on disk that knows of inner functions.

    Numba's own ``cache=True`` compiles anew when the file of the outer function changes, but goes on with the old
    machine code when a compiled function that it calls, or a constant that it reads, changes in another file. Here
    both are part of the key, so that compiled functions can be shared between files.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(**options)(function)
        with suppress(RuntimeError):  # a read-only install without a home: nothing is kept, each process compiles
            dispatcher._cache = _Cache(function)  # as ``cache=True`` does, with its `FunctionCache`
        return dispatcher

    return decorate


class _KeptFiles(IndexDataCacheFile):
    """Numba's files of a function's machine code: nothing is in those that are damaged or name types that are gone.

    What unpickling raises at damaged bytes is in no list, a `MemoryError` among it.
    """

    def _load_index(self):
        try:
            return super()._load_index()
        except Exception:
            return {}

    def _load_data(self, name):
        try:
            return super()._load_data(name)
        except Exception as error:
            raise OSError(name) from error  # which Numba takes as a file that is gone


class _Cache(FunctionCache):
    """Machine code by signature, processor, and the code of a function and of all compiled ones that it reaches."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        kept = self._cache_file
        self._cache_file = _KeptFiles(self._cache_path, self._impl.filename_base, kept._source_stamp)

    def load_overload(self, sig, target_context):
        """Return the machine code kept for a signature; None where there is none.

        As Numba's own, which first registers all that it can compile, and imports SciPy for it. What is compiled
        needs only the runtime that it calls, and compiling registers all of that by itself: 0.3 s less in a process
        that finds everything in the cache.
        """
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            kept = self._load_overload(sig, target_context)
        if kept is None:
            _say_once()
        return kept

    def _index_key(self, sig, codegen):
        digest = hashlib.sha256()
        for part in _parts(self._py_func, set()):
            digest.update(part.encode())
        return *super()._index_key(sig, codegen), digest.hexdigest()


@functools.cache
def _say_once() -> None:
    COMPILING.warning("compiling what is run here for the first time, for some seconds; later sessions find it done")


def _parts(function: Callable[..., Any], seen: set[Callable[..., Any]]) -> Iterator[str]:
    """Yield what a function is made of: its code, the values of the global names in it, and the same of inner ones.

    A value that no text stands for, as a function that is not compiled, has its address in it: it is never found again
    in the cache, and so compiled anew, which is slow but right.
    """
    seen.add(function)
    for code in _codes(function.__code__):
        yield repr((code.co_code, code.co_names, code.co_varnames))
        yield repr([const for const in code.co_consts if not isinstance(const, CodeType)])
        for name in code.co_names:
            value = function.__globals__.get(name)
            if not isinstance(value, Dispatcher):
                yield repr(value.tolist() if isinstance(value, np.ndarray) else value)
            elif value.py_func not in seen:
                yield repr(value.targetoptions)
                yield from _parts(value.py_func, seen)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a function's code and that of what is defined inside it, as comprehensions."""
    yield code
    for const in code.co_consts:
        if isinstance(const, CodeType):
            yield from _codes(const)
