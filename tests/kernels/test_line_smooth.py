"""The line-smooth cost: closed forms, SciPy's quadrature, and finite differences."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import RegularGridInterpolator

from jaxurban.kernels.line.cuts import cuts_needed
from jaxurban.kernels.line.smooth import line_integrals, line_smooth

RESOLUTION_M, REFERENCE_M, WEIGHT = 2.0, 5.0, 0.3
CUTS = 8


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def random_case(seed=0):
    rng = np.random.default_rng(seed)
    layers = rng.random((2, 7, 9))
    return rng.uniform(0.5, 13.5, (6, 2)), layers


def cost_of(points_m, layers, num_cuts=CUTS, distance_weight=WEIGHT):
    return line_smooth(
        jnp.asarray(points_m), jnp.asarray(layers), RESOLUTION_M, distance_weight, REFERENCE_M, num_cuts=num_cuts
    )


def by_quadrature(points_m, layer):
    """Integral of the clamped bilinear interpolant, piece by piece between rows and columns of centres."""
    num_rows, num_cols = layer.shape
    value = RegularGridInterpolator((np.arange(num_rows), np.arange(num_cols)), layer)
    total = 0.0
    for begin, end in zip(points_m[:-1] / RESOLUTION_M - 0.5, points_m[1:] / RESOLUTION_M - 0.5, strict=True):
        crossed = (np.arange(-2, 30)[:, None] - begin) / (end - begin)
        cuts = np.unique(np.concatenate([[0, 1], crossed[(crossed > 0) & (crossed < 1)]]))

        def along(t, begin=begin, end=end):
            x, y = begin + t * (end - begin)
            return value((np.clip(y, 0, num_rows - 1), np.clip(x, 0, num_cols - 1)))

        length_m = np.hypot(*(end - begin)) * RESOLUTION_M
        total += length_m * sum(quad(along, low, high)[0] for low, high in itertools.pairwise(cuts))
    return total


def test_a_uniform_map_costs_its_value_along_the_length():
    points_m, layers = random_case()
    length_m = np.hypot(*np.diff(points_m, axis=0).T).sum()
    expected = (WEIGHT + (0.7 + 0.2) / REFERENCE_M) * length_m
    uniform = np.ones_like(layers) * np.array([0.7, 0.2])[:, None, None]
    assert float(cost_of(points_m, uniform)) == pytest.approx(expected, rel=1e-14)


def test_a_linear_map_costs_its_value_at_the_middle_of_each_segment():
    points_m = np.array([[2.0, 3.0], [11.0, 8.5], [11.0, 4.0], [4.0, 4.0]])
    rows, cols = np.mgrid[:7, :9]
    layer = 1.0 + 0.3 * (cols + 0.5) * RESOLUTION_M + 0.7 * (rows + 0.5) * RESOLUTION_M
    middle = (points_m[1:] + points_m[:-1]) / 2
    lengths_m = np.hypot(*np.diff(points_m, axis=0).T)
    expected = ((1.0 + middle @ (0.3, 0.7)) * lengths_m).sum()
    integral = line_integrals(jnp.asarray(points_m), jnp.asarray(layer[None]), RESOLUTION_M, num_cuts=CUTS).per_layer_m
    assert float(integral[0]) == pytest.approx(expected, rel=1e-14)


def test_integrals_equal_quadrature_also_beyond_the_outermost_centres():
    points_m, layers = random_case(3)
    points_m[2] = [0.2, 13.9]
    found = line_integrals(jnp.asarray(points_m), jnp.asarray(layers), RESOLUTION_M, num_cuts=CUTS)
    np.testing.assert_allclose(found.per_layer_m, [by_quadrature(points_m, layer) for layer in layers], rtol=1e-10)
    single = line_integrals(
        jnp.asarray(points_m, jnp.float32), jnp.asarray(layers, jnp.float32), RESOLUTION_M, num_cuts=CUTS
    )
    assert single.per_layer_m.dtype == jnp.float32
    np.testing.assert_allclose(single.per_layer_m, found.per_layer_m, rtol=1e-5)


@pytest.mark.parametrize("argument", [0, 1, 2])
def test_gradients_equal_finite_differences_for_waypoints_layers_and_weight(argument):
    points_m, layers = random_case(1)
    arguments = [jnp.asarray(points_m), jnp.asarray(layers), jnp.asarray(WEIGHT)]

    def cost(value):
        given = [*arguments[:argument], value, *arguments[argument + 1 :]]
        return cost_of(given[0], given[1], distance_weight=given[2])

    base = np.asarray(arguments[argument])
    gradient = np.asarray(jax.grad(cost)(arguments[argument]))
    step = 1e-5
    numeric = np.empty(base.shape)
    for index in np.ndindex(*base.shape):
        shift = np.zeros(base.shape)
        shift[index] = step
        numeric[index] = (cost(jnp.asarray(base + shift)) - cost(jnp.asarray(base - shift))) / (2 * step)
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-8)


def test_gradients_are_finite_where_segments_have_no_length_or_points_lie_on_centres():
    _, layers = random_case()
    points_m = np.array([[3.0, 3.0], [3.0, 3.0], [7.0, 3.0], [7.0, 3.0], [7.0, 9.0], [0.0, 0.0], [18.0, 14.0]])
    value, gradient = jax.value_and_grad(cost_of)(jnp.asarray(points_m), layers, 16)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


def test_repeated_end_points_change_neither_value_nor_gradient():
    points_m, layers = random_case()
    padded = np.concatenate([points_m, np.repeat(points_m[-1:], 4, axis=0)])
    value, gradient = jax.value_and_grad(cost_of)(jnp.asarray(points_m), layers)
    padded_value, padded_gradient = jax.value_and_grad(cost_of)(jnp.asarray(padded), layers)
    assert float(padded_value) == pytest.approx(float(value), rel=1e-14)
    np.testing.assert_allclose(padded_gradient[:6], gradient, rtol=1e-12)
    np.testing.assert_array_equal(padded_gradient[6:], 0.0)


def test_too_few_cuts_give_nan_and_the_needed_ones_the_same_as_more():
    points_m, layers = random_case(5)
    needed = cuts_needed(points_m, RESOLUTION_M, 0.5)
    assert float(cost_of(points_m, layers, needed)) == pytest.approx(float(cost_of(points_m, layers, 32)), rel=1e-13)
    assert np.isnan(cost_of([[1.0, 1.0], [13.0, 1.0]], layers, 2))


def test_a_batch_equals_its_members():
    _, layers = random_case()
    batch = np.stack([random_case(seed)[0] for seed in range(3)])
    together = jax.vmap(lambda points_m: cost_of(points_m, layers))(jnp.asarray(batch))
    np.testing.assert_allclose(together, [cost_of(points_m, layers) for points_m in batch], rtol=1e-13)
