"""jaxurban demo: maps of Lower Manhattan, paths over them and pictures, for a reader new to them."""

import warnings
from pathlib import Path

from jaxurban.progress import LOG, reporting
from jaxurban.settings import PlannerName
from jaxurban.terminal.common import DEVICE, JSON_FLAG, OVERWRITE, PATH, SHOWN, print_json
from jaxurban.terminal.options import command

CITY = "sample:lower-manhattan"
RESOLUTION_M = 5.0
START = (-74.0172, 40.7130)  # of the paths, degrees: Battery Park City
GOAL = (-73.9815, 40.7265)  # East Village
PLANNERS: tuple[PlannerName, ...] = ("ptp", "astar", "bitstar-dist", "bitstar-plus")
BUDGET_S = 2.0  # what the sampling planners use up; the others need less
SNAP_M = 500.0  # the ends may lie in a building
DAY_UP_TO_M = 60.0  # night above, as in the paper's figures
SCENARIO_FILE, PATHS_FOLDER, TABLE_FILE = "scenario.toml", "paths", "paths/paths.csv"
COLUMNS = "altitude_m", "settings.time_of_day", "planner", "status", "cost", "length_m", "elapsed_s"


@command()
@SHOWN("-o", "folder", type=PATH, default=Path("out/demo"))
@OVERWRITE
@DEVICE
@JSON_FLAG
def demo_command(folder: Path, overwrite: bool, as_json: bool) -> None:
    """Make maps, paths and pictures of Lower Manhattan.

    Every planner plans paths across it. No file is needed.
    """
    import pandas as pd

    from jaxurban.draw.write import save
    from jaxurban.io.stored import RUN_FILE
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.run import run_scenario
    from jaxurban.maps.scenario import Scenario
    from jaxurban.paths.plan import plan
    from jaxurban.plot import save_figures

    # The folder is checked before maps and paths are made.
    scenario = Scenario.from_dict(
        {"region": {"resolution_m": RESOLUTION_M}, "buildings": {"source": CITY}}
    )
    Workspace.check(folder, "demo", (SCENARIO_FILE, TABLE_FILE), is_shared=True)
    with reporting("demo") as report:
        # The maps, and a path by every method at every altitude.
        run = run_scenario(scenario, folder, progress=report, overwrite=overwrite)
        maps = run.maps[RESOLUTION_M]
        report("paths")
        paths = [
            plan(
                maps,
                start=START,
                goal=GOAL,
                altitude_m=altitude_m,
                planner=planner,
                time_of_day="day" if altitude_m <= DAY_UP_TO_M else "night",
                snap=SNAP_M,
                budget_s=BUDGET_S,
            )
            for altitude_m in maps.altitudes_m
            for planner in PLANNERS
        ]

        # A table of the paths, a file for each, and pictures.
        facts = [path.to_dict() for path in paths]
        table = pd.json_normalize(facts)
        table = table[[*COLUMNS, *table.filter(like="metrics.")]]
        with Workspace.open(folder, "demo", is_shared=True), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Unknown heights")  # they are counted below
            save(folder, {SCENARIO_FILE: scenario.to_toml(), TABLE_FILE: table})
            for path in paths:
                if path.status.has_path:
                    name = f"{path.search.planner}_{path.altitude_m:g}m.geojson"
                    path.save(folder / PATHS_FOLDER / name)
            report("figures")
            figures = save_figures(maps, paths, folder / "figures")
    num_found = sum(path.status.has_path for path in paths)
    overview, table_file = folder / "figures" / "overview.png", folder / TABLE_FILE
    kinds = [{caution.kind for caution in path.cautions} for path in paths]
    num_reached = sum("unknown heights" in each for each in kinds)
    LOG.info(
        f"What has no known height may reach {num_reached} of the paths: `jaxurban plan {folder} ... --rules "
        f"unknown_heights=highest` stays above it. {folder / RUN_FILE} holds all warnings of the maps."
    )
    LOG.info(f"Look at {overview}: it shows the maps and the paths over them.")
    LOG.info(f"{num_found} of {len(paths)} searches found a path; {table_file} compares them.")
    LOG.info(f"To plan by hand in a browser, run: jaxurban view {folder}")
    if as_json:
        record = {"folder": str(folder), "record": str(folder / RUN_FILE)}
        print_json(record | {"figures": [str(figure) for figure in figures], "paths": facts})
