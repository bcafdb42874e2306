"""Pictures of metric maps and paths, as matplotlib Figures (in a notebook: ``%matplotlib inline`` shows them)."""

from functools import cache
from typing import Any

from jaxurban.checks import typed
from jaxurban.public import public_names

_fetch, __dir__, __all__ = public_names(__name__, __file__)


@cache
def __getattr__(name: str) -> Any:
    """Return a function of the stub, which checks the kinds of its arguments; errors as of a module."""
    return typed(_fetch(name))
