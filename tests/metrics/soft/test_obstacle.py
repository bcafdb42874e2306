"""Soft obstacles against the exact rule and differences."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.world.surface import obstacle_mask, soft_obstacle

ROOF_M = jnp.array([0.0, 5.0, 17.9, 18.0, 18.5, 19.0, 19.9, 20.0, 21.0, 300.0])


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
        np.testing.assert_array_equal(soft_obstacle(ROOF_M, z_m, 0.0), exact)
        np.testing.assert_array_equal(soft_obstacle(ROOF_M, z_m, 1e-6), exact)


def test_derivatives_equal_central_differences():
    with jax.enable_x64(True):
        point = [np.linspace(17.9, 20.1, 12), np.full(12, 20.0), np.full(12, 2.0)]
        slopes = jax.grad(lambda *p: jnp.sum(soft_obstacle(*p)), argnums=(0, 1, 2))(*map(jnp.asarray, point))
        for at, slope in enumerate(slopes):
            ends = [soft_obstacle(*point[:at], point[at] + step, *point[at + 1 :]) for step in (1e-6, -1e-6)]
            np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_at_softness_0_derivatives_are_0():
    slopes = jax.grad(lambda *p: jnp.sum(soft_obstacle(*p)), argnums=(0, 1, 2))(ROOF_M, 20.0, 0.0)
    assert not any(np.any(slope) for slope in slopes)
