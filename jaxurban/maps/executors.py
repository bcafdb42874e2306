"""Who works on the tiles: threads of this process, processes of this machine, or a Dask cluster."""

import logging
import os
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any

import dask.threaded
from dask.callbacks import Callback
from dask.delayed import Delayed, delayed

from jaxurban.errors import InputError, reason_of
from jaxurban.maps.tiled import (
    QUADRANTS,
    Quadrant,
    Tile,
    TileJob,
    finish_tile,
    raster_tile,
    sweep_tile,
)
from jaxurban.programs import keeps_programs
from jaxurban.progress import LOG

RETRIES = 3  # of a task whose worker was killed
WORKER = """
import signal
from jaxurban.programs import COMPILING, keep_programs

signal.signal(signal.SIGINT, signal.SIG_IGN)

def dask_setup(worker):
    COMPILING.disabled = worker.name != 0  # one says it for all
"""
KEEPING_WORKER = f"{WORKER}    keep_programs()\n"
Tell = Callable[[Any], None]


def num_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def tile_graph(job: TileJob, call: Callable[..., Any]) -> list[Delayed]:
    """Return the tasks of a job, each with those it stands on.

    A tile's maps need the rasters around it and the shadows that its neighbours hand on; shadows run from
    tile to tile, away from the satellites of each quadrant.

    Args:
      job: the job.
      call: calls ``raster_tile``, ``sweep_tile`` or ``finish_tile`` with the job and further arguments.
    """
    tiling = job.tiling
    sweeps = dict[tuple[Tile, Quadrant], Delayed]()

    def task(function: Callable, name: str, *arguments: Any, after: list[Delayed]) -> Delayed:
        key = f"{function.__name__}-{name}"
        return delayed(partial(_after, call, function, arguments), pure=False)(
            after, dask_key_name=key
        )

    def upstream(tile: Tile, quadrant: Quadrant) -> list[Delayed]:
        return [
            sweeps[near, quadrant]
            for near in tiling.upstream(tile, quadrant)
            if (near, quadrant) in sweeps
        ]

    rasters = {tile: task(raster_tile, f"{tile}", tile, after=[]) for tile in tiling.tiles}
    for quadrant in QUADRANTS:
        for tile in sorted(
            tiling.tiles, key=lambda tile: -tile[0] * quadrant[0] - tile[1] * quadrant[1]
        ):
            if job.hands_on(tile, quadrant):
                after = [rasters[tile], *upstream(tile, quadrant)]
                sweeps[tile, quadrant] = task(
                    sweep_tile, f"{tile}-{quadrant}", tile, quadrant, after=after
                )
    finished = []
    for tile in tiling.region_tiles:
        around = [rasters[near] for near in tiling.touching(job.looked_at(tile))]
        shadows = [each for quadrant in QUADRANTS for each in upstream(tile, quadrant)]
        finished.append(task(finish_tile, f"{tile}", tile, after=[*around, *shadows]))
    return [*rasters.values(), *sweeps.values(), *finished]


def _after(call: Callable, function: Callable, arguments: tuple, before: list[Any]) -> Any:
    """Return what a task makes; the results of those ``before`` it are awaited, not used."""
    return call(function, *arguments)


def _call_in_worker(job_name: str, function: Callable, *arguments: Any) -> Any:
    from distributed import get_worker

    holder: Any = get_worker().plugins[job_name]
    return function(holder.job, *arguments)


def work_in_threads(job: TileJob, num_threads: int, on_result: Tell) -> None:
    """Do a job in threads of this process; ``on_result`` gets every task's result.

    Where a task fails, those that run are waited for: none writes after the call.
    """
    listener = Callback(posttask=lambda key, result, *_: on_result(result))
    with ThreadPoolExecutor(num_threads) as pool, listener:
        tasks = tile_graph(job, lambda function, *arguments: function(job, *arguments))
        dask.compute(*tasks, scheduler=dask.threaded.get, pool=pool)


def work_on_cluster(job: TileJob, client: Any, on_result: Tell) -> None:
    """Do a job on a Dask cluster whose workers see the work folder under the same path.

    Dask starts what a killed worker held again on another one.

    Raises:
      InputError: workers are killed again and again on the same tile.
    """
    from distributed import KilledWorker, WorkerPlugin, as_completed

    class JobHolder(WorkerPlugin):
        """What the scheduler gives every worker before its first task, those that take a killed one's place too."""

        def __init__(self, job: TileJob) -> None:
            self.job = job

    name = f"jaxurban-job-{uuid.uuid4().hex}"
    _register(client, JobHolder(job), name)
    futures = client.compute(tile_graph(job, partial(_call_in_worker, name)), retries=RETRIES)
    try:
        for future in as_completed(futures):
            on_result(future.result())
            future.release()
    except KilledWorker as error:
        raise InputError(
            "worker processes were killed again and again on the same tile, most likely for lack of memory: use fewer "
            "--workers or a larger machine; finished tiles are kept"
        ) from error
    finally:
        with suppress(OSError):  # a worker died while it got it: nothing of the job is left in it
            client.unregister_worker_plugin(name)


def _register(client: Any, plugin: Any, name: str) -> None:
    """Give every worker a plugin, those too that take the place of one which is killed meanwhile."""
    for _ in range(RETRIES):
        with suppress(OSError):  # a worker was killed while it got it
            client.register_plugin(plugin, name)
            return
    client.register_plugin(plugin, name)


# Pages on the run that any user of this machine could open: none.
NO_PAGES: dict[str, list[str]] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


@contextmanager
def cluster_client(workers: int | str) -> Iterator[Any]:
    """Yield a client of a Dask cluster.

    Args:
      workers: the address of its scheduler, or the number of processes of a new cluster of this machine's own.

    Raises:
      InputError: ``distributed`` is not installed, no scheduler responds, it is lost in the block, or a process ends
        while it starts.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.comm import CommClosedError
        from distributed.security import Security

        security = Security.temporary()  # needs cryptography
    except ImportError as error:
        raise InputError(
            "--cluster and --workers need Dask's distributed scheduler and cryptography, which are not installed: "
            "pip install 'jaxurban[cluster]', or leave them out to work in threads"
        ) from error
    if isinstance(workers, str):
        try:
            client = Client(workers, timeout=10)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"no Dask scheduler responds at --cluster {workers!r}: {error}"
            ) from error
        with client:
            if not client.scheduler_info()["workers"]:
                LOG.warning(
                    f"the cluster {workers} has no worker yet: waiting for one (`dask worker {workers}`)"
                )
            try:
                yield client
            except (CancelledError, CommClosedError) as error:
                raise InputError(
                    f"the Dask scheduler at {workers} was lost: start it again, or leave --cluster out, and run the "
                    "same again; what is finished is kept"
                ) from error
        return
    options = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "memory_limit": 0,
        "dashboard_address": "127.0.0.1:0",  # any free port: two runs may work side by side
        "scheduler_kwargs": {"dashboard": False},
        # What ends a process is reported in our words: Ctrl-C, which reaches all of them, by this one.
        "silence_logs": logging.CRITICAL,
        "preload": KEEPING_WORKER if keeps_programs() else WORKER,
        # Without its certificates any user of this machine could run code as this one.
        "security": security,
    }
    with ExitStack() as stack:
        try:
            with dask.config.set(NO_PAGES):
                cluster = stack.enter_context(LocalCluster(**options))
        except RuntimeError as error:
            raise InputError(
                f"a worker process ended while it started ({reason_of(error)}): a script must do its work under `if "
                "__name__ == '__main__':`; else memory ran out, most likely: run the same again, with fewer --workers "
                "if it happens again; what is finished is kept"
            ) from error
        yield stack.enter_context(Client(cluster))
