"""jaxurban study."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.commands.common import JSON_FLAG, limit_options, print_json, stages, tell, tell_warnings
from jaxurban.errors import InputError

if TYPE_CHECKING:
    from jaxurban.case_study import StudyResult
    from jaxurban.limits import Limits
    from jaxurban.planners.base import CostModel
    from jaxurban.scenario import Scenario


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=click.Path(path_type=Path))
@click.option("-o", "folder", type=click.Path(path_type=Path), required=True, help="Folder of the maps and the study.")
@click.option("--instances", "instances_file", type=click.Path(path_type=Path), help="Ask these (.parquet, .csv).")
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres.  [default: the scenario's first]")
@click.option("--budget-iterations", type=click.IntRange(min=1), help="Samples a run instead of [study] budget_s.")
@limit_options
@click.option(
    "--workers", type=click.IntRange(min=1), help="Processes.  [default: one a core, where Dask is installed]"
)
@click.option("--cluster", metavar="ADDRESS", help="Work on the Dask cluster of a scheduler, such as tcp://host:8786.")
@click.option(
    "--benchmark", "benchmark_folder", type=click.Path(path_type=Path), help="Export a public benchmark to it."
)
@click.option("--overwrite", is_flag=True, help="Replace maps or a study of other settings in the output folder.")
@JSON_FLAG
def study(
    scenario_file: Path,
    folder: Path,
    benchmark_folder: Path | None,
    no_fly: Sequence[Path],
    require: Sequence[str],
    as_json: bool,
    **given: Any,
) -> int:
    """Ask every planner of SCENARIO's [study] many random questions over its maps, and say what came out."""
    from jaxurban.limits import Limits
    from jaxurban.planners.base import CostModel
    from jaxurban.scenario import Scenario
    from jaxurban.studies.benchmarkset import check_exportable, export_benchmark
    from jaxurban.study_report import write_analysis

    scenario = Scenario.from_toml(scenario_file)
    model = CostModel.from_settings({**scenario.planning.model_dump(), "cost_model": scenario.study.cost_model})
    limits = Limits.read(no_fly, require)
    if benchmark_folder is not None:
        check_exportable(model, limits)
    result = _run(scenario, folder, model, limits, **given)
    report = write_analysis(result, folder / "analysis")
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
    return 0


def _run(
    scenario: "Scenario",
    folder: Path,
    model: "CostModel",
    limits: "Limits",
    instances_file: Path | None,
    resolution_m: float | None,
    budget_iterations: int | None,
    workers: int | None,
    cluster: str | None,
    overwrite: bool,
) -> "StudyResult":
    from jaxurban.case_study import land_cover_of
    from jaxurban.case_study import study as run_study
    from jaxurban.cost import Weights
    from jaxurban.pipeline import run_scenario
    from jaxurban.studies.sampling import read_instances

    if workers is not None and cluster is not None:
        raise InputError("give either --workers, for processes of this machine, or --cluster, not both")
    settings = scenario.study
    instances = None if instances_file is None else read_instances(instances_file)
    cover = None if instances_file is not None else land_cover_of(scenario)
    with stages("maps") as on_stage:
        run = run_scenario(scenario, folder, on_stage, overwrite, tell=tell)
    tell_warnings(run.record)
    weights = settings.weights
    return run_study(
        folder,
        folder / "study",
        instances=instances,
        num_instances=settings.instances,
        altitudes_m=settings.altitudes_m,
        cover=cover,
        weights=weights if isinstance(weights, str) else [Weights(**each.model_dump()) for each in weights],
        planners=settings.planners,
        distance_only=settings.distance_only,
        cost_model=model,
        limits=limits,
        budget_s=settings.budget_s,
        budget_iterations=budget_iterations or settings.budget_iterations,
        seed=settings.seed,
        workers=workers or _default_workers(cluster),
        cluster=cluster,
        resolution_m=resolution_m or scenario.region.resolution_m[0],
        obstacles=scenario.planning.obstacles,
        overwrite=overwrite,
    )


def _default_workers(cluster: str | None) -> int:
    """Return a process a core, or one where Dask's scheduler is not installed, which is told."""
    from importlib.util import find_spec

    from jaxurban.resources import num_cores

    if cluster is not None or find_spec("distributed") is not None:
        return num_cores()
    tell("working on one core: several need Dask's scheduler, pip install 'jaxurban[cluster]'")
    return 1
