"""Whether values lie where the kernels for a CPU read them, and how those want them."""

import jax
import numpy as np
from jaxtyping import Array


def is_on_host(values: Array | np.ndarray, *others: Array | np.ndarray) -> bool:
    """Return whether none is traced and the values lie, or JAX would put them, in the memory of a CPU."""
    if any(isinstance(array, jax.core.Tracer) for array in (values, *others)):
        return False
    held = values if isinstance(values, jax.Array) else jax.device_put(np.float32(0))
    return all(device.platform == "cpu" for device in held.devices())


def on_host(values: Array | np.ndarray) -> np.ndarray:
    """Return values for Numba, read-only as those of JAX are: it compiles anew for another kind."""
    array = np.ascontiguousarray(values).view()
    array.flags.writeable = False
    return array
