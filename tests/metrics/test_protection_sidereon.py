"""Protection levels of what real cities leave in view, against sidereon's ARAIM."""

import numpy as np
import pytest

from jaxurban.metrics.protection import Protection, levels_of_satellites, ranging_of
from jaxurban.metrics.visibility import distinct_choices

pytestmark = [pytest.mark.data, pytest.mark.slow]

PARAMS = Protection()
PATTERNS = 5000  # of each city
NEAR_M = 1000.0  # beyond, satellites that all but leave the position undetermined magnify rounding
CITIES = {
    "tokyo": ("DISTRICT", [f"2018-12-19T{hour:02d}:20:00Z" for hour in (6, 7)]),
    "manhattan": ("MANHATTAN", [f"2020-04-27T{hour:02d}:00:00Z" for hour in range(24)]),
}


@pytest.mark.parametrize("city", CITIES)
def test_levels_of_what_a_city_leaves_in_view_are_sidereons(city, data_dir):
    peer = pytest.importorskip("benchmarks.sidereon_peer", reason="sidereon (dev extra) is not installed")
    from benchmarks import protection, scenes

    name, times = CITIES[city]
    place = getattr(protection, name, None) or getattr(scenes, name)
    is_obstacle, seen = protection.views(place, 20.0, 5.0, times)
    num, num_near = 0, 0
    for words, in_view in seen:
        patterns, _ = distinct_choices(words, is_obstacle)
        patterns = patterns[:, : PATTERNS - num]
        ours = levels_of_satellites(in_view, PARAMS, patterns)
        theirs = peer.Peer(ranging_of(in_view, PARAMS), in_view.systems, PARAMS.budget).levels(patterns)
        np.testing.assert_array_equal(np.isfinite(ours), np.isfinite(theirs))
        is_near = theirs < NEAR_M
        np.testing.assert_allclose(ours[is_near], theirs[is_near], atol=1e-6, rtol=0)
        is_far = np.isfinite(theirs) & ~is_near
        np.testing.assert_allclose(ours[is_far], theirs[is_far], rtol=1e-6)
        num += patterns.shape[1]
        num_near += int(is_near.all(axis=0).sum())
        if num >= PATTERNS:
            break
    assert num == PATTERNS
    assert num_near > PATTERNS / 3
