"""Numba and JAX make the same maps, bit for bit; which of them runs is chosen once, recorded, and changes no folder."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.kernels.engine import chosen, runs_numba
from jaxurban.maps.build import compute_maps
from jaxurban.maps.run import make_zarr
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics import lidar, risk, visibility
from jaxurban.progress import Report
from tests.cli_runs import assert_one_sentence, run
from tests.hanging_city import city as hanging_city
from tests.maps.test_slabs import PARAMS, REGION
from tests.tiled_runs import RAGGED, city, maker, sky, task

NUMBA = {visibility: "mark_visible", lidar: "count_on_host", risk: "distance_on_host"}
SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.993, 40.761]
resolution_m = 20
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
"""


def both(of: MapTask):
    """Return the datasets of a task by Numba and by JAX."""
    return [compute_maps(replace(of, params=replace(of.params, engine=engine))).ds for engine in ("numba", "jax")]


def assert_same(numba, jaxs):
    assert {*numba} == {*jaxs}
    for name in numba:
        np.testing.assert_array_equal(jaxs[name].values, numba[name].values, err_msg=name)


@pytest.fixture
def called(monkeypatch):
    """The forms of Numba that were called."""
    names = []

    def counted(name, form):
        return lambda *arguments, **options: names.append(name) or form(*arguments, **options)

    for module, name in NUMBA.items():
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return names


def test_jax_gives_the_bits_of_numba_for_two_constellations_and_calls_no_form_of_it(called):
    of = task(city())
    of = replace(of, sky=replace(sky(), systems=("gps", "galileo") * 3), params=replace(of.params, engine="numba"))
    numba = compute_maps(of).ds
    assert {*called} == {*NUMBA.values()}
    called.clear()
    jaxs = compute_maps(replace(of, params=replace(of.params, engine="jax"))).ds
    assert not called
    assert_same(numba, jaxs)
    for name in ("num_visible", "lidar", "risk"):
        assert len(np.unique(numba[name])) > 4, name


@pytest.mark.slow
def test_over_terrain_around_slabs_and_on_finer_cells_the_bits_are_equal():
    params = replace(PARAMS, altitudes_m=(2.0, 13.0))
    solid = replace(params, sections=params.sections | {"risk": ju.Risk(distance="solid")})
    finer = replace(params, oversample=3, sections=params.sections | {"gps": ju.Gps(bounds=True)})
    for each in (params, solid, finer):
        assert_same(*both(MapTask(hanging_city(with_terrain=True), REGION, sky(), each)))


@pytest.mark.slow
def test_tiles_of_jax_are_the_whole_map_of_numba(tmp_path):
    of = city(with_terrain=True)
    whole, made = both(task(of))[0], maker(tmp_path, of)
    params = replace(made.task.params, engine="jax")
    make_zarr(replace(made, task=replace(made.task, params=params)), Report(), RAGGED)
    assert_same(whole, store.open_zarr(tmp_path, None))


@pytest.mark.slow
@pytest.mark.data
def test_on_lower_manhattan_the_bits_are_equal(data_dir):
    bounds = (-74.02, 40.70, -73.98, 40.73)
    town = ju.City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=bounds)
    orbits = data_dir / "gps" / "gps-ops_2020-04-27.tle"
    assert_same(
        *(
            ju.build_maps(town, bounds, altitudes_m=(20.0, 60.0, 122.0), engine=engine, gps=ju.Gps(orbits=orbits)).ds
            for engine in ("numba", "jax")
        )
    )


def test_what_is_traced_is_jaxs_and_auto_is_numba_on_a_cpu_alone():
    assert (chosen("auto", "cpu"), chosen("auto", "gpu"), chosen("numba", "gpu")) == ("numba", "jax", "numba")
    traced = []
    jax.jit(lambda values: traced.append(runs_numba("numba", values)) or values)(np.zeros(3))
    assert traced == [False]
    assert runs_numba("numba", np.zeros(3))
    assert not runs_numba("jax", np.zeros(3))


def test_a_wrong_engine_is_one_sentence(tmp_path, capsys):
    sentence = r"engine must be 'auto', 'numba' or 'jax', got 'jx' \(did you mean 'jax'\?\)"
    with pytest.raises(InputError, match=sentence):
        ju.build_maps(ju.demo_city(400, 400), engine="jx")
    with pytest.raises(InputError, match=sentence):
        MapParams(engine="jx")
    (tmp_path / "town.toml").write_text(SCENARIO)
    code, _, err = run(capsys, "maps", tmp_path / "town.toml", "-o", tmp_path, "--set", "region.engine='jx'")
    assert code == 2
    assert_one_sentence(err, "region.engine", "'auto', 'numba' or 'jax'")
    assert run(capsys, "maps", tmp_path / "town.toml", "-o", tmp_path, "--engine", "jx")[0] == 2


def test_a_run_records_its_engine_and_another_one_keeps_its_maps(tmp_path, capsys, called):
    (tmp_path / "town.toml").write_text(SCENARIO)
    command = "maps", tmp_path / "town.toml", "-o", tmp_path / "out"
    assert run(capsys, *command, "--engine", "jax")[0] == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (record["engine"], record["settings"]["region"]["engine"]) == ("jax", "jax")
    assert run(capsys, *command)[0] == 0
    again = json.loads((tmp_path / "out" / "run.json").read_text())
    assert not called
    assert (again["engine"], again["settings"]["region"]["engine"]) == ("jax", "auto")
    assert run(capsys, *command, "--overwrite", "--set", "lidar.beams=3")[0] == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["engine"] == "numba"
    assert called


def test_numba_beside_a_gpu_is_planned_and_recorded_as_on_a_cpu(tmp_path, monkeypatch):
    scenario = ju.Scenario.from_dict(
        {
            "region": {
                "bounds": [-74.0, 40.755, -73.993, 40.761],
                "resolution_m": 20,
                "altitudes_m": [60],
                "engine": "numba",
            }
        }
        | {"buildings": {"source": "synthetic"}}
    )
    from jaxurban.maps.run import run_scenario

    monkeypatch.setattr("jaxurban.maps.run.jax.default_backend", lambda: "gpu")
    monkeypatch.setattr("jaxurban.maps.memory.gpu_free_bytes", lambda: 1)
    made = run_scenario(scenario, tmp_path / "beside", progress=False).record
    monkeypatch.undo()
    assert made["run_key"] == run_scenario(scenario, tmp_path / "beside", progress=False).record["run_key"]
    assert made["engine"] == "numba"
