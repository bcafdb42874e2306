"""jaxurban sensitivity, of one route, and jaxurban sensitivity-study, of many routes in one or several cities."""

from collections.abc import Sequence
from dataclasses import asdict
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
    given_rules,
    given_workers,
    names_in,
    print_json,
    take_snap,
    tell,
    together,
)
from jaxurban.progress import reporting

WEIGHTS = together(  # what both commands ask of weights
    click.option(
        "--vary", default="", metavar="NAME,...", help="Weights that vary.  [default: every metric with a weight]"
    ),
    click.option(
        "--range",
        "factors",
        type=Numbers("LOW,HIGH", "two factors, as in 0.1,10", 2),
        default="0.1,10",
        show_default=True,
        help="Times each weight.",
    ),
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True),
    click.option("--overwrite", is_flag=True, help="Replace another run of this command in the output folder."),
    DEVICE,
    JSON_FLAG,
)
SCENARIO_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command()
@ROUTE
@click.option("--samples", "num_samples", type=int, default=128, show_default=True, help="For Sobol; a power of two.")
@click.option("--pareto", default="", metavar="A,B[,C]", help="What to trade.  [default: distance, the two dearest]")
@click.option("--tolerance", type=float, default=1e-3, show_default=True, help="Of the front; 1e-9 is exact.")
@click.option("--buildings", "with_buildings", is_flag=True, help="Also rank buildings by what they cost the route.")
@click.option(
    "--scenario", type=SCENARIO_FILE, help="That made the maps, where --buildings needs its folder; of one DIR."
)
@WEIGHTS
@click.option("-o", "output", type=PATH, default=Path("out/sensitivity"), show_default=True)
def sensitivity(folder: Path, output: Path, as_json: bool, overwrite: bool, **given: Any) -> int:
    """Report what would change a route over the maps in DIR."""
    from jaxurban.io.tables import records_of
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.metric_maps import open_maps
    from jaxurban.paths.plan import cost_map
    from jaxurban.report.buildings import BUILDINGS_FILES, write_buildings
    from jaxurban.report.sensitivity import FILES, ranges, sensitivity_markdown, sensitivity_outputs
    from jaxurban.report.write import REPORT_FILE, save
    from jaxurban.studies.weights.study import SensitivitySettings
    from jaxurban.studies.weights.study import sensitivity as study

    with_buildings, scenario = given["with_buildings"], given["scenario"]
    if scenario is not None and not with_buildings:
        raise click.UsageError("--scenario belongs to --buildings: add that")
    how = SensitivitySettings(
        vary=names_in(given["vary"]),
        objectives=names_in(given["pareto"]),
        **{name: given[name] for name in ("factors", "num_samples", "tolerance", "seed")},
    )
    maps = open_maps(folder, given["resolution_m"], obstacles=given["obstacles"])
    at = {name: given[name] for name in ("time", "time_of_day")}
    shared = cost_map(maps, given["altitude_m"], objective="weighted", **at, **given_rules(given))
    shared.maps.check_altitude(given["altitude_m"])  # whose map its figures show
    Workspace.check(output, "sensitivity")
    ends = {"start": given["start"], "goal": given["goal"], "snap": take_snap(given)}
    first = shared.plan(**ends)
    if not first.status.has_path:
        tell(first.to_dict()["message"])
        if as_json:
            print_json(first.to_dict())
        return first.status.exit_code
    if first.search.note:
        tell(first.search.note)
    query = {"altitude_m": given["altitude_m"]} | at | ends
    key = {"maps": shared.maps.identity, "buildings": with_buildings} | query | dict(first.settings) | asdict(how)
    names = [*FILES, *(f"buildings/{name}" for name in BUILDINGS_FILES if with_buildings)]
    with (
        Workspace.open(output, "sensitivity", key, names=names, overwrite=overwrite),
        reporting("sensitivity") as report,
    ):
        found = study(shared, **ends, settings=how, progress=report)
        report("report")
        save(output, sensitivity_outputs(found)[0])
        if with_buildings:
            report("buildings")
            buildings = write_buildings(folder, first, output / "buildings", scenario=scenario)
            save(output, {REPORT_FILE: sensitivity_markdown(found, buildings)})
    tell(f"sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        tables = {name: records_of(table.reset_index()) for name, table in found.tables().items()}
        result = {"route": found.route.to_dict(), "ranges": {name: ranges(found, name) for name in found.lines}}
        print_json(result | {"tables": tables, "num_plans": found.num_plans, "elapsed_s": found.elapsed_s})
    return 0


@click.command("sensitivity-study")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=PATH)
@click.option("--routes", "num_routes", type=click.IntRange(min=1), help="Sample so many in each DIR.  [default: 30]")
@click.option(
    "--altitudes", "altitudes_m", type=Numbers("M,...", "numbers, as in 20,60"), help="Of --routes.  [default: all]"
)
@click.option("--queries", type=PATH, help="Study these routes (.csv, .parquet), not sampled ones.")
@RULES
@click.option(
    "--wrong", type=float, default=2.0, show_default=True, help="A wrong weight is so many times off, for its regret."
)
@click.option(
    "--samples", "num_samples", type=int, default=32, show_default=True, help="Of each route for Sobol; a power of two."
)
@click.option("--heights", type=click.IntRange(min=0), default=0, help="Plan on maps of so many draws of heights.")
@click.option(
    "--scenario",
    type=SCENARIO_FILE,
    help="That made the maps, where --heights needs its folder; of one DIR.",
)
@WORKERS
@WEIGHTS
@click.option("-o", "output", type=PATH, default=Path("out/sensitivity-study"), show_default=True)
def sensitivity_study(folders: Sequence[Path], output: Path, as_json: bool, overwrite: bool, **given: Any) -> int:
    """Report what weights do to many routes over the maps in each DIR, drawn or from --queries."""
    from jaxurban.io.tables import read_table, records_of
    from jaxurban.paths.rows import HAS_PATH, MapsFolder
    from jaxurban.planners.base import EXIT_NO_PATH
    from jaxurban.report.buildings import scenario_of
    from jaxurban.report.run_sensitivity import sensitivity_study as study
    from jaxurban.studies.weights.routes import SensitivityStudySettings

    if given["queries"] is not None and (given["num_routes"] is not None or given["altitudes_m"]):
        raise click.UsageError("--queries names the routes: leave out --routes and --altitudes, or --queries")
    scenario = given["scenario"]
    if scenario is not None and not (given["heights"] and len(folders) == 1):
        raise click.UsageError("--scenario belongs to --heights of one DIR")
    workers, rules = given_workers(given), given_rules(given)
    weights = rules.pop("weights")
    settings = SensitivityStudySettings(
        vary=names_in(given["vary"]),
        num_heights=given["heights"],
        **rules,
        **{name: given[name] for name in ("factors", "wrong", "num_samples", "seed")},
    )
    found = study(
        [MapsFolder(folder, given["resolution_m"], given["obstacles"]) for folder in folders],
        output,
        given["num_routes"] or 30 if given["queries"] is None else read_table(given["queries"], "queries"),
        altitudes_m=given["altitudes_m"],
        weights=weights,
        settings=settings,
        scenarios=None if scenario is None else {folders[0].resolve().name: scenario_of(folders[0], scenario)},
        workers=workers,
        overwrite=overwrite,
    )
    has_route = found.rows.status.isin(HAS_PATH).any()
    if not has_route:
        tell("warning: no route was found, so that nothing can be said: the report tells why")
    tell(f"study of sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        kept = {name: records_of(table) for name, table in found.tables.items() if name.endswith("summary")}
        statuses = found.rows.status.value_counts().to_dict()
        print_json({"folder": str(output), "statuses": statuses, "tables": kept})
    return 0 if has_route else EXIT_NO_PATH
