"""Soft maps of whole cities come as near to the exact ones as is asked for."""

from functools import partial

import jax
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.maps.build import view_sky
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.metrics.visibility import SkyView
from tests.metrics.whole_maps import compute_gps

LOWER_MANHATTAN = (-74.02, 40.70, -73.98, 40.73)
ALTITUDE_M = 20.0


@pytest.mark.slow
@pytest.mark.data
def test_each_halving_comes_nearer_and_the_last_map_is_the_exact_one_but_for_half_a_percent(data_dir):
    city = ju.City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=LOWER_MANHATTAN)
    region = ju.Grid.from_bounds(LOWER_MANHATTAN, 5.0, city.crs)
    sky = view_sky(region, ju.Gps(times=["2020-04-27T16:00:00Z"]))
    surface, angles = MapTask(city, region, sky, MapParams()).surface(), (sky.azimuth_rad[0], sky.elevation_rad[0])
    gps = compute_gps(surface, *angles, [ALTITUDE_M]).m[0]
    view = SkyView.of(surface, *angles)
    for exact, soft, last in (
        (gps, lambda softness_m: soft_gps(surface, ALTITUDE_M, 20.0, softness_m, view), 5),
        (compute_lidar(surface, [ALTITUDE_M], Lidar())[0], partial(soft_lidar, surface, ALTITUDE_M, Lidar()), 6),
        (compute_risk(surface, [ALTITUDE_M], Risk())[0], partial(soft_risk, surface, ALTITUDE_M, Risk()), 3),
    ):
        of_softness = jax.jit(soft)
        apart = [np.abs(of_softness(2.0**-power) - exact) for power in range(-3, last + 1)]
        assert (np.diff([values.mean() for values in apart]) < 0).all()
        assert (apart[-1] > 0.01).mean() < 0.005
        np.testing.assert_allclose(of_softness(0.0), exact, atol=1e-5)
