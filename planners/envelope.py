"""The cost of the planned path as a differentiable JAX function of the cost layers and the weights."""

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.registry import find_planner

CostFunction = Callable[
    [Float[Array | np.ndarray, "L Y X"], Float[Array | np.ndarray, " W"]], Float[Array, ""]
]


@typed
def planned_cost(
    problem: Problem, planner: str | Callable[[Problem], Path] = "astar"
) -> CostFunction:
    """Return the cost of the path that a planner finds, as a function that JAX can differentiate.

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

    Returns:
      A function of layers ``[L, Y, X]`` and weights ``[1 + L]``, which gives the cost as a scalar JAX array.

    Raises:
      InputError: an unknown planner; when called, layers or weights of other shapes.

    Examples:
      >>> import jax
      >>> on = ju.cost_map(maps, 60.0)
      >>> cost = ju.grad.planned_cost(on.problem.between((2, 2), (27, 27)))
      >>> [round(float(each)) for each in jax.grad(cost, argnums=1)(on.costs, on.weight_vector)]
      [848, 20, 166, 12, 0]
    """
    if isinstance(planner, str):
        planner = partial(find_planner(planner), budget_s=np.inf, seed=0)

    def search(costs, weights):
        """Plan on the host: return the cost, the features ``[W]``, and ``[Y, X]`` how often the cost counts each cell.

        Without a path these are inf, zeros and zeros.
        """
        query = problem.with_costs(np.asarray(costs, np.float64), np.asarray(weights, np.float64))
        path = planner(query)
        if not path.status.has_path:
            return np.inf, np.zeros(len(query.weights)), np.zeros(query.is_free.shape)
        features = query.features(path.points_m)
        return features.cost(query.weights), features.phi, features.visits

    def call(costs, weights):
        """Return what `search` does, as JAX arrays in the type of the costs."""
        cell_shape = problem.is_free.shape
        if costs.shape[1:] != cell_shape or weights.shape != (1 + costs.shape[0],):
            raise InputError(
                f"costs must be [L, Y, X] over {cell_shape} cells and weights [1 + L], got shapes {costs.shape} and "
                f"{weights.shape}"
            )
        shapes = tuple(
            jax.ShapeDtypeStruct(shape, costs.dtype) for shape in ((), weights.shape, cell_shape)
        )
        return call_on_host(search, shapes, costs, jnp.asarray(weights, costs.dtype))

    @jax.custom_vjp
    def cost(costs, weights):
        """Return the cost of the planned path."""
        return call(costs, weights)[0]

    def forward(costs, weights):
        """Return the cost, and what its gradient needs."""
        total, features, counts = call(costs, weights)
        return total, (features, counts, weights)

    def backward(kept, cotangent):
        """Return the gradients: by layers, weights times counts; by weights, the features."""
        features, counts, weights = kept
        by_layer = jnp.asarray(weights[1:], counts.dtype)[:, None, None] * counts
        return cotangent * by_layer, jnp.asarray(cotangent * features, weights.dtype)

    cost.defvjp(forward, backward)
    return cost


def call_on_host(
    function: Callable[..., Sequence[np.ndarray]],
    shapes: Sequence[jax.ShapeDtypeStruct],
    *arrays: Array,
) -> tuple[Array, ...]:
    """Return the results of a host function of float arrays, called from JAX.

    `jax.pure_callback` may run it in a thread that does not know of ``jax.enable_x64(True)``, where arguments and
    results would be rounded to float32 (JAX 0.8: the larger programs of a CPU). So they are passed as their bits, which
    are not rounded. Under vmap the function is called for one item after the other.

    Args:
      function: pure; takes NumPy arrays of the types of ``arrays``, and returns one array for each of ``shapes``.
      shapes: shapes and types of the results, float32 or float64.
      arrays: the function's arguments, float32 or float64.
    """
    given = [jax.ShapeDtypeStruct(array.shape, jnp.result_type(array)) for array in arrays]
    out = tuple(jax.eval_shape(_bits, shape) for shape in shapes)

    def on_words(*words):
        """Call the function with the numbers that words of 32 bits stand for, and return its results as words."""
        results = zip(function(*map(_viewed, words, given)), shapes, out, strict=True)
        return tuple(
            _viewed(np.asarray(value, shape.dtype), word) for value, shape, word in results
        )

    words = jax.pure_callback(on_words, out, *map(_bits, arrays), vmap_method="sequential")
    return tuple(
        lax.bitcast_convert_type(word, shape.dtype)
        for word, shape in zip(words, shapes, strict=True)
    )


def _bits(values: Array) -> Array:
    # float64: a last axis of two words, the low one first.
    return lax.bitcast_convert_type(values, jnp.uint32)


def _viewed(values: np.ndarray, like: jax.ShapeDtypeStruct) -> np.ndarray:
    """Return the same bits as values of another type and shape."""
    return np.asarray(values).reshape(-1).view(like.dtype).reshape(like.shape)
