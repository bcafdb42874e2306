"""plan: a path between two places over metric maps, evaluated the same way for every planner."""

from jaxurban.cost import Weights
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import CostKind, CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.weighted import Point, weigh


def plan(
    maps: MetricMaps,
    start: Point | None = None,
    goal: Point | None = None,
    *,
    altitude_m: float,
    start_xy_m: Point | None = None,
    goal_xy_m: Point | None = None,
    weights: Weights | None = None,
    planner: str = "astar-plus",
    heuristic: str | None = None,
    objective: str = "weighted",
    cost_model: CostModel | CostKind = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    budget_s: float = 180.0,
    seed: int = 0,
    snap: bool | float = False,
    refine: bool = False,
    limits: Limits | None = None,
) -> PlannedPath:
    """Return a path from ``start`` to ``goal`` at one altitude.

    For many queries on one map and weights, `weigh` once and call its ``plan``: what planners derive from
    the map is then shared.

    Args:
      maps: from `build_maps` or `open_maps`.
      start, goal: longitude, latitude in degrees.
      altitude_m: one of the maps' altitudes.
      start_xy_m, goal_xy_m: easting, northing in the maps' CRS, instead of ``start`` and ``goal``.
      weights: default `Weights()`.
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...
      heuristic: left out, the planner's own.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: how steps are charged and which are allowed, or its kind alone: ``"cell"`` (the paper) or
        ``"line"``.
      time: epoch of the GPS map; the first if left out.
      time_of_day: of the population map; the first if left out.
      budget_s: seconds that the search may take.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a limit to the nearest free cell instead of failing:
        True by at most 50 m, a number by at most so many metres. The path's message says how far.
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
      limits: no-fly zones and bounds on maps, from `Limits.read`; no path enters a cell that they close.

    Raises:
      InputError: a place outside the maps or inside an obstacle or a limit (names it and the nearest free cell), or an
        unknown altitude, planner, heuristic or objective.
    """
    find_planner(planner, heuristic)  # a wrong name is told before the maps are read
    weighted = weigh(
        maps,
        altitude_m,
        weights=weights,
        objective=objective,
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
        limits=limits,
    )
    return weighted.plan(
        start,
        goal,
        start_xy_m=start_xy_m,
        goal_xy_m=goal_xy_m,
        planner=planner,
        heuristic=heuristic,
        budget_s=budget_s,
        seed=seed,
        snap=snap,
        refine=refine,
    )
