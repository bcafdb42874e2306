"""Settings of metrics as JAX sees them: some fields are values to differentiate by, the others are fixed."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, TypeVar

import jax
import numpy as np

Settings = TypeVar("Settings", bound=type)


def differentiable(*names: str) -> Callable[[Settings], Settings]:
    """Return a decorator that makes a frozen dataclass a pytree whose leaves are the named fields.

    The other fields are static: a function under `jax.jit` is compiled anew for each of their values. What JAX builds
    itself (traced values, gradients) does not go through ``__post_init__``, which checks what users give: a gradient
    of a threshold may well be negative.
    """

    def register(cls: Settings) -> Settings:
        static = [field.name for field in fields(cls) if field.name not in names]

        def flatten(settings: Any) -> tuple[tuple, tuple]:
            return tuple(getattr(settings, name) for name in names), tuple(getattr(settings, name) for name in static)

        def flatten_with_keys(settings: Any) -> tuple[tuple, tuple]:
            leaves, fixed = flatten(settings)
            return tuple(zip(map(jax.tree_util.GetAttrKey, names), leaves, strict=True)), fixed

        def unflatten(fixed: tuple, leaves: Iterable) -> Any:
            settings: Any = object.__new__(cls)
            for name, value in zip((*names, *static), (*leaves, *fixed), strict=True):
                object.__setattr__(settings, name, value)
            return settings

        jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
        return cls

    return register


def is_known(value: Any) -> bool:
    """Return whether a value can be looked at now, which those that JAX is tracing cannot."""
    return not isinstance(value, jax.core.Tracer)


def holds(value: Any, is_good: Callable[[Any], Any]) -> bool:
    """Return whether a number, or each of an array, is good; True for those that JAX is tracing."""
    return not is_known(value) or bool(np.all(is_good(np.asarray(value))))
