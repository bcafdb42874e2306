"""Settings changed from outside the file, and what a folder of other maps is told to differ in."""

import json
from pathlib import Path

import pytest

from jaxurban.maps import provenance
from jaxurban.maps.provenance import differences_said, differing
from jaxurban.maps.scenario import Scenario, changed
from tests.campaign.settings import keys_of
from tests.cli_runs import assert_one_sentence, run

TEXT = """
[region]
bounds = [-74.0, 40.755, -73.993, 40.761]
resolution_m = 20
altitudes_m = [20]
[buildings]
source = "synthetic"
[population]
time_of_day = ["day"]
"""


@pytest.fixture
def file(tmp_path) -> Path:
    (tmp_path / "town.toml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "town.toml"


@pytest.mark.parametrize(
    ("change", "section", "name", "value"),
    [
        ("gps.mask_deg=10", "gps", "mask_deg", 10.0),
        ("region.altitudes_m=[30, 60]", "region", "altitudes_m", (30.0, 60.0)),
        ("buildings . level_height_m = 2.5", "buildings", "level_height_m", 2.5),
        ('planning.cost_model="line"', "planning", "cost_model", "line"),
        ("weights.risk=2", "weights", "risk", 2.0),
    ],
)
def test_a_value_is_read_as_toml(file, change, section, name, value):
    scenario = Scenario.from_toml(file, [change])
    assert getattr(getattr(scenario, section), name) == value


def test_a_change_is_as_if_the_file_said_it(file, tmp_path):
    (tmp_path / "other.toml").write_text(TEXT.replace("[20]", "[20, 60]") + "[gps]\nmask_deg = 7\n", encoding="utf-8")
    there = Scenario.from_toml(file, ["region.altitudes_m=[20, 60]", "gps.mask_deg=3", "gps.mask_deg=7"])
    assert there == Scenario.from_toml(tmp_path / "other.toml")
    assert provenance.run_key(there, {}, "cpu") == provenance.run_key(
        Scenario.from_toml(tmp_path / "other.toml"), {}, "cpu"
    )


def test_the_settings_that_are_given_stay_as_they_are():
    given = {"gps": {"mask_deg": 5}, "region": {"altitudes_m": [20]}}
    copy = json.loads(json.dumps(given))
    assert changed(given, ["gps.mask_deg=9", "lidar.range_m=50"])["lidar"] == {"range_m": 50}
    assert given == copy


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("gps.mask_degree=10", ("'gps.mask_degree'", "'mask_deg'")),
        ("mask_deg=10", ("unknown section 'mask_deg'", "gps, ")),
        ("region.range_m=10", ("'region.range_m'", "bounds, ")),
        ("gsp.mask_deg=10", ("'gsp'", "'gps'")),
        ("gps.mask_deg", ("key=value",)),
        ("buildings.source=town.osm", ("not TOML", "quotes")),
        ("gps.mask_deg=true", ("mask_deg",)),
        ("gps.mask_deg=95", ("gps.mask_deg", "--set gps.mask_deg=95")),
        ("region=5", ("region", "table of settings")),
        ("weights.gsp=2", ("'gsp'",)),
    ],
)
def test_a_wrong_change_is_one_sentence_that_names_near_keys(file, change, words, capsys, tmp_path):
    code, _, err = run(capsys, "maps", file, "-o", tmp_path / "out", "--set", change)
    assert code == 2
    assert_one_sentence(err, *words)
    assert not (tmp_path / "out").exists()


def test_keys_of_a_scenario_are_those_of_its_record(file):
    record = provenance.settings_of(Scenario.from_toml(file))
    known = keys_of(Scenario)
    assert [f"{s}.{k}" for s, keys in record.items() if s != "weights" for k in keys if f"{s}.{k}" not in known] == []


def test_a_folder_of_other_maps_says_which_settings_differ(file, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    assert run(capsys, "maps", file, "-o", out, "--set", "weights.gps=3", "--set", "planning.seed=2")[0] == 0
    code, _, err = run(capsys, "maps", file, "-o", out, "--set", "gps.mask_deg=10", "--set", "gps.max_age_days=3.5")
    assert code == 2
    assert_one_sentence(err, "gps.mask_deg was 5.0, now 10.0; gps.max_age_days was 90.0, now 3.5", "--overwrite")


def test_a_folder_of_other_files_or_versions_says_so(file, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    scenario = Scenario.from_toml(file)
    found = provenance.other_maps(out, scenario, {"terrain": {"path": "t.tif", "sha256": "1"}})
    assert found == "maps of other input files (terrain: what they hold has changed)"
    assert "other code" in provenance.other_maps(out, scenario, {})
    monkeypatch.setattr(
        provenance, "versions", lambda: {**json.loads((out / "run.json").read_text())["versions"], "jax": "9"}
    )
    assert "maps made by other versions (jax was" in provenance.other_maps(out, scenario, {})
    (out / "run.json").unlink()
    assert "or made by another version" in provenance.other_maps(out, scenario, {})


def test_of_many_differences_the_first_are_said():
    old, new = ({"s": {f"k{n}": n * factor for n in range(1, 10)}} for factor in (1, 2))
    said = differences_said(differing(old, new | {"t": {"x": 1}}))
    assert said.startswith("s.k1 was 1, now 2; ")
    assert said.endswith("and 4 more")
    assert differing({"a": {"b": None}}, {"a": {}}) == {}
    assert differing({"a": {"b": 1}}, {}) == {"a.b": (1, None)}
