"""Soft maps of a whole city come as near to the exact ones as is asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.read.rasterise import build_surface
from jaxurban.metrics.gps import Gps, soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from tests.metrics.soft.scene import AZIMUTH_RAD, ELEVATION_RAD
from tests.metrics.whole_maps import compute_gps

BOUNDS = (-74.02, 40.70, -73.98, 40.73)
HALO = 21  # cells of 5 m
ALTITUDE_M = 20.0


def exact_gps(surface, altitudes_m, params):
    return compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, altitudes_m, params).m


def soft_gps_of(surface, altitude_m, params, softness_m):
    view = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)
    return soft_gps(surface, altitude_m, params.gdop_threshold, softness_m, view)


GPS = exact_gps, soft_gps_of, Gps(), range(-3, 6)
LIDAR, RISK = (compute_lidar, soft_lidar, Lidar(), range(-3, 7)), (compute_risk, soft_risk, Risk(), range(-3, 4))


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("exact", "soft", "params", "powers"), [GPS, LIDAR, RISK])
def test_each_halving_comes_nearer_to_lower_manhattan_and_the_last_map_is_its_own_but_for_half_a_percent(
    data_dir, exact, soft, params, powers
):
    city = City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=BOUNDS)
    region = Grid.from_bounds(BOUNDS, 5.0, city.crs)
    surface = build_surface(city, region, region.padded(HALO, HALO, HALO, HALO))
    expected = exact(surface, [ALTITUDE_M], params)[0]
    of_softness = jax.jit(lambda softness_m: soft(surface, ALTITUDE_M, params, softness_m))
    apart = [np.asarray(jnp.abs(of_softness(2.0**-power) - expected)) for power in powers]
    assert (np.diff([values.mean() for values in apart]) < 0).all()
    assert (apart[-1] > 0.01).mean() < 0.005
    np.testing.assert_allclose(of_softness(0.0), expected, atol=1e-6)
