"""Settings of metrics as JAX sees them, some of them values to differentiate by; and how they are checked."""

import math
from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, TypeVar

import jax
import numpy as np

from jaxurban.errors import InputError

Settings = TypeVar("Settings", bound=type)


def differentiable(*names: str) -> Callable[[Settings], Settings]:
    """Return a decorator that makes a frozen dataclass a pytree whose leaves are the named fields.

    The other fields are static: a function under `jax.jit` is compiled again for each of their values. What JAX builds
    itself (traced values, gradients) does not go through ``__post_init__``, which checks what users give: a gradient
    of a threshold may well be negative.
    """

    def register(cls: Settings) -> Settings:
        """Make settings a tree of JAX: the named fields are its leaves, all others are fixed."""
        static = [field.name for field in fields(cls) if field.name not in names]

        def flatten(settings: Any) -> tuple[tuple, tuple]:
            leaves = tuple(getattr(settings, name) for name in names)
            fixed = tuple(getattr(settings, name) for name in static)
            return leaves, fixed

        def flatten_with_keys(settings: Any) -> tuple[tuple, tuple]:
            leaves, fixed = flatten(settings)
            keys = map(jax.tree_util.GetAttrKey, names)
            return tuple(zip(keys, leaves, strict=True)), fixed

        def unflatten(fixed: tuple, leaves: Iterable) -> Any:
            settings: Any = object.__new__(cls)
            for name, value in zip((*names, *static), (*leaves, *fixed), strict=True):
                object.__setattr__(settings, name, value)
            return settings

        jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
        return cls

    return register


def is_known(value: Any) -> bool:
    """Return whether a value can be read now, which those that JAX is tracing cannot."""
    return not isinstance(value, jax.core.Tracer)


def is_positive(values: Any) -> Any:
    """Return whether numbers are above 0."""
    return values > 0


def is_not_negative(values: Any) -> Any:
    """Return whether numbers are 0 or more."""
    return values >= 0


def check_fields(
    settings: Any, names: Iterable[str], what: str, is_good: Callable[[Any], Any]
) -> None:
    """Raise InputError unless fields are finite and good numbers or arrays; those that JAX is tracing are.

    Args:
      settings: that have these fields.
      names: of the fields.
      what: each must be, for the message.
      is_good: whether each of an array of numbers is.
    """
    for name in names:
        _check_value(name, getattr(settings, name), what, is_good)


def _check_value(name: str, value: Any, what: str, is_good: Callable[[Any], Any]) -> None:
    if not is_known(value):
        return
    values = np.asarray(value)
    are_numbers = np.issubdtype(values.dtype, np.number)
    if not are_numbers or not np.all(np.isfinite(values) & is_good(values)):
        raise InputError(f"{name} must be {what}, got {value}")


def reach_of(value_m: Any, reach_m: float | None, name: str) -> float:
    """Return how far to look, metres.

    Args:
      value_m: the parameter that says how far is needed, maybe traced.
      reach_m: what the caller gives; None for ``value_m``.
      name: of the parameter, for the message.

    Raises:
      InputError: ``value_m`` is traced and ``reach_m`` is missing, or ``reach_m`` is too short or no length.
    """
    if reach_m is None:
        if not is_known(value_m):
            raise InputError(
                f"{name} is traced by JAX: give reach_m, a number of metres it never exceeds"
            )
        return float(value_m)
    if not (is_known(reach_m) and math.isfinite(reach_m) and reach_m > 0):
        raise InputError(
            f"reach_m must be a positive number of metres, not traced by JAX, got {reach_m}"
        )
    if is_known(value_m) and float(value_m) > reach_m:
        raise InputError(f"reach_m must be at least {name}, {float(value_m):g} m, got {reach_m:g}")
    return float(reach_m)


def check_softness(softness_m: Any) -> None:
    """Raise InputError unless a softness is 0 or more metres."""
    what = "0 (exact) or a positive number of metres such as 2"
    _check_value("softness_m", softness_m, what, is_not_negative)
