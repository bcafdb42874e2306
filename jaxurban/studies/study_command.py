"""jaxurban study."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jaxurban.progress import LOG, reporting
from jaxurban.terminal.common import (
    CHANGES,
    DEVICE,
    GIVEN,
    JSON_FLAG,
    NUMBER,
    OVERWRITE,
    PATH,
    PRESET,
    SCENARIO,
    WORKERS,
    ZONES,
    Settings,
    again,
    all_cores,
    constraints_given,
    log_lines,
    outcome_of,
    print_json,
)
from jaxurban.terminal.options import command, grouped_options

if TYPE_CHECKING:
    from jaxurban.paths.constraints import Constraints
    from jaxurban.settings import Preset

NO_ROUTE = "no planner found a path for any instance: the report says why"


@command()
@SCENARIO
@click.option("-o", "folder", type=PATH, required=True, help="Folder of the maps and the study.")
@click.option(
    "--instances", "instances_file", type=GIVEN, help="File of queries to plan (.parquet, .csv)."
)
@NUMBER(
    "--resolution",
    "resolution_m",
    help="Cell size of the maps in metres.  [default: the scenario's first]",
)
@CHANGES
@PRESET
@grouped_options("constraints", constraints_given, ZONES, names=("no_fly", "require"))
@WORKERS
@OVERWRITE
@DEVICE
@JSON_FLAG
def study_command(
    scenario_file: Path,
    folder: Path,
    instances_file: Path | None,
    resolution_m: float | None,
    changes: tuple[str, ...],
    preset: "Preset",
    constraints: "Constraints",
    workers: int | str | None,
    overwrite: bool,
    as_json: bool,
) -> int:
    """Run planners on many random queries, and report.

    The planners are those of [study] in SCENARIO, a file or a folder of maps, and the queries are over its maps.
    """
    from jaxurban.maps.scenario import OF_SAMPLING
    from jaxurban.maps.scenario_files import read_scenario

    # Settings that --set names and that a file of instances fixes.
    fixed = tuple(f"study.{name}" for name in OF_SAMPLING)
    beside = [change for change in changes if change.startswith(fixed)]
    if instances_file is not None and beside:
        raise click.UsageError(
            f"--set {beside[0]} belongs to sampled instances: leave it out, or --instances"
        )

    # The scenario, with the settings that options change, and the rules of routes, which all later steps share.
    if preset:
        changes = (*changes, f"planning.preset={preset!r}")
    scenario = read_scenario(scenario_file, changes)
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.provenance import finished
    from jaxurban.maps.run import run_scenario
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.studies.montecarlo.sampling import (
        read_instances,
        sample_instances,
        weights_setting,
    )
    from jaxurban.studies.montecarlo.study import land_cover_of, study, without_sampling

    settings = scenario.study

    # What cannot be read or written is refused before anything is made. Then the maps are made.
    workers = workers or all_cores()
    analysis = folder / "analysis"
    Workspace.check(analysis, "study")
    instances = None if instances_file is None else read_instances(instances_file)
    cover = land_cover_of(scenario) if instances is None else None
    with reporting("maps") as report:
        record = finished(scenario, folder)
        if record is None:
            record = run_scenario(scenario, folder, report, overwrite).record
    for warning in record["warnings"]:
        LOG.warning(f"warning: {warning}")

    # Draw instances where no file names them, run all planners on them, and write the report.
    source = MapsFolder(folder, resolution_m or scenario.region.resolution_m[0])
    if instances is None:
        instances = sample_instances(
            source.open(),
            settings.instances,
            cover=cover,
            altitudes_m=settings.altitudes_m,
            weights=settings.weights,
            seed=settings.seed,
            constraints=constraints,
        )
    result = study(
        source,
        folder / "study",
        instances,
        settings=without_sampling(settings),
        workers=workers,
        overwrite=overwrite,
        constraints=constraints,
    )
    # Where the queries are those of a file, further ones are drawn, for a study of its own.
    own = shlex.quote(f"{folder}-more" if instances_file else str(folder))
    typed = again("-o", "--instances", "--set study.instances")
    weights = weights_setting(instances)
    if instances_file and weights:
        typed += f" --set {shlex.quote(weights)}"
    replaced = (f"--set {name}" for name in (*fixed, "region.bounds"))
    wider = f"{again('-o', '--instances', *replaced)} -o {shlex.quote(f'{folder}-wider')}"
    result = replace(result, again=f"{typed} -o {own}", wider=wider)
    report_file = result.save(analysis)[-1]
    log_lines(result.decided.facts)
    LOG.info(f"study finished: read {report_file}")

    # What is printed with --json.
    statuses, code, message = outcome_of(result.rows, NO_ROUTE)
    facts: Settings = {
        "folder": str(folder),
        "report": str(report_file),
        "rows": str(result.folder / "rows.parquet"),
        "num_rows": len(result.rows),
        "statuses": statuses,
        "decided": result.decided.to_dict(),
    }
    if as_json:
        print_json(facts, code, message)
    return code
