"""Routes planned on one set of maps and judged by another: what a difference of maps changes for routes."""

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
from jaxurban.studies.decided import edge_band, is_at_edge

ENDS = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
NUMBERS = ["best_there", "cost", "length_m", "cost_there", "regret", "closed_m", "is_closed"]
COLUMNS = ["pair", "altitude_m", *ENDS, "status", *NUMBERS, "apart_m", "at_edge"]


def compared_routes(
    a: MetricMaps,
    b: MetricMaps,
    num: int,
    seed: int,
    times: tuple[str | None, str | None],
    report: Report,
) -> pd.DataFrame:
    """Return a row for each route that is planned on map A and judged on map B.

    At each altitude ``num`` pairs of cells that are free in both maps are drawn, and on each map the cheapest route of
    the grid between them is planned. Both maps have the weights, cost model and constraints of A's scenario.

    Args:
      a, b: the maps, cut to what both hold (`jaxurban.maps.shared.shared_part`).
      num: pairs at each altitude.
      seed: of the pairs.
      times: of A and of B; None: the first one.
      report: called with stage, done and total.

    Returns:
      Rows with the ends in metres and ``status``. ``cost`` is the route's cost on A, ``cost_there`` its cost on B (NaN
      where it is closed there), ``best_there`` the cost of B's own route, and ``regret`` is cost_there / best_there -
      1. ``closed_m`` is its length in cells that are closed on B, and ``is_closed`` is 1 where it crosses such cells or
      comes too near one. ``apart_m`` is how far it and B's own route are apart at most, and ``at_edge`` is 1 where it
      runs along the border of the data. A route that was not found has NaN instead.

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
        ends = np.hstack([free[start], free[goal]]).tolist()

        # The cheapest path of each pair on either map.
        routes = zip(ends, _planned(on_a, ends), _planned(on_b, ends), strict=True)
        for pair, ((row, col, goal_row, goal_col), path, best) in enumerate(routes):
            places_m = *a.grid.xy_of_cell(row, col), *a.grid.xy_of_cell(goal_row, goal_col)
            facts: dict[str, Any] = dict(zip(ENDS, places_m, strict=True))
            facts |= {"pair": pair, "altitude_m": altitude_m, "status": path.status.value}
            if path.status.has_path:
                facts |= _judged(on_b, path, best)
                facts["at_edge"] = float(is_at_edge(path.points_m, a.grid, band))
            rows.append(facts)
    return pd.DataFrame(rows, columns=COLUMNS)


def _planned(cost_map: CostMap, ends: list[list[int]]) -> list[Path]:
    """Return the cheapest path of the grid between each pair of cells (row, column, row, column), in their order.

    Raises:
      Exception: whatever the search of a pair raised.
    """
    problems = [cost_map.problem.between((a, b), (c, d)) for a, b, c, d in ends]
    paths = []
    for _, outcome in sorted(solve_many(problems), key=lambda each: each[0]):
        if isinstance(outcome, Exception):
            raise outcome
        paths.append(outcome)
    return paths


def _judged(on_b: CostMap, path: Path, best: Path) -> dict[str, float]:
    """Return the columns of a row that say what a path of A costs on B (see `compared_routes`).

    Args:
      on_b: the cost map of B.
      path: the cheapest path of A.
      best: the cheapest path of B between the same ends, if there is one.
    """
    features = on_b.problem.features(path.points_m)
    facts = {
        "cost": path.cost,
        "length_m": features.length_m.sum(),
        "closed_m": features.length_m[~on_b.is_free[features.crossed]].sum(),
        "is_closed": float(not features.is_valid),
    }
    if best.status.has_path:
        facts["best_there"] = best.cost
        lines = (shapely.LineString(each.points_m) for each in (path, best))
        facts["apart_m"] = float(shapely.hausdorff_distance(*lines))

    # A path that costs the same as the best one has the regret 0; where the best one costs nothing, it is inf.
    if features.is_valid:
        cost = facts["cost_there"] = features.cost(on_b.problem.weights)
        facts["regret"] = 0.0
        if not cost <= best.cost * SAME_COST:
            facts["regret"] = cost / best.cost - 1 if best.cost > 0 else np.inf
    return facts
