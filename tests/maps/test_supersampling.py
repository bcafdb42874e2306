"""Supersampling: the answers of the supersampled surface at the map's cells, crops, bounds."""

import numpy as np
import pytest

from jaxurban.metrics.visibility import bounding_visibility, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface
from tests.metrics.whole_maps import surface_on

UTM = "EPSG:32618"
OUTER = Grid(UTM, 6.0, 750_000, 96_000, 40, 44)
REGION = Grid(UTM, 6.0, 750_009, 96_007, 20, 24)
# Axes, diagonals and directions beside them.
ANGLES = np.radians([(0, 20), (90, 25), (180, 15), (270, 30), (45, 20), (225, 35), (44.9, 15), (200, 60), (110, 10)])


def fine_city(oversample: int, terrain: bool = False) -> Surface:
    """Return boxes of subcells, the same for every oversample."""
    grid, region = OUTER.refined(oversample), REGION.refined(oversample)
    row, col = np.indices(grid.shape)
    rng = np.random.default_rng(3)
    coarse = rng.uniform(0, 40, (20, 20)) * (rng.random((20, 20)) < 0.3)
    roof_m = coarse[row * 20 // grid.num_rows, col * 20 // grid.num_cols]
    ground_m = 6 * np.sin(row / grid.num_rows * 9) + 5 * np.cos(col / grid.num_cols * 7)
    return surface_on(roof_m, grid, region, ground_m if terrain else None)


@pytest.mark.parametrize("terrain", [False, True])
@pytest.mark.parametrize("oversample", [3, 2])
def test_satellites_at_centres_are_those_of_the_full_fine_sweep(oversample, terrain):
    supersampled = fine_city(oversample, terrain=terrain)
    centre = slice(oversample // 2, None, oversample)
    found = visibility(supersampled, *ANGLES.T, [10.0, 25.0], every=oversample)
    expected = np.asarray(visibility(supersampled, *ANGLES.T, [10.0, 25.0]))[..., centre, centre]
    assert len(np.unique(expected)) > 10
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("oversample", [1, 3])
def test_who_is_seen_past_roofs_that_hide_most_is_seen_past_those_that_hide_least(oversample):
    view = fine_city(oversample), *ANGLES.T, [10.0, 25.0], oversample
    most, least = (bounding_visibility(*view, hides_most=hides_most) for hides_most in (True, False))
    assert np.all(most & ~least == 0)
    assert np.any(most != least)
