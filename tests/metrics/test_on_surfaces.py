"""Lidar, risk and obstacles on a surface, and statistics of a metric over time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.variables import SCALE, TimeTotals, series_statistics
from jaxurban.world.grid import Grid
from jaxurban.world.surface import obstacle_mask, soft_obstacle
from tests.metrics.soft.scene import check_gradient
from tests.metrics.whole_maps import surface_on

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 70, 62)
REGION = GRID.padded(-10, -10, -10, -10)  # a margin of 50 m
ALTITUDES_M = [20.0, 60.0, 122.0]


RNG = np.random.default_rng(0)
SCATTERED_M = np.where(RNG.random(GRID.shape) < 0.03, RNG.uniform(3, 130, GRID.shape), 0).astype(np.float32)


def solid_by_brute_force(roof_m, terrain_m, altitude_m, threshold_m):
    """Return the distance of each receiver to the nearest column, every pair tried."""
    row, col = np.indices(roof_m.shape)
    nearest_m2 = np.full(roof_m.shape, np.inf)
    for i, j in np.argwhere(roof_m > 0):
        drop_m = np.maximum(terrain_m + altitude_m - terrain_m[i, j] - roof_m[i, j], 0)
        nearest_m2 = np.minimum(nearest_m2, 25.0 * ((row - i) ** 2 + (col - j) ** 2) + drop_m**2)
    return np.minimum(np.sqrt(nearest_m2), threshold_m)


@pytest.mark.parametrize(("distance", "relief_m"), [("slice", 0.0), ("slice", 50.0), ("solid", 0.0), ("solid", 40.0)])
def test_the_slice_is_scipys_distance_transform_over_any_terrain_and_the_solid_that_of_brute_force(distance, relief_m):
    roof_m, ground_m = SCATTERED_M, np.random.default_rng(1).uniform(0, relief_m, GRID.shape)
    surface = surface_on(roof_m, GRID, REGION, ground_m if relief_m else None)
    m = compute_risk(surface, ALTITUDES_M, Risk(distance=distance))
    assert m.dtype == jnp.float32
    for altitude_m, got in zip(ALTITUDES_M, m, strict=True):
        if distance == "slice":
            expected_m = np.minimum(distance_transform_edt(roof_m < altitude_m, sampling=5.0), 50)
        else:
            expected_m = solid_by_brute_force(roof_m, ground_m, altitude_m, 50.0)
        np.testing.assert_allclose(got * 50, expected_m[10:-10, 10:-10], atol=1e-3)


def test_nothing_stands_beyond_the_surface():
    padded, lidar = GRID.padded(30, 30, 30, 30), Lidar(azimuths=60)
    alone = compute_lidar(surface_on(SCATTERED_M, GRID, GRID), [20.0], lidar)
    among_nothing = compute_lidar(surface_on(np.pad(SCATTERED_M, 30), padded, GRID), [20.0], lidar)
    assert alone.min() < alone.max()
    np.testing.assert_array_equal(alone, among_nothing)


def test_a_single_beam_lies_in_the_middle_and_several_at_equal_steps():
    np.testing.assert_allclose(Lidar(beams=1, field_of_view_deg=(-10, 20)).elevations_rad, np.deg2rad([5]))
    np.testing.assert_allclose(np.rad2deg(Lidar().elevations_rad), np.arange(-15, 16, 2), atol=1e-12)


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


@pytest.mark.parametrize("num_times", [1, 2, 7, 24, 288])
def test_statistics_equal_numpys_quantiles(num_times):
    m = np.random.default_rng(num_times).random((num_times, 3, 50), np.float32)
    m[0, 0] = 0.5  # exactly at the threshold: not available
    found = series_statistics(m, 0.5)
    np.testing.assert_allclose(found["median"], np.median(m, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["p05"], np.quantile(m, 0.05, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["availability"], (m > 0.5).mean(axis=0), atol=1e-6)
    assert all(values.dtype == np.float32 for values in found.values())


def test_totals_give_means_and_the_worst_epoch_in_any_order():
    m = np.random.default_rng(0).random((5, 2, 100))
    m[3, 1] /= 10
    cells = np.rint(m * SCALE).astype(int).reshape(5, 2, 10, 10)
    parts = [TimeTotals(cells[:, :, i].sum(axis=2), np.full(2, 10)) for i in range(10)]
    nothing = TimeTotals(np.zeros((5, 2), int), np.zeros(2, int))
    forward, backward = sum(parts, nothing), sum(parts[::-1], nothing)
    np.testing.assert_array_equal(forward.mean, backward.mean)
    np.testing.assert_allclose(forward.mean, m.mean(axis=2), atol=1e-4)
    assert forward.worst[1] == 3
