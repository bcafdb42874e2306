"""Who works on the tiles: threads of this process, processes of this machine, or a Dask cluster."""

import logging
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any

import dask.threaded
import numpy as np
from dask.callbacks import Callback
from dask.delayed import Delayed, delayed

from jaxurban.checks import check_extra
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
from jaxurban.progress import LOG

RETRIES = 3  # of a task whose worker was killed
WORKER = """
import signal
from jaxurban.programs import COMPILING

signal.signal(signal.SIGINT, signal.SIG_IGN)

def dask_setup(worker):
    COMPILING.disabled = worker.name != 0  # one says it for all
"""
Tell = Callable[[Any], None]


def tile_graph(job: TileJob, call: Callable[..., Any]) -> list[Delayed]:
    """Return the tasks of a job for Dask, each with the tasks that must be done before it.

    A tile's maps need the rasters around it and the shadows that its neighbours hand on; shadows run from
    tile to tile, away from the satellites of each quadrant. A device makes each tile alone.

    Args:
      job: the job.
      call: calls ``raster_tile``, ``sweep_tile`` or ``finish_tile`` with the job and further arguments.
    """
    tiling = job.tiling
    sweeps = dict[tuple[Tile, Quadrant], Delayed]()

    def task(function: Callable, *arguments: Any, after: list[Delayed]) -> Delayed:
        """Return the task that calls a function for a tile, and a quadrant if it has one, after others."""
        key = "-".join(map(str, (function.__name__, *arguments)))
        make = delayed(partial(_after, call, function, arguments), pure=False)
        return make(after, dask_key_name=key)

    def upstream(tile: Tile, quadrant: Quadrant) -> list[Delayed]:
        """Return the sweeps that hand shadows of a quadrant on to a tile."""
        near = [(neighbour, quadrant) for neighbour in tiling.upstream(tile, quadrant)]
        return [sweeps[key] for key in near if key in sweeps]

    if job.device_bytes is not None:
        return [task(finish_tile, tile, after=[]) for tile in tiling.region_tiles]
    rasters = {tile: task(raster_tile, tile, after=[]) for tile in tiling.tiles}

    # Shadows begin at the tiles nearest to the source, those with the largest dot product with its quadrant.
    for quadrant in QUADRANTS:
        from_source = sorted(tiling.tiles, key=partial(np.dot, quadrant), reverse=True)
        for tile in from_source:
            if job.hands_on(tile, quadrant):
                after = [rasters[tile], *upstream(tile, quadrant)]
                sweeps[tile, quadrant] = task(sweep_tile, tile, quadrant, after=after)

    finished = []
    for tile in tiling.region_tiles:
        after = [rasters[near] for near in tiling.touching(job.looked_at(tile))]
        for quadrant in QUADRANTS:
            after += upstream(tile, quadrant)
        finished.append(task(finish_tile, tile, after=after))
    return [*rasters.values(), *sweeps.values(), *finished]


def _after(call: Callable, function: Callable, arguments: tuple, before: list[Any]) -> Any:
    """Return what a task makes; Dask waits for the results of the tasks ``before`` it, which are not used."""
    return call(function, *arguments)


def _call_in_worker(job_name: str, function: Callable, *arguments: Any) -> Any:
    """Return what a function makes of the job that a cluster's worker holds under a name, and of further arguments."""
    from distributed import get_worker

    holder: Any = get_worker().plugins[job_name]
    return function(holder.job, *arguments)


def work_in_threads(job: TileJob, num_threads: int, on_result: Tell) -> None:
    """Do a job in threads of this process.

    If a task fails, the call raises its error once the tasks that are running have ended: none writes after the call.

    Args:
      job: the job.
      num_threads: how many tasks run at a time.
      on_result: is called with every task's result.
    """
    listener = Callback(posttask=lambda key, result, *_: on_result(result))
    with ThreadPoolExecutor(num_threads) as pool, listener:
        tasks = tile_graph(job, lambda function, *arguments: function(job, *arguments))
        dask.compute(*tasks, scheduler=dask.threaded.get, pool=pool)


def work_on_cluster(job: TileJob, client: Any, on_result: Tell) -> None:
    """Do a job on a Dask cluster whose workers see the work folder under the same path.

    The tasks of a worker that is killed start again on another one.

    Args:
      job: the job.
      client: of the cluster.
      on_result: is called with every task's result.

    Raises:
      InputError: workers are killed again and again on the same tile.
    """
    from distributed import KilledWorker, WorkerPlugin, as_completed

    class JobHolder(WorkerPlugin):
        """Holds the job; the scheduler gives it to every worker before its first task, also if that starts later."""

        def __init__(self, job: TileJob) -> None:
            """Hold a job."""
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
    """Give a plugin under a name to every worker of a client's cluster, also to workers that start later.

    A worker that is killed while it gets the plugin raises OSError, so it is tried again, `RETRIES` times.
    """
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
# A process that ended starts again, which takes longer than Dask waits on a busy machine: it would do without it.
KEEPS_LOST = {"distributed.deploy.lost-worker-timeout": "1 week"}


@contextmanager
def _running_client(address: str) -> Iterator[Any]:
    """Yield a client of the Dask scheduler that runs at an address, and close it after the block.

    Raises:
      InputError: no scheduler responds, or it is lost within the block.
    """
    from distributed import Client
    from distributed.comm import CommClosedError

    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"no Dask scheduler responds at --cluster {address!r}: {error}") from error
    with client:
        if not client.scheduler_info()["workers"]:
            LOG.warning(
                f"the cluster {address} has no worker yet: waiting for one (`dask worker {address}`)"
            )
        try:
            yield client
        except (CancelledError, CommClosedError) as error:
            raise InputError(
                f"the Dask scheduler at {address} was lost: start it again, or leave --cluster out, and run the "
                "same again; what is finished is kept"
            ) from error


@contextmanager
def cluster_client(workers: int | str) -> Iterator[Any]:
    """Yield a client of a Dask cluster, which is closed after the block; a cluster that is started here ends then too.

    Args:
      workers: the address of a scheduler, or the number of processes of a new cluster on this machine.

    Raises:
      InputError: ``distributed`` is not installed, no scheduler responds, the scheduler is lost within the block, or a
        process ends while it starts.
    """
    check_extra()
    import dask
    from distributed import Client, LocalCluster
    from distributed.security import Security

    security = Security.temporary()

    if isinstance(workers, str):
        with _running_client(workers) as client:
            yield client
        return

    # A new cluster, which the stack ends after the block.
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(KEEPS_LOST))
        try:
            with dask.config.set(NO_PAGES):
                started = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    memory_limit=0,
                    dashboard_address="127.0.0.1:0",  # any free port: two runs may work side by side
                    scheduler_kwargs={"dashboard": False},
                    # What ends a process is reported in our words: Ctrl-C, which reaches all of them, by this one.
                    silence_logs=logging.CRITICAL,
                    preload=WORKER,
                    # Without its certificates any user of this machine could run code as this one.
                    security=security,
                )
                cluster = stack.enter_context(started)
        except RuntimeError as error:
            raise InputError(
                f"a worker process ended while it started ({reason_of(error)}): a script must do its work under `if "
                "__name__ == '__main__':`; else memory ran out, most likely: run the same again, with fewer --workers "
                "if it happens again; what is finished is kept"
            ) from error
        yield stack.enter_context(Client(cluster))
