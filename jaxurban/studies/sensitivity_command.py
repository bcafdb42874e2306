"""jaxurban sensitivity, of one route or of many, in one or several cities."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from jaxurban.progress import LOG
from jaxurban.studies.weights.settings import SensitivitySettings
from jaxurban.terminal.common import (
    JSON_FLAG,
    MAPS_PATH,
    OVERWRITE,
    PATH,
    PLACE,
    POSITIVE_COUNT,
    PROCESSES,
    RESOLUTION,
    RULES,
    SHOWN,
    SNAP,
    WEIGHTS,
    Point,
    Settings,
    all_cores,
    finished_said,
    finite_records,
    log_lines,
    number_or_file,
    outcome_of,
    print_json,
)
from jaxurban.terminal.options import Names, Numbers, Values, command

NO_ROUTE = "no route was found, so that nothing can be said: the report says why"
DRAWN_ROUTES = 30  # in each folder of maps
OF_STUDY = (
    "num_heights",
    "wrong",
    "seed",
    "height_seed",
)


@command()
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=MAPS_PATH, is_eager=True)
@PLACE("--start", required=False, help="Start of one route: longitude,latitude in degrees.")
@PLACE("--goal", required=False, help="Goal of one route: longitude,latitude in degrees.")
@click.option(
    "--routes",
    metavar="NUMBER|FILE",
    callback=partial(number_or_file, POSITIVE_COUNT),
    help="Instead of one route: how many to draw in each DIR, or a table of routes (.csv, .parquet).  [default: 30]",
)
@click.option(
    "--altitude",
    "altitudes_m",
    type=Numbers("M,...", "numbers, as in 20,60"),
    help="Altitudes in metres above ground, but of a table's routes.  [default: all of the maps']",
)
@SNAP
@click.option(
    "--vary",
    type=Names(),
    default=(),
    metavar="NAME,...",
    help="Weights that vary.  [default: every metric with a weight]",
)
@SHOWN(
    "--range",
    "factors",
    type=Numbers("LOW,HIGH", "two factors, as in 0.1,10", 2),
    default="0.1,10",
    help="Range of each weight, as factors of its value.",
)
@click.option(
    "--study",
    type=Values(SensitivitySettings, OF_STUDY),
    default="",
    help="What is asked of every route.",
)
@RESOLUTION
@WEIGHTS
@RULES
@PROCESSES
@OVERWRITE
@JSON_FLAG
@SHOWN("-o", "output", type=PATH, default=Path("out/sensitivity"))
def sensitivity_command(
    folders: tuple[Path, ...],
    start: Point | None,
    goal: Point | None,
    routes: int | Path | None,
    altitudes_m: tuple[float, ...] | None,
    snap: bool | float,
    vary: tuple[str, ...],
    factors: tuple[float, float],
    study: Settings,
    resolution_m: float | None,
    weights: dict[str, float],
    rules: Settings,
    workers: int | None,
    overwrite: bool,
    as_json: bool,
    output: Path,
) -> int:
    """Find the weights at which a route changes, or many do.

    The routes are planned over the maps in each DIR: one from --start to --goal, or those of --routes.
    """
    if (start is None) != (goal is None):
        lacking = "--start" if start is None else "--goal"
        raise click.UsageError(f"one route has a --start and a --goal: name the {lacking}, too")
    if start and routes:
        raise click.UsageError("--start and --goal are of one route, --routes of several: name one")
    settings = SensitivitySettings(vary=vary, factors=factors, **study)

    from jaxurban.io.tables import read_table
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.studies.reports.run_sensitivity import sensitivity

    asked: Any = routes or DRAWN_ROUTES
    if start is not None:
        asked = [(start, goal)]
        workers = 1
    elif isinstance(routes, Path):
        asked = read_table(routes, "routes")
    result = sensitivity(
        [MapsFolder(folder, resolution_m) for folder in folders],
        output,
        asked,
        altitudes_m=altitudes_m,
        weights=weights,
        snap=snap,
        settings=settings,
        workers=workers or all_cores(),
        overwrite=overwrite,
        **rules,
    )

    # What is printed: the first lines, where the report is, and with --json the tables.
    statuses, code, message = outcome_of(result.rows, NO_ROUTE)
    if start is not None and result.rows.note[0]:
        LOG.info(result.rows.note[0])
    log_lines(result.decided.facts)
    LOG.info(finished_said("sensitivity", output))
    if as_json:
        facts = {
            "folder": str(output),
            "decided": result.decided.to_dict(),
            "statuses": statuses,
            "tables": finite_records(result.tables),
        }
        print_json(facts, code, message)
    return code
