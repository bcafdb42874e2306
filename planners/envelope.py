"""The cost of the planned path as a differentiable JAX function of the cost layers and the weights."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, typed
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.cost import visit_counts
from jaxurban.planners.host import call_on_host
from jaxurban.planners.registry import find_planner

CostFunction = Callable[[Float[Array, "L Y X"], Float[Array, " W"]], Float[Array, ""]]


@dataclass(frozen=True, eq=False)
class _Search:
    """A planner as JAX calls it: plain arrays in, plain arrays out."""

    problem: Problem
    planner: Callable[[Problem], Path]

    def __call__(self, costs, weights) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the path's cost, its features ``[W]``, and ``[Y, X]`` how often its cost counts each cell."""
        dtype = np.asarray(costs).dtype
        problem = self.problem.with_costs(np.asarray(costs, np.float64), np.asarray(weights, np.float64))
        found = self.planner(problem)
        counts = np.zeros(problem.is_free.shape, dtype)
        if not found.status.has_path:
            return np.array(np.inf, dtype), np.zeros(len(problem.weights), dtype), counts
        counts[:] = visit_counts(problem, found.points_m)
        features = problem.features(found.points_m)
        return np.array(features.cost(problem.weights), dtype), features.phi.astype(dtype), counts


@typed
def planned_cost(problem: Problem, planner: str | Callable[[Problem], Path] = "astar-plus") -> CostFunction:
    """Return the cost of the path that a planner finds, as a function of layers ``[L, Y, X]`` and weights ``[1 + L]``.

    Its gradient is that of the cost of the path found, the path held fixed: for each layer its weight times how often
    the path's cost counts each cell, and for the weights the path's features. **For an exact planner this is the
    gradient of the optimal cost** (the envelope theorem, Danskin 1967), wherever the optimal path is unique; where
    several paths tie, it is one element of the superdifferential. For any other planner it is the gradient of that
    path's cost, and no more. Multiplied on with the derivatives of the layers by thresholds or heights (soft maps),
    it gives the gradient with respect to them. Second derivatives are not defined. The cost is inf, and its gradient
    0, where no path is found.

    It runs under jit; the planner itself is called back on the host, one query after the other under vmap.

    Args:
      problem: the query on one altitude; its own layers and weights play no part.
      planner: its name, or a function such as `astar` with its options bound.

    Raises:
      InputError: an unknown planner; when called, layers or weights of other shapes.
    """
    if isinstance(planner, str):
        planner = partial(find_planner(planner), budget_s=np.inf, seed=0)
    search = _Search(problem, planner)

    def call(costs, weights):
        cell_shape = problem.is_free.shape
        if costs.shape[1:] != cell_shape or weights.shape != (1 + costs.shape[0],):
            raise InputError(
                f"costs must be [L, Y, X] over {cell_shape} cells and weights [1 + L], got shapes {costs.shape} and "
                f"{weights.shape}"
            )
        shapes = tuple(jax.ShapeDtypeStruct(shape, costs.dtype) for shape in ((), weights.shape, cell_shape))
        return call_on_host(search, shapes, costs, jnp.asarray(weights, costs.dtype))

    @jax.custom_vjp
    def cost(costs, weights):
        return call(costs, weights)[0]

    def forward(costs, weights):
        total, features, counts = call(costs, weights)
        return total, (features, counts, weights)

    def backward(kept, cotangent):
        features, counts, weights = kept
        by_layer = jnp.asarray(weights[1:], counts.dtype)[:, None, None] * counts
        return cotangent * by_layer, jnp.asarray(cotangent * features, weights.dtype)

    cost.defvjp(forward, backward)
    return cost
