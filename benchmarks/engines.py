"""Numba against JAX on whole jobs: what the first maps of a machine cost, the next ones, and those of a new process.

``python -m benchmarks.engines [--checkout PATH ...] [--engine ENGINE ...] [--only JOB ...]`` prints a row for each run
of a job, and in it a cell for each engine of each checkout. A cell begins with empty caches: the job runs in a fresh
process (cold), there again (warm), and in a second process that finds the caches filled. Imports are left out, and so
is the reading of a city whose maps stay in memory; ``jaxurban maps`` is measured whole. Only public functions and
options are used, so that PATH may be an old checkout. It needs Linux, for the greatest memory of a run.
"""

import argparse
import json
import os
import re
import runpy
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

import geopandas as gpd
import jax
import numpy as np
import pandas as pd
import rasterio
import shapely

import jaxurban as ju
from benchmarks.common import ROOT, machine, table
from benchmarks.workloads import DATA, LEAST_S, SCENARIOS
from jaxurban.maps.params import MapParams

COMPILE = "/jax/core/compile/backend_compile_duration"  # also of programs that are loaded
PROGRAMS = "programs"
LOADED = "/jax/compilation_cache/cache_hits"
RUNS = ("cold", "warm", "new process")
MEASURES = "CPU s / wall s / greatest memory, MiB / programs compiled + loaded / s of these"
SAMPLE = "sample:lower-manhattan"
TWO, THREE, FOUR = (20.0, 60.0), (20.0, 60.0, 122.0), (20.0, 60.0, 122.0, 600.0)  # altitudes, m
WARDS_DEG, CENTRE_DEG = (139.56, 35.53, 139.92, 35.82), (139.68, 35.655, 139.785, 35.72)
WARDS_ROOFS = ROOT / "out" / "wards.parquet"
WARDS = f"""
[region]
bounds = {list(WARDS_DEG)}
resolution_m = 5.0
altitudes_m = {list(THREE)}
[buildings]
source = "{WARDS_ROOFS}"
"""
Work = Callable[[], object]
Job = Callable[[str, Path], Work]  # from an engine and a folder for files to what is measured


@dataclass(frozen=True)
class Cost:
    """What a run took.

    Attributes:
      cpu_s, wall_s: seconds; CPU seconds of all threads.
      peak_mib: greatest memory during the run, with all that the process held before.
      num_compiled, num_loaded: programs that XLA compiled, and that came from JAX's cache on the disk.
      compile_s: seconds of both, summed over threads.
    """

    cpu_s: float
    wall_s: float
    peak_mib: float
    num_compiled: float
    num_loaded: float
    compile_s: float

    def __str__(self) -> str:
        programs = f"{self.num_compiled:.0f} + {self.num_loaded:.0f} / {self.compile_s:.2f}"
        return f"{self.cpu_s:#.3g} / {self.wall_s:#.3g} / {self.peak_mib:.0f} / {programs}"


def in_memory(city: Callable[[Path], ju.City], **options: object) -> Job:
    """Return the job `build_maps` of a city; left out, cells have 5 m and there are two altitudes."""
    options = {"resolution_m": 5.0, "altitudes_m": TWO} | options

    def prepared(engine: str, folder: Path) -> Work:
        return partial(ju.build_maps, city(folder), engine=engine, progress=False, **options)

    return prepared


def manhattan(folder: Path) -> ju.City:
    """Lower Manhattan, with its trees, masts and wires."""
    return ju.sample_city("lower-manhattan")


def buildings_alone(folder: Path) -> ju.City:
    """The buildings of Lower Manhattan; older checkouts know no others."""
    return ju.sample_city("lower-manhattan", kinds=["building"])


def with_slabs(folder: Path) -> ju.City:
    """Lower Manhattan, whose hanging parts and bridges hang."""
    return ju.City.from_files(ju.Buildings(SAMPLE, hanging="slabs"))


def hilly(folder: Path) -> ju.City:
    """Lower Manhattan on hills of 10 m."""
    row, col = np.mgrid[:800, :800]
    hills_m = (5 * (np.sin(row / 6) + np.sin(col / 5))).astype(np.float32)
    west_m, north_m, cell_m = 565_000, 4_527_000, 50
    with rasterio.open(
        folder / "hills.tif",
        "w",
        driver="GTiff",
        width=800,
        height=800,
        count=1,
        dtype="float32",
        crs="EPSG:32618",
        transform=rasterio.Affine(cell_m, 0, west_m, 0, -cell_m, north_m),
    ) as raster:
        raster.write(hills_m, 1)
    return ju.City.from_files(SAMPLE, terrain=folder / "hills.tif")


def second_city(engine: str, folder: Path) -> Work:
    """Shinjuku, after Lower Manhattan at equal resolution and altitudes, which is not measured."""
    in_memory(manhattan, resolution_m=10.0)(engine, folder)()
    return in_memory(lambda _: ju.sample_city("shinjuku"), resolution_m=10.0)(engine, folder)


def on_disk(scenario: str) -> Job:
    """Return the job ``jaxurban maps`` of a scenario in TOML."""

    def prepared(engine: str, folder: Path) -> Work:
        (folder / "scenario.toml").write_text(scenario)

        def work() -> None:
            with tempfile.TemporaryDirectory(dir=folder) as out:
                sys.argv = ["", "maps", "scenario.toml", "-o", f"{out}/maps"]
                params = partial(MapParams, engine=engine)
                try:
                    with patch("jaxurban.maps.scenario.MapParams", params):
                        runpy.run_module("jaxurban", run_name="__main__")
                except SystemExit as ended:
                    if ended.code:
                        raise

        return work

    return prepared


HAND_ON = f"""
[region]
bounds = [-74.02, 40.70, -73.98, 40.73]
resolution_m = 2.0
altitudes_m = {list(THREE)}
[buildings]
source = "{SAMPLE}"
"""
SMALL: dict[str, Job] = {
    "flat": in_memory(manhattan, resolution_m=10.0, altitudes_m=FOUR),
    "buildings alone": in_memory(buildings_alone, resolution_m=10.0, altitudes_m=FOUR),
    "flat, 2 m": in_memory(manhattan, resolution_m=2.0, altitudes_m=THREE),
    "second city": second_city,
    "small city": in_memory(lambda _: ju.demo_city(600, 600), resolution_m=20.0),
    "terrain": in_memory(hilly),
    "oversample 3": in_memory(manhattan, oversample=3),
    "oversample 5": in_memory(manhattan, oversample=5),
    "bounds": in_memory(manhattan, oversample=3, gps=ju.Gps(bounds=True)),
    "slabs": in_memory(with_slabs),
    "solid distance": in_memory(manhattan, risk=ju.Risk(distance="solid")),
    "hand-on": on_disk(HAND_ON),
}
LARGE: dict[str, Job] = {
    "tokyo": on_disk(SCENARIOS["tokyo"]),
    "paper": on_disk(SCENARIOS["paper"]),
    "wards": on_disk(WARDS),
}
JOBS = SMALL | LARGE


def write_roofs(path: Path) -> None:
    """Write roofs all over the box of Tokyo's 23 wards: the largest quarter of those of its centre, repeated."""
    roofs = gpd.read_parquet(DATA / "tokyo" / "tokyo-central-lod2.parquet")
    areas = shapely.area(roofs.geometry.values)
    roofs = roofs[areas >= np.quantile(areas, 0.75)]
    west, south, east, north = CENTRE_DEG
    copies = [
        roofs.set_geometry(roofs.translate(i * (east - west), j * (north - south)))
        for i in range(-2, 3)
        for j in range(-2, 3)
    ]
    everywhere = pd.concat(copies, ignore_index=True)
    west, south, east, north = WARDS_DEG
    path.parent.mkdir(exist_ok=True)
    everywhere.cx[west:east, south:north].to_parquet(path)


def measured(work: Work, events: Counter[str]) -> Cost:
    """Return what a run took, its programs by ``events`` of `count_programs`."""
    events.clear()
    Path("/proc/self/clear_refs").write_text("5")  # the greatest memory begins anew
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    peak_kib = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    num_compiled = events[PROGRAMS] - events[LOADED]
    return Cost(
        cpu_s, wall_s, int(peak_kib[1]) / 1024, num_compiled, events[LOADED], events[COMPILE]
    )


def count_programs() -> Counter[str]:
    """Return what JAX's monitor counts from now on: `PROGRAMS`, the seconds of `COMPILE`, and `LOADED`."""
    events: Counter[str] = Counter()

    def on_duration(event: str, seconds: float, **_: object) -> None:
        if event == COMPILE:
            events.update({PROGRAMS: 1, COMPILE: seconds})

    jax.monitoring.register_event_duration_secs_listener(on_duration)
    jax.monitoring.register_event_listener(lambda event, **_: events.update([event]))
    return events


def run_job(name: str, engine: str, is_once: bool) -> None:
    """Print as JSON what a job took in this process at first and, unless it runs once, as the medians of later runs."""
    if not Path(ju.__file__).is_relative_to(Path.cwd()):
        raise SystemExit(f"jaxurban is imported from {ju.__file__}, not from {Path.cwd()}")
    events, work = count_programs(), JOBS[name](engine, Path.cwd())
    costs, warm = [measured(work, events)], list[Cost]()
    if not is_once:
        while sum(cost.cpu_s for cost in warm) < LEAST_S:
            warm.append(measured(work, events))
        costs.append(Cost(*pd.DataFrame(warm).median()))
    print(json.dumps([asdict(cost) for cost in costs]))


def commit(checkout: Path) -> str:
    """Return what Git calls a checkout."""
    asked = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(asked, cwd=checkout, capture_output=True, text=True).stdout.strip()


@dataclass(frozen=True)
class Side:
    """An engine of a checkout."""

    checkout: Path
    engine: str

    def __str__(self) -> str:
        return f"{self.engine}, {commit(self.checkout)}"

    def process(self, folder: Path, name: str, is_once: bool) -> list[Cost]:
        """Return what the runs of a job took in a process of its own.

        Raises:
          SystemExit: it failed.
        """
        caches = {
            "XDG_CACHE_HOME": str(folder / "cache"),
            "NUMBA_CACHE_DIR": str(folder / "numba"),
            "JAX_COMPILATION_CACHE_DIR": str(folder / "jax"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PLATFORMS": "cpu",
        }
        arguments = f"({name!r}, {self.engine!r}, {is_once})"
        call = f"from benchmarks.engines import run_job; run_job{arguments}"
        done = subprocess.run(
            [sys.executable, "-c", call],
            cwd=folder,
            env=os.environ | caches,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise SystemExit(f"{name}, {self}: {done.stderr[-2000:]}")
        return [Cost(**cost) for cost in json.loads(done.stdout.splitlines()[-1])]

    def costs(self, name: str) -> list[Cost]:
        """Return what `RUNS` of a job took, its caches empty at first."""
        with tempfile.TemporaryDirectory(prefix="engines-") as scratch:
            folder = Path(scratch)
            (folder / "jaxurban").symlink_to(self.checkout / "jaxurban")
            (folder / "benchmarks").symlink_to(ROOT / "benchmarks")
            cold, warm = self.process(folder, name, is_once=False)
            (again,) = self.process(folder, name, is_once=True)
            return [cold, warm, again]


def cells(costs: list[list[Cost]], run: int) -> list[str]:
    """Return a run's cell of each side; behind all but the first the ratios of CPU and wall seconds to the first."""
    of_run = [each[run] for each in costs]
    first = of_run[0]
    ratios = [f" ({c.cpu_s / first.cpu_s:.2f}, {c.wall_s / first.wall_s:.2f})" for c in of_run[1:]]
    return [f"{cost}{ratio}" for cost, ratio in zip(of_run, ["", *ratios], strict=True)]


def main() -> None:
    """Print the table that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = partial(parser.add_argument, action="append")
    add("--checkout", type=Path, metavar="PATH", help="left out: this one")
    add("--engine", choices=("numba", "jax", "auto"), help="left out: numba and jax")
    add(
        "--only",
        choices=JOBS,
        metavar="JOB",
        help=f"of {', '.join(JOBS)}; left out: {len(SMALL)} small ones",
    )
    asked = parser.parse_args()
    sides = [
        Side(checkout.resolve(), engine)
        for checkout in asked.checkout or [ROOT]
        for engine in asked.engine or ("numba", "jax")
    ]
    if "wards" in (asked.only or ()) and not WARDS_ROOFS.exists():
        write_roofs(WARDS_ROOFS)
    print(f"{machine()}\n\nCells: {MEASURES} (ratios of CPU and wall to the first cell).\n")
    print(table(["job", "run", *map(str, sides)], []), flush=True)
    for name in asked.only or SMALL:
        costs = [side.costs(name) for side in sides]
        for run, title in enumerate(RUNS):
            print(f"| {' | '.join([name, title, *cells(costs, run)])} |", flush=True)
    print(f"\nload averages then: {os.getloadavg()}")


if __name__ == "__main__":
    main()
