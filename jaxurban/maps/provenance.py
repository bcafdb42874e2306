"""run.json: what went into a run's maps, what was met on the way, and how long each stage took."""

import glob
import hashlib
import importlib.metadata
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import pyproj
import shapely

from jaxurban.checks import values_given
from jaxurban.errors import readable
from jaxurban.io.files import SCRATCH_SUFFIX, digest_of, read_json, visible_files, write_json
from jaxurban.io.samples import located, structures_of
from jaxurban.io.stored import RUN_FILE, ZARR_FOLDER, short_number
from jaxurban.io.workspace import Differing, Workspace, differing
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.population import FILES
from jaxurban.progress import LOG
from jaxurban.settings import NOMINAL, as_tuple

if TYPE_CHECKING:
    from jaxurban.maps.task import MapTask

COMPANIED_SUFFIXES = (".shp", ".tif", ".tiff", ".asc", ".img")
REPORTED_VERSIONS = (
    *("jaxurban", "jax", "jaxlib", "numpy", "osmium", "pyproj"),
    *("rasterio", "shapely", "skyfield", "xarray", "zarr"),
)
# Sections of the scenario that no map depends on.
NOT_OF_MAPS = ("weights", "planning", "vehicle", "study")
REMEDY = "name a file that can be read"
MOST_SAID, NOT_SET = 6, "not set"  # of differing settings in one sentence
DIGITS_SAID = 8  # of a SHA-256
MAP_FOLDERS = (
    "kernels",
    "world",
    "metrics",
    "io",
    "cities",
    "maps",
)  # of the package: what maps depend on

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
    city = tasks[0].city
    region = tasks[0].region
    sky = tasks[-1].sky

    return {
        "started_utc": started_utc,
        "elapsed_s": {name: round(seconds, 3) for name, seconds in elapsed_s.items()},
        "run_key": key,
        "by_numba": tasks[0].by_numba,
        "versions": versions(),
        "settings": settings_of(scenario),
        "inputs": inputs,
        "region": {
            "crs": region.crs,
            "bounds_m": list(region.bounds_m),
            "cells": {short_number(task.region.resolution_m): task.region.shape for task in tasks},
        },
        "buildings": {
            "faults": dict(city.read_issues),
            "learned": {name: asdict(each) for name, each in city.learned.items()},
        },
        "epochs": list(sky.times),
        "warnings": list(dict.fromkeys(messages)),
    }


def write_record(file: Path, record: dict[str, Any], is_kept: bool) -> dict[str, Any]:
    """Write run.json, unless it already holds the same, and return what it holds.

    Args:
      file: run.json.
      record: from `run_record`.
      is_kept: whether all maps were kept and none was made. Start, times and earlier warnings then stay those
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
        kept_names = "started_utc", "elapsed_s", "by_numba"
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
    files = {}
    for role, name in _named_files(scenario).items():
        file = located(scenario.path_of(name))
        if recorded is not None and not os.path.exists(file):
            continue
        record = recorded and recorded.get(role, {})
        files[role] = {"path": name} | _sum_and_size(file, role, record)
    return files


def check_inputs(scenario: Scenario) -> None:
    """Raise InputError where a file that a scenario names is not there; none is read."""
    for role, name in _named_files(scenario).items():
        file = located(scenario.path_of(name))
        with readable(file, "bytes", REMEDY, what=f"the {role} file {str(file)!r}"):
            file.stat()


def _named_files(scenario: Scenario) -> dict[str, Any]:
    """Return the names of the files of a scenario, as it gives them, by the roles of `hash_inputs`."""
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
    return values_given(named)


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
    with readable(path, "bytes", REMEDY, what=f"the {role} file {str(path)!r}"):
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
    """Return the settings that maps depend on: all but those of `NOT_OF_MAPS`."""
    return {name: value for name, value in settings.items() if name not in NOT_OF_MAPS}


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
    return inputs, run_key(scenario, inputs, jax.default_backend())


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


def differences_said(settings: Differing) -> str:
    """Return differing settings in words, as ``gps.mask_deg was 5.0, now 10.0``; the first `MOST_SAID` of them."""
    words = [f"{key} was {_shown(old)}, now {_shown(new)}" for key, (old, new) in settings.items()]
    if len(words) > MOST_SAID:
        words[MOST_SAID:] = [f"and {len(words) - MOST_SAID} more"]
    return "; ".join(words)


def _shown(value: Any) -> str:
    """Return the value of a setting as a text; None is a setting that is not set."""
    return NOT_SET if value is None else repr(value)


def _compared(settings: Mapping[str, Any], inputs: Inputs, made_by: Any) -> dict[str, Any]:
    """Return what decides maps, to be compared: settings, the first digits of each file's SHA-256, and versions."""
    sums = {role: file["sha256"][:DIGITS_SAID] for role, file in inputs.items()}
    return {"inputs": sums, "versions": made_by} | _of_maps(settings)


def other_maps(folder: Path, scenario: Scenario, inputs: Inputs) -> str:
    """Return in words how the maps under a folder differ from those that a scenario would make.

    The record of the folder's maps says it: by settings, input files and versions of libraries.

    Args:
      folder: with maps of another run.
      scenario: the settings.
      inputs: its files, from `hash_inputs`.
    """
    others = Differing()
    with suppress(OSError, ValueError, LookupError, TypeError):
        record = read_json(folder / RUN_FILE)
        before = _compared(record["settings"], record["inputs"], record["versions"])
        others = differing(before, _compared(settings_of(scenario), inputs, versions()))
    if others:
        return f"maps of other settings, input files or versions ({differences_said(others)})"
    return "maps made by other code of jaxurban, or on another device"


def versions() -> dict[str, str]:
    """Return the versions of the packages that the maps depend on."""
    import rasterio

    libraries = {
        "GDAL": rasterio.__gdal_version__,
        "GEOS": shapely.geos_version_string,
        "PROJ": pyproj.proj_version_str,
    }
    return {name: importlib.metadata.version(name) for name in REPORTED_VERSIONS} | libraries
