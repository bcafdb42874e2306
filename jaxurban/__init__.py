"""jaxurban: urban metric maps for small drones, and planning on them.

On a CPU the heavy kernels are compiled by Numba; under ``jax.jit``, ``jax.vmap``, on export and on a GPU maps are JAX.
Gradients come from soft forms of the metrics.
"""

import ast as _ast
from importlib import import_module as _import_module
from pathlib import Path as _Path

# Names are fetched when they are first used: JAX, Numba and the readers take seconds to import, and the command
# line must react, to --help and to Ctrl-C, before that. The stub beside says to type checkers and here where each is.
_HOMES = {
    _name.name: _line.module
    for _line in _ast.parse(_Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(_line, _ast.ImportFrom)
    for _name in _line.names
}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
