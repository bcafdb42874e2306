"""Which rays stay above known ground: by place and direction alone."""

import numpy as np
import shapely

from jaxurban.world.known import stays_within

TWO_TOWNS = shapely.box(0, 0, 100, 100).union(shapely.box(300, 0, 400, 100))
EAST = np.pi / 2


def rays(*runs_m: float, rise_m: float = 50.0) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths and elevations of rays that run so far east while they rise."""
    return np.full(len(runs_m), EAST), np.arctan2(rise_m, np.array(runs_m))


def test_a_ray_leaves_where_no_data_are_even_if_it_ends_where_some_are():
    start_m = np.array([[50.0, 50.0], [95.0, 50.0]])
    stays = stays_within(TWO_TOWNS, start_m[:, None], *rays(4.0, 300.0, 8.0), rise_m=50.0)
    np.testing.assert_array_equal(stays, [[True, False, True], [True, False, False]])


def test_a_ray_is_followed_to_the_height_of_the_highest_roof_alone():
    start_m = np.array([50.0, 50.0])
    for rise_m, expected in ((49.0, True), (51.0, False), (-3.0, True)):
        assert stays_within(TWO_TOWNS, start_m, EAST, np.arctan(1.0), rise_m) == expected


def test_rays_over_any_polygon_are_those_that_lie_in_it():
    """A witness of its own: points along each ray, two to a metre."""
    rng = np.random.default_rng(3)
    known = shapely.Point(0, 0).buffer(100.0).difference(shapely.box(-20, 30, 20, 50))
    start_m, azimuth_rad = rng.uniform(-110, 110, (400, 2)), rng.uniform(0, 2 * np.pi, 400)
    elevation_rad = np.radians(rng.uniform(20, 89, 400))
    stays = stays_within(known, start_m, azimuth_rad, elevation_rad, rise_m=40.0)
    run_m = 40.0 / np.tan(elevation_rad)
    share = np.linspace(0, 1, 400)[:, None]
    x_m = start_m[:, 0] + share * run_m * np.sin(azimuth_rad)
    y_m = start_m[:, 1] + share * run_m * np.cos(azimuth_rad)
    is_known = shapely.contains_xy(known, x_m, y_m).all(axis=0)
    assert 100 < stays.sum() < 300
    assert (stays == is_known).mean() > 0.99
    assert not (stays & ~is_known).any()


def test_a_place_outside_is_not_known_whatever_the_direction():
    assert not stays_within(TWO_TOWNS, np.array([200.0, 50.0]), EAST, np.pi / 2, 50.0)
