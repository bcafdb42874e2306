"""Tiled maps equal untiled ones bit for bit, whoever works on the tiles and whoever is killed at it."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxurban.io import store
from jaxurban.io.folders import WorkFolder
from jaxurban.maps.build import compute_maps
from jaxurban.maps.executors import cluster_client
from jaxurban.maps.run import Maker, make_zarr
from jaxurban.metrics.custom import Layer
from jaxurban.progress import Report
from tests import tiled_runs
from tests.tiled_runs import RAGGED, files_of, make, task

WORK = Path("maps.zarr") / ".20m.jaxurban-part"


def untiled(city, series) -> xr.Dataset:
    return compute_maps(task(city, series)).ds


@pytest.fixture(scope="module")
def city():
    return tiled_runs.city()


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Compiled programs, for other processes: a run shall be killed at work and not while it compiles."""
    settings = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = [jax.config.values[name] for name in settings]
    folder = str(tmp_path_factory.mktemp("jax"))
    for name, value in zip(settings, (folder, 0.0), strict=True):
        jax.config.update(name, value)
    yield folder
    for name, value in zip(settings, before, strict=True):
        jax.config.update(name, value)


@pytest.fixture(scope="module")
def made(city, cache, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiled")
    make(folder, city)
    return folder


@pytest.fixture(scope="module")
def whole(made) -> dict[str, bytes]:
    return files_of(made)


def assert_equal(folder, expected: xr.Dataset) -> None:
    found = store.open_zarr(folder, None)
    assert found.attrs.pop("run_key") == "key"
    xr.testing.assert_identical(found.load(), expected)
    assert {name: array.dtype for name, array in found.items()} == {n: array.dtype for n, array in expected.items()}


def test_ragged_tiles_equal_the_untiled_maps(city, made):
    expected = untiled(city, "epochs")
    assert expected["num_visible"].values.max() > expected["num_visible"].values.min()
    assert_equal(made, expected)


@pytest.mark.parametrize("num_threads", [2, 1])
def test_while_a_tiles_results_are_waited_for_another_tile_is_begun(city, cache, tmp_path, num_threads):
    """So does a GPU compute one tile while another's maps travel; with one thread it would have to wait."""
    first, another, in_time = threading.Lock(), threading.Event(), []

    def wait() -> np.float32:
        in_time.append(another.wait(60 if num_threads > 1 else 0.5))
        return np.float32(0)

    def values(surface, altitude_m):
        late = np.float32(0)
        if first.acquire(blocking=False):
            late = jax.jit(lambda: jax.pure_callback(wait, jax.ShapeDtypeStruct((), np.float32)))()
        else:
            another.set()
        return jnp.zeros(surface.region.shape) + late

    plain = task(city)
    params = replace(plain.params, altitudes_m=(20.0,))
    with_layer = replace(plain, params=params, layers={"slow": Layer(values, "high-is-bad", scale=(0, 1))})
    make_zarr(Maker(with_layer, tmp_path, "key", num_threads), Report(), RAGGED)
    assert in_time == [num_threads > 1]


def test_statistics_over_time_of_tiles_equal_the_untiled_ones(city, tmp_path):
    make(tmp_path, city, series="statistics")
    assert_equal(tmp_path, untiled(city, "statistics"))


def test_tiles_on_terrain_with_holes_in_the_data_equal_the_untiled_maps(tmp_path):
    city = tiled_runs.city(with_terrain=True)
    make(tmp_path, city)
    expected = untiled(city, "epochs")
    assert np.isnan(expected["gps"].values).any()
    assert_equal(tmp_path, expected)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(47, 39), (1, 39), (47, 5), (7, 11), (46, 38)])
def test_any_shape_of_tiles_gives_the_same_maps(city, tmp_path, shape):
    make(tmp_path, city, shape)
    assert_equal(tmp_path, untiled(city, "epochs"))


def test_nothing_of_the_work_is_left(made):
    assert sorted(path.name for path in (made / "maps.zarr").iterdir()) == ["20m"]


def test_a_chunk_is_a_tile(made):
    assert store.open_zarr(made, None)["risk"].encoding["chunks"] == (1, *RAGGED)


@pytest.mark.parametrize("num_workers", [1, 2, 4])
def test_any_number_of_dask_workers_gives_the_same_bytes(city, whole, tmp_path, num_workers, monkeypatch):
    suffixes, finish = set(), WorkFolder.finish

    def look_and_finish(work, *target):
        suffixes.update(path.suffix for path in work.path.rglob("*") if path.is_file())
        finish(work, *target)

    monkeypatch.setattr(WorkFolder, "finish", look_and_finish)
    distributed = pytest.importorskip("distributed", reason="needs the cluster extra")
    options = {"processes": False, "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=num_workers, **options) as cluster, distributed.Client(cluster) as client:
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == whole
    is_chunk = {suffix for suffix in suffixes if suffix[1:].isdigit()}
    # Plain data: workers get the job itself from the scheduler.
    assert suffixes - is_chunk == {"", ".txt", ".npz", ".json"}


def start(folder: Path, cache: str) -> subprocess.Popen:
    environment = {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    return subprocess.Popen([sys.executable, "-m", "tests.tiled_runs", str(folder)], env=environment)


def done_tiles(folder: Path) -> dict[str, int]:
    """Return the finished tiles and when each was marked."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / WORK / "done").glob("tile_*.json")}


def tear_unfinished(folder: Path) -> None:
    """Tear every chunk of the tiles that are not marked, as a power cut may."""
    finished = {f"tile_{4 - i}_{1 + j}.json": f"{i}.{j}" for i in range(4) for j in range(3)}  # after one of margin
    kept = {finished[name] for name in done_tiles(folder)}
    for chunk in (folder / WORK / "zarr").rglob("[0-9]*.[0-9]*"):
        if ".".join(chunk.name.split(".")[-2:]) not in kept:
            chunk.write_bytes(chunk.read_bytes()[:5])


def kill_and_resume(folder: Path, cache: str, seed: int, num_kills: int, whole: dict[str, bytes]) -> None:
    """Kill a run some times, each after a random number of further tiles and a random moment, then let it finish."""
    rng = random.Random(seed)
    kept: dict[str, int] = {}
    for _ in range(num_kills):
        process = start(folder, cache)
        wanted, later_s = len(kept) + rng.randint(1, 8 // num_kills), rng.uniform(0, 0.05)
        while process.poll() is None and len(done_tiles(folder)) < wanted:
            time.sleep(0.002)
        time.sleep(later_s)
        process.kill()
        assert process.wait() == -signal.SIGKILL
        marked = done_tiles(folder)
        assert kept.items() <= marked.items()  # none was done again
        kept = marked
        tear_unfinished(folder)
    assert start(folder, cache).wait(timeout=200) == 0
    assert files_of(folder) == whole


@pytest.mark.slow
def test_kill_9_of_the_run_loses_no_finished_tile_and_changes_no_byte(tmp_path, cache, whole):
    kill_and_resume(tmp_path, cache, 0, 2, whole)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 7))
def test_kill_9_of_the_run_three_times_over(tmp_path, cache, whole, seed):
    kill_and_resume(tmp_path, cache, seed, 3, whole)


def kill_workers(folder: Path, cache: str, seed: int, num_kills: int, whole: dict[str, bytes]) -> None:
    """Kill random workers of two, each a random moment after some tiles are finished."""
    rng, killed = random.Random(seed), []
    with cluster_client(2) as client:

        def kill() -> None:
            for n in range(num_kills):
                while len(done_tiles(folder)) < 2 + 3 * n:
                    time.sleep(0.002)
                time.sleep(rng.uniform(0, 0.1))
                pids = list(client.run(os.getpid).values())
                os.kill(rng.choice(pids), signal.SIGKILL)
                killed.append(True)

        killer = threading.Thread(target=kill)
        killer.start()
        make(folder, tiled_runs.city(), client=client)
        killer.join()
    assert len(killed) == num_kills
    assert files_of(folder) == whole


@pytest.mark.slow
def test_kill_9_of_a_worker_costs_only_its_tile(tmp_path, cache, whole):
    pytest.importorskip("distributed", reason="needs the cluster extra")
    kill_workers(tmp_path, cache, 0, 1, whole)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 8))
def test_kill_9_of_workers_three_times_a_run(tmp_path, cache, whole, seed):
    kill_workers(tmp_path, cache, seed, 3, whole)


def test_a_worker_that_dies_as_the_job_goes_costs_nothing(city, whole, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs the cluster extra")

    def failing(client, name, **options):
        raise OSError("Stream is closed")

    monkeypatch.setattr(distributed.Client, "unregister_worker_plugin", failing)
    options = {"processes": False, "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=1, **options) as cluster, distributed.Client(cluster) as client:
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == whole


def test_scratch_and_files_of_the_user_among_unfinished_maps_are_no_outputs(city, whole, tmp_path, monkeypatch):
    """Scratch as a killed worker leaves it goes, in the midst of a run too; what no step wrote is set aside."""
    finish, mine = WorkFolder.finish, ("mine.txt", "done/mine.json", "zarr/risk/0.0.0.bak", "arrays/mine/a.npz")

    def plant(work, *names):
        for name in (*names, "zarr/risk/.0.0.0.0a1b2c3d.jaxurban-part", f"zarr/risk/0.0.{32 * 'a'}.partial"):
            (work.path / name).parent.mkdir(exist_ok=True)
            (work.path / name).write_text(name)

    def finish_late(work, target):
        plant(work, *mine[:2])
        work.mark_zarr()
        assert work.begin((work.path / "key.txt").read_text()) == []
        plant(work, *mine[2:])
        finish(work, target)

    monkeypatch.setattr(WorkFolder, "finish", finish_late)
    make(tmp_path, city)
    assert files_of(tmp_path) == whole | {f"kept/{name}": name.encode() for name in mine}


def test_another_jobs_unfinished_work_is_not_gone_on_with(tmp_path):
    work = WorkFolder(tmp_path / WORK)
    work.begin("one")
    work.mark_zarr()
    work.mark_done("tile_0_0", {}, {"num_free": [1]})
    work.begin("one")
    assert work.done("tile_0_0") == {"num_free": [1]}
    (work.path / "mine.txt").write_text("mine")
    work.begin("two")
    assert work.done("tile_0_0") is None
    assert (tmp_path / "kept/mine.txt").read_text() == "mine"
