"""Routes planned on each of two sets of maps and judged by the other: what a difference of maps changes for routes."""

from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.plan import cost_map
from jaxurban.planners.base import Path
from jaxurban.planners.registry import solve_many
from jaxurban.progress import Report
from jaxurban.studies.bootstrap import Clusters, named

WAYS = (("A", "B"), ("B", "A"))  # planned on, judged on
HEAD = ["altitude_m", "planned_on", "judged_on"]
NUMBERS = "cost", "length_m", "cost_there", "regret", "closed_m", "is_closed"


def compared_routes(
    a: MetricMaps,
    b: MetricMaps,
    num: int,
    seed: int,
    times: tuple[str | None, str | None],
    report: Report,
) -> pd.DataFrame:
    """Return a row for each route that is planned on map A and judged on map B, and the other way round.

    At each altitude ``num`` pairs of cells that are free in both maps are drawn, and on each map the cheapest route of
    the grid between them is planned. Both maps have the weights, cost model and constraints of A's scenario.

    Args:
      a, b: the maps, cut to what both hold (`map_comparison.shared_part`).
      num: pairs at each altitude.
      seed: of the pairs.
      times: of A and of B; None: the first one.
      report: called with stage, done and total.

    Returns:
      Rows with the ends in metres and ``status``. ``cost`` is the route's cost on the map on which it was planned,
      ``cost_there`` its cost on the other map (NaN where it is closed there), ``best_there`` the cost of the other
      map's own route, and ``regret`` is cost_there / best_there - 1. ``closed_m`` is its length in cells that are
      closed on the other map, and ``is_closed`` is 1 where it crosses such cells or comes too near one. A route that
      was not found has NaN instead.

    Raises:
      InputError: fewer than two cells are free in both at an altitude, or the scenario asks what B does not hold.
    """
    time_a, time_b = times
    rows = []
    for number, altitude_m in enumerate(report.over("routes", a.altitudes_m)):
        on_a = cost_map(a, altitude_m, time=time_a)
        on_b = cost_map(
            b,
            altitude_m,
            time=time_b,
            weights={name: float(on_a.weights[name]) for name in ("distance", *b.metrics)},
            objective=on_a.objective,
            cost_model=on_a.cost_model,
            constraints=on_a.constraints,
        )

        # Pairs of different cells: the goal is a random number of places, but not 0, after the start.
        free = np.argwhere(on_a.is_free & on_b.is_free)
        if len(free) < 2:
            raise InputError(
                f"at {altitude_m:g} m fewer than two cells are free in both maps: leave out routes"
            )
        rng = np.random.default_rng([seed, number])
        start = rng.integers(len(free), size=num)
        goal = (start + rng.integers(1, len(free), size=num)) % len(free)
        ends = np.stack([free[start], free[goal]], axis=1)

        # The cheapest path of each pair on either map, judged by the other map.
        cost_maps = {"A": on_a, "B": on_b}
        paths = {name: _planned(one_map, ends) for name, one_map in cost_maps.items()}
        for pair, (start_cell, goal_cell) in enumerate(ends):
            start_x_m, start_y_m = on_a.grid.xy_of_cell(*start_cell)
            goal_x_m, goal_y_m = on_a.grid.xy_of_cell(*goal_cell)
            for planned_on, judged_on in WAYS:
                row = {
                    "pair": pair,
                    "altitude_m": altitude_m,
                    "planned_on": planned_on,
                    "judged_on": judged_on,
                    "start_x_m": start_x_m,
                    "start_y_m": start_y_m,
                    "goal_x_m": goal_x_m,
                    "goal_y_m": goal_y_m,
                }
                path = paths[planned_on][pair]
                best = paths[judged_on][pair]
                rows.append(row | _judged(cost_maps[judged_on], path, best))
    return pd.DataFrame(rows)


def _planned(cost_map: CostMap, ends: np.ndarray) -> list[Path]:
    """Return the cheapest path of the grid for each of ``N`` pairs of cells, in their order.

    Args:
      cost_map: whose weights, cost model and constraints hold.
      ends: ``[N, 2, 2]`` start and goal of each pair, as row and column.

    Raises:
      Exception: whatever the search of a pair raised.
    """
    problems = [
        cost_map.problem.between(tuple(start), tuple(goal)) for start, goal in ends.tolist()
    ]
    paths = []
    for _, outcome in sorted(solve_many(problems), key=itemgetter(0)):
        if isinstance(outcome, Exception):
            raise outcome
        paths.append(outcome)
    return paths


def _judged(cost_map: CostMap, path: Path, best: Path) -> dict[str, Any]:
    """Return the columns of a row that say what a path costs on another map than its own (see `compared_routes`).

    Args:
      cost_map: the other map.
      path: planned on its own map; without points all `NUMBERS` are NaN.
      best: the cheapest path of the other map between the same ends.
    """
    # Whether both paths were found.
    facts: dict[str, Any] = {"status": path.status.value, "best_there": np.nan}
    if best.status.has_path:
        facts["best_there"] = best.cost
    if not path.status.has_path:
        return facts | dict.fromkeys(NUMBERS, np.nan)

    # What the path costs on the other map.
    features = cost_map.problem.features(path.points_m)
    cost = np.nan  # where the path is closed
    if features.is_valid:
        cost = features.cost(cost_map.problem.weights)

    # A path that costs the same as the best one has the regret 0. The cost NaN of a closed path is not less than any
    # cost, so the regret is NaN, or inf where the best path costs nothing.
    regret = 0.0
    if not cost <= best.cost * SAME_COST:
        regret = cost / best.cost - 1 if best.cost > 0 else np.inf
    return facts | {
        "cost": path.cost,
        "length_m": features.length_m.sum(),
        "cost_there": cost,
        "regret": regret,
        "closed_m": features.length_m[~cost_map.is_free[features.crossed]].sum(),
        "is_closed": float(not features.is_valid),
    }


def route_regrets(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how many routes the other map closes, and the regret of the others.

    A row for each altitude and for each map that routes were planned on. Routes that were not found do not count. The
    share ``closed`` and the median ``regret`` have 95 % intervals by the bootstrap over pairs
    (`jaxurban.studies.bootstrap`), which are NaN for fewer than eight pairs.

    Args:
      rows: of `compared_routes`.
    """
    table = []
    for head, routes in rows.groupby(HEAD, sort=False):
        routes = routes[routes["is_closed"].notna()]
        clusters = Clusters(routes["pair"])
        regret = routes["regret"]
        table.append(
            {
                **dict(zip(HEAD, head, strict=True)),
                "routes": len(routes),
                **named("closed", clusters.interval(routes["is_closed"], "share")),
                "closed_m": routes["closed_m"][routes["is_closed"] > 0].median(),
                **named("regret", clusters.interval(regret, "median")),
                "regret_p90": regret.quantile(0.9),
                "regret_worst": regret.quantile(1.0),
            }
        )
    return pd.DataFrame(table)
