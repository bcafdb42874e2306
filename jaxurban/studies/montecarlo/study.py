"""study: a Monte Carlo benchmark of planners over metric maps, kept in a folder and resumable."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack

import pandas as pd

from jaxurban import wings
from jaxurban.checks import typed, values_given
from jaxurban.errors import InputError
from jaxurban.io.samples import is_sample
from jaxurban.io.tables import INSTANCES_FILE, PARTS_FOLDER, ROWS_FILE, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import scenario_grid
from jaxurban.maps.scenario import OF_SAMPLING, Scenario, Study
from jaxurban.paths.choices import RulesChoice
from jaxurban.paths.rows import MapsFolder, check_workers, run_rows
from jaxurban.planners.cost import CostModel
from jaxurban.progress import Progress, reporting
from jaxurban.statistics.conclusions import Conclusion
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.sampling import (
    KEY,
    check_instances,
    checked_instances,
    query_columns,
    read_instances,
    sample_instances,
    with_connection,
)
from jaxurban.studies.montecarlo.trial import Benchmark, row_columns
from jaxurban.studies.queries import constraint_options
from jaxurban.studies.results import StudyResult
from jaxurban.world.land_cover import LandCover


@dataclass(frozen=True, eq=False, repr=False)
class BenchmarkResult(StudyResult):
    """What a Monte Carlo benchmark found.

    Attributes:
      folder: where it is kept.
      maps: what it was made on.
      instances: the queries (`sample_instances`).
      rows: what each planner found, one row per planner, objective, instance and altitude.
      settings: how they were run.
      again: command that ran it, which ends in its folder; empty where none did.
      wider: command that runs it on other maps, without instances; empty where none ran it.

    Examples:
      >>> chosen = ju.studies.Study(planners="astar-plus", distance_only=(), altitudes_m=[60.0])
      >>> result = ju.studies.study(maps, "found", 2, settings=chosen, progress=False)
      >>> result.table.groupby("planner")["has_path"].mean().to_dict()
      {'astar-plus': 1.0}
    """

    _command = "study"
    _report = "jaxurban.studies.reports.montecarlo:benchmark_report"

    folder: Path
    maps: MetricMaps
    instances: pd.DataFrame
    rows: pd.DataFrame
    settings: Benchmark
    again: str = ""
    wider: str = ""

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, where it is kept, its instances, and how many runs ended with each status."""
        counts = self.rows.status.value_counts()
        runs = ", ".join(f"{status} {count}" for status, count in counts.items())
        facts = {"folder": str(self.folder), "instances": str(len(self.instances)), "runs": runs}
        return self.decided.facts | facts

    @cached_property
    def decided(self) -> Conclusion:
        """Which planners are cheaper and find more paths, which cannot be told apart, and what to run next."""
        folder = self.maps.folder or "SCENARIO"
        wider = self.wider or f"jaxurban study {folder} -o {self.folder}-wider"
        wider += f" --instances {shlex.quote(str(self.folder / INSTANCES_FILE))}"
        rules = constraint_options(self.settings.constraints, self.maps)
        return analysis.conclusion(self.table, self.instances, self.maps, self.again, wider, rules)

    @property
    def table(self) -> pd.DataFrame:
        """The rows with their instances, ``has_path``, ``is_joined`` and ``ratio``."""
        return analysis.with_instances(self.rows, self.instances)


@typed
def study(
    maps: MetricMaps | MapsFolder | str | Path,
    folder: str | Path,
    instances: pd.DataFrame | int | None = None,
    *,
    settings: Study | None = None,
    workers: int | str = 1,
    overwrite: bool = False,
    progress: Progress = True,
    **rules: Unpack[RulesChoice],
) -> BenchmarkResult:
    """Return what every planner finds for every instance, under equal budgets: a Monte Carlo benchmark.

    Rows are kept in ``folder`` (``rows.parquet``, one per planner, objective, instance and altitude) as they come. The
    same call after any end, ``kill -9`` included, runs only the missing ones; planners and instances may be added. A
    planner that crashes leaves a row with the status ``crashed``, and a place that is not free one with ``bad-input``.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of maps, which several workers need; a `MapsFolder` where it
        holds several resolutions, or planners are to keep another rule of obstacles.
      folder: where the benchmark is kept.
      instances: a table as from `jaxurban.studies.sample_instances`, whose ``is_connected`` is found again on these
        maps, or the number to sample at each altitude; left out, the settings' number.
      settings: planners and budgets.
      cost_model, constraints, preset: of all routes, as in `jaxurban.plan`.
      workers: processes of this machine, 1 works in this process; or the address of a Dask scheduler, whose workers see
        the maps' folder under the same path.
      overwrite: replace a benchmark of other settings.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      ``rows``, one per planner, objective, instance and altitude: status, costs, metres (``length_m``), seconds
      (``elapsed_s``) and the mean of each metric; ``table``, the same beside their instances; ``save`` writes the
      report.

    Raises:
      InputError: a wrong argument, settings of sampled instances beside a table, instances for other maps or none that
        lies on these, or a folder that holds a benchmark of other settings or other instances.

    Examples:
      >>> chosen = ju.studies.Study(planners="astar-plus", altitudes_m=[60.0])
      >>> benchmark = ju.studies.study(maps, "benchmark", 2, settings=chosen, progress=False)
      >>> benchmark.rows[["instance", "planner", "objective", "status"]]
         instance     planner objective   status
      0         0  astar-dist  distance  optimal
      1         0  astar-plus  weighted  optimal
      2         1  astar-dist  distance  optimal
      3         1  astar-plus  weighted  optimal
    """
    # The rules of all runs: an argument comes before the maps' scenario.
    folder = Path(folder)
    chosen = settings or Study()
    if isinstance(instances, int):
        chosen = replace(chosen, instances=instances)
    job = Benchmark(study=chosen, **values_given(rules))

    # The maps under these rules, and the source from which each worker opens them.
    source = maps if isinstance(maps, MetricMaps | MapsFolder) else MapsFolder(maps)
    check_workers(workers, [source])
    opened, job = job.under(source if isinstance(source, MetricMaps) else source.open())
    source = opened if isinstance(source, MetricMaps) else source.at(opened)

    # The instances: those of a table, as these maps connect them, or sampled ones.
    if isinstance(instances, pd.DataFrame):
        instances = _listed_instances(instances, opened, job)
    else:
        _check_samples(
            chosen, ("land_cover",), "sample_instances(cover=...) takes it: give its table"
        )
        instances = sample_instances(
            opened,
            chosen.instances,
            altitudes_m=chosen.altitudes_m,
            weights=chosen.weights,
            cost_model=job.cost_model,
            constraints=job.constraints,
            seed=chosen.seed,
        )

    # The runs that the folder lacks; it is shared with the maps, and mended unless it is replaced.
    with Workspace.open(
        folder,
        "study",
        job.deciding(opened),
        names=[ROWS_FILE, INSTANCES_FILE],
        overwrite=overwrite,
        is_shared=True,
        is_mended=not overwrite,
    ) as workspace:
        _check_growth(workspace, instances)
        write_table(instances, folder / INSTANCES_FILE)
        columns = row_columns(instances.columns)
        with reporting("study", progress) as report:
            sources = {None: source}  # None: one source for all instances, as they name no city
            rows = run_rows(
                folder / ROWS_FILE,
                job,
                instances,
                sources,
                lambda _: columns,
                workers=workers,
                report=report,
            )
    return BenchmarkResult(folder, opened, instances, rows, job)


def _listed_instances(table: pd.DataFrame, maps: MetricMaps, job: Benchmark) -> pd.DataFrame:
    """Return the instances of a user's table, with ``is_connected`` as these maps connect them.

    Args:
      table: of instances.
      maps: that the benchmark runs on.
      job: the benchmark, with its settings and rules.

    Raises:
      InputError: a wrong table, instances for other maps or none that lies on these, or settings of sampled instances.
    """
    _check_samples(
        job.study, OF_SAMPLING, "a table of instances has its own: leave it out, or the table"
    )
    instances = checked_instances(table, "instances")
    check_instances(instances, maps)
    instances = with_connection(instances, maps, CostModel.of(job.cost_model), job.constraints)

    # A single one with an end that is not free is no error: it becomes a row with the status ``bad-input``.
    if instances.is_connected.isna().all():
        first = instances.iloc[0]
        raise InputError(
            f"no instance lies on these maps: of each, as of instance {first.instance} at {first.altitude_m:g} m, the "
            "start or the goal is not free: use the maps that they are for"
        )
    return instances


def without_sampling(settings: Study) -> Study:
    """Return the settings of a study whose instances are drawn already."""
    return replace(settings, **{name: getattr(Study, name) for name in OF_SAMPLING})


def _check_samples(settings: Study, names: Sequence[str], remedy: str) -> None:
    """Check that settings say nothing of how instances are sampled where that would not count.

    Args:
      settings: of a study.
      names: of the settings that would not count.
      remedy: what to do instead, for the message.

    Raises:
      InputError: a setting that is not its default.
    """
    named = [name for name in names if getattr(settings, name) != getattr(Study, name)]
    if named:
        raise InputError(f"settings name {' and '.join(named)}, and {remedy}")


def land_cover_of(scenario: Scenario) -> LandCover | None:
    """Return the water and the parks that the benchmark of a scenario distinguishes, None where no source holds them.

    The source is ``[study] land_cover``. If that is left out, it is the source of the buildings, where this is an OSM
    file, a sample city or the synthetic city.

    Raises:
      InputError: the file cannot be read, or ``[study] land_cover`` names another kind of file.
    """
    region = scenario.region
    named = scenario.study.land_cover
    if named is None and scenario.is_synthetic:
        return wings.demo_cover_for_bounds(region.bounds, region.crs)

    # Files are read as far as the cells of the scenario's first resolution reach.
    source = named or str(scenario.buildings.source)
    grid = scenario_grid(scenario)
    file = source if is_sample(source) else scenario.path_of(source)
    cover = wings.land_cover_from(file, grid.crs, grid.bounds_m)
    if cover is None and named is not None and not is_sample(named):
        raise InputError(
            f"[study] land_cover must be an OpenStreetMap file (.osm.pbf, .osm, or JSON of the Overpass API), "
            f"got {named!r}"
        )
    return cover


def _check_growth(workspace: Workspace, instances: pd.DataFrame) -> None:
    """Raise InputError unless all instances of the benchmark that a folder holds are among these, unchanged.

    A benchmark may grow by further instances, but no row may lose its instance. A folder without rows passes.

    Args:
      workspace: of the folder; knows whether the file of instances is as it was written.
      instances: of this call.
    """
    folder = workspace.folder
    file = folder / INSTANCES_FILE
    remedy = "choose another folder, or pass --overwrite (overwrite=True) to replace it"
    if not (folder / ROWS_FILE).exists() and not any((folder / PARTS_FOLDER).glob("*.json")):
        return

    # The instances that its rows belong to.
    if workspace.is_changed(file):
        raise InputError(f"{str(file)!r} is not as the study wrote it: {remedy}")
    before = read_instances(file).set_index(KEY)

    # Each of them must still be there, with the same value in all columns that planners depend on.
    columns = query_columns(instances.columns)
    before = before.reindex(columns=columns)
    after = instances.set_index(KEY)[columns].reindex(before.index)
    is_same = ((before == after) | (before.isna() & after.isna())).all(axis=1)
    if not is_same.all():
        first: Any = is_same.idxmin()
        number, altitude_m = first
        raise InputError(
            f"{str(folder)!r} holds a study of {len(before)} instances, counted at each altitude, of which "
            f"{(~is_same).sum()} are others or left out now (instance {number} at {altitude_m:g} m is the first), and "
            f"a study can be made longer but not shorter: {remedy}"
        )
