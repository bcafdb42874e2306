"""What weights do to each of many routes, and how a route differs on changed maps: a row per route.

A row is made alone, so that any number can be made side by side.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from jaxurban.checks import one_of
from jaxurban.errors import InputError
from jaxurban.io.tables import Row
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.places import XY, End
from jaxurban.paths.rows import RouteJob, Run
from jaxurban.paths.snapping import snap_note
from jaxurban.planners.astar import astar
from jaxurban.studies.demonstrations import overlap_of
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.queries import RouteQuery, outcomes_of
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import nearest_breakpoints
from jaxurban.studies.weights.paid import PAID, paid_on
from jaxurban.studies.weights.settings import SensitivitySettings

ROUTE_KEY = ("city", *KEY)
SAME_SUMS = 1e-9  # relative: routes whose sums differ by less are one route
# Columns of each weight, as "below:gps".
OF_WEIGHT = (
    "elasticity",
    "below",
    "above",
    "regret_low",
    "regret_high",
    *(f"more_{name}" for name in PAID),
)
TOGETHER = "together:"  # begins the columns of two weights, as "together:gps,risk"
SIGNS = np.array([(1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (-1.0, -1.0)])  # of two weights
TEXTS = ("city", "status", "note", "vary", "change", "layers")


@dataclass(frozen=True, kw_only=True)
class WeightsJob(RouteJob):
    """What the weights do to the route of an instance.

    Attributes:
      settings: what is asked.
      snap: move an end that is not free to the nearest free cell: False never, True by at most 50 m, a number by at
        most this many metres.
      cost_model, constraints, preset: see `jaxurban.paths.rows.RouteRules`.
    """

    settings: SensitivitySettings
    snap: bool | float = False

    key = ROUTE_KEY

    def to_dict(self) -> dict[str, Any]:
        """Return what decides a row, as plain, JSON-ready values."""
        names = ("factors", "vary", "wrong", "seed", "height_seed")
        asked = {name: getattr(self.settings, name) for name in names}
        return self.rules() | asked | {"snap": self.snap}

    def facts(self, cost_map: CostMap, instance: Row, runs: Sequence[Run]) -> list[dict[str, Any]]:
        """Return what the weights do to the route of an instance, as one row (see `typed_columns`)."""
        # The cheapest route, and what it costs.
        begin_s = time.perf_counter()
        settings = self.settings
        query, weights, ends = query_of(cost_map, instance, self.snap)
        varied = varied_columns(query.names, weights, settings.vary)
        path = astar(query.problem(weights))
        if not path.status.has_path:
            note = f"{path.status.sentence} {cost_map.free_space.apart_note(*ends)}".strip()
            return [{"status": path.status.value, "note": note}]
        features, integrals = query.sums(path.points_m)
        cost = float(weights @ features)
        if not cost > 0:
            raise InputError(
                "the cheapest route costs nothing, so no weight has a share of its cost: give a weight above 0"
            )
        facts = {
            "status": path.status.value,
            "note": f"{snap_note(*ends)} {path.note}".strip(),
            "vary": ",".join(varied),
            "cost": cost,
        }
        facts |= {name: float(value) for name, value in outcomes_of(integrals, query.names).items()}
        for name, share in zip(query.names, weights * features / cost, strict=True):
            facts[f"elasticity:{name}"] = float(share)

        # How it changes with each weight that varies.
        pool = RoutePool([query])
        columns = list(varied.values())
        nearest = nearest_breakpoints(pool, weights, columns, settings.factors)

        # What the route costs that is planned with a weight too small, or too large: the regrets, and of the worse of
        # the two what a user pays more.
        paid = paid_on(cost_map)
        own = paid(path.points_m)
        facts |= {name: own[name] for name in own if name != "length_m"}
        for (name, column), factors in zip(varied.items(), nearest.tolist(), strict=True):
            regrets, others = [], []
            for factor in (1 / settings.wrong, settings.wrong):
                wrong = weights.copy()
                wrong[column] *= factor
                points_m = query.cheapest(wrong)
                regrets.append(max(float(query.sums(points_m)[0] @ weights / cost - 1), 0.0))
                others.append(paid(points_m))
            worse = others[int(np.argmax(regrets))]
            more = [worse.get(each, math.nan) - own.get(each, math.nan) for each in PAID]
            values = (*factors, *regrets, *more)
            facts |= {
                f"{kind}:{name}": each for kind, each in zip(OF_WEIGHT[1:], values, strict=True)
            }

        facts |= two_wrong(pool, weights, cost, varied, settings.wrong)
        elapsed_s = time.perf_counter() - begin_s
        return [facts | {"num_plans": pool.num_plans + 2 * len(varied) + 1, "elapsed_s": elapsed_s}]


def two_wrong(
    pool: RoutePool, weights: np.ndarray, cost: float, columns: Mapping[str, int], factor: float
) -> dict[str, float]:
    """Return of each two weights what both cost more that are wrong in opposite directions than in the same one.

    It is half of the difference of two routes and two, under the true weights, as a share of the cost, by `TOGETHER`
    and their names.

    Args:
      pool: of one query; routes found join it.
      weights: ``[K]`` the true ones.
      cost: of the cheapest route under them.
      columns: of the weights that vary, by name.
      factor: by which a weight is too large or too small.
    """
    more = {}
    for one, other in combinations(columns, 2):
        wrong = np.tile(weights, (4, 1))
        wrong[:, [columns[one], columns[other]]] *= factor**SIGNS
        costs = pool.cheapest(wrong)[0, 0] @ weights
        more[f"{TOGETHER}{one},{other}"] = float(costs @ [0.5, 0.5, -0.5, -0.5]) / cost
    return more


def varied_columns(
    names: Sequence[str], weights: np.ndarray, vary: Sequence[str], where: str = ""
) -> dict[str, int]:
    """Return the columns of the weights to vary, by name.

    Args:
      names: ``[K]`` of the weights, ``"distance"`` first.
      weights: ``[K]``.
      vary: names of the weights to vary; empty: all metrics whose weight is above 0.
      where: ends "weight gps is 0" in an error, such as " on every route".

    Raises:
      InputError: no weight varies, or one is named that does not exist or is 0.
    """
    if not vary:
        vary = [name for name, weight in zip(names[1:], weights[1:], strict=True) if weight > 0]
    if not vary:
        raise InputError(
            f"every metric has weight 0{where}, so nothing varies: give one a weight above 0, or name vary"
        )
    columns = {name: names.index(one_of("a weight that varies", name, names)) for name in vary}
    for name, column in columns.items():
        if not weights[column] > 0:
            raise InputError(
                f"weight {name} is 0{where}, which no factor changes: give it a value above 0, or do not vary it"
            )
    return columns


def typed_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the columns of rows with their types; a metric that some maps lack has no number there.

    For every route: ``status`` and ``note``; ``cost``, the outcomes (`outcomes_of`) and what a user pays (`paid_on`) of
    the cheapest route under the given weights; ``vary``, the weights that vary; ``num_plans`` and ``elapsed_s``. A
    route that is not found has its status and note alone.

    For each weight: ``elasticity:NAME``, its share of the cost, which is d log cost / d log w.

    For each weight that varies: ``below:NAME`` and ``above:NAME``, the nearest factors at which the route changes (NaN
    if none is within the range). ``regret_low:NAME`` and ``regret_high:NAME``, by which share a route costs more under
    the true weights if it is planned with this weight ``wrong`` times too small or too large, and what a user pays more
    for the worse one of the two (``more_length_m:NAME`` and the like of `PAID`). For each two of these weights
    ``together:NAME,OTHER``, by which share of the cost both cost more that are wrong in opposite directions than in the
    same one (`two_wrong`).
    """
    names = dict.fromkeys(name for row in rows for name in row)
    types = {"instance": "int64"} | dict.fromkeys(TEXTS, "object")
    return {name: types.get(name, "float64") for name in names}


def query_of(
    cost_map: CostMap, instance: Row, snap: bool | float = False
) -> tuple[RouteQuery, np.ndarray, tuple[End, End]]:
    """Return the query of an instance, its weights ``[K]``, and its ends.

    Args:
      cost_map: on which its ends lie.
      instance: its ends in metres, and a weight ``w_NAME`` for each name of the map.
      snap: as in `WeightsJob`.

    Raises:
      InputError: a place that is not free, or both in one cell.
    """
    places = [XY(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")]
    ends = cost_map.free_space.ends(*places, snap=snap)
    start, goal = (end.cell for end in ends)
    if start == goal:
        raise InputError(
            "start and goal lie in one cell, so there is no route to study: set them further apart"
        )
    query = RouteQuery(cost_map, start, goal, str(instance["instance"]))
    weights = np.array([float(instance[f"w_{name}"]) for name in query.names])
    return query, weights, ends


@dataclass(frozen=True, kw_only=True, eq=False)
class OnChangedMaps(RouteJob):
    """How the cheapest route on changed maps differs from that on the nominal maps.

    Its rows: ``status``, both routes'; ``is_other``, whether they add up to something else on the nominal maps;
    ``overlap``, the share of the nominal route's cells that the other one shares; ``nominal_is_closed``, whether the
    nominal route crosses what is closed on the changed maps, else ``nominal_regret``, by which share it costs more
    there than the cheapest route.

    Attributes:
      nominal_at: returns the cost map of the nominal maps at an altitude, time and time of day.
      change: the columns that name the changed maps, with their values.
      layers: the metrics that the change of times changes, parted by commas.
      snap: of the ends on the nominal maps.
    """

    nominal_at: Callable[..., CostMap]
    change: Mapping[str, Any]
    layers: str = ""
    snap: bool | float = False

    key = ROUTE_KEY

    def key_of(self, instance: Row, run: Run) -> dict[str, Any]:
        """Return the columns that name the row of an instance, with their values, those of the change first."""
        return {**self.change, **super().key_of(instance, run)}

    def facts(self, cost_map: CostMap, instance: Row, runs: Sequence[Run]) -> list[dict[str, Any]]:
        """Return how the route of an instance differs between the nominal maps and the changed ones, as one row."""
        at = instance["altitude_m"], instance["time"], instance["time_of_day"]
        nominal, weights, _ = query_of(self.nominal_at(*at), instance, self.snap)
        other = replace(nominal, cost_map=cost_map)
        if not all(cost_map.is_free[cell] for cell in (nominal.start, nominal.goal)):
            raise InputError("an end of the route is closed on these maps")
        return [_compared(nominal, other, weights) | {"layers": self.layers}]


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

    # Both routes on the nominal map, and the nominal one on the other map, where it may be closed.
    on_nominal = nominal.cost_map.problem.features
    own = on_nominal(nominal_m)
    moved = on_nominal(other_m)
    kept = other.cost_map.problem.features(nominal_m)
    is_same = moved.is_valid and np.allclose(moved.phi, own.phi, rtol=SAME_SUMS, atol=SAME_SUMS)
    best = paths[1].cost
    return {
        "status": paths[0].status.value,
        "is_other": float(not is_same),
        "overlap": overlap_of(nominal_m, other_m, nominal.cost_map.grid.resolution_m),
        "nominal_is_closed": float(not kept.is_valid),
        "nominal_regret": max(kept.cost(weights) / best - 1, 0.0)
        if kept.is_valid and best > 0
        else math.nan,
    }
