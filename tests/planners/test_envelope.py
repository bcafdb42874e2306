"""The planned cost's gradient agrees with finite differences of replanned costs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.planners.any_angle import ptp
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.planners.cost import CostModel
from jaxurban.planners.envelope import planned_cost

EXACT = partial(astar, heuristic="octile")


def make(cost_model="cell", seed=0, shape=(12, 15)):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) > 0.15
    is_free[0, 0] = is_free[-1, -1] = True
    layers = rng.random((2, *shape)) + 0.1
    return Problem(layers, is_free, (0, 0), (shape[0] - 1, shape[1] - 1), 5.0, 0.1, cost_model)


@pytest.mark.slow
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_gradient_of_the_optimal_cost_is_that_of_replanned_costs(cost_model):
    problem = make(cost_model)
    with jax.enable_x64(True):
        cost = planned_cost(problem, EXACT)
        layers, w = jnp.asarray(problem.costs), jnp.array([0.1, 1.0, 1.0])
        value, (by_layers, by_weights) = jax.value_and_grad(cost, (0, 1))(layers, w)
        assert value == EXACT(problem).cost
        rng = np.random.default_rng(1)
        for direction, weighting in zip(
            rng.normal(size=(3, *layers.shape)), np.eye(3), strict=True
        ):
            step, change = 1e-6 * direction, 1e-6 * weighting
            slope = (cost(layers + step, w) - cost(layers - step, w)) / 2e-6
            np.testing.assert_allclose(jnp.vdot(by_layers, direction), slope, rtol=1e-6)
            slope = (cost(layers, w + change) - cost(layers, w - change)) / 2e-6
            np.testing.assert_allclose(jnp.vdot(by_weights, weighting), slope, rtol=1e-6)


def test_weights_and_maps_meet_in_one_gradient_under_jit():
    problem = make("line")

    with jax.enable_x64(True):
        cost = planned_cost(problem, EXACT)
        layers = jnp.asarray(problem.costs)

        @jax.jit
        def of_weights(weights):
            return cost(layers, weights)

        weights = jnp.array([0.2, 1.0, 0.5])
        by_weights = jax.grad(of_weights)(weights)
        # The optimal cost is homogeneous in the weights (Euler).
        np.testing.assert_allclose(jnp.vdot(by_weights, weights), of_weights(weights), rtol=1e-12)
        several = jax.vmap(of_weights)(jnp.stack([weights, 2 * weights]))
        np.testing.assert_allclose(several[1], 2 * several[0], rtol=1e-12)


def test_another_planners_gradient_is_that_of_its_own_path():
    problem = Problem(
        np.ones((1, 4, 9)), np.ones((4, 9), bool), (0, 0), (3, 8), 1.0, 1.0, CostModel("line", 1.0)
    )
    cost = planned_cost(problem, ptp)
    by_layer = jax.grad(cost)(jnp.ones((1, 4, 9)), jnp.ones(2, jnp.float32))
    np.testing.assert_allclose(by_layer.sum(), np.hypot(3, 8), rtol=1e-6)


def test_without_a_path_the_cost_is_infinite_and_its_gradient_zero():
    is_free = np.ones((3, 5), bool)
    is_free[:, 2] = False
    problem = Problem(np.zeros((1, 3, 5)), is_free, (0, 0), (0, 4), 1.0, 1.0)
    value, by_layer = jax.value_and_grad(planned_cost(problem, EXACT))(
        jnp.ones((1, 3, 5)), jnp.ones(2, jnp.float32)
    )
    assert value == np.inf
    assert not by_layer.any()


def test_a_large_program_of_doubles_loses_no_digit_on_its_way_to_the_planner():
    # Programs of some size run in threads of their own, which do not know of enable_x64.
    problem = make("line", shape=(150, 160))
    with jax.enable_x64(True):
        cost = planned_cost(problem, EXACT)
        grown = jax.jit(
            jax.value_and_grad(lambda layers: cost(jnp.sin(layers) + 1, jnp.array([0.1, 1.0, 1.0])))
        )
        value, slope = grown(jnp.asarray(problem.costs))
    assert (value.dtype, slope.dtype) == (np.float64, np.float64)
    np.testing.assert_allclose(
        value, EXACT(problem.with_costs(np.sin(problem.costs) + 1, 0.1)).cost, rtol=1e-13
    )
