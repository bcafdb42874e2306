"""Obstacle cells."""

import numpy as np

from jaxurban.world.surface import obstacle_mask


def test_a_cell_is_an_obstacle_up_to_its_roof_and_free_above():
    roof_m = np.array([[0.0, 19.9, 20.0], [60.0, 60.1, 0.0]], np.float32)
    np.testing.assert_array_equal(
        obstacle_mask(roof_m, [20.0, 60.0, 122.0]),
        [
            [[False, False, True], [True, True, False]],
            [[False, False, False], [True, True, False]],
            [[False, False, False], [False, False, False]],
        ],
    )


def test_bare_ground_is_free_even_at_altitude_zero():
    assert not obstacle_mask(np.zeros((2, 2), np.float32), [0.0]).any()
