"""Weights and cost maps."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import Weights


def test_population_is_its_own_cost_and_the_others_are_one_minus_m():
    m = jnp.array([0.0, 0.25, 1.0])
    np.testing.assert_array_equal(METRICS["population"].cost(m), m)
    for name in ("gps", "lidar", "risk"):
        np.testing.assert_array_equal(METRICS[name].cost(m), 1 - m)


def test_weights_are_parsed_over_a_base():
    weights = Weights.parse("gps=2, risk=0", Weights(lidar=7.0))
    assert weights == Weights(gps=2.0, lidar=7.0, risk=0.0)


def test_weights_carry_any_name_and_a_name_that_is_left_out_weighs_one():
    weights = Weights.parse("noise=2,gps=3")
    assert (weights["noise"], weights["gps"], weights["crowd"]) == (2.0, 3.0, 1.0)
    assert weights == Weights(gps=3.0, noise=2.0) == Weights.of({"noise": 2.0, "gps": 3.0})
    assert hash(weights) == hash(Weights(gps=3.0, noise=2.0))
    assert weights.replace(noise=5.0).to_dict() == {**Weights(gps=3.0).to_dict(), "noise": 5.0}
    assert weights.checked(["noise"]) == weights
    gradient = jax.grad(lambda w: w["noise"] ** 2 + w.gps)(weights)
    assert (gradient["noise"], gradient.gps, gradient.risk) == (4.0, 1.0, 0.0)
