"""Whole ``jaxurban maps`` commands of two checkouts in turn, from files to files: CPU seconds, wall, memory, by stage.

``python -m benchmarks.file_to_file OLD NEW [--pairs 3] [--only NAME]`` runs each job as a fresh process of OLD and NEW
in turn, after an untimed run of each that fills its caches of compiled programs. Prints a row for each job and each of
its stages (``elapsed_s`` of run.json, wall): both medians and the median of the pairs' ratios, old over new. Then
compares every value of the GeoTIFFs, overviews too, and of the Zarrs of both sides, and exits with 1 where one differs.

So that both make the same maps, satellites share one clock: a checkout that can solve for one of each constellation is
told not to, and one that cannot gets the scenario without that line.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rasterio
import xarray as xr

from benchmarks.checkouts import environment_of
from benchmarks.common import ROOT, load

DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data")).resolve()
TOKYO = DATA / "tokyo"
JOBS = {
    "tokyo": f"""
[region]
bounds = [139.680, 35.655, 139.785, 35.720]
resolution_m = 2.0
altitudes_m = [20, 60, 122]
[buildings]
source = "{TOKYO / "tokyo-central-lod2.parquet"}"
[gps]
orbits = ["{TOKYO / "gps_2018-12-19.tle"}", "{TOKYO / "galileo_2018-12-19.tle"}"]
times = ["2018-12-19T06:20:00Z"]
""",
    "paper": """
[region]
bounds = [-74.04, 40.68, -73.9215, 40.8601]
resolution_m = [2.0, 5.0, 10.0]
altitudes_m = [20, 60, 122, 600]
[buildings]
source = "synthetic"
""",
}
ONE_CLOCK = '[gps]\nclocks = "one"\n'
KNOWS_CLOCKS = "import jaxurban; print('clocks' in jaxurban.GpsParams.__dataclass_fields__)"
Figures = dict[str, float]  # of one run, by name


def scenario_for(checkout: Path, job: str, caches: Path) -> str:
    """Return the scenario of a job as a checkout takes it."""
    command = [sys.executable, "-P", "-c", KNOWS_CLOCKS]
    environment = environment_of(checkout, caches)
    told = subprocess.run(command, cwd=caches, env=environment, capture_output=True, text=True, check=True).stdout
    text = JOBS[job]
    if told.strip() == "False":
        return text
    return text.replace("[gps]\n", ONE_CLOCK) if "[gps]" in text else text + ONE_CLOCK


def run(checkout: Path, scenario: Path, folder: Path, caches: Path) -> Figures:
    """Make the maps of a scenario with a checkout's jaxurban and return what that took."""
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-P", "-m", "jaxurban", "maps", str(scenario), "-o", str(folder)]
    environment, began_s = environment_of(checkout, caches), time.perf_counter()
    with (caches / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=caches, env=environment, stdout=log, stderr=log)
        _, status, used = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - began_s
    if status:
        raise SystemExit(f"{command} failed: {(caches / 'log').read_text()[-2000:]}")
    stages = json.loads((folder / "run.json").read_text())["elapsed_s"]
    return {
        "CPU, s": used.ru_utime + used.ru_stime,
        "wall, s": wall_s,
        "memory, MiB": used.ru_maxrss / 1024,
        **{f"{name}, s": float(seconds) for name, seconds in stages.items()},
    }


def rows(job: str, pairs: list[tuple[Figures, Figures]]) -> Iterator[str]:
    """Yield a table row for each figure that both sides give."""
    for name in pairs[0][0]:
        if any(name not in side for pair in pairs for side in pair):
            continue
        old, new = np.array([[side[name] for side in pair] for pair in pairs]).T
        ratio = np.median(old / np.maximum(new, 1e-9))
        yield f"| {job} | {name} | {np.median(old):.4g} | {np.median(new):.4g} | {ratio:.2f} |"


def differences(old: Path, new: Path) -> list[str]:
    """Return the maps of two folders that differ in a value, or that one of them lacks."""
    names = {side: {path.name for path in (side / "geotiff").glob("*.tif")} for side in (old, new)}
    found = sorted(names[old] ^ names[new])
    for name in sorted(names[old] & names[new]):
        files = old / "geotiff" / name, new / "geotiff" / name
        with rasterio.open(files[0]) as one, rasterio.open(files[1]) as other:
            levels = [None, *range(len(one.overviews(1)))]
            is_like = one.overviews(1) == other.overviews(1)
        if not is_like or any(not np.array_equal(*(values(file, level) for file in files)) for level in levels):
            found.append(name)
    for path in sorted((old / "maps.zarr").glob("*m")):
        a, b = (xr.open_zarr(side / "maps.zarr", group=path.name) for side in (old, new))
        for name in a.data_vars:
            if name not in b or not _is_same(a[name], b[name]):
                found.append(f"{path.name}/{name}")
    return found


def values(file: Path, level: int | None) -> np.ndarray:
    """Return the bits of a GeoTIFF's values, or of one of its overviews."""
    with rasterio.open(file) if level is None else rasterio.open(file, overview_level=level) as raster:
        found = raster.read(1)
    return found.view(f"u{found.itemsize}")


def _is_same(a: xr.DataArray, b: xr.DataArray) -> bool:
    """Return whether two variables hold the same, some rows at a time."""
    if a.shape != b.shape or a.ndim < 2:
        return a.identical(b)
    parts = (slice(start, start + 1024) for start in range(0, a.sizes[a.dims[-2]], 1024))
    return all(
        np.array_equal(*(each[..., part, :].values for each in (a, b)), equal_nan=a.dtype.kind == "f") for part in parts
    )


def main() -> None:
    """Print the table that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path, metavar="OLD", help="checkout")
    parser.add_argument("new", type=Path, metavar="NEW", help="checkout")
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--only", action="append", choices=JOBS, metavar="NAME", help=f"of {', '.join(JOBS)}")
    asked = parser.parse_args()
    work, before, different = Path(tempfile.mkdtemp(prefix="file-to-file-")), load(), []
    sides = (asked.old, work / "old"), (asked.new, work / "new")
    print("| job | figure | old | new | old / new |\n|---|---|---|---|---|")
    try:
        for job in asked.only or JOBS:
            pairs, scenarios = [], [place / f"{job}.toml" for _, place in sides]
            for (side, place), scenario in zip(sides, scenarios, strict=True):
                place.mkdir(exist_ok=True)
                scenario.write_text(scenario_for(side, job, place / "caches"))
            for number in range(asked.pairs + 1):
                found = [
                    run(side, scenario, place / job, place / "caches")
                    for (side, place), scenario in zip(sides, scenarios, strict=True)
                ]
                pairs.append((found[0], found[1]))
                print(f"{job}: {number} of {asked.pairs} pairs", file=sys.stderr, flush=True)
            print("\n".join(rows(job, pairs[1:])), flush=True)
            different += [f"{job}: {name}" for name in differences(*(place / job for _, place in sides))]
            for _, place in sides:
                shutil.rmtree(place / job)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"\nload {before} before, {load()} after; " + ("\n".join(different) or "every value is the same"))
    sys.exit(bool(different))


if __name__ == "__main__":
    main()
