"""Monotone cubic curves against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from jaxurban.world.pchip import pchip
from jaxurban.world.synthetic_streets import EAST_BANK, SHORES


@pytest.mark.parametrize(("x", "y"), [SHORES[:, [0, 1]].T, SHORES[:, [0, 2]].T, EAST_BANK.T])
def test_shores_of_the_synthetic_city_are_scipys_curves(x, y):
    at = np.linspace(x[0], x[-1], 401)
    np.testing.assert_allclose(pchip(x, y, at), PchipInterpolator(x, y)(at), rtol=0, atol=4e-16)


def test_curves_through_any_points_are_scipys():
    rng = np.random.default_rng(0)
    for number in range(500):
        num = rng.integers(3, 20)
        x = np.cumsum(rng.uniform(0.01, 3.0, num))
        y = rng.choice([0.0, 1.0, 0.5, -1.0], num) if number % 2 else rng.normal(size=num)  # flat stretches too
        at = np.r_[x, rng.uniform(x[0], x[-1], 50)]
        np.testing.assert_allclose(pchip(x, y, at), PchipInterpolator(x, y)(at), rtol=1e-13, atol=1e-14)


def test_a_curve_through_a_straight_line_of_points_is_the_line():
    at = np.linspace(0.0, 4.0, 33)
    np.testing.assert_allclose(pchip(np.array([0.0, 1.0, 3.0, 4.0]), np.array([1.0, 3.0, 7.0, 9.0]), at), 1 + 2 * at)
