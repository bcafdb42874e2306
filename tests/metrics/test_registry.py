"""The metrics as one registry, their weights, and layers of one's own beside them."""

import json
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.metrics.base import Scene, SoftScene
from jaxurban.metrics.custom import Layer, held_metrics, own_metric
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.registry import METRICS, ON_REQUEST, known_metrics
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.weights import Weights
from jaxurban.world.surface import obstacle_mask
from tests.metrics.soft.scene import ALTITUDE_M, BUILDING, CASES, CELLS, HEIGHT_M, REGION, surface_of

SURFACE = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
VALUES = np.linspace(-10.0, 100.0, REGION.num_rows * REGION.num_cols).reshape(REGION.shape)
NOISE = Layer("noise.tif", "high-is-bad", (0.0, 80.0))


IS_OBSTACLE = obstacle_mask(SURFACE.crop(SURFACE.roof_m), [ALTITUDE_M])[0]
HERE = Scene(SURFACE, ALTITUDE_M, IS_OBSTACLE)


def test_metrics_stand_in_the_papers_order_and_an_unknown_one_is_named():
    assert list(METRICS) == ["gps", "lidar", "population", "risk"]
    assert [float(metric.cost(0.25)) for metric in METRICS.values()] == [0.75, 0.75, 0.25, 0.75]
    assert [metric.reach_m(metric.params()) for metric in METRICS.values()] == [0.0, 100.0, 0.0, 50.0]
    assert [METRICS["lidar"].reach_m(Lidar(range_m=70.0)), METRICS["risk"].reach_m(Risk(35.0))] == [70.0, 35.0]
    assert [*known_metrics()] == [*METRICS, *ON_REQUEST]
    assert len({metric.colour for metric in known_metrics().values()}) == len(known_metrics())


def test_a_function_sees_the_surface_and_has_gradients_where_it_has_a_soft_form():
    layer = Layer(
        lambda surface, altitude_m: surface.crop(surface.roof_m) / altitude_m,
        "high-is-bad",
        (0.0, 2.0),
        reach_m=10.0,
        soft=lambda surface, altitude_m, softness_m: surface.crop(surface.roof_m) / altitude_m,
    )
    metric = own_metric("shade", layer)
    pickle.loads(pickle.dumps(own_metric("noise", NOISE).compute))  # for workers
    assert (metric.dims, metric.reach_m(layer)) == (("altitude",), 10.0)
    m = metric.compute(HERE, layer)["shade"]
    np.testing.assert_allclose(m, np.clip(np.asarray(SURFACE.crop(SURFACE.roof_m)) / ALTITUDE_M / 2, 0, 1), rtol=1e-6)
    view = CASES["gps"].view()

    def total(altitude_m):
        around = SoftScene(SURFACE, altitude_m, 2.0, jnp.asarray(CELLS), 10.0, view, None, "day")
        return metric.soft(around, layer).sum()

    assert jax.grad(total)(ALTITUDE_M) < 0
    wrong = Layer(lambda surface, altitude_m: np.zeros((2, 2)), "high-is-bad", (0.0, 1.0))
    with pytest.raises(InputError, match="one value for each cell"):
        own_metric("wrong", wrong).compute(HERE, wrong)


def test_maps_say_which_layers_they_hold():
    ds = xr.Dataset({name: (("y", "x"), VALUES) for name in ("risk", "gps_median", "noise", "roof")})
    ds["noise"].attrs["layer"] = json.dumps(NOISE.record)
    held = held_metrics(ds)
    assert list(held) == ["gps", "risk", "noise"]
    assert held["noise"].cost(1.0) == 1.0


def test_weights_are_parsed_over_a_base_carry_any_name_and_a_name_that_is_left_out_weighs_one():
    assert Weights.parse("gps=2, risk=0", Weights(lidar=7.0)) == Weights(gps=2.0, lidar=7.0, risk=0.0)
    weights = Weights.parse("noise=2,gps=3")
    assert (weights["noise"], weights["gps"], weights["crowd"]) == (2.0, 3.0, 1.0)
    assert weights == Weights(gps=3.0, noise=2.0) == Weights.of({"noise": 2.0, "gps": 3.0})
    assert hash(weights) == hash(Weights(gps=3.0, noise=2.0))
    assert weights.replace(noise=5.0).to_dict() == {**Weights(gps=3.0).to_dict(), "noise": 5.0}
    assert weights.checked(["noise"]) == weights
    gradient = jax.grad(lambda w: w["noise"] ** 2 + w.gps)(weights)
    assert (gradient["noise"], gradient.gps, gradient.risk) == (4.0, 1.0, 0.0)
