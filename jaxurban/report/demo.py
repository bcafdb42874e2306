"""The demo: maps of the synthetic city, paths over them, pictures, and summary.md, for a reader new to them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.io.store import RUN_FILE
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import PAPER_PLANNERS, Scenario
from jaxurban.metrics.gps import Rating, rating
from jaxurban.metrics.variables import names_in
from jaxurban.paths.export.write import write_path
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import plan
from jaxurban.progress import Report
from jaxurban.report.figures import save_figures
from jaxurban.report.figures.files import maps_figures
from jaxurban.report.figures.notes import caveats_said, rules_said
from jaxurban.report.write import bullets, fill, listed, save, table

BOUNDS = (-74.0, 40.755, -73.955, 40.80)  # about 3.8 x 5 km: the synthetic city scales itself to the box
RESOLUTION_M = 5.0
SCENARIO_FILE, SUMMARY_FILE = "scenario.toml", "summary.md"
Paths = Mapping[float, Sequence[PlannedPath]]
BUDGET_S = 2.0  # what the sampling planners use up; the others need less


def run_demo(folder: Path, report: Report, overwrite: bool = False) -> dict[str, Any]:
    """Write the demo under ``folder`` and return what it made.

    Raises:
      InputError: the folder cannot be written to, or holds maps of other settings.
    """
    scenario = Scenario.from_dict(
        {
            "region": {"bounds": BOUNDS, "resolution_m": RESOLUTION_M},
            "buildings": {"source": "synthetic"},
        }
    )
    Workspace.check(folder, "demo", (SCENARIO_FILE, SUMMARY_FILE), is_shared=True)
    run = run_scenario(scenario, folder, progress=report, overwrite=overwrite)
    maps = run.maps[RESOLUTION_M]
    report("paths")
    paths = demo_paths(maps)
    with Workspace.open(folder, "demo", is_shared=True):
        save(folder, {SCENARIO_FILE: scenario.to_toml()})
        (folder / "paths").mkdir(exist_ok=True)
        for altitude_m, planned in paths.items():
            for path in planned:
                write_path(path, folder / "paths" / f"{path.search.planner}_{altitude_m:g}m.geojson")
        report("figures")
        figures = save_figures(maps, paths, folder / "figures")
        save(folder, {SUMMARY_FILE: summary_markdown(maps, paths, run.record)})
    return {
        "folder": str(folder),
        "record": str(folder / RUN_FILE),
        "figures": [str(figure) for figure in figures],
        "paths": [path.to_dict() for planned in paths.values() for path in planned],
    }


def demo_paths(maps: MetricMaps) -> dict[float, list[PlannedPath]]:
    """Return paths of every planner across the city, southwest to northeast, by altitude.

    Day at the two lower altitudes, night above, as in the paper's figures.
    """
    grid = maps.grid
    start = (grid.x_min_m + 0.30 * (grid.x_max_m - grid.x_min_m), grid.y_min_m + 0.12 * (grid.y_max_m - grid.y_min_m))
    goal = (grid.x_min_m + 0.62 * (grid.x_max_m - grid.x_min_m), grid.y_min_m + 0.80 * (grid.y_max_m - grid.y_min_m))
    return {
        altitude_m: [
            plan(
                maps,
                start_xy_m=start,
                goal_xy_m=goal,
                altitude_m=altitude_m,
                planner=planner,
                time_of_day="day" if altitude_m <= 60 else "night",
                snap=True,
                budget_s=BUDGET_S,
            )
            for planner in PAPER_PLANNERS
        ]
        for altitude_m in maps.altitudes_m
    }


def summary_markdown(maps: MetricMaps, paths: Paths, run: Mapping[str, Any] | None = None) -> str:
    """Return the summary of one region's maps and paths as Markdown; every number is taken from them.

    Pictures are named as `jaxurban.report.figures.save_figures` names them, in a folder ``figures`` beside the
    summary. Means and shares by altitude are over free cells, at the first time.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude; may be empty.
      run: what run.json holds; what it lacks is left out.
    """
    grid, run = maps.grid, run or {}
    planned = [path for z in maps.altitudes_m for path in paths.get(z, ())]
    roof_m = maps.m("roof")[maps.ds["has_data"].values]
    tables = {
        "by_altitude": pd.DataFrame([_facts(maps, z) for z in maps.altitudes_m]),
        "population": pd.DataFrame([_people(maps, run, item) for item in maps.times_of_day]),
        "paths": pd.DataFrame([_outcome(maps, path, planned) for path in planned]),
    }
    return fill(
        "summary",
        tables,
        credits=[maps.attribution],
        what="Metric maps and paths" if planned else "Metric maps",
        width_km=(grid.x_max_m - grid.x_min_m) / 1000,
        height_km=(grid.y_max_m - grid.y_min_m) / 1000,
        southwest=grid.lonlat_of_xy(grid.x_min_m, grid.y_min_m),
        northeast=grid.lonlat_of_xy(grid.x_max_m, grid.y_max_m),
        grid=grid,
        altitudes=listed(f"{z:g}" for z in maps.altitudes_m),
        roofed=float((roof_m > 0).mean()),
        highest_m=roof_m.max(),
        num_satellites=len(names_in(maps.ds.attrs, "satellites")),
        num_times=len(maps.times),
        first_time=maps.times[0],
        record=_record(run),
        rules=rules_said(*(path.settings for path in planned)),
        pictures=bullets(f"[{name}](figures/{name}.png)" for name in maps_figures(maps, paths)),
        caveats="".join(f"\n- {line}" for line in caveats_said(maps)),
    )


def _record(run: Mapping[str, Any]) -> str:
    """Return what the record of a run says beyond its maps."""
    buildings, shares = run.get("buildings") or {}, run.get("rays_leave_data_share") or {}
    facts = [("buildings in the region", buildings["in_region"])] if buildings else []
    facts += [(f"heights from: {name}", num) for name, num in (buildings.get("height_origin_counts") or {}).items()]
    facts += [(f"source of {role}", f"`{source['path']}`") for role, source in (run.get("inputs") or {}).items()]
    facts += [(f"seconds: {step}", elapsed_s) for step, elapsed_s in (run.get("elapsed_s") or {}).items()]
    facts += [(f"cells at {z} m with a ray that leaves the data", f"{share:.1%}") for z, share in shares.items()]
    facts += [("warned", message) for message in run.get("warnings") or ()]
    return table(("of the run", ""), facts) if facts else ""


def _facts(maps: MetricMaps, altitude_m: float) -> dict[str, float]:
    """Return the means over free cells at an altitude, NaN without a free cell."""
    is_free = maps.is_free(altitude_m, "centre")
    gps, lidar = maps.m("gps", altitude_m), maps.m("lidar", altitude_m)
    shown = {"mean m_gps": gps, "mean m_lidar": lidar, "mean m_risk": maps.m("risk", altitude_m)}
    shown["GPS better"] = maps.prefers_gps(altitude_m)
    if "gdop" in maps.ds:  # a long series keeps no DOPs
        gdop = maps.m("gdop", altitude_m)
        shown |= {"good GPS": rating(gdop) <= Rating.GOOD, "too few satellites": ~np.isfinite(gdop)}
    facts = {"altitude (m)": altitude_m, "obstacle cells": 1 - float(is_free[maps.ds["has_data"].values].mean())}
    for name, values in shown.items():
        facts[name] = float(values[is_free].mean(dtype=np.float64)) if is_free.any() else np.nan
    varies = is_free.any() and all(np.ptp(values[is_free]) > 0 for values in (gps, lidar))
    correlation = float(np.corrcoef(gps[is_free], lidar[is_free])[0, 1]) if varies else np.nan
    return facts | {"correlation of m_gps and m_lidar": correlation}


def _people(maps: MetricMaps, run: Mapping[str, Any], item: str) -> dict[str, Any]:
    """Return how many people the maps hold at a time of day, and what the record of a run says of them."""
    density = maps.m("density", time_of_day=item)
    num_people = np.nansum(density, dtype=np.float64) * maps.grid.resolution_m**2 / 1e6
    row = {"time of day": item, "people in the maps": f"{num_people:,.0f}"}
    row |= {"densest cell (per km²)": f"{np.nanmax(density):,.0f}"}
    return row | dict((run.get("population") or {}).get(item) or {})


def _outcome(maps: MetricMaps, path: PlannedPath, planned: Sequence[PlannedPath]) -> dict[str, Any]:
    """Return a path's row, beside the cheapest of its altitude."""
    best = min(other.cost for other in planned if other.altitude_m == path.altitude_m)
    row = {"altitude (m)": path.altitude_m, "time of day": path.settings["time_of_day"] or "-"}
    row |= {"planner": path.search.planner, "graph": path.search.graph or "-", "status": path.status.value}
    row["search (s)"] = path.search.elapsed_s
    if path.status.has_path:
        row |= {"cost": path.cost, "above the cheapest": path.cost / best - 1 if best > 0 else np.nan}
        row |= {"length (m)": path.length_m, **{f"mean m_{name}": path.metrics[name] for name in maps.metrics}}
    return row
