"""JAX makes the maps, few programs serve all cities, and where Numba's form stays it has the same bits."""

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
from jaxurban.kernels.engine import ONLY_JAX, runs_numba, uses_numba
from jaxurban.kernels.lidar import terrain_cpu
from jaxurban.kernels.lidar.hard import MOST_BEAMS
from jaxurban.maps.build import compute_maps
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from tests import hanging_city
from tests.tiled_runs import city, task


def both(of: MapTask):
    """Return the datasets of a task by Numba, where it has a form, and by JAX."""
    by_numba, by_jax = (
        replace(of, params=replace(of.params, engine=engine)) for engine in ("numba", "jax")
    )
    with pytest.warns(UserWarning, match="JAX makes it on the host"):
        numba = compute_maps(by_numba).ds
    return numba, compute_maps(by_jax).ds


@pytest.fixture
def called(monkeypatch):
    """The forms of Numba that were called."""
    names, form = [], terrain_cpu.count_on_terrain_on_host
    monkeypatch.setattr(
        terrain_cpu,
        "count_on_terrain_on_host",
        lambda *arguments: names.append("lidar over terrain") or form(*arguments),
    )
    return names


@pytest.mark.slow
def test_over_terrain_around_slabs_and_on_finer_cells_the_bits_are_equal():
    of = hanging_city.task(hanging_city.city(with_terrain=True), altitudes_m=(2.0, 13.0))
    sections = of.params.sections
    solid = {"sections": sections | {"risk": ju.Risk(distance="solid")}}
    finer = {"sections": sections | {"gps": ju.Gps(bounds=True)}, "oversample": 3}
    for settings in ({}, solid, finer):
        xr.testing.assert_equal(*both(replace(of, params=replace(of.params, **settings))))


def test_over_terrain_numba_counts_what_a_lidar_sees_with_the_bits_of_jax(called):
    of = task(city(with_terrain=True))
    numba, jaxs = both(of)
    assert {*called} == {"lidar over terrain"} == {*of.by_numba}
    xr.testing.assert_equal(jaxs, numba)
    assert len(np.unique(jaxs["lidar"])) > 4


@pytest.mark.slow
def test_more_beams_than_numba_counts_are_jaxs_and_recorded_as_such(called):
    of = task(city(with_terrain=True))
    for beams, made in ((MOST_BEAMS, ["lidar over terrain"]), (MOST_BEAMS + 1, [])):
        sections = of.params.sections | {"lidar": ju.Lidar(beams, azimuths=4, range_m=40.0)}
        of = replace(of, params=replace(of.params, altitudes_m=(20.0,), sections=sections))
        called.clear()
        compute_maps(of)
        assert called == of.by_numba == made


def test_what_is_traced_is_jaxs_and_auto_is_numba_on_a_cpu_alone(monkeypatch):
    assert uses_numba("auto")
    with monkeypatch.context() as patched:
        patched.setattr("jaxurban.kernels.engine._platform", lambda: "gpu")
        assert (uses_numba("auto"), uses_numba("numba")) == (False, True)
    traced = []
    jax.jit(lambda values: traced.append(runs_numba("numba", values)) or values)(np.zeros(3))
    assert traced == [False]
    assert runs_numba("numba", np.zeros(3))
    assert not runs_numba("jax", np.zeros(3))


def test_a_wrong_engine_is_one_sentence():
    sentence = r"engine must be 'auto', 'numba' or 'jax', got 'jx' \(did you mean 'jax'\?\)"
    for call in (
        lambda: ju.build_maps(ju.demo_city(400, 400), engine="jx"),
        lambda: MapParams(engine="jx"),
    ):
        with pytest.raises(InputError, match=sentence):
            call()


def test_numba_warns_where_maps_are_made():
    with pytest.warns(UserWarning, match=re.escape(ONLY_JAX)):
        ju.build_maps(
            ju.demo_city(400, 400), resolution_m=50.0, altitudes_m=(20.0,), engine="numba"
        )


MAPS = """
import json
from dataclasses import replace

import jax
import jaxurban as ju

compiled = []
name = "/jax/core/compile/backend_compile_duration"
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **facts: compiled.append(facts.get("fun_name", "?")) if event == name else None
)
cities = [
    (ju.demo_city(600, 700), (20.0, 60.0, 100.0), "2020-04-27T16:00:00Z"),
    (replace(ju.demo_city(900, 500, seed=3), crs="EPSG:32654"), (10.0, 33.0, 70.0), "2020-04-27T04:00:00Z"),
    (replace(ju.demo_city(1800, 1300, seed=5), crs="EPSG:32719"), (25.0, 50.0, 150.0), "2020-04-27T09:00:00Z"),
]
counts = []
for city, altitudes_m, time in cities:
    for lidar in (ju.Lidar(), ju.Lidar(range_m=90.0)):  # of one class of ranges
        before = len(compiled)
        gps = ju.Gps(times=time, gdop_threshold=10.0 + len(counts))
        people = ju.Population(credit=city.crs, commercial=[len(counts)])
        sections = {"gps": gps, "lidar": lidar, "population": people}
        maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=altitudes_m, **sections)
        assert {"gps", "lidar", "population", "risk"} <= set(maps.ds)
        counts.append(compiled[before:])
print(json.dumps(counts))
"""


@pytest.mark.slow
def test_three_cities_of_other_size_crs_altitudes_and_time_compile_the_programs_of_the_first():
    done = subprocess.run([sys.executable, "-c", MAPS], capture_output=True, text=True, check=True)
    first, *others = json.loads(done.stdout.splitlines()[-1])
    assert 1 <= len(first) <= 8, first
    assert others == [[]] * 5
