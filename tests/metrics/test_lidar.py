"""The lidar metric on a surface."""

import numpy as np

from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.world.grid import Grid
from tests.metrics.whole_maps import surface_on

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 110, 120)
PARAMS = Lidar(azimuths=60)
MARGIN = 20  # cells of 5 m in a range of 100 m


def random_roof(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.gamma(1.0, 20.0, (22, 24)) * (rng.random((22, 24)) < 0.3), np.ones((5, 5)))
    return blocks.astype(np.float32)


def test_lidar_is_a_share_zero_inside_obstacles_and_above_every_reach():
    roof_m = random_roof()
    region = GRID.padded(*4 * [-MARGIN])
    m = np.asarray(compute_lidar(surface_on(roof_m, GRID, region), [20.0, 60.0, 600.0], PARAMS))
    assert m.shape == (3, *region.shape)
    assert m.dtype == np.float32
    assert m.min() == 0
    assert 0.5 < m.max() <= 1
    assert (m[0][roof_m[MARGIN:-MARGIN, MARGIN:-MARGIN] >= 20] == 0).all()
    assert (m[2] == 0).all()
    np.testing.assert_allclose(m * 60, np.round(m * 60), atol=1e-4)


def test_nothing_stands_beyond_the_surface():
    roof_m = random_roof()
    padded = GRID.padded(30, 30, 30, 30)
    alone = compute_lidar(surface_on(roof_m, GRID, GRID), [20.0], PARAMS)
    among_nothing = compute_lidar(surface_on(np.pad(roof_m, 30), padded, GRID), [20.0], PARAMS)
    np.testing.assert_array_equal(alone, among_nothing)


def test_a_single_beam_lies_in_the_middle_and_several_at_equal_steps():
    np.testing.assert_allclose(Lidar(beams=1, field_of_view_deg=(-10, 20)).elevations_rad, np.deg2rad([5]))
    np.testing.assert_allclose(np.rad2deg(Lidar().elevations_rad), np.arange(-15, 16, 2), atol=1e-12)
