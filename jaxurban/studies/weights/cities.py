"""The cities of a weight study: their maps opened, one set of rules for all, and the routes in each."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.tables import fingerprint
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights, WeightsLike, check_held
from jaxurban.paths.queries import WEIGHT_PREFIX, QueriesLike, read_queries, table_of
from jaxurban.paths.rows import MapsFolder, Source
from jaxurban.planners.cost import CostModel
from jaxurban.studies.montecarlo.sampling import (
    check_instances,
    checked_instances,
    instances_of_queries,
    sample_joined,
    weighed_metrics,
    weight_columns,
)
from jaxurban.studies.weights.routes import ROUTE_KEY, WeightsJob, varied_columns


class Cities(NamedTuple):
    """The cities of a study by name, and what holds for the routes of all.

    Attributes:
      sources: what workers open.
      maps: opened.
      job: with the cost model and the constraints of the maps' scenarios where the caller named none.
      weights: of sampled routes, and of those that name none.
    """

    sources: dict[str, Source]
    maps: dict[str, MetricMaps]
    job: WeightsJob
    weights: Weights

    @property
    def metrics(self) -> tuple[str, ...]:
        """The metrics that the maps of any city hold."""
        names = chain.from_iterable(maps.metrics for maps in self.maps.values())
        return tuple(dict.fromkeys(names))


def named_sources(sources: Any) -> dict[str, Source]:
    """Return the maps of each city by its name; maps in memory as they are, folders as `MapsFolder`.

    Args:
      sources: maps or folders by name, or one or several folders, which are called by their own names; maps in memory
        alone are called ``"maps"``.

    Raises:
      InputError: there is no city, two have one name, or several maps in memory have none.
    """
    if isinstance(sources, MetricMaps):
        sources = {"maps": sources}
    if isinstance(sources, str | Path | MapsFolder):
        sources = [sources]
    named = sources.items() if isinstance(sources, Mapping) else ((None, each) for each in sources)
    opened = []
    for name, source in named:
        if not isinstance(source, MetricMaps | MapsFolder):
            source = MapsFolder(source)
        if name is None:
            if isinstance(source, MetricMaps):
                raise InputError(
                    "maps in memory have no name: give them by name, as {'manhattan': maps}"
                )
            name = Path(source.folder).resolve().name
        opened.append((str(name), source))
    if not opened or len(dict(opened)) < len(opened):
        names = ", ".join(name for name, _ in opened) or "none"
        raise InputError(
            f"sources must be cities of different names, and one at least, got {names}: folders are called as they "
            "are, so name each once and rename one of two alike (in Python give {'name': folder})"
        )
    return dict(opened)


def open_cities(sources: Mapping[str, Source], job: WeightsJob, weights: WeightsLike) -> Cities:
    """Return the cities of a study, their maps opened.

    Args:
      sources: by the cities' names; at least one.
      job: of the study; the scenarios of the maps fill in what its rules leave out.
      weights: of sampled routes; None: those of the maps' scenarios.

    Raises:
      InputError: maps whose scenarios differ in what all routes share, or whose costs cannot be compared; a weight of a
        metric that no city has.
    """
    # By city: the source that workers open, the maps, and the rules (job and weights) under its own scenario.
    opened = {}
    all_maps = {}
    rules = {}
    for city, source in sources.items():
        maps = source if isinstance(source, MetricMaps) else source.open()
        maps, job_of_city = job.under(maps)
        all_maps[city] = maps
        opened[city] = maps if isinstance(source, MetricMaps) else source.at(maps)
        rules[city] = job_of_city, Weights.of(weights, maps.recorded.get("weights"))

    # One set of rules and comparable costs for all cities.
    first = next(iter(rules))
    for city, other in rules.items():
        if other != rules[first]:
            raise InputError(
                f"the scenarios of {first} and {city} give other weights, cost models, clearances or vehicles: name "
                "them for both (--weights, --rules), or make them the same"
            )
    common_job, common_weights = rules[first]
    resolutions_m = {maps.grid.resolution_m for maps in all_maps.values()}
    if CostModel.of(common_job.cost_model).kind == "cell" and len(resolutions_m) > 1:
        listed = ", ".join(f"{side_m:g} m" for side_m in sorted(resolutions_m))
        raise InputError(
            f"the maps have cells of {listed}, on which the 'cell' cost model costs differently: use cost_model='line'"
        )
    cities = Cities(opened, all_maps, common_job, common_weights)
    check_held(weights, cities.metrics)
    return cities


def routes_of_cities(
    cities: Cities, routes: QueriesLike | int, altitudes_m: Sequence[float] | None
) -> pd.DataFrame:
    """Return the routes of all cities as instances with a column ``city``.

    There is a column for the weight of every metric of any city, with 0 where a city lacks the metric.

    Args:
      cities: of the study.
      routes: a table of routes, pairs of places, or how many to sample in each city.
      altitudes_m: of sampled routes and of pairs; None: all that the maps hold.

    Raises:
      InputError: routes for other cities or maps, an invalid weight, or altitudes beside a table.
    """
    job = cities.job
    settings = job.settings
    weights = cities.weights.checked(cities.metrics).to_dict()
    if isinstance(routes, pd.DataFrame) and altitudes_m is not None:
        raise InputError(
            "altitudes_m is of sampled routes and of pairs: a table of routes names its own"
        )
    if not isinstance(routes, int | pd.DataFrame):  # pairs of places, at each of the altitudes
        first = next(iter(cities.maps.values()))
        altitudes = pd.DataFrame({"altitude_m": altitudes_m or first.altitudes_m})
        routes = table_of(routes).merge(altitudes, how="cross")
    if isinstance(routes, pd.DataFrame):
        _check_cities(routes, cities.maps)

    # The routes of each city: those of the table, or sampled ones.
    parts = []
    for number, (city, maps) in enumerate(cities.maps.items()):
        # A city may lack the layers of another one, and then has no weight for them.
        names = {"distance", *maps.metrics}
        of_city = Weights(**{name: weights[name] for name in weights if name in names})
        if isinstance(routes, pd.DataFrame):
            foreign = {WEIGHT_PREFIX + name for name in cities.metrics if name not in names}
            own = routes.assign(**dict.fromkeys(foreign & {*routes}, 0.0))
            part = _listed_routes(own, city, maps, of_city)
        else:
            part = sample_joined(
                maps,
                routes,
                altitudes_m=altitudes_m,
                weights=[of_city],
                cost_model=job.cost_model,
                constraints=job.constraints,
                seed=int(
                    np.random.SeedSequence(settings.seed, spawn_key=(number,)).generate_state(1)[0]
                ),
            )
        parts.append(part.assign(city=city))

    # One table with a column for each weight.
    table = pd.concat(parts, ignore_index=True)
    no_weights = dict.fromkeys(weight_columns(cities.metrics), 0.0)
    columns = dict.fromkeys([*table, *no_weights])
    table = table.reindex(columns=list(columns)).fillna(no_weights)

    # A weight that is 0 on some routes is no error here: the row of such a route says so.
    varied = ("distance", *cities.metrics)
    largest = table[[WEIGHT_PREFIX + name for name in varied]].max().to_numpy()
    varied_columns(varied, largest, settings.vary, " on every route")
    return table


def _listed_routes(
    routes: pd.DataFrame, city: str, maps: MetricMaps, weights: Weights
) -> pd.DataFrame:
    """Return the routes of a table that lie in a city, as instances.

    Args:
      routes: instances or queries; without a column ``city`` all of them lie in this one.
      city: its name.
      maps: of the city.
      weights: of queries that name none.

    Raises:
      InputError: a route that does not fit the maps, or an invalid weight.
    """
    part = routes
    if "city" in routes:
        # The routes of this city, without the weights of layers that only other cities have.
        weighed = weight_columns(weighed_metrics(routes.columns))
        foreign = set(weighed) - set(weight_columns(maps.metrics))
        part = routes[routes["city"].astype(str) == city].drop(columns=["city", *foreign])

    # Instances have a number; all else is a table of queries, in which the columns of other cities are empty.
    if "instance" in part:
        part = checked_instances(part, f"the instances of {city}")
    else:
        table = part.reset_index(drop=True).dropna(axis=1, how="all")
        queries = read_queries(table, weights=weights, metrics=maps.metrics)
        part = instances_of_queries(maps, queries)
    check_instances(part, maps)
    return part


def _check_cities(routes: pd.DataFrame, cities: Iterable[str]) -> None:
    """Raise InputError unless a table has routes of each city and of no other one.

    Args:
      routes: with a column ``city``, which may be missing where there is a single city.
      cities: names of the cities whose maps are there.
    """
    only, *others = cities
    named = routes.get("city", pd.Series("" if others else only, routes.index)).astype(str).unique()
    if {*named} != {only, *others}:
        names = ", ".join(filter(None, named)) or "none"
        raise InputError(
            f"the routes name the cities {names} (column 'city'), and the maps are of {', '.join([only, *others])}: "
            "give routes on all of the maps, and maps for all of the routes"
        )


def with_held_weights(instances: pd.DataFrame, maps: Mapping[str, MetricMaps]) -> pd.DataFrame:
    """Return instances in which the weight of a layer that a city lacks is that of the other cities.

    Args:
      instances: of a study.
      maps: of each city by its name.
    """
    columns = list(weight_columns(weighed_metrics(instances.columns)))
    weights = instances[columns].astype(float)
    for city, of_city in maps.items():
        held = ("distance", *of_city.metrics)
        lacking = [name for name in columns if name.removeprefix(WEIGHT_PREFIX) not in held]
        weights.loc[instances.city == city, lacking] = np.nan
    return instances.assign(**weights.fillna(weights.max()).fillna(0.0))


def shared_weights(instances: pd.DataFrame) -> Weights | None:
    """Return the weights that all instances share; None where they differ."""
    weights = instances[list(weight_columns(weighed_metrics(instances.columns)))]
    if len(weights.drop_duplicates()) > 1:
        return None
    return Weights(**weights.iloc[0].rename(lambda name: name.removeprefix(WEIGHT_PREFIX)))


def study_key(
    job: WeightsJob, maps: Mapping[str, MetricMaps], instances: pd.DataFrame
) -> dict[str, Any]:
    """Return what identifies a study in its folder: rules, weights, maps, and how many routes, with a digest."""
    weights: dict[str, float] = {}
    for city, of_city in instances.groupby("city"):
        shared = shared_weights(of_city)
        if shared is not None:
            weights |= {
                name: float(shared[name]) for name in ("distance", *maps[str(city)].metrics)
            }
    plain = instances.drop(columns="is_connected").sort_values(list(ROUTE_KEY))
    return job.to_dict() | {
        "maps": {city: each.identity for city, each in maps.items()},
        "order_of_cities": [*maps],
        "weights": weights,
        "routes": f"{len(plain)} ({fingerprint(plain.to_csv(index=False))})",
    }


def in_order(rows: pd.DataFrame, cities: Iterable[str]) -> pd.DataFrame:
    """Return rows, which are kept by the cities' names, in the order of the cities, on which their intervals depend."""
    if rows.empty:
        return rows
    order = pd.Categorical(rows["city"], [*cities])
    return rows.iloc[order.argsort(kind="stable")].reset_index(drop=True)
