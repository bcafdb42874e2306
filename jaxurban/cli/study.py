"""jaxurban study."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    CONSTRAINTS,
    DEVICE,
    JSON_FLAG,
    PATH,
    PRESET,
    WORKERS,
    all_cores,
    given_constraints,
    given_workers,
    print_json,
)
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG, reporting

NO_ROUTE = "no planner found a path for any instance: the report says why"


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.option("-o", "folder", type=PATH, required=True, help="Folder of the maps and the study.")
@click.option(
    "--instances", "instances_file", type=PATH, help="File of queries to plan (.parquet, .csv)."
)
@click.option(
    "--resolution",
    "resolution_m",
    type=float,
    help="Cell size of the maps in metres.  [default: the scenario's first]",
)
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change a setting of SCENARIO; repeatable.",
)
@PRESET
@CONSTRAINTS
@WORKERS
@click.option("--benchmark", "benchmark_folder", type=PATH, help="Folder for a public benchmark.")
@click.option(
    "--overwrite",
    is_flag=True,
    help="Replace maps or a study of other settings in the output folder.",
)
@DEVICE
@JSON_FLAG
def study(
    scenario_file: Path,
    folder: Path,
    instances_file: Path | None,
    changes: tuple[str, ...],
    benchmark_folder: Path | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Run every planner of SCENARIO's [study] on many random queries over its maps, and report their results."""
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.run import run_scenario
    from jaxurban.maps.scenario import Scenario
    from jaxurban.paths.rows import HAS_PATH, MapsFolder
    from jaxurban.planners.cost import CostModel
    from jaxurban.report.benchmark import check_exportable, export_benchmark
    from jaxurban.report.montecarlo import study as run_study
    from jaxurban.studies.montecarlo.sampling import read_instances, sample_instances
    from jaxurban.studies.montecarlo.study import land_cover_of

    preset = [f"planning.preset={options['preset']!r}"] if options["preset"] else []
    scenario = Scenario.from_toml(scenario_file, (*changes, *preset))
    planning, settings = scenario.planning, scenario.study
    kind = settings.cost_model or planning.rules.cost_model
    rules: dict[str, Any] = {
        "cost_model": CostModel.from_settings(vars(planning) | {"cost_model": kind}),
        "constraints": given_constraints(options).under(planning, scenario.vehicle),
    }
    if benchmark_folder is not None:
        check_exportable(**rules)
    workers, analysis = given_workers(options) or all_cores(), folder / "analysis"
    Workspace.check(analysis, "study")
    instances = None if instances_file is None else read_instances(instances_file)
    cover = land_cover_of(scenario) if instances is None else None
    with reporting("maps") as report:
        run = run_scenario(scenario, folder, report, options["overwrite"])
    for warning in run.record["warnings"]:
        LOG.warning(f"warning: {warning}")
    source = MapsFolder(folder, options["resolution_m"] or scenario.region.resolution_m[0])
    if instances is None:
        sampled = {name: getattr(settings, name) for name in ("altitudes_m", "weights", "seed")}
        instances = sample_instances(
            source.open(), settings.instances, cover=cover, **sampled, **rules
        )
    result = run_study(
        source,
        folder / "study",
        instances,
        settings=settings,
        workers=workers,
        overwrite=options["overwrite"],
        **rules,
    )
    report_file = result.save(analysis)[-1]
    LOG.info(f"study finished: read {report_file}")
    facts: dict[str, Any] = {
        "folder": str(folder),
        "report": str(report_file),
        "rows": str(result.folder / "rows.parquet"),
    }
    facts |= {"num_rows": len(result.rows), "statuses": result.rows.status.value_counts().to_dict()}
    if benchmark_folder is not None:
        counts = export_benchmark(
            result.maps,
            result.instances,
            result.rows,
            benchmark_folder,
            result.settings,
            scenario_file.stem,
        )
        LOG.info(
            f"benchmark of {counts['shortest']} shortest and {counts['weighted']} weighted problems: {benchmark_folder}"
        )
        facts |= {"benchmark": {"folder": str(benchmark_folder), **counts}}
    has_path = result.rows.status.isin(HAS_PATH).any()
    code = ExitCode.DONE if has_path else ExitCode.NO_PATH
    if as_json:
        print_json(facts, code, "" if has_path else NO_ROUTE)
    if not has_path:
        LOG.warning(f"warning: {NO_ROUTE}")
    return code
