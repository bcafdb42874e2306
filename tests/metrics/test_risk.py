"""The proximity risk metric on a surface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.metrics.risk import METRIC, Risk, compute_risk
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 70, 62)
REGION = GRID.padded(-10, -10, -10, -10)  # a margin of 50 m
ALTITUDES_M = [20.0, 60.0, 122.0]


def random_roof() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.where(rng.random(GRID.shape) < 0.03, rng.uniform(3, 130, GRID.shape), 0).astype(np.float32)


def surface_of(roof_m, grid=GRID, region=REGION, terrain_m=None) -> Surface:
    terrain = None if terrain_m is None else jnp.asarray(terrain_m, jnp.float32)
    return Surface(jnp.asarray(roof_m), terrain, None, None, grid, region)


def solid_by_brute_force(roof_m, terrain_m, altitude_m, threshold_m):
    """Return the distance of each receiver to the nearest column, every pair tried."""
    row, col = np.indices(roof_m.shape)
    nearest_m2 = np.full(roof_m.shape, np.inf)
    for i, j in np.argwhere(roof_m > 0):
        drop_m = np.maximum(terrain_m + altitude_m - terrain_m[i, j] - roof_m[i, j], 0)
        nearest_m2 = np.minimum(nearest_m2, 25.0 * ((row - i) ** 2 + (col - j) ** 2) + drop_m**2)
    return np.minimum(np.sqrt(nearest_m2), threshold_m)


@pytest.mark.slow
def test_slice_equals_scipys_distance_transform_of_the_surface_with_its_margin():
    roof_m = random_roof()
    m = compute_risk(surface_of(roof_m), ALTITUDES_M, Risk())
    assert m.shape == (3, *REGION.shape)
    assert m.dtype == jnp.float32
    for altitude_m, got in zip(ALTITUDES_M, m, strict=True):
        distance_m = distance_transform_edt(roof_m < altitude_m, sampling=5.0)[10:-10, 10:-10]
        np.testing.assert_allclose(got * 50, np.minimum(distance_m, 50), atol=1e-3)
        assert (got[roof_m[10:-10, 10:-10] >= altitude_m] == 0).all()


def test_terrain_leaves_the_slice_alone_because_it_follows_the_ground():
    roof_m = random_roof()
    terrain_m = np.random.default_rng(1).uniform(0, 50, GRID.shape)
    flat = compute_risk(surface_of(roof_m), ALTITUDES_M, Risk())
    np.testing.assert_array_equal(compute_risk(surface_of(roof_m, terrain_m=terrain_m), ALTITUDES_M, Risk()), flat)


@pytest.mark.parametrize("relief_m", [0.0, 40.0])
def test_solid_equals_brute_force(relief_m):
    roof_m = random_roof()
    terrain_m = np.random.default_rng(1).uniform(0, relief_m, GRID.shape) if relief_m else None
    m = compute_risk(surface_of(roof_m, terrain_m=terrain_m), ALTITUDES_M, Risk(distance="solid"))
    for altitude_m, got in zip(ALTITUDES_M, m, strict=True):
        ground_m = np.zeros(GRID.shape) if terrain_m is None else terrain_m
        expected = solid_by_brute_force(roof_m, ground_m, altitude_m, 50.0)[10:-10, 10:-10]
        np.testing.assert_allclose(got * 50, expected, atol=1e-3)


def test_one_metre_above_a_roof_is_close_only_in_solid():
    roof_m = np.zeros(GRID.shape, np.float32)
    roof_m[30, 30] = 59.0
    above = (slice(None), 20, 20)
    assert compute_risk(surface_of(roof_m), [60.0], Risk())[above] == 1
    np.testing.assert_allclose(compute_risk(surface_of(roof_m), [60.0], Risk(distance="solid"))[above], 1 / 50)


@pytest.mark.slow
def test_solid_risk_has_finite_gradients_in_heights_and_altitude():
    roof_m = jnp.asarray(random_roof())

    def total(roof_m, altitude_m):
        return compute_risk(surface_of(roof_m), altitude_m[None], Risk(distance="solid")).sum()

    by_roof, by_altitude = jax.grad(total, argnums=(0, 1))(roof_m, jnp.asarray(60.0))
    assert jnp.isfinite(by_roof).all()
    assert (by_roof <= 0).all()  # a higher roof is nearer
    assert by_altitude > 0  # flying higher is farther


def test_reach_is_the_threshold():
    assert METRIC.reach_m(Risk(threshold_m=35.0)) == 35.0
