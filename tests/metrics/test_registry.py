"""The metrics as one registry, their weights, layers of one's own beside them, and what all of them refuse."""

import json
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.metrics.base import Scene, SoftScene
from jaxurban.metrics.custom import Layer, check_layers, held_metrics, own_metric
from jaxurban.metrics.gps import Dop, Gps, soft_gps
from jaxurban.metrics.lidar import Lidar, soft_lidar
from jaxurban.metrics.population import Population, day_share
from jaxurban.metrics.protection import IntegritySupport, Protection
from jaxurban.metrics.registry import METRICS, ON_REQUEST, known_metrics
from jaxurban.metrics.risk import Risk, soft_risk
from jaxurban.metrics.weights import Weights
from jaxurban.settings import Heights, HeightStd
from jaxurban.world.surface import obstacle_mask
from tests.metrics.soft.scene import (
    ALTITUDE_M,
    BUILDING,
    CASES,
    CELLS,
    HEIGHT_M,
    REGION,
    surface_of,
)

SURFACE = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
VALUES = np.linspace(-10.0, 100.0, REGION.num_rows * REGION.num_cols).reshape(REGION.shape)
LAYER = {"source": "noise.tif", "cost": "high-is-bad", "scale": (0.0, 80.0)}
NOISE = Layer(**LAYER)


HERE = Scene(SURFACE, ALTITUDE_M, obstacle_mask(SURFACE.crop(SURFACE.roof_m), [ALTITUDE_M])[0])


def test_metrics_stand_in_the_papers_order_and_an_unknown_one_is_named():
    assert list(METRICS) == ["gps", "lidar", "population", "risk"]
    assert [float(metric.cost(0.25)) for metric in METRICS.values()] == [0.75, 0.75, 0.25, 0.75]
    assert [metric.reach_m(metric.params()) for metric in METRICS.values()] == [
        0.0,
        100.0,
        0.0,
        50.0,
    ]
    assert [METRICS["lidar"].reach_m(Lidar(range_m=70.0)), METRICS["risk"].reach_m(Risk(35.0))] == [
        70.0,
        35.0,
    ]
    assert [*known_metrics()] == [*METRICS, *ON_REQUEST]
    assert len({metric.colour for metric in known_metrics().values()}) == len(known_metrics())


@pytest.mark.slow
def test_a_function_sees_the_surface_and_has_gradients_where_it_has_a_soft_form():
    def shade(surface, altitude_m, softness_m=0.0):
        return surface.crop(surface.roof_m) / altitude_m

    layer = Layer(shade, "high-is-bad", (0.0, 2.0), reach_m=10.0, soft=shade)
    metric = own_metric("shade", layer)
    pickle.loads(pickle.dumps(own_metric("noise", NOISE).compute))  # for workers
    assert (metric.dims, metric.reach_m(layer)) == (("altitude",), 10.0)
    m = metric.compute(HERE, layer)["shade"]
    np.testing.assert_allclose(
        m, np.clip(np.asarray(SURFACE.crop(SURFACE.roof_m)) / ALTITUDE_M / 2, 0, 1), rtol=1e-6
    )
    view = CASES["gps"].view()

    def total(altitude_m):
        around = SoftScene(SURFACE, altitude_m, 2.0, jnp.asarray(CELLS), 10.0, view, None, "day")
        return metric.soft(around, layer).sum()

    assert jax.grad(total)(ALTITUDE_M) < 0
    wrong = Layer(lambda surface, altitude_m: np.zeros((2, 2)), "high-is-bad", (0.0, 1.0))
    with pytest.raises(InputError, match="one value for each cell"):
        own_metric("wrong", wrong).compute(HERE, wrong)


def test_maps_say_which_layers_they_hold():
    ds = xr.Dataset(
        {name: (("y", "x"), VALUES) for name in ("risk", "gps_median", "noise", "roof")}
    )
    ds["noise"].attrs["layer"] = json.dumps(NOISE.record)
    held = held_metrics(ds)
    assert list(held) == ["gps", "risk", "noise"]
    assert held["noise"].cost(1.0) == 1.0


def test_weights_are_parsed_over_a_base_carry_any_name_and_a_name_that_is_left_out_weighs_one():
    assert Weights.parse("gps=2, risk=0", Weights(lidar=7.0)) == Weights(
        gps=2.0, lidar=7.0, risk=0.0
    )
    weights = Weights.parse("noise=2,gps=3")
    assert (weights["noise"], weights["gps"], weights["crowd"]) == (2.0, 3.0, 1.0)
    assert weights == Weights(gps=3.0, noise=2.0) == Weights.of({"noise": 2.0, "gps": 3.0})
    assert hash(weights) == hash(Weights(gps=3.0, noise=2.0))
    assert weights.replace(noise=5.0).to_dict() == {**Weights(gps=3.0).to_dict(), "noise": 5.0}
    assert weights.checked(["noise"]) == weights
    gradient = jax.grad(lambda w: w["noise"] ** 2 + w.gps)(weights)
    assert (gradient["noise"], gradient.gps, gradient.risk) == (4.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        *(
            (Gps, {"gdop_threshold": x}, "gdop_threshold must be a number above 1")
            for x in (1.0, np.nan, np.inf)
        ),
        (Gps, {"clocks": "two"}, "clocks must be 'system' or 'one', got 'two'"),
        (Dop, {"dop_threshold": 1.0}, "dop_threshold must be a number above 1"),
        (Lidar, {"beams": 0}, "beams"),
        (Lidar, {"azimuths": 2.5}, "azimuths"),
        (Lidar, {"field_of_view_deg": (-90.0, 15.0)}, "field_of_view_deg"),
        (Lidar, {"range_m": np.nan}, "range_m"),
        (Lidar, {"range_m": 0.0}, "range_m"),
        (Risk, {"threshold_m": -1.0}, "threshold_m"),
        (Risk, {"distance": "slize"}, "did you mean 'slice'"),
        (Population, {"gamma_commercial": -1.0}, "gamma_commercial must be finite"),
        (Population, {"gamma_commercial": jnp.asarray(-1.0)}, "gamma_commercial must be finite"),
        (Population, {"gamma_residential": np.nan}, "gamma_residential must be finite"),
        (Population, {"quantity": "people"}, "'density' or 'count'"),
        (Population, {"normalise": "median"}, "a percentile such as 'p95'"),
        (Population, {"normalise": "p0"}, "a percentile such as 'p95'"),
        (Population, {"normalise": 0.0}, "a positive number per km2"),
        (
            Protection,
            {"horizontal_alert_limit_m": 0.0},
            "horizontal_alert_limit_m must be positive metres",
        ),
        (IntegritySupport, {"bias_m": -1.0}, "bias_m must be 0 or more metres"),
        (IntegritySupport, {"p_const": 0.5}, "p_const must be a probability from 0 to below 0.1"),
        (
            IntegritySupport,
            {"phmi_vertical": 0.0},
            "phmi_vertical must be a probability from 1e-15 to 0.1",
        ),
        (IntegritySupport, {"tolerance_m": (0.05, 0.0)}, "tolerance_m must be positive metres"),
        (HeightStd, {"levels": -1.0}, "levels must be 0 or a positive number of metres"),
        (Heights, {"height_samples": 1}, "height_samples must be 0, for none, or from 2"),
        (Layer, LAYER | {"source": 5}, "source must be the path"),
        (Layer, LAYER | {"cost": "high"}, "cost must be 'high-is-bad' or 'low-is-bad', got 'high'"),
        (Layer, LAYER | {"scale": (1.0, 1.0)}, "two ascending numbers"),
        (Layer, LAYER | {"scale": (0.0, 1.0, 2.0)}, "scale must be two ascending numbers"),
        (Layer, LAYER | {"scale": (0.0, np.inf)}, "scale must be a finite number"),
        (Layer, LAYER | {"scale": 5.0}, "scale must be a sequence"),
        (Layer, LAYER | {"reach_m": 5.0}, "how far a function looks"),
        (Layer, LAYER | {"altitudes_m": (20.0, 20.0)}, "altitudes_m must name different altitudes"),
        (Layer, LAYER | {"altitudes_m": 20.0}, "altitudes_m must be a sequence of numbers or None"),
    ],
)
def test_a_wrong_setting_is_one_sentence(setting, value, words):
    with pytest.raises(InputError, match=words):
        setting(**value)


NAMES = (
    "gps",
    "roof",
    "distance",
    "gdop",
    "class",
    "2nd",
    "time",
    "climb",
    "descent",
    "self",
    "risk_mean",
)


@pytest.mark.parametrize("name", [*NAMES, "my noise", 5])
def test_a_layer_has_a_name_of_its_own(name):
    with pytest.raises(InputError, match="a layer"):
        check_layers({name: NOISE})


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: soft_gps(SURFACE, 20.0, 20.0, -1.0, None), "softness_m must be 0"),
        (lambda: soft_lidar(SURFACE, 20.0, Lidar(), -1.0), "softness_m must be 0"),
        (
            lambda: soft_lidar(SURFACE, 20.0, Lidar(), 1.0, reach_m=30.0),
            "that lidar range_m never exceeds, got 30",
        ),
        (
            lambda: jax.grad(lambda r: soft_lidar(SURFACE, 20.0, Lidar(range_m=r), 1.0).sum())(
                40.0
            ),
            "reach_m",
        ),
        (
            lambda: jax.grad(lambda d: soft_risk(SURFACE, 20.0, Risk(d), 1.0).sum())(40.0),
            "that risk threshold_m never exceeds",
        ),
        (lambda: day_share("nigth"), "did you mean 'night'"),
        (lambda: day_share("weekday-24"), "weekday-08"),
        *(
            (lambda given=given: Weights.of(given), "numbers by name")
            for given in (5.0, "risk", [1.0, 2.0], {1: 2.0})
        ),
        (lambda: Weights.parse("noise=x"), "name=number"),
        (lambda: Weights.parse("gps"), "name=number"),
        (lambda: Weights.parse("gps=-1"), ">= 0"),
        (lambda: Weights.parse("gps=nan"), "finite number"),
        (lambda: Weights(quiet=2.0).checked(["quite"]), r"unknown weight 'quiet'.*'quite'"),
    ],
)
def test_a_wrong_call_is_one_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()
