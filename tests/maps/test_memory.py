"""The memory plan: what fits, what is refused, and that a real run stays under its ceiling."""

import json
import logging
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
import shapely
from affine import Affine

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps import memory
from jaxurban.maps.free_memory import parse_bytes
from jaxurban.maps.memory import (
    format_bytes,
    plan_run,
    shape_of_tiles,
    tile_bytes,
)
from jaxurban.maps.params import MapParams
from jaxurban.maps.saving import open_maps
from jaxurban.maps.task import MapTask
from jaxurban.metrics import lidar
from jaxurban.metrics.gps import Gps
from jaxurban.world.raster import Raster
from jaxurban.world.sky import Sky
from tests.made_files import WGS84, write_raster, write_vector

GIB = 2**30


def test_sizes_are_read_and_said_as_people_write_them():
    for text, num_bytes in (
        ("4GiB", 4 * GIB),
        ("512 MB", 512 * 10**6),
        ("1.5GiB", 3 * GIB // 2),
        ("2048kB", 2048000),
        ("2048000", 2048000),
    ):
        assert parse_bytes(text) == num_bytes
    for text in ("", "GiB", "-4GiB", "0", "4", "2048", "4 gigs", "4GiB free"):
        with pytest.raises(InputError, match="such as 4GiB"):
            parse_bytes(text)
    sizes = {
        1: "1 B",
        90 * 2**20: "90.00 MiB",
        1.26 * GIB: "1.26 GiB",
        2000 * GIB: "1.95 TiB",
    }
    assert [format_bytes(num_bytes) for num_bytes in sizes] == [*sizes.values()]


@pytest.fixture
def small() -> MapTask:
    """A region of one tile."""
    nobody = np.empty((1, 0))
    region, sky = (
        ju.Grid("EPSG:32618", 2.0, 0, 0, 300, 300),
        Sky(("",), (), nobody, nobody, (), nobody),
    )
    return MapTask(ju.demo_city(700, 700), region, sky, MapParams())


def test_as_many_tiles_at_a_time_as_fit_and_no_more_are_told_than_there_are(
    small, monkeypatch, caplog
):
    caplog.set_level(logging.INFO, "jaxurban")
    assert plan_run([small], None, 2) == 2  # two threads write GeoTIFFs
    assert "90,000 cells, tiles at a time: 1; about" in caplog.text
    plan_run([replace(small, region=replace(small.region, num_rows=3000))], None, 2)
    assert "tiles at a time: 2; about" in caplog.text
    monkeypatch.setattr(memory, "tile_bytes", lambda task, tile: 2 * GIB)
    needed = (
        psutil.Process().memory_info().rss + memory.COMPILING_BYTES + memory.PROGRAM_BYTES + 2 * GIB
    )
    assert plan_run([small], needed + GIB, 8) == 1
    monkeypatch.setattr(memory, "tile_bytes", lambda task, tile: GIB // 4)
    assert plan_run([small], 26 * GIB, 16, 4) == 16
    of_each = memory.PROGRAM_BYTES + memory.WORKER_BYTES
    ceiling = psutil.Process().memory_info().rss + 4 * of_each + 10 * GIB // 4
    assert plan_run([small], ceiling, 16, 4) == 8  # each process works on as many


def test_the_forecast_holds_what_the_lidar_by_jax_takes_over_terrain_as_compiled():
    kept = json.loads((Path(__file__).parents[2] / "benchmarks" / "cuda_compile.json").read_text())
    terrain = (
        kept["lidar: terrain, tile"]["temporary_mib"] * 2**20 / 1000**2
    )  # of a tile of so many cells
    assert 0.6 * lidar.TERRAIN_GPU_BYTES < terrain <= lidar.TERRAIN_GPU_BYTES


def test_beams_that_jax_counts_over_terrain_take_four_bytes_a_ray(small):
    hills = Raster(np.zeros((2, 2), np.float32), (1e4, 0, 5e5, 0, -1e4, 5e6), "EPSG:32618")
    city = replace(small.city, terrain=hills)

    def needed(beams: int) -> int:
        params = MapParams(sections={"lidar": ju.Lidar(beams=beams)})
        return tile_bytes(replace(small, city=city, params=params), small.region)

    num_rays = ju.Lidar().azimuths * 300 * 300
    assert needed(250) == needed(16)
    assert needed(251) - needed(250) >= 4 * num_rays


def test_tiles_do_not_depend_on_the_machine_and_shrink_for_long_series(small):
    short = replace(small, region=replace(small.region, num_rows=10_000, num_cols=5_000))
    params, region = (
        MapParams(sections={"gps": Gps(series="statistics")}),
        replace(short.region, resolution_m=5.0),
    )
    long = replace(short, region=region, sky=replace(small.sky, times=("",) * 288), params=params)
    assert shape_of_tiles(short) == (1000, 1000)
    rows, cols = shape_of_tiles(long)
    assert rows * cols * 288 * 4 * 4 <= 400 * 2**20
    crs = small.city.crs
    hills = replace(
        small.city,
        terrain=Raster(np.zeros((2, 2), np.float32), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0), crs),
    )
    short, tile = replace(short, city=hills), replace(short.region, num_rows=1000, num_cols=1000)
    assert tile_bytes(long, replace(region, num_rows=rows, num_cols=cols)) < 3 * tile_bytes(
        short, tile
    )


@pytest.mark.parametrize("cell_m", [0.2, 0.05])
def test_a_region_of_fine_cells_that_cannot_fit_is_refused_before_it_begins(cell_m, monkeypatch):
    """At 0.05 m the lidar looks 2,000 cells far: a yard and what is around it are 64 million cells."""
    monkeypatch.setattr(memory, "free_bytes", lambda: GIB)
    city = ju.demo_city(700, 700)
    x_m, y_m = city.extent_m[0] + 300, city.extent_m[1] + 300
    num = round(200 / cell_m)
    grid = ju.Grid(city.crs, cell_m, round(y_m / cell_m), round(x_m / cell_m), num, num)
    sentence = r"cells of 0\.\d+ m need about .* [GT]iB of memory at once and 1\.00 GiB are free: "
    with pytest.raises(InputError, match=sentence):
        ju.build_maps(city, grid=grid)


V1 = "/sys/fs/cgroup/memory"
V2 = "/sys/fs/cgroup"
NO_LIMIT = 9_223_372_036_854_771_712  # as version 1 writes it
FREE = 40 * GIB


def of_groups(
    root, groups: str, mounts: dict[str, tuple[str, str]], limits: dict[str, object]
) -> int:
    """Return the free bytes under a made file system: groups of the process, mounts by place, limits by folder."""
    lines = [
        f"3{k} 31 0:3{k} {top} {place} rw - {kind} {kind} rw"
        for k, (place, (top, kind)) in enumerate(mounts.items())
    ]
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(groups)
    (root / "proc/self/mountinfo").write_text(
        "\n".join(["23 1 8:1 / / rw shared:1 - ext4 /dev/root rw", *lines])
    )
    for folder, limit in limits.items():
        path = root / folder.strip("/")
        path.mkdir(parents=True, exist_ok=True)
        is_v1 = "/memory" in folder
        (path / ("memory.limit_in_bytes" if is_v1 else "memory.max")).write_text(f"{limit}\n")
        held = (
            "cache 9\nrss 1\nshmem 1\ntotal_rss 700\ntotal_shmem 300\n"
            if is_v1
            else "anon 900\nfile 9\nshmem 100\n"
        )
        (path / "memory.stat").write_text(held)
    return memory.free_bytes(root)


V2_MOUNT = {V2: ("/", "cgroup2")}
V1_MOUNTS = {
    "/sys/fs/cgroup/cpu": ("/", "cgroup"),
    V1: ("/", "cgroup"),
    f"{V2}/unified": ("/", "cgroup2"),
}
IN_V1 = "9:name=systemd:/\n4:cpu,memory:/jobs/7\n2:cpu:/other\n0::/\n"


@pytest.mark.parametrize(
    ("groups", "mounts", "limits", "left"),
    [
        ("0::/a/b\n", V2_MOUNT, {f"{V2}/a/b": "max", f"{V2}/a": "max"}, FREE),
        ("0::/a/b\n", V2_MOUNT, {f"{V2}/a/b": 2 * GIB, f"{V2}/a": "max"}, 2 * GIB - 1000),
        ("0::/a/b\n", V2_MOUNT, {f"{V2}/a/b": "max", f"{V2}/a": GIB}, GIB - 1000),
        ("0::/a/b\n", V2_MOUNT, {f"{V2}/a/b": 3 * GIB, f"{V2}/a": 2 * GIB, V2: 4 * GIB}, 2 * GIB - 1000),
        ("0::/\n", V2_MOUNT, {V2: GIB}, GIB - 1000),
        ("0::/a\\x2db\n", {V2: (r"/a\134x2db", "cgroup2")}, {V2: GIB}, GIB - 1000),
        ("0::/../other\n", V2_MOUNT, {V2: GIB}, GIB - 1000),
        (IN_V1, V1_MOUNTS, {f"{V1}/jobs/7": GIB, f"{V1}/jobs": 2 * GIB, V1: NO_LIMIT}, GIB - 1000),
        (IN_V1, V1_MOUNTS, {f"{V1}/jobs/7": NO_LIMIT, f"{V1}/jobs": NO_LIMIT, V1: NO_LIMIT}, FREE),
        (IN_V1, V1_MOUNTS, {f"{V1}/jobs/7": NO_LIMIT, f"{V1}/jobs": GIB, V1: NO_LIMIT}, GIB - 1000),
        ("4:memory:/docker/x/in\n", {V1: ("/docker/x", "cgroup")}, {f"{V1}/in": 2 * GIB, V1: 3 * GIB}, 2 * GIB - 1000),
        ("4:memory:/docker/x\n", {V1: ("/", "cgroup")}, {V1: GIB}, GIB - 1000),
        ("4:memory:/docker/x\n", {V1: ("/docker/y", "cgroup")}, {V1: GIB}, GIB - 1000),
        ("", {}, {}, FREE),
    ],
    ids=[
        "v2 without a limit", "v2", "v2 above", "v2 nested: the least", "v2 in its own namespace", "v2 escaped",
        "v2 beside the namespace", "v1 in a hybrid", "v1 without a limit", "v1 above", "v1 of a container",
        "v1 not visible", "v1 of another container", "no groups",
    ],
)  # fmt: skip
def test_the_least_limit_of_every_control_group_counts(
    groups, mounts, limits, left, tmp_path, monkeypatch
):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=FREE))
    assert of_groups(tmp_path, groups, mounts, limits) == left


def test_lines_that_are_no_groups_or_mounts_are_passed_over(tmp_path, monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=FREE))
    assert of_groups(tmp_path, "garbage\n0:\n0::/a\n", V2_MOUNT, {f"{V2}/a": GIB}) == GIB - 1000
    with (tmp_path / "proc/self/mountinfo").open("ab") as file:
        file.write(b"\n30 - cgroup2\n30 23 0:26 / /m\xe4 rw - cgroup2 c rw\n")
    assert memory.free_bytes(tmp_path) == GIB - 1000


def test_without_linux_the_machines_memory_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=FREE))
    assert memory.free_bytes(tmp_path) == FREE


# Of this program alone: ``ru_maxrss`` begins with what the process that started it, a worker of pytest, took.
PEAK = (
    "import re, sys; from jaxurban.cli.main import main\n"
    "try: main(sys.argv[1:])\n"
    "finally: print(re.search(r'VmHWM:\\s+(\\d+) kB', open('/proc/self/status').read())[1])"
)


def peak_of(*arguments) -> tuple[str, int]:
    """Return what ``jaxurban`` says on the terminal, and the most memory that it takes in a process of its own."""
    done = subprocess.run([sys.executable, "-c", PEAK, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr, int(done.stdout.split()[-1]) * 1024


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell_m", "range_m", "threshold_m", "terrain"),
    [
        (0.4, 100, 50, ""),
        (0.1, 30, 10, ""),
        (0.2, 100, 10, '[terrain]\nsource = "hills.tif"\n'),
    ],
)
def test_the_estimate_of_fine_cells_is_above_the_truth_and_not_twice_it(
    tmp_path, cell_m, range_m, threshold_m, terrain
):
    """On the yard of a tower, whose walls the lidar sees."""
    (tmp_path / "fine.toml").write_text(
        f"[region]\nbounds = [-73.98, 40.75, -73.9795, 40.7504]\nresolution_m = {cell_m}\naltitudes_m = 20\n"
        f'[buildings]\nsource = "tower.geojson"\n[lidar]\nrange_m = {range_m}\n'
        f"{terrain}[risk]\nthreshold_m = {threshold_m}\n"
    )
    write_vector(
        tmp_path / "tower.geojson",
        [shapely.box(-73.98, 40.75, -73.9799, 40.7501)],
        WGS84,
        height=[25],
    )
    ground_m = 5 + 4 * np.sin(np.arange(60)[:, None] / 5) * np.cos(np.arange(60) / 7)
    place = Affine(0.0002, 0, -73.985, 0, -0.0002, 40.755)
    write_raster(tmp_path / "hills.tif", ground_m.astype(np.float32), place, WGS84)
    said, peak = peak_of("maps", tmp_path / "fine.toml", "-o", tmp_path / "out")
    told = parse_bytes(re.search(r"about ([\d.]+ [GM]iB) of memory at most", said)[1])
    assert peak < told + 0.05 * GIB  # told to a tenth
    assert told < 2 * peak


@pytest.mark.slow
def test_a_run_stays_under_its_ceiling_on_a_region_that_needs_several_times_more_at_once(tmp_path):
    """20 million cells at 4 altitudes: 3.1 GB of maps alone, under 1.4 GiB, of which libraries take the half.

    It needs 1.1 to 1.2 GiB: how much of the libraries is in memory depends on the machine's state.
    """
    (tmp_path / "scenario.toml").write_text(
        '[region]\nbounds = [-74.03, 40.69, -73.912, 40.76]\nresolution_m = 2\n[buildings]\nsource = "synthetic"\n'
    )
    _, peak = peak_of(
        "maps", tmp_path / "scenario.toml", "-o", tmp_path / "out", "--memory", "1.4GiB"
    )
    assert peak < 1.4 * GIB
    assert open_maps(tmp_path / "out").ds.nbytes > 2 * 1.4 * GIB
