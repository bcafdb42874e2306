"""The metrics as one registry, and layers of one's own beside them."""

import json
import pickle
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.metrics.base import Scene, SoftScene
from jaxurban.metrics.custom import Layer, held_metrics, own_metric
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.population import BlockLayers
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import SkyView, visibility
from jaxurban.world.sky import InView
from jaxurban.world.surface import obstacle_mask
from tests.metrics.soft.scene import ALTITUDE_M, CELLS, REGION, scene, surface_of
from tests.metrics.whole_maps import compute_gps

AZIMUTH_RAD, ELEVATION_RAD = np.radians([10.0, 80.0, 190.0, 285.0, 140.0]), np.radians([35.0, 50.0, 25.0, 40.0, 65.0])
HEIGHT_M, BUILDING = scene()
SURFACE = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
VALUES = np.linspace(-10.0, 100.0, REGION.num_rows * REGION.num_cols).reshape(REGION.shape)
NOISE = Layer("noise.tif", "high-is-bad", (0.0, 80.0))
QUIET = Layer("noise.tif", "low-is-bad", (0.0, 80.0), nan="error")


def here(**rest) -> Scene:
    is_obstacle = obstacle_mask(SURFACE.crop(SURFACE.roof_m), [ALTITUDE_M])[0]
    return Scene(SURFACE, ALTITUDE_M, is_obstacle, **rest)


def test_every_metric_makes_its_own_maps_of_a_scene():
    params = {"lidar": Lidar(beams=2, azimuths=8, range_m=30.0), "risk": Risk(30.0)}
    gps = METRICS["gps"].params()
    words = visibility(SURFACE, AZIMUTH_RAD, ELEVATION_RAD, [ALTITUDE_M])[:, 0]
    people = BlockLayers(jnp.array([0.25, 1.0]), jnp.array([10.0, 40.0]), jnp.array(40.0))
    block = jnp.asarray(np.arange(REGION.num_rows * REGION.num_cols).reshape(REGION.shape) % 3 - 1)
    found = METRICS["gps"].compute(here(in_view=InView(AZIMUTH_RAD, ELEVATION_RAD, ()), words=words), gps)
    whole = compute_gps(SURFACE, AZIMUTH_RAD, ELEVATION_RAD, [ALTITUDE_M], gps)
    np.testing.assert_array_equal(found["gps"], whole.m[0])
    np.testing.assert_array_equal(found["num_visible"], whole.num_visible[0])
    for name, compute in (("lidar", compute_lidar), ("risk", compute_risk)):
        m = METRICS[name].compute(here(), params[name])[name]
        np.testing.assert_array_equal(m, compute(SURFACE, [ALTITUDE_M], params[name])[0])
    over_blocks = Scene(replace(SURFACE, block=block), population=people)
    found |= METRICS["population"].compute(over_blocks, METRICS["population"].params())
    np.testing.assert_array_equal(found["population"], np.array([0.25, 1.0, 0.0])[np.asarray(block)])
    for name in ("gps", "population"):
        assert {kind for kind in found if kind in METRICS[name].variables} == {*METRICS[name].variables}


def test_metrics_stand_in_the_papers_order_and_an_unknown_one_is_named():
    assert list(METRICS) == ["gps", "lidar", "population", "risk"]
    assert [float(metric.cost(0.25)) for metric in METRICS.values()] == [0.75, 0.75, 0.25, 0.75]
    assert [metric.reach_m(metric.params()) for metric in METRICS.values()] == [0.0, 100.0, 0.0, 50.0]
    assert len({metric.colour for metric in METRICS.values()}) == len(METRICS)


@pytest.mark.parametrize("layer", [NOISE, QUIET])
def test_a_raster_is_scaled_by_fixed_numbers_and_cut(layer):
    metric = own_metric("noise", layer)
    m = np.asarray(metric.compute(here(rasters={"noise": VALUES}), layer)["noise"])
    np.testing.assert_allclose(m, np.clip(VALUES / 80, 0, 1), atol=1e-6)
    np.testing.assert_allclose(metric.cost(m), m if layer is NOISE else 1 - m)
    assert metric.dims == ()
    pickle.loads(pickle.dumps(metric.compute))


def test_cells_without_a_value_stay_unknown_or_are_an_error():
    rasters = {"noise": np.where(np.arange(REGION.num_cols) == 3, np.nan, VALUES)}
    m = np.asarray(own_metric("noise", NOISE).compute(here(rasters=rasters), NOISE)["noise"])
    assert np.isnan(m[:, 3]).all()
    assert np.isfinite(np.delete(m, 3, axis=1)).all()
    with pytest.raises(InputError, match=f"'noise' has no value in {REGION.num_rows} cells"):
        own_metric("noise", QUIET).compute(here(rasters=rasters), QUIET)


def test_a_function_sees_the_surface_and_has_gradients_where_it_has_a_soft_form():
    layer = Layer(
        lambda surface, altitude_m: surface.crop(surface.roof_m) / altitude_m,
        "high-is-bad",
        (0.0, 2.0),
        reach_m=10.0,
        soft=lambda surface, altitude_m, softness_m: surface.crop(surface.roof_m) / altitude_m,
    )
    metric = own_metric("shade", layer)
    assert (metric.dims, metric.reach_m(layer)) == (("altitude",), 10.0)
    m = metric.compute(here(), layer)["shade"]
    np.testing.assert_allclose(m, np.clip(np.asarray(SURFACE.crop(SURFACE.roof_m)) / ALTITUDE_M / 2, 0, 1), rtol=1e-6)
    view = SkyView.of(SURFACE, AZIMUTH_RAD, ELEVATION_RAD)

    def total(altitude_m):
        around = SoftScene(SURFACE, altitude_m, 2.0, jnp.asarray(CELLS), 10.0, view, None, "day")
        return metric.soft(around, layer).sum()

    assert jax.grad(total)(ALTITUDE_M) < 0
    wrong = Layer(lambda surface, altitude_m: np.zeros((2, 2)), "high-is-bad", (0.0, 1.0))
    with pytest.raises(InputError, match="one value for each cell"):
        own_metric("wrong", wrong).compute(here(), wrong)


def test_maps_say_which_layers_they_hold():
    ds = xr.Dataset({name: (("y", "x"), VALUES) for name in ("risk", "gps_median", "noise", "roof")})
    ds["noise"].attrs["layer"] = json.dumps(NOISE.record)
    held = held_metrics(ds)
    assert list(held) == ["gps", "risk", "noise"]
    assert held["noise"].cost(1.0) == 1.0
