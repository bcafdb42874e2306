"""Height uncertainty: the spread of metrics against NumPy, the normal law and the plain maps."""

import math
from dataclasses import replace

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.maps.uncertain_heights import Spread, perturbed_cities
from jaxurban.metrics.lidar import Lidar
from jaxurban.settings import HeightStd
from jaxurban.world.footprints import HeightOrigin
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from tests.made_maps import city_of_boxes

X0, Y0, UTM = 500_000.0, 4_500_000.0, "EPSG:32618"
REGION = Grid(UTM, 10.0, 450_000, 50_000, 12, 14)
LIDAR = Lidar(beams=4, azimuths=12, range_m=50.0)
DEFAULT, EXACT = HeightStd(), HeightStd(0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def city() -> ju.City:
    made = city_of_boxes(
        [(30, 40, 50, 70), (90, 60, 110, 90)], np.array([30.0, 10.0]), 140.0, (X0, Y0), UTM
    )
    origin = np.array([HeightOrigin.HEIGHT, HeightOrigin.DEFAULT], np.uint8)
    return replace(made, buildings=replace(made.buildings, origin=origin))


def spread_of(city, *, num_samples, height_std=DEFAULT):
    heights = ju.Heights(height_samples=num_samples, height_std_m=height_std)
    sky = view_sky(REGION, ju.Gps(times=["2020-04-27T16:00:00Z"]))
    params = MapParams((12.0, 31.0), heights=heights, sections={"lidar": LIDAR})
    ds = compute_maps(MapTask(city, REGION, sky, params)).ds
    names = [
        f"{metric}_{what}"
        for metric in ("gps", "lidar", "risk")
        for what in ("mean", "std", "p05", "p95")
    ]
    return ds[[*names, "obstacle_share"]]


@pytest.mark.parametrize("num_samples", [2, 5, 21, 60])
def test_spreads_are_numpys_moments_and_percentiles(num_samples):
    samples = np.random.default_rng(0).random((num_samples, 4, 5)).astype(np.float32)
    spread = Spread(num_samples)
    for sample in samples:
        spread.add(sample)
    found = spread.results()
    np.testing.assert_allclose(found["mean"], samples.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(found["std"], samples.std(axis=0, ddof=1), rtol=1e-5)
    for name, share in (("p05", 5), ("p95", 95)):
        np.testing.assert_allclose(found[name], np.percentile(samples, share, axis=0), rtol=1e-5)


def test_heights_known_exactly_have_no_spread(city):
    maps = ju.build_maps(city, grid=REGION, altitudes_m=(12.0, 31.0), lidar=LIDAR).ds
    spread = spread_of(city, height_std=EXACT, num_samples=3)
    for name in ("gps", "lidar", "risk"):
        assert spread[f"{name}_std"].dims == maps[name].dims
        assert not np.nan_to_num(spread[f"{name}_std"]).any()
        for what in ("mean", "p05", "p95"):
            np.testing.assert_array_equal(spread[f"{name}_{what}"], maps[name])
    np.testing.assert_array_equal(spread["obstacle_share"], maps["obstacle"])


def test_the_share_of_obstacles_is_the_normal_laws(city):
    # 10 m known to 5 m reach 12 m with the probability of 0.4 standard deviations; 30 m known to 1 m reach 31 m
    # with that of one.
    num = 4000
    heights = np.array([c.buildings.height_m for c in perturbed_cities(city, HeightStd(), num, 1)])
    for building, altitude_m, deviations in ((1, 12.0, 0.4), (0, 31.0, 1.0)):
        expected = 0.5 * math.erfc(deviations / math.sqrt(2))
        assert (heights[:, building] >= altitude_m).mean() == pytest.approx(
            expected, abs=4 / math.sqrt(4 * num)
        )
    assert heights.min() == 0.0  # where 5 m too little would put a roof of 10 m under the ground
    assert abs(np.corrcoef(heights.T)[0, 1]) < 0.05


def test_a_roof_moves_as_a_whole_and_the_same_call_repeats_its_draws(city):
    spread = spread_of(city, num_samples=8)
    share = spread["obstacle_share"].values
    assert len(np.unique(share[1, 4:7, 3:5])) == 1
    assert 0 < share[0, 6:9, 9:11].max() < 1
    assert (spread["risk_std"].values > 0).any()
    assert not (spread["gps_p05"] > spread["gps_p95"]).any()
    assert spread.identical(spread_of(city, num_samples=8))


def test_a_height_raster_moves_by_connected_buildings(city):
    values = np.zeros((8, 9), np.float32)
    values[1:3, 1:4], values[5:7, 5:8], values[0, 8] = 12.0, 20.0, np.nan
    raster = Raster(values, (10.0, 0.0, X0, 0.0, -10.0, Y0 + 80.0), UTM)
    rasters = replace(city, buildings=None, roofs=raster)
    drawn = np.array(
        [c.roofs.values for c in perturbed_cities(rasters, HeightStd(raster=2.0), 200, 0)]
    )
    error = drawn - values
    assert np.isnan(drawn[:, 0, 8]).all()
    assert (drawn[:, values == 0] == 0).all()
    for building in (values == 12, values == 20):
        assert np.ptp(error[:, building], axis=1).max() < 1e-5
        assert error[:, building].std() == pytest.approx(2.0, rel=0.2)
