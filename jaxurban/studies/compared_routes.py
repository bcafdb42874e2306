"""Routes planned on one set of maps and judged by another: what a difference of maps changes for routes."""

from functools import partial

import numpy as np
import pandas as pd
import shapely

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import FIX
from jaxurban.paths.batch import plan_many
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import cost_map
from jaxurban.paths.profile import cut_on, profile_of, without_fix
from jaxurban.paths.queries import IN_METRES
from jaxurban.progress import Report
from jaxurban.studies.decided import edge_band, is_at_edge
from jaxurban.studies.montecarlo.sampling import sample_joined

SAME = 1e-4  # share of the cost: a route that costs no more above the cheapest one is as good
JUDGED = ["length_m", "cost", "best_there", "cost_there", "is_closed", "apart_m", "at_edge"]
NO_FIX = ["no_fix_m", "no_fix_there_m"]


def compared_routes(
    a: MetricMaps,
    b: MetricMaps,
    num: int,
    seed: int,
    times: tuple[str | None, str | None],
    report: Report,
) -> pd.DataFrame:
    """Return a row for each route that is planned on map A and judged on map B.

    The pairs of places are those of studies (`sample_joined`): a path on A joins them at every altitude.

    Args:
      a, b: the maps, cut to what both hold (`jaxurban.maps.shared.shared_part`); both with the scenario's settings of A
        (`MetricMaps.recorded`), under which all routes are planned.
      num: pairs, the same at each altitude.
      seed: of the pairs.
      times: of A and of B; None: the first one.
      report: called with stage, done and total.

    Returns:
      Rows with the ends in metres, and ``status`` and ``status_there``, how the searches on A and on B ended.
      ``cost`` is the route's cost on A, ``cost_there`` its cost on B (NaN where it is closed there), ``best_there`` the
      cost of B's own route, and ``regret`` is cost_there / best_there - 1. ``is_closed`` is 1 where it crosses cells
      that are closed on B or comes too near one, and ``is_changed`` where it is closed or its regret is above `SAME`.
      ``no_fix_m`` and ``no_fix_there_m`` are its lengths without a position fix on A and on B, as of `explain`.
      ``apart_m`` is how far it and B's own route are apart at most, and ``at_edge`` is 1 where it runs along the border
      of the data. What is not known is NaN.

    Raises:
      InputError: too few pairs that a path joins on A, or the scenario asks what B does not hold.
      KeyboardInterrupt: Ctrl-C.
    """
    drawn = sample_joined(a, num, seed=seed).rename(columns={"instance": "pair"})
    table = drawn[["pair", "altitude_m", *IN_METRES]]
    queries = table.drop(columns="pair")
    # By the exact search of the grid, whatever the scenario plans with, so that no other route costs less.
    plan_all = partial(plan_many, planner="astar", budget_s=np.inf, progress=report)
    on_a = plan_all(a, queries, time=times[0])
    on_b = plan_all(b, queries, time=times[1])
    if on_a.was_interrupted or on_b.was_interrupted:
        raise KeyboardInterrupt

    # What each route costs on B.
    maps_b = {z_m: cost_map(b, z_m, time=times[1]) for z_m in b.altitudes_m}
    band = edge_band(a)
    rows: list[dict[str, float]] = []
    for altitude_m, path, best in zip(table.altitude_m, on_a, on_b, strict=True):
        rows.append({})
        if path is None or not path.status.has_path:
            continue
        problem = maps_b[altitude_m].problem
        features = problem.features(path.search.points_m)
        rows[-1] = {
            "length_m": path.length_m,
            "cost": path.search.cost,
            "cost_there": features.cost(problem.weights) if features.is_valid else np.nan,
            "is_closed": float(not features.is_valid),
            "at_edge": float(is_at_edge(path.search.points_m, a.grid, band)),
            "no_fix_m": _no_fix_m(path, a, times[0]),
            "no_fix_there_m": _no_fix_m(path, b, times[1]),
        }
        if best is not None and best.status.has_path:
            lines = (shapely.LineString(each.search.points_m) for each in (path, best))
            rows[-1] |= {
                "best_there": best.search.cost,
                "apart_m": float(shapely.hausdorff_distance(*lines)),
            }
    judged = pd.DataFrame(rows, columns=[*JUDGED, *NO_FIX])
    regret = (judged.cost_there / judged.best_there - 1).clip(lower=0)
    is_changed = (judged.is_closed > 0) | (regret > SAME)
    return table.assign(
        status=on_a.to_dataframe().status,
        status_there=on_b.to_dataframe().status,
        **judged,
        regret=regret,
        is_changed=is_changed.where(judged.is_closed.notna()).astype(float),
    )


def _no_fix_m(path: PlannedPath, maps: MetricMaps, time: str | None) -> float:
    """Return the length of a route without a position fix by maps at a time; NaN where they do not know it."""
    _, parts = cut_on(path, maps)
    profile = profile_of(parts, maps, {FIX: FIX}, {**path.settings, "time": time})
    if FIX not in profile:
        return np.nan
    return float(sum(to_m - from_m for from_m, to_m in without_fix(profile)))
