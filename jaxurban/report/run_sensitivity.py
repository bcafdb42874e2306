"""sensitivity_study: what weights do to many routes of one or several cities, kept in a folder and resumable."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.checks import one_of, typed
from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.tables import (
    INSTANCES_FILE,
    ROWS_FILE,
    RowStore,
    fingerprint,
    read_table,
    write_table,
)
from jaxurban.io.workspace import Workspace
from jaxurban.maps.build import compute_maps
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import tasks_of as maps_tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import Weights, WeightsLike
from jaxurban.paths.queries import WEIGHT_PREFIX, read_queries
from jaxurban.paths.rows import MapsFolder, Source, check_workers, run_rows, solve_here, tasks_of
from jaxurban.planners.cost import CostModel
from jaxurban.progress import LOG, Progress, Report, reporting
from jaxurban.report.buildings import scenario_of
from jaxurban.report.sensitivity_study import FILES, SensitivityStudy, write_sensitivity_study
from jaxurban.studies.montecarlo.sampling import (
    check_instances,
    checked_instances,
    instances_of_queries,
    sample_joined,
    weighed_metrics,
    weight_columns,
)
from jaxurban.studies.weights.routes import (
    CITY_NUMBER,
    ROUTE_KEY,
    OnOtherParameters,
    OnPerturbedMaps,
    SensitivityStudySettings,
    row_columns,
    seed_at,
)

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
      `SensitivityStudy`: ``rows`` has a row a route, and ``tables`` their summaries with intervals, by name.

    Raises:
      InputError: a wrong argument, routes for other maps, or a folder that holds another study or other files.

    Examples:
      >>> chosen = ju.studies.SensitivityStudySettings(vary=("gps",), num_samples=0, seed=1)
      >>> result = ju.studies.sensitivity_study(
      ...     {"demo": maps}, "weights", 2, altitudes_m=[60.0], settings=chosen, progress=False
      ... )
      >>> result.rows[["city", "status", "elasticity:gps", "below:gps", "above:gps"]].round(2)
         city   status  elasticity:gps  below:gps  above:gps
      0  demo  optimal            0.08       0.88        NaN
      1  demo  optimal            0.08        NaN       4.19
    """
    folder, settings, given = (
        Path(folder),
        settings or SensitivityStudySettings(),
        named_sources(sources),
    )
    check_workers(workers, given.values())
    if isinstance(routes, int) and routes < 1:
        raise InputError(
            f"routes must be how many to sample in each city, at least 1, or a table of them, got {routes!r}"
        )
    opened, settings, weights = _opened(given, settings, weights)
    instances = _instances(opened, routes, altitudes_m, weights, settings)
    _check_vary(
        settings.vary,
        instances,
        dict.fromkeys(name for maps in opened.values() for name in maps.metrics),
    )
    about = {city: maps.identity for city, maps in opened.items()}
    key = settings.to_dict() | {
        "maps": about,
        "order_of_cities": [*about],
        "routes": _routes_key(instances),
    }
    job = (
        settings
        if workers == 1 or settings.num_threads is not None
        else replace(settings, num_threads=1)
    )
    folders = ROUTES_FOLDER, OnPerturbedMaps.folder, OnOtherParameters.folder
    names = [INSTANCES_FILE, *(f"{name}/{ROWS_FILE}" for name in folders), *FILES]
    with (
        Workspace.open(folder, "sensitivity-study", key, names=names, overwrite=overwrite),
        reporting("sensitivity", progress) as report,
    ):
        write_table(instances, folder / INSTANCES_FILE)
        file = folder / ROUTES_FOLDER / ROWS_FILE
        rows = _by_city(
            run_rows(file, job, instances, given, row_columns, workers=workers, report=report),
            opened,
        )
        changed, skipped = _remade(folder, instances, given, opened, settings, scenarios, report)
        report("report")
        is_sampled = not isinstance(routes, pd.DataFrame)
        remade, parameters = (changed.get(name, pd.DataFrame()) for name in folders[1:])
        how = remade, skipped, settings, is_sampled, parameters
        result = SensitivityStudy(folder, opened, instances, rows, *how)
        write_sensitivity_study(result)
    return result


def _by_city(rows: pd.DataFrame, cities: Iterable[str]) -> pd.DataFrame:
    """Return rows, which are kept by the cities' names, in the order of the cities, on which their intervals depend."""
    if rows.empty:
        return rows
    order = {city: number for number, city in enumerate(cities)}
    return rows.sort_values(
        "city", key=lambda names: names.map(order), kind="stable", ignore_index=True
    )


def _opened(
    sources: dict[str, Source], settings: SensitivityStudySettings, weights: WeightsLike
) -> tuple[dict[str, MetricMaps], SensitivityStudySettings, WeightsLike]:
    """Return the maps of each city, and the settings and weights that hold for all; name in ``given`` what is opened.

    Raises:
      InputError: maps whose scenarios differ in what all routes share, or whose costs cannot be compared.
    """
    opened, rules = dict[str, MetricMaps](), dict[str, Any]()
    for city, source in sources.items():
        maps = source if isinstance(source, MetricMaps) else source.open()
        opened[city], job = settings.under(maps)
        rules[city] = job, Weights.of(weights, maps.recorded.get("weights"))
        sources[city] = opened[city] if isinstance(source, MetricMaps) else source.at(opened[city])
    (first, (settings, weights)), *others = rules.items()
    for city, other in others:
        if other != rules[first]:
            raise InputError(
                f"the scenarios of {first} and {city} give other weights, cost models, clearances or vehicles: name "
                "them for both (--weights, --cost-model, --clearance, --vertical-clearance), or make them the same"
            )
    resolutions = {maps.grid.resolution_m for maps in opened.values()}
    if CostModel.of(settings.cost_model).kind == "cell" and len(resolutions) > 1:
        listed = ", ".join(f"{each:g} m" for each in sorted(resolutions))
        raise InputError(
            f"the maps have cells of {listed}, on which the 'cell' cost model costs differently: use cost_model='line'"
        )
    return opened, settings, weights


def named_sources(sources: Any) -> dict[str, Source]:
    """Return the maps of each city by its name: folders as `MapsFolder`.

    Raises:
      InputError: none, or two of one name.
    """
    if isinstance(sources, Mapping):
        listed = [(str(name), source) for name, source in sources.items()]
    else:
        several = [sources] if isinstance(sources, str | Path | MapsFolder) else list(sources)
        if any(isinstance(source, MetricMaps) for source in several):
            raise InputError(
                "maps in memory have no name: give them by name, as {'manhattan': maps}"
            )
        folders = [
            source.folder if isinstance(source, MapsFolder) else source for source in several
        ]
        listed = [
            (Path(each).resolve().name, source)
            for each, source in zip(folders, several, strict=True)
        ]
    names = [name for name, _ in listed]
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"sources must be cities of different names, and one at least, got {', '.join(names) or 'none'}: folders "
            "are called as they are, so name each once and rename one of two alike (in Python give {'name': folder})"
        )
    result: dict[str, Source] = {}
    for name, source in listed:
        result[name] = source if isinstance(source, MetricMaps | MapsFolder) else MapsFolder(source)
    return result


def _routes_key(instances: pd.DataFrame) -> str:
    plain = instances.drop(columns="is_connected").sort_values(list(ROUTE_KEY))
    return f"{len(plain)} ({fingerprint(plain.to_csv(index=False))})"


def _instances(
    opened: Mapping[str, MetricMaps],
    routes: pd.DataFrame | int,
    altitudes_m: Sequence[float] | None,
    weights: WeightsLike,
    settings: SensitivityStudySettings,
) -> pd.DataFrame:
    """Return the routes of all cities as instances with a column ``city``."""
    model, constraints = settings.cost_model, settings.constraints
    metrics = dict.fromkeys(name for maps in opened.values() for name in maps.metrics)
    of_all = Weights.of(weights).checked(metrics).to_dict()
    if isinstance(routes, pd.DataFrame):
        _check_cities(routes, opened)
    parts = []
    for number, (city, maps) in enumerate(opened.items()):
        known = {"distance", *METRICS, *maps.metrics}  # a city may lack the layers of another one
        weights = Weights(**{name: value for name, value in of_all.items() if name in known})
        if not isinstance(routes, pd.DataFrame):
            seed = seed_at(settings.seed, number)
            how: dict[str, Any] = {"cost_model": model, "constraints": constraints, "seed": seed}
            part = sample_joined(maps, routes, altitudes_m=altitudes_m, weights=[weights], **how)
        else:
            part = _given_routes(routes, city, maps, weights)
        parts.append(part.assign(city=city, **{CITY_NUMBER: number}))
    if isinstance(routes, pd.DataFrame) and altitudes_m is not None:
        raise InputError("altitudes_m is of sampled routes: a table of routes names its own")
    result = pd.concat(parts, ignore_index=True)
    columns = weight_columns(metrics)
    return result.reindex(
        columns=[*result.columns, *(c for c in columns if c not in result)]
    ).fillna(dict.fromkeys(columns, 0.0))


def _check_vary(vary: Sequence[str], instances: pd.DataFrame, names: Iterable[str]) -> None:
    """Check that every weight to vary counts on one route at least; each route names those that do not on it."""
    names = tuple(names)
    counted = [
        name for name in ("distance", *names) if (instances[f"{WEIGHT_PREFIX}{name}"] > 0).any()
    ]
    if not vary and not set(names) & set(counted):
        raise InputError(
            "every metric has weight 0 on every route, so nothing varies: give one a weight above 0"
        )
    for name in vary:
        if one_of("a weight that varies", name, ("distance", *names)) not in counted:
            raise InputError(
                f"weight {name} is 0 on every route, which no factor changes: give it a value above 0, or do not vary "
                "it"
            )


def _check_cities(routes: pd.DataFrame, cities: Iterable[str]) -> None:
    """Check that a table has routes, all of them of the cities whose maps are there, and some of each."""
    cities = tuple(cities)
    if routes.empty:
        raise InputError("the table of routes has no rows: give at least one route")
    if "city" not in routes:
        if len(cities) > 1:
            raise InputError(
                "the routes lack the column 'city', which says on which of the maps each lies: add it"
            )
        return
    named = dict.fromkeys(map(str, routes["city"]))
    if strange := [name for name in named if name not in cities]:
        raise InputError(
            f"the routes name the city {strange[0]!r}, and the maps are of {', '.join(cities)}: add its maps, or leave "
            "its routes out"
        )
    if lost := [city for city in cities if city not in named]:
        raise InputError(
            f"the routes hold none of the city {lost[0]!r}: add some, or leave its maps out"
        )


def _given_routes(
    routes: pd.DataFrame, city: str, maps: MetricMaps, weights: WeightsLike
) -> pd.DataFrame:
    part = routes
    if "city" in routes:
        others = set(weight_columns(weighed_metrics(routes.columns))) - set(
            weight_columns(maps.metrics)
        )
        part = routes[routes["city"].astype(str) == city].drop(columns=["city", *others])
    if "instance" in part:
        part = checked_instances(part, f"the instances of {city}")
    else:
        queries = part.reset_index(drop=True).dropna(axis=1, how="all")
        part = instances_of_queries(
            maps, read_queries(queries, weights=weights, metrics=maps.metrics)
        )
    check_instances(part, maps)
    return part


def _remade(
    folder: Path,
    instances: pd.DataFrame,
    sources: Mapping[str, Source],
    opened: Mapping[str, MetricMaps],
    settings: SensitivityStudySettings,
    scenarios: Mapping[str, Scenario] | None,
    report: Report,
) -> tuple[dict[str, pd.DataFrame], tuple[str, ...]]:
    """Return the rows of routes on changed maps by what was changed, and why some were not made.

    Whole maps at a time are kept.
    """
    is_asked = {
        OnPerturbedMaps: settings.num_heights > 0,
        OnOtherParameters: settings.has_parameters,
    }
    stores = {
        kind: RowStore(folder / kind.folder / ROWS_FILE, kind.key, has_parts=True)
        for kind in is_asked
        if is_asked[kind]
    }
    rules: dict[str, Any] = {"cost_model": settings.cost_model, "constraints": settings.constraints}
    skipped = []
    try:
        for city, maps in opened.items() if stores else ():
            try:
                task = _map_task(city, sources[city], maps, scenarios)
            except InputError as error:
                skipped.append(f"{city}: {error}")
                LOG.warning(f"no other maps of {city} are made: {error}")
                continue
            of_city = instances[instances.city == city]
            for kind, store in stores.items():
                stage, changes = f"{kind.called} of {city}", kind.changes(task, settings)
                for number, (change, other) in enumerate(
                    zip(changes, kind.tasks(task, settings), strict=True)
                ):
                    report(stage, number, len(changes))
                    if isinstance(other, InputError):
                        skipped.append(f"{city}: {other}")
                        continue
                    job = kind(nominal=maps, change=change, **rules)
                    if left := tasks_of(of_city, job, store):
                        perturbed = _made(other).with_obstacles(maps.obstacles)
                        store.add(
                            [
                                row
                                for rows in solve_here(left, {city: perturbed}, job)
                                for row in rows
                            ]
                        )
                report(stage, len(changes), len(changes))
    finally:
        for store in stores.values():
            store.save(row_columns(store.rows))
    tables = {
        kind.folder: read_table(store.file, "rows of changed maps")
        for kind, store in stores.items()
    }
    return {name: _by_city(rows, opened) for name, rows in tables.items()}, tuple(skipped)


def _made(task: MapTask) -> MetricMaps:
    """Return the maps of a task whose guesses were reported when the nominal maps were made."""
    check_fits(task)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessWarning)
        return compute_maps(task)


def _map_task(
    city: str, source: Source, maps: MetricMaps, scenarios: Mapping[str, Scenario] | None
) -> MapTask:
    """Return what the maps of a city are made of, its sources read again.

    Raises:
      InputError: they are not told or found, or are not those of these maps.
    """
    scenario = (scenarios or {}).get(city)
    if scenario is None:
        if isinstance(source, MetricMaps):
            raise InputError(
                "maps in memory do not name their sources: give the scenario, or a folder of maps"
            )
        scenario = scenario_of(Path(source.folder))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessWarning)  # reported when the maps were made
        tasks = maps_tasks_of(scenario)
    task = next((task for task in tasks if task.region == maps.grid), None)
    if task is None or not set(maps.metrics) == set(task.metrics):
        raise InputError(
            "the scenario makes other maps than these (another grid, or other metrics): give theirs"
        )
    return task
