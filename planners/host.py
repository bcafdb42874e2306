"""A function on the host, called from a JAX program without loss of digits."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax


def call_on_host(
    function: Callable[..., Sequence[np.ndarray]], shapes: Sequence[jax.ShapeDtypeStruct], *arrays: jax.Array
) -> tuple[jax.Array, ...]:
    """Return what a host function makes of float arrays; it gets and gives NumPy arrays of the types given.

    `jax.pure_callback` may run it in a thread that does not know of ``jax.enable_x64(True)``, where arguments and
    results would be rounded to float32 (JAX 0.8: the larger programs of a CPU). They travel as their bits, which nobody
    rounds. One query after the other under vmap.

    Args:
      function: pure, of NumPy arrays; gives one array for each of ``shapes``.
      shapes: of the results, float32 or float64.
      arrays: arguments, float32 or float64.
    """
    given = [np.dtype(jnp.result_type(array)) for array in arrays]

    def on_words(*words):
        found = function(*(_from_words(np.asarray(word), dtype) for word, dtype in zip(words, given, strict=True)))
        return tuple(_to_words(np.asarray(value, s.dtype)) for value, s in zip(found, shapes, strict=True))

    out = tuple(jax.eval_shape(_bits, shape) for shape in shapes)
    words = jax.pure_callback(on_words, out, *map(_bits, arrays), vmap_method="sequential")
    return tuple(lax.bitcast_convert_type(word, shape.dtype) for word, shape in zip(words, shapes, strict=True))


def _bits(values: jax.Array) -> jax.Array:
    return lax.bitcast_convert_type(values, jnp.uint32)  # float64: a last axis of two words


def _from_words(words: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Return the numbers as words of 32 bits, the low one first."""
    values = np.asarray(words, order="C").view(dtype)
    return values[..., 0] if dtype.itemsize == 8 else values


def _to_words(values: np.ndarray) -> np.ndarray:
    words = np.ascontiguousarray(values).reshape(*values.shape, 1).view(np.uint32)
    return words if values.dtype.itemsize == 8 else words[..., 0]
