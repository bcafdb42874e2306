"""The demo: maps of the synthetic city, paths over them, pictures, and a summary."""

from pathlib import Path
from typing import Any

from jaxurban.io.store import RUN_FILE
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.export.write import write_path
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import plan
from jaxurban.progress import Report
from jaxurban.report.figures import save_figures
from jaxurban.report.maps import summary_markdown
from jaxurban.report.write import save
from jaxurban.scenario.run import run_scenario
from jaxurban.scenario.settings import PAPER_PLANNERS, Scenario

BOUNDS = (-74.0, 40.755, -73.955, 40.80)  # about 3.8 x 5 km: the synthetic city scales itself to the box
RESOLUTION_M = 5.0
SCENARIO_FILE, SUMMARY_FILE = "scenario.toml", "summary.md"
BUDGET_S = 2.0  # what the sampling planners use up; the others need less


def run_demo(folder: Path, report: Report, overwrite: bool = False, degrees: bool = False) -> dict[str, Any]:
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
        figures = save_figures(maps, paths, folder / "figures", degrees=degrees)
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
