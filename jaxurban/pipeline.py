"""A scenario carried out: files in, metric maps and run.json out, resumable."""

import hashlib
import importlib.metadata
import json
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import shapely
import xarray as xr

from jaxurban.build import compute_maps, make_surface, view_sky
from jaxurban.city import City
from jaxurban.demo import demo_city_for_bounds
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io import store
from jaxurban.io.city import read_city
from jaxurban.io.rasterise import highest_top_m
from jaxurban.maps import MetricMaps
from jaxurban.metrics.gps import GpsParams
from jaxurban.metrics.lidar import LidarParams
from jaxurban.metrics.population import PopulationParams, population_totals
from jaxurban.metrics.risk import RiskParams
from jaxurban.scenario import NOMINAL, Scenario
from jaxurban.sky import Sky
from jaxurban.uncertainty import HeightStd

RUN_FILE = "run.json"
REPORTED_VERSIONS = (
    "jaxurban",
    "jax",
    "numpy",
    "osmium",
    "pyproj",
    "rasterio",
    "shapely",
    "skyfield",
    "xarray",
    "zarr",
)


@dataclass
class Stopwatch:
    """Seconds by stage; a stage entered again adds to its time."""

    elapsed_s: dict[str, float] = field(default_factory=dict)
    on_stage: Callable[[str], None] | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under ``name``."""
        if self.on_stage:
            self.on_stage(name)
        began = time.perf_counter()
        try:
            yield
        finally:
            self.elapsed_s[name] = self.elapsed_s.get(name, 0.0) + time.perf_counter() - began


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
    )


def grids_of(scenario: Scenario) -> list[Grid]:
    """Return the region's grid at each resolution of a scenario, all over the same snapped box."""
    region = scenario.region
    return [Grid.from_bounds(region.bounds, r, region.crs, region.resolution_m) for r in region.resolution_m]


def run_scenario(
    scenario: Scenario, folder: Path, on_stage: Callable[[str], None] | None = None, overwrite: bool = False
) -> Run:
    """Make the maps of a scenario under ``folder`` and return them with the record of the run.

    Finished resolutions and files of the same inputs are kept; nothing half-written is left behind.

    Raises:
      InputError: bad settings or sources, too little memory, or a folder that holds another job's maps.
    """
    started_utc = datetime.now(UTC).isoformat(timespec="seconds")
    watch = Stopwatch(on_stage=on_stage)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        grids = grids_of(scenario)
        check_memory(scenario, grids)
        inputs = hash_inputs(scenario)
        key = run_key(scenario, inputs)
        prepare_folder(folder, key, overwrite)
        with watch.stage("read"):
            city = load_city(scenario)
        maps, sky = {}, None
        for grid in grids:
            with watch.stage("orbits"):
                sky = _sky(scenario, grid)
            maps[grid.resolution_m] = _maps_of(scenario, city, grid, sky, folder, key, watch)
    assert sky is not None
    record = {
        "started_utc": started_utc,
        "elapsed_s": {name: round(seconds, 3) for name, seconds in watch.elapsed_s.items()},
        "run_key": key,
        "versions": {name: importlib.metadata.version(name) for name in REPORTED_VERSIONS},
        "settings": json.loads(scenario.model_dump_json(exclude_none=True)),
        "inputs": inputs,
        "region": _region_record(grids),
        "buildings": _building_record(city, grids[0]),
        "satellites": _satellite_record(sky),
        "satellites_above_mask": sky.count_by_system(np.radians(scenario.gps.mask_deg)),
        "rays_leave_data_share": {
            store.short_number(z): round(rays_leaving_share(city, grids[0], sky, z, scenario.gps.mask_deg), 4)
            for z in scenario.region.altitudes_m
        },
        "population": population_record(scenario, city, grids[0]),
        "warnings": list(dict.fromkeys(str(item.message) for item in caught)),
    }
    with store.whole_file(folder / RUN_FILE) as scratch:
        scratch.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return Run(maps, record)


def _sky(scenario: Scenario, grid: Grid) -> Sky:
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


def _maps_of(
    scenario: Scenario, city: City, grid: Grid, sky: Sky, folder: Path, key: str, watch: Stopwatch
) -> MetricMaps:
    """Return the maps at one resolution: those on disk if they are this job's, else computed and saved."""
    if stored_key(folder, grid.resolution_m) == key:
        ds = store.open_zarr(folder, grid.resolution_m)
    else:
        ds = _compute(scenario, city, grid, sky, watch).ds.assign_attrs(run_key=key)
        with watch.stage("write_zarr"):
            store.write_zarr(ds, folder)
    with watch.stage("write_geotiff"):
        store.write_geotiffs(ds, folder, skip_key=key)
    return MetricMaps(ds)


def _compute(scenario: Scenario, city: City, grid: Grid, sky: Sky, watch: Stopwatch) -> MetricMaps:
    region, lidar = scenario.region, scenario.lidar
    lidar_params = LidarParams(lidar.beams, lidar.field_of_view_deg, lidar.azimuths, lidar.range_m)
    risk_params = RiskParams(scenario.risk.threshold_m, scenario.risk.distance)
    with watch.stage("surface"):
        surface = make_surface(
            city,
            grid,
            sky,
            region.altitudes_m,
            mask_deg=scenario.gps.mask_deg,
            lidar=lidar_params,
            risk=risk_params,
            all_touched=scenario.buildings.all_touched,
        )
    return compute_maps(
        city,
        surface,
        sky,
        region.altitudes_m,
        mask_deg=scenario.gps.mask_deg,
        gps=GpsParams(scenario.gps.gdop_threshold),
        lidar=lidar_params,
        risk=risk_params,
        population=population_params(scenario),
        times_of_day=scenario.population.time_of_day,
        all_touched=scenario.buildings.all_touched,
        oversample=region.oversample,
        gps_bounds=scenario.gps.bounds,
        height_std=HeightStd(**scenario.buildings.height_std_m.model_dump()),
        height_samples=scenario.buildings.height_samples,
        height_seed=scenario.buildings.height_seed,
        stage=watch.stage,
    )


def population_params(scenario: Scenario) -> PopulationParams:
    """Return the population metric's parameters of a scenario."""
    people = scenario.population
    return PopulationParams(
        gamma_commercial=people.gamma_commercial,
        gamma_residential=people.gamma_residential,
        quantity=people.quantity,
        normalise=people.normalise,
    )


def hash_inputs(scenario: Scenario) -> dict[str, dict[str, str]]:
    """Return path and SHA-256 of every file that a scenario names (a Shapefile with its companions).

    Raises:
      InputError: a file that is missing or cannot be read.
    """
    people = scenario.population
    named = {
        "buildings": None if scenario.is_synthetic else scenario.buildings.source,
        "terrain": scenario.terrain.source,
        **_orbit_files(scenario),
        "blocks": people.blocks,
        "table": people.table,
        "districts": people.districts,
    }
    return {
        role: {"path": name, "sha256": _sha256(scenario.path_of(name), role)}
        for role, name in named.items()
        if name is not None
    }


def _orbit_files(scenario: Scenario) -> dict[str, str]:
    """Return the orbit files by role: ``orbits``, and ``orbits_2`` ... where there are several."""
    files = [name for name in scenario.gps.orbits if name != NOMINAL]
    return {"orbits" if i == 1 else f"orbits_{i}": name for i, name in enumerate(files, start=1)}


def _sha256(path: Path, role: str) -> str:
    digest = hashlib.sha256()
    parts = sorted(path.parent.glob(f"{path.stem}.*")) if path.suffix.lower() == ".shp" and path.exists() else [path]
    try:
        for part in parts:
            with part.open("rb") as file:
                while chunk := file.read(1 << 20):
                    digest.update(chunk)
    except OSError as error:
        raise InputError(f"cannot read the {role} file {str(path)!r}: {error.strerror or error}") from error
    return digest.hexdigest()


def run_key(scenario: Scenario, inputs: dict[str, dict[str, str]]) -> str:
    """Return a short hash of everything the maps depend on: settings, input bytes, our version."""
    settings = scenario.model_dump(mode="json", exclude={"weights", "planning", "study"})
    facts = {"settings": settings, "inputs": inputs, "version": importlib.metadata.version("jaxurban")}
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]


def stored_key(folder: Path, resolution_m: float) -> str | None:
    """Return the run key of the maps that lie under ``folder``, None without any."""
    path = store.zarr_path(folder, resolution_m)
    if not (path / "zarr.json").is_file():
        return None
    return xr.open_zarr(path, consolidated=False, chunks=None).attrs.get("run_key")


def prepare_folder(folder: Path, key: str, overwrite: bool) -> None:
    """Make the output folder ready: refuse another job's maps, sweep what a killed run left.

    Raises:
      InputError: the folder cannot be written to, or holds maps of other settings or inputs.
    """
    store.check_writable(folder)
    store.sweep_scraps(folder)
    keys = {stored_key(folder, r) for r in store.stored_resolutions(folder)}
    if keys - {key}:
        if not overwrite:
            raise InputError(
                f"{str(folder)!r} holds maps of other settings or inputs: choose another folder, "
                "or pass --overwrite to replace them"
            )
        store.remove_maps(folder)


def check_memory(scenario: Scenario, grids: list[Grid]) -> None:
    """Raise InputError if the maps of the finest grid clearly cannot fit in free memory."""
    altitudes, epochs = len(scenario.region.altitudes_m), len(scenario.gps.epochs)
    cells = max(grid.num_rows * grid.num_cols for grid in grids)
    needed = cells * (altitudes * (epochs * 25 + 9) + 8 * len(scenario.population.time_of_day) + 5) * 2
    if scenario.region.oversample > 1 or scenario.gps.bounds:
        needed += cells * scenario.region.oversample**2 * 20  # the fine surface, and its tops for both directions
    free = psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"{cells / 1e6:.0f} million cells at {altitudes} altitudes and {epochs} epochs need about "
            f"{needed / 2**30:.1f} GiB of memory and {free / 2**30:.1f} GiB are free: use a smaller region, "
            "a coarser [region] resolution_m, or fewer altitudes or epochs"
        )


def rays_leaving_share(city: City, region: Grid, sky: Sky, altitude_m: float, mask_deg: float) -> float:
    """Return the share of cells with a ray that leaves the data while a roof could still block it."""
    x_min, y_min, x_max, y_max = city.extent_m
    x_m, y_m = region.x_m, region.y_m[:, None]
    leaves = np.zeros(region.shape, bool)
    climb_m = max(highest_top_m(city) - altitude_m, 0.0)
    above = sky.elevation_rad >= np.radians(mask_deg)
    for azimuth_rad, elevation_rad in zip(sky.azimuth_rad[above], sky.elevation_rad[above], strict=True):
        run_m = climb_m / np.tan(elevation_rad)
        x_end_m, y_end_m = x_m + run_m * np.sin(azimuth_rad), y_m + run_m * np.cos(azimuth_rad)
        leaves |= (x_end_m < x_min) | (x_end_m > x_max) | (y_end_m < y_min) | (y_end_m > y_max)
    return float(leaves.mean())


def population_record(scenario: Scenario, city: City, region: Grid) -> dict[str, Any] | None:
    """Return night and day population by zoning of the blocks that touch the region."""
    if city.blocks is None:
        return None
    return population_totals(city.blocks, population_params(scenario), region.bounds_m)


def _region_record(grids: list[Grid]) -> dict[str, Any]:
    first = grids[0]
    return {
        "crs": first.crs,
        "bounds_m": list(first.bounds_m),
        "cells": {store.short_number(g.resolution_m): list(g.shape) for g in grids},
    }


def _building_record(city: City, region: Grid) -> dict[str, Any]:
    record: dict[str, Any] = {"faults": dict(city.faults), "source_counts": dict(city.counts)}
    if city.buildings is not None:
        inside = city.buildings.take(shapely.intersects(city.buildings.polygons, shapely.box(*region.bounds_m)))
        counts = inside.origin_counts()
        record |= {
            "in_region": len(inside),
            "height_origin_counts": counts,
            "height_origin_shares": {name: round(n / max(len(inside), 1), 4) for name, n in counts.items()},
            "highest_m": float(inside.height_m.max(initial=0.0)),
            "hanging_parts": int((inside.min_height_m > 0).sum()),
        }
    else:
        assert city.roofs is not None
        record |= {
            "height_origin_shares": {"raster": 1.0},
            "highest_m": float(np.nanmax(city.roofs.values, initial=0.0)),
        }
    return record


def _satellite_record(sky: Sky) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "system": system,
            "azimuth_grid_deg": np.degrees(sky.azimuth_rad[:, i]).round(3).tolist(),
            "elevation_deg": np.degrees(sky.elevation_rad[:, i]).round(3).tolist(),
            "element_age_days": sky.element_age_days[:, i].round(3).tolist(),
        }
        for i, (name, system) in enumerate(zip(sky.names, sky.systems, strict=True))
    ]
