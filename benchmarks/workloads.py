"""Runs one workload on the jaxurban of one checkout and prints, as JSON, the CPU seconds of its measured parts.

`benchmarks.against_commit` starts this in a fresh process for each measurement. It imports nothing else of this folder
and uses public names only. A workload runs once untimed, so that nothing compiles in what is timed.
"""

import argparse
import dataclasses
import gc
import json
import os
import re
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.world.city import Raster

ALTITUDE_M = 20.0
LARGE, MIDDLE, SMALL = "large", "middle", "small"  # folders of maps, made once by `prepare`
CITIES = {  # width and height in metres, metres a cell
    LARGE: ((10_000, 20_000), 5.0),  # 2000 x 4000 cells
    MIDDLE: ((3_400, 3_400), 5.0),
    SMALL: ((1_000, 1_000), 10.0),
}
INSTANCES, ROUTES = "instances.parquet", "routes.geojson"
NUM_QUERIES, NUM_ROUTES, NUM_INSTANCES, NUM_SAMPLES = 200, 20, 30, 8000
BUDGET_S = 1e6  # no search meets it
LEAST_S = 2.0  # CPU seconds of all runs in a process
Found = dict[str, Any]  # CPU seconds or bytes by part, and "answer", which both checkouts must share


def random_queries(maps: Any, num: int, seed: int) -> pd.DataFrame:
    """Return queries between random cells of the largest free part of the maps."""
    parts, _ = label(ju.Constraints().is_free(maps, ALTITUDE_M))
    cells = np.argwhere(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    ends = cells[np.random.default_rng(seed).integers(len(cells), size=(num, 2))]
    x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
    return pd.DataFrame(
        {
            "start_x_m": x_m[ends[:, 0, 1]],
            "start_y_m": y_m[ends[:, 0, 0]],
            "goal_x_m": x_m[ends[:, 1, 1]],
            "goal_y_m": y_m[ends[:, 1, 0]],
        }
    )


def prepare(folder: Path, names: list[str]) -> None:
    """Make the maps, instances and routes that the workloads read, those not there yet."""
    for name in names:
        (width_m, height_m), resolution_m = CITIES[name]
        if not (folder / name).exists():
            city = ju.demo_city(width_m, height_m)
            maps = ju.build_maps(city, resolution_m=resolution_m, altitudes_m=(ALTITUDE_M,))
            maps.save(folder / f"{name}-unfinished")
            (folder / f"{name}-unfinished").rename(folder / name)
    maps = ju.open_maps(folder / SMALL)
    if not (folder / INSTANCES).exists():
        ju.sample_instances(maps, NUM_INSTANCES, altitudes_m=[ALTITUDE_M], seed=0).to_parquet(folder / INSTANCES)
    if not (folder / ROUTES).exists():
        hidden = ju.Weights(distance=0.3, gps=0.5, lidar=0.2, population=2.0, risk=3.0)
        paths = ju.plan_many(maps, random_queries(maps, NUM_ROUTES, 1), altitude_m=ALTITUDE_M, weights=hidden)
        lines = [
            {
                "type": "Feature",
                "properties": {"altitude_m": ALTITUDE_M},
                "geometry": {"type": "LineString", "coordinates": path.lonlat.tolist()},
            }
            for path in paths
        ]
        (folder / ROUTES).write_text(json.dumps({"type": "FeatureCollection", "features": lines}))


def settings(kind: Callable[..., Any], name: str, **values: Any) -> dict[str, Any]:
    """Return the arguments that set values of a call: older checkouts take them one by one, newer ones together."""
    return {"settings": getattr(ju, name)(**values)} if "settings" in signature(kind).parameters else values


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the CPU seconds of a call, all threads, and what it returns.

    Python's collector of reference cycles rests meanwhile, as in `timeit`: whether it comes in one call or the next
    says nothing of either.
    """
    gc.collect()
    gc.disable()
    try:
        began_s = time.process_time()
        found = work()
        return time.process_time() - began_s, found
    finally:
        gc.enable()


def repeated(name: str, work: Callable[[], Any], num_runs: int) -> Found:
    """Return the median CPU seconds of runs after an untimed one, more of them of short work.

    ``work`` returns the answer.
    """
    answer = work()
    seconds: list[float] = []
    while len(seconds) < num_runs or sum(seconds) < LEAST_S:
        seconds.append(timed(work)[0])
    return {name: statistics.median(seconds), "answer": repr(answer)}


def build_maps(folder: Path, num_runs: int) -> Found:
    """The maps of the synthetic city, 10 m, two altitudes; the city is made before."""
    city = ju.demo_city(5_000, 10_000)

    def work() -> float:
        maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0, 60.0))
        return float(sum(maps.ds[name].sum() for name in ("gps", "lidar", "risk", "population")))

    return repeated("build_maps", work, num_runs)


def made_otherwise(name: str, num_runs: int, city: Any = None, **how: Any) -> Found:
    """The maps of a smaller synthetic city, 10 m, made in one way."""
    city = ju.demo_city(2_500, 5_000) if city is None else city

    def work() -> float:
        maps = ju.build_maps(city, resolution_m=10.0, **{"altitudes_m": (20.0,)} | how)
        return float(sum(maps.ds[layer].sum() for layer in ("gps", "lidar", "risk", "population")))

    return repeated(name, work, num_runs)


def series(folder: Path, num_runs: int) -> Found:
    """Maps of six times and four altitudes: mostly occlusion and DOPs."""
    times = [f"2024-05-29T{hour:02d}:00:00Z" for hour in range(0, 24, 4)]
    return made_otherwise(
        "series", num_runs, ju.demo_city(5_000, 5_000), times=times, altitudes_m=(20.0, 40.0, 60.0, 122.0)
    )


def supersampled(folder: Path, num_runs: int) -> Found:
    """Maps of cells sampled 2 x 2 times."""
    return made_otherwise("supersampled", num_runs, oversample=2)


def terrain(folder: Path, num_runs: int) -> Found:
    """Maps over hills of 10 m: mostly lidar."""
    city = ju.demo_city(2_000, 2_000)
    x_m, y_m, east_m, north_m = city.extent_m
    num = int(max(east_m - x_m, north_m - y_m) // 50) + 42
    row, col = np.mgrid[:num, :num]
    hills_m = (5 * (np.sin(row / 6) + np.sin(col / 5))).astype(np.float32)
    ground = Raster(hills_m, (50.0, 0.0, x_m - 1000, 0.0, -50.0, north_m + 1000), city.crs)
    extent_m = (x_m - 1000, north_m + 1000 - 50 * num, x_m - 1000 + 50 * num, north_m + 1000)
    hilly = dataclasses.replace(city, terrain=ground, terrain_extent_m=extent_m)
    return made_otherwise("terrain", num_runs, hilly)


def gradient(folder: Path, num_runs: int) -> Found:
    """The gradient of a route's cost by every building, through soft maps; the route and the soft city made before."""
    city = ju.demo_city(3_000, 3_000)
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(ALTITUDE_M,))
    row = next(random_queries(maps, 1, 4).itertuples())
    ends = {"start_xy_m": (row.start_x_m, row.start_y_m), "goal_xy_m": (row.goal_x_m, row.goal_y_m)}
    planned = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, planner="astar-plus", budget_s=BUDGET_S)
    params = ju.SoftParams(ALTITUDE_M, 2.0)
    soft = ju.soft_city(city, maps.grid, params)

    def work() -> str:
        return f"{ju.building_costs(city, soft, planned, params)['per_metre'].abs().sum():.6g}"

    return repeated("gradient", work, num_runs)


def plan_row(maps: Any, row: Any) -> float:
    """Return the cost of one query of `random_queries`."""
    ends = {"start_xy_m": (row.start_x_m, row.start_y_m), "goal_xy_m": (row.goal_x_m, row.goal_y_m)}
    return float(ju.plan(maps, **ends, altitude_m=ALTITUDE_M, planner="astar-plus", budget_s=BUDGET_S).cost)


def astar(folder: Path, num_runs: int) -> Found:
    """A* on 8 M cells: the first plan on opened maps, then later ones; compiled before on small maps."""
    small = ju.open_maps(folder / SMALL)
    plan_row(small, next(random_queries(small, 1, 0).itertuples()))
    maps = ju.open_maps(folder / LARGE)
    rows = list(random_queries(maps, 1 + num_runs, 2).itertuples())
    runs = [timed(lambda row=row: plan_row(maps, row)) for row in rows]
    later_s = statistics.median(seconds for seconds, _ in runs[1:])
    return {"astar, first": runs[0][0], "astar, later": later_s, "answer": repr([cost for _, cost in runs])}


def plan_many(folder: Path, num_runs: int) -> Found:
    """200 queries on the synthetic city in the size of Lower Manhattan, 5 m."""
    maps = ju.open_maps(folder / MIDDLE)
    queries = random_queries(maps, NUM_QUERIES, 3)

    def work() -> float:
        return float(sum(path.cost for path in ju.plan_many(maps, queries, altitude_m=ALTITUDE_M, budget_s=BUDGET_S)))

    return repeated("plan_many", work, num_runs)


def bitstar(folder: Path, num_runs: int) -> Found:
    """BIT* with a fixed number of samples, on the instances of a small study, and the rows that this keeps."""
    maps, instances = ju.open_maps(folder / SMALL), pd.read_parquet(folder / INSTANCES)
    scratch = Path.cwd()  # the checkout's caches

    told = {"planners": ("bitstar-plus",), "distance_only": (), "budget_iterations": NUM_SAMPLES, "seed": 0}
    how = settings(ju.study, "BenchmarkSettings", **told)

    def work() -> list[float]:
        out = scratch / f"study-{time.time_ns()}"
        return ju.study(maps, out, instances=instances, **how).rows["cost_line"].sort_values().tolist()

    return repeated("bitstar", work, num_runs)


def tune(folder: Path, num_runs: int) -> Found:
    """`fit_weights` on 20 routes; reading them is left out."""
    # The reader goes by the field's word in newer checkouts.
    read = getattr(ju, "read_examples", None) or ju.read_demonstrations
    routes = read(folder / ROUTES, ju.open_maps(folder / SMALL))

    how = settings(ju.fit_weights, "FitSettings", seed=0)

    def work() -> list[str]:  # the numbers alone, whatever holds them
        return re.findall(r"\d[\d.e-]*", repr(ju.fit_weights(routes, bootstrap=50, **how).weights))

    return repeated("tune", work, num_runs)


def memory(folder: Path, num_runs: int) -> Found:
    """The greatest memory of a process that opens maps of 8 M cells and plans once on them, MiB."""
    maps = ju.open_maps(folder / LARGE)
    x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
    free = ju.Constraints().is_free(maps, ALTITUDE_M)
    # Along the middle, without `label`, which takes memory of its own.
    cells = [(int(row), int(np.flatnonzero(free[row])[0])) for row in (free.shape[0] // 4, 3 * free.shape[0] // 4)]
    (start, goal) = ((x_m[col], y_m[row]) for row, col in cells)
    path = ju.plan(maps, start_xy_m=start, goal_xy_m=goal, altitude_m=ALTITUDE_M, budget_s=BUDGET_S, snap=True)
    return {
        "memory, MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "answer": f"{path.status.value} {path.cost!r}",
    }


def first(folder: Path, num_runs: int) -> Found:
    """All of a process that makes maps as its first act, its user having set nothing about caches."""
    script = "import jaxurban as ju; print(float(ju.build_maps(ju.demo_city(1000, 1000)).ds['gps'].mean()))"
    own = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    own |= {"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(folder.resolve() / "caches")}
    found = []
    for _ in range(num_runs + 1):  # the first fills the caches
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, "-c", script], env=own, capture_output=True, text=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        found.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return {"first build_maps of a session": statistics.median(found[1:]), "answer": done.stdout.strip()}


WORKLOADS: dict[str, tuple[Callable[[Path, int], Found], list[str]]] = {  # and the maps that they read
    "build_maps": (build_maps, []),
    "series": (series, []),
    "supersampled": (supersampled, []),
    "terrain": (terrain, []),
    "gradient": (gradient, []),
    "astar": (astar, [SMALL, LARGE]),
    "plan_many": (plan_many, [MIDDLE]),
    "bitstar": (bitstar, [SMALL]),
    "tune": (tune, [SMALL]),
    "memory": (memory, [LARGE]),
    "first": (first, []),
}


def main() -> None:
    """Run the workload that the command line names, or make what they read."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("folder", type=Path, help="of the maps that workloads read")
    parser.add_argument("names", nargs="+", choices=WORKLOADS)
    parser.add_argument("--prepare", action="store_true", help="make what these workloads read")
    parser.add_argument("--runs", type=int, default=3, help="of which the median is taken")
    asked = parser.parse_args()
    if not Path(ju.__file__).is_relative_to(asked.checkout):
        raise SystemExit(f"jaxurban is imported from {ju.__file__}, not from {asked.checkout}")
    asked.folder.mkdir(parents=True, exist_ok=True)
    if asked.prepare:
        prepare(asked.folder, sorted({SMALL, *(each for name in asked.names for each in WORKLOADS[name][1])}))
        return
    print(json.dumps(WORKLOADS[asked.names[0]][0](asked.folder, asked.runs)))


if __name__ == "__main__":
    main()
