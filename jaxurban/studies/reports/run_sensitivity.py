"""sensitivity: what weights do to one or many routes of one or several cities, kept in a folder and resumable."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Unpack

import pandas as pd

from jaxurban.checks import at_least, typed, values_given
from jaxurban.draw.write import save
from jaxurban.errors import InputError
from jaxurban.io.tables import INSTANCES_FILE, ROWS_FILE, records_of, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.choices import RulesChoice
from jaxurban.paths.places import snap_limit_m
from jaxurban.paths.queries import QueriesLike
from jaxurban.paths.rows import MapsFolder, check_workers, run_rows
from jaxurban.progress import Progress, reporting
from jaxurban.studies.reports.sensitivity import FILES, Sensitivity, sensitivity_report
from jaxurban.studies.weights.changed_maps import CHANGED_FOLDER, add_changed_rows
from jaxurban.studies.weights.cities import (
    in_order,
    named_sources,
    open_cities,
    routes_of_cities,
    study_key,
)
from jaxurban.studies.weights.one_route import one_route
from jaxurban.studies.weights.routes import WeightsJob, query_of, typed_columns
from jaxurban.studies.weights.settings import SensitivitySettings

ROUTES_FOLDER = "routes"


@typed
def sensitivity(
    sources: MetricMaps
    | Mapping[str, MetricMaps | MapsFolder | str | Path]
    | Sequence[MapsFolder | str | Path]
    | MapsFolder
    | str
    | Path,
    folder: str | Path | None = None,
    routes: QueriesLike | int = 30,
    *,
    altitudes_m: Sequence[float] | None = None,
    weights: WeightsLike = None,
    snap: bool | float = False,
    settings: SensitivitySettings | None = None,
    workers: int | str = 1,
    overwrite: bool = False,
    progress: Progress = True,
    **rules: Unpack[RulesChoice],
) -> Sensitivity:
    """Return what the weights do to one route, or to many of several altitudes and cities, with intervals.

    For each route and weight: its share of the cost (which is the gradient of the cost by the logarithm of the weight),
    the nearest breakpoints and the regret of a wrong weight; also how routes change at other times of the maps and, if
    asked, where heights are uncertain. A study of one route holds every route along the range of each weight, too.
    Rows are kept in ``folder`` as they come; the same call after any end, ``kill -9`` included, makes
    only what is missing. A route that fails is a row with its status.
    ``report.md`` there says first what is decided, what is not, and what to run next, beside tables and figures.

    Args:
      sources: maps, or their folder; or maps of each city by its name, folders or maps in memory (which only this
        process sees); or folders, called as they are. What is drawn depends on the seed and on the order of the cities,
        not on their names.
      folder: where the study is kept; left out, nowhere: the result is all there is.
      routes: pairs of start and goal, ``[((lon, lat), (lon, lat))]`` for one route; or a table of instances (see
        `sample_instances`) or of queries (as `plan_many` takes it), with a column ``city`` where there are several; or
        how many to sample in each city, by stratum and range, that a path joins at every altitude.
      altitudes_m: of sampled routes and of pairs; left out, all that the maps hold.
      weights: of sampled routes, and of those that name none; left out, those of the maps' scenarios, else `Weights()`.
      snap: move an end that is not free to the nearest free cell that is joined to the other one: False never, True by
        at most 50 m, a number by at most this many metres.
      settings: what is asked of every route, and on which changed maps.
      workers: processes of this machine, 1 works in this process; or the address of a Dask scheduler, whose workers see
        the maps' folders under the same paths.
      overwrite: replace a study of other settings or routes.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      cost_model, constraints, preset: of all routes, as in `jaxurban.plan`.

    Returns:
      `Sensitivity`: ``decided`` says what is decided, ``rows`` has a row per route, ``tables`` their summaries with
      intervals, by name, and ``route`` what only one route has.

    Raises:
      InputError: a wrong argument, routes for other maps, a single route whose end is not free, or a folder that holds
        another study or other files.

    Examples:
      >>> chosen = ju.studies.SensitivitySettings(vary=("gps",), seed=1)
      >>> result = ju.studies.sensitivity(
      ...     {"demo": maps}, "weights", 2, altitudes_m=[60.0], settings=chosen, progress=False
      ... )
      >>> result.rows[["city", "status", "elasticity:gps", "below:gps", "above:gps"]].round(2)
         city   status  elasticity:gps  below:gps  above:gps
      0  demo  optimal            0.07        NaN        NaN
      1  demo  optimal            0.07        NaN        NaN
    """
    # Check everything before anything is planned: sources, workers, routes and weights.
    settings = settings or SensitivitySettings()
    snap_limit_m(snap)
    sources_by_city = named_sources(sources)
    check_workers(workers, sources_by_city.values())
    _check_routes(routes, weights)
    job = WeightsJob(settings=settings, snap=snap, **values_given(rules))
    cities = open_cities(sources_by_city, job, weights)
    instances = routes_of_cities(cities, routes, altitudes_m)

    job = cities.job
    only = None  # the single route: its cost map and instance
    if len(instances) == 1:
        (instance,) = records_of(instances)
        (maps,) = cities.maps.values()
        at = instance["altitude_m"], instance["time"], instance["time_of_day"]
        only = job.cost_map(maps, *at), instance
        query_of(*only, snap)  # its ends are free

    # What identifies the study in its folder, and the files that it may write there.
    key = study_key(job, cities.maps, instances)
    folders = ROUTES_FOLDER, CHANGED_FOLDER
    names = [INSTANCES_FILE, *(f"{name}/{ROWS_FILE}" for name in folders), *FILES]
    place: Any
    if folder is None:
        place = TemporaryDirectory()
    else:
        folder = Path(folder)
        place = Workspace.open(folder, "sensitivity", key, names=names, overwrite=overwrite)
    with place, reporting("sensitivity", progress) as report:
        kept = folder or Path(place.name)
        write_table(instances, kept / INSTANCES_FILE)
        rows = run_rows(
            kept / ROUTES_FOLDER / ROWS_FILE,
            job,
            instances,
            cities.sources,
            typed_columns,
            workers=workers,
            report=report,
        )

        # The rows on changed maps and why some are missing, and what only one route has.
        changed, skipped = add_changed_rows(kept, cities, instances, report)
        route = None if only is None else one_route(*only, job, report)
        report("report")
        result = Sensitivity(
            folder=folder,
            maps=cities.maps,
            instances=instances,
            rows=in_order(rows, cities.maps),
            skipped=skipped,
            settings=settings,
            rules=job,
            is_sampled=isinstance(routes, int),
            changed=changed,
            route=route,
        )
        if folder is not None:
            save(kept, sensitivity_report(result).outputs)
    return result


def _check_routes(routes: QueriesLike | int, weights: WeightsLike) -> None:
    """Raise InputError where no route is to be sampled, or weights are given beside instances that have their own.

    Args:
      routes, weights: as in `sensitivity`.
    """
    if isinstance(routes, int):
        at_least("routes", routes, 1)
    if weights and isinstance(routes, pd.DataFrame) and "instance" in routes:
        raise InputError(
            "weights are of sampled routes and of queries: a table of instances has its own, so leave weights out"
        )
