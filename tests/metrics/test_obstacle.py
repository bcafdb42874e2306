"""Obstacle cells, exact and soft."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.world.surface import obstacle_mask, soft_obstacle
from tests.metrics.soft.scene import check_gradient

ROOF_M = jnp.array([0.0, 5.0, 17.9, 18.0, 18.5, 19.0, 19.9, 20.0, 21.0, 300.0])


def test_a_cell_is_an_obstacle_up_to_its_roof_and_free_above_and_bare_ground_is_free_even_at_altitude_zero():
    roof_m, z_m = np.array([[0.0, 19.9, 20.0, 60.0, 60.1]], np.float32), np.array([0.0, 20.0, 60.0, 122.0])
    expected = [[0, 1, 1, 1, 1], [0, 0, 1, 1, 1], [0, 0, 0, 1, 1], [0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(obstacle_mask(roof_m, z_m)[:, 0], expected)


def test_a_soft_obstacle_is_never_less_than_the_exact_one_and_the_same_beyond_one_softness():
    exact = obstacle_mask(ROOF_M[None], [20.0])[0, 0]
    soft = soft_obstacle(ROOF_M, 20.0, 2.0)
    assert np.all(soft >= exact)
    is_near = (ROOF_M > 18) & (ROOF_M < 20)
    np.testing.assert_array_equal(soft[~is_near], exact[~is_near])
    np.testing.assert_allclose(soft[ROOF_M == 19.0], 0.5)


def test_softness_0_is_the_exact_rule_also_where_roof_and_altitude_meet():
    for z_m in (20.0, 18.0, 0.0, -1.0):
        exact = obstacle_mask(ROOF_M[None], [z_m])[0, 0]
        for softness_m in (0.0, 1e-6):
            np.testing.assert_array_equal(soft_obstacle(ROOF_M, z_m, softness_m), exact)


def test_derivatives_of_a_soft_obstacle_equal_central_differences_and_are_0_at_softness_0():
    def total(at):
        return soft_obstacle(at["roof_m"], at["altitude_m"], at["softness_m"]).sum()

    with jax.enable_x64(True):
        at = {"roof_m": np.linspace(17.9, 20.1, 12), "altitude_m": 20.0, "softness_m": 2.0}
        slopes = jax.jit(jax.value_and_grad(total))
        check_gradient(slopes, {name: jnp.asarray(value) for name, value in at.items()}, rtol=1e-6)
        exact = slopes({"roof_m": jnp.full(12, 19.0), "altitude_m": jnp.asarray(20.0), "softness_m": jnp.asarray(0.0)})
    assert not any(np.any(slope) for slope in exact[1].values())
