"""A scenario carried out: files in, metric maps and run.json out, resumable."""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import dask.array

from jaxurban.build import block_layers_of, map_guesses, view_sky
from jaxurban.city import City
from jaxurban.cluster import work_in_threads, work_on_cluster
from jaxurban.demo import demo_city_for_bounds
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.guesses import Guesses, draws_guesses, warn_of
from jaxurban.io import store
from jaxurban.io.city import read_city
from jaxurban.io.damage import open_whole
from jaxurban.io.finished import broken_files, has_other_maps, prepare_folder, stored_key
from jaxurban.io.geotiff import stale_geotiffs, write_geotiffs
from jaxurban.io.rasterise import check_has_data, rasterise
from jaxurban.io.workfolder import WorkFolder
from jaxurban.layers import MapParams, empty_dataset, margin_of, with_series
from jaxurban.maps import MetricMaps
from jaxurban.memory import shape_of_tiles
from jaxurban.metrics.availability import EpochTotals
from jaxurban.metrics.gps import GpsParams
from jaxurban.record import hash_inputs, run_key, run_record, write_record
from jaxurban.resources import Resources, plan_run, plan_sentence
from jaxurban.scenario import NOMINAL, Scenario
from jaxurban.sky import Sky
from jaxurban.tiled import TileJob, unmark_damaged
from jaxurban.tiles import Tiling
from jaxurban.uncertainty import HeightStd


@dataclass
class Stopwatch:
    """Seconds by stage; a stage entered again adds to its time."""

    elapsed_s: dict[str, float] = field(default_factory=dict)
    on_stage: Callable[[str], None] | None = None

    def add(self, name: str, seconds: float) -> None:
        """Add to the time of a stage."""
        self.elapsed_s[name] = self.elapsed_s.get(name, 0.0) + seconds

    def tell(self, name: str) -> None:
        """Say what is being done."""
        if self.on_stage:
            self.on_stage(name)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under ``name``."""
        self.tell(name)
        began = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - began)


@dataclass(frozen=True)
class Run:
    """What a job made: the maps by resolution, and the record that run.json holds."""

    maps: dict[float, MetricMaps]
    record: dict[str, Any]


def load_city(scenario: Scenario) -> City:
    """Return the city that a scenario names.

    Raises:
      InputError: a source that cannot be used, or no building in the region.
    """
    region, people = scenario.region, scenario.population
    if scenario.is_synthetic:
        return demo_city_for_bounds(region.bounds, region.crs)

    def path(name: str | None) -> Path | None:
        return None if name is None else scenario.path_of(name)

    return read_city(
        scenario.path_of(scenario.buildings.source),
        bounds=region.bounds,
        crs=region.crs,
        blocks=path(people.blocks),
        table=path(people.table),
        districts=path(people.districts),
        terrain=path(scenario.terrain.source),
        block_field=people.block_field,
        district_field=people.district_field,
        commercial=people.commercial,
        default_height_m=scenario.buildings.default_height_m,
        level_height_m=scenario.buildings.level_height_m,
        mask_deg=scenario.gps.mask_deg,
        allow_none=scenario.buildings.allow_none,
        kind=scenario.buildings.kind,
    )


def grids_of(scenario: Scenario) -> list[Grid]:
    """Return the region's grid at each resolution of a scenario, all over the same snapped box."""
    region = scenario.region
    return [Grid.from_bounds(region.bounds, r, region.crs, region.resolution_m) for r in region.resolution_m]


def map_params(scenario: Scenario) -> MapParams:
    """Return the maps' parameters of a scenario."""
    gps = scenario.gps
    return MapParams(
        altitudes_m=scenario.region.altitudes_m,
        mask_deg=gps.mask_deg,
        gps=GpsParams(gps.gdop_threshold, gps.series, gps.availability_threshold),
        lidar=scenario.lidar.params(),
        risk=scenario.risk.params(),
        population=scenario.population.params(),
        times_of_day=scenario.population.time_of_day,
        all_touched=scenario.buildings.all_touched,
        oversample=scenario.region.oversample,
        gps_bounds=gps.bounds,
        height_std=HeightStd(**scenario.buildings.height_std_m.model_dump()),
        height_samples=scenario.buildings.height_samples,
        height_seed=scenario.buildings.height_seed,
    )


def run_scenario(
    scenario: Scenario,
    folder: Path,
    on_stage: Callable[[str], None] | None = None,
    overwrite: bool = False,
    resources: Resources | None = None,
    tell: Callable[[str], None] | None = None,
) -> Run:
    """Make the maps of a scenario under ``folder`` and return them with the record of the run.

    Finished resolutions, tiles and files of the same inputs are kept, once all of them have been read; what is
    damaged or missing is told and made anew, and nothing half-written is taken for finished.

    Args:
      scenario: the settings.
      folder: where the maps go.
      on_stage: told what is being done.
      overwrite: replace maps of other settings.
      resources: what the run may use; left out, half of the free memory and a thread a core.
      tell: told one sentence on size and memory before the work begins, and one for each damaged file.

    Raises:
      InputError: bad settings or sources, too little memory, or a folder that holds another job's maps.
    """
    started_utc = datetime.now(UTC).isoformat(timespec="seconds")
    watch, resources, params = Stopwatch(on_stage=on_stage), resources or Resources(), map_params(scenario)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        grids = grids_of(scenario)
        inputs = hash_inputs(scenario)
        key = run_key(scenario, inputs)
        if has_other_maps(folder, key) and not overwrite:
            raise InputError(
                f"{str(folder)!r} holds maps of other settings or inputs, or made by another version of jaxurban "
                "or its libraries: choose another folder, or pass --overwrite to replace them"
            )
        with watch.stage("read"):
            city = load_city(scenario)
        with watch.stage("orbits"):
            skies = [sky_of(scenario, grid) for grid in grids]
        guesses = map_guesses(city, grids[0], skies[0], params)
        warn_of(guesses, told=city.guesses)
        store.check_writable(folder)
        plan = plan_run(city, grids, skies, params, resources, folder)
        if tell:
            tell(plan_sentence(grids, plan))
        # Nothing of an older job is touched before this one can begin.
        with store.only_writer(folder), resources.client() as client:
            prepare_folder(folder, key, [grid.resolution_m for grid in grids])
            say = tell or _say_nothing
            made = [
                _maps_of(Maker(city, grid, sky, params, folder, key, plan.num_workers, client, say, guesses), watch)
                for grid, sky in zip(grids, skies, strict=True)
            ]
            record = run_record(
                scenario,
                city,
                grids,
                skies[-1],
                params.population,
                inputs,
                key,
                watch.elapsed_s,
                started_utc,
                [str(item.message) for item in caught],
            )
            is_kept = not any(is_new for _, is_new in made)
            record = write_record(folder / store.RUN_FILE, record, is_kept, say)
    rule = scenario.planning.obstacles
    return Run(
        {grid.resolution_m: maps.with_obstacles(rule) for grid, (maps, _) in zip(grids, made, strict=True)}, record
    )


def _say_nothing(sentence: str) -> None:
    pass


def sky_of(scenario: Scenario, grid: Grid) -> Sky:
    """Return the satellites of a scenario, as `view_sky` does."""
    gps = scenario.gps
    orbits = [name if name == NOMINAL else scenario.path_of(name) for name in gps.orbits]
    return view_sky(
        grid,
        orbits,
        gps.epochs,
        mask_deg=gps.mask_deg,
        reference=gps.reference,
        max_age_days=gps.max_age_days,
    )


@dataclass(frozen=True)
class Maker:
    """What the maps of one resolution are made from, where they go and who works on them."""

    city: City
    grid: Grid
    sky: Sky
    params: MapParams
    folder: Path
    key: str
    num_workers: int
    client: Any
    tell: Callable[[str], None] = _say_nothing
    guesses: Guesses = field(default_factory=dict)


def _maps_of(maker: Maker, watch: Stopwatch) -> tuple[MetricMaps, bool]:
    """Return the maps at one resolution, and whether they were made: those on disk are kept if whole and this job's."""
    folder, resolution_m = maker.folder, maker.grid.resolution_m
    with watch.stage("verify"):
        broken = broken_files(folder, resolution_m, maker.num_workers)
        is_kept = not broken and stored_key(folder, resolution_m) == maker.key
    if broken:
        others = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        again = f"making the maps at {store.short_number(resolution_m)} m again"
        maker.tell(f"{str(broken[0])!r}{others} is missing or damaged: {again}")
    if not is_kept:
        began = time.perf_counter()
        seconds = make_zarr(maker, watch.tell)
        # Tiles are worked on side by side: a stage gets its share of the time that passed.
        scale = (time.perf_counter() - began) / (sum(seconds.values()) or 1.0)
        for name, busy_s in seconds.items():
            watch.add(name, busy_s * scale)
    ds = store.open_zarr(folder, resolution_m)
    with watch.stage("verify"):
        stale = stale_geotiffs(ds, folder, maker.key, maker.num_workers)
        for path in stale if is_kept else ():
            maker.tell(f"{str(path)!r} is missing or damaged: writing it again")
    with watch.stage("write_geotiff"):
        write_geotiffs(ds, folder, maker.key, maker.num_workers, only=stale)
    return MetricMaps(ds), not is_kept


def make_zarr(maker: Maker, tell: Callable[[str], None], shape: tuple[int, int] | None = None) -> dict[str, float]:
    """Make the Zarr of one resolution tile by tile and return the seconds that all workers spent on each stage.

    Args:
      maker: what from and where to.
      tell: told how many tiles are done.
      shape: of the tiles; left out, `shape_of_tiles`.

    Raises:
      InputError: rasters without data in the region, or workers that are killed again and again.
    """
    city, grid, sky, params = maker.city, maker.grid, maker.sky, maker.params
    shape = shape or shape_of_tiles(grid.shape, params, len(sky.times))
    tiling = Tiling.over(grid, margin_of(city, grid, sky, params), shape)
    if city.roofs is not None or city.terrain is not None:
        check_has_data(rasterise(city, tiling.grid_of(tile)).has_data for tile in tiling.region_tiles)
    work = WorkFolder(store.work_path(maker.folder.resolve(), grid.resolution_m))
    damaged = work.begin(f"{maker.key} {shape}")
    people = block_layers_of(city, grid, params)
    job = TileJob(work, tiling, sky, params, people, city)
    for path in [*damaged, *unmark_damaged(job, maker.num_workers)]:
        maker.tell(f"{str(path)!r} of the unfinished maps is damaged: making it again")
    if not work.zarr.exists():
        known = people, city.terrain is not None, city.attribution
        empty = empty_dataset(grid, sky, params, *known, _no_values, has_guessed=draws_guesses(city, grid))
        store.create_zarr(empty.assign_attrs(run_key=maker.key, guesses=maker.guesses), work.zarr, shape)
    seconds: dict[str, float] = {}
    totals, num_done = EpochTotals.zero(len(sky.times), len(params.altitudes_m)), 0

    def take(found: dict[str, Any]) -> None:
        nonlocal totals, num_done
        for name, busy_s in found["seconds"].items():
            seconds[name] = seconds.get(name, 0.0) + busy_s
        if "num_free" in found:
            totals += EpochTotals.of(found)
            num_done += 1
            tell(f"{store.short_number(grid.resolution_m)} m, tile {num_done} of {len(tiling.region_tiles)}")

    if maker.client is None:
        work_in_threads(job, maker.num_workers, take)
    else:
        work_on_cluster(job, maker.client, take)
    if not params.gps.keeps_epochs(len(sky.times)):
        made = with_series(open_whole(work.zarr), totals)
        store.add_to_zarr(made[["gps_epoch_mean", "gps_worst_time"]], work.zarr)
    work.finish(store.zarr_path(maker.folder, grid.resolution_m))
    return seconds


def _no_values(shape: tuple[int, ...], dtype: Any) -> dask.array.Array:
    return dask.array.zeros(shape, dtype=dtype, chunks=-1)
