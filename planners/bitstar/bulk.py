"""Edges of BIT* costed many at once in JAX, and which backend costs them."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.line.segment_costs import segment_costs
from jaxurban.planners.checks import check_name

BACKENDS = ("numba", "jax", "auto")
BULK = 1024  # edges costed in one call; fewer are filled up, so that one map compiles once


def chosen_backend(name: str) -> str:
    """Return ``"numba"`` or ``"jax"``: the name itself, or what ``"auto"`` picks on this machine.

    ``auto`` picks numba where JAX runs on a CPU: there the compiled search, which costs each edge as it
    comes up, was several times faster (docs/benchmarks.md).

    Raises:
      InputError: an unknown name.
    """
    check_name("backend", name, BACKENDS)
    if name != "auto":
        return name
    return "numba" if jax.default_backend() == "cpu" else "jax"


class BulkCosts:
    """What edges cost over one map, in float64; the map stays on JAX's device."""

    def __init__(self, cost_grid: CostGrid) -> None:
        self._per_side, self._is_line, self._passes_corners = (
            cost_grid.per_side,
            cost_grid.is_line,
            cost_grid.passes_corners,
        )
        with jax.enable_x64(True):
            self._cell_cost = jnp.asarray(cost_grid.cell_cost)
        self(np.full((1, 2), 0.5), np.full((1, 2), 0.5))  # compiles

    def __call__(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return ``[E]`` the cost of edges between points ``[E, 2]``, ``E <= BULK`` (see `segment_costs`)."""
        padded = np.full((2, BULK, 2), 0.5)
        padded[0, : len(start)], padded[1, : len(end)] = start, end
        with jax.enable_x64(True):
            costs = segment_costs(
                self._cell_cost, padded[0], padded[1], self._per_side, self._is_line, self._passes_corners
            )
        return np.asarray(costs)[: len(start)]
