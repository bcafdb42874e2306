"""What metrics refuse, each in one sentence with its remedy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.metrics.custom import Layer, check_layers
from jaxurban.metrics.gps import Dop, Gps, soft_gps
from jaxurban.metrics.lidar import Lidar, soft_lidar
from jaxurban.metrics.population import Population, day_share
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.risk import Risk, soft_risk
from jaxurban.metrics.weights import Weights
from tests.metrics.soft.scene import BUILDING, HEIGHT_M, surface_of

SURFACE = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
LAYER = {"source": "n.tif", "cost": "high-is-bad", "scale": (0.0, 80.0)}
NOISE = Layer(**LAYER)


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        *((Gps, {"gdop_threshold": x}, "gdop_threshold must be a number above 1") for x in (1.0, np.nan, np.inf)),
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
        (Population, {"weekday": (1.0,) * 23}, "24 shares"),
        (Protection, {"horizontal_alert_limit_m": 0.0}, "horizontal_alert_limit_m must be positive metres"),
        (Protection, {"bias_m": -1.0}, "bias_m must be 0 or more metres"),
        (Protection, {"p_const": 0.5}, "p_const must be a probability from 0 to below 0.1"),
        (Protection, {"phmi_vertical": 0.0}, "phmi_vertical must be a probability from 1e-15 to 0.1"),
        (Protection, {"tolerance_m": (0.05, 0.0)}, "tolerance_m must be positive metres"),
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


NAMES = "gps", "roof", "distance", "gdop", "class", "2nd", "time", "climb", "descent", "self", "risk_mean"


@pytest.mark.parametrize("name", [*NAMES, "my noise", 5])
def test_a_layer_has_a_name_of_its_own(name):
    with pytest.raises(InputError, match="a layer"):
        check_layers({name: NOISE})


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: soft_gps(SURFACE, 20.0, 20.0, -1.0, None), "softness_m must be 0"),
        (lambda: soft_lidar(SURFACE, 20.0, Lidar(), -1.0), "softness_m must be 0"),
        (lambda: soft_lidar(SURFACE, 20.0, Lidar(), 1.0, reach_m=30.0), "at least lidar range_m, 100 m"),
        (lambda: jax.grad(lambda r: soft_lidar(SURFACE, 20.0, Lidar(range_m=r), 1.0).sum())(40.0), "reach_m"),
        (lambda: jax.grad(lambda d: soft_risk(SURFACE, 20.0, Risk(d), 1.0).sum())(40.0), "by JAX: give reach_m"),
        (lambda: day_share("nigth"), "did you mean 'night'"),
        (lambda: day_share("weekday-24"), "weekday-08"),
        *((lambda given=given: Weights.of(given), "numbers by name") for given in (5.0, "risk", [1.0, 2.0], {1: 2.0})),
        (lambda: Weights.parse("noise=x"), "name=number"),
        (lambda: Weights.parse("gps"), "name=number"),
        (lambda: Weights.parse("gps=-1"), ">= 0"),
        (lambda: Weights.parse("gps=nan"), "finite number"),
        (lambda: Weights(noise=2.0).checked(["nois"]), r"unknown weight 'noise'.*'nois'"),
    ],
)
def test_a_wrong_call_is_one_sentence(call, words):
    with pytest.raises(InputError, match=words):
        call()
