"""jaxurban sensitivity, of one route, and jaxurban sensitivity-study, of many routes in one or several cities."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    COUNT,
    DEVICE,
    FLAG,
    GIVEN,
    JSON_FLAG,
    MAPS,
    MAPS_PATH,
    NAMES,
    OVERWRITE,
    PATH,
    POSITIVE_COUNT,
    ROUTE,
    RULES,
    SEED,
    SHOWN,
    WEIGHTS,
    WORKERS,
    MapsOf,
    Point,
    Settings,
    all_cores,
    outcome_of,
    print_json,
    run_study,
)
from jaxurban.cli.options import DependentOption, Numbers, command, options_together
from jaxurban.progress import LOG

NO_ROUTE = "no route was found, so that nothing can be said: the report says why"
WEIGHT_RANGES = options_together(
    NAMES(
        "--vary",
        metavar="NAME,...",
        help="Weights that vary.  [default: every metric with a weight]",
    ),
    SHOWN(
        "--range",
        "factors",
        type=Numbers("LOW,HIGH", "two factors, as in 0.1,10", 2),
        default="0.1,10",
        help="Range of each weight, as factors of its value.",
    ),
    SEED,
    OVERWRITE,
    DEVICE,
    JSON_FLAG,
)
DRAWN_ROUTES = 30  # in each folder of maps


@command()
@ROUTE
@SHOWN("--samples", "num_samples", default=128, help="Sobol samples; a power of two.")
@NAMES(
    "--pareto",
    "objectives",
    metavar="A,B[,C]",
    help="Objectives of the Pareto front.  [default: distance, the two costliest]",
)
@SHOWN(
    "--tolerance",
    default=1e-3,
    help="Relative tolerance of the Pareto front; 1e-9 gives every route.",
)
@FLAG("--buildings", help="Also rank buildings by what they cost the route.")
@click.option(
    "--scenario",
    cls=DependentOption,
    owner="--buildings",
    type=GIVEN,
    help="Scenario of the maps, for --buildings, if its paths are relative.",
)
@WEIGHT_RANGES
@SHOWN("-o", "output", type=PATH, default=Path("out/sensitivity"))
def sensitivity_command(
    folder: Path,
    start: Point,
    goal: Point,
    altitude_m: float,
    time: str | None,
    time_of_day: str | None,
    maps_of: MapsOf,
    weights: dict[str, float],
    rules: Settings,
    snap: bool | float,
    buildings: bool,
    scenario: Path | None,
    output: Path,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Find the weights at which a route changes.

    The route is planned over the maps in DIR.
    """
    from jaxurban.io.tables import records_of
    from jaxurban.io.workspace import Workspace
    from jaxurban.paths.plan import cost_map
    from jaxurban.report.buildings import write_buildings
    from jaxurban.report.sensitivity import ranges, sensitivity_markdown, sensitivity_outputs
    from jaxurban.report.write import REPORT_FILE, save
    from jaxurban.studies.weights.study import SensitivitySettings, sensitivity

    settings = SensitivitySettings(**options)  # all other options are its fields

    # The maps and the route; without a route there is nothing to study.
    maps = maps_of(folder, rules.pop("obstacles")).open()
    costs = cost_map(
        maps,
        altitude_m,
        objective="weighted",
        time=time,
        time_of_day=time_of_day,
        weights=weights,
        **rules,
    )
    costs.maps.check_altitude(altitude_m)  # whose map its figures show
    first = costs.plan(start, goal, snap=snap)
    if not first.status.has_path:
        LOG.info(first.to_dict()["message"])
        if as_json:
            print_json(first.to_dict(), first.status.exit_code)
        return first.status.exit_code
    if first.search.note:
        LOG.info(first.search.note)

    result = run_study(
        "sensitivity",
        output,
        partial(sensitivity, costs, start, goal, snap=snap, settings=settings),
        overwrite,
    )

    # The ranking of buildings, and the report again, which then holds it. The folder is opened with the settings of
    # this study, as another run may have come in between.
    if buildings:
        _, settings_of_route = sensitivity_outputs(result)
        with Workspace.open(output, "sensitivity", settings_of_route):
            ranking = write_buildings(folder, first, output / "buildings", scenario=scenario)
            save(output, {REPORT_FILE: sensitivity_markdown(result, ranking)})
    if as_json:
        tables = result.tables().items()
        facts = {
            "route": result.route.to_dict(),
            "ranges": {name: ranges(result, name) for name in result.lines},
            "tables": {name: records_of(table.reset_index()) for name, table in tables},
            "num_plans": result.num_plans,
            "elapsed_s": result.elapsed_s,
        }
        print_json(facts)
    return 0


@command()
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=MAPS_PATH)
@click.option(
    "--routes",
    "num_routes",
    type=POSITIVE_COUNT,
    help="Number of routes drawn in each DIR.  [default: 30]",
)
@click.option(
    "--altitudes",
    "altitudes_m",
    type=Numbers("M,...", "numbers, as in 20,60"),
    help="Altitudes of --routes.  [default: all of the maps']",
)
@click.option(
    "--queries", type=GIVEN, help="Table of routes to study instead of drawn ones (.csv, .parquet)."
)
@MAPS
@WEIGHTS
@RULES
@SHOWN("--wrong", default=2.0, help="Factor by which a wrong weight is off, for its regret.")
@SHOWN("--samples", "num_samples", default=32, help="Sobol samples of each route; a power of two.")
@click.option(
    "--heights",
    "num_heights",
    type=COUNT,
    default=0,
    help="Number of draws of building heights to plan again on.",
)
@FLAG(
    "--parameters",
    "has_parameters",
    help="Also plan on maps with each threshold, range and gamma of the metrics halved and doubled.",
)
@click.option(
    "--scenario",
    type=GIVEN,
    help="Scenario of the maps, for --heights and --parameters, if its paths are relative; only with one DIR.",
)
@WORKERS
@WEIGHT_RANGES
@SHOWN("-o", "output", type=PATH, default=Path("out/sensitivity-study"))
def sensitivity_study_command(
    folders: tuple[Path, ...],
    num_routes: int | None,
    altitudes_m: tuple[float, ...] | None,
    queries: Path | None,
    maps_of: MapsOf,
    weights: dict[str, float],
    rules: Settings,
    scenario: Path | None,
    workers: int | str | None,
    output: Path,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Find the weights at which many routes change.

    The routes are planned over the maps in each DIR.
    """
    if queries is not None and (num_routes is not None or altitudes_m):
        raise click.UsageError(
            "--queries names the routes: leave out --routes and --altitudes, or --queries"
        )

    from jaxurban.io.tables import read_table, records_of
    from jaxurban.maps.sources import scenario_of
    from jaxurban.report.run_sensitivity import sensitivity_study
    from jaxurban.studies.weights.routes import SensitivityStudySettings

    # The scenario of the one folder, which goes by the name of its city.
    scenarios = None
    if scenario is not None:
        if len(folders) > 1 or not (options["num_heights"] or options["has_parameters"]):
            raise click.UsageError("--scenario belongs to --heights or --parameters of one DIR")
        scenarios = {folders[0].resolve().name: scenario_of(folders[0], scenario.parent)}

    # All further options and rules are fields of the settings, but for the obstacles, which belong to the maps.
    obstacles = rules.pop("obstacles")
    settings = SensitivityStudySettings(**options, **rules)
    routes = num_routes or DRAWN_ROUTES
    result = sensitivity_study(
        [maps_of(folder, obstacles) for folder in folders],
        output,
        routes if queries is None else read_table(queries, "queries"),
        altitudes_m=altitudes_m,
        weights=weights,
        settings=settings,
        scenarios=scenarios,
        workers=workers or all_cores(),
        overwrite=overwrite,
    )

    # What is printed: warnings, where the report is, and with --json the summaries.
    statuses, code, message = outcome_of(result.rows, NO_ROUTE)
    if "sobol_summary" in result.tables:
        needed = result.tables["sobol_summary"].samples_needed.max()
        if needed > 0:
            remedy = f"about {needed:.0f} samples (--samples {needed:.0f}) should resolve them"
            LOG.warning(f"warning: some Sobol shares are not resolved: {remedy}")
    LOG.info(
        f"study of sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}"
    )
    if as_json:
        names = [name for name in result.tables if name.endswith("summary")]
        summaries = {name: records_of(result.tables[name]) for name in names}
        facts = {"folder": str(output), "statuses": statuses, "tables": summaries}
        print_json(facts, code, message)
    return code
