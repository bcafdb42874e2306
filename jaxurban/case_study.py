"""study: a Monte Carlo study of planners over metric maps, kept in a folder and resumable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.city import LandCover
from jaxurban.cost import Weights
from jaxurban.demo import demo_cover_for_bounds
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.city import OSM_SUFFIXES
from jaxurban.io.landcover import read_land_cover
from jaxurban.io.rowstore import PARTS_FOLDER, ROWS_FILE
from jaxurban.io.seal import read_json, write_json
from jaxurban.io.store import check_writable, only_writer, whole_file
from jaxurban.io.tables import write_table
from jaxurban.limits import Limits, limits_said
from jaxurban.maps import MetricMaps, Obstacles, open_maps
from jaxurban.planners.base import CostKind, CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.scenario import PAPER_PLANNERS, Scenario
from jaxurban.studies.analysis import joined
from jaxurban.studies.montecarlo import Source, run_study
from jaxurban.studies.sampling import (
    DIRICHLET,
    KEY,
    QUESTION,
    checked_instances,
    read_instances,
    sample_instances,
    with_connection,
)
from jaxurban.studies.trial import DISTANCE, WEIGHTED, Run, Settings, free_cell

SETTINGS_FILE, INSTANCES_FILE = "study.json", "instances.parquet"


@dataclass(frozen=True, eq=False)
class StudyResult:
    """What a study found.

    Attributes:
      folder: where it is kept.
      maps: what it was made on.
      instances: what was asked (`sample_instances`).
      rows: what each planner answered (`jaxurban.studies.trial.COLUMNS`).
      settings: how it was asked.
    """

    folder: Path
    maps: MetricMaps
    instances: pd.DataFrame
    rows: pd.DataFrame
    settings: Settings

    @property
    def table(self) -> pd.DataFrame:
        """The rows with their instances, ``has_path``, ``is_joined`` and ``ratio`` (`studies.analysis.joined`)."""
        return joined(self.rows, self.instances)


def study(
    maps: MetricMaps | str | Path,
    folder: str | Path,
    *,
    instances: pd.DataFrame | None = None,
    num_instances: int = 200,
    altitudes_m: Sequence[float] | None = None,
    cover: LandCover | None = None,
    weights: str | Sequence[Weights] = DIRICHLET,
    planners: Sequence[str] = PAPER_PLANNERS,
    distance_only: Sequence[str] = ("astar-dist",),
    cost_model: CostModel | CostKind = "line",
    limits: Limits | None = None,
    budget_s: float = 2.0,
    budget_iterations: int | None = None,
    seed: int = 0,
    workers: int = 1,
    cluster: str | None = None,
    resolution_m: float | None = None,
    obstacles: Obstacles = "touched",
    overwrite: bool = False,
    progress: bool = True,
) -> StudyResult:
    """Return every planner's answer to every instance, under equal budgets.

    Rows are kept in ``folder`` (``rows.parquet``, one a planner, objective, instance and altitude) as they come; the
    same call after any end, ``kill -9`` included, asks only what is missing; planners and instances may be added. A
    planner that crashes is a row with the status ``crashed``, a place that is not free here one with ``bad-input``.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of maps, which several workers need.
      folder: where the study is kept.
      instances: from `sample_instances` or `studies.sampling.read_instances`; left out, sampled. Their
        ``is_connected`` is told anew from these maps.
      num_instances, altitudes_m, cover, weights: of the sampling (see `sample_instances`).
      planners: each is asked every instance.
      distance_only: planners that are asked for the shortest path too; its weighted cost is reported.
      cost_model: as in `plan`; ``"line"`` depends on no resolution. Costs are reported under both kinds.
      limits: no-fly zones and bounds that close cells to starts, goals and every planner.
      budget_s: seconds for each run.
      budget_iterations: instead, samples for planners that draw any, while the others run to their end: rows then
        repeat exactly, whatever the number of workers, but for ``elapsed_s``.
      seed: of the sampling and of sampling planners.
      workers: processes of this machine; 1 works in this process.
      cluster: address of a Dask scheduler instead, whose workers see the maps' folder under the same path.
      resolution_m: which maps, where a folder holds several.
      obstacles: where planners may fly on the maps of a folder (see `MetricMaps`, which carry their own rule).
      overwrite: replace a study of other settings.
      progress: show a bar with running totals on stderr, where that is a terminal.

    Raises:
      InputError: a wrong argument, instances for other maps or none that can be asked, or a folder that holds a study
        of other settings or other instances.
    """
    folder = Path(folder)
    if not planners:
        raise InputError("planners is empty: name at least one planner")
    for planner in (*planners, *distance_only):
        find_planner(planner)
    if workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    settings = Settings(CostModel.of(cost_model), float(budget_s), budget_iterations, seed, limits or Limits())
    opened = maps if isinstance(maps, MetricMaps) else open_maps(maps, resolution_m, obstacles=obstacles)
    source = maps if isinstance(maps, MetricMaps) else Source(Path(maps).resolve(), opened.grid.resolution_m, obstacles)
    if instances is None:
        instances = sample_instances(
            opened,
            num_instances,
            altitudes_m=altitudes_m,
            cover=cover,
            weights=weights,
            cost_model=settings.cost_model,
            limits=settings.limits,
            seed=seed,
        )
    else:
        instances = checked_instances(instances, "instances")
        _check_instances(instances, opened)
        instances = with_connection(instances, opened, settings.cost_model, settings.limits)
        _check_places(instances, opened, settings.limits)
    runs = [Run(name, WEIGHTED) for name in dict.fromkeys(planners)]
    runs += [Run(name, DISTANCE) for name in dict.fromkeys(distance_only)]
    check_writable(folder)
    with only_writer(folder):
        _claim(folder, settings, opened, instances, overwrite)
        write_table(instances, folder / INSTANCES_FILE)
        rows = run_study(
            instances, runs, source, folder, settings, num_workers=workers, cluster=cluster, progress=progress
        )
    return StudyResult(folder, opened, instances, rows, settings)


def land_cover_of(scenario: Scenario) -> LandCover | None:
    """Return the water and the parks that the study of a scenario tells apart, None where nothing tells them.

    From ``[study] land_cover``; left out, from the buildings' source where that is an OSM file, or the embedded city's.

    Raises:
      InputError: the file cannot be read, or is no OSM file.
    """
    region, named = scenario.region, scenario.study.land_cover
    if named is None and scenario.is_synthetic:
        return demo_cover_for_bounds(region.bounds, region.crs)
    source = named or scenario.buildings.source
    if not source.lower().endswith(OSM_SUFFIXES):
        if named is not None:
            raise InputError(f"[study] land_cover must be an OpenStreetMap file (.osm.pbf or .osm), got {named!r}")
        return None
    grid = Grid.from_bounds(region.bounds, region.resolution_m[0], region.crs, region.resolution_m)
    return read_land_cover(scenario.path_of(source), grid.crs, grid.bounds_m)


def _check_instances(instances: pd.DataFrame, maps: MetricMaps) -> None:
    """Raise InputError unless instances can be asked on these maps."""
    crs = set(instances.crs) - {maps.grid.crs}
    if crs:
        raise InputError(f"the instances' places are in {crs.pop()}, the maps in {maps.grid.crs}: use maps in that CRS")
    times = maps.times if maps.default_time is not None else ()
    for name, held in (("altitude_m", maps.altitudes_m), ("time", times), ("time_of_day", maps.times_of_day)):
        lost = [value for value in instances[name].dropna().unique() if value not in held]
        if lost:
            listed = ", ".join(f"{value:g}" if name == "altitude_m" else str(value) for value in held) or "none"
            raise InputError(f"the instances ask for {name} {lost[0]}, and these maps hold {listed}")


def _check_places(instances: pd.DataFrame, maps: MetricMaps, limits: Limits) -> None:
    """Raise InputError if not one instance starts and ends on a free cell; a few that do not are rows."""
    if instances.is_connected.notna().any():
        return
    first = instances.iloc[0]
    is_free = limits.is_free(maps, first.altitude_m, time=first.time, time_of_day=first.time_of_day)
    for end in ("start", "goal"):
        try:
            free_cell(maps.grid, is_free, first[f"{end}_x_m"], first[f"{end}_y_m"])
        except InputError as error:
            raise InputError(
                f"no instance can be asked on these maps, from the first one on, instance {first.instance} at "
                f"{first.altitude_m:g} m, whose {end} is no free place ({error}): use the maps that they are for"
            ) from error


def _claim(folder: Path, settings: Settings, maps: MetricMaps, instances: pd.DataFrame, overwrite: bool) -> None:
    """Make the folder this study's, or raise InputError if it is another's."""
    told = settings.to_dict() | {
        "maps": {name: str(maps.ds.attrs[name]) for name in ("crs", "resolution_m", "first_row", "first_col")}
        | {"run_key": str(maps.ds.attrs.get("run_key")), "obstacles": maps.obstacles},
    }
    file = folder / SETTINGS_FILE
    held = _held(file)
    other = None if held is None else _other_settings(held, told) or _other_instances(folder, instances)
    if other is not None:
        if not overwrite:
            raise InputError(
                f"{str(folder)!r} holds a study {other}: choose another folder, or pass --overwrite (overwrite=True) "
                "to replace it"
            )
        for old in (folder / ROWS_FILE, folder / INSTANCES_FILE, *(folder / PARTS_FOLDER).glob("*.json")):
            old.unlink(missing_ok=True)
    with whole_file(file) as scratch:
        write_json(scratch, told, indent=2)


def _in_words(told: Mapping[str, Any]) -> dict[str, str]:
    """Return what decides a study's rows, for a person to read."""
    iterations, maps = told.get("budget_iterations"), told.get("maps") or {}
    limits = told.get("limits") or {}
    return {
        "cost model": f"{told.get('cost_model')}",
        "reference length": f"{told.get('reference_length_m')} m",
        "number of neighbours (connectivity)": f"{told.get('connectivity')}",
        "rule for diagonal steps": f"{told.get('diagonal')}",
        "budget": f"{told.get('budget_s')} s" if iterations is None else f"{iterations} samples",
        "seed": f"{told.get('seed')}",
        "rule of obstacles": f"{maps.get('obstacles')}",
        "set of limits": limits_said(limits) or "none",
        "outlines of no-fly zones": ", ".join(zone.get("outline", "") for zone in limits.get("no_fly", ())),
        "maps' CRS": f"{maps.get('crs')}",
        "maps' resolution": f"{maps.get('resolution_m')} m",
        "maps' first row and column": f"{maps.get('first_row')}, {maps.get('first_col')}",
        "key of the maps' settings, inputs and code": f"{maps.get('run_key')}",
    }


def _other_settings(held: Mapping[str, Any], told: Mapping[str, Any]) -> str | None:
    """Return how the held study is asked otherwise than this one, None if it is asked alike."""
    before, now = _in_words(held), _in_words(told)
    differing = (
        f"that was asked otherwise (its {name} is {before[name]}, and {now[name]} is asked for now)"
        for name in now
        if before[name] != now[name]
    )
    return next(differing, None)


def _other_instances(folder: Path, instances: pd.DataFrame) -> str | None:
    """Return which instance of the held study is not among these or not the same, None if the study only grows."""
    try:
        held = read_instances(folder / INSTANCES_FILE).set_index(list(KEY))
    except InputError as error:
        has_rows = (folder / ROWS_FILE).exists() or any((folder / PARTS_FOLDER).glob("*.json"))
        return f"whose instances are lost ({error})" if has_rows else None
    asked = instances.set_index(list(KEY))
    lost = held.index.difference(asked.index)
    if len(lost):
        number, altitude_m = lost[0]
        return (
            f"of {len(held)} instances, counted at each altitude, of which {len(lost)} are not asked now (instance "
            f"{number} at {altitude_m:g} m is the first), and a study can be made longer but not shorter"
        )
    before, now = held[list(QUESTION)], asked[list(QUESTION)].reindex(held.index)
    differs = np.argwhere(~((before == now) | (before.isna() & now.isna())).to_numpy())
    if not len(differs):
        return None
    row, col = differs[0]
    number, altitude_m = held.index[row]
    return (
        f"of other instances (instance {number} at {altitude_m:g} m has the {QUESTION[col]} {before.iloc[row, col]}, "
        f"and {now.iloc[row, col]} is asked for now)"
    )


def _held(file: Path) -> dict[str, Any] | None:
    try:
        held = read_json(file)
    except FileNotFoundError:
        if foreign := [name for name in (ROWS_FILE, INSTANCES_FILE, PARTS_FOLDER) if (file.parent / name).exists()]:
            raise InputError(
                f"{str(file.parent / foreign[0])!r} is there already, and nothing says that it is a study's: choose "
                "another folder, or remove it"
            ) from None
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{str(file)!r} cannot be read: remove the folder and run the study anew") from error
    return held
