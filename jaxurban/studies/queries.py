"""What studies share: queries, and what routes between their ends add up."""

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import population_norms
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import AnyArray, Weights
from jaxurban.paths.constraints import GPS_FLOOR, Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.places import Point
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Problem
from jaxurban.settings import CLEARANCES
from jaxurban.world.grid import Grid

LENGTH, PEOPLE = "length_m", "people"
# Labels of the outcomes that are not means.
PLAIN = {LENGTH: "length", PEOPLE: "population crossed"}


@dataclass(frozen=True, eq=False)
class RouteQuery:
    """Two ends of a route on a map. ``K`` weights: distance and the metrics.

    Attributes:
      cost_map: whose layers are the costs c_j; its weights play no part.
      start, goal: cells.
      name: for messages and reports.
      is_planned: its route was planned under weights of these very maps, whatever their population is divided by.
    """

    cost_map: CostMap
    start: Cell
    goal: Cell
    name: str = ""
    is_planned: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The weights: ``"distance"`` and the map's metrics."""
        return self.cost_map.weight_names

    def problem(self, weights: np.ndarray) -> Problem:
        """Return the planners' view of the query under weights ``[K]``."""
        return self.cost_map.problem.between(self.start, self.goal).with_weights(weights)

    def cheapest(self, weights: np.ndarray) -> np.ndarray:
        """Return ``[N, 2]`` the cheapest route under weights ``[K]``, in metres from the map's southwest corner.

        Raises:
          InputError: start and goal are not connected.
        """
        path = astar(self.problem(weights))
        if not path.status.has_path:
            raise InputError(f"no path joins the ends of route {self.name!r}: leave it out")
        return path.points_m

    def sums(self, points_m: np.ndarray) -> np.ndarray:
        """Return ``[2, K]`` what a valid route ``[N, 2]`` adds up, in metres from the map's southwest corner.

        The first row holds its features, which weights multiply, so that cost = W . features: metres, then the sum
        (``cell``) or the integral over the reference length (``line``) of each c_j. The second row holds its integrals:
        metres, then the integral of each metric m_j along the route, in metres.
        """
        features = self.cost_map.problem.features(points_m)
        length_m = float(features.phi[0])
        means = np.array(list(self.cost_map.means(features).values()))
        return np.stack([features.phi, np.append(length_m, means * length_m)])


def maps_of(queries: Iterable[RouteQuery]) -> list[CostMap]:
    """Return the maps that queries lie on, each once."""
    return list({id(query.cost_map): query.cost_map for query in queries}.values())


@typed
def make_queries(
    cost_map: CostMap, pairs: Iterable[tuple[Point, Point]], *, snap: bool | float = False
) -> list[RouteQuery]:
    """Return a query for each pair of a start and a goal, as longitude and latitude in degrees.

    Args:
      cost_map: from `jaxurban.cost_map`.
      pairs: start and goal of each query.
      snap: move an end inside an obstacle to the nearest free cell: False never, True by at most 50 m, a number by at
        most this many metres.

    Returns:
      The queries in the order of the pairs: ``start`` and ``goal`` are cells, row and column, and ``name`` is the
      number of the pair, from 1. `jaxurban.fit.fit_targets` takes them.

    Raises:
      InputError: a place outside the maps or inside an obstacle (names the pair), or a cost map of levels.

    Examples:
      >>> queries = ju.studies.make_queries(ju.cost_map(maps, 60.0), [(start, goal), (goal, start)])
      >>> [(query.name, query.start, query.goal) for query in queries]
      [('1', (2, 2), (27, 27)), ('2', (27, 27), (2, 2))]
    """
    if cost_map.levels is not None:
        raise InputError(
            "a study of routes needs one altitude, not Levels: give cost_map(maps, 60.0)"
        )
    queries = []
    for number, pair in enumerate(pairs, start=1):
        try:
            start, goal = pair
        except (TypeError, ValueError) as error:
            raise InputError(f"each of pairs must be a start and a goal, got {pair!r}") from error
        try:
            snapped_start, snapped_goal = cost_map.free_space.ends(start, goal, snap=snap)
        except InputError as error:
            raise InputError(f"pair {number}: {error}") from error
        queries.append(RouteQuery(cost_map, snapped_start.cell, snapped_goal.cell, f"{number}"))
    return queries


def weights_from(query: RouteQuery, values: np.ndarray) -> Weights:
    """Return `Weights` from values ``[K]`` in the order of the query's names; metrics it does not have weigh 0."""
    others = dict.fromkeys((*METRICS, *query.cost_map.maps.metrics), 0.0)
    return Weights(**others | dict(zip(query.names, map(float, values), strict=True)))


def check_alike(queries: Sequence[RouteQuery]) -> tuple[str, ...]:
    """Return the names of the weights that all queries have, ``"distance"`` and metrics, after checking all maps.

    A study may add up costs of several maps only where a weight means the same on all of them.

    Raises:
      InputError: no query, or maps whose metrics, cost models or units of population differ, or whose cell sizes differ
        under the cost model ``cell``.
    """
    # Metrics, cost models and, where a cost counts cells, resolutions.
    if not queries:
        raise InputError(
            "there are no routes to study: name files of routes, such as the instances.parquet of a study, or sample "
            "instances (--sample); in Python give demonstrations or queries"
        )
    cost_maps = maps_of(queries)
    metrics = [", ".join(cost_map.weight_names) for cost_map in cost_maps]
    _check_same(metrics, "metrics: make all from the same kinds of sources")
    models = [cost_map.cost_model for cost_map in cost_maps]
    _check_same(models, "cost models: name one for all (--preset, cost_model=)")
    if models[0].kind == "cell":
        sides = [f"{cost_map.grid.resolution_m:g} m" for cost_map in cost_maps]
        _check_same(
            sides,
            "resolutions, on which the 'cell' cost model costs differently: use cost_model='line'",
        )

    # What population is divided by. It does not matter to routes that were planned under weights of these very maps.
    if "population" in queries[0].names:
        unplanned = maps_of(query for query in queries if not query.is_planned)
        norms = [population_norms(each.maps).get(each.time_of_day or "") for each in unplanned]
        _check_same(
            norms,
            "numbers by which population is normalised, so that one weight means different things: make the maps with "
            "[population] normalise set to a number per km2, or take one time of day (--time-of-day, time_of_day=)",
        )
    return queries[0].names


def _check_same(values: Sequence[Any], remedy: str) -> None:
    """Raise InputError unless the values of all maps are equal; the message ends with what differs and the remedy."""
    for value in values:
        if value != values[0]:
            raise InputError(
                f"the routes lie on maps of {values[0]} and {value}, different {remedy}"
            )


def ends_option(grid: Grid, ends_m: ArrayLike) -> str:
    """Return start and goal ``[2, 2]``, easting and northing in the grid's CRS, as commands take them."""
    lonlat = grid.lonlat_at(np.asarray(ends_m))
    start, goal = (",".join(f"{degrees:.6f}" for degrees in end) for end in lonlat.tolist())
    return f"--start {start} --goal {goal}"


def command_to_plan(query: RouteQuery, weights: Weights) -> str:
    """Return the command that plans the route of a query under weights."""
    cost_map = query.cost_map
    ends_m = [cost_map.grid.xy_of_cell(*cell) for cell in (query.start, query.goal)]
    return (
        f"jaxurban plan {cost_map.maps.folder or 'DIR'} {ends_option(cost_map.grid, ends_m)} "
        f"--altitude {cost_map.altitude_m:g} {_rules_options(cost_map)}{_time_options(cost_map)}"
        f"--weights {weights_option(weights)}"
    )


def command_to_vary(
    query: RouteQuery, weights: Weights, folder: str, is_length_open: bool = False
) -> str:
    """Return the command that says whether routes change where weights are wrong; empty where no metric has a weight.

    Args:
      query: of whose maps and altitude.
      weights: the metrics' and the distance's.
      folder: that the study is kept in.
      is_length_open: the weight of the distance varies too, which else is the unit of the others.
    """
    cost_map = query.cost_map
    maps = cost_map.maps
    if not any(weights[name] for name in cost_map.names):
        return ""
    vary = ""
    if is_length_open:
        vary = f"--vary {','.join(name for name in cost_map.weight_names if weights[name])} "
    return (
        f"jaxurban sensitivity {maps.folder or 'DIR'} --resolution {maps.grid.resolution_m:g} "
        f"--altitude {cost_map.altitude_m:g} {_rules_options(cost_map)}{vary}"
        f"--weights {weights_option(weights, maps.metrics)} -o {folder} --routes 30"
    )


def _rules_options(cost_map: CostMap) -> str:
    """Return the options of the preset and the constraints under which is planned, with a space behind each."""
    preset = cost_map.maps.planning.preset
    preset_option = f"--preset {preset} " if preset else ""
    return preset_option + constraint_options(cost_map.constraints, cost_map.maps)


def _time_options(cost_map: CostMap) -> str:
    """Return the options of times that are not the first ones of the maps, with a space behind each."""
    maps = cost_map.maps
    options = ""
    if cost_map.time_of_day != next(iter(maps.times_of_day), None):
        options += f"--time-of-day {cost_map.time_of_day} "
    if cost_map.time != maps.default_time:
        options += f"--time {cost_map.time} "
    return options


def constraint_options(constraints: Constraints, maps: MetricMaps) -> str:
    """Return the options of constraints that the scenario of the maps does not have, with a space behind each.

    A file of zones is called by its name, and ``FILE`` where zones were made in Python.
    """
    usual = maps.planning.rules
    names = *CLEARANCES, "unknown_heights"
    kept = {name: getattr(constraints, name) for name in names}
    own = {name: value for name, value in kept.items() if value not in (None, getattr(usual, name))}
    files = dict.fromkeys(zone.source or "FILE" for zone in constraints.zones)
    words = [("--no-fly", file) for file in files]
    words += [("--require", str(bound)) for bound in constraints.bounds]
    if constraints.above_gps_floor:
        words.append(("--require", GPS_FLOOR))
    if own:
        words.append(("--rules", ",".join(f"{name}={value}" for name, value in own.items())))
    return "".join(f"{shlex.join(each)} " for each in words)


def weights_option(weights: Weights, metrics: Iterable[str] | None = None) -> str:
    """Return weights as ``--weights`` takes them; with metrics, those of the distance and of these alone."""
    names = weights.to_dict() if metrics is None else ("distance", *metrics)
    return ",".join(f"{name}={weights[name]:.6g}" for name in names)


def weight_units(cost_map: CostMap) -> list[str]:
    """Return ``[K]`` what each weight of a map is per, where its metric costs 1."""
    model = cost_map.cost_model
    unit = f"per {model.reference_length_m:g} m flown"
    if model.kind == "cell":
        unit = "per cell entered"
    return ["per metre", *(unit for _ in cost_map.names)]


def outcome_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the outcomes of routes on maps with these weights (``"distance"`` and metrics)."""
    of_weight = {"distance": LENGTH, "population": PEOPLE}
    return tuple(of_weight.get(name, f"mean_{name}") for name in names)


def outcome_label(outcome: str) -> str:
    """Return what sentences call an outcome: without a capital, but for abbreviations such as GPS."""
    if outcome in PLAIN:
        return PLAIN[outcome]
    metric = outcome.removeprefix("mean_")
    label = METRICS[metric].label if metric in METRICS else metric
    return label if label[:2].isupper() else f"{label[:1].lower()}{label[1:]}"


def outcomes_of(integrals: Float[AnyArray, "*N K"], names: Sequence[str]) -> dict[str, Any]:
    """Return each outcome ``[*N]`` of routes by its name, in the order of the weights.

    ``length_m`` in metres; ``mean_gps`` and the like, the mean of m along the route by length; ``people``, the integral
    of m_population along the route in metres, which is proportional to the people under a strip of any width.

    Args:
      integrals: of the routes (see `RouteQuery.sums`), NumPy or JAX.
      names: ``[K]`` the weights, ``"distance"`` first.
    """
    outcomes = {}
    for k, outcome in enumerate(outcome_names(names)):
        integral = integrals[..., k]
        outcomes[outcome] = integral if outcome in PLAIN else integral / integrals[..., 0]
    return outcomes
