"""The proximity risk metric on a surface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.world.grid import Grid
from tests.metrics.whole_maps import surface_on

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 70, 62)
REGION = GRID.padded(-10, -10, -10, -10)  # a margin of 50 m
ALTITUDES_M = [20.0, 60.0, 122.0]


def random_roof() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.where(rng.random(GRID.shape) < 0.03, rng.uniform(3, 130, GRID.shape), 0).astype(np.float32)


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
    roof_m, ground_m = random_roof(), np.random.default_rng(1).uniform(0, relief_m, GRID.shape)
    surface = surface_on(roof_m, GRID, REGION, ground_m if relief_m else None)
    m = compute_risk(surface, ALTITUDES_M, Risk(distance=distance))
    assert m.shape == (3, *REGION.shape)
    assert m.dtype == jnp.float32
    for altitude_m, got in zip(ALTITUDES_M, m, strict=True):
        if distance == "slice":
            expected_m = np.minimum(distance_transform_edt(roof_m < altitude_m, sampling=5.0), 50)
        else:
            expected_m = solid_by_brute_force(roof_m, ground_m, altitude_m, 50.0)
        np.testing.assert_allclose(got * 50, expected_m[10:-10, 10:-10], atol=1e-3)


@pytest.mark.slow
def test_solid_risk_has_finite_gradients_in_heights_and_altitude():
    roof_m = jnp.asarray(random_roof())

    def total(roof_m, altitude_m):
        return compute_risk(surface_on(roof_m, GRID, REGION), altitude_m[None], Risk(distance="solid")).sum()

    by_roof, by_altitude = jax.grad(total, argnums=(0, 1))(roof_m, jnp.asarray(60.0))
    assert jnp.isfinite(by_roof).all()
    assert (by_roof <= 0).all()  # a higher roof is nearer
    assert by_altitude > 0  # flying higher is farther
