"""run.json: what went into a run's maps, what was met on the way, and how long each stage took."""

import hashlib
import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.rasterise import highest_top_m
from jaxurban.io.store import short_number
from jaxurban.metrics.population import PopulationParams, population_totals
from jaxurban.scenario import NOMINAL, Scenario
from jaxurban.sky import Sky

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


def run_record(
    scenario: Scenario,
    city: City,
    grids: Sequence[Grid],
    sky: Sky,
    population: PopulationParams,
    inputs: Mapping[str, Mapping[str, str]],
    key: str,
    elapsed_s: Mapping[str, float],
    started_utc: str,
    warnings: Sequence[str],
) -> dict[str, Any]:
    """Return what run.json holds; the arguments are what `run_scenario` worked with."""
    region = grids[0]
    people = None if city.blocks is None else population_totals(city.blocks, population, region.bounds_m)
    return {
        "started_utc": started_utc,
        "elapsed_s": {name: round(seconds, 3) for name, seconds in elapsed_s.items()},
        "run_key": key,
        "versions": {name: importlib.metadata.version(name) for name in REPORTED_VERSIONS},
        "settings": json.loads(scenario.model_dump_json(exclude_none=True)),
        "inputs": inputs,
        "region": _region_record(grids),
        "buildings": _building_record(city, region),
        "satellites": _satellite_record(sky),
        "rays_leave_data_share": {
            short_number(z): round(rays_leaving_share(city, region, sky, z, scenario.gps.mask_deg), 4)
            for z in scenario.region.altitudes_m
        },
        "population": people,
        "warnings": list(dict.fromkeys(warnings)),
    }


def hash_inputs(scenario: Scenario) -> dict[str, dict[str, str]]:
    """Return path and SHA-256 of every file that a scenario names (a Shapefile with its companions).

    Raises:
      InputError: a file that is missing or cannot be read.
    """
    people = scenario.population
    named = {
        "buildings": None if scenario.is_synthetic else scenario.buildings.source,
        "terrain": scenario.terrain.source,
        "orbits": None if scenario.gps.orbits == NOMINAL else scenario.gps.orbits,
        "blocks": people.blocks,
        "table": people.table,
        "districts": people.districts,
    }
    return {
        role: {"path": name, "sha256": _sha256(scenario.path_of(name), role)}
        for role, name in named.items()
        if name is not None
    }


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


def rays_leaving_share(city: City, region: Grid, sky: Sky, altitude_m: float, mask_deg: float) -> float:
    """Return the share of cells with a ray that leaves the data while a roof could still block it."""
    x_min, y_min, x_max, y_max = city.extent_m
    x_m, y_m = region.x_m, region.y_m
    col_leaves, row_leaves = np.zeros(region.num_cols, bool), np.zeros(region.num_rows, bool)
    climb_m = max(highest_top_m(city) - altitude_m, 0.0)
    above = sky.elevation_rad >= np.radians(mask_deg)
    for azimuth_rad, elevation_rad in zip(sky.azimuth_rad[above], sky.elevation_rad[above], strict=True):
        run_m = climb_m / np.tan(elevation_rad)
        x_end_m, y_end_m = x_m + run_m * np.sin(azimuth_rad), y_m + run_m * np.cos(azimuth_rad)
        col_leaves |= (x_end_m < x_min) | (x_end_m > x_max)
        row_leaves |= (y_end_m < y_min) | (y_end_m > y_max)
    return float(1.0 - (1.0 - col_leaves.mean()) * (1.0 - row_leaves.mean()))


def _region_record(grids: Sequence[Grid]) -> dict[str, Any]:
    first = grids[0]
    return {
        "crs": first.crs,
        "bounds_m": list(first.bounds_m),
        "cells": {short_number(g.resolution_m): list(g.shape) for g in grids},
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
