"""Numba and JAX make the same maps, bit for bit; which of them runs is chosen once and recorded."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.kernels.engine import chosen, runs_numba
from jaxurban.maps.build import compute_maps
from jaxurban.maps.run import run_scenario
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics import lidar, risk, visibility
from tests import hanging_city
from tests.cli_runs import TOWN, run
from tests.tiled_runs import city, sky, task

NUMBA = {visibility: "mark_visible", lidar: "count_on_host", risk: "distance_on_host"}


def both(of: MapTask):
    """Return the datasets of a task by Numba and by JAX."""
    return [
        compute_maps(replace(of, params=replace(of.params, engine=engine))).ds
        for engine in ("numba", "jax")
    ]


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
    of = replace(
        of,
        sky=replace(sky(), systems=("gps", "galileo") * 3),
        params=replace(of.params, engine="numba"),
    )
    numba = compute_maps(of).ds
    assert {*called} == {*NUMBA.values()}
    called.clear()
    jaxs = compute_maps(replace(of, params=replace(of.params, engine="jax"))).ds
    assert not called
    xr.testing.assert_equal(jaxs, numba)
    for name in ("num_visible", "lidar", "risk"):
        assert len(np.unique(numba[name])) > 4, name


@pytest.mark.slow
def test_over_terrain_around_slabs_and_on_finer_cells_the_bits_are_equal():
    of = hanging_city.task(hanging_city.city(with_terrain=True), altitudes_m=(2.0, 13.0))
    sections = of.params.sections
    solid = {"sections": sections | {"risk": ju.Risk(distance="solid")}}
    finer = {"sections": sections | {"gps": ju.Gps(bounds=True)}, "oversample": 3}
    for settings in ({}, solid, finer):
        xr.testing.assert_equal(*both(replace(of, params=replace(of.params, **settings))))


@pytest.mark.slow
@pytest.mark.data
def test_on_lower_manhattan_the_bits_are_equal(data_dir):
    bounds = (-74.02, 40.70, -73.98, 40.73)
    town = ju.City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=bounds)
    gps = ju.Gps(orbits=data_dir / "gps" / "gps-ops_2020-04-27.tle")
    settings = {"altitudes_m": (20.0, 60.0), "gps": gps}
    xr.testing.assert_equal(
        *(ju.build_maps(town, bounds, engine=name, **settings).ds for name in ("jax", "numba"))
    )


def test_what_is_traced_is_jaxs_and_auto_is_numba_on_a_cpu_alone():
    assert (chosen("auto", "cpu"), chosen("auto", "gpu"), chosen("numba", "gpu")) == (
        "numba",
        "jax",
        "numba",
    )
    traced = []
    jax.jit(lambda values: traced.append(runs_numba("numba", values)) or values)(np.zeros(3))
    assert traced == [False]
    assert runs_numba("numba", np.zeros(3))
    assert not runs_numba("jax", np.zeros(3))


@pytest.fixture
def town(tmp_path):
    (tmp_path / "town.toml").write_text(TOWN)
    return tmp_path / "town.toml"


def test_a_wrong_engine_is_one_sentence():
    sentence = r"engine must be 'auto', 'numba' or 'jax', got 'jx' \(did you mean 'jax'\?\)"
    for call in (
        lambda: ju.build_maps(ju.demo_city(400, 400), engine="jx"),
        lambda: MapParams(engine="jx"),
    ):
        with pytest.raises(InputError, match=sentence):
            call()


@pytest.mark.slow
def test_a_run_records_its_engine_and_another_one_keeps_its_maps(town, tmp_path, capsys, called):
    def engines(*options):
        assert run(capsys, "maps", town, "-o", tmp_path / "out", *options)[0] == 0
        record = json.loads((tmp_path / "out" / "run.json").read_text())
        return record["engine"], record["settings"]["region"]["engine"]

    assert engines("--engine", "jax") == ("jax", "jax")
    assert engines() == ("jax", "auto")
    assert not called
    assert engines("--overwrite", "--set", "lidar.beams=3") == ("numba", "auto")
    assert called


def test_numba_beside_a_gpu_is_planned_and_recorded_as_on_a_cpu(town, tmp_path, monkeypatch):
    town.write_text(TOWN.replace("[buildings]", 'engine = "numba"\n[buildings]'))
    with monkeypatch.context() as patched:
        patched.setattr("jaxurban.maps.run.jax.default_backend", lambda: "gpu")
        patched.setattr("jaxurban.maps.memory.gpu_free_bytes", lambda: 1)
        made = run_scenario(ju.Scenario.from_toml(town), tmp_path / "beside", progress=False).record
    again = run_scenario(ju.Scenario.from_toml(town), tmp_path / "beside", progress=False).record
    assert made["run_key"] == again["run_key"]
    assert made["engine"] == "numba"


COMPILED = re.compile(r"Finished XLA compilation of (.+) in [\d.e-]+ sec")
MAPS = """
import sys
import jax
import jaxurban as ju

city = ju.demo_city(600, 700)
jax.config.update("jax_log_compiles", True)
for engine, resolution_m in (("numba", 10.0), ("jax", 12.0)):
    maps = ju.build_maps(city, resolution_m=resolution_m, altitudes_m=(20.0, 60.0, 100.0), engine=engine)
    assert {"gps", "lidar", "population", "risk"} <= set(maps.ds)
    print("-- next", file=sys.stderr)
"""


def test_maps_of_a_new_shape_in_a_new_process_compile_few_programs():
    """Every operation of JAX outside a jitted function would be one more."""
    done = subprocess.run([sys.executable, "-c", MAPS], capture_output=True, text=True, check=True)
    by_numba, by_jax, _ = map(COMPILED.findall, done.stderr.split("-- next"))
    assert "jit(maps_of_words)" in by_numba  # JAX still tells of them as this test expects
    assert len(by_numba) <= 5, by_numba
    assert len(by_jax) <= 6, by_jax
