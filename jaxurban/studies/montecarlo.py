"""A Monte Carlo study: every planner on every instance under equal budgets, in parallel, resumable."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd
from tqdm import tqdm

from jaxurban.cluster import cluster_client
from jaxurban.errors import InputError
from jaxurban.io.rowstore import RowStore
from jaxurban.maps import MetricMaps, Obstacles, open_maps
from jaxurban.planners.base import Status
from jaxurban.studies.sampling import KEY
from jaxurban.studies.trial import COLUMNS, CRASHED, Ground, Run, Settings, put_to, row_of

ROW_KEY = (*KEY, "planner", "objective")
HAS_PATH = {status.value for status in Status if status.has_path}


@dataclass(frozen=True)
class Source:
    """Where workers find the maps.

    Attributes:
      folder: of the maps, as `open_maps` takes it.
      resolution_m: which of them.
      obstacles: where planners may fly (see `jaxurban.maps.MetricMaps`).
    """

    folder: Path
    resolution_m: float
    obstacles: Obstacles

    def open(self) -> MetricMaps:
        """Return the maps."""
        return open_maps(self.folder, self.resolution_m, obstacles=self.obstacles)


@dataclass(frozen=True)
class Task:
    """An instance, and the runs of it that are still to be done."""

    instance: Mapping[str, Any]
    runs: tuple[Run, ...]

    @property
    def ground_key(self) -> tuple[float, str | None, str | None]:
        """What maps it is asked on: altitude, time, time of day."""
        return self.instance["altitude_m"], self.instance["time"], self.instance["time_of_day"]


def tasks_of(instances: pd.DataFrame, runs: Sequence[Run], done: RowStore) -> list[Task]:
    """Return what is still to be done, instances on the same maps one after the other."""
    tasks = []
    for instance in instances.astype(object).where(instances.notna(), None).to_dict("records"):
        head = tuple(instance[name] for name in KEY)
        left = tuple(run for run in runs if (*head, run.planner, run.objective) not in done)
        if left:
            tasks.append(Task({str(name): value for name, value in instance.items()}, left))
    return sorted(tasks, key=lambda task: tuple(map(str, task.ground_key)))


def solve(
    tasks: Sequence[Task],
    source: Source | MetricMaps,
    settings: Settings,
    *,
    num_workers: int = 1,
    cluster: str | None = None,
) -> Iterator[tuple[Task, list[dict[str, Any]]]]:
    """Yield each task with its rows as it is done, in any order.

    Args:
      tasks: what to do.
      source: the maps; those in memory serve this process only.
      settings: budgets and the like.
      num_workers: processes of this machine (Dask); 1 works in this process.
      cluster: address of a Dask scheduler instead, whose workers see the maps' folder under the same path.

    Raises:
      InputError: maps in memory and several workers, or no cluster.
    """
    if num_workers == 1 and cluster is None:
        grounds = _Grounds(source, settings)
        for task in tasks:
            yield task, grounds.put(task)
        return
    if isinstance(source, MetricMaps):
        raise InputError("several workers need the maps in a folder: save them, and give the folder instead")
    with cluster_client(cluster, None if cluster else num_workers) as client:
        yield from solve_on(client, tasks, source, settings)


def solve_on(
    client: Any, tasks: Sequence[Task], source: Source, settings: Settings
) -> Iterator[tuple[Task, list[dict[str, Any]]]]:
    """Yield tasks that a Dask cluster has done. A run that kills its workers again and again costs its own row alone.

    Dask blames every task that a killed worker held. Those it gives up are asked once more at the end, run by run, each
    alone on the cluster, so that only the guilty one is a crash.
    """
    from distributed import KilledWorker, as_completed

    def submit(task: Task) -> Any:
        return client.submit(_put_in_worker, source, settings, task, pure=False)

    waiting = {submit(task): task for task in tasks}
    suspects: list[Task] = []
    for future in as_completed(list(waiting)):
        task = waiting.pop(future)
        try:
            rows = future.result()
        except KilledWorker:
            suspects += [replace(task, runs=(run,)) for run in task.runs]
            continue
        future.release()
        yield task, rows
    for task in suspects:
        try:
            rows = submit(task).result()
        except KilledWorker:
            head = {name: task.instance[name] for name in KEY}
            note = "Its worker process was killed again and again, most likely for lack of memory."
            rows = [row_of(head, task.runs[0], status=CRASHED, note=note)]
        yield task, rows


class _Grounds:
    """The maps of the last altitude and time, kept for the tasks to come."""

    def __init__(self, source: Source | MetricMaps, settings: Settings) -> None:
        self.settings = settings
        self.maps = source if isinstance(source, MetricMaps) else source.open()
        self._at = lru_cache(maxsize=1)(self._read)

    def _read(self, altitude_m: float, time: str | None, time_of_day: str | None) -> Ground:
        return Ground(self.maps, altitude_m, time, time_of_day, self.settings)

    def put(self, task: Task) -> list[dict[str, Any]]:
        """Return the rows of a task."""
        return put_to(self._at(*task.ground_key), task.instance, task.runs)


@lru_cache(maxsize=1)
def _grounds_in_worker(source: Source, settings: Settings) -> _Grounds:
    return _Grounds(source, settings)


def _put_in_worker(source: Source, settings: Settings, task: Task) -> list[dict[str, Any]]:
    return _grounds_in_worker(source, settings).put(task)


def run_study(
    instances: pd.DataFrame,
    runs: Sequence[Run],
    source: Source | MetricMaps,
    folder: Path,
    settings: Settings,
    *,
    num_workers: int = 1,
    cluster: str | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Return the rows of a study (see `COLUMNS`), in the order of their keys; those in ``folder`` are not asked again.

    Every row is on disk when it is counted. After any end, Ctrl-C and ``kill -9`` included, the same call goes on.

    Args:
      instances: from `sample_instances` or `read_instances`.
      runs: planners and objectives.
      source, settings, num_workers, cluster: see `solve`.
      folder: where the rows are kept.
      progress: show a bar with running totals on stderr, where that is a terminal.
    """
    store = RowStore(folder, ROW_KEY)
    tasks = tasks_of(instances, runs, store)
    counts = Counter(_outcome(row) for row in store.rows)
    left = sum(len(task.runs) for task in tasks)
    try:
        with tqdm(
            total=len(store) + left,
            initial=len(store),
            unit="run",
            desc="study",
            file=sys.stderr,
            disable=None if progress else True,
        ) as bar:
            for task, rows in solve(tasks, source, settings, num_workers=num_workers, cluster=cluster):
                store.add(rows)
                counts.update(map(_outcome, rows))
                bar.set_postfix(counts, refresh=False)
                bar.update(len(task.runs))
    finally:
        table = store.compact(COLUMNS)
    return table


def _outcome(row: Mapping[str, Any]) -> str:
    status = row["status"]
    return "paths" if status in HAS_PATH else "crashed" if status == CRASHED else "none"
