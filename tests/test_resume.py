"""Killed runs: kill -9 of the run or of a worker loses no finished tile and changes no byte."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from jaxurban.io.workfolder import WorkFolder
from tests import tiled_runs
from tests.tiled_runs import files_of, make

WORK = Path("maps.zarr") / ".20m.part"


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> str:
    """Compiled programs, so that a run is killed at work and not while it compiles."""
    return str(tmp_path_factory.mktemp("jax"))


def start(folder: Path, cache: str) -> subprocess.Popen:
    environment = {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    return subprocess.Popen([sys.executable, "-m", "tests.tiled_runs", str(folder)], env=environment)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, cache) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole")
    assert start(folder, cache).wait(timeout=200) == 0
    return files_of(folder)


def done_tiles(folder: Path) -> dict[str, int]:
    """Return the finished tiles and when each was marked."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / WORK / "done").glob("tile_*.json")}


def kill_and_resume(folder: Path, cache: str, seed: int, whole: dict[str, bytes]) -> None:
    """Kill a run after a random number of finished tiles, a random moment later, until one gets through."""
    rng, kept = random.Random(seed), {}
    while True:
        process = start(folder, cache)
        wanted, later_s = len(kept) + rng.randint(1, 6), rng.uniform(0, 0.1)
        while process.poll() is None and len(done_tiles(folder)) < wanted:
            time.sleep(0.002)
        time.sleep(later_s)
        if process.poll() is None:
            process.kill()
        code = process.wait()
        if code == 0:
            break
        assert code == -signal.SIGKILL
        marked = done_tiles(folder)
        if not marked:  # killed while the maps took their name
            continue
        assert kept.items() <= marked.items()  # none was done again
        kept = marked
    assert kept
    assert files_of(folder) == whole


@pytest.mark.parametrize("seed", [0, 1])
def test_kill_9_of_the_run_loses_no_finished_tile_and_changes_no_byte(tmp_path, cache, whole, seed):
    kill_and_resume(tmp_path, cache, seed, whole)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 22))
def test_kill_9_of_the_run_twenty_times(tmp_path, cache, whole, seed):
    kill_and_resume(tmp_path, cache, seed, whole)


def kill_workers(folder: Path, cache: str, seed: int, num_kills: int, whole: dict[str, bytes]) -> None:
    from jaxurban.cluster import cluster_client

    rng = random.Random(seed)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = cache
    with cluster_client(None, 2) as client:
        import threading

        killed = []

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


def test_kill_9_of_a_worker_costs_only_its_tile(tmp_path, cache, whole):
    pytest.importorskip("distributed", reason="needs the cluster extra")
    kill_workers(tmp_path, cache, 0, 1, whole)


def test_a_torn_chunk_is_never_taken_for_a_finished_one(tmp_path, cache, whole):
    """A chunk that a power cut tore, of a tile without its mark, is written again."""
    process = start(tmp_path, cache)
    while process.poll() is None and len(done_tiles(tmp_path)) < 3:
        time.sleep(0.002)
    process.kill()
    process.wait()
    done = {name.removesuffix(".json") for name in done_tiles(tmp_path)}
    chunks = [path for path in (tmp_path / WORK / "zarr" / "risk" / "c").rglob("*") if path.is_file()]
    assert len(chunks) >= 2 * len(done)
    for path in (tmp_path / WORK / "done").iterdir():
        path.unlink()
    for chunk in chunks:
        chunk.write_bytes(chunk.read_bytes()[:5])
    assert start(tmp_path, cache).wait(timeout=200) == 0
    assert files_of(tmp_path) == whole


def test_another_jobs_unfinished_work_is_not_gone_on_with(tmp_path):
    work = WorkFolder(tmp_path / "work")
    work.begin("one")
    work.mark_done("tile_0_0", {"num_free": [1]})
    work.begin("one")
    assert work.done("tile_0_0") == {"num_free": [1]}
    work.begin("two")
    assert work.done("tile_0_0") is None


def children() -> list[int]:
    return [process.pid for process in psutil.Process().children(recursive=True)]
