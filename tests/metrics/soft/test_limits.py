"""Soft maps of whole cities come as near to the exact ones as is asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.read.rasterise import build_surface
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.synthetic import demo_city

LOWER_MANHATTAN = (-74.02, 40.70, -73.98, 40.73)
HALO = 21  # cells of 5 m
ALTITUDE_M = 20.0


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("city_name", ["synthetic", "lower-manhattan"])
def test_each_halving_comes_nearer_and_the_last_map_is_the_exact_one_but_for_half_a_percent(city_name, request):
    if city_name == "synthetic":
        city = demo_city(2000, 2000)
        x_min, y_min = (round(edge / 5) for edge in city.extent_m[:2])
        region = Grid(city.crs, 5.0, y_min, x_min, 400, 400)
    else:
        data = request.getfixturevalue("data_dir")
        city = City.from_files(data / "osm" / "lower-manhattan.osm.pbf", bounds=LOWER_MANHATTAN)
        region = Grid.from_bounds(LOWER_MANHATTAN, 5.0, city.crs)
    surface = build_surface(city, region, region.padded(HALO, HALO, HALO, HALO))
    cases = {
        "lidar": (compute_lidar, soft_lidar, Lidar(), range(-3, 7)),
        "risk": (compute_risk, soft_risk, Risk(), range(-3, 4)),
    }
    for exact, soft, params, powers in cases.values():
        expected = exact(surface, [ALTITUDE_M], params)[0]
        of_softness = jax.jit(lambda s, softness_m, f=soft, p=params: f(s, ALTITUDE_M, p, softness_m))
        apart = [np.asarray(jnp.abs(of_softness(surface, 2.0**-power) - expected)) for power in powers]
        assert (np.diff([values.mean() for values in apart]) < 0).all()
        assert (apart[-1] > 0.01).mean() < 0.005
        np.testing.assert_allclose(of_softness(surface, 0.0), expected, atol=1e-6)
