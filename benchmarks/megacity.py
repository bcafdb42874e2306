"""A megacity on this machine: six copies of the synthetic city side by side, 30 x 40 km, mapped under a memory ceiling.

``python -m benchmarks.megacity [--resolution 2] [--memory 8GiB] [--workers 0 --workers 2]`` writes the roofs as a
GeoParquet, runs ``jaxurban maps`` on it in threads (0) or worker processes, and prints what the run foretold of memory
and disk, what it took at its highest (all processes together, looked at five times a second), and cells a second by
stage (``elapsed_s`` of run.json).
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import geopandas as gpd
import numpy as np
import psutil
import pyproj
import shapely

import jaxurban as ju
from benchmarks.common import load

COPIES = (2, 3)  # north, east
SIDE_M = (20_000.0, 10_000.0)
LOOK_EVERY_S = 0.2
SCENARIO = """
[region]
bounds = {bounds}
crs = "{crs}"
resolution_m = {resolution_m}
altitudes_m = [20, 60, 122]
[buildings]
source = "roofs.parquet"
"""


def write_city(folder: Path, resolution_m: float) -> Path:
    """Write the roofs and the scenario, and return this."""
    city = ju.demo_city(SIDE_M[1], SIDE_M[0])
    assert city.buildings is not None
    polygons, heights_m = [], []
    for north in range(COPIES[0]):
        for east in range(COPIES[1]):
            away = np.array([east * SIDE_M[1], north * SIDE_M[0]])
            polygons.append(shapely.transform(city.buildings.polygons, lambda xy, away=away: xy + away))
            heights_m.append(city.buildings.height_m)
    frame = gpd.GeoDataFrame({"height": np.concatenate(heights_m)}, geometry=np.concatenate(polygons), crs=city.crs)
    frame.to_parquet(folder / "roofs.parquet")
    x_m, y_m = city.extent_m[:2]
    box_m = (x_m, y_m, x_m + COPIES[1] * SIDE_M[1], y_m + COPIES[0] * SIDE_M[0])
    bounds = pyproj.Transformer.from_crs(city.crs, "EPSG:4326", always_xy=True).transform_bounds(*box_m)
    scenario = folder / "megacity.toml"
    scenario.write_text(SCENARIO.format(bounds=list(bounds), crs=city.crs, resolution_m=resolution_m))
    print(f"{len(frame):,} roofs", file=sys.stderr)
    return scenario


def bytes_of(process: psutil.Process) -> tuple[int, int]:
    """Return the memory of a process and of all that it started, and how much of it are pages of files."""
    total, of_files = 0, 0
    for each in (process, *process.children(recursive=True)):
        with suppress(psutil.Error):  # it has ended
            memory = each.memory_info()
            total, of_files = total + memory.rss, of_files + memory.shared
    return total, of_files


def measure(scenario: Path, folder: Path, memory: str, num_workers: int) -> None:
    """Print what one run foretells and takes."""
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "jaxurban", "maps", str(scenario), "-o", str(folder), "--memory", memory]
    command += ["--workers", str(num_workers)] if num_workers else []
    free, least_free, most_bytes = shutil.disk_usage(scenario.parent).free, float("inf"), (0, 0)
    began_s = time.perf_counter()
    with (scenario.parent / "log").open("w+") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        watched = psutil.Process(process.pid)
        while process.poll() is None:
            if (now := bytes_of(watched)) > most_bytes:
                most_bytes, at_s = now, time.perf_counter() - began_s
            least_free = min(least_free, shutil.disk_usage(scenario.parent).free)
            time.sleep(LOOK_EVERY_S)
        log.seek(0)
        said = [line for line in log if "cells" in line or "error" in line]
    wall_s = time.perf_counter() - began_s
    print(f"{' '.join(command[3:])}: exit {process.returncode}, {wall_s:.0f} s; foretold: {''.join(said).strip()}")
    gib, of_files = (size / 2**30 for size in most_bytes)
    print(f"at its highest, after {at_s:.0f} s, {gib:.2f} GiB of memory ({of_files:.2f} of files)", end=", ")
    print(f"{(free - least_free) / 2**30:.2f} GiB of disk")
    if process.returncode:
        sys.exit(process.returncode)
    record = json.loads((folder / "run.json").read_text())
    maps = ju.open_maps(folder)
    num_cells = maps.grid.num_rows * maps.grid.num_cols
    print(f"\n{num_cells:,} cells\n\n| stage | s | million cells a second |\n|---|---|---|")
    for stage, seconds in record["elapsed_s"].items():
        print(f"| {stage} | {seconds:.1f} | {num_cells / max(seconds, 1e-3) / 1e6:.2f} |")
    print(flush=True)


def main() -> None:
    """Print what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resolution", type=float, default=2.0)
    parser.add_argument("--memory", default="8GiB")
    parser.add_argument("--workers", type=int, action="append", help="0: threads; may be given several times")
    asked = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="megacity-"))
    print(f"load {load()} before")
    try:
        scenario = write_city(work, asked.resolution)
        for num_workers in asked.workers or [0]:
            measure(scenario, work / "maps", asked.memory, num_workers)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"load {load()} after")


if __name__ == "__main__":
    main()
