"""Routes planned on each of two sets of maps and judged by the other: what a difference of maps changes for routes."""

from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.plan import cost_map
from jaxurban.planners.base import Path
from jaxurban.planners.registry import solve_many
from jaxurban.progress import Report
from jaxurban.studies.bootstrap import Clusters, named
from jaxurban.studies.decided import edge_band, is_at_edge

WAYS = (("A", "B"), ("B", "A"))  # planned on, judged on
HEAD = ["altitude_m", "planned_on", "judged_on"]
ENDS = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
NUMBERS = ["best_there", "cost", "length_m", "cost_there", "regret", "closed_m", "is_closed"]


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
      a, b: the maps, cut to what both hold (`jaxurban.maps.shared.shared_part`).
      num: pairs at each altitude.
      seed: of the pairs.
      times: of A and of B; None: the first one.
      report: called with stage, done and total.

    Returns:
      Rows with the ends in metres and ``status``. ``cost`` is the route's cost on the map on which it was planned,
      ``cost_there`` its cost on the other map (NaN where it is closed there), ``best_there`` the cost of the other
      map's own route, and ``regret`` is cost_there / best_there - 1. ``closed_m`` is its length in cells that are
      closed on the other map, and ``is_closed`` is 1 where it crosses such cells or comes too near one. ``apart_m`` is
      how far it and the other map's own route are apart at most, and ``at_edge`` whether it runs along the border of
      the data. A route that was not found has NaN instead.

    Raises:
      InputError: fewer than two cells are free in both at an altitude, or the scenario asks what B does not hold.
    """
    band = edge_band(a)
    rows = []
    for number, altitude_m in enumerate(report.over("routes", a.altitudes_m)):
        on_a = cost_map(a, altitude_m, time=times[0])
        on_b = cost_map(
            b,
            altitude_m,
            time=times[1],
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
        ends = np.stack([free[start], free[goal]], axis=1).tolist()

        # The cheapest path of each pair on either map, judged by the other map.
        cost_maps = {"A": on_a, "B": on_b}
        paths = {
            name: _planned([each.problem.between(tuple(one), tuple(other)) for one, other in ends])
            for name, each in cost_maps.items()
        }
        for pair, cells in enumerate(ends):
            for planned_on, judged_on in WAYS:
                row: dict[str, Any] = {
                    "pair": pair,
                    "altitude_m": altitude_m,
                    "planned_on": planned_on,
                    "judged_on": judged_on,
                }
                for end, cell in zip(("start", "goal"), cells, strict=True):
                    row[f"{end}_x_m"], row[f"{end}_y_m"] = a.grid.xy_of_cell(*cell)
                path = paths[planned_on][pair]
                row["status"] = path.status.value
                if path.status.has_path:
                    row |= _judged(cost_maps[judged_on], path, paths[judged_on][pair])
                    row["at_edge"] = float(is_at_edge(path.points_m, a.grid, band))
                rows.append(row)
    columns = ["pair", *HEAD, *ENDS, "status", *NUMBERS, "apart_m", "at_edge"]
    return pd.DataFrame(rows, columns=columns)


def _planned(problems: list[Any]) -> list[Path]:
    """Return the cheapest path of the grid for each problem, in their order; what a search raised is raised here."""
    paths = []
    for _, outcome in sorted(solve_many(problems), key=lambda each: each[0]):
        if isinstance(outcome, Exception):
            raise outcome
        paths.append(outcome)
    return paths


def _judged(cost_map: CostMap, path: Path, best: Path) -> dict[str, float]:
    """Return the columns of a row that say what a path costs on another map than its own (see `compared_routes`).

    Args:
      cost_map: of the other map.
      path: the cheapest path of its own map.
      best: the cheapest path of the other map between the same ends, if there is one.
    """
    features = cost_map.problem.features(path.points_m)
    facts = {
        "cost": path.cost,
        "length_m": features.length_m.sum(),
        "closed_m": features.length_m[~cost_map.is_free[features.crossed]].sum(),
        "is_closed": float(not features.is_valid),
    }
    if features.is_valid:
        facts["cost_there"] = features.cost(cost_map.problem.weights)
    if best.status.has_path:
        facts["best_there"] = best.cost
        lines = (shapely.LineString(each.points_m) for each in (path, best))
        facts["apart_m"] = float(shapely.hausdorff_distance(*lines))

    # A path that costs the same as the best one has the regret 0; where the best one costs nothing, it is inf.
    if "cost_there" in facts:
        facts["regret"] = 0.0
        if not facts["cost_there"] <= best.cost * SAME_COST:
            facts["regret"] = facts["cost_there"] / best.cost - 1 if best.cost > 0 else np.inf
    return facts


def route_regrets(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how many routes the other map closes, and the regret of the others.

    A row for each altitude and for each map that routes were planned on. Routes that were not found do not count. The
    share ``closed`` and the median ``regret`` have 95 % intervals by the bootstrap over pairs
    (`jaxurban.studies.bootstrap`), which are NaN for fewer than eight pairs.

    Args:
      rows: of `compared_routes`.
    """
    table = []
    for head, routes in rows[rows.is_closed.notna()].groupby(HEAD, sort=False):
        clusters = Clusters(routes.pair)
        regret = routes.regret
        table.append(
            {
                **dict(zip(HEAD, head, strict=True)),
                "routes": len(routes),
                **named("closed", clusters.interval(routes.is_closed, "share")),
                "closed_m": routes.closed_m[routes.is_closed > 0].median(),
                **named("regret", clusters.interval(regret, "median")),
                "regret_p90": regret.quantile(0.9),
                "regret_worst": regret.quantile(1.0),
            }
        )
    return pd.DataFrame(table)
