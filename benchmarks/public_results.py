"""Prints, as JSON, what the jaxurban of one checkout computes: maps, paths and weight studies, by public names only.

`benchmarks.same_results` runs this for two checkouts and compares. It imports nothing else of this folder. Commands are
run in this process. All searches end by themselves, and BIT* after a number of samples (by ``study``, the only command
that sets one), so that no result depends on the clock.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import re
import runpy
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w

import jaxurban as ju

SCENARIOS = Path(__file__).with_name("public_scenarios.toml")
DATA = os.environ.get("JAXURBAN_DATA", "")
ALTITUDE_M = 20.0
COST_MODELS = ("cell", "line")
OF_THE_CLOCK = re.compile(r"elapsed|seconds|(?:setup_s|_utc|[. ]batches|[. ]folder|[. ]version|_key)$")
BUDGET_S = 1e6  # no search meets it
Facts = dict[str, str]


def digest(array: Any) -> str:
    """Return what stands for an array: a hash of its bytes, its type and shape, and its sum for a person to read."""
    values = np.ascontiguousarray(array)
    total = f" sum {np.nansum(values)!r}" if values.dtype.kind in "fiub" else ""
    return f"{hashlib.sha256(values.tobytes()).hexdigest()[:20]} {values.dtype}{list(values.shape)}{total}"


def flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the leaves of JSON-like values by name, without what the clock decides."""
    if OF_THE_CLOCK.search(name):
        return
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from flat(f"{name}.{key}", part)
    elif isinstance(value, list | tuple) and len(value) > 8:
        yield name, digest(np.asarray(value)) if np.ndim(value) and not isinstance(value[0], Mapping) else repr(value)
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from flat(f"{name}[{number}]", part)
    else:
        yield name, repr(value.item() if hasattr(value, "item") else value)


def of_table(name: str, table: pd.DataFrame) -> Facts:
    """Return every cell of a table by column and row."""
    return dict(flat(name, {str(column): {f"{k}": v for k, v in enumerate(table[column])} for column in table}))


def of_maps(name: str, maps: Any) -> Facts:
    """Return a digest of every variable and coordinate of maps."""
    return {f"{name} {variable}": digest(maps.ds[variable].values) for variable in sorted(map(str, maps.ds.variables))}


def of_path(name: str, path: Any) -> Facts:
    """Return status, cost, length, metrics and points of a path."""
    if path is None:
        return {f"{name} path": "None"}
    facts = {"status": path.status.value, "cost": path.cost, "length_m": path.length_m, "metrics": dict(path.metrics)}
    return dict(flat(name, facts)) | {f"{name}.points": digest(path.xy_m)}


def command(*words: object) -> str:
    """Run a command of jaxurban in this process and return what it prints on stdout; no path is no failure."""
    printed, sys.argv = io.StringIO(), ["jaxurban", *map(str, words)]
    try:
        with contextlib.redirect_stdout(printed):
            runpy.run_module("jaxurban", run_name="__main__")
    except SystemExit as end:
        if end.code not in (None, 0, 3):
            raise RuntimeError(f"jaxurban {' '.join(map(str, words))} ended with {end.code}") from end
    return printed.getvalue()


def scenario(folder: Path, name: str) -> Path:
    """Write one of the scenarios and return its file."""
    settings = tomllib.loads(SCENARIOS.read_text(encoding="utf-8").replace("{data}", DATA))
    file = folder / f"{name}.toml"
    file.write_text(tomli_w.dumps(settings[name]), encoding="utf-8")
    return file


def made(folder: Path, name: str) -> Any:
    """Return the maps of a scenario, made by the command under ``folder``."""
    command("maps", scenario(folder, name), "-o", folder / name)
    return ju.open_maps(folder / name)


def places(maps: Any, cells: np.ndarray) -> pd.DataFrame:
    """Return queries between cells ``[Q, 2, 2]``: start and goal, row and column."""
    x_m, y_m = (maps.ds[name].values.astype(float) for name in ("x", "y"))
    ends = {"start": cells[:, 0], "goal": cells[:, 1]}
    return pd.DataFrame(
        {f"{end}_{axis}_m": of[at[:, k]] for end, at in ends.items() for axis, of, k in (("x", x_m, 1), ("y", y_m, 0))}
    )


def planned(name: str, maps: Any, queries: pd.DataFrame, **how: Any) -> Facts:
    """Return the facts of a batch of queries."""
    paths = ju.plan_many(maps, queries, altitude_m=ALTITUDE_M, budget_s=BUDGET_S, **how)
    told = " ".join(f"{value}" for value in how.values())
    return {key: value for k, path in enumerate(paths) for key, value in of_path(f"{name} {told} {k}", path).items()}


def free_cells(maps: Any) -> np.ndarray:
    """Return ``[N, 2]`` row and column of the cells where planners may fly."""
    return np.argwhere(ju.Constraints().is_free(maps, ALTITUDE_M))


def synthetic(folder: Path) -> Facts:
    """Maps in memory, and every planner that the clock does not decide."""
    maps = ju.build_maps(ju.demo_city(2_000, 2_000), resolution_m=10.0, altitudes_m=(20.0, 60.0))
    facts = of_maps("synthetic in memory", maps)
    free = free_cells(maps)
    queries = places(maps, free[np.random.default_rng(0).integers(len(free), size=(30, 2))])
    weights = ju.Weights(distance=1.0, gps=0.5, lidar=0.0, population=2.0, risk=3.0)
    for model in COST_MODELS:
        for planner in ("ptp", "astar-dist", "astar-plus", "astar-anytime", "theta-star"):
            if (planner, model) != ("theta-star", "cell"):
                facts |= planned("synthetic", maps, queries, planner=planner, cost_model=model)
        facts |= planned("synthetic", maps, queries[:8], cost_model=model, objective="distance")
        other = ju.plan_many(maps, queries[:8], altitude_m=60.0, weights=weights, time_of_day="night", cost_model=model)
        facts |= {key: v for k, path in enumerate(other) for key, v in of_path(f"night {model} {k}", path).items()}
        for k, row in enumerate(queries[:6].itertuples(index=False)):
            ends = {"start_xy_m": (row.start_x_m, row.start_y_m), "goal_xy_m": (row.goal_x_m, row.goal_y_m)}
            one = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, cost_model=model, budget_s=BUDGET_S)
            facts |= of_path(f"alone {model} {k}", one)
            how = {**ends, "cost_model": model, "budget_s": BUDGET_S}
            if hasattr(ju, "Levels"):
                volume = ju.plan(maps, altitude_m=ju.Levels(level_step_m=20.0), **how)
            else:  # as it was asked for before
                volume = ju.plan_volume(maps, level_step_m=20.0, **how)
            facts |= of_path(f"volume {model} {k}", volume) | {f"volume {model} {k} heights": digest(volume.z_m)}
    return facts


def tiled(folder: Path) -> Facts:
    """Maps of two tiles, and those of the rarer settings."""
    facts: Facts = {}
    for name in ("tiled", "detailed", "series"):
        facts |= of_maps(name, made(folder, name))
    # Its scenario says line and 4 neighbours.
    found = json.loads(command("plan", folder / "detailed", *ends_of(folder / "detailed"), "--report", "--json"))
    return facts | dict(flat("plan --report", found))


def ends_of(folder: Path) -> list[str]:
    """Return the options of a command that place a query on free cells, a quarter in from two corners."""
    maps = ju.open_maps(folder)
    free = free_cells(maps)
    shape = np.array(maps.is_free(ALTITUDE_M).shape)
    cells = [free[np.argmin(np.hypot(*(free - share * shape).T))] for share in (0.25, 0.75)]
    row = next(places(maps, np.array([cells])).itertuples(index=False))
    found = ju.plan(maps, start_xy_m=row[:2], goal_xy_m=row[2:], altitude_m=ALTITUDE_M)
    lonlat = ([f"{degrees:.9f}" for degrees in found.lonlat[at]] for at in (0, -1))
    start, goal = (",".join(each) for each in lonlat)
    return [f"--start={start}", f"--goal={goal}", "--altitude", f"{ALTITUDE_M:g}"]


def studies(folder: Path) -> Facts:
    """The numbers of ``study`` (BIT* among its planners), ``sensitivity`` and ``tune``."""
    out = folder / "small"
    command("study", scenario(folder, "small"), "-o", out, "--budget-iterations", 300, "--workers", 1)
    keys = ["planner", "objective", "instance", "altitude_m"]
    facts = of_table("study rows", pd.read_parquet(out / "study" / "rows.parquet").sort_values(keys))
    maps = ju.open_maps(out)
    ends = ends_of(out)
    asked = {"": (), " --require": ("--require", "gps>=0.1"), " --volume": ("--volume", "--max-altitude", "60")}
    for name, options in asked.items():
        found = json.loads(command("plan", out, *ends, *options, "--report", "--json"))
        facts |= dict(flat(f"plan{name}", found))
    for model in COST_MODELS:
        given = ("--samples", 16, "--tolerance", 0.02, "--cost-model", model)
        command("sensitivity", out, *ends, *given, "-o", folder / f"sensitivity-{model}")
        for table in sorted((folder / f"sensitivity-{model}").rglob("*.csv")):
            facts |= of_table(f"sensitivity {model} {table.stem}", pd.read_csv(table, dtype=str))
    free = free_cells(maps)
    queries = places(maps, free[np.random.default_rng(1).integers(len(free), size=(12, 2))])
    hidden = ju.Weights(distance=0.3, gps=0.5, lidar=0.2, population=2.0, risk=3.0)
    routes = [
        path for path in ju.plan_many(maps, queries, altitude_m=ALTITUDE_M, weights=hidden) if len(path.lonlat) > 1
    ]
    lines = [
        {
            "type": "Feature",
            "properties": {"altitude_m": ALTITUDE_M},
            "geometry": {"type": "LineString", "coordinates": path.lonlat.tolist()},
        }
        for path in routes
    ]
    (folder / "routes.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": lines}))
    command("tune", out, folder / "routes.geojson", "-o", folder / "tune", "--bootstrap", 20)
    for table in sorted((folder / "tune").glob("*.csv")):
        facts |= of_table(f"tune {table.stem}", pd.read_csv(table, dtype=str))
    return facts


def manhattan(folder: Path) -> Facts:
    """Lower Manhattan and the queries of its test, where the data are at hand."""
    if not Path(DATA, "osm", "lower-manhattan.osm.pbf").exists():
        return {"manhattan": "left out: no data"}
    maps = made(folder, "manhattan")
    facts = of_maps("manhattan", maps)
    free, rng = free_cells(maps), np.random.default_rng(9)
    starts = free[rng.integers(len(free), size=20)]
    cells = np.array([[start, goal] for start in starts for goal in free[rng.integers(len(free), size=10)]])
    queries = places(maps, cells)
    for model in COST_MODELS:
        for planner, heuristic in (
            ("astar-dist", None),
            ("astar-plus", "plus"),
            ("astar-plus", "landmarks"),
            ("astar-plus", "exact"),
            ("astar-anytime", "landmarks"),
        ):
            how = {"planner": planner, "heuristic": heuristic, "cost_model": model, "time_of_day": "day"}
            facts |= planned("manhattan", maps, queries, **how)
    rng = np.random.default_rng(0)
    pairs = np.array([free[rng.choice(len(free), 2, replace=False)] for _ in range(200)])
    for planner, heuristic in (("astar-dist", "octile"), ("astar-plus", "landmarks"), ("astar-anytime", "plus")):
        how = {"planner": planner, "heuristic": heuristic, "time_of_day": "day"}
        facts |= planned("manhattan pairs", maps, places(maps, pairs), **how)
    return facts


PARTS: dict[str, Callable[[Path], Facts]] = {
    "synthetic": synthetic,
    "tiled": tiled,
    "studies": studies,
    "manhattan": manhattan,
}


def main() -> None:
    """Print the facts of the parts that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("folder", type=Path, help="for files on the way")
    parser.add_argument("parts", nargs="+", choices=PARTS)
    asked = parser.parse_args()
    if not Path(ju.__file__).is_relative_to(asked.checkout):
        raise SystemExit(f"jaxurban is imported from {ju.__file__}, not from {asked.checkout}")
    asked.folder.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Facts] = {}
    for part in asked.parts:
        began_s = time.perf_counter()
        facts[part] = PARTS[part](asked.folder)
        print(f"{asked.checkout}: {part} {time.perf_counter() - began_s:.0f} s", file=sys.stderr, flush=True)
    print(json.dumps(facts))


if __name__ == "__main__":
    main()
