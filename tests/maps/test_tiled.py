"""Tiled maps equal untiled ones bit for bit, whoever works on the tiles and whoever is killed at it."""

import gc
import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.io.files import remove
from jaxurban.io.folders import WorkFolder
from jaxurban.maps import executors
from jaxurban.maps.build import compute_maps
from jaxurban.maps.executors import cluster_client
from jaxurban.maps.run import RunContext, make_zarr
from jaxurban.maps.task import MapTask
from jaxurban.maps.tiled import Tiling
from jaxurban.metrics.custom import Layer
from jaxurban.metrics.gps_floor import GpsFloor
from jaxurban.metrics.protection import IntegritySupport, Protection
from jaxurban.metrics.risk import Risk
from jaxurban.progress import Report
from jaxurban.settings import Heights, HeightStd
from tests import hanging_city, tiled_runs
from tests.tiled_runs import RAGGED, check_tiles, files_of, make, task

WORK = Path("maps.zarr") / ".20m.jaxurban-part"
WIDE = Protection(1e4, 1e4, IntegritySupport(p_const_gps=0.0))  # of the few satellites of that sky
VARIED = {
    "risk",
    "risk_std",
    "gps_p05",
    "obstacle_share",
    "protection",
    "hpl",
    "vpl",
    "within_limits",
    "gps_floor",
    "gps_floor_highest",
} | {
    f"protection_{what}" for what in ("availability", "median", "p05")
}  # maps that must not be the same everywhere


@pytest.fixture(scope="module")
def city():
    return tiled_runs.city()


@pytest.fixture(scope="module")
def whole(city, tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("tiled")
    make(folder, city)
    return files_of(folder)


def with_section(series: str = "epochs", with_terrain: bool = False, **section) -> MapTask:
    of = task(tiled_runs.city(with_terrain), series)
    return replace(of, params=replace(of.params, sections={**of.params.sections, **section}))


def people_by_day_and_night() -> MapTask:
    of = with_section()
    blocks = replace(
        of.city.blocks, day_count=np.random.default_rng(0).uniform(0, 900, len(of.city.blocks))
    )
    return replace(of, city=replace(of.city, blocks=blocks))


def slabs(with_terrain: bool = False, **settings) -> MapTask:
    return hanging_city.task(
        hanging_city.city(with_terrain=with_terrain), altitudes_m=(2.0, 13.0), **settings
    )


JOBS = {  # the task, the shape of its tiles, and how tiles differ in their settings
    "slabs over terrain": (lambda: slabs(with_terrain=True), (34, 58), {}),
}
SLOW = {
    "epochs": (with_section, RAGGED, {}),
    "statistics": (lambda: with_section("statistics"), RAGGED, {}),
    "terrain with holes": (lambda: with_section(with_terrain=True), RAGGED, {}),
    "people by day and by night": (people_by_day_and_night, RAGGED, {}),
    "solid risk over terrain": (
        lambda: with_section(with_terrain=True, risk=Risk(distance="solid")),
        RAGGED,
        {},
    ),
    "terrain, tiles by JAX": (lambda: with_section(with_terrain=True), RAGGED, {"engine": "jax"}),
    "protection": (lambda: with_section(protection=WIDE), (16, 16), {}),
    "protection's statistics": (lambda: with_section("statistics", protection=WIDE), (16, 16), {}),
    "GPS floor over terrain": (
        lambda: with_section(with_terrain=True, gps_floor=GpsFloor()),
        RAGGED,
        {},
    ),
    "GPS floor, the highest": (
        lambda: with_section("statistics", gps_floor=GpsFloor()),
        (16, 16),
        {},
    ),
    "slabs": (slabs, (34, 58), {}),
    "drawn heights": (lambda: slabs(heights=Heights(height_samples=3)), (34, 58), {}),
    "slabs and finer rays": (lambda: slabs(oversample=3), (34, 58), {}),
} | {
    f"tiles of {shape}": (with_section, shape, {})
    for shape in [(47, 39), (1, 39), (47, 5), (7, 11), (46, 38)]
}


@pytest.mark.parametrize(
    "name", [*JOBS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
def test_tiles_equal_the_untiled_maps(name, tmp_path):
    of, shape, options = (JOBS | SLOW)[name]
    found = check_tiles(of(), tmp_path, shape, **options)
    assert found["risk"].encoding["chunks"][1:] == shape
    if "terrain with holes" in name:
        assert np.isnan(found["gps"].values).any()
    for variable in VARIED & {*found}:
        assert len(np.unique(found[variable])) > 1


def test_a_run_that_fails_returns_when_no_thread_writes_any_more(city, tmp_path, monkeypatch):
    begun, ended, both_run = [], [], threading.Barrier(2, timeout=60)

    def raster_tile(job, tile):
        begun.append(tile)
        both_run.wait()
        if tile == begun[0]:
            raise MemoryError
        time.sleep(0.2)
        ended.append(tile)
        return {"seconds": {}}

    monkeypatch.setattr(executors, "raster_tile", raster_tile)
    with pytest.raises(MemoryError):
        make(tmp_path, city)
    assert begun[1:] == ended


# By shadows of roofs, of those that are drawn higher and of hills, and by what metrics look at.
@pytest.mark.parametrize(("what", "mask_deg"), [("roofs", 20), ("terrain", 20), ("roofs", 80)])
def test_maps_of_a_part_equal_that_part_of_the_maps_though_their_surface_reaches_less_far(
    what, mask_deg
):
    of = with_section(with_terrain=True)
    towers_m = np.where(
        of.city.roofs.values > (0 if mask_deg == 80 else 180), np.float32(200), np.float32(0)
    )
    bare = replace(of.city.roofs, values=0 * towers_m)
    city = replace(
        of.city, **{"roofs": bare, "terrain": None, what: replace(bare, values=towers_m)}
    )
    params = replace(
        of.params, heights=Heights(height_samples=2, height_std_m=HeightStd(raster=200.0))
    )
    of = replace(of, city=city, sky=replace(of.sky, mask_deg=mask_deg), params=params)
    part, whole = (
        compute_maps(replace(of, region=of.region.padded(*[-n] * 4))).ds for n in (14, 0)
    )
    for name in ("obstacle", "gps", "gps_mean", "gdop", "num_visible", "lidar", "risk"):
        np.testing.assert_array_equal(part[name], whole[name][..., 14:-14, 14:-14])


@pytest.mark.slow
@pytest.mark.parametrize("num_threads", [2, 1])
def test_while_a_tiles_results_are_waited_for_another_tile_is_begun(city, tmp_path, num_threads):
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
    with_layer = replace(
        plain, params=params, layers={"slow": Layer(values, "high-is-bad", scale=(0, 1))}
    )
    make_zarr(RunContext(with_layer, tmp_path, "key", num_threads), Report(), RAGGED)
    assert in_time == [num_threads > 1]


@contextmanager
def cluster_of(num_workers: int):
    distributed = pytest.importorskip("distributed", reason="needs the cluster extra")
    options = {"processes": False, "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
    with (
        distributed.LocalCluster(n_workers=num_workers, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.mark.slow
@pytest.mark.parametrize("num_workers", [1, 3])
def test_any_number_of_dask_workers_gives_the_same_bytes(
    city, whole, tmp_path, num_workers, monkeypatch
):
    suffixes, finish = set(), WorkFolder.finish

    def look_and_finish(work, *target):
        suffixes.update(path.suffix for path in work.path.rglob("*") if path.is_file())
        finish(work, *target)

    monkeypatch.setattr(WorkFolder, "finish", look_and_finish)
    with cluster_of(num_workers) as client:
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == whole
    is_chunk = {suffix for suffix in suffixes if suffix[1:].isdigit()}
    # Plain data: workers get the job itself from the scheduler.
    assert suffixes - is_chunk == {"", ".txt", ".npz", ".json"}


@pytest.mark.slow
def test_a_worker_that_dies_as_the_job_goes_costs_nothing(city, whole, tmp_path, monkeypatch):
    def failing(client, name, **options):
        raise OSError("Stream is closed")

    with cluster_of(1) as client:
        monkeypatch.setattr(type(client), "unregister_worker_plugin", failing)
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == whole


def start(folder: Path) -> subprocess.Popen:
    environment = os.environ | {
        "JAX_PLATFORMS": "cpu"
    }  # programs are kept by the settings of conftest.py
    return subprocess.Popen(
        [sys.executable, "-m", "tests.tiled_runs", str(folder)], env=environment
    )


def done_tiles(folder: Path) -> dict[str, int]:
    """Return the finished tiles and when each was marked."""
    return {
        path.name: path.stat().st_mtime_ns for path in (folder / WORK / "done").glob("tile_*.json")
    }


def tear_unfinished(folder: Path) -> None:
    """Tear every chunk of the tiles that are not marked, as a power cut may."""
    of = tiled_runs.task(tiled_runs.city())
    tiling = Tiling.over(of.region, of.with_margin(), RAGGED)
    north, west = tiling.first[0] + tiling.counts[0] - 1, tiling.first[1]
    finished = {
        f"tile_{row}_{col}.json": f"{north - row}.{col - west}" for row, col in tiling.region_tiles
    }
    kept = {finished[name] for name in done_tiles(folder)}
    for chunk in (folder / WORK / "zarr").rglob("[0-9]*.[0-9]*"):
        if ".".join(chunk.name.split(".")[-2:]) not in kept:
            chunk.write_bytes(chunk.read_bytes()[:5])


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "num_kills"), [(0, 2), (1, 3)])
def test_kill_9_of_the_run_loses_no_finished_tile_and_changes_no_byte(
    tmp_path, whole, seed, num_kills
):
    """Each kill comes after a random number of further tiles and a random moment; at last the run finishes."""
    rng = random.Random(seed)
    kept: dict[str, int] = {}
    for _ in range(num_kills):
        process = start(tmp_path)
        wanted, later_s = len(kept) + rng.randint(1, 8 // num_kills), rng.uniform(0, 0.05)
        while process.poll() is None and len(done_tiles(tmp_path)) < wanted:
            time.sleep(0.002)
        time.sleep(later_s)
        process.kill()
        assert process.wait() == -signal.SIGKILL
        marked = done_tiles(tmp_path)
        assert kept.items() <= marked.items()  # none was done again
        kept = marked
        tear_unfinished(tmp_path)
    assert start(tmp_path).wait(timeout=200) == 0
    assert files_of(tmp_path) == whole


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:unclosed <ssl.SSLSocket:ResourceWarning"
)  # Dask leaves a killed worker's open
@pytest.mark.parametrize(("seed", "num_kills"), [(0, 1), (1, 3)])
def test_kill_9_of_workers_costs_only_their_tiles(tmp_path, whole, seed, num_kills):
    """Random workers of two are killed, each a random moment after some tiles are finished."""
    pytest.importorskip("distributed", reason="needs the cluster extra")
    rng, killed = random.Random(seed), []
    with cluster_client(2) as client:

        def kill() -> None:
            for n in range(num_kills):
                while len(done_tiles(tmp_path)) < 2 + 3 * n:
                    time.sleep(0.002)
                time.sleep(rng.uniform(0, 0.1))
                os.kill(rng.choice(list(client.run(os.getpid).values())), signal.SIGKILL)
                killed.append(True)

        killer = threading.Thread(target=kill)
        killer.start()
        make(tmp_path, tiled_runs.city(), client=client)
        killer.join()
    gc.collect()  # those sockets are this test's, not a later one's
    assert len(killed) == num_kills
    assert files_of(tmp_path) == whole


@pytest.mark.slow
def test_scratch_and_files_of_the_user_among_unfinished_maps_are_no_outputs(
    city, whole, tmp_path, monkeypatch
):
    """Scratch as a killed worker leaves it goes, in the midst of a run too; what no step wrote is set aside."""
    finish, mine = (
        WorkFolder.finish,
        ("mine.txt", "done/mine.json", "zarr/risk/0.0.0.bak", "arrays/mine/a.npz"),
    )

    def plant(work, *names):
        for name in (
            *names,
            "zarr/risk/.0.0.0.0a1b2c3d.jaxurban-part",
            f"zarr/risk/0.0.{32 * 'a'}.partial",
        ):
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
    work.mark_done("tile_0_0", {})
    work.begin("one")
    assert work.is_done("tile_0_0")
    work.begin("two")
    assert not work.is_done("tile_0_0")


@pytest.mark.parametrize(
    "name", ["../../mine.txt", "zarr/../../../mine.txt", "MINE", "arrays/../../../mine.txt"]
)
def test_a_mark_that_names_a_file_elsewhere_removes_none(tmp_path, name):
    (tmp_path / "mine.txt").write_text("mine")
    work = WorkFolder(tmp_path / WORK)
    work.begin("one")
    work.mark_zarr()
    work.mark_done("tile_0_0", {name.replace("MINE", str(tmp_path / "mine.txt")): "00000000-0"})
    assert work.begin("one") == [work.path / "done/tile_0_0.json"]
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("is_gone_on_with", [False, True])
@pytest.mark.parametrize("name", ["", "zarr", "done", "zarr/.zgroup", "arrays/risk_0_0.npz"])
def test_a_link_among_unfinished_maps_is_followed_nowhere(tmp_path, name, is_gone_on_with):
    out, documents = tmp_path / "out", tmp_path / "documents"
    work = WorkFolder(out / WORK)
    work.begin("one")
    for each in ("", "zarr", "done"):
        (documents / each).mkdir(exist_ok=True)
    for each in ("key.txt", "mine.txt", "zarr/.zgroup", "zarr/mine.txt"):
        (documents / each).write_text("one")
    target = documents / "mine.txt" if "/" in name else documents / name
    remove(work.path / name)
    (work.path / name).parent.mkdir(parents=True, exist_ok=True)
    (work.path / name).symlink_to(target)
    before = files_of(documents)
    if name:
        work.begin("one" if is_gone_on_with else "two")
        assert not (work.path / name).is_symlink()
        assert (out / "kept" / name).is_symlink()
    else:
        with pytest.raises(
            InputError, match=r"is a link in the place of unfinished maps: move it, or .*-o"
        ):
            work.begin("one") if is_gone_on_with else work.discard()
    assert files_of(documents) == before
