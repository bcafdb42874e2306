"""Which form of a kernel runs: Numba's on the host, or JAX's wherever JAX computes."""

from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal

import jax
import numpy as np

Engine = Literal["auto", "numba", "jax"]


def chosen(engine: str, platform: str | None = None) -> str:
    """Return ``"numba"`` or ``"jax"``: for ``"auto"`` Numba where the platform, JAX's by default, is a CPU."""
    if engine != "auto":
        return engine
    return "numba" if (platform or _platform()) == "cpu" else "jax"


def runs_numba(engine: str, *values: Any) -> bool:
    """Return whether Numba's form runs on values: where it is chosen, and JAX traces none of them."""
    is_traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
    return not is_traced and chosen(engine) == "numba"


def on_device_of(engine: str) -> AbstractContextManager:
    """Return the context in which JAX computes what has no form in Numba: beside ``"numba"`` on the host."""
    if engine == "numba" and _platform() != "cpu":
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    return nullcontext()


def _platform() -> str:
    return next(iter(jax.device_put(np.float32(0)).devices())).platform
