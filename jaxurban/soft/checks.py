"""What is checked of a soft metric's settings at the call, as far as JAX is not tracing them."""

import math
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.metrics.settings import holds, is_known


def reach_of(value_m: Any, reach_m: float | None, name: str) -> float:
    """Return how far to look, metres.

    Args:
      value_m: the parameter that says how far is needed, maybe traced.
      reach_m: what the caller asks for; None for ``value_m``.
      name: of the parameter, for the message.

    Raises:
      InputError: ``value_m`` is traced and ``reach_m`` is missing, or ``reach_m`` is too short or no length.
    """
    if reach_m is None:
        if not is_known(value_m):
            raise InputError(f"{name} is traced by JAX: give reach_m, a number of metres it never exceeds")
        return float(value_m)
    if not (is_known(reach_m) and math.isfinite(reach_m) and reach_m > 0):
        raise InputError(f"reach_m must be a positive number of metres, not traced by JAX, got {reach_m}")
    if is_known(value_m) and float(value_m) > reach_m:
        raise InputError(f"reach_m must be at least {name}, {float(value_m):g} m, got {reach_m:g}")
    return float(reach_m)


def check_softness(softness_m: Any) -> None:
    """Raise InputError unless a softness is 0 or more metres."""
    if not holds(softness_m, lambda softness: np.isfinite(softness) & (softness >= 0)):
        raise InputError(f"softness_m must be 0 (exact) or a positive number of metres such as 2, got {softness_m}")
