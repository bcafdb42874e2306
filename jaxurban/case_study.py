"""study: a Monte Carlo study of planners over metric maps, kept in a folder and resumable."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.city import LandCover
from jaxurban.cost import Weights
from jaxurban.demo import demo_cover_for_bounds
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.city import OSM_SUFFIXES
from jaxurban.io.landcover import read_land_cover
from jaxurban.io.store import check_writable, only_writer, whole_file
from jaxurban.io.tables import write_table
from jaxurban.maps import MetricMaps, open_maps
from jaxurban.planners.base import CostModel, Diagonal
from jaxurban.planners.registry import find_planner
from jaxurban.scenario import PAPER_PLANNERS, Scenario
from jaxurban.studies.analysis import joined
from jaxurban.studies.montecarlo import Source, run_study
from jaxurban.studies.sampling import DIRICHLET, sample_instances
from jaxurban.studies.trial import DISTANCE, WEIGHTED, Run, Settings

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
    cost_model: CostModel = "line",
    reference_length_m: float = 5.0,
    connectivity: int = 8,
    diagonal: Diagonal = "both-free",
    budget_s: float = 2.0,
    budget_iterations: int | None = None,
    seed: int = 0,
    workers: int = 1,
    cluster: str | None = None,
    resolution_m: float | None = None,
    overwrite: bool = False,
    progress: bool = True,
) -> StudyResult:
    """Return every planner's answer to every instance, under equal budgets.

    Rows are kept in ``folder`` (``rows.parquet``, one a planner, objective, instance and altitude) as they come; the
    same call after any end, ``kill -9`` included, asks only what is missing, and planners may be added. A planner that
    crashes is a row with the status ``crashed``.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of maps, which several workers need.
      folder: where the study is kept.
      instances: from `sample_instances` or `studies.sampling.read_instances`; left out, sampled.
      num_instances, altitudes_m, cover, weights: of the sampling (see `sample_instances`).
      planners: each is asked every instance.
      distance_only: planners that are asked for the shortest path too; its weighted cost is reported.
      cost_model: ``"line"``, which depends on no resolution, or ``"cell"`` (the paper); costs are reported under both.
      reference_length_m, connectivity, diagonal: as in `plan`.
      budget_s: seconds for each run.
      budget_iterations: instead, samples for planners that draw any, while the others run to their end: rows then
        repeat exactly, whatever the number of workers, but for ``elapsed_s``.
      seed: of the sampling and of sampling planners.
      workers: processes of this machine; 1 works in this process.
      cluster: address of a Dask scheduler instead, whose workers see the maps' folder under the same path.
      resolution_m: which maps, where a folder holds several.
      overwrite: replace a study of other settings.
      progress: show a bar with running totals on stderr, where that is a terminal.

    Raises:
      InputError: a wrong argument, instances for other maps, or a folder that holds a study of other settings.
    """
    folder = Path(folder)
    for planner in (*planners, *distance_only):
        find_planner(planner)
    if workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    settings = Settings(
        cost_model, reference_length_m, connectivity, diagonal, float(budget_s), budget_iterations, seed
    )
    opened = maps if isinstance(maps, MetricMaps) else open_maps(maps, resolution_m)
    source = maps if isinstance(maps, MetricMaps) else Source(Path(maps).resolve(), opened.grid.resolution_m)
    if instances is None:
        instances = sample_instances(
            opened,
            num_instances,
            altitudes_m=altitudes_m,
            cover=cover,
            weights=weights,
            reference_length_m=reference_length_m,
            seed=seed,
        )
    _check_instances(instances, opened)
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


def _claim(folder: Path, settings: Settings, maps: MetricMaps, instances: pd.DataFrame, overwrite: bool) -> None:
    """Make the folder this study's, or raise InputError if it is another's."""
    told = asdict(settings) | {
        "maps": {name: str(maps.ds.attrs[name]) for name in ("crs", "resolution_m", "first_row", "first_col")}
        | {"run_key": str(maps.ds.attrs.get("run_key"))},
        "instances": hashlib.sha256(instances.to_csv(index=False).encode()).hexdigest()[:16],
    }
    file = folder / SETTINGS_FILE
    held = _held(file)
    if held is not None and held != told:
        if not overwrite:
            changed = next(name for name in {**held, **told} if held.get(name) != told.get(name))
            raise InputError(
                f"{str(folder)!r} holds a study with another {changed}: choose another folder, or pass --overwrite "
                "(overwrite=True) to replace it"
            )
        for old in (folder / "rows.parquet", *(folder / "parts").glob("*.json")):
            old.unlink(missing_ok=True)
    with whole_file(file) as scratch:
        scratch.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def _held(file: Path) -> dict[str, Any] | None:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{str(file)!r} cannot be read: remove the folder and run the study anew") from error
