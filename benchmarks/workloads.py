"""Runs one workload on the jaxurban of one checkout and prints, as JSON, what it took and what came out.

`benchmarks.against_commit` starts this in a fresh process for each measurement. It imports nothing else of this folder
and uses public names and commands only. CPU seconds are of all threads, after an untimed run, so that nothing compiles
in what is timed; commands are measured whole. What comes out is named and compared as text: arrays by a hash, their
type, shape and sum.
"""

import argparse
import dataclasses
import hashlib
import json
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import rasterio
import xarray as xr
from scipy.ndimage import label

import jaxurban as ju

DATA = Path(
    os.environ.get("JAXURBAN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
).resolve()
ALTITUDE_M = 20.0
Raster = get_args(ju.City.__annotations__["terrain"])[
    0
]  # which module holds it, checkouts differ in
LARGE, MIDDLE, SMALL = "large", "middle", "small"  # folders of maps, made once
CITIES = {  # width and height in metres, metres a cell
    LARGE: ((10_000, 20_000), 5.0),  # 2000 x 4000 cells
    MIDDLE: ((3_400, 3_400), 5.0),
    SMALL: ((1_000, 1_000), 10.0),
}
HIDDEN = ju.Weights(distance=0.3, gps=0.5, lidar=0.2, population=2.0, risk=3.0)
BUDGET_S = 1e6  # no search meets it
LEAST_S, NUM_RUNS = 2.0, 3  # CPU seconds of all timed runs in a process, and how many at least
OF_THE_CLOCK = re.compile(r"elapsed|seconds|fastest|time_ratio|_utc|_s$|_s_|batches|version|_key$")
SCENARIOS = {  # of `jaxurban maps`, from files to files
    "tokyo": f"""
[region]
bounds = [139.680, 35.655, 139.785, 35.720]
resolution_m = 2.0
altitudes_m = [20, 60, 122]
[buildings]
source = "{DATA}/tokyo/tokyo-central-lod2.parquet"
[gps]
orbits = ["{DATA}/tokyo/gps_2018-12-19.tle", "{DATA}/tokyo/galileo_2018-12-19.tle"]
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
    "small": """
[region]
bounds = [-73.976, 40.7755, -73.964, 40.7845]
resolution_m = 10.0
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
[study]
instances = 4
planners = ["ptp", "astar-dist", "astar-plus", "theta-star", "bitstar-dist", "bitstar-plus"]
""",
}
FIRST = """
import jaxurban as ju
maps = ju.build_maps(ju.demo_city(600, 600), resolution_m=20.0)
x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
print(ju.plan(maps, ju.XY(x_m[0], y_m[0]), ju.XY(x_m[-1], y_m[-1]), altitude_m=600.0).cost)
"""
Took = dict[str, float]  # CPU seconds, or what its name says, by part
Facts = dict[str, str]  # by name


def digest(array: Any) -> str:
    """Return what stands for an array: a hash of its bytes, its type and shape, and its sum for a person to read."""
    values = np.ascontiguousarray(array)
    total = f" sum {np.nansum(values, dtype=float)!r}" if values.dtype.kind in "fiub" else ""
    return f"{hashlib.sha256(values.tobytes()).hexdigest()[:20]} {values.dtype}{list(values.shape)}{total}"


def of_dataset(name: str, dataset: xr.Dataset) -> Facts:
    """Return a digest of every variable and coordinate."""
    return {
        f"{name} {variable}": digest(dataset[variable].values)
        for variable in sorted(map(str, dataset.variables))
    }


def of_paths(name: str, paths: list[Any]) -> Facts:
    """Return status, cost, length, metrics and points of paths."""
    facts = {}
    for k, path in enumerate(paths):
        numbers = {"cost": path.cost, "length_m": path.length_m} | dict(path.metrics)
        facts |= {f"{name} {k} {key}": repr(float(value)) for key, value in numbers.items()}
        facts |= {f"{name} {k} status": path.status.value, f"{name} {k} points": digest(path.xy_m)}
    return facts


def of_files(folder: Path) -> Facts:
    """Return what the GeoTIFFs (overviews too), Zarrs and tables under a folder hold; what the clock decides apart."""
    facts: Facts = {}
    for file in sorted(folder.rglob("*")):
        name = str(file.relative_to(folder))
        if file.suffix == ".tif":
            with rasterio.open(file) as raster:
                levels = [
                    {},
                    *({"overview_level": level} for level in range(len(raster.overviews(1)))),
                ]
            for level in levels:
                with rasterio.open(file, **level) as raster:
                    facts[f"{name} {level}"] = digest(raster.read(1))
        elif file.parent.suffix == ".zarr" and file.is_dir():
            facts |= of_dataset(name, xr.open_zarr(file.parent, group=file.name))
        elif file.suffix in (".csv", ".parquet"):
            table = pd.read_csv(file, dtype=str) if file.suffix == ".csv" else pd.read_parquet(file)
            kept = table[[column for column in table if not OF_THE_CLOCK.search(column)]].map(str)
            rows = sorted(kept.itertuples(index=False, name=None))
            facts |= {
                f"{name} row {k} {c}": v
                for k, row in enumerate(rows)
                for c, v in zip(kept, row, strict=True)
            }
    return facts


def timed(name: str, work: Callable[[], Facts]) -> tuple[Took, Facts]:
    """Return the median CPU seconds of runs after an untimed one, more of them of short work."""
    facts, seconds = work(), []
    while len(seconds) < NUM_RUNS or sum(seconds) < LEAST_S:
        began_s = time.process_time()
        work()
        seconds.append(time.process_time() - began_s)
    return {name: statistics.median(seconds)}, facts


def used_by(command: list[str], environment: dict[str, str] | None = None) -> tuple[Took, str]:
    """Return what a process took, and what it printed.

    Raises:
      SystemExit: it failed.
    """
    began_s = time.perf_counter()
    with tempfile.TemporaryFile("w+") as printed:
        process = subprocess.Popen(
            command, env=environment, stdout=printed, stderr=subprocess.STDOUT
        )
        _, status, used = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - began_s
        printed.seek(0)
        text = printed.read()
    if status:
        raise SystemExit(f"{command} failed: {text[-2000:]}")
    took = {
        "CPU": used.ru_utime + used.ru_stime,
        "wall": wall_s,
        "memory, MiB": used.ru_maxrss / 1024,
    }
    return took, text


def jaxurban(name: str, *words: object) -> Took:
    """Run a command of jaxurban; return what it took by ``name``."""
    took, _ = used_by([sys.executable, "-P", "-m", "jaxurban", *map(str, words)])
    return {f"{name}, {part}": value for part, value in took.items()}


def opened(folder: Path, name: str) -> ju.MetricMaps:
    """Return maps of the synthetic city, made and saved where they are not yet there."""
    (width_m, height_m), resolution_m = CITIES[name]
    if not (folder / name).exists():
        maps = ju.build_maps(
            ju.demo_city(width_m, height_m), resolution_m=resolution_m, altitudes_m=(ALTITUDE_M,)
        )
        maps.save(folder / f"{name}-unfinished")
        (folder / f"{name}-unfinished").rename(folder / name)
    return ju.open_maps(folder / name)


def queries(maps: ju.MetricMaps, num: int, seed: int) -> pd.DataFrame:
    """Return queries between random cells of the largest free part of the maps."""
    parts, _ = label(ju.Constraints().is_free(maps, ALTITUDE_M))
    cells = np.argwhere(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    ends = cells[np.random.default_rng(seed).integers(len(cells), size=(num, 2))]
    x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
    of = {"start_x_m": x_m[ends[:, 0, 1]], "start_y_m": y_m[ends[:, 0, 0]]}
    return pd.DataFrame(of | {"goal_x_m": x_m[ends[:, 1, 1]], "goal_y_m": y_m[ends[:, 1, 0]]})


def ends_of(maps: ju.MetricMaps, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the ends of twelve random queries as `plan` takes them."""
    for row in queries(maps, 12, seed).itertuples():
        yield {
            "start": ju.XY(row.start_x_m, row.start_y_m),
            "goal": ju.XY(row.goal_x_m, row.goal_y_m),
        }


def build(
    name: str, width_m: float, height_m: float, how: dict[str, Any], folder: Path
) -> tuple[Took, Facts]:
    """The maps of a synthetic city, made in memory at 10 m; the city is made before."""
    city, how = ju.demo_city(width_m, height_m), {"altitudes_m": (ALTITUDE_M,)} | how
    return timed(name, lambda: of_dataset(name, ju.build_maps(city, resolution_m=10.0, **how).ds))


def terrain(folder: Path) -> tuple[Took, Facts]:
    """Maps over hills of 10 m: mostly lidar."""
    city = ju.demo_city(2_000, 2_000)
    x_m, y_m, east_m, north_m = city.extent_m
    num = int(max(east_m - x_m, north_m - y_m) // 50) + 42
    row, col = np.mgrid[:num, :num]
    hills_m = (5 * (np.sin(row / 6) + np.sin(col / 5))).astype(np.float32)
    ground = Raster(hills_m, (50.0, 0.0, x_m - 1000, 0.0, -50.0, north_m + 1000), city.crs)
    extent_m = (x_m - 1000, north_m + 1000 - 50 * num, x_m - 1000 + 50 * num, north_m + 1000)
    hilly = dataclasses.replace(city, terrain=ground, terrain_extent_m=extent_m)
    how = {"resolution_m": 10.0, "altitudes_m": (ALTITUDE_M,)}
    return timed("terrain", lambda: of_dataset("terrain", ju.build_maps(hilly, **how).ds))


def gradient(folder: Path) -> tuple[Took, Facts]:
    """The gradient of a route's cost by every building, through soft maps; the route and the soft city made before."""
    city = ju.demo_city(3_000, 3_000)
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(ALTITUDE_M,))
    planned = ju.plan(
        maps,
        **next(ends_of(maps, 4)),
        altitude_m=ALTITUDE_M,
        planner="astar-plus",
        budget_s=BUDGET_S,
    )
    params = ju.grad.SoftParams(ALTITUDE_M, 2.0)
    soft = ju.grad.soft_city(city, maps.grid, params)

    def work() -> Facts:
        return {
            "gradient": f"{ju.studies.building_costs(city, soft, planned, params)['per_metre'].abs().sum():.6g}"
        }

    return timed("gradient", work)


def astar(folder: Path) -> tuple[Took, Facts]:
    """A* on 8 M cells: the first plan on opened maps, then later ones; compiled before on small maps."""
    how = {"altitude_m": ALTITUDE_M, "planner": "astar-plus", "budget_s": BUDGET_S}
    small, maps = opened(folder, SMALL), opened(folder, LARGE)
    ju.plan(small, **next(ends_of(small, 0)), **how)
    seconds, paths = [], []
    for ends in ends_of(maps, 2):
        began_s = time.process_time()
        paths.append(ju.plan(maps, **ends, **how))
        seconds.append(time.process_time() - began_s)
    return {"astar, first": seconds[0], "astar, later": statistics.median(seconds[1:])}, of_paths(
        "astar", paths
    )


def many(
    name: str, maps_name: str, num: int, how: dict[str, Any], folder: Path
) -> tuple[Took, Facts]:
    """A batch of random queries."""
    maps = opened(folder, maps_name)
    asked, how = queries(maps, num, 3), {"altitude_m": ALTITUDE_M, "budget_s": BUDGET_S} | how
    return timed(name, lambda: of_paths(name, list(ju.plan_many(maps, asked, **how))))


def volume(folder: Path) -> tuple[Took, Facts]:
    """Paths between levels."""
    maps = ju.build_maps(ju.demo_city(1_000, 1_000), resolution_m=10.0, altitudes_m=(20.0, 60.0))
    how = {"altitude_m": ju.Levels(level_step_m=20.0), "budget_s": BUDGET_S, "cost_model": "line"}
    ends = list(ends_of(maps, 5))
    return timed(
        "volume", lambda: of_paths("volume", [ju.plan(maps, **each, **how) for each in ends])
    )


def fit(folder: Path) -> tuple[Took, Facts]:
    """`fit_weights` on 20 routes; reading them is left out."""
    maps, file = opened(folder, SMALL), folder / "routes.geojson"
    if not file.exists():
        ju.plan_many(maps, queries(maps, 20, 1), altitude_m=ALTITUDE_M, weights=HIDDEN).save(file)
    read = getattr(ju.fit, "demonstrations", None) or ju.fit.read_demonstrations  # before 2.0
    routes = read(file, maps)

    def work() -> Facts:  # the numbers alone, whatever holds them
        found = repr(
            ju.fit.fit_weights(routes, bootstrap=50, settings=ju.fit.FitSettings(seed=0)).weights
        )
        return {f"fit {k}": number for k, number in enumerate(re.findall(r"\d[\d.e-]*", found))}

    return timed("fit", work)


def files(name: str, folder: Path) -> tuple[Took, Facts]:
    """A whole ``jaxurban maps``; its stages are of the wall."""
    if str(DATA) in SCENARIOS[name] and not DATA.exists():
        return {}, {f"{name}": "left out: no data"}
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        scenario, out = Path(scratch, "scenario.toml"), Path(scratch, "out")
        scenario.write_text(SCENARIOS[name])
        took = jaxurban(name, "maps", scenario, "-o", out)
        stages = json.loads((out / "run.json").read_text())["elapsed_s"]
        return took | {f"{name}, {stage}, wall": float(s) for stage, s in stages.items()}, of_files(
            out
        )


def studies(folder: Path) -> tuple[Took, Facts]:
    """The commands ``study`` (BIT* by a number of samples) and ``sensitivity``, and the tables they write."""
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        scenario, out, table = (
            Path(scratch, "scenario.toml"),
            Path(scratch, "out"),
            Path(scratch, "queries.csv"),
        )
        scenario.write_text(SCENARIOS["small"])
        took = jaxurban(
            "study",
            "study",
            scenario,
            "-o",
            out,
            "--set",
            "study.budget_iterations=300",
            "--workers",
            1,
        )
        queries(ju.open_maps(out), 3, 6).assign(altitude_m=ALTITUDE_M).to_csv(table, index=False)
        asked = ("--routes", table, "--workers", 1)
        took |= jaxurban(
            "sensitivity", "sensitivity", out, *asked, "-o", Path(scratch, "sensitivity")
        )
        return took, of_files(Path(scratch))


def memory(folder: Path) -> tuple[Took, Facts]:
    """The greatest memory of a process that opens maps of 8 M cells and plans once on them, MiB."""
    maps = ju.open_maps(folder / LARGE)
    x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
    free = ju.Constraints().is_free(maps, ALTITUDE_M)
    # Along the middle, without `label`, which takes memory of its own.
    cells = [
        (int(row), int(np.flatnonzero(free[row])[0]))
        for row in (free.shape[0] // 4, 3 * free.shape[0] // 4)
    ]
    start, goal = ((x_m[col], y_m[row]) for row, col in cells)
    path = ju.plan(
        maps, ju.XY(*start), ju.XY(*goal), altitude_m=ALTITUDE_M, budget_s=BUDGET_S, snap=True
    )
    used_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"memory, MiB": used_mib}, of_paths("memory", [path])


def first(folder: Path) -> tuple[Took, Facts]:
    """All of a process that makes maps of 30 x 30 cells and plans as its first act: caches empty, then filled."""
    own = {
        name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "NUMBA_"))
    }
    with tempfile.TemporaryDirectory(dir=folder) as caches:
        own |= {
            "JAX_PLATFORMS": "cpu",
            "XDG_CACHE_HOME": caches,
            "NUMBA_CACHE_DIR": f"{caches}/numba",
        }
        runs = [used_by([sys.executable, "-P", "-c", FIRST], own) for _ in range(1 + NUM_RUNS)]
    filled_s = statistics.median(took["CPU"] for took, _ in runs[1:])
    printed = {f"first {k}": text.strip().splitlines()[-1] for k, (_, text) in enumerate(runs)}
    return {"first, empty caches": runs[0][0]["CPU"], "first, filled caches": filled_s}, printed


TIMES = [f"2024-05-29T{hour:02d}:00:00Z" for hour in range(0, 24, 4)]
SPREAD = {"gps": ju.Gps(bounds=True), "heights": ju.Heights(height_samples=2)}
WORKLOADS: dict[str, Callable[[Path], tuple[Took, Facts]]] = {
    "build_maps": partial(build, "build_maps", 5_000, 10_000, {"altitudes_m": (20.0, 60.0)}),
    "series": partial(
        build,
        "series",
        5_000,
        5_000,
        {"gps": ju.Gps(times=TIMES), "altitudes_m": (20.0, 40.0, 60.0, 122.0)},
    ),
    "supersampled": partial(build, "supersampled", 2_500, 5_000, {"oversample": 2}),
    "spread": partial(build, "spread", 1_000, 1_000, {"oversample": 3, **SPREAD}),
    "terrain": terrain,
    "gradient": gradient,
    "astar": astar,
    "plan_many": partial(many, "plan_many", MIDDLE, 200, {}),
    "landmarks": partial(many, "landmarks", MIDDLE, 200, {"heuristic": "landmarks"}),
    "astar-line": partial(
        many, "astar-line", SMALL, 30, {"planner": "astar-dist", "cost_model": "line"}
    ),
    "theta-star": partial(
        many, "theta-star", SMALL, 30, {"planner": "theta-star", "cost_model": "line"}
    ),
    "volume": volume,
    "fit": fit,
    "studies": studies,
    "memory": memory,
    "first": first,
    "tokyo": partial(files, "tokyo"),
    "paper": partial(files, "paper"),
}


def main() -> None:
    """Run the workload that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", type=Path)
    parser.add_argument(
        "folder", type=Path, help="of the maps that workloads read, made where they are not there"
    )
    parser.add_argument("name", choices=WORKLOADS)
    asked = parser.parse_args()
    if not Path(ju.__file__).is_relative_to(asked.checkout):
        raise SystemExit(f"jaxurban is imported from {ju.__file__}, not from {asked.checkout}")
    asked.folder.mkdir(parents=True, exist_ok=True)
    took, facts = WORKLOADS[asked.name](asked.folder)
    print(json.dumps({"took": took, "facts": facts}))


if __name__ == "__main__":
    main()
