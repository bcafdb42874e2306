"""Routes planned on one set of maps and judged by another: what a difference of maps changes for routes."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.batch import plan_many
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import cost_map
from jaxurban.paths.queries import IN_METRES, LONLAT, read_queries
from jaxurban.progress import Report
from jaxurban.studies.baseline import MEASURES, SHORTEST
from jaxurban.studies.montecarlo.sampling import (
    check_instances,
    instances_of_queries,
    sample_joined,
)
from jaxurban.studies.weights.paid import paid_on

SAME = 1e-4  # share of the cost: a route that costs no more above the cheapest one is as good
# What is judged: A's routes on A and on B, B's own on B, and A's of distance alone on A.
THERE, BEST = "there_", "best_"
JUDGED = [
    *("length_m", "cost", "best_there", "cost_there", "is_closed", "apart_m", "at_edge"),
    *("exposure", "people_below", "no_fix_m"),
    *(f"{of}{name}" for of in (THERE, BEST, SHORTEST) for name in MEASURES),
    f"{SHORTEST}cost",
]


def compared_routes(
    a: MetricMaps,
    b: MetricMaps,
    routes: int | pd.DataFrame,
    seed: int,
    times: tuple[str | None, str | None],
    report: Report,
) -> pd.DataFrame:
    """Return a row for each route that is planned on map A and judged on map B.

    The pairs of places that are drawn are those of studies (`sample_joined`): a path on A joins them at every altitude.

    Args:
      a, b: the maps, cut to what both hold (`jaxurban.maps.shared.shared_part`); both with the scenario's settings of A
        (`MetricMaps.recorded`), under which all routes are planned.
      routes: how many pairs are drawn, the same at each altitude; or a table of ends and altitudes.
      seed: of the pairs.
      times: of A and of B; None: the first one.
      report: called with stage, done and total.

    Returns:
      Rows with the ends in metres, and ``status`` and ``status_there``, how the searches on A and on B ended.
      ``cost`` is the route's cost on A, ``cost_there`` its cost on B (NaN where it is closed there), ``best_there`` the
      cost of B's own route, and ``regret`` is cost_there / best_there - 1. ``is_closed`` is 1 where it crosses cells
      that are closed on B or comes too near one, and ``is_changed`` where it is closed or its regret is above `SAME`.
      ``apart_m`` is how far it and B's own route are apart at most, and ``at_edge`` is 1 where it runs along the border
      of the data. ``length_m``, ``no_fix_m`` and ``people_below`` are what a user pays (`paid_on`), ``exposure`` is the
      cost without that of the length, all on A; with `THERE` of A's route on B, with `BEST` of B's own, and with
      `SHORTEST` of the shortest route on A, that of distance alone. What is not known is NaN.

    Raises:
      InputError: a wrong table, too few pairs that a path joins on A, or the scenario asks what B does not hold.
      KeyboardInterrupt: Ctrl-C.
    """
    table = _pairs(a, routes, seed)[["pair", "altitude_m", *IN_METRES]]
    queries = table.drop(columns="pair")
    # By the exact search of the grid, whatever the scenario plans with, so that no other route costs less.
    plan_all = partial(plan_many, planner="astar", budget_s=np.inf, progress=report)
    on_a = plan_all(a, queries, time=times[0])
    on_b = plan_all(b, queries, time=times[1])
    shortest = plan_all(a, queries, time=times[0], objective="distance")
    plans = on_a, on_b, shortest
    if any(each.was_interrupted for each in plans):
        raise KeyboardInterrupt

    # What each route costs on both maps.
    judges_a = {z_m: _judge(cost_map(a, z_m, time=times[0])) for z_m in a.altitudes_m}
    judges_b = {z_m: _judge(cost_map(b, z_m, time=times[1])) for z_m in b.altitudes_m}
    rows: list[dict[str, float]] = []
    queries_planned: Any = zip(table.altitude_m, *plans, strict=True)
    for altitude_m, path, best, short in queries_planned:
        judge_a, judge_b = judges_a[altitude_m], judges_b[altitude_m]
        row = judge_a(path)
        rows.append(row)
        if not row:
            continue
        there = judge_b(path)
        row["is_closed"] = float(not there)
        others = {THERE: there, BEST: judge_b(best), SHORTEST: judge_a(short)}
        for of, facts in others.items():
            row |= {f"{of}{name}": value for name, value in facts.items()}
        if others[BEST]:
            lines = (shapely.LineString(each.search.points_m) for each in (path, best))
            row["apart_m"] = float(shapely.hausdorff_distance(*lines))
    names = {f"{THERE}cost": "cost_there", f"{BEST}cost": "best_there"}
    judged = pd.DataFrame(rows).rename(columns=names).reindex(columns=JUDGED)
    regret = (judged.cost_there / judged.best_there - 1).clip(lower=0)
    is_changed = (judged.is_closed > 0) | (regret > SAME)
    return table.assign(
        status=on_a.to_dataframe().status,
        status_there=on_b.to_dataframe().status,
        **judged,
        regret=regret,
        is_changed=is_changed.where(judged.is_closed.notna()).astype(float),
    )


def _pairs(maps: MetricMaps, routes: int | pd.DataFrame, seed: int) -> pd.DataFrame:
    """Return instances with the number of their ``pair`` of places, drawn or those of a table."""
    if isinstance(routes, int):
        return sample_joined(maps, routes, seed=seed).rename(columns={"instance": "pair"})
    places = IN_METRES if IN_METRES[0] in routes else LONLAT
    queries = read_queries(routes.filter([*places, "altitude_m"]), metrics=maps.metrics)
    instances = instances_of_queries(maps, queries)
    check_instances(instances, maps)
    return instances.assign(pair=instances.groupby([*IN_METRES], sort=False).ngroup())


def _judge(on_map: CostMap) -> Callable[[PlannedPath | None], dict[str, float]]:
    """Return a function of a route that returns its cost on a map and what a user pays; empty where it is closed."""
    paid = paid_on(on_map)
    problem = on_map.problem

    def judged(path: PlannedPath | None) -> dict[str, float]:
        """Return what a route costs; nothing without one."""
        if path is None or not path.status.has_path:
            return {}
        points_m = path.search.points_m
        features = problem.features(points_m)
        if not features.is_valid:
            return {}
        cost = features.cost(problem.weights)
        exposure = float(cost - problem.weights[0] * features.phi[0])
        return paid(points_m) | {"cost": cost, "exposure": exposure}

    return judged
