"""sensitivity_study: what weights do to many routes of one or several cities, kept in a folder and resumable."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.tables import INSTANCES_FILE, ROWS_FILE, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.rows import MapsFolder, check_workers, run_rows
from jaxurban.progress import Progress, reporting
from jaxurban.report.sensitivity_study import FILES, SensitivityStudy, write_sensitivity_study
from jaxurban.studies.weights.changed_maps import CHANGES, add_changed_rows
from jaxurban.studies.weights.cities import (
    in_order,
    named_sources,
    open_cities,
    routes_key,
    routes_of_cities,
)
from jaxurban.studies.weights.routes import SensitivityStudySettings, typed_columns

ROUTES_FOLDER = "routes"


@typed
def sensitivity_study(
    sources: Mapping[str, MetricMaps | MapsFolder | str | Path]
    | Sequence[MapsFolder | str | Path]
    | str
    | Path,
    folder: str | Path,
    routes: pd.DataFrame | int = 30,
    *,
    altitudes_m: Sequence[float] | None = None,
    weights: WeightsLike = None,
    settings: SensitivityStudySettings | None = None,
    scenarios: Mapping[str, Scenario] | None = None,
    workers: int | str = 1,
    overwrite: bool = False,
    progress: Progress = True,
) -> SensitivityStudy:
    """Return what the weights do to many routes, at several altitudes and in several cities, with intervals.

    For each route and weight: its share of the cost (which is the gradient of the cost by the logarithm of the weight),
    the nearest breakpoints, the regret of a wrong weight, and Sobol shares of what the route is like; if asked
    also how routes change where heights are uncertain or a parameter of a metric is another one. Rows are kept in
    ``folder`` as they come; the same call after any end, ``kill -9`` included, makes only what is missing. A route that
    fails is a row with its status. ``report.md`` there says what the routes support and what not, beside tables and
    figures.

    Args:
      sources: maps of each city by its name, folders or maps in memory (which only this process sees); or folders,
        called as they are. What is drawn depends on the seed and on the order of the cities, not on their names.
      folder: where the study is kept.
      routes: how many to sample in each city, by stratum and range, that a path joins at every altitude; or a
        table of instances (see `sample_instances`) or of queries (as `plan_many` takes it), with a column ``city``
        where there are several.
      altitudes_m: of sampled routes; left out, all that the maps hold.
      weights: of sampled routes, and of those that name none; left out, those of the maps' scenarios, else `Weights()`.
      settings: what is asked of every route, and on which perturbed maps.
      scenarios: of cities whose maps are perturbed; left out, the record in their folder names the sources.
      workers: processes of this machine, 1 works in this process; or the address of a Dask scheduler, whose workers see
        the maps' folders under the same paths.
      overwrite: replace a study of other settings or routes.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `SensitivityStudy`: ``rows`` has a row per route, and ``tables`` their summaries with intervals, by name.

    Raises:
      InputError: a wrong argument, routes for other maps, or a folder that holds another study or other files.

    Examples:
      >>> chosen = ju.studies.SensitivityStudySettings(vary=("gps",), num_samples=0, seed=1)
      >>> result = ju.studies.sensitivity_study(
      ...     {"demo": maps}, "weights", 2, altitudes_m=[60.0], settings=chosen, progress=False
      ... )
      >>> result.rows[["city", "status", "elasticity:gps", "below:gps", "above:gps"]].round(2)
         city   status  elasticity:gps  below:gps  above:gps
      0  demo  optimal            0.07        NaN        NaN
      1  demo  optimal            0.07        NaN        NaN
    """
    # Check everything before anything is planned: sources, workers, routes and weights.
    folder = Path(folder)
    settings = settings or SensitivityStudySettings()
    sources_by_city = named_sources(sources)
    check_workers(workers, sources_by_city.values())
    _check_routes(routes, weights)
    if scenarios is not None and not (settings.num_heights or settings.has_parameters):
        raise InputError(
            "scenarios are for perturbed maps: leave them out, or set num_heights or has_parameters"
        )
    cities = open_cities(sources_by_city, settings, weights)
    instances = routes_of_cities(cities, routes, altitudes_m)

    # What identifies the study in its folder. With several processes each search has one thread.
    key = cities.settings.to_dict() | {
        "maps": {city: maps.identity for city, maps in cities.maps.items()},
        "order_of_cities": [*cities.maps],
        "routes": routes_key(instances),
    }
    job = cities.settings
    if workers != 1 and job.num_threads is None:
        job = replace(job, num_threads=1)

    # The files that the study may write into its folder, and the rows of all routes.
    folders = ROUTES_FOLDER, *CHANGES
    names = [INSTANCES_FILE, *(f"{name}/{ROWS_FILE}" for name in folders), *FILES]
    with (
        Workspace.open(folder, "sensitivity-study", key, names=names, overwrite=overwrite),
        reporting("sensitivity", progress) as report,
    ):
        write_table(instances, folder / INSTANCES_FILE)
        rows = run_rows(
            folder / ROUTES_FOLDER / ROWS_FILE,
            job,
            instances,
            cities.sources,
            typed_columns,
            workers=workers,
            report=report,
        )

        # The rows on perturbed maps and on maps of other parameters, by their subfolder, and why some are missing.
        changed, skipped = add_changed_rows(folder, cities, instances, scenarios, report)
        report("report")
        result = SensitivityStudy(
            folder=folder,
            maps=cities.maps,
            instances=instances,
            rows=in_order(rows, cities.maps),
            skipped=skipped,
            settings=cities.settings,
            is_sampled=isinstance(routes, int),
            **changed,
        )
        write_sensitivity_study(result)
    return result


def _check_routes(routes: pd.DataFrame | int, weights: WeightsLike) -> None:
    """Raise InputError where no route is to be sampled, or weights are given beside instances that have their own.

    Args:
      routes, weights: as in `sensitivity_study`.
    """
    if isinstance(routes, int) and routes < 1:
        raise InputError(
            f"routes must be how many to sample in each city, at least 1, or a table of them, got {routes!r}"
        )
    if weights and isinstance(routes, pd.DataFrame) and "instance" in routes:
        raise InputError(
            "weights are of sampled routes and of queries: a table of instances has its own, so leave weights out"
        )
