"""The cost of the planned path as a differentiable JAX function of the cost layers and the distance weight."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.evaluate import charge_map, evaluate_on
from jaxurban.planners.host import call_on_host

CostFunction = Callable[[Float[Array, "L Y X"], Float[Array, ""]], Float[Array, ""]]


@dataclass(frozen=True, eq=False)
class _Search:
    """A planner as JAX calls it: plain arrays in, plain arrays out."""

    problem: Problem
    planner: Callable[[Problem], Path]

    def __call__(self, layers, distance_weight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the path's cost, its length, and ``[Y, X]`` how often each cell is charged."""
        dtype = np.asarray(layers).dtype
        problem = self.problem.with_layers(np.asarray(layers, np.float64), float(distance_weight))
        found = self.planner(problem)
        charges = np.zeros(problem.is_free.shape, dtype)
        if not found.status.has_path:
            return np.array(np.inf, dtype), np.array(0, dtype), charges
        charges[:] = charge_map(problem, found.points_m)
        paid = evaluate_on(problem, found.points_m)
        return np.array(paid.total, dtype), np.array(paid.length_m, dtype), charges


def planned_cost(problem: Problem, planner: Callable[[Problem], Path]) -> CostFunction:
    """Return a function of cost layers ``[L, Y, X]`` and distance weight: the cost of the path that a planner finds.

    Its gradient is that of the cost of the path found, the path held fixed: for each layer how often the path is
    charged each cell, and for the distance weight its length. **For an exact planner this is the gradient of the
    optimal cost** (the envelope theorem, Danskin 1967), wherever the optimal path is unique; where several paths
    tie, it is one element of the superdifferential. For any other planner it is the gradient of that path's
    cost, and no more. Multiplied on with the derivatives of the layers by weights, thresholds or heights (soft maps),
    it gives the gradient with respect to them. Second derivatives are not defined. The cost is inf, and its
    gradient 0, where no path is found.

    It runs under jit; the planner itself is called back on the host, one query after the other under vmap.

    Args:
      problem: the question; its own layers and distance weight play no part.
      planner: such as `astar`, with its options bound.
    """
    search = _Search(problem, planner)

    def call(layers, distance_weight):
        cell_shape = problem.is_free.shape
        if layers.shape[1:] != cell_shape:
            raise InputError(f"layers must be [L, Y, X] over {cell_shape} cells, got shape {layers.shape}")
        shapes = tuple(jax.ShapeDtypeStruct(shape, layers.dtype) for shape in ((), (), cell_shape))
        return call_on_host(search, shapes, layers, jnp.asarray(distance_weight))

    @jax.custom_vjp
    def cost(layers, distance_weight):
        return call(layers, distance_weight)[0]

    def forward(layers, distance_weight):
        total, length_m, charges = call(layers, distance_weight)
        return total, (length_m, charges, jnp.zeros(layers.shape[0], layers.dtype))

    def backward(kept, cotangent):
        length_m, charges, per_layer = kept
        return cotangent * (charges + per_layer[:, None, None]), cotangent * length_m

    cost.defvjp(forward, backward)
    return cost
