"""Edges of BIT* costed many at once in JAX, and which backend costs them."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.errors import InputError, nearest_name
from jaxurban.kernels.segment_costs import segment_costs
from jaxurban.planners.bitstar_search import Ground

BACKENDS = ("numba", "jax", "auto")
BULK = 1024  # edges costed in one call; fewer are filled up, so that one map compiles once


def chosen_backend(name: str) -> str:
    """Return ``"numba"`` or ``"jax"``: the name itself, or what ``"auto"`` picks on this machine.

    ``auto`` picks numba where JAX runs on a CPU: there the compiled search, which costs each edge as it
    comes up, was several times faster (docs/benchmarks.md).

    Raises:
      InputError: an unknown name.
    """
    if name not in BACKENDS:
        raise InputError(f"unknown backend {name!r}{nearest_name(name, BACKENDS)}: choose one of {', '.join(BACKENDS)}")
    if name != "auto":
        return name
    return "numba" if jax.default_backend() == "cpu" else "jax"


class BulkCosts:
    """What edges cost over one map, in float64; the map stays on JAX's device."""

    def __init__(self, ground: Ground) -> None:
        self._per_side, self._is_line, self._passes_corners = ground.per_side, ground.is_line, ground.passes_corners
        with jax.enable_x64(True):
            self._charge = jnp.asarray(ground.charge)
        self(np.full((1, 2), 0.5), np.full((1, 2), 0.5))  # compiles

    def __call__(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return ``[E]`` the cost of edges between points ``[E, 2]``, ``E <= BULK`` (see `segment_costs`)."""
        padded = np.full((2, BULK, 2), 0.5)
        padded[0, : len(start)], padded[1, : len(end)] = start, end
        with jax.enable_x64(True):
            costs = segment_costs(
                self._charge, padded[0], padded[1], self._per_side, self._is_line, self._passes_corners
            )
        return np.asarray(costs)[: len(start)]
