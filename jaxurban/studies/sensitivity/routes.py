"""What weights do to each of many routes: one row a route, made alone, so that any number can be made side by side."""

import math
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxurban.errors import InputError, at_least, positive, typed
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.planners.astar import astar
from jaxurban.planners.base import CostKind
from jaxurban.planners.cost_model import CostModel
from jaxurban.presets import Preset
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.montecarlo.trial import BAD_INPUT, CRASHED, KILLED, InstanceRules, free_cell
from jaxurban.studies.outcomes import outcomes_of
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.sensitivity.breakpoints import nearest_breakpoints
from jaxurban.studies.sensitivity.sobol import check_vary, sobol_of_weights

ROUTE_KEY = ("city", *KEY)
OF_WEIGHT = ("elasticity", "below", "above", "regret_low", "regret_high")  # columns of each weight, as "below:gps"
OF_SHARE = ("first", "first_ci", "total", "total_ci")  # and of each outcome too, as "first:gps:length_m"
TEXTS = ("city", "status", "note", "vary", "changed")


@typed
@dataclass(frozen=True)
class SensitivityStudySettings(InstanceRules):
    """What is asked of every route of a weight study.

    Attributes:
      vary: names of weights; left out: all metrics of a route's maps whose weight is above 0. The distance keeps its
        weight as the unit unless it is named.
      factors: breakpoints are looked for, and weights of the Sobol indices drawn, from the first to the second of
        these times each weight.
      wrong: a wrong weight is so many times too large or too small.
      num_samples: N of each route's Sobol indices, a power of two, N x (2 + weights that vary) searches; 0: none.
      cost_model: of the routes, or its kind alone.
      constraints: no-fly zones, bounds and clearances that close cells to every route.
      seed: of the sampling of routes and weights, mixed with the city's name and the route's number.
      num_threads: of the searches of a route; left out, one a core, and one where several processes work.
      preset: ``"paper"`` for its cost model, obstacles and clearance instead of the defaults of what is left out here
        and in the scenario of the maps, from which the study takes what it gives.

    Raises:
      InputError: a value that is none of these.
    """

    vary: tuple[str, ...] = ()
    factors: tuple[float, float] = (0.1, 10.0)
    wrong: float = 2.0
    num_samples: int = 32
    cost_model: CostModel | CostKind | None = None
    constraints: Constraints = field(default_factory=Constraints)
    seed: int = 0
    num_threads: int | None = None
    preset: str = ""

    def __post_init__(self) -> None:
        Preset.of(self.preset)  # refuses an unknown one, as the next line does
        CostModel.of(self.cost_model)
        at_least("seed", self.seed)
        if self.num_threads is not None:
            at_least("num_threads", self.num_threads, 1)
        if len(set(self.vary)) < len(self.vary):
            raise InputError(f"vary must name each weight once, got {', '.join(self.vary)}")
        if len(self.factors) != 2 or not 0 < self.factors[0] < 1 < self.factors[1] < math.inf:
            raise InputError(f"factors must be two, from below 1 to above 1, as 0.1, 10, got {self.factors}")
        if not positive("wrong", self.wrong) > 1:
            raise InputError(f"wrong must be a factor above 1 such as 2, got {self.wrong}")
        if self.num_samples < 0 or self.num_samples == 1 or self.num_samples & (self.num_samples - 1):
            raise InputError(f"num_samples must be 0 or a power of two such as 32, got {self.num_samples}")

    def to_dict(self) -> dict[str, Any]:
        """Return what decides a row, as plain, JSON-ready values."""
        chosen = {name: getattr(self, name) for name in ("factors", "vary", "wrong", "num_samples", "seed")}
        return {**CostModel.of(self.cost_model).settings, **chosen, "limits": self.constraints.to_dict()}

    def solve(self, on: CostMap, instance: Mapping[str, Any], runs: Sequence[tuple[str, ...]]) -> list[dict[str, Any]]:
        """Return the row of a route (see `route_row`); one that fails is a row with its status."""
        try:
            facts = route_row(on, instance, self)
        except InputError as error:
            facts = {"status": BAD_INPUT, "note": str(error)}
        except Exception as error:  # whatever a route does, the study goes on
            facts = {"status": CRASHED, "note": f"{type(error).__name__}: {error}"}
        return [row_of(instance, **facts)]

    def killed(self, instance: Mapping[str, Any], run: tuple[str, ...]) -> dict[str, Any]:
        """Return the row of a route whose worker was killed again and again."""
        return row_of(instance, status=CRASHED, note=KILLED)


def row_of(instance: Mapping[str, Any], **facts: Any) -> dict[str, Any]:
    """Return the row of a route: its key and what is known, None for what is no number."""
    key = {name: instance[name] for name in ROUTE_KEY}
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in (key | facts).items()
    }


def row_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the columns of rows with their types; a metric that some maps lack has no number there."""
    names = dict.fromkeys(name for row in rows for name in row)
    types = {"instance": "int64"} | dict.fromkeys(TEXTS, "object")
    return {name: types.get(name, "float64") for name in names}


def query_of(on: CostMap, instance: Mapping[str, Any]) -> tuple[RouteQuery, np.ndarray]:
    """Return the query of an instance, and its weights ``[K]``.

    Raises:
      InputError: a place that is not free, or both in one cell.
    """
    ends = ((instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal"))
    start, goal = (free_cell(on.grid, on.is_free, x_m, y_m) for x_m, y_m in ends)
    if start == goal:
        raise InputError("start and goal lie in one cell, so there is no route to study: set them further apart")
    query = RouteQuery(on, start, goal, str(instance["instance"]))
    return query, np.array([float(instance[f"w_{name}"]) for name in query.names])


def route_row(on: CostMap, instance: Mapping[str, Any], settings: SensitivityStudySettings) -> dict[str, Any]:
    """Return what the weights do to one route.

    ``status``; ``cost`` and the outcomes of the cheapest route under the given weights (`outcomes_of`); for each weight
    ``elasticity:NAME``, its share of the cost, which is d log cost / d log w; for each that varies ``below:NAME`` and
    ``above:NAME``, the nearest factors at which the route changes (none within the range: no number);
    ``regret_low:NAME`` and ``regret_high:NAME``, how much dearer, under the true weights, the route is that is the
    cheapest where this weight is `wrong` times too small or too large; and its Sobol shares of each outcome with half
    the width of their 95 % intervals, ``first:NAME:OUTCOME``, ``first_ci``, ``total`` and ``total_ci`` likewise.

    Args:
      on: the maps.
      instance: ends and weights.
      settings: what is asked.

    Raises:
      InputError: a place that is not free, both in one cell, or a weight to vary that is 0 or not there.
    """
    begin_s = time.perf_counter()
    query, weights = query_of(on, instance)
    names = query.names
    vary = settings.vary or tuple(name for name, weight in zip(names[1:], weights[1:], strict=True) if weight > 0)
    if not vary:
        raise InputError("no metric of these maps has a weight above 0, so nothing varies: give one, or name vary")
    first = astar(query.problem(weights))
    if not first.status.has_path:
        return {"status": first.status.value, "note": first.status.sentence}
    features, integrals = query.sums(first.points_m)
    cost = float(weights @ features)
    if not cost > 0:
        raise InputError(
            "the cheapest route costs nothing, so no weight has a share of its cost: give a weight above 0"
        )
    facts: dict[str, Any] = {"status": first.status.value, "note": first.note, "vary": ",".join(vary), "cost": cost}
    facts |= {name: float(value) for name, value in outcomes_of(integrals, names).items()}
    facts |= {f"elasticity:{name}": float(w * f / cost) for name, w, f in zip(names, weights, features, strict=True)}
    pool = RoutePool([query], workers=settings.num_threads)
    columns = check_vary(pool, weights, vary, settings.factors)
    nearest = nearest_breakpoints(pool, weights, columns, settings.factors)
    wrong = np.tile(weights, (2 * len(vary), 1))
    wrong[np.arange(len(wrong)), np.repeat(columns, 2)] *= np.tile([1 / settings.wrong, settings.wrong], len(vary))
    regret = np.maximum(pool.cheapest(wrong)[0, 0] @ weights / cost - 1, 0.0).reshape(-1, 2)
    for name, ends, lost in zip(vary, nearest, regret, strict=True):
        facts |= {f"below:{name}": float(ends[0]), f"above:{name}": float(ends[1])}
        facts |= {f"regret_low:{name}": float(lost[0]), f"regret_high:{name}": float(lost[1])}
    if settings.num_samples:
        of_route = [settings.seed, zlib.crc32(instance["city"].encode()), int(instance["instance"])]
        seed = int(np.random.SeedSequence(of_route).generate_state(1)[0])
        shares = sobol_of_weights(
            pool, weights, vary, factors=settings.factors, num_samples=settings.num_samples, seed=seed % 2**31
        )
        for share in shares.table.reset_index().to_dict("records"):
            where = f"{share['factor']}:{share['outcome']}"
            facts |= {f"{kind}:{where}": float(share[kind]) for kind in OF_SHARE}
    return facts | {"num_plans": pool.num_plans + 1, "elapsed_s": time.perf_counter() - begin_s}
