"""A weight study of Lower Manhattan, Tokyo and the synthetic city, killed twice on its way, its breakpoints checked.

``python -m benchmarks.weight_study OUT`` takes the real files of ``JAXURBAN_DATA`` (default ``../shared/data``), makes
the maps, runs the study in a process of its own that is killed (SIGKILL) after a third and after two thirds of the rows
and run again, and compares breakpoints with searches alone: Dijkstra's, without a heuristic, at many weights along the
range of each weight, then bisection of the first interval in which the route stops being the cheapest. Prints JSON.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.io.tables import records_of
from jaxurban.maps.metric_maps import open_maps
from jaxurban.planners.astar import astar
from jaxurban.report.run_sensitivity import sensitivity_study
from jaxurban.scenario.run import run_scenario
from jaxurban.scenario.settings import Scenario
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.sensitivity.remade import RemadeSettings
from jaxurban.studies.sensitivity.routes import SensitivityStudySettings, query_of

DATA = Path(os.environ.get("JAXURBAN_DATA", "../shared/data")).resolve()
ALTITUDES_M = (20.0, 60.0)
BOUNDS = {
    "manhattan": (-74.02, 40.70, -73.98, 40.73),
    "tokyo": (139.69, 35.665, 139.73, 35.695),
    "synthetic": (-73.99, 40.75, -73.95, 40.78),
}
SOURCES: dict[str, dict[str, Any]] = {
    "manhattan": {
        "buildings": {"source": f"{DATA}/osm/lower-manhattan.osm.pbf"},
        "gps": {"orbits": f"{DATA}/gps/gps-ops_2020-04-27.tle", "times": ["2020-04-27T16:00:00Z"]},
        "population": {
            "blocks": f"{DATA}/census/tl_2010_36061_tabblock10.shp",
            "table": f"{DATA}/census/DECENNIALSF12010.P1_nyc_blocks.csv",
            "districts": f"{DATA}/districts/nyc_community_districts.geojson",
        },
    },
    "tokyo": {
        "buildings": {"source": f"{DATA}/tokyo/tokyo-central-lod2.parquet"},
        "gps": {"orbits": f"{DATA}/tokyo/gps_2018-12-19.tle", "times": ["2018-12-19T06:20:00Z"]},
    },
    "synthetic": {"buildings": {"source": "synthetic"}},
}
KILLED_AT = (1 / 3, 2 / 3)  # of the rows of routes
NUM_WEIGHTS = 40  # searched at along each side of a weight's range
SAME = 1e-14  # relative: a route that is dearer than Dijkstra's by less is as cheap


def make_maps(out: Path, resolution_m: float) -> None:
    """Make the maps of the three cities."""
    for city, sources in SOURCES.items():
        region = {"bounds": BOUNDS[city], "resolution_m": resolution_m, "altitudes_m": ALTITUDES_M}
        scenario = Scenario.from_dict({"region": region, "planning": {"cost_model": "line"}, **sources})
        run_scenario(scenario, out / "maps" / city)


def study(out: Path, num_routes: int, num_heights: int, workers: int) -> Any:
    """Return the study; what is there is not made again."""
    return sensitivity_study(
        {city: out / "maps" / city for city in BOUNDS},
        out / "study",
        num_routes,
        altitudes_m=ALTITUDES_M,
        settings=SensitivityStudySettings(),
        remade=RemadeSettings(num_heights, has_parameters=True),
        workers=workers,
    )


def killed_runs(out: Path, num_rows: int, command: list[str]) -> list[dict[str, Any]]:
    """Run the study in processes of its own, killed twice and then to its end; return what each left."""
    runs: list[dict[str, Any]] = []
    for share in (*KILLED_AT, None):
        begin_s = time.perf_counter()
        job = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
        while job.poll() is None:
            if share is not None and _num_kept(out) >= share * num_rows:
                os.killpg(job.pid, signal.SIGKILL)  # its workers too
                break
            time.sleep(0.2)
        status = job.wait()
        kept = _num_kept(out)
        runs.append({"seconds": time.perf_counter() - begin_s, "status": status, "rows_kept": kept})
        print(f"killed_runs: {runs[-1]}", file=sys.stderr)
    return runs


def _num_kept(out: Path) -> int:
    parts = len(list((out / "study/routes/parts").glob("*.json")))
    file = out / "study/routes/rows.parquet"
    return parts if parts or not file.exists() else len(pd.read_parquet(file, columns=["instance"]))


def brute_breakpoints(
    query: RouteQuery, weights: np.ndarray, column: int, factors: tuple[float, float]
) -> Iterator[float]:
    """Yield the factors below and above 1 at which the cheapest route stops being so, by searches alone."""
    given = query.sums(astar(query.problem(weights), heuristic="none").points_m)[0]

    def is_cheapest(factor: float) -> bool:
        changed = weights.copy()
        changed[column] *= factor
        best = query.sums(astar(query.problem(changed), heuristic="none").points_m)[0]
        return bool(changed @ (given - best) <= SAME * (changed @ given))

    for end in factors:
        along = np.geomspace(1.0, end, NUM_WEIGHTS + 1)[1:]
        inside = 1.0
        for factor in along:
            if not is_cheapest(factor):
                break
            inside = factor
        else:
            yield np.nan
            continue
        outside = float(factor)
        while abs(outside - inside) > 1e-12 * outside:
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if is_cheapest(middle) else (inside, middle)
        yield (inside + outside) / 2


def check_breakpoints(out: Path, num: int, factors: tuple[float, float]) -> dict[str, Any]:
    """Return how far the breakpoints of ``num`` routes, spread over the study, lie from those by searches alone."""
    settings = SensitivityStudySettings()
    rows, instances = (pd.read_parquet(out / "study" / name) for name in ("routes/rows.parquet", "instances.parquet"))
    table = rows.merge(instances, on=["city", "instance", "altitude_m"])
    chosen = table.iloc[np.linspace(0, len(table) - 1, num).astype(int)]
    begin_s, off, num_none, wrong = time.perf_counter(), [], 0, []
    for row in records_of(chosen):
        on = settings.cost_map(
            open_maps(out / "maps" / row["city"]), row["altitude_m"], row["time"], row["time_of_day"]
        )
        query, weights = query_of(on, row)
        for name in row["vary"].split(","):
            brute = brute_breakpoints(query, weights, query.names.index(name), factors)
            for side, expected in zip(("below", "above"), brute, strict=True):
                found = np.nan if row[f"{side}:{name}"] is None else row[f"{side}:{name}"]
                if np.isnan(found) and np.isnan(expected):
                    num_none += 1
                elif not abs(found - expected) <= 1e-9 * expected:
                    where = {key: row[key] for key in ("city", "instance", "altitude_m")}
                    wrong.append(where | {"weight": name, "side": side, "found": found, "brute": expected})
                else:
                    off.append(abs(found / expected - 1))
        print(f"check_breakpoints: {row['city']} {row['instance']} {row['altitude_m']:g} m", file=sys.stderr)
    return {
        "routes": len(chosen),
        "breakpoints": len(off) + len(wrong),
        "none_within_the_range_either_way": num_none,
        "largest_relative_difference": float(max(off, default=0.0)),
        "above_1e-9": wrong,
        "seconds": time.perf_counter() - begin_s,
    }


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--resolution", type=float, default=20.0)
    parser.add_argument("--routes", type=int, default=30, help="in each city, at both altitudes")
    parser.add_argument("--heights", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--checked", type=int, default=20, help="routes compared with searches alone")
    parser.add_argument("--only-study", action="store_true", help="what the killed processes run")
    options = parser.parse_args()
    out = options.out.resolve()
    if options.only_study:
        study(out, options.routes, options.heights, options.workers)
        return
    begin_s = time.perf_counter()
    make_maps(out, options.resolution)
    maps_s = time.perf_counter() - begin_s
    passed = ["--routes", options.routes, "--heights", options.heights, "--workers", options.workers, "--only-study"]
    command = [sys.executable, "-m", "benchmarks.weight_study", str(out), *map(str, passed)]
    runs = killed_runs(out, len(BOUNDS) * len(ALTITUDES_M) * options.routes, command)
    report = {"maps_seconds": maps_s, "runs": runs, "all_seconds": time.perf_counter() - begin_s}
    report["breakpoints"] = check_breakpoints(out, options.checked, SensitivityStudySettings().factors)
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
