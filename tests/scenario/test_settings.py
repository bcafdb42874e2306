"""Scenario: defaults, TOML there and back, one sentence an error."""

import tomllib
from pathlib import Path

import jax
import pytest

from jaxurban.errors import InputError
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.weights import Weights

NOISE = {"source": "noise.tif", "cost": "high-is-bad", "scale": [0, 80]}
MINIMAL = {"region": {"bounds": [-74.02, 40.70, -73.98, 40.73]}, "buildings": {"source": "synthetic"}}


def test_only_region_and_buildings_are_required():
    scenario = Scenario.from_dict(MINIMAL)
    assert scenario.region.altitudes_m == (20.0, 60.0, 122.0, 600.0)
    assert scenario.gps.utc_times is None
    assert scenario.weights.distance == 0.1
    assert scenario.is_synthetic


def test_toml_round_trip_keeps_every_setting(tmp_path):
    scenario = Scenario.from_dict(
        MINIMAL | {"gps": {"times": ["2020-04-27T12:00:00-04:00"], "reference": [-74.0, 40.7]}}
    )
    path = tmp_path / "scenario.toml"
    path.write_text(scenario.to_toml())
    again = Scenario.from_toml(path)
    assert again.model_dump() == scenario.model_dump()
    assert again.gps.utc_times == ("2020-04-27T16:00:00Z",)


def test_a_layer_of_ones_own_and_its_weight_survive_toml(tmp_path):
    given = MINIMAL | {"layers": {"noise": NOISE | {"altitudes_m": [20, 60]}}, "weights": {"noise": 2, "gps": 3}}
    (tmp_path / "s.toml").write_text(Scenario.from_dict(given).to_toml())
    scenario = Scenario.from_toml(tmp_path / "s.toml")
    assert scenario.layers["noise"].altitudes_m == (20.0, 60.0)
    assert scenario.weights == Weights(gps=3.0, noise=2.0)
    assert "layers" not in Scenario.from_dict(MINIMAL).model_dump()


def test_a_section_is_the_metrics_own_parameters_and_has_gradients():
    scenario = Scenario.from_dict(MINIMAL | {"risk": {"threshold_m": 30}, "gps": {"gdop_threshold": 10}})
    assert scenario.risk == Risk(30.0)
    assert isinstance(scenario.gps, Gps)
    assert jax.grad(lambda risk: risk.threshold_m**2)(scenario.risk).threshold_m == 60.0
    assert jax.grad(lambda gps: gps.gdop_threshold**2)(scenario.gps).gdop_threshold == 20.0


def test_paths_are_relative_to_the_file(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(tomllib_text({"buildings": 'source = "city.osm.pbf"'}))
    scenario = Scenario.from_toml(path)
    assert scenario.path_of(scenario.buildings.source) == tmp_path.resolve() / "city.osm.pbf"
    assert scenario.path_of("/elsewhere/x.tle") == Path("/elsewhere/x.tle")


def tomllib_text(extra: dict[str, str]) -> str:
    text = "[region]\nbounds = [-74.02, 40.70, -73.98, 40.73]\n"
    text += "".join(f"[{section}]\n{line}\n" for section, line in extra.items())
    tomllib.loads(text)
    return text


def test_a_time_series_survives_toml(tmp_path):
    series = {"start": "2020-04-27T00:00:00Z", "stop": "2020-04-27T01:00:00Z", "step_s": 600}
    (tmp_path / "s.toml").write_text(Scenario.from_dict(MINIMAL | {"gps": series}).to_toml())
    assert len(Scenario.from_toml(tmp_path / "s.toml").gps.utc_times) == 7


def test_a_series_of_epochs_includes_both_ends():
    series = {"start": "2020-04-27T00:00:00Z", "stop": "2020-04-27T00:10:00Z", "step_s": 300}
    times = Scenario.from_dict(MINIMAL | {"gps": series}).gps.utc_times
    assert times == ("2020-04-27T00:00:00Z", "2020-04-27T00:05:00Z", "2020-04-27T00:10:00Z")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"region": {"bounds": [-74.02, 40.70, -73.98, 40.73], "resolution": 5}}, "'resolution_m'"),
        ({"regoin": {}}, "did you mean 'region'"),
        ({"lidar": {"bems": 3}}, "did you mean 'beams'"),
        ({"region": {"bounds": [-74.02, 40.70, -73.98, 40.73], "resolution_m": -5}}, "greater than 0"),
        ({"region": {"bounds": [-74.02, 40.70, -73.98, 40.73], "altitudes_m": [20, 20]}}, "twice"),
        ({"region": {"bounds": [40.70, -120.0, 40.73, -73.98]}}, "longitude first"),
        ({"region": {"bounds": [-74.02, 40.70, -73.98, 40.73], "crs": "EPSG:4326"}}, "not a projected CRS"),
        ({"gps": {"times": []}}, "times must be different"),
        ({"gps": {"times": ["2020-04-27T16:00:00Z", "2020-04-27T12:00:00-04:00"]}}, "different"),
        ({"gps": {"times": ["2020-04-27T16:00:00.5Z"]}}, "whole seconds"),
        ({"population": {"time_of_day": ["day", "day"]}}, "different names"),
        ({"population": {"time_of_day": ["noon"]}}, "noon"),
        ({"population": {"normalise": "mx"}}, "normalise"),
        ({"population": {"normalise": True}}, "normalise cannot be true"),
        ({"population": {"table": "P1.csv"}}, "need blocks"),
        ({"population": {"blocks": "b.shp"}}, "own population"),
        ({"terrain": {"source": "dem.tif"}}, "flat ground"),
        ({"lidar": {"field_of_view_deg": [15, -15]}}, "field_of_view_deg"),
        ({"lidar": {"beams": 10**9}}, "beams must be a whole number from 1 to 100,000"),
        ({"planning": {"planner": "astr-plus"}}, "did you mean 'astar-plus'"),
        ({"gps": {"times": ["noon"]}}, "gps: 'noon' is not a time"),
        ({"gps": {"start": "2020-04-27T00:00:00Z"}}, "needs all of start, stop and step_s"),
        (
            {"gps": {"start": "2020-04-27T00:00:00", "stop": "2020-04-26T00:00:00Z", "step_s": 60}},
            "stop, 2020-04-26.*, is before start",
        ),
        ({"gps": {"start": "2010-04-27T00:00:00Z", "stop": "2020-04-26T00:00:00Z", "step_s": 1}}, "make step_s longer"),
        (
            {
                "buildings": {"source": "synthetic", "height_samples": 2},
                "gps": {"start": "2020-04-27T00:00:00Z", "stop": "2020-04-28T00:00:00Z", "step_s": 60},
            },
            "every time",
        ),
        ({"planning": {"seed": -1}}, "planning: seed must be a whole number from 0 up, got -1"),
        ({"gps": {"mask_deg": 90}}, "less than 90"),
        ({"weights": {"risk": -1}}, "weights: weight risk must be a finite number >= 0"),
        ({"risk": {"distance": "round"}}, "'slice' or 'solid'"),
        ({"weights": {"gps": 1e308}}, r"weights: gps must be a finite number of at most 9e\+18, got 1e\+308"),
        ({"study": {"weights": ["dirichlet"]}}, "study.weights.0: must be a table of settings, got 'dirichlet'"),
        ({"population": {"normalise": [1]}}, "^the scenario: population.normalise: .*"),
        ({"study": {"planners": []}}, "name at least one planner"),
        ({"study": {"altitudes_m": [60, 60]}}, "twice"),
        ({"study": {"weights": []}}, "study.weights: must be 'dirichlet' or a list"),
        ({"study": {"weights": "uniform"}}, "must be 'dirichlet' or a list such as .*, got 'uniform'"),
        (
            {"study": {"weights": [{"gps": 1.0}, {"riks": 4.0}]}},
            r"study.weights.1: unknown weight 'riks' \(did you mean 'risk'",
        ),
        ({"weights": {"noise": 2.0}}, "weights: unknown weight 'noise'"),
        ({"weights": {"gps": True}}, "weights: gps must be a number"),
        ({"layers": {"noise": {"source": "n.tif"}}}, "'layers.noise.cost' is required"),
        ({"layers": {"noise": NOISE | {"scale": [80, 0]}}}, "layers.noise: scale must be two ascending numbers"),
        ({"layers": {"noise": NOISE | {"cost": "low"}}}, "layers.noise.cost: input should be 'high-is-bad'"),
        ({"layers": {"noise": NOISE | {"nan": "close"}}}, "layers.noise.nan"),
        ({"layers": {"noise": NOISE | {"sale": 1}}}, "unknown key 'layers.noise.sale' .*'scale'"),
        ({"layers": {"gps": NOISE}}, "cannot be called 'gps'"),
        ({"layers": {"my noise": NOISE}}, "letters, digits and _"),
        ({"study": {"weights": [{"gps": -1.0}]}}, "study.weights.0: weight gps must be a finite number >= 0"),
    ],
)
def test_a_bad_setting_is_one_sentence(settings, words):
    with pytest.raises(InputError, match=words) as caught:
        Scenario.from_dict(MINIMAL | settings)
    assert "\n" not in str(caught.value)


def test_missing_and_broken_files_are_one_sentence(tmp_path):
    with pytest.raises(InputError, match="does not exist: check the path"):
        Scenario.from_toml(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("[region\n")
    with pytest.raises(InputError, match="cannot be read as a scenario in TOML"):
        Scenario.from_toml(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read as a scenario in TOML"):
        Scenario.from_toml(broken)
