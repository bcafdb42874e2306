"""sensitivity: what would change one planned route, and what would not: all weight studies of one query together."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.cost import Weights
from jaxurban.errors import InputError
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.astar import astar
from jaxurban.planners.base import CostKind, CostModel
from jaxurban.studies.kinds import sort_into_kinds
from jaxurban.studies.local import LocalSensitivity, local_sensitivity
from jaxurban.studies.outcomes import outcomes_of
from jaxurban.studies.pareto import ParetoFront, pareto_front
from jaxurban.studies.pool import RoutePool
from jaxurban.studies.queries import Query, unit_map
from jaxurban.studies.sobol import SobolIndices, check_vary, sobol_of_weights
from jaxurban.studies.switches import EXACT, Partition, find_switches
from jaxurban.weighted import Point, weigh

NUM_KINDS = 7  # of routes over a triangle: a picture of more colours is hard to read

OnStage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What the weights do to one route. ``K`` weights.

    Attributes:
      maps: on which it is planned.
      route: the cheapest route under the given weights.
      names: ``"distance"`` and the metrics.
      weights: ``[K]`` as given.
      vary: the weights that vary.
      factors: each from the first to the second of these times its value.
      local: derivatives at the given weights.
      sobol: shares of variance over the whole range.
      lines: of each varied weight, the routes along its range, the others as given.
      triangle_names, triangle: three weights that share their total in all ways, the others as given; None with
        less than three that vary.
      front: routes between wishes.
      kinds, standing: ``[R]`` the kind of each route of the triangle, and ``[M]`` the route that stands for each
        kind, that of the given weights first (see `sort_into_kinds`).
      line_routes, triangle_routes: ``[N, 2]`` easting and northing of the routes of each line, in the order of
        its cells, and of those that stand for the triangle's kinds.
      num_plans, elapsed_s: searches and wall time.
    """

    maps: MetricMaps
    route: PlannedPath
    names: tuple[str, ...]
    weights: np.ndarray
    vary: tuple[str, ...]
    factors: tuple[float, float]
    local: LocalSensitivity
    sobol: SobolIndices
    lines: dict[str, Partition]
    triangle_names: tuple[str, ...]
    triangle: Partition | None
    front: ParetoFront
    kinds: np.ndarray
    standing: np.ndarray
    line_routes: dict[str, list[np.ndarray]]
    triangle_routes: list[np.ndarray]
    num_plans: int
    elapsed_s: float

    def switches(self, name: str) -> pd.DataFrame:
        """Return the routes along the range of one weight: ``from`` and ``to`` its value, and their outcomes.

        ``is_given`` marks the route under the given weights.
        """
        line = self.lines[name]
        column = self.names.index(name)
        ends = np.concatenate([[0.0], line.cuts, [1.0]])
        values = line.weights_at(np.stack([1 - ends, ends], axis=-1))[:, column]
        given = np.searchsorted(values[1:-1], self.weights[column], side="right")
        return pd.DataFrame(
            {"weight_name": name, "from": values[:-1], "to": values[1:]}
            | outcomes_of(line.integrals, self.names)
            | {"is_given": np.arange(len(line.cells)) == given},
            pd.RangeIndex(1, len(line.cells) + 1, name="route"),
        )

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return all tables by name."""
        found = {
            "cost_gradient": self.local.cost,
            "local": self.local.outcomes,
            "sobol": self.sobol.table,
            "sobol_spread": self.sobol.spread,
            "switches": pd.concat([self.switches(name) for name in self.vary]),
            "pareto": self.front.points,
        }
        if self.triangle is not None:
            middles = self.triangle.weights_at(self.triangle.middles)
            found["triangle"] = pd.DataFrame(
                {"share": self.triangle.sizes, "kind": self.kinds + 1}
                | {f"{name}_at_middle": middles[:, self.names.index(name)] for name in self.triangle_names}
                | outcomes_of(self.triangle.integrals, self.names),
                pd.RangeIndex(1, len(middles) + 1, name="route"),
            )
        return found


def sensitivity(
    maps: MetricMaps,
    start: Point,
    goal: Point,
    *,
    altitude_m: float,
    weights: Weights | None = None,
    time_of_day: str | None = None,
    epoch: str | None = None,
    cost_model: CostModel | CostKind = "cell",
    limits: Limits | None = None,
    vary: Sequence[str] = (),
    factors: tuple[float, float] = (0.1, 10.0),
    num_samples: int = 128,
    triangle: Sequence[str] = (),
    wishes: Sequence[str] = (),
    snap: bool | float = False,
    tolerance: float = 1e-3,
    max_plans: int = 5000,
    seed: int = 0,
    on_stage: OnStage | None = None,
) -> Sensitivity:
    """Return what would change the cheapest route of a query, and what would not.

    Along the lines all switches are found. The triangle and the front hold as many routes as maps have cells, nearly:
    there ``tolerance`` leaves out those that never save more than this share of the cost.

    Args:
      maps: from `build_maps` or `open_maps`.
      start, goal: longitude, latitude in degrees.
      altitude_m: one of the maps' altitudes.
      weights: default `Weights()`.
      time_of_day, epoch: of the population and the GPS map; the first if left out.
      cost_model, limits: as in `plan`.
      vary: names of weights; left out: all metrics with a weight above 0. The distance keeps its weight as the
        unit unless it is named, since only ratios of weights choose a route.
      factors: each varies from the first to the second of these times its value.
      num_samples: N of the Sobol indices, a power of two; N x (2 + weights that vary) searches.
      triangle: three weights; left out: the three varied ones with the largest shares of the route's cost.
      wishes: two or three features for the Pareto front; left out: distance and the two varied metrics with the
        largest shares.
      snap: move a start or goal inside an obstacle to the nearest free cell, by at most 50 m, or so many metres.
      tolerance: of the triangle and the front, a share of the cost.
      max_plans: searches that the triangle, and the front, may take each.
      seed: of the Sobol sequence and the noise.
      on_stage: told what runs.

    Raises:
      InputError: places outside the maps or inside an obstacle, both in one cell or with no path between them, or a
        wrong setting.
    """
    begin_s = time.perf_counter()
    on_stage = on_stage or (lambda _: None)
    query, weighed, route = _plan(maps, start, goal, altitude_m, weights, epoch, time_of_day, cost_model, limits, snap)
    names = query.names
    pool = RoutePool([query])
    varied = tuple(vary) or tuple(name for name in names[1:] if weighed[names.index(name)] > 0)
    columns = check_vary(pool, weighed, varied, factors)
    on_stage("local")
    local = local_sensitivity(pool, weighed, seed=seed)
    shares = dict(zip(names, local.cost["elasticity"].to_numpy(), strict=True))
    by_share = sorted(varied, key=lambda name: -shares[name])
    three = _three(triangle, by_share, names)
    wishes = tuple(wishes) or ("distance", *[name for name in by_share if name != "distance"][:2])

    def told(what: str) -> Callable[[int], None]:
        return lambda num_plans: on_stage(f"{what}: {num_plans} searches")

    sobol = sobol_of_weights(
        pool, weighed, varied, factors=factors, num_samples=num_samples, seed=seed, on_plans=told("sobol")
    )
    lines = {}
    for name, column in zip(varied, columns, strict=True):
        ends = np.tile(weighed, (2, 1))
        ends[:, column] *= factors
        lines[name] = find_switches(pool, ends, tolerance=EXACT, on_plans=told(f"switches of {name}"))
    shared, kinds, standing = None, np.empty(0, int), np.empty(0, int)
    if three:
        at = [names.index(name) for name in three]
        corners = np.tile(weighed, (3, 1))
        corners[:, at] = np.eye(3) * weighed[at].sum()
        shared = find_switches(pool, corners, tolerance=tolerance, max_plans=max_plans, on_plans=told("triangle"))
        given = int(shared.route_at(weighed[at] / weighed[at].sum()))
        values = np.stack(list(outcomes_of(shared.integrals, names).values()), axis=-1)
        kinds, standing = sort_into_kinds(values, shared.sizes, given, NUM_KINDS)
    front = pareto_front(pool, wishes, tolerance=tolerance, max_plans=max_plans, on_plans=told("Pareto front"))
    on_stage("routes")
    return Sensitivity(
        maps=maps,
        route=route,
        names=names,
        weights=weighed,
        vary=varied,
        factors=factors,
        local=local,
        sobol=sobol,
        lines=lines,
        triangle_names=three,
        triangle=shared,
        front=front,
        kinds=kinds,
        standing=standing,
        line_routes={name: routes_under(query, line.weights_at(line.middles)) for name, line in lines.items()},
        triangle_routes=[] if shared is None else routes_under(query, shared.weights_at(shared.middles[standing])),
        num_plans=pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
    )


def routes_under(query: Query, weights: np.ndarray) -> list[np.ndarray]:
    """Return ``[N, 2]`` easting, northing of the cheapest route under each of ``[M, K]`` weights."""
    problem = query.unit.problem.between(query.start, query.goal)
    corner_m = np.array([query.unit.grid.x_min_m, query.unit.grid.y_min_m])

    def search(each: np.ndarray) -> np.ndarray:
        return astar(problem.reweighted(each[1:], float(each[0]))).points_m + corner_m

    with ThreadPoolExecutor() as threads:
        return list(threads.map(search, weights))


def _plan(maps, start, goal, altitude_m, weights, epoch, time_of_day, cost_model, limits, snap):
    """Return the query, the weights ``[K]`` and the planned route."""
    setting = {"cost_model": cost_model, "time": epoch, "time_of_day": time_of_day, "limits": limits}
    weights = (weights or Weights()).checked()
    weighted = weigh(maps, altitude_m, weights=weights, **setting)
    route = weighted.plan(start, goal, snap=snap)
    if not route.status.has_path:
        raise InputError(f"there is no route to study: {route.to_dict()['message']}")
    ends = (weighted.locate("start", start, snap=snap).cell, weighted.locate("goal", goal, snap=snap).cell)
    if ends[0] == ends[1]:
        raise InputError("start and goal lie in one cell, so there is no route to study: set them further apart")
    query = Query(unit_map(maps, altitude_m, **setting), *ends)
    return query, np.array([float(getattr(weights, name)) for name in query.names]), route


def _three(asked: Sequence[str], by_share: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return the weights of the triangle, none where less than three vary."""
    if not asked:
        return tuple(by_share[:3]) if len(by_share) >= 3 else ()
    if len(set(asked)) != 3 or len(asked) != 3 or any(name not in names for name in asked):
        raise InputError(f"a triangle takes three of the weights {', '.join(names)}, got {', '.join(asked)}")
    return tuple(asked)
