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
        """Register the class with JAX, and return it."""
        static = [field.name for field in fields(cls) if field.name not in names]

        def flatten(settings: Any) -> tuple[tuple, tuple]:
            """Return the leaves, each beside its key, and the values of the static fields."""
            keys = map(jax.tree_util.GetAttrKey, names)
            leaves = tuple((key, getattr(settings, key.name)) for key in keys)
            return leaves, tuple(getattr(settings, name) for name in static)

        def unflatten(fixed: tuple, leaves: Iterable) -> Any:
            """Return the settings of static values and leaves, without ``__post_init__``."""
            settings: Any = object.__new__(cls)
            for name, value in zip((*names, *static), (*leaves, *fixed), strict=True):
                object.__setattr__(settings, name, value)
            return settings

        jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
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
    """Check that fields are finite numbers, or arrays of them, that keep a rule; values that JAX traces pass.

    Args:
      settings: the object with these fields.
      names: of the fields.
      what: the rule in words, for the message: "... must be WHAT".
      is_good: returns, of an array of numbers, which of them keep the rule.

    Raises:
      InputError: a field does not.
    """
    for name in names:
        _check_value(name, getattr(settings, name), what, is_good)


def _check_value(name: str, value: Any, what: str, is_good: Callable[[Any], Any]) -> None:
    """Raise InputError unless a value keeps a rule; ``name`` is that of the value, the rest as for `check_fields`."""
    if not is_known(value):
        return
    values = np.asarray(value)
    are_numbers = np.issubdtype(values.dtype, np.number)
    if not are_numbers or not np.all(np.isfinite(values) & is_good(values)):
        raise InputError(f"{name} must be {what}, got {value}")


def reach_of(value_m: Any, reach_m: float | None, name: str) -> float:
    """Return how far a metric looks, metres: a plain number, as it decides the shapes of arrays.

    Args:
      value_m: the parameter that says how far the metric must look, such as a lidar's range; maybe traced.
      reach_m: how far it is to look; None for ``value_m`` itself.
      name: of the parameter, for the message.

    Raises:
      InputError: ``value_m`` is traced and ``reach_m`` is missing, or ``reach_m`` is too short or no length.
    """
    reach: Any = value_m if reach_m is None else reach_m
    is_length = is_known(reach) and 0 < reach < math.inf
    if not is_length or (is_known(value_m) and value_m > reach):
        raise InputError(
            f"reach_m must be a number of metres, not traced by JAX, that {name} never exceeds, got {reach_m}"
        )
    return float(reach)


def check_softness(softness_m: Any) -> None:
    """Raise InputError unless a softness is 0 or more metres."""
    what = "0 (exact) or a positive number of metres such as 2"
    _check_value("softness_m", softness_m, what, is_not_negative)
