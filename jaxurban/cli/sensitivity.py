"""jaxurban sensitivity: of one route, or of many routes in one or several cities."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    COSTS,
    DEGREES,
    DEVICE,
    ENDS,
    JSON_FLAG,
    PATH,
    Settings,
    default_workers,
    given_rules,
    names_in,
    numbers_in,
    print_json,
    take_snap,
    tell,
    together,
)
from jaxurban.errors import InputError
from jaxurban.progress import reporting

NAMED = {"vary": "vary", "triangle": "triangle", "objectives": "pareto"}  # lists of names, and their options
OF_ONE = {  # options that only the study of one route takes, with what they are left out
    **{"start": None, "goal": None, "altitude_m": None, "time": None, "time_of_day": None, "triangle": ""},
    **{"pareto": "", "tolerance": None, "with_buildings": False, "snap": False, "snap_distance_m": None},
    "degrees": False,
}
OF_MANY = {
    **{"num_routes": None, "altitudes_text": "", "queries": None, "wrong": None, "heights": 0, "parameters": False},
    **{"parameter_text": "", "workers": None, "cluster": None},
}
OPTIONS = {
    **{"altitude_m": "--altitude", "with_buildings": "--buildings", "num_routes": "--routes"},
    **{"altitudes_text": "--altitudes", "parameter_text": "--parameter-factors"},
}
NUM_ROUTES, WRONG, TOLERANCE, SAMPLES_OF_ONE, SAMPLES_OF_MANY = 30, 2.0, 1e-3, 128, 32

MANY = together(
    click.option(
        "--routes", "num_routes", type=click.IntRange(min=1), help="Sample so many in each DIR.  [default: 30]"
    ),
    click.option("--altitudes", "altitudes_text", default="", metavar="M,...", help="Of --routes.  [default: all]"),
    click.option("--queries", type=PATH, help="Study these routes (.csv, .parquet), not sampled ones."),
    click.option("--wrong", type=float, help="A wrong weight is so many times off, for its regret.  [default: 2]"),
    click.option("--heights", type=click.IntRange(min=0), default=0, help="Plan on maps of so many draws of heights."),
    click.option("--parameters", is_flag=True, help="Plan on maps of other thresholds, range and gammas."),
    click.option(
        "--parameter-factors", "parameter_text", default="", metavar="X,...", help="Of --parameters.  [default: 0.5,2]"
    ),
    click.option(
        "--workers", type=click.IntRange(min=1), help="Processes.  [default: one a core, where Dask is installed]"
    ),
    click.option(
        "--cluster", metavar="ADDRESS", help="Work on the Dask cluster of a scheduler, such as tcp://host:8786."
    ),
)


@click.command()
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=PATH)
@together(*(click.option(*names, type=kind, help=f"Of one route: {told}") for names, kind, told in ENDS))
@MANY
@COSTS
@click.option(
    "--vary", default="", metavar="NAME,...", help="Weights that vary.  [default: every metric with a weight]"
)
@click.option(
    "--range", "factors_text", default="0.1,10", show_default=True, metavar="LOW,HIGH", help="Times each weight."
)
@click.option(
    "--samples", "num_samples", type=int, help="For Sobol; a power of two.  [default: 128; 32 of each of many routes]"
)
@click.option(
    "--triangle", default="", metavar="A,B,C", help="Three weights to share.  [default: those that cost most]"
)
@click.option("--pareto", default="", metavar="A,B[,C]", help="What to trade.  [default: distance, the two dearest]")
@click.option("--tolerance", type=float, help="Of triangle and front; 1e-9 is exact.  [default: 0.001]")
@click.option("--buildings", "with_buildings", is_flag=True, help="Also rank buildings by what they cost the route.")
@click.option(
    "--scenario",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="That made the maps, where --buildings, --heights or --parameters needs its folder; of one DIR.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("-o", "output", type=PATH, default=Path("out/sensitivity"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace another run of sensitivity in the output folder.")
@DEGREES
@DEVICE
@JSON_FLAG
def sensitivity(folders: Sequence[Path], output: Path, as_json: bool, overwrite: bool, **given: Any) -> int:
    """Report what would change a route over the maps in DIR, or many routes over those of several cities.

    With --start, --goal and --altitude one route is studied in depth; else many, drawn or from --queries.
    """
    ends = [given[name] is not None for name in ("start", "goal", "altitude_m")]
    if not any(ends):
        _refuse(OF_ONE, given, "one route: give --start, --goal and --altitude too")
        return _many(folders, output, as_json, overwrite, given)
    if not all(ends):
        raise click.UsageError("one route needs all of --start, --goal and --altitude; many routes none of them")
    if len(folders) > 1:
        raise click.UsageError("one route lies on the maps of one DIR: name one, or leave --start and --goal out")
    _refuse(OF_MANY, given, "many routes: leave out --start, --goal and --altitude")
    return _one(folders[0], output, as_json, overwrite, given)


def _refuse(defaults: Settings, given: Settings, whose: str) -> None:
    for name, default in defaults.items():
        if given[name] != default:
            option = OPTIONS.get(name, f"--{name.removesuffix('_m').replace('_', '-')}")
            raise click.UsageError(f"{option} is of {whose}")


def _one(folder: Path, output: Path, as_json: bool, overwrite: bool, given: Settings) -> int:
    from jaxurban.io.files import check_writable
    from jaxurban.io.tables import records_of
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.metric_maps import open_maps
    from jaxurban.paths.cost_map import cost_map
    from jaxurban.report.sensitivity import FILES, add_buildings, ranges, write_sensitivity
    from jaxurban.studies.sensitivity.study import SensitivitySettings
    from jaxurban.studies.sensitivity.study import sensitivity as study

    with_buildings, scenario = given["with_buildings"], given["scenario"]
    if scenario is not None and not with_buildings:
        raise click.UsageError("--scenario belongs to --buildings: add that")
    snap = take_snap(given)
    chosen: dict[str, Any] = {name: names_in(given[option]) for name, option in NAMED.items()}
    chosen["num_samples"] = SAMPLES_OF_ONE if given["num_samples"] is None else given["num_samples"]
    chosen["tolerance"] = TOLERANCE if given["tolerance"] is None else given["tolerance"]
    how = SensitivitySettings(factors=_factors(given["factors_text"]), seed=given["seed"], **chosen)
    maps = open_maps(folder, given["resolution_m"], obstacles=given["obstacles"])
    at = {name: given[name] for name in ("time", "time_of_day")}
    shared = cost_map(maps, given["altitude_m"], **at, **given_rules(given))
    shared.maps.check_altitude(given["altitude_m"])  # whose map its figures show
    check_writable(output)
    ends = {"start": given["start"], "goal": given["goal"], "snap": snap}
    first = shared.plan(**ends)
    if not first.status.has_path:
        tell(first.to_dict()["message"])
        if as_json:
            print_json(first.to_dict())
        return first.status.exit_code
    if first.search.note:
        tell(first.search.note)
    of_maps = {
        name: str(shared.maps.ds.attrs.get(name))
        for name in ("run_key", "crs", "resolution_m", "first_row", "first_col")
    }
    query = {name: given[name] for name in ("altitude_m", "time", "time_of_day")} | ends
    key = {"maps": of_maps, "buildings": with_buildings} | query | dict(first.settings) | asdict(how)
    names = [*FILES]
    if with_buildings:
        from jaxurban.report.buildings import BUILDINGS_FILES, write_buildings

        names += [f"buildings/{name}" for name in BUILDINGS_FILES]
    with (
        Workspace.open(output, "sensitivity", key, names=names, overwrite=overwrite),
        reporting("sensitivity") as report,
    ):
        found = study(shared, **ends, settings=how, progress=report)
        report("report")
        write_sensitivity(found, output, given["degrees"])
        if with_buildings:
            report("buildings")
            drawn = {"scenario": scenario, "degrees": given["degrees"]}
            add_buildings(output, write_buildings(folder, first, output / "buildings", **drawn))
    tell(f"sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        tables = {name: records_of(table.reset_index()) for name, table in found.tables().items()}
        result = {"route": found.route.to_dict(), "ranges": {name: ranges(found, name) for name in found.vary}}
        print_json(result | {"tables": tables, "num_plans": found.num_plans, "elapsed_s": found.elapsed_s})
    return 0


def _many(folders: Sequence[Path], output: Path, as_json: bool, overwrite: bool, given: Settings) -> int:
    from jaxurban.io.tables import read_table, records_of
    from jaxurban.planners.base import EXIT_NO_PATH
    from jaxurban.report.buildings import scenario_of
    from jaxurban.report.run_sensitivity import sensitivity_study
    from jaxurban.studies.montecarlo.run import MapsFolder
    from jaxurban.studies.montecarlo.trial import HAS_PATH
    from jaxurban.studies.sensitivity.remade import RemadeSettings
    from jaxurban.studies.sensitivity.routes import SensitivityStudySettings

    if given["queries"] is not None and (given["num_routes"] is not None or given["altitudes_text"]):
        raise click.UsageError("--queries names the routes: leave out --routes and --altitudes, or --queries")
    if given["workers"] is not None and given["cluster"] is not None:
        raise InputError("give either --workers, for processes of this machine, or --cluster, not both")
    if given["parameter_text"] and not given["parameters"]:
        raise click.UsageError("--parameter-factors belongs to --parameters: add that")
    factors = numbers_in("--parameter-factors", given["parameter_text"] or "0.5,2")
    remade = RemadeSettings(given["heights"], given["parameters"], factors)
    if given["scenario"] is not None and not (remade and len(folders) == 1):
        raise click.UsageError("--scenario belongs to --heights and --parameters of one DIR")
    rules = given_rules(given)
    weights = rules.pop("weights")
    settings = SensitivityStudySettings(
        vary=names_in(given["vary"]),
        factors=_factors(given["factors_text"]),
        wrong=WRONG if given["wrong"] is None else given["wrong"],
        num_samples=SAMPLES_OF_MANY if given["num_samples"] is None else given["num_samples"],
        **rules,
        seed=given["seed"],
    )
    routes = given["num_routes"] or NUM_ROUTES
    altitudes = numbers_in("--altitudes", given["altitudes_text"]) if given["altitudes_text"] else None
    scenario = given["scenario"]
    found = sensitivity_study(
        [MapsFolder(folder, given["resolution_m"], given["obstacles"]) for folder in folders],
        output,
        routes if given["queries"] is None else read_table(given["queries"], "queries"),
        altitudes_m=altitudes,
        weights=weights,
        settings=settings,
        remade=remade,
        scenarios=None if scenario is None else {folders[0].resolve().name: scenario_of(folders[0], scenario)},
        workers=given["cluster"] or given["workers"] or default_workers(),
        overwrite=overwrite,
    )
    has_route = found.rows.status.isin(HAS_PATH).any()
    if not has_route:
        tell("warning: no route was found, so that nothing can be said: the report tells why")
    tell(f"sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        shown = ("summary", "comparisons")
        kept = {name: records_of(table) for name, table in found.tables.items() if name.endswith(shown)}
        statuses = found.rows.status.value_counts().to_dict()
        print_json({"folder": str(output), "statuses": statuses, "tables": kept})
    return 0 if has_route else EXIT_NO_PATH


def _factors(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--range {text!r} must be two factors, as in 0.1,10") from error
    return low, high
