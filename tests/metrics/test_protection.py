"""Protection maps: range errors as published, one level a choice of satellites; sidereon's ARAIM of real cities."""

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import scenes
from jaxurban.metrics.protection import (
    Protection,
    galileo_receiver_sigma_m,
    levels_of_satellites,
    protection_maps,
    ranging_of,
)
from jaxurban.metrics.visibility import distinct_choices
from jaxurban.world.sky import InView
from tests.kernels.test_protection import EXAMPLE

PARAMS = Protection()
ISD = PARAMS.isd


def test_range_errors_are_those_of_the_published_example():
    east, north, up = -EXAMPLE[:, :3].T
    in_view = InView(
        np.arctan2(east, north), np.arctan2(up, np.hypot(east, north)), ("gps",) * len(EXAMPLE)
    )
    found = ranging_of(in_view, ISD)
    np.testing.assert_allclose(found.sigma_int_m**2, EXAMPLE[:, 3], atol=1e-4)
    np.testing.assert_allclose(found.sigma_acc_m**2, EXAMPLE[:, 4], atol=1e-4)


def test_galileo_has_a_table_that_ends_at_5_degrees():
    found_m = galileo_receiver_sigma_m(np.radians([0.0, 5.0, 7.5, 10.0, 90.0]))
    np.testing.assert_allclose(found_m, [0.4529, 0.4529, 0.4041, 0.3553, 0.2277])
    in_view = InView(np.zeros(3), np.full(3, 0.6), ("galileo", "gps", "qzss"))
    found = ranging_of(in_view, ISD)
    assert found.sigma_int_m[0] < found.sigma_int_m[1] == found.sigma_int_m[2]
    np.testing.assert_array_equal(found.p_const[found.constellation], [1e-4, 1e-8, 1e-4])


@pytest.mark.parametrize("counts", [(9, 0), (7, 6), (40, 30)])
def test_every_cell_has_the_levels_of_its_own_satellites(counts):
    draw, num, systems = (
        np.random.default_rng(3),
        sum(counts),
        np.repeat(["gps", "galileo"], counts),
    )
    in_view = InView(
        draw.uniform(0, 2 * np.pi, num), np.arcsin(draw.uniform(0.15, 1, num)), tuple(systems)
    )
    words = draw.integers(0, 2**32, (-(-num // 32), 9, 11), dtype=np.uint32)
    words[-1] &= np.uint32(2 ** (num % 32) - 1)
    words[:, 3:5] = words[:, :1]
    is_obstacle = draw.random((9, 11)) < 0.2
    maps = protection_maps(jnp.asarray(words), is_obstacle, in_view, PARAMS)
    levels = levels_of_satellites(in_view, ISD, words.reshape(len(words), -1)).reshape(2, 9, 11)
    hpl_m, vpl_m = np.where(is_obstacle, np.inf, levels)
    np.testing.assert_array_equal(maps["hpl"], hpl_m.astype(np.float32))
    np.testing.assert_array_equal(maps["vpl"], vpl_m.astype(np.float32))
    np.testing.assert_allclose(maps["protection"], 1 - np.minimum(hpl_m, 40) / 40, atol=1e-7)
    np.testing.assert_array_equal(maps["within_limits"], (hpl_m <= 40) & (vpl_m <= 35))
    assert not maps["protection"][is_obstacle].any()
    assert maps["within_limits"].any()


PATTERNS = 5000  # of each city
CITIES = {
    "DISTRICT": [f"2018-12-19T{hour:02d}:20:00Z" for hour in (6, 7)],  # of Tokyo
    "MANHATTAN": [f"2020-04-27T{hour:02d}:00:00Z" for hour in range(24)],
}


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.usefixtures("data_dir")
@pytest.mark.parametrize("city", CITIES)
def test_levels_of_what_a_city_leaves_in_view_are_sidereons(city):
    peer = pytest.importorskip(
        "benchmarks.protection", reason="sidereon (dev extra) is not installed"
    )
    place = getattr(peer, city, None) or getattr(scenes, city)
    is_obstacle, seen = peer.views(place, 20.0, 5.0, CITIES[city])
    num, num_near = 0, 0
    for words, in_view in seen:
        patterns, _ = distinct_choices(words, is_obstacle)
        patterns = patterns[:, : PATTERNS - num]
        ours = levels_of_satellites(in_view, ISD, patterns)
        theirs = peer.Peer(ranging_of(in_view, ISD), in_view.systems, ISD.budget).levels(patterns)
        np.testing.assert_array_equal(np.isfinite(ours), np.isfinite(theirs))
        # Beyond, satellites that all but leave the position undetermined magnify rounding.
        is_near, is_had = theirs < peer.NEAR_M, np.isfinite(theirs)
        off_m = np.abs(ours[is_had] - theirs[is_had])
        assert (off_m <= 1e-6 * np.where(is_near, 1.0, theirs)[is_had]).all()
        num += patterns.shape[1]
        num_near += int(is_near.all(axis=0).sum())
    assert num == PATTERNS
    assert num_near > PATTERNS / 3
