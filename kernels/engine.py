"""Which form of a kernel runs, JAX's, or Numba's where that stays beside it, being quicker; and on how many cores."""

import os
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal

import jax
import numpy as np

from jaxurban.errors import warn

Engine = Literal["auto", "numba", "jax"]
ONLY_JAX = (
    "engine = 'numba' makes lidar maps over terrain and the shadows of slabs; all else has no form in Numba any more, "
    "and JAX makes it on the host"
)


def uses_numba(engine: str) -> bool:
    """Return whether a kernel that has a form in Numba runs it; for ``"auto"`` where JAX's platform is a CPU."""
    return engine == "numba" or (engine == "auto" and _platform() == "cpu")


def runs_numba(engine: str, *values: Any) -> bool:
    """Return whether Numba's form runs on values: where it is chosen, and JAX traces none of them."""
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
    return not is_traced and uses_numba(engine)


def num_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn_of_jax(engine: str) -> None:
    """Warn, where maps are made and Numba is asked for, of what JAX makes all the same."""
    if engine == "numba":
        warn(ONLY_JAX)


def on_host() -> AbstractContextManager:
    """Return the context in which JAX computes on the host, whatever devices there are."""
    if _platform() == "cpu":
        return nullcontext()
    return jax.default_device(jax.local_devices(backend="cpu")[0])


def _platform() -> str:
    return next(iter(jax.device_put(np.float32(0)).devices())).platform
