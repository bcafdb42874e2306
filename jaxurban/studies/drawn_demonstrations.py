"""Demonstrations from tables of queries and from Monte Carlo benchmarks: routes that are drawn anew on the maps."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, LeftOutWarning, OtherSettingsWarning
from jaxurban.io.files import read_json
from jaxurban.io.rows import INSTANCES_FILE, ROWS_FILE, SETTINGS_FILE
from jaxurban.io.tables import SUFFIXES, read_table, records_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.queries import LONLAT, WEIGHT_PREFIX, XY, Query, read_queries
from jaxurban.paths.snapping import one_place
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path as FoundPath
from jaxurban.planners.cost_model import CostModel
from jaxurban.studies.demonstrations import Demonstration, demonstration_from_line
from jaxurban.studies.montecarlo.sampling import KEY, read_instances
from jaxurban.studies.montecarlo.trial import HAS_PATH, WEIGHTED, BenchmarkSettings, limited
from jaxurban.studies.queries import RouteQuery

SAME_COST = 1e-6  # relative: a route that is drawn again costs as its row says
PREFERRED = "astar-plus"  # of a benchmark's planners: its paths are cheapest on the grid
MapOf = Callable[[float, str | None, str | None], CostMap]  # by altitude, time and time of day


class DrawnRoutes(NamedTuple):
    """Queries of a table, and how their routes were found.

    Attributes:
      name: of the file, for messages.
      queries: a row each: places, altitude, times, weights, and ``cost`` where it is known.
      settings: that the routes were planned under; empty where the file does not say.
      planner: what is asked for a route, by the number of its instance.
    """

    name: str
    queries: pd.DataFrame
    settings: Mapping[str, Any]
    planner: Callable[[Any, int], FoundPath]


def holds_queries(file: Path | pd.DataFrame) -> bool:
    """Return whether this is a table of queries, such as instances, or a folder of a Monte Carlo benchmark."""
    if isinstance(file, pd.DataFrame) or file.is_dir():
        return True
    if file.suffix.lower() not in SUFFIXES or not file.is_file():
        return False
    columns = set(read_table(file, "routes").columns)
    return columns.issuperset(XY) or columns.issuperset(LONLAT)


def read_drawn(file: Path | pd.DataFrame, planner: str | None = None) -> DrawnRoutes:
    """Return the queries of a table, or those that a planner of a Monte Carlo benchmark found paths for.

    Args:
      file: instances or queries, or the table of a batch (in a .parquet or .csv file, or as a table); or the folder
        of a benchmark.
      planner: of a benchmark; left out, `PREFERRED`, or the first that is not it.

    Raises:
      InputError: the file or folder cannot be read or holds no such rows, or the planner is none of the benchmark's.
    """
    if isinstance(file, Path) and file.is_dir():
        return _of_benchmark(file, planner)
    name = "the table" if isinstance(file, pd.DataFrame) else str(file)
    if planner is not None:
        raise InputError(f"{name!r} is no folder of a study, whose planners could be chosen: leave planner out")
    queries = file if isinstance(file, pd.DataFrame) else read_table(file, "routes")
    return DrawnRoutes(name, queries, {}, lambda problem, _: astar(problem))


def _of_benchmark(folder: Path, planner: str | None) -> DrawnRoutes:
    """Return the instances for which one planner of a benchmark found a path, with its cost."""
    for name in (SETTINGS_FILE, INSTANCES_FILE, ROWS_FILE):
        if not (folder / name).is_file():
            raise InputError(f"{str(folder)!r} is no finished study, since it holds no {name}: run `jaxurban study`")
    settings, rows = read_json(folder / SETTINGS_FILE), read_table(folder / ROWS_FILE, "rows")
    rows = rows[rows.objective == WEIGHTED]
    planners = list(dict.fromkeys(rows.planner))
    if planner is None:
        planner = PREFERRED if PREFERRED in planners else next(iter(planners), "")
    if planner not in planners:
        raise InputError(f"planner must be one of the study's, {', '.join(planners) or 'none'}, got {planner!r}")
    found = rows[(rows.planner == planner) & rows.status.isin(HAS_PATH)]
    queries = read_instances(folder / INSTANCES_FILE).merge(found[[*KEY, "cost"]], on=list(KEY))
    if queries.empty:
        raise InputError(f"{planner} found no path in {str(folder)!r}: choose another planner of the study")
    runs = BenchmarkSettings(
        planners=planner,
        distance_only=(),
        cost_model=CostModel.from_settings(settings),
        **{name: settings[name] for name in ("budget_s", "budget_iterations", "seed")},
    )

    def plan(problem: Any, instance: int) -> FoundPath:
        return limited(planner, runs)(problem.alone(), seed=runs.seed_of(instance))

    return DrawnRoutes(str(folder), queries, settings, plan)


def draw(drawn: DrawnRoutes, maps: MetricMaps, map_of: MapOf, pilot: Weights | None) -> list[Demonstration]:
    """Return the routes of queries, found anew on the maps under each row's own weights, or all under the pilot's.

    Rows that say that their places are not joined are left out; so are those whose route does not come out again: its
    cost is another than the row's, as where a budget in seconds ended the search. Warnings count them.

    Args:
      drawn: from `read_drawn`.
      maps: that they lie on.
      map_of: cost maps with all metrics.
      pilot: weights under which routes are the cheapest, whatever the rows say.

    Raises:
      InputError: a row that is no query of these maps, or no row left.
    """
    table = drawn.queries
    if "crs" in table and (other := set(table.crs.dropna()) - {maps.grid.crs}):
        raise InputError(f"the places of {drawn.name!r} are in {other.pop()}, the maps in {maps.grid.crs}: name others")
    is_told = table["is_connected"].astype(str).str.lower() if "is_connected" in table else pd.Series("", table.index)
    table = table[is_told != "false"]
    if "status" in table:
        table = table[table.status.isin(HAS_PATH)]
    weights = [WEIGHT_PREFIX + name for name in ("distance", *maps.metrics)]
    told = [name for name in weights if name in table]
    places = XY if set(XY) <= set(table.columns) else LONLAT
    if pilot is None and not told:
        raise InputError(
            f"{drawn.name!r} names no weights ({', '.join(weights)}) under which its routes are cheapest: name them "
            "(--pilot, pilot=)"
        )
    if pilot is None and (empty := [name for name in told if table[name].isna().any()]):
        raise InputError(
            f"row {1 + int(table[empty[0]].isna().to_numpy().argmax())} of {drawn.name!r} has no {empty[0]}: give a "
            "number in each row, leave the column out, or name the weights of all (--pilot, pilot=)"
        )
    known = [name for name in (*places, "altitude_m", "time", "time_of_day", *told) if name in table]
    queries = read_queries(table[known], metrics=maps.metrics)
    if pilot is None and len({tuple(query.weights.to_dict().items()) for query in queries}) > 1:
        warnings.warn(
            f"the routes of {drawn.name!r} were planned under different weights, and a fit finds one W for all: they "
            "are fitted together as they are; choose routes of one W, or name one under which they are drawn anew "
            "(--pilot, pilot=)",
            OtherSettingsWarning,
            stacklevel=4,
        )
    if not queries:
        raise InputError(f"{drawn.name!r} holds no route between places that a path joins: give more rows, or others")
    demonstrations, lost = [], 0
    for number, (query, row) in enumerate(zip(queries, records_of(table), strict=True), start=1):
        name = f"{row.get('instance', row.get('query', number))}"
        try:
            route = _route(drawn, query, row, map_of, pilot, name)
        except InputError as error:
            raise InputError(f"row {number} of {drawn.name!r}: {error}") from error
        if route is None:
            lost += 1
        else:
            demonstrations.append(route)
    said = (
        f"{lost} of {len(queries)} routes of {drawn.name!r} did not come out again as their rows say (other maps, "
        "another cost model or a budget in seconds)"
    )
    if not demonstrations:
        raise InputError(f"{said}, so that none is left: name the maps and the cost model that they were planned under")
    if lost:
        warnings.warn(f"{said} and were left out", LeftOutWarning, stacklevel=4)
    return demonstrations


def _route(
    drawn: DrawnRoutes, query: Query, row: Mapping[str, Any], map_of: MapOf, pilot: Weights | None, name: str
) -> Demonstration | None:
    """Return the route of a query, None where it is not what its row tells."""
    if query.error:
        raise InputError(query.error)
    on = map_of(query.altitude_m, query.time, query.time_of_day)
    start = on.locate("start", one_place("start", query.start, query.start_xy_m)).cell
    goal = on.locate("goal", one_place("goal", query.goal, query.goal_xy_m)).cell
    asked = RouteQuery(on, start, goal, name)
    if start == goal:
        raise InputError("it starts and ends in one cell: leave it out")
    if pilot is not None:
        return Demonstration(asked, asked.cheapest(pilot.vector(asked.names)))
    weights = query.weights.vector(asked.names)
    found = drawn.planner(asked.problem(weights), int(row.get("instance", 0)))
    points_m = asked.points_of(found)
    cost, told = asked.sums(points_m)[0] @ weights, row.get("cost")
    if told is not None and not pd.isna(told) and abs(cost - told) > SAME_COST * abs(told):
        return None
    corner_m = np.array([on.grid.x_min_m, on.grid.y_min_m])
    return demonstration_from_line(on, points_m + corner_m, name)
