"""Routes of a weight study on changed maps: of perturbed heights, and of other parameters of the metrics.

Maps are made again with heights drawn as well as they are known, and with each parameter of the metrics halved and
doubled.
"""

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from functools import lru_cache, partial
from itertools import chain, product
from pathlib import Path
from typing import Any

import jax
import pandas as pd

from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.tables import ROWS_FILE, RowStore, read_table
from jaxurban.maps.build import compute_maps
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.sources import scenario_of
from jaxurban.maps.task import MapTask
from jaxurban.maps.uncertain_heights import perturbed_cities
from jaxurban.paths.rows import Source, runs_to_do, solve_here
from jaxurban.progress import LOG, Report
from jaxurban.studies.weights.cities import Cities, in_order
from jaxurban.studies.weights.routes import (
    ROUTE_KEY,
    OnChangedMaps,
    SensitivityStudySettings,
    typed_columns,
)

PARAMETER_FACTORS = (0.5, 2.0)
# Changes of maps: the subfolder of their rows, and the columns that name one.
REMADE, PARAMETERS = "remade", "parameters"
CHANGES = {REMADE: ("draw",), PARAMETERS: ("parameter", "factor")}


def add_changed_rows(
    folder: Path,
    cities: Cities,
    instances: pd.DataFrame,
    scenarios: Mapping[str, Scenario] | None,
    report: Report,
) -> tuple[dict[str, pd.DataFrame], tuple[str, ...]]:
    """Make the rows of routes on changed maps that a study lacks, and keep them in its folder.

    Each changed map is made once, for all routes of its city. What is made is kept even if an error ends the call.

    Args:
      folder: of the study.
      cities: of the study; their settings say which changes are wanted.
      instances: its routes, with a column ``city``.
      scenarios: by city; for a city without one the record in the maps' folder names the sources.
      report: of the progress.

    Returns:
      The rows, by the name of the subfolder in which they are kept (`CHANGES`; none of changes that are not wanted),
      and sentences on maps that could not be made.
    """
    settings = cities.settings
    wanted = {REMADE: settings.num_heights, PARAMETERS: settings.has_parameters}
    stores = {
        kind: RowStore(folder / kind / ROWS_FILE, (*names, *ROUTE_KEY), has_parts=True)
        for kind, names in CHANGES.items()
        if wanted[kind]
    }

    # Rows are saved with all their columns, whatever happens.
    skipped = []
    try:
        for city, maps in cities.maps.items() if stores else ():
            try:
                task = _map_task(cities.sources[city], maps, (scenarios or {}).get(city))
            except InputError as error:
                LOG.warning(f"no other maps of {city} are made: {error}")
                skipped.append(f"{city}: {error}")
                continue
            of_city = instances[instances.city == city]
            nominal_at = lru_cache(maxsize=1)(partial(settings.cost_map, maps))
            for kind, change, changed in changed_tasks(task, settings, report, city):
                if isinstance(changed, InputError):  # a change that a metric refuses
                    skipped.append(f"{city}: {changed}")
                    continue

                # The maps are made only if a route lacks its row.
                job = OnChangedMaps(
                    nominal_at=nominal_at,
                    change=change,
                    cost_model=settings.cost_model,
                    constraints=settings.constraints,
                )
                lacking = runs_to_do(of_city, job, stores[kind])
                if lacking:
                    made = _made(changed).with_obstacles(maps.obstacles)
                    rows = solve_here(lacking, {city: made}, job)
                    stores[kind].add(list(chain.from_iterable(rows)))
    finally:
        for store in stores.values():
            store.save(typed_columns(store.rows))
    tables = {
        kind: in_order(read_table(store.file, "rows of changed maps"), cities.maps)
        for kind, store in stores.items()
    }
    return tables, tuple(skipped)


def _made(task: MapTask) -> MetricMaps:
    """Return the maps of a task; what is guessed of its city was said when the nominal maps were made."""
    check_fits(task)
    with warnings.catch_warnings(action="ignore", category=GuessWarning):
        return compute_maps(task)


def changed_tasks(
    task: MapTask, settings: SensitivityStudySettings, report: Report, city: str
) -> Iterator[tuple[str, dict[str, Any], MapTask | InputError]]:
    """Yield of each change of maps its kind, the columns that name it, and its task, or the error why there is none.

    Args:
      task: that made the maps as they are.
      settings: of the study: how often heights are drawn, by which seed, and whether parameters change.
      report: of the progress.
      city: of the maps, for the report.
    """
    plain = plain_task(task)
    std_m = task.params.heights.height_std_m
    draws = report.over(f"perturbed maps of {city}", range(settings.num_heights))
    cities = perturbed_cities(task.city, std_m, settings.num_heights, settings.seed)
    for draw, drawn in zip(draws, cities, strict=True):
        yield REMADE, {"draw": draw}, replace(plain, city=drawn)
    names = parameters_of(task) if settings.has_parameters else ()
    pairs = [*product(names, PARAMETER_FACTORS)]
    for name, factor in report.over(f"maps of other parameters of {city}", pairs):
        changed: MapTask | InputError
        try:
            changed = with_parameter(plain, name, factor)
        except InputError as error:
            changed = InputError(f"{name} x {factor:g}: {error}")
        yield PARAMETERS, {"parameter": name, "factor": factor}, changed


def plain_task(task: MapTask) -> MapTask:
    """Return a task of the metrics alone, without bounds and spreads."""
    params = task.params
    gps = replace(params.gps, bounds=False)
    heights = replace(params.heights, height_samples=0)
    return replace(
        task, params=replace(params, heights=heights, sections={**params.sections, "gps": gps})
    )


def parameters_of(task: MapTask) -> dict[str, float]:
    """Return every number that the metrics of a task have a gradient by, as ``{"lidar.range_m": 100.0}``.

    A user's own layers have none.
    """
    result: dict[str, float] = {}
    for name, metric in task.metrics.items():
        settings = task.settings_of(metric)
        if name not in task.layers and is_dataclass(settings):
            leaves, _ = jax.tree_util.tree_flatten_with_path(settings)
            result |= {f"{name}.{path[0].name}": float(value) for path, value in leaves}
    return result


def with_parameter(task: MapTask, parameter: str, factor: float) -> MapTask:
    """Return a task with one parameter multiplied by a factor.

    Args:
      task: stays as it is.
      parameter: a metric and its setting, as ``"lidar.range_m"`` (see `parameters_of`).
      factor: above 0.

    Raises:
      InputError: the metric cannot have such a value.
    """
    metric_name, name = parameter.split(".")
    metric = task.metrics[metric_name]
    settings = task.settings_of(metric)
    settings = replace(settings, **{name: factor * getattr(settings, name)})
    sections = {**task.params.sections, metric.section: settings}
    return replace(task, params=replace(task.params, sections=sections))


def _map_task(source: Source, maps: MetricMaps, scenario: Scenario | None) -> MapTask:
    """Return the task that makes the maps of a city, its sources read again.

    Args:
      source: of the maps, whose folder names the sources where there is no scenario.
      maps: the task makes the same grid and the same metrics.
      scenario: of the city, or None.

    Raises:
      InputError: sources that are unknown or gone, or those of other maps.
    """
    if scenario is None:
        if isinstance(source, MetricMaps):
            raise InputError(
                "maps in memory do not name their sources: give the scenario, or a folder of maps"
            )
        scenario = scenario_of(Path(source.folder))
    with warnings.catch_warnings(
        action="ignore", category=GuessWarning
    ):  # reported when the maps were made
        tasks = tasks_of(scenario)
    for task in tasks:
        if task.region == maps.grid and set(maps.metrics) == set(task.metrics):
            return task
    raise InputError(
        "the scenario makes other maps than these (another grid, or other metrics): give theirs"
    )
