"""The queries of a batch, how they are read, and what became of each."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pandas as pd

from jaxurban import wings
from jaxurban.checks import finite, nearest_name, typed
from jaxurban.errors import InputError
from jaxurban.io.tables import SUFFIXES, Row, write_table
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import Weights, WeightsLike
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, Point
from jaxurban.planners.base import Path, Status
from jaxurban.public import FactsRepr

LONLAT = ("start_lon", "start_lat", "goal_lon", "goal_lat")
IN_METRES = ("start_x_m", "start_y_m", "goal_x_m", "goal_y_m")
WEIGHT_PREFIX = "w_"
COLUMNS = (*LONLAT, *IN_METRES, "altitude_m", "time", "time_of_day")
OF_SEARCH = (
    "objective_cost",
    "lower_bound",
    "num_points",
    "num_expanded",
    "elapsed_s",
    "setup_s",
    "planner",
    "heuristic",
    "backend",
)
QueriesLike = pd.DataFrame | Sequence[tuple[Point, Point]] | np.ndarray
NOT_RUN = "not-run"  # beside the names of `Status` and what `jaxurban.paths.rows` adds


@dataclass(frozen=True)
class Query:
    """One query of a batch, not yet checked against any maps.

    Attributes:
      start, goal: longitude, latitude in degrees, or `XY` in the maps' CRS.
      altitude_m: flight altitude above ground.
      time: UTC time of the GPS map; None for the first.
      time_of_day: of the population map; None for the first.
      weights: of the path's cost.
      error: why the query cannot be planned at all, or nothing.
    """

    start: Point | XY
    goal: Point | XY
    altitude_m: float
    time: str | None
    time_of_day: str | None
    weights: Weights
    error: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return the query as a row with the columns that `read_queries` takes."""
        place_columns = IN_METRES if isinstance(self.start, XY) else LONLAT
        coordinates = (*self.start[:2], *self.goal[:2])
        return {
            **dict(zip(place_columns, coordinates, strict=True)),
            "altitude_m": self.altitude_m,
            "time": self.time,
            "time_of_day": self.time_of_day,
            **{WEIGHT_PREFIX + name: value for name, value in self.weights.to_dict().items()},
        }


def read_queries(
    queries: QueriesLike,
    *,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    weights: WeightsLike = None,
    metrics: Iterable[str] = METRICS,
) -> list[Query]:
    """Return the queries of a table or of pairs of places; what a row leaves out comes from the arguments.

    Args:
      queries: ``(start, goal)`` pairs of longitude, latitude, or of `XY`; or a table with the columns ``start_lon``,
        ``start_lat``, ``goal_lon``, ``goal_lat`` (or ``start_x_m``, ``start_y_m``, ``goal_x_m``, ``goal_y_m`` in
        the maps' CRS), and any of ``altitude_m``, ``time``, ``time_of_day``, ``w_distance``, ``w_gps``,
        ``w_lidar``, ``w_population``, ``w_risk`` and the like of further ``metrics``.
      altitude_m, time, time_of_day, weights: for queries that do not say it themselves; each weight by itself.
      metrics: names of those that may have a weight.

    Returns:
      A query for each row, in their order. A row that cannot be read (a number missing, a negative weight) becomes a
      query with an ``error``.

    Raises:
      InputError: a column that is not known or missing, or invalid pairs.
    """
    no_place = (np.nan, np.nan)
    base_weights = Weights.of(weights).checked(metrics)
    base = Query(no_place, no_place, np.nan, time, time_of_day, base_weights)
    if altitude_m is not None:
        base = replace(base, altitude_m=finite("altitude_m", altitude_m))
    if not isinstance(queries, pd.DataFrame):
        queries = table_of(queries)
    weight_names = dict.fromkeys((*base_weights.to_dict(), *metrics))
    place_columns = _place_columns(queries, weight_names)
    return [_of_row(row, place_columns, base) for row in queries.to_dict("records")]


def _place_columns(queries: pd.DataFrame, weight_names: Iterable[str]) -> Sequence[str]:
    """Return the four columns of a table that hold its places: `LONLAT` or `IN_METRES`.

    Args:
      queries: the table.
      weight_names: of distance and metrics; each may have a column after `WEIGHT_PREFIX`.

    Raises:
      InputError: a column that is not known, one of the four that is missing, or places in degrees and in metres.
    """
    known = (*COLUMNS, *(WEIGHT_PREFIX + name for name in weight_names))
    unknown = [str(name) for name in queries if str(name) not in known]
    hold = ""
    if unknown:
        hold = f"unknown columns {unknown}{nearest_name(unknown[0], known)}"
    names = IN_METRES if IN_METRES[0] in queries else LONLAT
    missing = [name for name in names if name not in queries]
    if missing:
        beside = f" and have {hold}" if hold else ""
        choices = f"{', '.join(LONLAT)} or {', '.join(IN_METRES)}"
        raise InputError(f"queries lack the columns {', '.join(missing)}{beside}: give {choices}")
    if hold:
        raise InputError(
            f"queries have {hold}: leave them out, in pandas by queries.drop(columns=[...]); the columns are "
            f"{', '.join(known)}"
        )
    in_degrees = [name for name in LONLAT if name in queries]
    if names == IN_METRES and in_degrees:
        raise InputError(
            f"queries have {names[0]} and {in_degrees[0]}: give places in degrees or in metres, not in both"
        )
    return names


def table_of(queries: Iterable[tuple[Point, Point]] | np.ndarray) -> pd.DataFrame:
    """Return pairs of places as a table with the columns `LONLAT`, or `IN_METRES` for pairs of `XY`.

    Raises:
      InputError: something that is not a pair of places, places in degrees beside `XY`, or `XY` with altitudes.
    """
    pairs = list(queries)
    try:
        is_xy = [isinstance(place, XY) for pair in pairs for place in pair]
        places = np.array(pairs, float)
    except (TypeError, ValueError):  # no numbers, or not as many in each
        is_xy = []
        places = np.empty(0)  # whose shape is refused below
    in_metres = bool(is_xy) and all(is_xy)
    if in_metres and np.isnan(places[..., 2]).all():  # an altitude of None has become NaN
        places = places[..., :2]
    if len(pairs) and (places.shape[1:] != (2, 2) or any(is_xy) != in_metres):
        raise InputError(
            "queries must be pairs of places in degrees, [((lon, lat), (lon, lat)), ...] or an array [N, 2, 2], pairs "
            f"of ju.XY without altitudes, or a table with the columns {', '.join(LONLAT)}"
        )
    return pd.DataFrame(places.reshape(-1, 4), columns=list(IN_METRES if in_metres else LONLAT))


def _of_row(row: Mapping, place_columns: Sequence[str], base: Query) -> Query:
    """Return the query of a row, with an ``error`` where a number is missing, not finite or no number.

    Args:
      row: values by column. One that is missing or NaN is as in ``base``.
      place_columns: `LONLAT` or `IN_METRES`.
      base: a query with what rows may leave out, which is all but the places.
    """
    values = {str(name): value for name, value in row.items() if not pd.isna(value)}
    time = values.get("time", base.time)
    query = base  # what is returned, with the error, if even the first number is no number
    try:
        coordinates = [float(values.get(name, np.nan)) for name in place_columns]
        start = tuple(coordinates[:2])
        goal = tuple(coordinates[2:])
        is_xy = place_columns == IN_METRES
        weights = {
            name.removeprefix(WEIGHT_PREFIX): float(value)
            for name, value in values.items()
            if name.startswith(WEIGHT_PREFIX)
        }
        query = replace(
            base,
            start=XY(*start) if is_xy else start,
            goal=XY(*goal) if is_xy else goal,
            altitude_m=float(values.get("altitude_m", base.altitude_m)),
            time=None if time is None else str(time),
            time_of_day=values.get("time_of_day", base.time_of_day),
            weights=base.weights.replace(**weights).checked(),
        )
        # NaN is no place and no altitude.
        for end, place in (("start", start), ("goal", goal)):
            if not np.isfinite(place).all():
                raise InputError(f"{end} needs two finite numbers, got {place}")
        if not np.isfinite(query.altitude_m):
            raise InputError(
                "the altitude is missing: give each row an altitude_m (plan_many takes one for all, too)"
            )
    except ValueError as error:  # InputError is one
        return replace(query, error=str(error))
    return query


@dataclass(frozen=True, eq=False, repr=False)
class PlannedPaths(FactsRepr, Sequence[PlannedPath | None]):
    """The paths of a batch in the order of its queries; None where there is not even a planner's verdict.

    Attributes:
      rows: a row for each query: those of `to_dataframe`, with ``x_m`` and ``y_m``, the path's eastings and northings,
        and ``search``, the rest of what the planner reported, as JSON.
      paths: for each query what the planner gave; None where it did not run to its end.
      was_interrupted: whether Ctrl-C ended the batch before its end.

    Examples:
      >>> paths = ju.plan_many(maps, [(start, goal), (goal, start)], altitude_m=60.0, progress=False)
      >>> len(paths), paths[0].status.value, paths.was_interrupted
      (2, 'optimal', False)
      >>> paths.facts["length"]
      '1.7 km'
    """

    rows: Sequence[Row]
    paths: Sequence[PlannedPath | None]
    was_interrupted: bool = False

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: Any) -> Any:
        return self.paths[index]

    @property
    def facts(self) -> dict[str, str]:
        """How many queries ended how, and what the paths cost and measure together."""
        paths = [path for path in self.paths if path is not None]
        reached = [path for path in paths if path.status.has_path]
        cost = sum(path.cost for path in reached)
        length_m = sum(path.length_m for path in reached)
        interrupted = " (interrupted)" if self.was_interrupted else ""
        return {
            "queries": f"{len(self):,}{interrupted}",
            "statuses": _counts(row["status"] for row in self.rows),
            "heuristics": _counts(path.search.heuristic for path in paths),
            "cost": f"{cost:,.2f} of {len(reached):,} paths",
            "length": f"{length_m / 1000:,.1f} km",
        }

    @typed
    def save(self, file: str | FilePath) -> FilePath:
        """Write the batch and return the file, by its suffix a table or the paths themselves.

        ``.parquet`` and ``.csv`` hold `to_dataframe`; ``.geojson`` and ``.kml`` a line for each path that was found,
        whose name is the query's number.

        Returns:
          The file as a `pathlib.Path`.

        Raises:
          InputError: another suffix, no path at all, or a folder that does not exist or cannot be written to.

        Examples:
          >>> paths = ju.plan_many(maps, [(start, goal), (goal, start)], altitude_m=60.0, progress=False)
          >>> [paths.save(name).name for name in ("routes.csv", "routes.geojson")]
          ['routes.csv', 'routes.geojson']
        """
        file = FilePath(file)
        if file.suffix.lower() in SUFFIXES:
            return write_table(self.to_dataframe(), file)
        if file.suffix.lower() not in wings.FORMATS:
            known = ", ".join(dict.fromkeys((*SUFFIXES, *wings.FORMATS)))
            raise InputError(
                f"cannot determine the format of {str(file)!r}: end its name in one of {known}"
            )
        if not wings.write_path(self, file, names=[f"query {k}" for k in range(len(self))]):
            raise InputError(
                "there is no path to save: to_dataframe gives the status of each query"
            )
        return file

    @typed
    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with one row per query: the query, status and message, costs, metrics, search.

        Returns:
          A `pandas.DataFrame` in the order of the queries; units end the names of its columns, and what a query
          without a path does not have is missing there.

        Examples:
          >>> paths = ju.plan_many(maps, [(start, goal), (goal, start)], altitude_m=60.0, progress=False)
          >>> table = paths.to_dataframe()
          >>> table[["query", "status", "num_points"]].to_numpy().tolist()
          [[0, 'optimal', 38], [1, 'optimal', 38]]
        """
        table = pd.DataFrame(self.rows)
        return table.drop(columns=["x_m", "y_m", "search", "key"], errors="ignore")


def _counts(names: Iterable[str]) -> str:
    """Return how often each name occurs, the most frequent first, or ``none``."""
    counts = Counter(names).most_common()
    return ", ".join(f"{name} {count:,}" for name, count in counts) or "none"


def row_of(
    k: int,
    query: Query,
    status: str,
    message: str,
    planned: PlannedPath | None = None,
    key: str = "",
) -> dict[str, Any]:
    """Return what became of a query as a flat row, which `path_of` reads.

    A row without a planner's path has no columns of cost, length, metrics and search, and None for budget and points.

    Args:
      k: number of the query.
      query: as it was asked.
      status: the name of a `Status`, or `BAD_INPUT`, `CRASHED` or `NOT_RUN`.
      message: what happened, in a sentence or two.
      planned: what the planner gave; None where it did not run to its end.
      key: a digest of map, weights, places, planner and settings, by which another run knows the query again.
    """
    row: dict[str, Any] = {"query": k, **query.to_dict(), "status": status, "message": message}
    if planned is None:
        return row | dict.fromkeys(("budget_s", "x_m", "y_m", "search")) | {"key": key}

    # The columns of `PlannedPaths.to_dataframe`.
    facts = planned.to_dict()
    row |= {name: facts[name] for name in ("cost", "length_m")}
    row |= {f"cost_{name}": value for name, value in facts["cost_by_layer"].items()}
    row |= {f"m_{name}": value for name, value in facts["metrics"].items()}
    row |= {name: facts[name] for name in OF_SEARCH}
    row |= {f"{name}_snap_m": value for name, value in facts["snap_distance_m"].items()}
    budget_s = planned.settings["budget_s"]
    row["budget_s"] = np.inf if budget_s is None else budget_s  # None: without a limit
    row["x_m"], row["y_m"] = planned.xy_m.T

    # What else the planner reported. Of its points the first is enough, as the others follow from x and y.
    search = planned.search
    reported = vars(search) | {
        "status": search.status.value,
        "points_m": search.points_m[:1].tolist(),
    }
    return row | {"search": json.dumps(reported), "key": key}


def path_of(row: Row) -> Path:
    """Return the planner's path from a row that `row_of` made of a path.

    Its points are ``[N, 2]`` in metres from the map's southwest corner, ``[0, 2]`` where the planner found no way.
    """
    reported = json.loads(row["search"])
    points_m = np.empty((0, 2))
    if reported["points_m"]:
        xy_m = np.stack([row["x_m"], row["y_m"]], axis=1)
        corner_m = xy_m[0] - reported["points_m"][0]  # of the map, from which the planner measured
        points_m = xy_m - corner_m
    reported["status"] = Status(reported["status"])
    reported["points_m"] = points_m
    reported["history"] = tuple(map(tuple, reported["history"]))
    return Path(**reported)
