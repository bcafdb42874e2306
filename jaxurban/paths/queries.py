"""Query: one query of a batch, and how batches of them are read."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, finite, nearest_name
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import GivenWeights, Weights

Point = tuple[float, float]

LONLAT = ("start_lon", "start_lat", "goal_lon", "goal_lat")
XY = ("start_x_m", "start_y_m", "goal_x_m", "goal_y_m")
WEIGHT_PREFIX = "w_"
WEIGHT_COLUMNS = tuple(WEIGHT_PREFIX + name for name in Weights().to_dict())
COLUMNS = (*LONLAT, *XY, "altitude_m", "time", "time_of_day", *WEIGHT_COLUMNS)


@dataclass(frozen=True)
class Query:
    """One query of a batch, not yet checked against any maps.

    Attributes:
      start, goal: longitude, latitude in degrees, or None where metres are given.
      start_xy_m, goal_xy_m: easting, northing in the maps' CRS, or None.
      altitude_m: flight altitude above ground.
      time: UTC time of the GPS map; None for the first.
      time_of_day: of the population map; None for the first.
      weights: of the path's cost.
      error: why the query cannot be planned at all, or nothing.
    """

    start: Point | None
    goal: Point | None
    start_xy_m: Point | None
    goal_xy_m: Point | None
    altitude_m: float
    time: str | None
    time_of_day: str | None
    weights: Weights
    error: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return the query as the columns that `read_queries` takes."""
        places = (self.start, self.goal) if self.start_xy_m is None else (self.start_xy_m, self.goal_xy_m)
        numbers = [value for place in places for value in (place or (np.nan, np.nan))]
        return {
            **dict(zip(LONLAT if self.start_xy_m is None else XY, numbers, strict=True)),
            "altitude_m": self.altitude_m,
            "time": self.time,
            "time_of_day": self.time_of_day,
            **{WEIGHT_PREFIX + name: value for name, value in self.weights.to_dict().items()},
        }


def read_queries(
    queries: pd.DataFrame | Sequence[tuple[Point, Point]],
    *,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    weights: GivenWeights = None,
    metrics: Iterable[str] = METRICS,
) -> list[Query]:
    """Return the queries of a table or of pairs of places; what a row leaves out comes from the arguments.

    Args:
      queries: ``(start, goal)`` pairs of longitude, latitude; or a table with the columns ``start_lon``,
        ``start_lat``, ``goal_lon``, ``goal_lat`` (or ``start_x_m``, ``start_y_m``, ``goal_x_m``, ``goal_y_m`` in
        the maps' CRS), and any of ``altitude_m``, ``time``, ``time_of_day``, ``w_distance``, ``w_gps``,
        ``w_lidar``, ``w_population``, ``w_risk`` and the like of further ``metrics``.
      altitude_m, time, time_of_day, weights: for queries that say nothing of their own (weights one by one).
      metrics: that may be weighed.

    A row that cannot be read (a number missing, a negative weight) becomes a query with an ``error``.

    Raises:
      InputError: a column that is not known or missing.
    """
    base = Query(None, None, None, None, np.nan, time, time_of_day, Weights.of(weights).checked(metrics))
    known = tuple(dict.fromkeys((*COLUMNS, *(WEIGHT_PREFIX + name for name in metrics))))
    if altitude_m is not None:
        base = replace(base, altitude_m=finite("altitude_m", altitude_m, "metres"))
    if isinstance(queries, str) or not isinstance(queries, pd.DataFrame | Sequence | np.ndarray):
        raise InputError(f"queries must be a table or pairs of (lon, lat), got {type(queries).__name__}")
    if not isinstance(queries, pd.DataFrame):
        return [_of_pair(pair, base) for pair in queries]
    for name in map(str, queries.columns):
        if name not in known:
            raise InputError(
                f"queries have an unknown column {name!r}{nearest_name(name, known)}: the columns are "
                f"{', '.join(known)}"
            )
    has_xy = XY[0] in queries.columns
    if missing := [name for name in (XY if has_xy else LONLAT) if name not in queries.columns]:
        raise InputError(f"queries lack the columns {', '.join(missing)}: give {', '.join(LONLAT)} or {', '.join(XY)}")
    if has_xy and (both := [name for name in LONLAT if name in queries.columns]):
        raise InputError(f"queries have {XY[0]} and {both[0]}: give places in degrees or in metres, not in both")
    return [_of_row(row, has_xy, base) for row in queries.to_dict("records")]


def _of_pair(pair: tuple[Point, Point], base: Query) -> Query:
    try:
        (start_lon, start_lat), (goal_lon, goal_lat) = pair
        numbers = [float(value) for value in (start_lon, start_lat, goal_lon, goal_lat)]
    except (TypeError, ValueError):
        return replace(base, error=f"a query must be ((lon, lat), (lon, lat)), got {pair!r}")
    return _checked(replace(base, start=(numbers[0], numbers[1]), goal=(numbers[2], numbers[3])))


def _of_row(row: dict, has_xy: bool, base: Query) -> Query:
    given = {str(name): value for name, value in row.items() if not pd.isna(value)}
    try:
        numbers = [float(given.get(name, np.nan)) for name in (XY if has_xy else LONLAT)]
        start, goal = (numbers[0], numbers[1]), (numbers[2], numbers[3])
        weights = {
            name.removeprefix(WEIGHT_PREFIX): float(value)
            for name, value in given.items()
            if name.startswith(WEIGHT_PREFIX)
        }
        query = replace(
            base,
            altitude_m=float(given.get("altitude_m", base.altitude_m)),
            time=None if given.get("time", base.time) is None else str(given.get("time", base.time)),
            time_of_day=given.get("time_of_day", base.time_of_day),
            weights=base.weights.replace(**weights).checked(),
        )
    except ValueError as error:  # InputError is one
        return replace(base, error=str(error))
    return _checked(
        replace(query, start_xy_m=start, goal_xy_m=goal) if has_xy else replace(query, start=start, goal=goal)
    )


def _checked(query: Query) -> Query:
    """Return the query with an error where a number is missing or not finite."""
    for name, place in (("start", query.start or query.start_xy_m), ("goal", query.goal or query.goal_xy_m)):
        if place is None or not np.isfinite(place).all():
            return replace(query, error=f"{name} needs two finite numbers, got {place}")
    if not np.isfinite(query.altitude_m):
        return replace(query, error="the altitude is missing: give altitude_m for all queries or in each row")
    return query
