"""From which height on a DOP is good: against normal matrices inverted set by set, and where a clock comes in late."""

import numpy as np
import pytest

from jaxurban.kernels.dop import Clocks, geometry, unit_vectors
from jaxurban.kernels.least_heights import least_heights

AZIMUTH_RAD = np.radians([10.0, 100.0, 190.0, 280.0, 55.0, 235.0, 145.0])
ELEVATION_RAD = np.radians([20.0, 35.0, 50.0, 25.0, 70.0, 40.0, 15.0])
DIRECTIONS = unit_vectors(AZIMUTH_RAD, ELEVATION_RAD)


def dops_of(directions: np.ndarray, clocks: np.ndarray) -> dict[str, float]:
    """Return the DOPs of satellites by inverting the normal matrix of position and the clocks that are seen."""
    seen = np.unique(clocks)
    rows = np.column_stack([directions, clocks[:, None] == seen])
    if np.linalg.matrix_rank(rows) < rows.shape[1]:
        return dict.fromkeys(("gdop", "hdop"), np.inf)
    variances = np.diag(np.linalg.inv(rows.T @ rows))
    return {"gdop": np.sqrt(variances[:4].sum()), "hdop": np.sqrt(variances[:2].sum())}


def expected(height_m, clocks, threshold, dop):
    """Return the least height of one cell by looking at every height at which a satellite comes into view."""
    least_m = np.inf
    for at_m in np.unique(height_m)[::-1]:
        is_seen = height_m <= at_m
        if dops_of(DIRECTIONS[is_seen], clocks[is_seen])[dop] > threshold:
            break
        least_m = at_m
    return least_m


@pytest.mark.parametrize("clocks", [np.zeros(7, int), np.array([0, 0, 0, 0, 1, 1, 1])])
@pytest.mark.parametrize(("dop", "threshold"), [("gdop", 6.0), ("hdop", 2.0), ("gdop", 1.0)])
def test_it_is_the_least_height_above_which_every_set_is_good(clocks, dop, threshold):
    rng = np.random.default_rng(3)
    shape = 13, 11
    roof_m = np.where(rng.random(shape) < 0.3, rng.uniform(5, 60, shape), 0).astype(np.float32)
    shadow_m = rng.uniform(-40, 90, (7, *shape)).astype(np.float32)
    shadow_m[rng.random(shadow_m.shape) < 0.2] = -np.inf
    filled_m = np.concatenate([shadow_m, np.full((1, *shape), 5.0, np.float32)])
    satellites = geometry(DIRECTIONS, multiple_of=8, clocks=Clocks(clocks, clocks.max() + 1))
    found = np.asarray(least_heights(filled_m, roof_m, satellites, threshold, dop=dop))
    height_m = np.maximum(shadow_m, roof_m)
    for cell in np.ndindex(shape):
        assert found[cell] == expected(height_m[:, *cell], clocks, threshold, dop)
    assert np.isfinite(found).all() == (threshold > 1)


def test_a_clock_that_comes_in_late_and_makes_it_worse_raises_the_floor():
    """Four satellites of the second system are good from 10 m; at 30 m the first one of the first system comes in."""
    clocks = np.array([1, 1, 1, 1, 0, 0, 0])
    good_alone = dops_of(DIRECTIONS[:4], clocks[:4])["gdop"]
    with_first = dops_of(DIRECTIONS[:5], clocks[:5])["gdop"]
    with_second = dops_of(DIRECTIONS[:6], clocks[:6])["gdop"]
    assert with_second < good_alone < with_first
    shadow_m = np.array([-np.inf, 3.0, 5.0, 10.0, 30.0, 40.0, 50.0], np.float32)[:, None]
    ground_m = np.zeros(1, np.float32)

    def floor(threshold, num=7):
        satellites = geometry(DIRECTIONS[:num], clocks=Clocks(clocks[:num], 2))
        return float(least_heights(shadow_m[:num], ground_m, satellites, threshold, dop="gdop")[0])

    between = (good_alone + with_first) / 2
    assert floor(between) == 40.0
    assert floor(with_first + 0.1) == 10.0
    assert floor(between, num=4) == 10.0
    assert floor(between, num=3) == np.inf
