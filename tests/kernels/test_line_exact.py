"""The differentiable line integral: the walk's values, and gradients by finite differences."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.line.cuts import cuts_needed
from jaxurban.kernels.line.exact import exact_integrals, exact_line_cost
from jaxurban.planners.cost_model import CostModel
from tests.planners.problems import costed

RESOLUTION_M = 4.0
LAYERS = np.random.default_rng(0).random((2, 9, 11))
POINTS = np.array([[3.1, 2.7], [39.2, 30.3], [17.9, 33.1], [17.9, 5.2], [17.9, 5.2], [2.2, 5.2]])  # also axis-parallel


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def walked(points_m):
    """Length and integrals of the exact walk from border to border."""
    paid = costed(points_m, LAYERS, np.ones((9, 11), bool), RESOLUTION_M, 0.0, CostModel("line", 1.0))
    return paid.length_m, paid.per_layer


def integrals(points_m, num_borders=16):
    return exact_integrals(jnp.asarray(points_m), jnp.asarray(LAYERS), RESOLUTION_M, num_borders=num_borders)


def test_random_polylines_collect_what_the_walk_collects():
    rng = np.random.default_rng(1)
    for _ in range(20):
        points = rng.uniform(0, [44, 36], (5, 2))
        for value, expected in zip(integrals(points), walked(points), strict=True):
            np.testing.assert_allclose(value, expected, rtol=1e-12)


def test_a_grid_path_through_corners_collects_what_the_walk_collects():
    cells = np.array([[0, 0], [1, 1], [2, 2], [2, 3], [1, 4], [1, 5]])
    points = (cells[:, ::-1] + 0.5) * RESOLUTION_M
    np.testing.assert_allclose(integrals(points)[1], walked(points)[1], rtol=1e-12)
    on_borders = np.array([[4.0, 8.0], [16.0, 8.0], [16.0, 20.0]])
    np.testing.assert_allclose(integrals(on_borders)[1], walked(on_borders)[1], rtol=1e-12)


def test_the_cost_of_a_line_has_the_gradient_of_finite_differences():
    cost = jax.jit(partial(exact_line_cost, reference_length_m=5.0, num_borders=16))
    inputs = [jnp.asarray(POINTS), jnp.asarray(LAYERS), jnp.asarray(RESOLUTION_M), jnp.asarray(0.3)]
    slopes = jax.grad(cost, (0, 1, 3))(*inputs)
    rng = np.random.default_rng(2)
    for place, slope in zip((0, 1, 3), slopes, strict=True):
        for _ in range(5):
            along = rng.normal(size=slope.shape)
            if place == 0:
                along[4] = along[3]  # the segment of no length keeps none: its length has a kink there
            ends = [
                cost(*(value + step * along if i == place else value for i, value in enumerate(inputs)))
                for step in (1e-6, -1e-6)
            ]
            np.testing.assert_allclose(jnp.vdot(slope, along), (ends[0] - ends[1]) / 2e-6, rtol=1e-6)


def test_by_each_layer_the_gradient_is_the_length_in_each_cell():
    by_layer = jax.grad(lambda layers: exact_integrals(jnp.asarray(POINTS), layers, RESOLUTION_M, num_borders=16)[1][0])
    np.testing.assert_allclose(by_layer(jnp.asarray(LAYERS))[0].sum(), walked(POINTS)[0])


def test_one_program_serves_other_points_and_other_maps_and_vmap():
    before = exact_integrals._cache_size()
    for shift in (0.0, 0.1, 0.2):
        exact_integrals(jnp.asarray(POINTS + shift), jnp.asarray(LAYERS + shift), RESOLUTION_M, num_borders=8)
    assert exact_integrals._cache_size() == before + 1
    many = jnp.asarray(np.stack([POINTS, POINTS[::-1]]))
    both = jax.vmap(lambda points: exact_integrals(points, jnp.asarray(LAYERS), RESOLUTION_M, num_borders=16)[1])(many)
    np.testing.assert_allclose(both[0], both[1], rtol=1e-12)


def test_leaving_the_map_or_too_few_borders_give_nan():
    assert np.isnan(integrals([[3.0, 3.0], [45.0, 3.0]])[1]).all()
    assert cuts_needed(POINTS, RESOLUTION_M, 0.0) == 16
    assert np.isfinite(integrals(POINTS)[1]).all()
    assert np.isnan(integrals(POINTS, num_borders=4)[1]).all()
