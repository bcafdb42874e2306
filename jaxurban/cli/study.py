"""jaxurban study."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import (
    CONSTRAINTS,
    DEVICE,
    JSON_FLAG,
    PATH,
    PRESET,
    WORKERS,
    given_constraints,
    given_workers,
    print_json,
    tell,
    tell_warnings,
)
from jaxurban.errors import InputError
from jaxurban.progress import reporting

ANALYSIS_FOLDER = "analysis"

if TYPE_CHECKING:
    from jaxurban.maps.scenario import Scenario
    from jaxurban.report.montecarlo import BenchmarkResult


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.option("-o", "folder", type=PATH, required=True, help="Folder of the maps and the study.")
@click.option("--instances", "instances_file", type=PATH, help="Plan these (.parquet, .csv).")
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres.  [default: the scenario's first]")
@click.option("--budget-iterations", type=click.IntRange(min=1), help="Samples a run instead of [study] budget_s.")
@PRESET
@CONSTRAINTS
@WORKERS
@click.option("--benchmark", "benchmark_folder", type=PATH, help="Export a public benchmark to it.")
@click.option("--overwrite", is_flag=True, help="Replace maps or a study of other settings in the output folder.")
@DEVICE
@JSON_FLAG
def study(scenario_file: Path, folder: Path, benchmark_folder: Path | None, as_json: bool, **given: Any) -> int:
    """Run every planner of SCENARIO's [study] on many random queries over its maps, and report what came out."""
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.scenario import Scenario
    from jaxurban.paths.rows import HAS_PATH
    from jaxurban.planners.base import EXIT_NO_PATH
    from jaxurban.planners.cost import CostModel
    from jaxurban.report.benchmark import check_exportable, export_benchmark

    changes = [f"planning.preset={given['preset']!r}"] if given["preset"] else []
    scenario = Scenario.from_toml(scenario_file, changes)
    planning, chosen = scenario.planning, scenario.study
    rules: dict[str, Any] = {
        "cost_model": CostModel.from_settings(
            vars(planning) | ({"cost_model": chosen.cost_model} if chosen.cost_model else {})
        ),
        "constraints": given_constraints(given).under(planning, scenario.vehicle),
    }
    if benchmark_folder is not None:
        check_exportable(**rules)
    workers = given_workers(given)
    Workspace.check(folder / ANALYSIS_FOLDER, "study")
    result = _run(scenario, folder, rules, workers, given)
    report = result.save(folder / ANALYSIS_FOLDER)[-1]
    tell(f"study finished: read {report}")
    made: dict[str, Any] = {"folder": str(folder), "report": str(report), "rows": str(result.folder / "rows.parquet")}
    made |= {"num_rows": len(result.rows), "statuses": result.rows.status.value_counts().to_dict()}
    if benchmark_folder is not None:
        counts = export_benchmark(
            result.maps, result.instances, result.rows, benchmark_folder, result.settings, scenario_file.stem
        )
        tell(
            f"benchmark of {counts['shortest']} shortest and {counts['weighted']} weighted problems: {benchmark_folder}"
        )
        made |= {"benchmark": {"folder": str(benchmark_folder), **counts}}
    if as_json:
        print_json(made)
    if not result.rows.status.isin(HAS_PATH).any():
        tell("warning: no planner found a path for any instance: the report tells why")
        return EXIT_NO_PATH
    return 0


def _run(
    scenario: "Scenario", folder: Path, rules: Mapping[str, Any], workers: int | str, given: Mapping[str, Any]
) -> "BenchmarkResult":
    """Return the benchmark of a scenario, its maps made first where they are not there yet."""
    from jaxurban.maps.run import run_scenario
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.report.montecarlo import land_cover_of
    from jaxurban.report.montecarlo import study as run_study
    from jaxurban.studies.montecarlo.sampling import read_instances, sample_instances

    resolutions_m = scenario.region.resolution_m
    if given["resolution_m"] is not None and given["resolution_m"] not in resolutions_m:
        listed = ", ".join(f"{each:g}" for each in resolutions_m)
        raise InputError(
            f"--resolution {given['resolution_m']:g} is none of the scenario's: it makes maps of {listed} m"
        )
    file = given["instances_file"]
    instances = None if file is None else read_instances(file)
    cover = None if file is not None else land_cover_of(scenario)
    with reporting("maps") as report:
        run = run_scenario(scenario, folder, report, given["overwrite"])
    tell_warnings(run.record)
    maps = MapsFolder(folder, given["resolution_m"] or resolutions_m[0])
    if instances is None:
        instances = sample_instances(
            maps.open(),
            scenario.study.instances,
            altitudes_m=scenario.study.altitudes_m,
            weights=scenario.study.weights,
            cover=cover,
            seed=scenario.study.seed,
            **rules,
        )
    chosen = scenario.study
    if given["budget_iterations"]:
        chosen = replace(chosen, budget_iterations=given["budget_iterations"])
    return run_study(
        maps, folder / "study", instances, settings=chosen, **rules, workers=workers, overwrite=given["overwrite"]
    )
