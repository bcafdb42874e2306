"""sensitivity: what would change one planned route, and what would not: all weight studies of one query together."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from jaxurban.checks import at_least, one_of, typed
from jaxurban.errors import InputError
from jaxurban.io.results import Result
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import Point
from jaxurban.progress import Progress, reporting
from jaxurban.studies.queries import RouteQuery, check_flat, outcomes_of, query_between
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import EXACT, Partition, find_breakpoints, pareto_front
from jaxurban.studies.weights.sobol import (
    check_sampling,
    cost_gradient,
    outcome_slopes,
    sobol_of_weights,
    varied_columns,
)


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Result):
    """What the weights do to one route. ``K`` weights.

    Attributes:
      maps: on which it is planned.
      route: the cheapest route under the given weights.
      names: ``"distance"`` and the metrics.
      weights: ``[K]`` as given.
      settings: what was varied, how far, and how finely; what was left out is filled in.
      cost, outcomes: derivatives at the given weights (`cost_gradient`, `outcome_slopes`).
      sobol: shares of variance over the whole range (`sobol_indices`).
      lines: of each varied weight, the routes along its range, the others as given.
      front: routes that trade the objectives against each other.
      line_routes: ``[N, 2]`` easting and northing of the routes of each line, in the order of its cells.
      num_plans: number of searches made.
      elapsed_s: wall time in seconds.

    Examples:
      >>> quick = ju.studies.SensitivitySettings(vary=("gps",), num_samples=4, max_plans=20)
      >>> result = ju.studies.sensitivity(ju.cost_map(maps, 60.0), start, goal, settings=quick)
      >>> {name: len(line.cells) for name, line in result.lines.items()}, result.route.status.value
      ({'gps': 5}, 'optimal')
    """

    _command = "sensitivity"
    _report = "sensitivity:sensitivity_outputs"

    maps: MetricMaps
    route: PlannedPath
    names: tuple[str, ...]
    weights: np.ndarray
    settings: "SensitivitySettings"
    cost: pd.DataFrame
    outcomes: pd.DataFrame
    sobol: pd.DataFrame
    lines: dict[str, Partition]
    front: Partition
    line_routes: dict[str, list[np.ndarray]]
    num_plans: int
    elapsed_s: float

    @property
    def facts(self) -> dict[str, str]:
        """The route, and for each weight that varies its value, share of the cost and number of routes in its range."""
        low, high = self.settings.factors
        facts = {
            "route": f"cost {self.route.cost:,.2f}, {self.route.length_m:,.0f} m at {self.route.altitude_m:g} m",
            "each weight varies": f"from {low:g} to {high:g} times its value",
        }
        for name, weight in zip(self.names, self.weights, strict=True):
            if name in self.lines:
                share = self.cost["elasticity"][name]
                num = len(self.lines[name].cells)
                facts[name] = f"{weight:g}, {share:.1%} of the cost, routes over its range: {num}"
        return facts

    @typed
    def breakpoints(self, name: str) -> pd.DataFrame:
        """Return the routes along the range of one weight, and their outcomes.

        ``from`` and ``to`` are the values of the weight between which a route is the cheapest; ``is_given`` marks the
        route under the given weights.

        Args:
          name: of a weight that was varied.

        Returns:
          A row per route, numbered from 1 in the order of the weight.

        Raises:
          InputError: the weight was not varied.

        Examples:
          >>> quick = ju.studies.SensitivitySettings(vary=("gps",), num_samples=4, max_plans=20)
          >>> result = ju.studies.sensitivity(ju.cost_map(maps, 60.0), start, goal, settings=quick)
          >>> result.breakpoints("gps")["is_given"].tolist()
          [True, False, False, False, False]
        """
        line = self.lines[one_of("name", name, self.lines)]

        # Values of the weight at both ends of the line and at the breakpoints between, from the shares of the second
        # corner there. The given weight lies between two of them.
        column = self.names.index(name)
        shares = np.concatenate([[0.0], line.breakpoints, [1.0]])
        values = line.weights_at(np.stack([1 - shares, shares], axis=-1))[:, column]
        given_route = np.searchsorted(values[1:-1], self.weights[column], side="right")
        num_routes = len(line.cells)
        columns = {
            "weight_name": name,
            "from": values[:-1],
            "to": values[1:],
            **outcomes_of(line.integrals, self.names),
            "is_given": np.arange(num_routes) == given_route,
        }
        return pd.DataFrame(columns, pd.RangeIndex(1, num_routes + 1, name="route"))

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return all tables by name.

        Returns:
          Those that `jaxurban sensitivity` writes, by the names of their files.

        Examples:
          >>> quick = ju.studies.SensitivitySettings(vary=("gps",), num_samples=4, max_plans=20)
          >>> result = ju.studies.sensitivity(ju.cost_map(maps, 60.0), start, goal, settings=quick)
          >>> list(result.tables())
          ['cost_gradient', 'local', 'sobol', 'switches', 'pareto']
        """
        return {
            "cost_gradient": self.cost,
            "local": self.outcomes,
            "sobol": self.sobol,
            "switches": pd.concat([self.breakpoints(name) for name in self.lines]),
            "pareto": self.front.points,
        }


@typed
@dataclass(frozen=True)
class SensitivitySettings:
    """What is varied, how far, and how finely.

    Attributes:
      vary: names of weights; left out: all metrics with a weight above 0. The distance keeps its weight as the
        unit unless it is named, since only ratios of weights choose a route.
      factors: each varies from the first to the second of these times its value.
      num_samples: N of the Sobol indices, a power of two; N x (2 + weights that vary) searches.
      objectives: two or three features for the Pareto front; left out: distance and the two varied metrics with the
        largest shares.
      tolerance: of the front, a share of the cost.
      max_plans: searches that the front may take.
      seed: of the Sobol sequence and the noise.

    Raises:
      InputError: factors that do not enclose 1, a number of samples that is no power of two, or another wrong value.

    Examples:
      >>> settings = ju.studies.SensitivitySettings(vary=("gps", "risk"), factors=(0.5, 2.0))
      >>> settings.num_samples, settings.objectives  # left out: chosen when the study runs
      (128, ())
    """

    vary: tuple[str, ...] = ()
    factors: tuple[float, float] = (0.1, 10.0)
    num_samples: int = 128
    objectives: tuple[str, ...] = ()
    tolerance: float = 1e-3
    max_plans: int = 5000
    seed: int = 0

    def __post_init__(self) -> None:
        """Check all numbers; names are checked against the maps when the study runs."""
        check_sampling(self)
        at_least("num_samples", self.num_samples, 2)
        at_least("max_plans", self.max_plans, 1)
        if not EXACT <= self.tolerance < 1:
            raise InputError(
                f"tolerance must be at least {EXACT:g} and below 1, got {self.tolerance}"
            )
        num = len(self.objectives)
        if num not in (0, 2, 3) or len(set(self.objectives)) < num:
            raise InputError(
                f"objectives must name 2 or 3 different weights, got {', '.join(self.objectives)}"
            )


@typed
def sensitivity(
    cost_map: CostMap,
    start: Point,
    goal: Point,
    *,
    snap: bool | float = False,
    settings: SensitivitySettings | None = None,
    progress: Progress = False,
) -> Sensitivity:
    """Return what would change the cheapest route of a query, and what would not.

    Along the range of each weight all breakpoints are found. The Pareto front can hold nearly as many routes as the
    maps have cells, so there the tolerance leaves out routes that never save more than this share of the cost.

    Args:
      cost_map: from `jaxurban.cost_map`; the weights vary around its own.
      start, goal: longitude, latitude in degrees.
      snap: move a start or goal inside an obstacle to the nearest free cell: False never, True by at most 50 m, a
        number by at most this many metres.
      settings: which weights vary, and how far.
      progress: gets the stage and the number of searches so far, as in `ju.build_maps`.

    Returns:
      ``cost``, a row for each weight: its value, the derivative of the cost by it, and its share of the cost
      (``elasticity``); ``breakpoints(name)``, the routes along the range of a weight; ``tables()``, all of it by name;
      ``save`` writes the report.

    Raises:
      InputError: places outside the maps or inside an obstacle, both in one cell or with no path between them, or a
        wrong setting.

    Examples:
      >>> quick = ju.studies.SensitivitySettings(vary=("gps",), num_samples=4, max_plans=20)
      >>> result = ju.studies.sensitivity(ju.cost_map(maps, 60.0), start, goal, settings=quick)
      >>> result.cost["elasticity"].round(2).to_dict()
      {'distance': 0.3, 'gps': 0.07, 'lidar': 0.59, 'population': 0.04, 'risk': 0.0}
      >>> result.breakpoints("gps")["to"].round(2).tolist()  # five routes, by the weight up to which each is cheapest
      [1.43, 1.7, 3.57, 7.62, 10.0]
    """
    # The query, its route, and the columns of the weights that vary.
    check_flat(cost_map)
    begin_s = time.perf_counter()
    settings = settings or SensitivitySettings()
    route = cost_map.plan(start, goal, snap=snap)
    if not route.status.has_path:
        raise InputError(f"there is no route to study: {route.to_dict()['message']}")
    snapped_start, snapped_goal = cost_map.ends(start, goal, snap=snap)
    query = query_between(cost_map, snapped_start.cell, snapped_goal.cell)
    names = query.names
    weights = cost_map.weight_vector
    pool = RoutePool([query])
    columns = varied_columns(names, weights, settings.vary)
    for name in settings.objectives:
        one_of("each of objectives", name, names)
    with reporting("sensitivity", progress) as report:
        # Small changes of the weights, from the features and the integrals [1, K] of the cheapest route.
        report("local")
        features, integrals = pool.cheapest(weights[None])[:, :, 0]
        cost = cost_gradient(names, weights, features)
        outcomes = outcome_slopes(pool, weights, integrals, seed=settings.seed)

        # What the settings leave out: the varied weights, and as objectives of the Pareto front the distance and the
        # two metrics with the largest shares of the cost.
        shares = cost["elasticity"][[name for name in columns if name != "distance"]]
        largest = shares.sort_values(ascending=False, kind="stable").index[:2]
        settings = replace(
            settings,
            vary=tuple(columns),
            objectives=settings.objectives or ("distance", *largest),
        )

        # The whole range of the weights, all at once: Sobol shares.
        sobol = sobol_of_weights(
            pool,
            weights,
            list(columns.values()),
            settings.factors,
            settings.num_samples,
            settings.seed,
            partial(report, "sobol"),
        )

        # One by one: the routes along a line of weights whose ends [2, K] differ in the one that varies.
        lines = {}
        for name, column in columns.items():
            ends = np.tile(weights, (2, 1))
            ends[:, column] *= settings.factors
            lines[name] = find_breakpoints(
                pool, ends, on_plans=partial(report, f"breakpoints of {name}")
            )

        # And traded against each other: the Pareto front.
        front = pareto_front(
            pool,
            settings.objectives,
            tolerance=settings.tolerance,
            max_plans=settings.max_plans,
            on_plans=partial(report, "Pareto front"),
        )

        # The result, with a route to draw for each cell of each line.
        report("routes")
        return Sensitivity(
            maps=cost_map.maps,
            route=route,
            names=names,
            weights=weights,
            settings=settings,
            cost=cost,
            outcomes=outcomes,
            sobol=sobol,
            lines=lines,
            front=front,
            line_routes={name: _routes(query, line) for name, line in lines.items()},
            num_plans=pool.num_plans,
            elapsed_s=time.perf_counter() - begin_s,
        )


def _routes(query: RouteQuery, line: Partition) -> list[np.ndarray]:
    """Return the cheapest route in the middle of each cell of a line, each ``[N, 2]`` easting, northing in metres."""
    southwest_m = query.cost_map.grid.bounds_m[:2]
    with ThreadPoolExecutor() as threads:
        routes = threads.map(query.cheapest, line.weights_at(line.middles))
        return [points_m + southwest_m for points_m in routes]
