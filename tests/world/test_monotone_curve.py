"""The curve of the synthetic city's shores against SciPy's."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from jaxurban.world.monotone_curve import monotone_curve
from jaxurban.world.synthetic_streets import EAST_BANK, SHORES

heights = st.lists(st.sampled_from([-2.5, -1.0, 0.0, 0.1, 0.3, 1.0, 7.0]), min_size=3, max_size=9)


@settings(max_examples=200, deadline=None)
@given(y=heights, seed=st.integers(0, 99))
def test_the_curve_is_scipys_to_the_bit(y, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.01, 2.0, len(y)))
    at = np.r_[x, rng.uniform(x[0], x[-1], 50)]
    np.testing.assert_array_equal(monotone_curve(x, np.array(y), at), PchipInterpolator(x, y)(at))


def test_the_shores_are_scipys_to_the_bit():
    for x, y in ((SHORES[:, 0], SHORES[:, 1]), (SHORES[:, 0], SHORES[:, 2]), EAST_BANK.T):
        at = np.linspace(x[0], x[-1], 1001)
        np.testing.assert_array_equal(monotone_curve(x, y, at), PchipInterpolator(x, y)(at))


def test_the_curve_keeps_within_its_points():
    x, y = np.arange(5.0), np.array([0.0, 0.0, 1.0, 1.0, 5.0])
    found = monotone_curve(x, y, np.linspace(0, 4, 401))
    assert np.all(np.diff(found) >= 0)
    assert found.max() == 5
