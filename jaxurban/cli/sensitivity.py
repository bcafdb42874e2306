"""jaxurban sensitivity, of one route, and jaxurban sensitivity-study, of many routes in one or several cities."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    DEVICE,
    JSON_FLAG,
    PATH,
    ROUTE,
    RULES,
    WORKERS,
    Numbers,
    all_cores,
    given_rules,
    given_workers,
    names_in,
    print_json,
    run_study,
    together,
)
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG

NO_ROUTE = "no route was found, so that nothing can be said: the report says why"
WEIGHTS = together(  # what both commands ask of weights
    click.option(
        "--vary",
        default="",
        metavar="NAME,...",
        help="Weights that vary.  [default: every metric with a weight]",
    ),
    click.option(
        "--range",
        "factors",
        type=Numbers("LOW,HIGH", "two factors, as in 0.1,10", 2),
        default="0.1,10",
        show_default=True,
        help="Range of each weight, as factors of its value.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of random numbers.",
    ),
    click.option(
        "--overwrite",
        is_flag=True,
        help="Replace another run of this command in the output folder.",
    ),
    DEVICE,
    JSON_FLAG,
)
SCENARIO_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command()
@ROUTE
@click.option(
    "--samples",
    "num_samples",
    type=int,
    default=128,
    show_default=True,
    help="Sobol samples; a power of two.",
)
@click.option(
    "--pareto",
    default="",
    metavar="A,B[,C]",
    help="Objectives of the Pareto front.  [default: distance, the two costliest]",
)
@click.option(
    "--tolerance",
    type=float,
    default=1e-3,
    show_default=True,
    help="Relative tolerance of the Pareto front; 1e-9 gives every route.",
)
@click.option("--buildings", is_flag=True, help="Also rank buildings by what they cost the route.")
@click.option(
    "--scenario",
    type=SCENARIO_FILE,
    help="Scenario of the maps, for --buildings, if its paths are relative.",
)
@WEIGHTS
@click.option("-o", "output", type=PATH, default=Path("out/sensitivity"), show_default=True)
def sensitivity(folder: Path, output: Path, as_json: bool, overwrite: bool, **options: Any) -> int:
    """Find the weights at which a route over the maps in DIR changes."""
    from jaxurban.io.tables import records_of
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.saving import open_maps
    from jaxurban.paths.plan import cost_map
    from jaxurban.report.buildings import write_buildings
    from jaxurban.report.sensitivity import (
        ranges,
        sensitivity_markdown,
        sensitivity_outputs,
    )
    from jaxurban.report.sensitivity import sensitivity as study
    from jaxurban.report.write import REPORT_FILE, save
    from jaxurban.studies.weights.study import SensitivitySettings

    if options["scenario"] is not None and not options["buildings"]:
        raise click.UsageError("--scenario belongs to --buildings: add that")
    settings = SensitivitySettings(
        vary=names_in(options["vary"]),
        objectives=names_in(options["pareto"]),
        **{name: options[name] for name in ("factors", "num_samples", "tolerance", "seed")},
    )
    maps = open_maps(folder, options["resolution_m"], obstacles=options["obstacles"])
    at = {name: options[name] for name in ("time", "time_of_day")}
    shared = cost_map(
        maps, options["altitude_m"], objective="weighted", **at, **given_rules(options)
    )
    shared.maps.check_altitude(options["altitude_m"])  # whose map its figures show
    ends = {name: options[name] for name in ("start", "goal", "snap")}
    first = shared.plan(**ends)
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
        lambda report: study(shared, **ends, settings=settings, progress=report),
        overwrite,
    )
    if options["buildings"]:
        _, of_this_route = sensitivity_outputs(result)
        with Workspace.open(
            output, "sensitivity", of_this_route
        ):  # another run may have come in between
            buildings = write_buildings(
                folder, first, output / "buildings", scenario=options["scenario"]
            )
            save(output, {REPORT_FILE: sensitivity_markdown(result, buildings)})
    if as_json:
        tables = {name: records_of(table.reset_index()) for name, table in result.tables().items()}
        facts = {
            "route": result.route.to_dict(),
            "ranges": {name: ranges(result, name) for name in result.lines},
        }
        print_json(
            facts | {"tables": tables, "num_plans": result.num_plans, "elapsed_s": result.elapsed_s}
        )
    return 0


@click.command("sensitivity-study")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=PATH)
@click.option(
    "--routes",
    "num_routes",
    type=click.IntRange(min=1),
    help="Number of routes drawn in each DIR.  [default: 30]",
)
@click.option(
    "--altitudes",
    "altitudes_m",
    type=Numbers("M,...", "numbers, as in 20,60"),
    help="Altitudes of --routes.  [default: all of the maps']",
)
@click.option(
    "--queries", type=PATH, help="Table of routes to study instead of drawn ones (.csv, .parquet)."
)
@RULES
@click.option(
    "--wrong",
    type=float,
    default=2.0,
    show_default=True,
    help="Factor by which a wrong weight is off, for its regret.",
)
@click.option(
    "--samples",
    "num_samples",
    type=int,
    default=32,
    show_default=True,
    help="Sobol samples of each route; a power of two.",
)
@click.option(
    "--heights",
    type=click.IntRange(min=0),
    default=0,
    help="Number of draws of building heights to plan again on.",
)
@click.option(
    "--parameters",
    "has_parameters",
    is_flag=True,
    help="Also plan on maps with each threshold, range and gamma of the metrics halved and doubled.",
)
@click.option(
    "--scenario",
    type=SCENARIO_FILE,
    help="Scenario of the maps, for --heights and --parameters, if its paths are relative; only with one DIR.",
)
@WORKERS
@WEIGHTS
@click.option("-o", "output", type=PATH, default=Path("out/sensitivity-study"), show_default=True)
def sensitivity_study(
    folders: Sequence[Path], output: Path, as_json: bool, overwrite: bool, **options: Any
) -> int:
    """Find the weights at which many routes over the maps in each DIR change."""
    from jaxurban.io.tables import read_table, records_of
    from jaxurban.maps.sources import scenario_of
    from jaxurban.paths.rows import HAS_PATH, MapsFolder
    from jaxurban.report.run_sensitivity import sensitivity_study as study
    from jaxurban.studies.weights.routes import SensitivityStudySettings

    if options["queries"] is not None and (
        options["num_routes"] is not None or options["altitudes_m"]
    ):
        raise click.UsageError(
            "--queries names the routes: leave out --routes and --altitudes, or --queries"
        )
    scenario = options["scenario"]
    if scenario is not None and not (
        (options["heights"] or options["has_parameters"]) and len(folders) == 1
    ):
        raise click.UsageError("--scenario belongs to --heights or --parameters of one DIR")
    workers, rules = given_workers(options) or all_cores(), given_rules(options)
    weights = rules.pop("weights")
    settings = SensitivityStudySettings(
        vary=names_in(options["vary"]),
        num_heights=options["heights"],
        **rules,
        **{
            name: options[name]
            for name in ("factors", "wrong", "num_samples", "has_parameters", "seed")
        },
    )
    result = study(
        [MapsFolder(folder, options["resolution_m"], options["obstacles"]) for folder in folders],
        output,
        options["num_routes"] or 30
        if options["queries"] is None
        else read_table(options["queries"], "queries"),
        altitudes_m=options["altitudes_m"],
        weights=weights,
        settings=settings,
        scenarios=None
        if scenario is None
        else {folders[0].resolve().name: scenario_of(folders[0], scenario.parent)},
        workers=workers,
        overwrite=overwrite,
    )
    has_route = result.rows.status.isin(HAS_PATH).any()
    code = ExitCode.DONE if has_route else ExitCode.NO_PATH
    if not has_route:
        LOG.warning(f"warning: {NO_ROUTE}")
    if "sobol_summary" in result.tables:
        needed = result.tables["sobol_summary"].samples_needed.max()
        if needed > 0:
            remedy = f"about {needed:.0f} samples (--samples {needed:.0f}) should resolve them"
            LOG.warning(f"warning: some Sobol shares are not resolved: {remedy}")
    LOG.info(
        f"study of sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}"
    )
    if as_json:
        kept = {
            name: records_of(table)
            for name, table in result.tables.items()
            if name.endswith("summary")
        }
        statuses = result.rows.status.value_counts().to_dict()
        facts = {"folder": str(output), "statuses": statuses, "tables": kept}
        print_json(facts, code, "" if has_route else NO_ROUTE)
    return code
