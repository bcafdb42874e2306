"""Queries of a study, and what a route on their maps adds up, whatever the weights are."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from jaxurban.cost import METRICS, Weights
from jaxurban.errors import InputError, nearest_name
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import Cell, CostKind, CostModel
from jaxurban.weighted import Point, WeightedMap, weigh

UNIT_WEIGHTS = Weights(1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Query:
    """A route that is asked for.

    Attributes:
      unit: the map with every weight 1, whose layers are the costs c_j.
      start, goal: cells.
      name: for messages and reports.
    """

    unit: WeightedMap
    start: Cell
    goal: Cell
    name: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The weights: ``"distance"`` and the map's metrics."""
        return ("distance", *self.unit.names)


@dataclass(frozen=True, eq=False)
class RouteFacts:
    """What a route adds up. ``K`` weights: distance and the metrics.

    Attributes:
      features: ``[K]`` what weights multiply, so that cost = W . features: metres, then the sum (``cell``) or
        the integral over the reference length (``line``) of each c_j.
      integrals: ``[K]`` metres, then the integral of each metric m_j along the route, in metres.
    """

    features: np.ndarray
    integrals: np.ndarray


def route_facts(unit: WeightedMap, points_m: np.ndarray) -> RouteFacts:
    """Return what a valid route ``[N, 2]``, in metres from the map's southwest corner, adds up."""
    paid = unit.evaluate(points_m)
    crossed = paid.crossings
    along = unit.m[:, crossed.row, crossed.col].astype(np.float64) @ crossed.length_m
    return RouteFacts(np.append(paid.length_m, paid.per_layer), np.append(paid.length_m, along))


def unit_map(
    maps: MetricMaps,
    altitude_m: float,
    *,
    metrics: Sequence[str] | None = None,
    cost_model: CostModel | CostKind = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    limits: Limits | None = None,
) -> WeightedMap:
    """Return the maps at one altitude with every weight 1.

    Args:
      maps: from `build_maps` or `open_maps`.
      altitude_m: one of the maps' altitudes.
      metrics: which of the maps' metrics routes pay for; all if left out. The others have the weight 0.
      cost_model, time, time_of_day, limits: as in `weigh`.

    Raises:
      InputError: a metric that the maps lack, or as in `weigh`.
    """
    names = maps.metrics if metrics is None else tuple(metrics)
    for name in names:
        if name not in maps.metrics:
            hint = nearest_name(name, METRICS) or f": they hold {', '.join(maps.metrics)}"
            raise InputError(f"these maps hold no metric {name!r}{hint}")
    if not names or len(set(names)) < len(names):
        raise InputError(f"metrics must name different metrics, and at least one, got {', '.join(names) or 'none'}")
    whole = weigh(
        maps,
        altitude_m,
        weights=UNIT_WEIGHTS,
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
        limits=limits,
    )
    kept = [row for row, name in enumerate(whole.names) if name in names]
    if len(kept) == len(whole.names):
        return whole
    return replace(whole, names=tuple(whole.names[row] for row in kept), m=whole.m[kept], layers=whole.layers[kept])


def make_queries(unit: WeightedMap, pairs: Iterable[tuple[Point, Point]], *, snap: bool | float = False) -> list[Query]:
    """Return a query for each pair of a start and a goal, as longitude and latitude in degrees.

    Args:
      unit: from `unit_map`.
      pairs: start and goal of each query.
      snap: move an end inside an obstacle to the nearest free cell, by at most 50 m, or so many metres.

    Raises:
      InputError: a place outside the maps or inside an obstacle; names the pair.
    """
    queries = []
    for number, (start, goal) in enumerate(pairs, start=1):
        try:
            ends = (unit.locate("start", start, snap=snap), unit.locate("goal", goal, snap=snap))
        except InputError as error:
            raise InputError(f"pair {number}: {error}") from error
        queries.append(Query(unit, ends[0].cell, ends[1].cell, f"{number}"))
    return queries


def weights_from(names: Sequence[str], values: np.ndarray) -> Weights:
    """Return the weights with these values ``[K]``, those not named 0."""
    named = dict(zip(names, (float(value) for value in values), strict=True))
    return Weights(**{item.name: named.get(item.name, 0.0) for item in fields(Weights)})


def check_alike(queries: Sequence[Query]) -> tuple[str, ...]:
    """Return the weights that all queries have.

    Raises:
      InputError: no query, or maps whose metrics, cost models or units of population differ.
    """
    if not queries:
        raise InputError("there are no routes to look at: give at least one")
    first = queries[0]
    for query in queries:
        if query.names != first.names:
            raise InputError(
                f"the routes lie on maps of different metrics, {', '.join(first.names)} and "
                f"{', '.join(query.names)}: make all maps from the same kinds of sources"
            )
        if query.unit.cost_model != first.unit.cost_model:
            raise InputError(
                f"the routes are costed by different cost models, {first.unit.cost_model} and "
                f"{query.unit.cost_model}: name one for all (--cost-model, cost_model=)"
            )
        if query.unit.grid.resolution_m != first.unit.grid.resolution_m and first.unit.cost_model.kind == "cell":
            raise InputError(
                "the routes lie on maps of different resolutions, on which the 'cell' cost model charges differently: "
                "use cost_model='line'"
            )
        if _norms(query.unit) != _norms(first.unit):
            raise InputError(
                "population is normalised by different numbers on these maps, so that one weight means different "
                "things: make the maps with [population] normalise set to a number per km2"
            )
    return first.names


def _norms(unit: WeightedMap) -> float | None:
    """Return what population is divided by at the map's time of day; None without population."""
    attrs = unit.maps.ds.attrs
    if "population" not in unit.names:
        return None
    for name in ("pop_norm_per_km2", "pop_norm_per_block"):
        if name in attrs and unit.time_of_day is not None:
            norms = np.atleast_1d(attrs[name])
            return float(norms[unit.maps.times_of_day.index(unit.time_of_day)])
    return None
