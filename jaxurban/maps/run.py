"""A scenario carried out: files in, metric maps and run.json out, resumable."""

import os
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jaxurban import wings
from jaxurban.checks import values_given
from jaxurban.errors import InputError, speaking
from jaxurban.io import store, stored
from jaxurban.io.city import City
from jaxurban.io.files import RECORDER, sweep_scraps
from jaxurban.io.folders import WorkFolder
from jaxurban.io.geotiff import RUN_KEY, geotiff_paths, write_geotiffs
from jaxurban.io.rasterise import bands_of, check_has_data, rasterise
from jaxurban.io.samples import BASE_MAP_FILE
from jaxurban.io.store import stored_key
from jaxurban.io.stored import ZARR
from jaxurban.io.workspace import Workspace
from jaxurban.kernels.engine import num_cores
from jaxurban.knowledge import guesses_to, warn_of
from jaxurban.maps.at_once import free_device_bytes
from jaxurban.maps.build import view_sky
from jaxurban.maps.executors import cluster_client, work_in_threads, work_on_cluster
from jaxurban.maps.memory import plan_run, shape_of_tiles
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.provenance import (
    Inputs,
    begun,
    other_maps,
    run_record,
    write_record,
)
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask, empty_dataset
from jaxurban.maps.tiled import TileJob, Tiling
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import FILES
from jaxurban.progress import LOG, Progress, Report, Stage, Stopwatch, reporting
from jaxurban.settings import NOMINAL, as_tuple
from jaxurban.world.grid import Grid


@dataclass(frozen=True)
class ScenarioRun:
    """What a run made: the maps by resolution in metres, and the record that run.json holds."""

    maps: dict[float, MetricMaps]
    record: dict[str, Any]


@speaking("scenario")
def load_city(scenario: Scenario) -> City:
    """Return the city that a scenario names, read from its files; the synthetic city has none.

    Raises:
      InputError: a source that cannot be used, or no building in the region.
    """
    region = scenario.region
    if scenario.is_synthetic:
        return wings.demo_city_for_bounds(region.bounds, region.crs)

    def placed(section: Any, *names: str) -> Any:
        """Return a section of settings in which the named settings, all files, are paths from the current folder."""
        files = values_given({name: getattr(section, name) for name in names})
        paths = {name: scenario.path_of(file) for name, file in files.items()}
        return replace(section, **paths)

    return City.from_files(
        placed(scenario.buildings, "source"),
        bounds=region.bounds,
        crs=region.crs,
        population=placed(scenario.population, *FILES),
        terrain=placed(scenario.terrain, "source"),
        gps=gps_of(scenario),
        vegetation=placed(scenario.vegetation, "source"),
        kinds=scenario.kinds,
    )


def gps_of(scenario: Scenario) -> Gps:
    """Return the ``[gps]`` settings of a scenario, with paths of orbit files that hold from the current folder."""
    names = as_tuple(scenario.gps.orbits)
    orbits = [name if name == NOMINAL else scenario.path_of(name) for name in names]
    return replace(scenario.gps, orbits=orbits)


def scenario_grid(scenario: Scenario, resolution_m: float | None = None) -> Grid:
    """Return the grid of a scenario's maps at one of their resolutions; None: the first.

    The grids of all resolutions cover the same box, as their bounds are snapped outward to cells of the coarsest one.
    """
    region = scenario.region
    resolution_m = resolution_m or region.resolution_m[0]
    return Grid.from_bounds(region.bounds, resolution_m, region.crs, region.resolution_m)


@speaking("scenario")
def tasks_of(scenario: Scenario, stage: Stage = nullcontext) -> list[MapTask]:
    """Return a task for each resolution of a scenario: all that its maps are made of.

    Args:
      scenario: the settings.
      stage: returns the context in which a stage runs, by its name; the city and the orbits are read in one each.

    Raises:
      InputError: sources that cannot be used, or no building in the region.
    """
    params = scenario.map_params
    with stage("read"):
        city = load_city(scenario)
    gps = gps_of(scenario)
    tasks = []
    with stage("orbits"):
        for resolution_m in scenario.region.resolution_m:
            grid = scenario_grid(scenario, resolution_m)
            bands = bands_of(scenario.layers, grid, params.altitudes_m, scenario.path_of(""))
            sky = view_sky(grid, gps)
            tasks.append(MapTask(city, grid, sky, params, scenario.layers, bands))
    return tasks


@speaking("scenario")
def run_scenario(
    scenario: Scenario,
    folder: Path,
    progress: Progress = True,
    overwrite: bool = False,
    memory_bytes: int | None = None,
    workers: int | str | None = None,
    layers: Sequence[str] = (),
) -> ScenarioRun:
    """Make the maps of a scenario under ``folder`` and return them with the record of the run.

    Finished resolutions, tiles and files of the same inputs are kept, once all of them have been read; what is
    damaged or missing is named in the log and made again, and nothing half-written is taken for finished. Before the
    work begins, one sentence in the log says how large the region is and how much memory it takes.

    Args:
      scenario: the settings.
      folder: where the maps go.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      overwrite: replace maps of other settings.
      memory_bytes: ceiling on the memory of all processes together; left out, half of what is free.
      workers: processes of a new local Dask cluster, or the address of a Dask scheduler whose workers see the output
        folder under the same path; left out, a thread per core of this process.
      layers: variables that are GeoTIFFs too (see `jaxurban.io.geotiff.write_geotiffs`).

    Raises:
      InputError: bad settings or sources, too little memory or disk, a layer that the maps would not hold, or a folder
        that holds another job's maps.
    """
    from jaxurban.maps.saving import save_base_map  # imported here: it brings GeoPandas

    started_utc = datetime.now(UTC).isoformat(timespec="seconds")
    with reporting("maps", progress) as report, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        watch = Stopwatch(on_stage=report)

        # What the maps depend on, and whether the folder is free for them.
        inputs, key = begun(scenario)
        if not overwrite:
            _check_holds_no_others(folder, scenario, inputs, key)

        # The city and the sky, and what the maps guess of them.
        tasks = tasks_of(scenario, watch.stage)
        city = tasks[0].city
        base = wings.base_map_source(city.sources.get("buildings"))
        base_file = folder / BASE_MAP_FILE
        planned = _files_of(tasks, folder, layers)
        if base is not None:
            planned.append(base_file)

        guesses = tasks[0].all_guesses
        warn_of(guesses, known=city.guesses)

        # Whether the folder can be written to, and memory suffices. Only then is an older job's file touched.
        Workspace.check(folder, "maps", is_shared=True)
        num_threads = num_cores()
        if not isinstance(workers, str):  # the memory of a cluster's machines is not known here
            num_threads = plan_run(
                tasks, memory_bytes, num_workers=workers or num_threads, num_processes=workers or 0
            )

        # The output folder is opened for this run; then the maps are made, one resolution after the other.
        opened = Workspace.open(
            folder,
            "maps",
            {RUN_KEY: key},
            names=[path.relative_to(folder).as_posix() for path in planned],
            overwrite=overwrite,
            is_shared=True,
            is_mended=True,
        )
        cluster = nullcontext() if workers is None else cluster_client(workers)
        with opened as workspace, cluster as client:
            _sweep(folder, key, scenario.region.resolution_m)
            tasks = [replace(task, guesses=guesses) for task in tasks]
            runs = [
                RunContext(task, folder, key, num_threads, client, tuple(layers)) for task in tasks
            ]
            with _waiting(folder, key, scenario.region.resolution_m):
                made = [_complete_maps(run, workspace, watch, report) for run in runs]
            all_maps, are_kept = zip(*made, strict=True)
            store.put_root(folder)  # an earlier run may have ended before it wrote the root

            # The base map and the record. Where all maps were kept they stay, but for a base map that is damaged.
            is_kept = all(are_kept)
            with watch.stage("base map"):
                if base is None or not is_kept or workspace.broken([base_file]):
                    save_base_map(replace(all_maps[0], base=base).base_map, workspace)
            messages = [str(item.message) for item in caught]
            record = run_record(
                scenario, tasks, inputs, key, watch.elapsed_s, started_utc, messages
            )
            record = write_record(folder / stored.RUN_FILE, record, is_kept)

    # The maps, with the base map's file and the settings of the record.
    kept_base = base_file.resolve() if base_file.is_file() else None
    by_resolution = {}
    for maps in all_maps:
        recorded = replace(maps, base=kept_base).with_recorded(record["settings"])
        by_resolution[maps.grid.resolution_m] = recorded
    return ScenarioRun(by_resolution, record)


def _check_holds_no_others(folder: Path, scenario: Scenario, inputs: Inputs, key: str) -> None:
    """Raise InputError if a folder holds maps of another run than the one that a key identifies (`run_key`).

    Args:
      folder: where maps would go.
      scenario, inputs: what the maps would be made of; the message says how the folder's maps differ from that.
      key: identifies the run that would make the maps.
    """
    stored_by = Workspace.settings_of(folder, "maps").get(RUN_KEY)
    if stored.stored_resolutions(folder) and stored_by != key:
        raise InputError(
            f"{str(folder)!r} holds {other_maps(folder, scenario, inputs)}: make these in another folder (-o), or pass "
            "--overwrite to replace them"
        )


def _files_of(tasks: Sequence[MapTask], folder: Path, layers: Sequence[str]) -> list[Path]:
    """Return the paths of the files that the maps of tasks will have under a folder.

    Args:
      tasks: one for each resolution.
      folder: the output folder.
      layers: variables that are GeoTIFFs too.

    Raises:
      InputError: a layer that the maps would not hold.
    """
    files = [folder / stored.RUN_FILE, *stored.root_files(folder)]
    for task in tasks:
        zarr = stored.zarr_path(folder, task.region.resolution_m)
        files += [zarr / name for name in stored.OF_ZARR]
        files += geotiff_paths(empty_dataset(task, _no_values), folder, layers)
    return files


@dataclass(frozen=True)
class RunContext:
    """The maps of one resolution: what they are made of, where they go, and who works on them.

    Attributes:
      task: what the maps are made of.
      folder: the output folder.
      key: identifies the run by all that its maps depend on (`run_key`).
      num_workers: how many threads of this process work at a time.
      client: client of the Dask cluster that works on the tiles; None if the threads of this process do.
      layers: variables that are GeoTIFFs too, besides obstacles and the metrics of the cost.
    """

    task: MapTask
    folder: Path
    key: str
    num_workers: int
    client: Any = None
    layers: tuple[str, ...] = ()

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Return the result of a function for each item, in order, computed in threads of this process.

        It is for work on files of the output folder, so the threads do it even if a cluster works on the tiles. The
        files that they write are recorded together with those of the calling thread.
        """
        with ThreadPoolExecutor(
            self.num_workers, initializer=RECORDER.set, initargs=(RECORDER.get(),)
        ) as pool:
            return list(pool.map(function, items))


def _sweep(folder: Path, key: str, resolutions_m: Sequence[float]) -> None:
    """Remove what killed runs left under a folder, except for the unfinished tiles with which this run goes on.

    Args:
      folder: the output folder.
      key: identifies this run (`run_key`).
      resolutions_m: the resolutions that this run makes. The tiles of a resolution that is finished are removed too.
    """
    left_over = {*stored.work_paths(folder)}
    for resolution_m in resolutions_m:
        if stored_key(folder, resolution_m) != key:
            left_over.discard(stored.work_path(folder, resolution_m))
    for path in left_over:
        WorkFolder(path).discard()
    sweep_scraps(folder, folder / stored.ZARR_FOLDER, folder / stored.GEOTIFF_FOLDER)


@contextmanager
def _waiting(folder: Path, key: str, resolutions_m: Sequence[float]) -> Iterator[None]:
    """Hold an empty work folder of each resolution that is not begun, from which others know that it will be made.

    Where the block refuses the maps, empty folders are removed.

    Args:
      folder, key, resolutions_m: as of `_sweep`.
    """
    works = [
        stored.work_path(folder, resolution_m)
        for resolution_m in resolutions_m
        if stored_key(folder, resolution_m) != key
    ]
    for work in works:
        if not os.path.lexists(work):
            work.mkdir(parents=True)
    try:
        yield
    except InputError:
        for path in (*works, folder / stored.ZARR_FOLDER):
            with suppress(OSError):  # it holds what was made
                path.rmdir()
        raise


def _complete_maps(
    run: RunContext, workspace: Workspace, watch: Stopwatch, report: Report
) -> tuple[MetricMaps, bool]:
    """Make what is missing or damaged of the maps at one resolution; return the maps, and whether their Zarr was kept.

    A Zarr on the disk is kept if it is whole and of the same run. A warning names what is missing or damaged.

    Args:
      run: what the maps are made of and where they go.
      workspace: the open output folder, with the checksums of its files.
      watch: gets the seconds of each stage.
      report: gets how many tiles are done.
    """
    folder = run.folder
    resolution_m = run.task.region.resolution_m
    zarr = stored.zarr_path(folder, resolution_m)
    with watch.stage("verify"):
        files = [folder / name for name in workspace.written if zarr in (folder / name).parents]
        broken = workspace.broken(files, run.map) if zarr.is_dir() else []
        is_kept = not broken and stored_key(folder, resolution_m) == run.key
    if broken:
        others = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        again = f"making the maps at {stored.short_number(resolution_m)} m again"
        LOG.warning(f"{str(broken[0])!r}{others} is missing or damaged: {again}")
    if not is_kept:
        began = time.perf_counter()
        seconds = make_zarr(run, report)
        # Tiles are worked on side by side: a stage gets its share of the time that passed.
        scale = (time.perf_counter() - began) / (sum(seconds.values()) or 1.0)
        for name, busy_s in seconds.items():
            watch.add(name, busy_s * scale)
    maps = MetricMaps(store.open_zarr(folder.resolve(), resolution_m))
    _renew_geotiffs(maps, run, workspace, watch, has_old_zarr=is_kept)
    return maps, is_kept


def _renew_geotiffs(
    maps: MetricMaps, run: RunContext, workspace: Workspace, watch: Stopwatch, *, has_old_zarr: bool
) -> None:
    """Write the GeoTIFFs and styles of maps that are missing or damaged, one by one.

    Styles are there to be edited, so that one that was changed stays, and a warning says so.

    Args:
      maps: whose values are written.
      run, workspace, watch: as of `_complete_maps`.
      has_old_zarr: the maps were kept, so that each missing file is named in the log. Under new maps all are missing.
    """
    with watch.stage("verify"):
        stale = []
        for path in workspace.broken(geotiff_paths(maps.ds, run.folder, run.layers), run.map):
            is_changed = workspace.is_changed(path)
            if is_changed and path.suffix == ".qml":
                LOG.warning(
                    f"{str(path)!r} was changed and stays: remove it, and the same command writes it again"
                )
                continue
            stale.append(path)
            if has_old_zarr and not is_changed:  # a changed file is reported when it is set aside
                LOG.warning(f"{str(path)!r} is missing: writing it again")
    with watch.stage("write_geotiff"):
        write_geotiffs(maps.ds, run.folder, run.map, only=stale, layers=run.layers)
        # Files that workers had begun to write before they were killed; other workers have written them since.
        sweep_scraps(run.folder / stored.GEOTIFF_FOLDER)


def make_zarr(
    run: RunContext, report: Report, shape: tuple[int, int] | None = None
) -> dict[str, float]:
    """Make the Zarr of one resolution tile by tile and return the seconds that all workers spent on each stage.

    Args:
      run: what the maps are made of and where they go.
      report: gets how many tiles are done.
      shape: how many rows and columns of cells a tile has; left out, as of `shape_of_tiles`.

    Raises:
      InputError: rasters without data in the region, or workers that are killed again and again.
    """
    task = run.task
    grid = task.region
    shape = shape or shape_of_tiles(task)
    tiling = Tiling.over(grid, task.with_margin(), shape)
    if task.city.roofs is not None or task.has_terrain:
        data = (rasterise(task.city, tiling.grid_of(tile)).has_data for tile in tiling.region_tiles)
        check_has_data(data, task.city)

    # The Zarr begins empty, in a work folder that keeps finished tiles for the next run of the same key.
    work = WorkFolder(stored.work_path(run.folder.resolve(), grid.resolution_m))
    for path in work.begin(f"{run.key} {shape}", run.map):
        LOG.warning(f"{str(path)!r} of the unfinished maps is damaged: making it again")
    job = TileJob(task, work, tiling, free_device_bytes(task))
    attrs = {RUN_KEY: run.key, "guesses": guesses_to(task.guesses)}
    if not work.is_done(ZARR):
        empty = empty_dataset(task, _no_values).assign_attrs(attrs)
        store.create_zarr(empty, work.zarr, shape)
        work.mark_zarr(len(tiling.region_tiles))

    # The tiles.
    seconds: defaultdict[str, float] = defaultdict(float)
    num_done = 0
    stage = f"tiles of {stored.short_number(grid.resolution_m)} m"
    num_kept, num_tiles = stored.num_tiles_in(work.path)
    if num_kept:
        LOG.info(f"resumed, {num_kept} of {num_tiles} {stage}")
    report(stage, num_done, len(tiling.region_tiles))

    def take(result: dict[str, Any]) -> None:
        """Add what a task on a tile returns to ``seconds`` and, of a finished tile, to the count."""
        nonlocal num_done
        for name, busy_s in result["seconds"].items():
            seconds[name] += busy_s
        if "finished" in result:
            num_done += 1
            report(stage, num_done, len(tiling.region_tiles))

    if run.client is None:
        work_in_threads(job, run.num_workers, take)
    else:
        work_on_cluster(job, run.client, take)

    work.finish(stored.zarr_path(run.folder, grid.resolution_m))
    return seconds


def _no_values(shape: tuple[int, ...], dtype: Any) -> Any:
    """Return an array of a shape and a type that takes no memory: it is never computed."""
    import dask.array

    return dask.array.zeros(shape, dtype=dtype, chunks=-1)
