"""Queries of a study, and what a route on their maps adds up, whatever the weights are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxurban.cost import Weights
from jaxurban.errors import InputError
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import Cell, CostModel
from jaxurban.weighted import WeightedMap, weigh

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
    cost_model: CostModel = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    reference_length_m: float = 5.0,
) -> WeightedMap:
    """Return the maps at one altitude with every weight 1 (arguments and errors as in `weigh`)."""
    return weigh(
        maps,
        altitude_m,
        weights=UNIT_WEIGHTS,
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
        reference_length_m=reference_length_m,
    )


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
        if (query.unit.cost_model, query.unit.reference_length_m) != (
            first.unit.cost_model,
            first.unit.reference_length_m,
        ):
            raise InputError("the routes are costed by different cost models: use one for all")
        if query.unit.grid.resolution_m != first.unit.grid.resolution_m and first.unit.cost_model == "cell":
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
    for name in ("pop_norm_per_km2", "pop_norm_per_block"):
        if name in attrs and unit.time_of_day is not None:
            norms = np.atleast_1d(attrs[name])
            return float(norms[unit.maps.times_of_day.index(unit.time_of_day)])
    return None
