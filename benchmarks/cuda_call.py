"""How `cuda_kernels` says what to compile: a kernel's call, of arrays or of their shapes and types."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp


@dataclass(frozen=True)
class Call:
    """What to compile.

    Attributes:
      function: made by `jax.jit`.
      arguments: arrays, or their shapes and types (`jax.ShapeDtypeStruct`).
      static: arguments by name that the program is compiled for.
      is_float64: it runs under ``jax.enable_x64(True)``.
    """

    function: Any
    arguments: tuple
    static: dict[str, Any] = field(default_factory=dict)
    is_float64: bool = False


def array(*shape: int, dtype: Any = jnp.float32) -> jax.ShapeDtypeStruct:
    """Return the shape and type of an array."""
    return jax.ShapeDtypeStruct(shape, dtype)


def float64(*shape: int) -> jax.ShapeDtypeStruct:
    return array(*shape, dtype=jnp.float64)


def int32(*shape: int) -> jax.ShapeDtypeStruct:
    return array(*shape, dtype=jnp.int32)


def gradient(of: Callable, by: int | tuple[int, ...] = 0) -> Any:
    """Return the compiled value and gradient of a function's sum."""
    return jax.jit(jax.value_and_grad(lambda *arguments: jnp.sum(of(*arguments)), by))
