"""Scenario: defaults, TOML there and back, changes from outside the file, and what other maps are said to differ in."""

import json
import tomllib
from pathlib import Path
from typing import get_type_hints

import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps import provenance
from jaxurban.maps.scenario import Scenario, changed, fields_of, model_in
from jaxurban.metrics.registry import known_metrics
from jaxurban.metrics.weights import Weights
from tests.cli_runs import TOWN, assert_one_sentence, run

NOISE = {"source": "noise.tif", "cost": "high-is-bad", "scale": [0, 80]}
REGION = {"bounds": [-74.02, 40.70, -73.98, 40.73]}
MINIMAL = {"region": REGION, "buildings": {"source": "synthetic"}}
BEGIN = "2020-04-27T00:00:00Z"
SERIES = {"times": [BEGIN, "2020-04-27T00:10:00Z"], "step_s": 300}
SPREAD = {"source": "synthetic", "height_samples": 2}


def test_only_region_and_buildings_are_required():
    scenario = Scenario.from_dict(MINIMAL)
    assert scenario.gps.utc_times is None
    assert scenario.is_synthetic
    assert "layers" not in scenario.model_dump()


def test_toml_keeps_every_setting_and_paths_are_relative_to_the_file(tmp_path):
    given = MINIMAL | {"gps": {"times": ["2020-04-27T12:00:00-04:00"], "reference": [-74.0, 40.7]}}
    given |= {
        "layers": {"noise": NOISE | {"altitudes_m": [20, 60]}},
        "weights": {"noise": 2, "gps": 3},
    }
    scenario, path = Scenario.from_dict(given), tmp_path / "scenario.toml"
    path.write_text(scenario.to_toml())
    again = Scenario.from_toml(path)
    assert again.model_dump() == scenario.model_dump()
    assert again.gps.utc_times == ("2020-04-27T16:00:00Z",)
    assert again.layers["noise"].altitudes_m == (20.0, 60.0)
    assert again.weights == Weights(gps=3.0, noise=2.0)
    assert again.path_of("city.osm.pbf") == tmp_path.resolve() / "city.osm.pbf"
    assert again.path_of("/elsewhere/x.tle") == Path("/elsewhere/x.tle")


def test_a_series_of_epochs_includes_both_ends_and_survives_toml(tmp_path):
    scenario, times = (
        Scenario.from_dict(MINIMAL | {"gps": SERIES}),
        [f"2020-04-27T00:{n:02}:00Z" for n in (0, 5, 10)],
    )
    (tmp_path / "s.toml").write_text(scenario.to_toml())
    assert (
        scenario.gps.utc_times
        == Scenario.from_toml(tmp_path / "s.toml").gps.utc_times
        == tuple(times)
    )


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"lidar": {"bems": 3}}, "did you mean 'beams'"),
        ({"region": REGION | {"resolution_m": -5}}, "positive number of metres"),
        ({"region": REGION | {"altitudes_m": [20, 20]}}, "twice"),
        ({"region": {"bounds": [40.70, -120.0, 40.73, -73.98]}}, "longitude first"),
        ({"region": REGION | {"crs": "EPSG:4326"}}, "not a projected CRS"),
        ({"gps": {"times": ["2020-04-27T16:00:00Z", "2020-04-27T12:00:00-04:00"]}}, "different"),
        ({"gps": {"times": ["2020-04-27T16:00:00.5Z"]}}, "whole seconds"),
        ({"population": {"time_of_day": ["day", "day"]}}, "different names"),
        ({"population": {"time_of_day": ["noon"]}}, "noon"),
        ({"population": {"normalise": True}}, "normalise: .* got True"),
        ({"population": {"table": "P1.csv"}}, "need blocks"),
        ({"population": {"blocks": "b.shp"}}, "own population"),
        ({"terrain": {"source": "dem.tif"}}, "flat ground"),
        ({"lidar": {"field_of_view_deg": [15, -15]}}, "field_of_view_deg"),
        ({"lidar": {"beams": 10**9}}, "beams must be a whole number from 1 to 100,000"),
        (
            {"gps": SERIES | {"times": [BEGIN]}},
            "step_s needs two times, first the beginning",
        ),
        ({"planning": {"planner": "astr-plus"}}, "'astar-plus', .* got 'astr-plus'"),
        ({"region": REGION | {"altitudes_m": []}}, "altitudes_m"),
        (
            {"gps": SERIES | {"times": [BEGIN, "2020-04-26T00:00:00Z"]}},
            "first the beginning of the series",
        ),
        (
            {"gps": SERIES | {"times": ["2010-04-27T00:00:00Z", BEGIN], "step_s": 1}},
            "make it longer",
        ),
        (
            {"buildings": SPREAD, "gps": {"times": [BEGIN, "2020-04-28T00:00:00Z"], "step_s": 60}},
            "every time",
        ),
        ({"planning": {"seed": -1}}, "planning: seed must be a whole number from 0 up, got -1"),
        ({"risk": {"distance": "round"}}, "'slice' or 'solid'"),
        (
            {"weights": {"gps": 1e308}},
            r"weights: gps must be a finite number of at most 9e\+18, got 1e\+308",
        ),
        (
            {"study": {"weights": ["dirichlet"]}},
            "study.weights.0: input should be an object, got 'dirichlet'",
        ),
        ({"population": {"normalise": [1]}}, "^the scenario: population.normalise: .*"),
        ({"study": {"planners": []}}, "name at least one planner"),
        ({"study": {"altitudes_m": [60, 60]}}, "twice"),
        ({"study": {"weights": []}}, "study: weights is empty"),
        (
            {"study": {"weights": [{"gps": 1.0}, {"riks": 4.0}]}},
            r"study.weights.1: .*'riks' \(did you mean 'risk'",
        ),
        ({"weights": {"quiet": 2.0}}, "weights: unknown weight 'quiet'"),
        ({"weights": {"gps": True}}, "weights: gps must be a number"),
        ({"layers": {"noise": {"source": "n.tif"}}}, "'layers.noise.cost' is required"),
        (
            {"layers": {"noise": NOISE | {"scale": [80, 0]}}},
            "layers.noise: scale must be two ascending numbers",
        ),
        ({"layers": {"noise": NOISE | {"nan": "close"}}}, "layers.noise.nan"),
        ({"layers": {"noise": NOISE | {"sale": 1}}}, "unknown key 'layers.noise.sale' .*'scale'"),
        ({"layers": {"gps": NOISE}}, "cannot be called 'gps'"),
        ({"layers": {"my noise": NOISE}}, "letters, digits and _"),
        (
            {"study": {"weights": [{"gps": -1.0}]}},
            "study.weights.0: weight gps must be a finite number >= 0",
        ),
    ],
)
def test_a_bad_setting_is_one_sentence(settings, words):
    with pytest.raises(InputError, match=words) as caught:
        Scenario.from_dict(MINIMAL | settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"[region\n", b"\xff\xfe\x00"])
def test_missing_and_broken_files_are_one_sentence(tmp_path, content):
    if content is not None:
        (tmp_path / "file.toml").write_bytes(content)
    words = (
        "does not exist: check the path"
        if content is None
        else "cannot be read as a scenario in TOML"
    )
    with pytest.raises(InputError, match=words):
        Scenario.from_toml(tmp_path / "file.toml")


def test_a_mark_of_utf_8_before_a_scenario_is_passed_over(tmp_path):
    (tmp_path / "town.toml").write_bytes(b"\xef\xbb\xbf" + TOWN.encode())
    assert Scenario.from_toml(tmp_path / "town.toml").buildings.source == "synthetic"


@pytest.mark.parametrize("path", [r"C:\data\b.gpkg", r"C:\Users\me\b.gpkg", r"\\server\x"])
def test_a_path_with_backslashes_in_double_quotes_is_refused_with_how_to_write_it(tmp_path, path):
    file = tmp_path / "town.toml"
    file.write_text(TOWN.replace('"synthetic"', f'"{path}"'))
    with pytest.raises(InputError, match="in TOML") as caught:
        Scenario.from_toml(file)
    assert """write "/" or '...' for "\\" in double quotes""" in str(caught.value)
    file.write_text(TOWN.replace('"synthetic"', f"'{path}'"))
    assert Scenario.from_toml(file).buildings.source == path


@pytest.fixture
def file(tmp_path) -> Path:
    (tmp_path / "town.toml").write_text(TOWN, encoding="utf-8")
    return tmp_path / "town.toml"


def test_values_are_read_as_toml(file):
    changes = (
        "gps.mask_deg=10",
        "region.altitudes_m=[30, 60]",
        "buildings . level_height_m = 2.5",
        "weights.risk=2",
    )
    made = Scenario.from_toml(file, [*changes, 'planning.cost_model="line"'])
    assert (made.gps.mask_deg, made.region.altitudes_m, made.buildings.level_height_m) == (
        10.0,
        (30.0, 60.0),
        2.5,
    )
    assert (made.weights.risk, made.planning.cost_model) == (2.0, "line")


def test_a_change_is_as_if_the_file_said_it(file, tmp_path):
    (tmp_path / "other.toml").write_text(
        TOWN.replace("[20, 60]", "[20]") + "[gps]\nmask_deg = 7\n", encoding="utf-8"
    )
    other = Scenario.from_toml(tmp_path / "other.toml")
    there = Scenario.from_toml(
        file, ["region.altitudes_m=[20]", "gps.mask_deg=3", "gps.mask_deg=7"]
    )
    assert there == other
    assert provenance.run_key(there, {}, "cpu") == provenance.run_key(other, {}, "cpu")


def test_the_settings_that_are_given_stay_as_they_are():
    given = {"gps": {"mask_deg": 5}, "region": {"altitudes_m": [20]}}
    copy = json.loads(json.dumps(given))
    assert changed(given, ["gps.mask_deg=9", "lidar.range_m=50"])["lidar"] == {"range_m": 50}
    assert given == copy


def test_keys_of_a_scenario_are_those_of_its_record(file):
    record = provenance.settings_of(Scenario.from_toml(file))
    known = {
        name: fields_of(model)
        for name, kind in fields_of(Scenario).items()
        if (model := model_in(kind))
    }
    assert [
        f"{s}.{k}"
        for s, keys in record.items()
        if s != "weights"
        for k in keys
        if k not in known[s]
    ] == []


@pytest.mark.slow
def test_a_folder_of_other_maps_says_which_settings_differ(job, file, capsys):
    assert (
        run(capsys, "maps", file, "-o", job, "--set", "weights.gps=3", "--set", "planning.seed=2")[
            0
        ]
        == 0
    )
    code, _, err = run(
        capsys, "maps", file, "-o", job, "--set", "gps.mask_deg=10", "--set", "gps.max_age_days=3.5"
    )
    assert code == 2
    assert_one_sentence(
        err, "gps.mask_deg was 5.0, now 10.0; gps.max_age_days was 90.0, now 3.5", "--overwrite"
    )


def test_a_folder_of_other_files_or_versions_says_so(job, monkeypatch):
    scenario = Scenario.from_dict(tomllib.loads(TOWN))
    found = provenance.other_maps(job, scenario, {"terrain": {"path": "t.tif", "sha256": "1"}})
    words = "maps of other settings, input files or versions"
    assert found == f"{words} (inputs.terrain was not set, now '1')"
    assert "other code" in provenance.other_maps(job, scenario, {})
    made_by = json.loads((job / "run.json").read_text())["versions"]
    monkeypatch.setattr(provenance, "versions", lambda: made_by | {"jax": "9"})
    assert f"{words} (versions.jax was" in provenance.other_maps(job, scenario, {})
    (job / "run.json").unlink()
    assert "other code" in provenance.other_maps(job, scenario, {})


def test_of_many_differences_the_first_are_said():
    old, new = ({"s": {f"k{n}": n * factor for n in range(1, 10)}} for factor in (1, 2))
    said = provenance.differences_said(provenance.differing(old, new | {"t": {"x": 1}}))
    assert said.startswith("s.k1 was 1, now 2; ")
    assert said.endswith("and 4 more")
    assert provenance.differing({"a": {"b": None}}, {"a": {}}) == {}
    assert provenance.differing({"a": {"b": 1}}, {}) == {"a.b": (1, None)}


@pytest.mark.parametrize("function", [ju.build_maps, ju.grad.map_inputs])
def test_scenarios_and_maps_take_the_sections_of_every_metric(function):
    sections = {name: metric.params for name, metric in known_metrics().items()}
    fields = Scenario.model_fields
    assert [name for name in fields if name in sections] == [*sections]
    arguments = {name: hint for name, hint in get_type_hints(function).items() if name in sections}
    assert arguments == {name: params | None for name, params in sections.items()}
    for name, params in sections.items():
        assert fields[name].annotation in (params, params | None)
