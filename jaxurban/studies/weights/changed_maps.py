"""Routes of a weight study on changed maps: of other times, which are there, and of heights drawn as they are known."""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.tables import ROWS_FILE, RowStore, read_table
from jaxurban.maps.build import compute_maps
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import tasks_of
from jaxurban.maps.sources import scenario_of
from jaxurban.maps.task import MapTask
from jaxurban.maps.uncertain_heights import perturbed_cities
from jaxurban.paths.rows import Source, runs_to_do, solve_here
from jaxurban.progress import LOG, Report
from jaxurban.studies.map_comparison import SAME
from jaxurban.studies.weights.cities import Cities, in_order
from jaxurban.studies.weights.routes import (
    ROUTE_KEY,
    OnChangedMaps,
    typed_columns,
)
from jaxurban.studies.weights.settings import SensitivitySettings
from jaxurban.studies.weights.summary import HEIGHTS

# The columns that name changed maps: what is changed, and which of several such maps it is, from 0.
CHANGE = ("change", "draw")
CHANGED_FOLDER = "changed"  # of the rows
MakeMaps = Callable[[], MetricMaps]


def add_changed_rows(
    folder: Path,
    cities: Cities,
    instances: pd.DataFrame,
    report: Report,
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Make the rows of routes on changed maps that a study lacks, and keep them in its folder.

    Each changed map is made once, for all routes of its city. What is made is kept even if an error ends the call.

    Args:
      folder: of the study.
      cities: of the study; the settings of their job say which changes are wanted.
      instances: its routes, with a column ``city``.
      report: of the progress.

    Returns:
      The rows, and sentences on maps that could not be made.
    """
    job = cities.job
    store = RowStore(folder / CHANGED_FOLDER / ROWS_FILE, (*CHANGE, *ROUTE_KEY), has_parts=True)

    # Rows are saved with all their columns, whatever happens.
    skipped = []
    try:
        for city, maps in cities.maps.items():
            of_city = instances[instances.city == city]
            nominal_at = lru_cache(maxsize=1)(partial(job.cost_map, maps))
            changes = changed_maps(city, cities.sources[city], maps, job.settings, report)
            for change, draw, make in changes:
                if isinstance(make, InputError):  # lost sources, or the same maps
                    skipped.append(f"{city}: {make}")
                    continue

                # The maps are made only if a route lacks its row.
                on_changed = OnChangedMaps(
                    nominal_at=nominal_at,
                    change=dict(zip(CHANGE, (change, draw), strict=True)),
                    layers=",".join(differing_layers(maps, change, draw)),
                    snap=job.snap,
                    cost_model=job.cost_model,
                    constraints=job.constraints,
                )
                lacking = runs_to_do(of_city, on_changed, store)
                if lacking:
                    made = make().with_obstacles(maps.obstacles)
                    rows = solve_here(lacking, {city: made}, on_changed)
                    store.add(list(chain.from_iterable(rows)))
    finally:
        if len(store):
            store.save(typed_columns(store.rows))
    if not len(store):
        return pd.DataFrame(), tuple(skipped)
    return in_order(read_table(store.file, "rows of changed maps"), cities.maps), tuple(skipped)


def changed_maps(
    city: str,
    source: Source,
    maps: MetricMaps,
    settings: SensitivitySettings,
    report: Report,
) -> Iterator[tuple[str, int, MakeMaps | InputError]]:
    """Yield of each change of maps its name and number (`CHANGE`), and what makes them, or the error why none does.

    The first ones are the maps themselves with the times, or the times of day, of one dimension moved on by one or
    more, so that each time has the map of another one; where this changes no layer, none is made, and where no time
    has another map than the others, the error says so.

    Args:
      city: of the maps, for the report.
      source: of the maps, whose folder names the sources.
      maps: as they are.
      settings: of the study: how often heights are drawn, and by which seed.
      report: of the progress.
    """
    for name in ("time", "time_of_day"):
        steps = range(1, maps.ds.sizes.get(name, 1))
        differing = [step for step in steps if differing_layers(maps, name, step)]
        if steps and not differing:
            which = name.replace("_", " ")
            yield (
                name,
                0,
                InputError(f"the maps of each {which} are the same: nothing was compared"),
            )
        for step in differing:
            yield name, step, partial(_moved_on, maps, name, step)
    if not settings.num_heights:
        return
    try:
        task = _map_task(source, maps)
    except InputError as error:
        LOG.warning(f"no other maps of {city} are made: {error}")
        yield "", 0, error
        return

    plain = plain_task(task)
    std_m = task.params.heights.height_std_m
    draws = report.over(f"perturbed maps of {city}", range(settings.num_heights))
    cities = perturbed_cities(task.city, std_m, settings.num_heights, settings.height_seed)
    for draw, drawn in zip(draws, cities, strict=True):
        yield HEIGHTS, draw, partial(_made, replace(plain, city=drawn))


def _moved_on(maps: MetricMaps, name: str, step: int) -> MetricMaps:
    """Return maps in which each of the times of a dimension has the map of the one that comes ``step`` after it."""
    order = np.roll(np.arange(maps.ds.sizes[name]), -step)
    return replace(maps, ds=maps.ds.isel({name: order}).assign_coords({name: maps.ds[name]}))


def differing_layers(maps: MetricMaps, name: str, step: int) -> list[str]:
    """Return the metrics whose maps differ, by more than `SAME`, where times are moved on (`_moved_on`).

    There are none of heights.
    """
    if name == HEIGHTS:
        return []
    moved = _moved_on(maps, name, step)
    variables = {metric: maps.variable(metric) for metric in maps.metrics}
    return [
        metric
        for metric, variable in variables.items()
        if not np.allclose(maps.ds[variable], moved.ds[variable], SAME, SAME, equal_nan=True)
    ]


def _made(task: MapTask) -> MetricMaps:
    """Return the maps of a task; what is guessed of its city was said when the nominal maps were made."""
    check_fits(task)
    with warnings.catch_warnings(action="ignore", category=GuessWarning):
        return compute_maps(task)


def plain_task(task: MapTask) -> MapTask:
    """Return a task of the metrics alone, without bounds and spreads."""
    params = task.params
    gps = replace(params.gps, bounds=False)
    heights = replace(params.heights, height_samples=0)
    return replace(
        task, params=replace(params, heights=heights, sections={**params.sections, "gps": gps})
    )


def _map_task(source: Source, maps: MetricMaps) -> MapTask:
    """Return the task that makes the maps of a city, its sources read again.

    Args:
      source: of the maps, whose folder names the sources.
      maps: the task makes the same grid and the same metrics.

    Raises:
      InputError: sources that are unknown or gone, or those of other maps.
    """
    if isinstance(source, MetricMaps):
        raise InputError("maps in memory do not name their sources: give a folder of maps")
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
