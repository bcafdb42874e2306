"""What weights do to each of many routes, and how a route differs on changed maps: a row per route.

A row is made alone, so that any number can be made side by side.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.io.tables import Row
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.rows import RouteJob, Run
from jaxurban.planners.astar import astar
from jaxurban.studies.demonstrations import overlap_of
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.montecarlo.trial import ends_and_weights
from jaxurban.studies.queries import RouteQuery, outcomes_of, query_between
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import nearest_breakpoints
from jaxurban.studies.weights.sobol import (
    OF_SHARE,
    check_sampling,
    sobol_of_weights,
    varied_columns,
)

ROUTE_KEY = ("city", *KEY)
CITY_NUMBER = "city_number"  # column of instances: the place of a route's city among those of the study, from 0
SAME_SUMS = 1e-9  # relative: routes whose sums differ by less are one route
# Columns of each weight, as "below:gps"; those of each weight and outcome are as "first:gps:length_m" (`OF_SHARE`).
OF_WEIGHT = ("elasticity", "below", "above", "regret_low", "regret_high")
TEXTS = ("city", "status", "note", "vary", "parameter")


@typed
@dataclass(frozen=True)
class SensitivityStudySettings(RouteJob):
    """What is asked of every route of a weight study.

    Attributes:
      vary: names of weights; left out: all metrics of a route's maps whose weight is above 0. The distance keeps its
        weight as the unit unless it is named.
      factors: breakpoints are looked for, and weights of the Sobol indices drawn, from the first to the second of
        these times each weight.
      wrong: factor by which a wrong weight is too large or too small.
      num_samples: N of each route's Sobol indices, a power of two, N x (2 + weights that vary) searches; 0: none.
      num_heights: draws of all heights, on the maps of each of which every route is planned too.
      has_parameters: also plan on maps of which one parameter of the metrics is halved or doubled: each number that
        they have a gradient by (GDOP threshold, lidar range, risk threshold, both gammas of the population).
      seed: of the sampling of routes and weights, with the place of the city among those of the study and the route's
        number.
      num_threads: of the searches of a route; left out, one a core, and one where several processes work.
      cost_model, constraints, preset: of all routes, as in `jaxurban.plan`.

    Raises:
      InputError: factors that do not enclose 1, a number of samples that is no power of two, or another wrong value.

    Examples:
      >>> settings = ju.studies.SensitivityStudySettings(vary=("gps", "risk"), factors=(0.5, 2.0), num_samples=16)
      >>> settings.vary, settings.wrong
      (('gps', 'risk'), 2.0)
    """

    vary: tuple[str, ...] = ()
    factors: tuple[float, float] = (0.1, 10.0)
    wrong: float = 2.0
    num_samples: int = 32
    num_heights: int = 0
    has_parameters: bool = False
    seed: int = 0
    num_threads: int | None = None

    key = ROUTE_KEY

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sampling(self)
        at_least("num_heights", self.num_heights)
        if self.num_threads is not None:
            at_least("num_threads", self.num_threads, 1)
        if not positive("wrong", self.wrong) > 1:
            raise InputError(f"wrong must be a factor above 1 such as 2, got {self.wrong}")

    def to_dict(self) -> dict[str, Any]:
        """Return what decides a row, as plain, JSON-ready values.

        Returns:
          The cost model, the constraints (``limits``), and the settings of what is asked of a route.

        Examples:
          >>> record = ju.studies.SensitivityStudySettings(vary=("gps",)).to_dict()
          >>> record["cost_model"], record["factors"], record["wrong"]
          ('line', (0.1, 10.0), 2.0)
        """
        return self.rules() | {
            name: getattr(self, name)
            for name in ("factors", "vary", "wrong", "num_samples", "seed")
        }

    def facts(self, cost_map: CostMap, instance: Row, runs: Sequence[Run]) -> list[dict[str, Any]]:
        """Return what the weights do to the route of an instance.

        Returns:
          One row, as in ``rows`` of a `SensitivityStudy`.

        Examples:
          >>> instance = ju.studies.sample_instances(maps, 1, altitudes_m=[60.0]).to_dict("records")[0]
          >>> chosen = ju.studies.SensitivityStudySettings(vary=("gps",), num_samples=0)
          >>> (row,) = chosen.facts(ju.cost_map(maps, 60.0), instance, [()])
          >>> row["status"], round(row["cost"], 1), round(row["length_m"])
          ('optimal', 18.0, 148)
        """
        # The cheapest route, and what it costs.
        begin_s = time.perf_counter()
        query, weights = query_of(cost_map, instance)
        varied = varied_columns(query.names, weights, self.vary)
        path = astar(query.problem(weights))
        if not path.status.has_path:
            return [{"status": path.status.value, "note": path.status.sentence}]
        features, integrals = query.sums(path.points_m)
        cost = float(weights @ features)
        if not cost > 0:
            raise InputError(
                "the cheapest route costs nothing, so no weight has a share of its cost: give a weight above 0"
            )
        facts = {
            "status": path.status.value,
            "note": path.note,
            "vary": ",".join(varied),
            "cost": cost,
        }
        facts |= {name: float(value) for name, value in outcomes_of(integrals, query.names).items()}
        for name, share in zip(query.names, weights * features / cost, strict=True):
            facts[f"elasticity:{name}"] = float(share)

        # How it changes with each weight that varies.
        pool = RoutePool([query], workers=self.num_threads)
        columns = list(varied.values())
        nearest = nearest_breakpoints(pool, weights, columns, self.factors)

        # [varied, 2, K] the weights with each that varies too small, then too large, and the regrets [varied, 2].
        wrong = np.tile(weights, (len(columns), 2, 1))
        for number, column in enumerate(columns):
            wrong[number, :, column] *= 1 / self.wrong, self.wrong
        cheapest = pool.cheapest(wrong.reshape(-1, len(weights)))[0, 0]
        regret = np.maximum(cheapest @ weights / cost - 1, 0.0).reshape(-1, 2)
        for name, values in zip(varied, np.hstack([nearest, regret]).tolist(), strict=True):
            for kind, value in zip(OF_WEIGHT[1:], values, strict=True):
                facts[f"{kind}:{name}"] = value

        # The Sobol shares of its outcomes; the draws of each route have a seed of their own.
        if self.num_samples:
            seed = seed_at(self.seed, int(instance.get(CITY_NUMBER, 0)), int(instance["instance"]))
            shares = sobol_of_weights(
                pool,
                weights,
                columns,
                self.factors,
                self.num_samples,
                seed % 2**31,
            )
            for share in shares.reset_index().to_dict("records"):
                suffix = f"{share['factor']}:{share['outcome']}"
                facts |= {f"{kind}:{suffix}": float(share[kind]) for kind in OF_SHARE}
        elapsed_s = time.perf_counter() - begin_s
        return [facts | {"num_plans": pool.num_plans + 1, "elapsed_s": elapsed_s}]


def typed_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the columns of rows with their types; a metric that some maps lack has no number there.

    For every route: ``status`` and ``note``; ``cost`` and the outcomes (`outcomes_of`) of the cheapest route under the
    given weights; ``vary``, the weights that vary; ``num_plans`` and ``elapsed_s``. A route that is not found has its
    status and note alone.

    For each weight: ``elasticity:NAME``, its share of the cost, which is d log cost / d log w.

    For each weight that varies: ``below:NAME`` and ``above:NAME``, the nearest factors at which the route changes (NaN
    if none is within the range). ``regret_low:NAME`` and ``regret_high:NAME``, by which share a route costs more under
    the true weights if it is planned with this weight ``wrong`` times too small or too large. ``first:NAME:OUTCOME``
    and ``total:NAME:OUTCOME``, its Sobol shares of each outcome, with half the width of their 95 % intervals
    (``first_ci``, ``total_ci``), unless no samples are asked for.
    """
    names = dict.fromkeys(name for row in rows for name in row)
    types = {"instance": "int64"} | dict.fromkeys(TEXTS, "object")
    return {name: types.get(name, "float64") for name in names}


def query_of(cost_map: CostMap, instance: Row) -> tuple[RouteQuery, np.ndarray]:
    """Return the query of an instance, and its weights ``[K]``.

    Raises:
      InputError: a place that is not free, or both in one cell.
    """
    start, goal, weights = ends_and_weights(cost_map, instance)
    return query_between(cost_map, start, goal, str(instance["instance"])), weights


def seed_at(seed: int, *place: int) -> int:
    """Return the seed of draws at a place of a study: the number of a city, or of a city and a route."""
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class OnChangedMaps(RouteJob):
    """How the cheapest route on changed maps differs from that on the nominal maps.

    Its rows: ``status``, both routes'; ``is_other``, whether they add up to something else on the nominal maps;
    ``overlap``, the share of the nominal route's cells that the other one shares; ``is_closed``, whether the other one
    crosses what is closed on the nominal maps, else ``regret``, by which share it costs more on them than the nominal
    route; ``nominal_is_closed`` and ``nominal_regret`` the same of the nominal route on the changed maps.

    Attributes:
      nominal_at: returns the cost map of the nominal maps at an altitude, time and time of day.
      change: the columns that name the changed maps, with their values.
    """

    nominal_at: Callable[..., CostMap]
    change: Mapping[str, Any]

    key = ROUTE_KEY

    def key_of(self, instance: Row, run: Run) -> dict[str, Any]:
        """Return the columns that name the row of an instance, with their values, those of the change first."""
        return {**self.change, **super().key_of(instance, run)}

    def facts(self, cost_map: CostMap, instance: Row, runs: Sequence[Run]) -> list[dict[str, Any]]:
        """Return how the route of an instance differs between the nominal maps and the changed ones, as one row."""
        at = instance["altitude_m"], instance["time"], instance["time_of_day"]
        nominal, weights = query_of(self.nominal_at(*at), instance)
        other, _ = query_of(cost_map, instance)
        return [_compared(nominal, other, weights)]


def _compared(nominal: RouteQuery, other: RouteQuery, weights: np.ndarray) -> dict[str, Any]:
    """Return how a route changes on another map, and what it costs to keep the nominal route there.

    The columns are those of `OnChangedMaps`; where either map has no route, its status and a note alone.

    Args:
      nominal, other: the same query on the nominal map and on the other one.
      weights: ``[K]``.
    """
    # The cheapest route of each map.
    paths = [astar(query.problem(weights)) for query in (nominal, other)]
    for path in paths:
        if not path.status.has_path:
            return {"status": path.status.value, "note": path.status.sentence}
    nominal_m, other_m = (path.points_m for path in paths)

    # Both routes on both maps: own and moved on the nominal map, kept and best on the other one.
    on_nominal = nominal.cost_map.problem.features
    on_other = other.cost_map.problem.features
    own = on_nominal(nominal_m)
    moved = on_nominal(other_m)
    kept = on_other(nominal_m)
    best = on_other(other_m)
    is_same = moved.is_valid and np.allclose(moved.phi, own.phi, rtol=SAME_SUMS, atol=SAME_SUMS)
    return {
        "status": paths[0].status.value,
        "is_other": float(not is_same),
        "overlap": overlap_of(nominal_m, other_m, nominal.cost_map.grid.resolution_m),
        "is_closed": float(not moved.is_valid),
        "nominal_is_closed": float(not kept.is_valid),
        "regret": _regret(moved.cost(weights), own.cost(weights)),
        "nominal_regret": _regret(kept.cost(weights), best.cost(weights)),
    }


def _regret(cost: float, best: float) -> float:
    """Return by which share a cost is above the best; NaN for a path that is closed."""
    return max(cost / best - 1, 0.0) if math.isfinite(cost) and best > 0 else math.nan
