"""Runs over instances, in parallel and resumable: every planner of a benchmark, or what a study asks of each route."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol, get_args

import pandas as pd

from jaxurban.errors import InputError, one_of, typed
from jaxurban.io.tables import ROWS_FILE, RowStore, read_table, records_of
from jaxurban.maps.executors import cluster_client
from jaxurban.maps.metric_maps import MetricMaps, Obstacles, open_maps
from jaxurban.paths.cost_map import CostMap
from jaxurban.progress import Progress, Report, reporting
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.montecarlo.trial import CRASHED, HAS_PATH, BenchmarkSettings, row_columns

ROW_KEY = (*KEY, "planner", "objective")
Run = tuple[str, ...]  # what is done with an instance, by the further parts of its row's key: planner and objective


@typed
@dataclass(frozen=True)
class MapsFolder:
    """Maps in a folder, which several workers can read.

    Attributes:
      folder: of the maps, as `open_maps` takes it.
      resolution_m: which of them, where it holds several.
      obstacles: where planners may fly (see `jaxurban.maps.metric_maps.MetricMaps`); None: as the scenario has it.
    """

    folder: str | Path
    resolution_m: float | None = None
    obstacles: Obstacles | None = None

    def __post_init__(self) -> None:
        if self.obstacles is not None:
            one_of("obstacles", self.obstacles, get_args(Obstacles))

    def at(self, opened: MetricMaps) -> "MapsFolder":
        """Return the folder by its whole path, with the resolution and the rule of its opened maps."""
        return MapsFolder(Path(self.folder).resolve(), opened.grid.resolution_m, opened.obstacles)

    def open(self) -> MetricMaps:
        """Return the maps."""
        return open_maps(self.folder, self.resolution_m, obstacles=self.obstacles)


class Job(Protocol):
    """What is done with every instance. A frozen dataclass: it is sent to workers, which keep what they made by it."""

    def __hash__(self) -> int: ...

    def cost_map(self, maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None) -> CostMap:
        """Return the cost map that instances of an altitude and time share."""

    def solve(self, on: CostMap, instance: Mapping[str, Any], runs: Sequence[Run]) -> list[dict[str, Any]]:
        """Return the rows of an instance, one a run; whatever goes wrong is a row too."""

    def killed(self, instance: Mapping[str, Any], run: Run) -> dict[str, Any]:
        """Return the row of a run that killed its worker again and again."""


class InstanceRuns(NamedTuple):
    """An instance, and the runs of it that are still to be done."""

    instance: Mapping[str, Any]
    runs: tuple[Run, ...]

    @property
    def map_key(self) -> tuple[float, str | None, str | None]:
        """The maps that it lies on: altitude, time, time of day."""
        return self.instance["altitude_m"], self.instance["time"], self.instance["time_of_day"]


def tasks_of(
    instances: pd.DataFrame, runs: Sequence[Run], done: RowStore, key: Sequence[str] = KEY
) -> list[InstanceRuns]:
    """Return what is still to be done, instances on the same maps one after the other.

    Args:
      instances: to be run.
      runs: of each; a row's key is the instance's with the run's.
      done: rows that are there.
      key: columns that name an instance.
    """
    tasks = []
    for instance in records_of(instances):
        head = tuple(instance[name] for name in key)
        left = tuple(run for run in runs if (*head, *run) not in done)
        if left:
            tasks.append(InstanceRuns(instance, left))
    return sorted(tasks, key=lambda task: tuple(map(str, task.map_key)))


@contextmanager
def helpers(workers: int | str, sources: Iterable[MapsFolder | MetricMaps]) -> Iterator[Any]:
    """Yield the Dask client of several workers, None for one, which is this process.

    Args:
      workers: processes of this machine (Dask), 1 works in this process; or the address of a Dask scheduler, whose
        workers see the maps' folders under the same paths.
      sources: the maps; those in memory serve this process only.

    Raises:
      InputError: maps in memory and several workers, or no cluster.
    """
    if workers == 1:
        yield None
        return
    if any(isinstance(source, MetricMaps) for source in sources):
        raise InputError("several workers need the maps in a folder: save them, and give the folder instead")
    address = workers if isinstance(workers, str) else None
    with cluster_client(address, None if isinstance(workers, str) else workers) as client:
        yield client


def solve(
    tasks: Sequence[InstanceRuns], source: MapsFolder | MetricMaps, job: Job, client: Any = None
) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of each task as it is done, in any order.

    Args:
      tasks: what to do.
      source: the maps.
      job: what is done.
      client: from `helpers`.
    """
    if client is None:
        solver = _Solver(source, job)
        for task in tasks:
            yield solver.solve(task)
        return
    assert isinstance(source, MapsFolder)
    yield from solve_on(client, tasks, source, job)


def solve_on(
    client: Any, tasks: Sequence[InstanceRuns], source: MapsFolder, job: Job
) -> Iterator[list[dict[str, Any]]]:
    """Yield rows that a Dask cluster has made. A run that kills its workers again and again costs its own row alone.

    Dask blames every task that a killed worker held. Those it gives up are run once more at the end, run by run, each
    alone on the cluster, so that only the guilty one is a crash.
    """
    from distributed import KilledWorker, as_completed

    def submit(task: InstanceRuns) -> Any:
        return client.submit(_solve_in_worker, source, job, task, pure=False)

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
    for task in suspects:
        try:
            rows = submit(task).result()
        except KilledWorker:
            rows = [job.killed(task.instance, task.runs[0])]
        yield rows


class _Solver:
    """The cost map of the last altitude and time, kept for the tasks to come."""

    def __init__(self, source: MapsFolder | MetricMaps, job: Job) -> None:
        maps = source if isinstance(source, MetricMaps) else source.open()
        self.job = job
        self._map_of = lru_cache(maxsize=1)(partial(job.cost_map, maps))

    def solve(self, task: InstanceRuns) -> list[dict[str, Any]]:
        """Return the rows of a task."""
        return self.job.solve(self._map_of(*task.map_key), task.instance, task.runs)


_solver_in_worker = lru_cache(maxsize=1)(_Solver)


def _solve_in_worker(source: MapsFolder, job: Job, task: InstanceRuns) -> list[dict[str, Any]]:
    return _solver_in_worker(source, job).solve(task)


def keep_rows(store: RowStore, made: Iterable[list[dict[str, Any]]], num_left: int, report: Report) -> None:
    """Keep rows in a store as they are made, each on disk when it is counted.

    Args:
      store: of all rows, those of earlier runs too.
      made: rows, from `solve`.
      num_left: how many will come.
      report: gets how many are there, and how many of them have paths.
    """
    counts = Counter(_outcome(row) for row in store.rows)
    total = len(store) + num_left
    report("runs", len(store), total, **counts)
    for rows in made:
        store.add(rows)
        counts.update(map(_outcome, rows))
        report("runs", len(store), total, **counts)


def run_benchmark(
    instances: pd.DataFrame,
    source: MapsFolder | MetricMaps,
    folder: Path,
    settings: BenchmarkSettings,
    workers: int | str = 1,
    progress: Progress = True,
) -> pd.DataFrame:
    """Return the rows of a benchmark (see `trial.row_columns`), in the order of their keys.

    Every row is on disk when it is counted. After any end, Ctrl-C and ``kill -9`` included, the same call goes on: rows
    that are in ``folder`` are not made again.

    Args:
      instances: from `sample_instances` or `read_instances`.
      source: the maps.
      folder: where the rows are kept.
      settings: what is done.
      workers: see `helpers`.
      progress: as in `jaxurban.progress.reporting`.
    """
    store = RowStore(folder / ROWS_FILE, ROW_KEY, has_parts=True)
    tasks = tasks_of(instances, settings.runs, store)
    num_left = sum(len(task.runs) for task in tasks)
    try:
        with reporting("study", progress) as report, helpers(workers, [source]) as client:
            keep_rows(store, solve(tasks, source, settings, client), num_left, report)
    finally:
        store.save(row_columns(instances.columns))
    return read_table(store.file, "rows")


def _outcome(row: Mapping[str, Any]) -> str:
    status = row["status"]
    return "paths" if status in HAS_PATH else "crashed" if status == CRASHED else "none"
