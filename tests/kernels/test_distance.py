"""Windowed distances against SciPy and brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.kernels.distance.nearest import (
    capped_distance,
    capped_distance_over_terrain,
    disc,
    nearest_along,
    squared_runs,
    window_cells,
)

INF = np.float32(np.inf)


def distance_to(source_m2, resolution_m, cap_m, halo=None, dtype=np.float32):
    """Return the capped distance where nothing stands beyond the array."""
    halo = halo or window_cells(cap_m, resolution_m)
    around_m2 = np.pad(np.asarray(source_m2, dtype), halo, constant_values=np.inf)
    return capped_distance(around_m2, squared_runs(halo, resolution_m, dtype), dtype(cap_m))


def distance_over_terrain(receiver_m, top_m, is_source, resolution_m, cap_m):
    """Return the capped distance over terrain where nothing stands beyond the arrays."""
    halo = window_cells(cap_m, resolution_m)
    around = jnp.pad(top_m, halo), jnp.pad(is_source, halo)
    cells = disc(cap_m, resolution_m, np.float32)
    return capped_distance_over_terrain(receiver_m, *around, cells, np.float32(cap_m))


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
    distance_m = distance_to(np.where(is_source, 0.0, INF), resolution_m, cap_m)
    expected = np.minimum(distance_transform_edt(~is_source, sampling=resolution_m), cap_m)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)
    assert (np.asarray(distance_m)[expected == cap_m] == cap_m).all()


@pytest.mark.parametrize("share", [0.01, 0.0])
def test_distance_from_sources_below_equals_brute_force_and_without_any_is_the_cap(share):
    rng = np.random.default_rng(1)
    is_source = rng.random((131, 90)) < share
    depth_m = rng.uniform(0, 60, is_source.shape).astype(np.float32)
    distance_m = distance_to(np.where(is_source, depth_m**2, INF), 5.0, 50.0)
    expected = brute_force(lambda i, j: depth_m[i, j], is_source, 5.0, 50.0)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)


def test_one_column_finds_its_nearest_source_and_how_many_cells_away_it_stands():
    source_m2 = np.full(30, np.inf, np.float32)
    source_m2[[7, 20]] = 0.0, 4.0
    nearest_m2, offset = nearest_along(source_m2, squared_runs(5, 2.0, np.float32))
    cell = np.arange(5, 25)
    expected_m2 = np.minimum((2.0 * (cell - 7)) ** 2, (2.0 * (cell - 20)) ** 2 + 4)
    is_near = np.minimum(abs(cell - 7), abs(cell - 20)) <= 5
    np.testing.assert_array_equal(nearest_m2, np.where(is_near, expected_m2, np.inf))
    expected = np.where(cell < 14, 7 - cell, 20 - cell)
    np.testing.assert_array_equal(np.asarray(offset)[is_near], expected[is_near])


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_wider_halo_and_a_traced_cap_change_no_bit(dtype):
    rng = np.random.default_rng(3)
    depth_m = np.where(rng.random((60, 45)) < 0.5, 0, rng.uniform(0, 60, (60, 45)))
    source_m2 = np.where(rng.random(depth_m.shape) < 0.01, depth_m**2, np.inf)
    caps_m = np.array([17.0, 33.3, 50.0])
    with jax.enable_x64(dtype == np.float64):
        plain = [np.asarray(distance_to(source_m2, 3.3, cap_m, dtype=dtype)) for cap_m in caps_m]
        around_m2 = np.pad(source_m2.astype(dtype), 16, constant_values=np.inf)
        mapped = jax.vmap(capped_distance, (None, None, 0))
        found = mapped(around_m2, squared_runs(16, 3.3, dtype), caps_m.astype(dtype))
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, plain)


def test_distance_over_terrain_equals_brute_force():
    rng = np.random.default_rng(2)
    is_source = rng.random((60, 45)) < 0.02
    receiver_m = rng.uniform(20, 60, is_source.shape).astype(np.float32)
    top_m = rng.uniform(0, 50, is_source.shape).astype(np.float32)
    distance_m = distance_over_terrain(receiver_m, top_m, is_source, 5.0, 50.0)
    expected = brute_force(lambda i, j: receiver_m - top_m[i, j], is_source, 5.0, 50.0)
    np.testing.assert_allclose(distance_m, expected, atol=1e-4)


@pytest.mark.slow
def test_gradients_are_those_of_the_nearest_source_and_finite_everywhere():
    depth_m = jnp.asarray([30.0, 0.0])
    cell = jnp.arange(-10, 50)
    nothing = jnp.full((10, 60), INF)

    def distances(depth_m):
        of_first = jnp.where(cell == 3, depth_m[0] ** 2, INF)
        source_m2 = jnp.where(cell == 33, depth_m[1] ** 2, of_first)
        around_m2 = jnp.concatenate([nothing, source_m2[None], nothing])
        return capped_distance(around_m2, squared_runs(10, 5.0, np.float32), 50.0)[0]

    gradient = jax.jacobian(distances)(depth_m)
    assert jnp.isfinite(gradient).all()
    distance_m = distances(depth_m)
    np.testing.assert_allclose(distance_m[6], np.hypot(15.0, 30.0), rtol=1e-6)
    np.testing.assert_allclose(
        gradient[6], [30.0 / np.hypot(15.0, 30.0), 0.0], rtol=1e-6
    )  # d distance / d depth
    np.testing.assert_array_equal(gradient[33], 0.0)  # at distance 0
    np.testing.assert_array_equal(gradient[18], 0.0)  # at the cap


@pytest.mark.slow
def test_gradients_over_terrain_are_finite_where_nothing_stands():
    is_source = jnp.zeros((12, 12), bool).at[2, 3].set(True)

    def total(top_m):
        receiver_m = jnp.full((12, 12), 40.0)
        return distance_over_terrain(receiver_m, top_m, is_source, 5.0, 30.0).sum()

    gradient = jax.grad(total)(jnp.full((12, 12), 20.0))
    assert jnp.isfinite(gradient).all()
    assert gradient[2, 3] < 0  # a higher roof is nearer
    assert jnp.count_nonzero(gradient) == 1
