"""run.json: what went into a run's maps, what was met on the way, and how long each stage took."""

import glob
import hashlib
import importlib.metadata
import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import pyproj
import shapely

from jaxurban.checks import values_given
from jaxurban.errors import readable
from jaxurban.io.city import City
from jaxurban.io.files import SCRATCH_SUFFIX, digest_of, read_json, visible_files, write_json
from jaxurban.io.samples import located, structures_of
from jaxurban.io.stored import RUN_FILE, ZARR_FOLDER, short_number
from jaxurban.io.workspace import Workspace
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.population import FILES, Population
from jaxurban.progress import LOG
from jaxurban.settings import NOMINAL, as_tuple
from jaxurban.world.blocks import Blocks, Zoning
from jaxurban.world.grid import Bounds, Grid
from jaxurban.world.sky import Sky

if TYPE_CHECKING:
    from jaxurban.maps.task import MapTask

COMPANIED_SUFFIXES = (".shp", ".tif", ".tiff", ".asc", ".img")
REPORTED_VERSIONS = (
    *("jaxurban", "jax", "jaxlib", "numpy", "osmium", "pyproj"),
    *("rasterio", "shapely", "skyfield", "xarray", "zarr"),
)
# Sections of the scenario that no map depends on.
NOT_OF_MAPS = ("weights", "planning", "vehicle", "study")
MOST_SAID, NOT_SET = 6, "not set"  # of differing settings in one sentence
MAP_FOLDERS = ("kernels", "world", "metrics", "io", "maps")  # of the package: what maps depend on

Differing = dict[str, tuple[Any, Any]]  # old and new value by dotted key, None for what is not set
# Path, SHA-256 and bytes of each input file and its companions, by its role.
Inputs = Mapping[str, Mapping[str, Any]]
SYSTEM_FOLDERS = ("/proc", "/sys", "/dev")  # of files that may have no end
MEMORY_FOLDER = "/dev/shm"  # holds usual files


def run_record(
    scenario: Scenario,
    tasks: "Sequence[MapTask]",
    inputs: Inputs,
    key: str,
    elapsed_s: Mapping[str, float],
    started_utc: str,
    messages: Sequence[str],
) -> dict[str, Any]:
    """Return what run.json holds.

    Args:
      scenario: the settings.
      tasks: one for each resolution, all of the same city.
      inputs: from `hash_inputs`.
      key: from `run_key`.
      elapsed_s: seconds by stage.
      started_utc: when the run began, ISO 8601.
      messages: of the warnings.
    """
    from jaxurban.maps.guesses import leaving_shares

    city = tasks[0].city
    region = tasks[0].region
    sky = tasks[-1].sky

    # Shares of cells and of results whose rays leave the data, by altitude.
    cells_leaving = {}
    results_leaving = {}
    for altitude_m in scenario.region.altitudes_m:
        cells, results = leaving_shares(city, region, sky, altitude_m)
        cells_leaving[short_number(altitude_m)] = round(cells, 4)
        results_leaving[short_number(altitude_m)] = round(results, 4)

    # People of the blocks that touch the region, and of those only the people inside it.
    population = inside = None
    if city.blocks is not None:
        people = city.blocks, scenario.population, region.bounds_m
        population = population_totals(*people)
        inside = population_totals(*people, is_cut=True)

    return {
        "started_utc": started_utc,
        "elapsed_s": {name: round(seconds, 3) for name, seconds in elapsed_s.items()},
        "run_key": key,
        "engine": "numba" if scenario.region.engine == "numba" else "jax",
        "by_numba": tasks[0].by_numba,
        "versions": versions(),
        "settings": settings_of(scenario),
        "inputs": inputs,
        "region": {
            "crs": region.crs,
            "bounds_m": list(region.bounds_m),
            "cells": {short_number(task.region.resolution_m): task.region.shape for task in tasks},
        },
        "buildings": _building_record(city, region),
        "epochs": list(sky.times),
        "satellites_above_mask": sky.count_by_system(),
        "satellites": _satellite_record(sky),
        "rays_leave_data_share": cells_leaving,
        "answers_leave_data_share": results_leaving,
        "population": population,
        "population_in_region": inside,
        "warnings": list(dict.fromkeys(messages)),
    }


def write_record(file: Path, record: dict[str, Any], is_kept: bool) -> dict[str, Any]:
    """Write run.json, unless it already holds the same, and return what it holds.

    Args:
      file: run.json.
      record: from `run_record`.
      is_kept: whether all maps were kept and none was made. Start, times, engine and earlier warnings then stay those
        of the run that made the maps.
    """
    try:
        old = read_json(file)
    except (OSError, ValueError):
        old = {}
        if is_kept:
            LOG.warning(f"{str(file)!r} is missing or damaged: writing it again")
    record = json.loads(json.dumps(record))  # tuples become lists, as in the old record
    if is_kept and old.get("run_key") == record["run_key"]:
        kept_names = "started_utc", "elapsed_s", "engine", "by_numba"
        record |= {name: old[name] for name in kept_names if name in old}
        record["warnings"] = list(dict.fromkeys([*old["warnings"], *record["warnings"]]))
    if record != old:
        write_json(file, record, indent=2)
    return record


def hash_inputs(scenario: Scenario, recorded: Inputs | None = None) -> dict[str, dict[str, Any]]:
    """Return path, SHA-256 and bytes of every file that a scenario names, by its role.

    Roles are ``buildings``, ``structures``, ``terrain``, ``vegetation``, ``orbits``, ``orbits_2`` and so on, those of
    `FILES` and ``layer_NAME``. The companions of a file, such as the .dbf of a Shapefile, are hashed and counted with
    it.

    Args:
      scenario: the settings.
      recorded: what somebody's run recorded: a file of another size is not read and has the SHA-256 "". Files that are
        missing are left out then.

    Raises:
      InputError: a file that is missing (without a record) or cannot be read, or one of the system (`SYSTEM_FOLDERS`).
    """
    buildings = None if scenario.is_synthetic else scenario.buildings.source
    named: dict[str, Any] = {
        "buildings": buildings,
        "structures": structures_of(buildings, scenario.kinds),
        "terrain": scenario.terrain.source,
        "vegetation": scenario.vegetation.source,
    }
    orbits = [name for name in as_tuple(scenario.gps.orbits) if name != NOMINAL]
    for number, name in enumerate(orbits, start=1):
        named["orbits" if number == 1 else f"orbits_{number}"] = name
    for role in FILES:
        named[role] = getattr(scenario.population, role)
    for layer_name, layer in scenario.layers.items():
        named[f"layer_{layer_name}"] = layer.source
    files = {}
    for role, name in values_given(named).items():
        file = located(scenario.path_of(name))
        if recorded is not None and not os.path.exists(file):
            continue
        record = recorded and recorded.get(role, {})
        files[role] = {"path": name} | _sum_and_size(file, role, record)
    return files


def unsized(inputs: Inputs) -> dict[str, dict[str, Any]]:
    """Return inputs without their sizes, which no run key depends on and old records lack."""
    return {
        role: {key: value for key, value in file.items() if key != "bytes"}
        for role, file in inputs.items()
    }


def _sum_and_size(path: Path, role: str, recorded: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return ``sha256``, over the names and contents of a file and its companions, and ``bytes``, their size.

    Args:
      path: of the file.
      role: for the message.
      recorded: what is on record of the file, as for `hash_inputs`; None: the file is read whatever its size.

    Raises:
      InputError: a file that is missing, of the system, or cannot be read; the message names its role.
    """
    with readable(
        path, "bytes", "name a file that can be read", what=f"the {role} file {str(path)!r}"
    ):
        parts = _companions(path)
        for part in parts:
            _check_usual(part)
        num_bytes = sum(part.stat().st_size for part in parts)
        if recorded is not None and num_bytes != recorded.get("bytes"):
            return {"sha256": "", "bytes": num_bytes}
        home = path.parent
        sums = "".join(f"{part.relative_to(home).as_posix()} {digest_of(part)}\n" for part in parts)
    return {"sha256": hashlib.sha256(sums.encode()).hexdigest(), "bytes": num_bytes}


def _check_usual(path: Path) -> None:
    """Raise OSError for a file of the system (`SYSTEM_FOLDERS`), which may have no end, once links are followed."""
    target = path.resolve()
    is_of_system = any(map(target.is_relative_to, SYSTEM_FOLDERS))
    if is_of_system and not target.is_relative_to(MEMORY_FOLDER):
        raise OSError("it is a file of the system")


def _companions(path: Path) -> list[Path]:
    """Return a file and the files beside it that belong to it, sorted.

    They have its name but for the suffix, as the .dbf of a Shapefile and the .tfw of a raster, or with a further
    suffix, as its .aux.xml. A file of another kind (`COMPANIED_SUFFIXES`) is returned alone, and of a folder the files
    in it.
    """
    if path.is_dir():
        return visible_files(path)
    if not path.is_file() or path.suffix.lower() not in COMPANIED_SUFFIXES:
        return [path]
    stem, name = glob.escape(path.stem), glob.escape(path.name)
    others = {*path.parent.glob(f"{stem}.*"), *path.parent.glob(f"{name}.*")}
    return sorted(part for part in others | {path} if part.is_file())


def settings_of(scenario: Scenario) -> dict[str, Any]:
    """Return the settings of a scenario as run.json holds them, in ``[planning]`` only the ones that were given."""
    settings = json.loads(scenario.model_dump_json(exclude_none=True))
    return settings | {"planning": scenario.planning.given}


def code_hash() -> str:
    """Return a SHA-256 over the source files that make maps, so that maps of other code are not taken for ours."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    files = [package / "errors.py", package / "settings.py"]
    for name in MAP_FOLDERS:
        files += (package / name).rglob("*.py")
    for path in sorted(files):
        digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return digest.hexdigest()


def _of_maps(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that maps depend on: `NOT_OF_MAPS` and the engine, which changes no bit, are left out."""
    of_maps = {name: value for name, value in settings.items() if name not in NOT_OF_MAPS}
    region = {name: value for name, value in settings["region"].items() if name != "engine"}
    return of_maps | {"region": region}


def run_key(scenario: Scenario, inputs: Inputs, backend: str) -> str:
    """Return a short hash of all that maps depend on, 16 hexadecimal digits.

    Args:
      scenario: of its settings, those that maps depend on.
      inputs: from `hash_inputs`.
      backend: the device that computes, as JAX names it: ``"cpu"`` or ``"gpu"``. Our code and the versions of the
        libraries count too.
    """
    facts = {
        "settings": _of_maps(scenario.model_dump(mode="json")),
        "inputs": unsized(inputs),
        "code": code_hash(),
        "versions": versions(),
        "backend": backend,
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:16]


def begun(scenario: Scenario) -> tuple[Inputs, str]:
    """Return the input files of a run, from `hash_inputs`, and its key, from `run_key`, on this process's device."""
    inputs = hash_inputs(scenario)
    on_host = scenario.region.engine == "numba"
    return inputs, run_key(scenario, inputs, "cpu" if on_host else jax.default_backend())


def finished(scenario: Scenario, folder: Path) -> dict[str, Any] | None:
    """Return the record of the run that made a scenario's maps in a folder; None where something is left to do.

    Every file of the run is read and compared with its checksum.
    """
    with suppress(OSError, ValueError), Workspace.shared(folder, "maps") as run:
        record = read_json(folder / RUN_FILE)
        inputs, key = begun(scenario)
        same = {"run_key": key, "inputs": inputs, "settings": settings_of(scenario)}
        is_same = run.settings == {"run_key": key} and record == record | same
        has_remains = any((folder / ZARR_FOLDER).glob(f".*{SCRATCH_SUFFIX}"))
        if is_same and not has_remains and not run.broken(folder / name for name in run.written):
            return record
    return None


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by dotted key, such as ``region.resolution_m``; settings that are None are left out.

    Args:
      settings: nested, sections by name.
      prefix: in front of every key, with its dot.
    """
    by_key: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            by_key |= _flat(value, f"{prefix}{name}.")
        elif value is not None:
            by_key[f"{prefix}{name}"] = value
    return by_key


def differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> Differing:
    """Return what differs between two sets of settings, as JSON holds them.

    Returns:
      Old and new value by dotted key; None where a setting is not set.
    """
    before, after = _flat(old), _flat(new)
    pairs = {key: (before.get(key), after.get(key)) for key in after | before}
    return {key: (value, other) for key, (value, other) in pairs.items() if value != other}


def differences_said(settings: Differing) -> str:
    """Return differing settings in words, as ``gps.mask_deg was 5.0, now 10.0``; the first `MOST_SAID` of them."""
    words = [f"{key} was {_shown(old)}, now {_shown(new)}" for key, (old, new) in settings.items()]
    if len(words) > MOST_SAID:
        words[MOST_SAID:] = [f"and {len(words) - MOST_SAID} more"]
    return "; ".join(words)


def _shown(value: Any) -> str:
    """Return the value of a setting as a text; None is a setting that is not set."""
    return NOT_SET if value is None else repr(value)


def _sums(files: Mapping[str, Mapping[str, str]]) -> dict[str, str | None]:
    """Return the SHA-256 of input files by their roles, None for one that its record lacks."""
    return {role: file.get("sha256") for role, file in files.items()}


def other_maps(folder: Path, scenario: Scenario, inputs: Inputs) -> str:
    """Return in words how the maps under a folder differ from those that a scenario would make.

    The record of the folder's maps says it: by settings, input files and versions of libraries.

    Args:
      folder: with maps of another run.
      scenario: the settings.
      inputs: its files, from `hash_inputs`.
    """
    try:
        record = read_json(folder / RUN_FILE)
        settings = record["settings"]
        files = record["inputs"]
        made_by = record["versions"]
    except (OSError, ValueError, LookupError):
        return "maps of other settings or inputs, or made by another version of jaxurban or its libraries"

    # The settings, the input files and the versions that differ.
    words = []
    other_settings = differing(_of_maps(settings), _of_maps(settings_of(scenario)))
    if other_settings:
        words.append(f"of other settings ({differences_said(other_settings)})")
    roles = list(differing(_sums(files), _sums(inputs)))
    if other_settings:  # these name already the files that only one of the runs has
        roles = [role for role in roles if role in files and role in inputs]
    if roles:
        words.append(f"of other input files ({', '.join(roles)}: what they hold has changed)")
    other_versions = differing(made_by, versions())
    if other_versions:
        words.append(f"made by other versions ({differences_said(other_versions)})")
    return f"maps {' and '.join(words) or 'made by other code of jaxurban, or on another device'}"


def versions() -> dict[str, str]:
    """Return the versions of the packages that the maps depend on."""
    import rasterio

    libraries = {
        "GDAL": rasterio.__gdal_version__,
        "GEOS": shapely.geos_version_string,
        "PROJ": pyproj.proj_version_str,
    }
    return {name: importlib.metadata.version(name) for name in REPORTED_VERSIONS} | libraries


def _building_record(city: City, region: Grid) -> dict[str, Any]:
    """Return what `run.json` says of the buildings in a region.

    This is where their heights come from (counts and shares), and the faults of the file; for a city whose roofs are a
    raster, only the faults and the highest roof. The kinds of all that stands, what of it is the highest in metres and
    how many hang count structures too.
    """
    record: dict[str, Any] = {"faults": dict(city.read_issues)}
    if city.learned:
        record["learned"] = {name: asdict(each) for name, each in city.learned.items()}
    if city.buildings is None or city.standing is None:
        assert city.roofs is not None
        highest_m = float(np.nanmax(city.roofs.values, initial=0.0))
        return record | {"height_origin_shares": {"raster": 1.0}, "highest_m": highest_m}
    inside = city.buildings.inside(region.bounds_m)
    standing = city.standing.inside(region.bounds_m)
    counts = inside.origin_counts()
    num = max(len(inside), 1)
    return record | {
        "in_region": len(inside),
        "height_origin_counts": counts,
        "height_origin_shares": {name: round(count / num, 4) for name, count in counts.items()},
        "kinds": dict(Counter(standing.kinds.tolist())),
        "highest_m": float(standing.height_m.max(initial=0.0)),
        "hanging_parts": int((standing.min_height_m > 0).sum()),
    }


def _satellite_record(sky: Sky) -> list[dict[str, Any]]:
    """Return each satellite's directions by time, in degrees, and the age of its elements, in days."""
    azimuth_deg = np.degrees(sky.azimuth_rad).round(3).T
    elevation_deg = np.degrees(sky.elevation_rad).round(3).T
    age_days = sky.element_age_days.round(3).T
    return [
        {
            "name": name,
            "system": sky.systems[s],
            "azimuth_grid_deg": azimuth_deg[s].tolist(),
            "elevation_deg": elevation_deg[s].tolist(),
            "element_age_days": age_days[s].tolist(),
        }
        for s, name in enumerate(sky.names)
    ]


def population_totals(
    blocks: Blocks,
    params: Population | None = None,
    bounds_m: Bounds | None = None,
    is_cut: bool = False,
) -> dict[str, dict[str, float]]:
    """Return the people of the blocks by time of day and zoning, for run.json.

    Keys are ``night`` and ``day``, under each ``commercial``, ``residential``, ``other`` and ``total``.

    Args:
      blocks: the census blocks.
      params: settings whose gammas make the people by day, where the blocks do not hold these; left out, the paper's.
      bounds_m: x_min, y_min, x_max, y_max: only the blocks that touch this box count; left out, all.
      is_cut: whether a block that reaches beyond the box counts only with the people inside, spread evenly over its
        area; otherwise it counts whole.
    """
    params = params or Population()
    share = np.ones(len(blocks)) if bounds_m is None else blocks.touches(bounds_m)
    if is_cut and bounds_m is not None:
        inside_m2 = shapely.area(shapely.intersection(blocks.polygons, shapely.box(*bounds_m)))
        share = share * inside_m2 / np.where(blocks.area_m2 > 0, blocks.area_m2, 1.0)

    def by_zoning(count: np.ndarray) -> dict[str, float]:
        """Return the sum of the counts ``[N]`` of the blocks, each times its share, by zoning."""
        people = count * share
        return {
            zone.name.lower(): float(people[blocks.zoning == zone].sum())
            for zone in reversed(Zoning)
        }

    night = by_zoning(blocks.night_count)
    if blocks.day_count is None:
        day = {name: count * params.gamma_residential for name, count in night.items()}
        day["commercial"] = night["commercial"] * params.gamma_commercial
    else:
        day = by_zoning(blocks.day_count)
    for counts in (night, day):
        counts["total"] = sum(counts.values())
    return {"night": night, "day": day}
