"""Routes for a fit: planned paths and lines of files as they are, and tables of ends, whose routes are planned here."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd

from jaxurban.checks import finite, typed, values_given
from jaxurban.errors import InputError, OtherSettingsWarning, SkippedRouteWarning, warn
from jaxurban.io.routes import Route, read_routes
from jaxurban.io.tables import Row, is_table, read_table, records_of
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.weights import Weights, weights_on
from jaxurban.paths.choices import RulesChoice
from jaxurban.paths.constraints import describe_constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.queries import WEIGHT_PREFIX, read_queries
from jaxurban.paths.rows import RouteRules
from jaxurban.planners.cost import CostModel
from jaxurban.settings import iso_utc
from jaxurban.studies.demonstrations import Demonstration, demonstration_from_line
from jaxurban.studies.montecarlo.sampling import (
    as_columns,
    check_instances,
    checked_instances,
    instances_of_queries,
)
from jaxurban.studies.queries import weights_from
from jaxurban.studies.weights.routes import query_of

ALIKE = 1e-9  # relative: weights of rows, scaled to sum 1, that are one W
STARTS = {"start_lon", "start_x_m"}  # one of them is a column of every table of routes
MOST_REASONS = 3  # in an error or a warning

MapOf = Callable[[float, str | None, str | None], CostMap]  # of altitude, time and time of day
Line = tuple[str, Route, np.ndarray]  # what messages call it, what is known of it, [N, 2] metres


@typed
def demonstrations(
    routes: PlannedPath | Sequence[PlannedPath] | pd.DataFrame | str | Path,
    maps: MapsLike,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    *,
    pilot: Weights | None = None,
    metrics: Sequence[str] | None = None,
    **rules: Unpack[RulesChoice],
) -> list[Demonstration]:
    """Return routes as demonstrations of how a pilot weighs the metrics; lists of several may be joined with ``+``.

    **Planned paths and lines of files** are not planned again, but followed on the grid. Ends in closed cells move to
    free cells by at most 50 m. **Tables** hold ends: instances (`jaxurban.studies.sample_instances`, the
    ``instances.parquet`` of a study) or queries (`plan_many`). A* plans their routes, each under the weights of its
    row. Routes by day and by night go together there, since one W planned them all. Routes of no use are left out, with
    a warning that says which and why.

    Args:
      routes: one or several paths, from `plan`; or a table; or the file of a table (.csv, .parquet); or a file with
        LineStrings (GeoJSON, KML, GPX or another vector file).
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      altitude_m, time, time_of_day: of every route, in metres above the ground and UTC. Left out, the route's own
        count (paths that jaxurban wrote carry them), and without one the maps' first time. An altitude must be known.
      pilot: weights under which the routes of a table are planned, instead of those of its rows.
      cost_model: of every route; left out, the one under which jaxurban's own paths were planned.
      constraints: no-fly zones, bounds and clearances, as in `plan`, of which no file or path carries the zones.
      preset: as in `plan`; gives the cost model where no route names one.
      metrics: the metrics whose weights are to be fitted; all if left out.

    Returns:
      A `Demonstration` per route that is of use, in their order; ``note`` says what had to be done to a line.

    Raises:
      InputError: no route that is of use, a wrong table, one under different weights (without a pilot), a pilot of
        lines, or paths that were planned under different cost models.

    Examples:
      >>> back = ju.plan(maps, goal, start, altitude_m=60.0)
      >>> routes = ju.fit.demonstrations([path, back], maps, metrics=["gps", "lidar"])
      >>> [each.query.start for each in routes], routes[0].query.names
      ([(2, 2), (27, 27)], ('distance', 'gps', 'lidar'))
      >>> (flown,) = ju.fit.demonstrations(path.save("flown.geojson"), maps)
      >>> flown.query.name, flown.query.cost_map.altitude_m, flown.points_m.shape
      ('1', 60.0, (38, 2))
      >>> instances = ju.studies.sample_instances(maps, 4, altitudes_m=[60.0])
      >>> planned = ju.fit.demonstrations(instances, maps, pilot=ju.Weights(risk=5.0))
      >>> [each.query.name for each in planned]
      ['0', '1', '2', '3']
    """
    # What every route has, and what messages call the routes.
    maps = as_maps(maps)
    at = values_given({"altitude_m": altitude_m, "time_of_day": time_of_day})
    if altitude_m is not None:
        at["altitude_m"] = finite("altitude_m", altitude_m)
    if time is not None:
        at["time"] = iso_utc(time)
    source = "the routes"
    if isinstance(routes, str | Path):
        source = repr(str(routes))
        if is_table(routes):
            routes = read_table(routes, "instances")

    # A table is planned; all else are lines.
    if isinstance(routes, pd.DataFrame):
        table = routes.assign(**at)
        if "instance" in table and "altitude_m" in at:
            table = table.drop_duplicates("instance")  # which stood there for each altitude
        return _kept(source, _planned(source, table, maps, pilot, metrics, rules))
    if pilot is not None:
        raise InputError(
            f"a pilot plans the routes of tables and sampled instances, and {source} are lines: leave the pilot out "
            "(--pilot, pilot=)"
        )
    lines = list(_lines(routes, maps))
    map_of = _fitted(_cost_maps(maps, lines, rules), metrics)
    followed = (
        (label, partial(_followed, replace(route, **at), xy_m, map_of))
        for label, route, xy_m in lines
    )
    return _kept(source, followed)


def _kept(
    source: str, routes: Iterator[tuple[str, Callable[[], Demonstration]]]
) -> list[Demonstration]:
    """Return the demonstrations that can be made; warns of the others.

    Args:
      source: of the routes, for messages.
      routes: what messages call each, and what makes it or raises InputError.

    Raises:
      InputError: none can be made.
    """
    kept, reasons = [], []
    for label, make in routes:
        try:
            kept.append(make())
        except InputError as error:
            reasons.append(f"{label}: {error}")
    said = "; ".join(reasons[:MOST_REASONS])
    if not kept:
        raise InputError(f"no route of {source} is of use: {said or 'there is none'}")
    if reasons:
        num = len(kept) + len(reasons)
        warn(
            f"{len(reasons)} of {num} routes of {source} could not be used: {said}",
            SkippedRouteWarning,
        )
    return kept


def _lines(
    routes: PlannedPath | Sequence[PlannedPath] | str | Path, maps: MetricMaps
) -> Iterator[Line]:
    """Yield the lines of a file, or of planned paths, in metres in the maps' CRS.

    A path that changes its altitude has none.
    """
    if isinstance(routes, str | Path):
        for number, route in enumerate(read_routes(routes), start=1):
            place = ", ".join(f"{degrees:.6f}" for degrees in route.lonlat[0])
            label = f"line {number} ({route.name!r}, from {place})"
            yield label, route, maps.grid.xy_at(route.lonlat)
        return
    paths = [routes] if isinstance(routes, PlannedPath) else routes
    for number, path in enumerate(paths, start=1):
        settings = path.settings
        route = Route(
            path.lonlat,
            f"{number}",
            None if len(path.z_m) and np.ptp(path.z_m) > 0 else path.altitude_m,
            settings["time_of_day"],
            settings["time"],
            settings,
        )
        yield f"path {number}", route, path.xy_m


def _followed(route: Route, xy_m: np.ndarray, map_of: MapOf) -> Demonstration:
    """Return a line as a demonstration, on its own map.

    Raises:
      InputError: it has no altitude, or is of no use.
    """
    if route.altitude_m is None:
        raise InputError(
            "it has no altitude, or several: give it one (a property altitude_m, --altitude, altitude_m=)"
        )
    cost_map = map_of(float(route.altitude_m), route.time, route.time_of_day)
    weights = route.settings.get("weights")
    pilot = Weights(**weights) if weights else None
    return replace(demonstration_from_line(cost_map, xy_m, route.name), pilot=pilot)


def _planned(
    source: str,
    table: pd.DataFrame,
    maps: MetricMaps,
    pilot: Weights | None,
    metrics: Sequence[str] | None,
    rules: RulesChoice,
) -> Iterator[tuple[str, Callable[[], Demonstration]]]:
    """Yield what plans the route of each row of a table, after what messages call it.

    Args:
      source: of the table, for messages.
      table: of instances or of queries.
      maps: that the routes lie on.
      pilot: weights instead of those of the rows.
      metrics: whose weights are to be fitted; None: all.
      rules: of the cost maps.

    Raises:
      InputError: a wrong table, or one without weights, or under different ones.
    """
    # Without weights nothing says which routes are the cheapest.
    if pilot is not None:
        table = table.assign(**as_columns(weights_on(maps, pilot), maps.metrics))
    has_weights = not table.filter(regex=f"^{WEIGHT_PREFIX}").empty
    if not has_weights and STARTS.intersection(table.columns):
        raise InputError(
            f"{source} has no weights under which its routes are the cheapest: give a column for each (w_distance, "
            "w_gps ...), or the weights of a pilot who flies all of them (--pilot, pilot=)"
        )

    # Instances have a number and a CRS of their own; queries are places in degrees.
    if "instance" in table or "crs" in table:
        instances = checked_instances(table, source)
    else:
        instances = instances_of_queries(maps, read_queries(table, metrics=maps.metrics))
    check_instances(instances, maps)
    _check_one_weights(source, instances)

    # Routes are planned on maps of all metrics, and fitted on maps of the chosen ones, each made once.
    map_of = _cost_maps(maps, (), rules)
    fitted_map = _fitted(map_of, metrics)
    for row in records_of(instances):
        label = f"instance {row['instance']} at {row['altitude_m']:g} m"
        yield label, partial(_planned_route, row, map_of, fitted_map)


def _planned_route(row: Row, map_of: MapOf, fitted_map: MapOf) -> Demonstration:
    """Return the cheapest route of an instance, on the map that weights are fitted on.

    Raises:
      InputError: an end that is not free, or no path joins the ends.
    """
    place = row["altitude_m"], row["time"], row["time_of_day"]
    query, weights, _ = query_of(map_of(*place), row)
    points_m = query.cheapest(weights)
    fitted = replace(query, cost_map=fitted_map(*place), is_planned=True)
    return Demonstration(fitted, points_m, pilot=weights_from(query, weights))


def _fitted(map_of: MapOf, metrics: Sequence[str] | None) -> MapOf:
    """Return a function that gives the cost maps of the chosen metrics, each made once; None: of all."""
    return map_of if metrics is None else cache(lambda *place: map_of(*place).only(metrics))


def _cost_maps(maps: MetricMaps, lines: Sequence[Line], rules: RulesChoice) -> MapOf:
    """Return a function of altitude in metres, time and time of day that gives the cost map there.

    It makes each cost map once, as fits count maps by identity. Warns of the first route that was planned under another
    cost model, or under other constraints, than the maps have.

    Args:
      maps: of the routes.
      lines: with the settings that they were planned under, where these are known.
      rules: of the cost maps. A cost model that is left out is the one that the routes were planned under, else the
        maps' own; constraints that are left out are those of the maps' scenario.

    Raises:
      InputError: an invalid cost model in the settings, or routes that name different ones.
    """
    # The rules of the cost maps: an argument comes before the rules of the maps' scenario.
    given = values_given(rules)
    planned = [(label, route.settings) for label, route, _ in lines]
    if "cost_model" not in given:
        models = {
            name: CostModel.from_settings(settings)
            for name, settings in planned
            if "cost_model" in settings
        }
        first = next(iter(models), "")  # a name that no model has where there is none
        for name, other in models.items():
            if other != models[first]:
                raise InputError(
                    f"{first} was planned under the cost model {models[first]} and {name} under {other}: fit them "
                    "apart, or name one for all (--preset, cost_model=)"
                )
        given["cost_model"] = models.get(first)
    maps, route_rules = RouteRules(**given).under(maps)

    # Whether each route was planned under these rules; for a rule that it does not name it was.
    rules_now = route_rules.rules()
    now = _describe_rules(rules_now)
    for name, settings in planned:
        before = _describe_rules({key: settings.get(key, rules_now[key]) for key in rules_now})
        if before != now:
            warn(
                f"{name} was planned under {before} and is fitted under {now}: give what it was planned under "
                "(--preset, --rules, --no-fly, --require; cost_model=, constraints=)",
                OtherSettingsWarning,
            )
            break
    return cache(partial(route_rules.cost_map, maps))


def _describe_rules(rules: Mapping[str, Any]) -> str:
    """Return cost model and constraints, as `RouteRules.rules` holds them, for a person to read."""
    limits = describe_constraints(rules["limits"]) or "no constraints"
    return f"the cost model {CostModel.from_settings(rules)} and {limits}"


def _check_one_weights(name: str, table: pd.DataFrame) -> None:
    """Raise InputError where the rows of a table are under weights of different ratios.

    Args:
      name: of the table, for the message.
      table: a row per instance, with a column per weight (``w_distance`` ...); an empty one passes.
    """
    weights = table.filter(regex=f"^{WEIGHT_PREFIX}").to_numpy(np.float64)
    sums = weights.sum(axis=1, keepdims=True)
    shares = weights / np.maximum(sums, np.finfo(float).tiny)
    if table.empty or np.ptp(shares, axis=0).max() <= ALIKE:
        return
    num_weights = len(np.unique(shares, axis=0))
    raise InputError(
        f"the routes of {name} were planned under {num_weights} different weights, and a fit finds one W: run the "
        "study under one ([study] weights = [{ gps = 1.0 }]), or name the weights of a pilot who flies all of its "
        "pairs (--pilot, pilot=)"
    )
