"""Rows: the one engine of long jobs over many routes: a table, what is done with each of its instances, and a store.

Every row is on disk when it is counted: after any end, Ctrl-C and ``kill -9`` included, only what is missing is made.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import pandas as pd

from jaxurban.checks import check_extra, typed
from jaxurban.errors import InputError
from jaxurban.io.tables import Row, RowStore, read_table, records_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.saving import open_maps
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.plan import cost_map, rules_on
from jaxurban.planners.base import Status
from jaxurban.planners.cost import CostModel
from jaxurban.progress import Report
from jaxurban.settings import CostKind, ObstacleRule, Planning, Preset

CRASHED, BAD_INPUT = "crashed", "bad-input"  # beside the names of `Status`
KILLED = "Its worker process was killed again and again, most likely for lack of memory."
HAS_PATH = frozenset(status.value for status in Status if status.has_path)
Run = tuple[Any, ...]  # what is done with an instance, by the values of `RouteJob.run_key`


@typed
@dataclass(frozen=True)
class MapsFolder:
    """Maps in a folder, which several workers can read.

    Attributes:
      folder: of the maps, as `open_maps` takes it.
      resolution_m: which of them, where it holds several.
      obstacles: where planners may fly (see `jaxurban.maps.metric_maps.MetricMaps`); None: as the scenario has it.

    Examples:
      >>> folder = ju.studies.MapsFolder(maps.save("maps"), obstacles="touched")
      >>> folder.open().grid.shape
      (30, 30)
    """

    folder: str | Path
    resolution_m: float | None = None
    obstacles: ObstacleRule | None = None

    def at(self, opened: MetricMaps) -> "MapsFolder":
        """Return the folder by its whole path, with the resolution and the rule of its opened maps.

        Returns:
          `MapsFolder` in which nothing is left out, so that a worker in any folder opens the same maps.

        Examples:
          >>> whole = ju.studies.MapsFolder("maps").at(maps)
          >>> whole.folder.is_absolute(), whole.resolution_m, whole.obstacles
          (True, 20.0, 'touched')
        """
        return MapsFolder(Path(self.folder).resolve(), opened.grid.resolution_m, opened.obstacles)

    def open(self) -> MetricMaps:
        """Return the maps, with the errors of `open_maps`.

        Returns:
          `MetricMaps` whose arrays are read when they are used.

        Examples:
          >>> ju.studies.MapsFolder(maps.save("maps")).open().altitudes_m
          (20.0, 60.0)
        """
        return open_maps(self.folder, self.resolution_m, obstacles=self.obstacles)


Source = MetricMaps | MapsFolder


@dataclass(frozen=True, kw_only=True)
class RouteRules:
    """Under what the routes of a study are planned.

    Attributes:
      cost_model: of the routes (see `Problem`), or its kind alone.
      constraints: no-fly zones, bounds and clearances that close cells to starts, goals and routes.
      preset: ``"paper"`` for its cost model, obstacles and clearance instead of the defaults of what is left out here
        and in the scenario of the maps, from which a study takes what it gives.
    """

    cost_model: CostModel | CostKind | None = None
    constraints: Constraints = field(default_factory=Constraints)
    preset: Preset = ""

    def __post_init__(self) -> None:
        """Refuse an unknown preset and an unknown cost model: both lines raise InputError."""
        Planning(preset=self.preset)
        CostModel.of(self.cost_model)

    def under(self, maps: MetricMaps) -> tuple[MetricMaps, Self]:
        """Return the maps under these rules, and the rules on these maps, in which nothing is left out (`rules_on`)."""
        maps, cost_model, constraints = rules_on(
            maps, self.cost_model, self.constraints, self.preset
        )
        return maps, replace(self, cost_model=cost_model, constraints=constraints)

    def rules(self) -> dict[str, Any]:
        """Return cost model and constraints as plain, JSON-ready values."""
        return {**CostModel.of(self.cost_model).settings, "limits": self.constraints.to_dict()}

    def cost_map(
        self, maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None
    ) -> Any:
        """Return the `CostMap` of routes at an altitude and time (errors as in `jaxurban.cost_map`).

        Args:
          maps: the metric maps.
          altitude_m: above ground.
          time, time_of_day: of the GPS and the population map; the first if None.
        """
        return cost_map(
            maps,
            altitude_m,
            objective="weighted",
            cost_model=self.cost_model,
            time=time,
            time_of_day=time_of_day,
            constraints=self.constraints,
            preset=self.preset,
        )


class RouteJob(RouteRules):
    """What is done with every instance of a table. Hashable: workers keep maps by it.

    Attributes:
      key: columns that name a row.
      run_key: those of them that name a run.
    """

    key: ClassVar[tuple[str, ...]]
    run_key: ClassVar[tuple[str, ...]] = ()

    @property
    def runs(self) -> Sequence[Run]:
        """What is done with every instance: each run makes a row. By default one run, without a key."""
        return [()]

    def facts(self, cost_map: CostMap, instance: Row, runs: Sequence[Run]) -> Iterable[Row]:
        """Return the results of runs on an instance, a row of values by column for each, in their order.

        Args:
          cost_map: of the instance's altitude and times.
          instance: a row of the table of instances.
          runs: that are still to be done.

        Raises:
          InputError: the instance is not one of these maps.
        """
        raise NotImplementedError

    def key_of(self, instance: Row, run: Run) -> dict[str, Any]:
        """Return the columns that name the row of a run on an instance, with their values."""
        values = {**instance, **dict(zip(self.run_key, run, strict=True))}
        return {name: values[name] for name in self.key}

    def row_of(self, instance: Row, run: Run, facts: Row) -> dict[str, Any]:
        """Return the row of a run on an instance: its key and its results, None for numbers that are not finite."""
        row = self.key_of(instance, run) | dict(facts)
        for name, value in row.items():
            if isinstance(value, float) and not math.isfinite(value):
                row[name] = None
        return row


class InstanceRuns(NamedTuple):
    """An instance, and the runs of it that are still to be done."""

    instance: Row
    runs: tuple[Run, ...]

    @property
    def city(self) -> Any:
        """Where it lies; None where the table names no city."""
        return self.instance.get("city")

    @property
    def map_key(self) -> tuple[float, str | None, str | None]:
        """The maps that it lies on: altitude, time, time of day."""
        return self.instance["altitude_m"], self.instance["time"], self.instance["time_of_day"]


def runs_to_do(instances: pd.DataFrame, job: RouteJob, store: RowStore) -> list[InstanceRuns]:
    """Return the runs that a store does not hold yet, by instance; an instance without such runs is left out.

    Instances of one city follow each other, and among them instances on the same maps, so that maps are made once.
    """
    tasks = []
    for instance in records_of(instances):
        keys = {run: tuple(job.key_of(instance, run).values()) for run in job.runs}
        runs = tuple(run for run, key in keys.items() if key not in store)
        if runs:
            tasks.append(InstanceRuns(instance, runs))
    # By city, altitude and times, as texts, since None has no order.
    return sorted(tasks, key=lambda task: [*map(str, (task.city, *task.map_key))])


def check_workers(workers: int | str, sources: Iterable[Source]) -> None:
    """Raise InputError unless so many workers can read these maps."""
    if isinstance(workers, int) and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    if workers != 1:
        check_extra()
    if workers != 1 and any(isinstance(source, MetricMaps) for source in sources):
        raise InputError(
            "several workers need the maps in a folder: save them, and give the folder instead"
        )


def run_rows(
    file: Path,
    job: RouteJob,
    instances: pd.DataFrame,
    sources: Mapping[Any, Source],
    columns: Callable[[Sequence[Row]], Mapping[str, str]],
    *,
    workers: int | str,
    report: Report,
) -> pd.DataFrame:
    """Return the rows of a job over a table, in the order of their keys; those that the file holds are not made again.

    Args:
      file: where rows are kept. It is complete after any end, an error or Ctrl-C included.
      job: what is done with each instance.
      instances: altitude, times and what the job needs; with a column ``city`` where there are several.
      sources: the maps of each city by its name, or by None where the table names no city.
      columns: returns the columns of rows, with their types.
      workers: number of processes of this machine (Dask), of which 1 is this process itself; or the address of a Dask
        scheduler, whose workers see the maps' folders under the same paths.
      report: is called with how many rows are done, and how many of them have paths.
    """
    store = RowStore(file, job.key, has_parts=True)
    tasks = runs_to_do(instances, job, store)
    num_left = sum(len(task.runs) for task in tasks)
    try:
        if workers == 1 or not tasks:
            keep_rows(store, solve_here(tasks, sources, job), num_left, report)
        else:
            from jaxurban.maps.executors import cluster_client  # imported here: it brings Dask

            with cluster_client(workers) as client:
                keep_rows(store, solve_on(client, tasks, sources, job), num_left, report)
    finally:
        store.save(columns(store.rows))
    return read_table(file, "rows")


def solve_here(
    tasks: Iterable[InstanceRuns], sources: Mapping[Any, Source], job: RouteJob
) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of each task, made in this process; tasks of one city follow each other (`runs_to_do`)."""
    for city, city_tasks in groupby(tasks, lambda task: task.city):
        yield from map(_solver(sources[city], job), city_tasks)


def solve_on(
    client: Any, tasks: Iterable[InstanceRuns], sources: Mapping[Any, Source], job: RouteJob
) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of each task, made on a Dask cluster, as they are done.

    A run that kills its workers again and again costs only its own row, which then says that it crashed. Dask gives up
    every task that a killed worker had taken on. These are run once more at the end, run by run, each alone on the
    cluster, so that only the run that kills is a crash.

    Args:
      client: of the cluster.
      tasks: from `runs_to_do`.
      sources: folders of the maps of each city, by its name or None.
      job: what is done.
    """
    from distributed import KilledWorker, as_completed

    def submit(task: InstanceRuns) -> Any:
        """Return the future of a task's rows."""
        return client.submit(_solve_in_worker, sources[task.city], job, task, pure=False)

    # All tasks. Those whose worker was killed are parted into suspects of one run each.
    waiting = {submit(task): task for task in tasks}
    suspects: list[InstanceRuns] = []
    for future in as_completed(list(waiting)):
        task = waiting.pop(future)
        try:
            rows = future.result()
        except KilledWorker:
            suspects += [task._replace(runs=(run,)) for run in task.runs]
            continue
        future.release()
        yield rows

    # The suspects, one after the other.
    for task in suspects:
        try:
            rows = submit(task).result()
        except KilledWorker:
            rows = [job.row_of(task.instance, task.runs[0], {"status": CRASHED, "note": KILLED})]
        yield rows


def _solver(source: Source, job: RouteJob) -> Callable[[InstanceRuns], list[dict[str, Any]]]:
    """Return a function that makes the rows of a task.

    It keeps the cost map of the last task, for further tasks at the same altitude and time.

    Args:
      source: the maps of the tasks' city.
      job: what is done with each instance.
    """
    maps = source if isinstance(source, MetricMaps) else source.open()
    map_of = lru_cache(maxsize=1)(partial(job.cost_map, maps))
    # A task unpacks into its instance and its runs.
    return lambda task: solve_instance(job, map_of(*task.map_key), *task)


_solver_in_worker = lru_cache(maxsize=1)(_solver)


def _solve_in_worker(source: MapsFolder, job: RouteJob, task: InstanceRuns) -> list[dict[str, Any]]:
    """Return the rows of a task in a worker, which keeps the maps of the last city open."""
    return _solver_in_worker(source, job)(task)


def solve_instance(
    job: RouteJob, cost_map: CostMap, instance: Row, runs: Sequence[Run]
) -> list[dict[str, Any]]:
    """Return the rows of an instance, one for each run; an error makes rows too, which say what it was."""
    try:
        results = list(job.facts(cost_map, instance, runs))
    except Exception as error:  # whatever a route does, the job goes on
        results = [failure(error)] * len(runs)
    return [job.row_of(instance, run, facts) for run, facts in zip(runs, results, strict=True)]


def failure(error: Exception) -> dict[str, Any]:
    """Return what a row says of an error: ``status``, and a sentence as ``note``."""
    if isinstance(error, InputError):
        return {"status": BAD_INPUT, "note": str(error)}
    return {"status": CRASHED, "note": f"{type(error).__name__}: {error}"}


def keep_rows(
    store: RowStore, made: Iterable[list[dict[str, Any]]], num_left: int, report: Report
) -> None:
    """Keep rows in a store as they are made, each on disk when it is counted.

    Args:
      store: to which rows are added, beside those of earlier runs.
      made: lists of rows, from `solve_here` or `solve_on`.
      num_left: how many rows these will be.
      report: is called with how many rows are done, and how many of them have paths.
    """
    counts = Counter(map(_outcome, store.rows))
    total = len(store) + num_left
    report("runs", len(store), total, **counts)
    for rows in made:
        store.add(rows)
        counts.update(map(_outcome, rows))
        report("runs", len(store), total, **counts)


def _outcome(row: Row) -> str:
    """Return what a row counts as in a report: ``"paths"``, ``"crashed"`` or ``"none"``."""
    if row["status"] in HAS_PATH:
        return "paths"
    return "crashed" if row["status"] == CRASHED else "none"
