"""The runs of a Monte Carlo benchmark: every planner on every instance under equal budgets, in parallel, resumable."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from jaxurban.errors import InputError, typed
from jaxurban.io.rows import ROWS_FILE, RowStore
from jaxurban.io.tables import read_table, records_of
from jaxurban.maps.executors import cluster_client
from jaxurban.maps.metric_maps import MetricMaps, Obstacles, open_maps
from jaxurban.progress import Progress, reporting
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.montecarlo.trial import (
    CRASHED,
    HAS_PATH,
    BenchmarkSettings,
    PlannerRun,
    row_columns,
    row_of,
    solve_instance,
)

ROW_KEY = (*KEY, "planner", "objective")


@typed
@dataclass(frozen=True)
class MapsFolder:
    """Maps in a folder, which several workers can read.

    Attributes:
      folder: of the maps, as `open_maps` takes it.
      resolution_m: which of them, where it holds several.
      obstacles: where planners may fly (see `jaxurban.maps.metric_maps.MetricMaps`).
    """

    folder: str | Path
    resolution_m: float | None = None
    obstacles: Obstacles = "touched"

    def open(self) -> MetricMaps:
        """Return the maps."""
        return open_maps(self.folder, self.resolution_m, obstacles=self.obstacles)


class InstanceRuns(NamedTuple):
    """An instance, and the runs of it that are still to be done."""

    instance: Mapping[str, Any]
    runs: tuple[PlannerRun, ...]

    @property
    def map_key(self) -> tuple[float, str | None, str | None]:
        """The maps that it lies on: altitude, time, time of day."""
        return self.instance["altitude_m"], self.instance["time"], self.instance["time_of_day"]


def tasks_of(instances: pd.DataFrame, runs: Sequence[PlannerRun], done: RowStore) -> list[InstanceRuns]:
    """Return what is still to be done, instances on the same maps one after the other."""
    tasks = []
    for instance in records_of(instances):
        head = tuple(instance[name] for name in KEY)
        left = tuple(run for run in runs if (*head, run.planner, run.objective) not in done)
        if left:
            tasks.append(InstanceRuns(instance, left))
    return sorted(tasks, key=lambda task: tuple(map(str, task.map_key)))


def solve(
    tasks: Sequence[InstanceRuns], source: MapsFolder | MetricMaps, settings: BenchmarkSettings, workers: int | str = 1
) -> Iterator[tuple[InstanceRuns, list[dict[str, Any]]]]:
    """Yield each task with its rows as it is done, in any order.

    Args:
      tasks: what to do.
      source: the maps; those in memory serve this process only.
      settings: budgets and the like.
      workers: processes of this machine (Dask), 1 works in this process; or the address of a Dask scheduler, whose
        workers see the maps' folder under the same path.

    Raises:
      InputError: maps in memory and several workers, or no cluster.
    """
    if workers == 1:
        solver = _Solver(source, settings)
        for task in tasks:
            yield task, solver.solve(task)
        return
    if isinstance(source, MetricMaps):
        raise InputError("several workers need the maps in a folder: save them, and give the folder instead")
    address = workers if isinstance(workers, str) else None
    with cluster_client(address, None if isinstance(workers, str) else workers) as client:
        yield from solve_on(client, tasks, source, settings)


def solve_on(
    client: Any, tasks: Sequence[InstanceRuns], source: MapsFolder, settings: BenchmarkSettings
) -> Iterator[tuple[InstanceRuns, list[dict[str, Any]]]]:
    """Yield tasks that a Dask cluster has done. A run that kills its workers again and again costs its own row alone.

    Dask blames every task that a killed worker held. Those it gives up are run once more at the end, run by run, each
    alone on the cluster, so that only the guilty one is a crash.
    """
    from distributed import KilledWorker, as_completed

    def submit(task: InstanceRuns) -> Any:
        return client.submit(_solve_in_worker, source, settings, task, pure=False)

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
        yield task, rows
    for task in suspects:
        try:
            rows = submit(task).result()
        except KilledWorker:
            note = "Its worker process was killed again and again, most likely for lack of memory."
            rows = [row_of(task.instance, task.runs[0], status=CRASHED, note=note)]
        yield task, rows


class _Solver:
    """The cost map of the last altitude and time, kept for the tasks to come."""

    def __init__(self, source: MapsFolder | MetricMaps, settings: BenchmarkSettings) -> None:
        maps = source if isinstance(source, MetricMaps) else source.open()
        self.settings = settings
        self._map_of = lru_cache(maxsize=1)(partial(settings.cost_map, maps))

    def solve(self, task: InstanceRuns) -> list[dict[str, Any]]:
        """Return the rows of a task."""
        return solve_instance(self._map_of(*task.map_key), task.instance, task.runs, self.settings)


_solver_in_worker = lru_cache(maxsize=1)(_Solver)


def _solve_in_worker(source: MapsFolder, settings: BenchmarkSettings, task: InstanceRuns) -> list[dict[str, Any]]:
    return _solver_in_worker(source, settings).solve(task)


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
      source, settings, workers: see `solve`.
      folder: where the rows are kept.
      progress: as in `jaxurban.progress.reporting`.
    """
    store = RowStore(folder / ROWS_FILE, ROW_KEY, has_parts=True)
    tasks = tasks_of(instances, settings.runs, store)
    counts = Counter(_outcome(row) for row in store.rows)
    total = len(store) + sum(len(task.runs) for task in tasks)
    try:
        with reporting("study", progress) as report:
            report("runs", len(store), total, **counts)
            for _, rows in solve(tasks, source, settings, workers):
                store.add(rows)
                counts.update(map(_outcome, rows))
                report("runs", len(store), total, **counts)
    finally:
        store.save(row_columns(instances.columns))
    return read_table(store.file, "rows")


def _outcome(row: Mapping[str, Any]) -> str:
    status = row["status"]
    return "paths" if status in HAS_PATH else "crashed" if status == CRASHED else "none"
