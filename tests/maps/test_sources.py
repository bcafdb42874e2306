"""The city behind a folder of maps: read again only from files that are still those of the run."""

import os
import shutil

import numpy as np
import pytest
from shapely import box

import jaxurban as ju
from jaxurban.io.files import read_json, write_json
from jaxurban.io.store import RUN_FILE
from jaxurban.maps import provenance
from jaxurban.maps.run import run_scenario
from jaxurban.maps.sources import city_of
from tests.cli_runs import write_city
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("town")
    write_city(folder, box(-73.998, 40.757, -73.997, 40.758))
    return folder


@pytest.fixture(scope="module")
def maps(folder):
    scenario = ju.Scenario.from_toml(folder / "town.toml")
    run_scenario(scenario, folder / "maps", progress=False)
    return folder / "maps"


@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_the_city_is_found_beside_its_maps_and_where_it_is_named(folder, maps, tmp_path):
    beside = city_of(maps)
    opened = city_of(ju.open_maps(maps))
    np.testing.assert_array_equal(beside.buildings.height_m, [30.0])
    assert beside.facts == opened.facts
    assert city_of(beside) is beside
    (tmp_path / "city.geojson").write_bytes((folder / "city.geojson").read_bytes())
    assert city_of(maps, tmp_path).facts == beside.facts


def test_a_file_that_is_gone_or_changed_is_named(folder, maps, tmp_path):
    (tmp_path / "city.geojson").write_bytes((folder / "city.geojson").read_bytes() + b" ")
    (tmp_path / "none").mkdir()
    for place in (tmp_path, tmp_path / "none"):
        with pytest.raises(ju.InputError, match=r"no longer there as it was \('city\.geojson'\)"):
            city_of(maps, place)
    with pytest.raises(ju.InputError, match="sources must be a folder"):
        city_of(maps, tmp_path / "nowhere")


def test_maps_in_memory_or_saved_from_python_ask_for_the_city(tmp_path):
    made = made_maps(8, 9)
    with pytest.raises(ju.InputError, match="made in memory do not hold their city"):
        city_of(made)
    with pytest.raises(ju.InputError, match="not made by `jaxurban maps`"):
        city_of(made.save(tmp_path))


def test_a_record_of_somebody_else_names_no_file_that_is_read(maps, tmp_path):
    record = read_json(maps / RUN_FILE)
    del record["settings"]["region"]["bounds"]
    write_json(tmp_path / RUN_FILE, record)
    with pytest.raises(ju.InputError, match="not made by `jaxurban maps`"):
        city_of(tmp_path)


def changed_record(folder, to, **source):
    """Write a copy of a folder's record in which the buildings and what is on record of them are others."""
    record = read_json(folder / RUN_FILE)
    record["settings"]["buildings"]["source"] = source.pop("path")
    record["inputs"]["buildings"] |= source
    to.mkdir(exist_ok=True)
    write_json(to / RUN_FILE, record)
    return to


def test_a_recorded_file_that_is_huge_endless_or_of_the_system_is_refused_unread(
    maps, tmp_path, monkeypatch
):
    huge, pipe, link = (tmp_path / name for name in ("huge.geojson", "pipe", "link.geojson"))
    with huge.open("wb") as file:
        file.truncate(200 * 2**30)
    os.mkfifo(pipe)
    link.symlink_to("/proc/self/status")
    monkeypatch.setattr(provenance, "digest_of", lambda path: pytest.fail(f"{path} was read"))
    for path in (huge, pipe, link, "/proc/self/status", "/dev/zero", "/sys/kernel/notes"):
        for size in ({"bytes": 12}, {"bytes": 0}):
            folder = changed_record(maps, tmp_path / "of-others", path=str(path), **size)
            with pytest.raises(ju.InputError, match="no longer there as it was"):
                city_of(folder)
    record = read_json(maps / RUN_FILE)
    del record["inputs"]["buildings"]["bytes"]
    record["settings"]["buildings"]["source"] = str(huge)
    write_json(tmp_path / RUN_FILE, record)
    with pytest.raises(ju.InputError, match=r"\('.*huge\.geojson'\)"):
        city_of(tmp_path)


@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_maps_whose_record_has_no_sizes_are_those_of_the_same_files(folder, maps, tmp_path):
    scenario = ju.Scenario.from_toml(folder / "town.toml")
    inputs = provenance.hash_inputs(scenario)
    assert inputs["buildings"]["bytes"] == (folder / "city.geojson").stat().st_size
    key = read_json(maps / RUN_FILE)["run_key"]
    old = provenance.unsized(inputs)
    assert provenance.run_key(scenario, old, "cpu") == provenance.run_key(scenario, inputs, "cpu")
    record = read_json(maps / RUN_FILE) | {"inputs": old}
    shutil.copytree(maps, tmp_path / "maps")
    write_json(tmp_path / "maps" / RUN_FILE, record)
    assert city_of(tmp_path / "maps", folder).facts == city_of(maps).facts
    chunk = next((tmp_path / "maps").rglob(".zmetadata"))
    written = chunk.stat().st_mtime_ns
    run_scenario(scenario, tmp_path / "maps", progress=False)
    assert read_json(tmp_path / "maps" / RUN_FILE)["run_key"] == key
    assert chunk.stat().st_mtime_ns == written  # kept, not made again


@pytest.mark.parametrize("inputs", [[], "x", {"buildings": "x"}, None])
def test_damaged_inputs_of_a_record_end_in_a_sentence(maps, tmp_path, inputs):
    write_json(tmp_path / RUN_FILE, read_json(maps / RUN_FILE) | {"inputs": inputs})
    with pytest.raises(ju.InputError, match="as a run records them"):
        city_of(tmp_path)
