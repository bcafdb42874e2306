"""The trilinear line integral: closed forms, quadrature, the flat case, and gradients by finite differences."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from jaxurban.kernels.line.smooth import line_integrals
from jaxurban.kernels.line.smooth_volume import volume_line_integrals

LEVELS_M = np.array([10.0, 25.0, 60.0])
LAYERS = np.random.default_rng(0).random((2, 3, 7, 8))
POINTS_M = np.array([[3.0, 2.0, 12.0], [30.3, 22.2, 55.0], [30.3, 22.2, 30.1], [5.2, 25.1, 30.1], [5.2, 25.1, 30.1]])
SIDE_M = 4.0


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def integrals(points_m, layers=LAYERS, levels_m=LEVELS_M):
    return volume_line_integrals(*map(jnp.asarray, (points_m, layers, levels_m)), SIDE_M, num_cuts=8)


def test_it_is_the_integral_of_scipys_interpolant():
    centres = [LEVELS_M, (np.arange(7) + 0.5) * SIDE_M, (np.arange(8) + 0.5) * SIDE_M]
    share = (np.arange(40_000) + 0.5) / 40_000
    expected = np.zeros(2)
    for a, b in itertools.pairwise(POINTS_M):
        along = a + share[:, None] * (b - a)
        places = np.clip(along[:, ::-1], [c[0] for c in centres], [c[-1] for c in centres])
        for number, layer in enumerate(LAYERS):
            expected[number] += RegularGridInterpolator(centres, layer)(places).mean() * np.linalg.norm(b - a)
    found = integrals(POINTS_M)
    np.testing.assert_allclose(found.per_layer_m, expected, rtol=1e-7)
    np.testing.assert_allclose(found.length_m, np.linalg.norm(np.diff(POINTS_M, axis=0), axis=1).sum())


def test_at_a_level_it_is_the_integral_in_the_plane():
    flat = POINTS_M.copy()
    flat[:, 2] = LEVELS_M[1]
    plane = line_integrals(jnp.asarray(flat[:, :2]), jnp.asarray(LAYERS[:, 1]), SIDE_M, num_cuts=8)
    for found, expected in zip(integrals(flat), plane, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_gradients_by_waypoints_layers_and_levels_agree_with_finite_differences():
    inputs = [jnp.asarray(value) for value in (POINTS_M, LAYERS, LEVELS_M)]

    def value(*inputs):
        return jnp.vdot(volume_line_integrals(*inputs, SIDE_M, num_cuts=8).per_layer_m, jnp.array([1.0, 0.3]))

    slopes = jax.jit(jax.grad(value, (0, 1, 2)))(*inputs)
    rng = np.random.default_rng(1)
    for place, slope in enumerate(slopes):
        for _ in range(4):
            along = rng.normal(size=slope.shape)
            if place == 0:
                along[4] = along[3]  # the segment of no length keeps none
            above, below = (
                value(*(old + step * along if i == place else old for i, old in enumerate(inputs)))
                for step in (1e-6, -1e-6)
            )
            np.testing.assert_allclose(jnp.vdot(slope, along), (above - below) / 2e-6, rtol=1e-6)


def test_one_level_holds_at_every_altitude_and_too_few_cuts_give_nan():
    one = integrals(POINTS_M, LAYERS[:, :1], LEVELS_M[:1])
    assert np.isfinite(one.per_layer_m).all()
    few = volume_line_integrals(*map(jnp.asarray, (POINTS_M, LAYERS, LEVELS_M)), SIDE_M, num_cuts=2)
    assert np.isnan(few.per_layer_m).all()
