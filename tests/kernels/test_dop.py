"""Dilutions of precision against float64 matrix inverses and known geometries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.dop import Dops, dops, dops_of_words, geometry, unit_vectors


def inverse_dops(directions, is_seen):
    """The definition in float64: roots of the diagonal of (G^T G)^-1, [5, N] for N choices of satellites."""
    matrix = np.column_stack([directions, -np.ones(len(directions))])
    normal = np.einsum("ns,si,sj->nij", is_seen.astype(float), matrix, matrix)
    is_regular = np.linalg.cond(normal) < 1e12
    variance = np.full((4, len(normal)), np.inf)
    variance[:, is_regular] = np.diagonal(np.linalg.inv(normal[is_regular]), axis1=1, axis2=2).T
    east, north, up, clock = variance
    position = east + north + up
    return np.sqrt([position + clock, position, east + north, up, clock])


def random_sky(num, seed):
    rng = np.random.default_rng(seed)
    return unit_vectors(rng.uniform(0, 2 * np.pi, num), rng.uniform(np.radians(5), np.pi / 2, num))


@pytest.mark.parametrize("num", [6, 12, 33])
def test_dops_up_to_20_equal_float64_to_1e_5(num):
    rng = np.random.default_rng(num)
    directions = random_sky(num, num)
    is_seen = rng.random((20_000, num)) < rng.uniform(0.2, 1, (20_000, 1))
    words = np.zeros((-(-num // 32), len(is_seen)), np.uint32)
    for s in range(num):
        words[s // 32] |= is_seen[:, s].astype(np.uint32) << np.uint32(s % 32)
    found = np.array(dops_of_words(geometry(directions), jnp.asarray(words)))
    expected = inverse_dops(directions, is_seen)
    is_useful = (expected[0] < 20) & (is_seen.sum(axis=1) >= 4)
    assert is_useful.sum() > 100
    np.testing.assert_allclose(found[:, is_useful], expected[:, is_useful], rtol=1e-5)
    assert np.all(np.isinf(found[:, is_seen.sum(axis=1) < 4]))


def test_four_satellites_at_the_corners_of_a_tetrahedron_have_known_dops():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    found = dops(geometry(corners), jnp.ones(4))
    # Sum of u u^T is 4/3 of the identity and the mean direction is 0.
    expected = Dops(np.sqrt(2.5), 1.5, np.sqrt(1.5), np.sqrt(0.75), 0.5)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_satellites_on_one_cone_leave_the_position_undetermined():
    ring = unit_vectors(np.radians([0.0, 50.0, 130.0, 200.0, 300.0]), np.full(5, np.radians(40.0)))
    assert np.all(np.isinf(dops(geometry(ring), jnp.ones(5))))
    with_zenith = geometry(np.vstack([ring, [0.0, 0.0, 1.0]]))
    assert np.all(np.isfinite(dops(with_zenith, jnp.ones(6))))
    assert np.all(np.isinf(dops(with_zenith, jnp.array([1.0, 1, 1, 1, 1, 0]))))


def test_satellites_that_fill_up_change_no_bit():
    # A sum has as many terms, some of them 0, and is added up in the same order (up to 31 of them).
    directions = random_sky(12, 5)
    words = jnp.asarray(np.random.default_rng(0).integers(0, 2**12, (1, 500)), jnp.uint32)
    plain = dops_of_words(geometry(directions), words)
    np.testing.assert_array_equal(plain, dops_of_words(geometry(directions, multiple_of=24), words))
    alone = jnp.stack([jnp.stack(dops_of_words(geometry(directions), words[:, i])) for i in range(5)], axis=1)
    np.testing.assert_allclose(np.array(plain)[:, :5], alone, rtol=1e-6)


@pytest.mark.parametrize("num", [0, 3])
def test_fewer_than_four_satellites_give_inf(num):
    assert np.all(np.isinf(dops_of_words(geometry(random_sky(num, 1)), jnp.full((1, 2, 2), 2**num - 1, jnp.uint32))))


def test_one_more_satellite_never_raises_a_dop():
    satellites = geometry(random_sky(9, 4))
    weights = jnp.ones((9, 9)) - jnp.eye(9)  # each column leaves one out
    for less, all_seen in zip(dops(satellites, weights), dops(satellites, jnp.ones(9)), strict=True):
        assert np.all(less >= all_seen * (1 - 1e-6))


def test_derivatives_by_soft_weights_equal_finite_differences():
    with jax.enable_x64(True):
        satellites = geometry(random_sky(7, 3), np.float64)
        weights = jnp.asarray(np.random.default_rng(0).uniform(0.1, 1, 7))

        @jax.jit
        def total(w):
            return sum(jnp.sum(d) for d in dops(satellites, w))

        slope = jax.grad(total)(weights)
        step = 1e-6 * jnp.eye(7)
        expected = jnp.array([(total(weights + d) - total(weights - d)) / 2e-6 for d in step])
        np.testing.assert_allclose(slope, expected, rtol=1e-6)


@pytest.mark.parametrize("weights", [[0.0] * 6, [1.0, 1, 1, 0, 0, 0], [1.0, 1, 1, 1, 1, 0]])
def test_gradients_stay_finite_in_singular_geometry(weights):
    ring = unit_vectors(np.radians([0.0, 50.0, 130.0, 200.0, 300.0]), np.full(5, np.radians(40.0)))
    satellites = geometry(np.vstack([ring, [0.0, 0.0, 1.0]]))
    slope = jax.grad(lambda w: jnp.minimum(dops(satellites, w).gdop, 20.0))(jnp.array(weights))
    assert np.all(np.isfinite(slope))
