"""Windowed distances against SciPy and brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.kernels.distance.nearest import capped_distance, capped_distance_over_terrain
from jaxurban.kernels.distance.nearest_cpu import distance_on_host

INF = np.float32(np.inf)


def brute_force(drop_m, is_source, resolution_m, cap_m):
    """Return distances by trying every pair; ``drop_m(row, col)`` is the drop from all cells to one source."""
    row, col = np.indices(is_source.shape)
    nearest_m2 = np.full(is_source.shape, np.inf)
    for i, j in np.argwhere(is_source):
        run_m2 = ((row - i) ** 2 + (col - j) ** 2) * resolution_m**2
        nearest_m2 = np.minimum(nearest_m2, run_m2 + np.maximum(drop_m(i, j), 0) ** 2)
    return np.minimum(np.sqrt(nearest_m2), cap_m)


@pytest.mark.parametrize(
    ("resolution_m", "cap_m", "share"), [(5.0, 50.0, 0.01), (2.0, 33.0, 0.002)]
)
def test_distance_equals_scipys_up_to_the_cap(resolution_m, cap_m, share):
    is_source = np.random.default_rng(0).random((131, 90)) < share
    distance_m = capped_distance(
        jnp.where(is_source, 0.0, INF), resolution_m=resolution_m, cap_m=cap_m
    )
    expected = np.minimum(distance_transform_edt(~is_source, sampling=resolution_m), cap_m)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)
    assert (np.asarray(distance_m)[expected == cap_m] == cap_m).all()


@pytest.mark.parametrize("share", [0.01, 0.0])
def test_distance_from_sources_below_equals_brute_force_and_without_any_is_the_cap(share):
    rng = np.random.default_rng(1)
    is_source = rng.random((131, 90)) < share
    depth_m = rng.uniform(0, 60, is_source.shape).astype(np.float32)
    distance_m = capped_distance(
        jnp.where(is_source, depth_m**2, INF), resolution_m=5.0, cap_m=50.0
    )
    expected = brute_force(lambda i, j: depth_m[i, j], is_source, 5.0, 50.0)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "resolution_m", "cap_m", "dtype"),
    [
        ((1, 1), 3.0, 3.0, np.float32),
        ((131, 90), 5.0, 50.0, np.float32),
        ((131, 90), 2.0, 33.0, np.float64),
        ((40, 700), 3.0, 3.0, np.float64),
        ((40, 700), 5.0, 50.0, np.float64),
        ((600, 33), 2.0, 33.0, np.float32),
    ],
)
def test_the_kernel_for_a_cpu_gives_the_same_bits(shape, resolution_m, cap_m, dtype):
    rng = np.random.default_rng(3)
    is_source = rng.random(shape) < 0.002
    source_m2 = np.where(
        is_source, np.where(rng.random(shape) < 0.5, 0, rng.uniform(0, 60, shape) ** 2), np.inf
    )
    sizes = {"resolution_m": resolution_m, "cap_m": cap_m}
    with jax.enable_x64(dtype == np.float64):
        expected = np.asarray(capped_distance(jnp.asarray(source_m2, dtype), **sizes))
    assert expected.dtype == dtype
    for halo in {0, min(7, min(shape) // 3), min(shape) // 3}:
        found = distance_on_host(source_m2.astype(dtype), halo, **sizes)
        np.testing.assert_array_equal(
            found, expected[halo : shape[0] - halo, halo : shape[1] - halo], strict=True
        )


def test_distance_over_terrain_equals_brute_force():
    rng = np.random.default_rng(2)
    is_source = rng.random((60, 45)) < 0.02
    receiver_m = rng.uniform(20, 60, is_source.shape).astype(np.float32)
    top_m = rng.uniform(0, 50, is_source.shape).astype(np.float32)
    distance_m = capped_distance_over_terrain(
        receiver_m, top_m, jnp.asarray(is_source), resolution_m=5.0, cap_m=50.0
    )
    expected = brute_force(lambda i, j: receiver_m - top_m[i, j], is_source, 5.0, 50.0)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)


@pytest.mark.slow
def test_gradients_are_those_of_the_nearest_source_and_finite_everywhere():
    depth_m = jnp.asarray([30.0, 0.0])
    row = jnp.arange(40)

    def distances(depth_m):
        source_m2 = jnp.where(row == 3, depth_m[0] ** 2, jnp.where(row == 33, depth_m[1] ** 2, INF))
        return capped_distance(source_m2[None], resolution_m=5.0, cap_m=50.0)[0]

    gradient = jax.jacobian(distances)(depth_m)
    assert jnp.isfinite(gradient).all()
    distance_m = distances(depth_m)
    np.testing.assert_allclose(distance_m[6], np.hypot(15.0, 30.0), rtol=1e-6)
    np.testing.assert_allclose(
        gradient[6], [30.0 / np.hypot(15.0, 30.0), 0.0], rtol=1e-6
    )  # d distance / d depth
    np.testing.assert_array_equal(gradient[33], 0.0)  # at distance 0
    np.testing.assert_array_equal(gradient[18], 0.0)  # at the cap


def test_gradients_over_terrain_are_finite_where_nothing_stands():
    is_source = jnp.zeros((12, 12), bool).at[2, 3].set(True)

    def total(top_m):
        receiver_m = jnp.full((12, 12), 40.0)
        return capped_distance_over_terrain(
            receiver_m, top_m, is_source, resolution_m=5.0, cap_m=30.0
        ).sum()

    gradient = jax.grad(total)(jnp.full((12, 12), 20.0))
    assert jnp.isfinite(gradient).all()
    assert gradient[2, 3] < 0  # a higher roof is nearer
    assert jnp.count_nonzero(gradient) == 1
