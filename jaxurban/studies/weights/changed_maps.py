"""Routes of a weight study on changed maps: of perturbed heights, and of other parameters of the metrics."""

import warnings
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

import pandas as pd

from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.tables import ROWS_FILE, RowStore, read_table
from jaxurban.maps.build import compute_maps
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import tasks_of as maps_tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.sources import scenario_of
from jaxurban.maps.task import MapTask
from jaxurban.paths.rows import Source, solve_here, tasks_of
from jaxurban.progress import LOG, Report
from jaxurban.studies.weights.cities import Cities, in_order
from jaxurban.studies.weights.routes import OnOtherParameters, OnPerturbedMaps, row_columns


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
      The rows, by the name of the subfolder in which they are kept (empty where no change is wanted), and sentences on
      maps that could not be made.
    """
    # A store for each kind of change that is wanted.
    wanted = {
        OnPerturbedMaps: cities.settings.num_heights > 0,
        OnOtherParameters: cities.settings.has_parameters,
    }
    stores = {
        kind: RowStore(folder / kind.folder / ROWS_FILE, kind.key, has_parts=True)
        for kind, is_wanted in wanted.items()
        if is_wanted
    }

    # Rows are saved with all their columns, whatever happens.
    skipped = []
    try:
        for city in cities.maps if stores else ():
            of_city = instances[instances.city == city]
            scenario = (scenarios or {}).get(city)
            reasons = _add_city(stores, city, cities, of_city, scenario, report)
            skipped += [f"{city}: {reason}" for reason in reasons]
    finally:
        for store in stores.values():
            store.save(row_columns(store.rows))
    tables = {
        kind.folder: in_order(read_table(store.file, "rows of changed maps"), cities.maps)
        for kind, store in stores.items()
    }
    return tables, tuple(skipped)


def _add_city(
    stores: dict[type[OnPerturbedMaps], RowStore],
    city: str,
    cities: Cities,
    instances: pd.DataFrame,
    scenario: Scenario | None,
    report: Report,
) -> list[InputError]:
    """Add the rows of a city's routes on its changed maps to the stores, and return why some maps are not made.

    Args:
      stores: by kind of change; those that lack rows of the city get them.
      city: its name.
      cities: of the study.
      instances: the routes in this city.
      scenario: of the city; None: the record of its maps names the sources.
      report: of the progress.
    """
    maps = cities.maps[city]
    settings = cities.settings
    try:
        task = _map_task(cities.sources[city], maps, scenario)
    except InputError as error:
        LOG.warning(f"no other maps of {city} are made: {error}")
        return [error]
    errors = []
    for kind, store in stores.items():
        stage = f"{kind.called} of {city}"
        changes = kind.changes(task, settings)
        tasks = kind.tasks(task, settings)
        for number, (change, changed) in enumerate(zip(changes, tasks, strict=True)):
            report(stage, number, len(changes))
            if isinstance(changed, InputError):  # a change that a metric refuses
                errors.append(changed)
                continue

            # The maps are made only if a route lacks its row.
            job = kind(
                nominal=maps,
                change=change,
                cost_model=settings.cost_model,
                constraints=settings.constraints,
            )
            lacking = tasks_of(instances, job, store)
            if lacking:
                check_fits(changed)
                with warnings.catch_warnings(action="ignore", category=GuessWarning):
                    changed_maps = compute_maps(changed)
                rows = solve_here(lacking, {city: changed_maps.with_obstacles(maps.obstacles)}, job)
                store.add(list(chain.from_iterable(rows)))
        report(stage, len(changes), len(changes))
    return errors


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
        tasks = maps_tasks_of(scenario)
    for task in tasks:
        if task.region == maps.grid and set(maps.metrics) == set(task.metrics):
            return task
    raise InputError(
        "the scenario makes other maps than these (another grid, or other metrics): give theirs"
    )
