"""plan: a path between two places over metric maps, evaluated the same way for every planner."""

from typing import Any

from jaxurban.errors import typed
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import GivenMaps, as_maps
from jaxurban.metrics.weights import GivenWeights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import cost_map
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.preset import PathSearch, objective_on
from jaxurban.paths.snapping import Point, one_place
from jaxurban.planners.base import CostKind
from jaxurban.planners.cost_model import CostModel


@typed
def plan(
    maps: GivenMaps,
    start: Point | None = None,
    goal: Point | None = None,
    *,
    altitude_m: float | Levels,
    start_xy_m: Point | None = None,
    goal_xy_m: Point | None = None,
    weights: GivenWeights = None,
    planner: str | None = None,
    heuristic: str | None = None,
    objective: str | None = None,
    cost_model: CostModel | CostKind | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    budget_s: float | None = None,
    seed: int | None = None,
    snap: bool | float = False,
    refine: bool = False,
    constraints: Constraints | None = None,
    preset: str = "",
) -> PlannedPath:
    """Return a path from ``start`` to ``goal``, at one altitude or between levels.

    For many queries on one map and weights, make a `cost_map` once and call its ``plan``: what planners derive from
    the map is then shared.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps. What is left out here is as
        their scenario's ``[weights]``, ``[planning]`` and ``[vehicle]`` give it, as for the command ``plan``, if there
        is one (`MetricMaps.recorded`).
      start, goal: longitude, latitude in degrees; between levels also an altitude, one of the levels (left out, the
        lowest that is free there).
      altitude_m: within the range of the maps' altitudes; between two of them metrics are taken linearly from both,
        which the path's message says, and obstacles from the roofs' own heights. Or `Levels`, for a path that may climb
        and descend on its way. What it costs is described in docs/volume.md: the metrics of the cells it enters, its
        length in space, and each metre of climb and descent; 8 neighbours are 26 there. ``objective="distance"`` leaves
        climb and descent out too.
      start_xy_m, goal_xy_m: easting, northing in the maps' CRS (and altitude), instead of ``start`` and ``goal``.
      weights: default `Weights()`; numbers by name leave the others as the scenario has them.
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...; left out, ``"astar-plus"``, and between levels
        ``"astar-volume"``.
      heuristic: left out, the planner's own.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: how steps are costed and which are allowed, or its kind alone: ``"line"``, the default, or
        ``"cell"`` (the paper).
      time: UTC time of the GPS map; the first if left out. Where it is named, zones that are not in force then, nor
        within an hour, close nothing (`Constraints.at`).
      time_of_day: of the population map; the first if left out.
      budget_s: seconds that the search may take; default 10.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a constraint to the nearest free cell (of its level)
        that is joined to the other end, instead of failing: True by at most 50 m, a number by at most so many metres.
        The path's message says how far.
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
      constraints: no-fly zones, bounds on maps and clearances, from `Constraints.read`; no path enters a cell that
        they close. A zone between two levels closes the lower one. Left out, paths keep 3 m over roofs.
      preset: ``"paper"`` for the paper's ``cell``, obstacles at centres and no clearance, instead of the defaults of
        what is left out here and in the maps' scenario.

    Raises:
      InputError: a place outside the maps or inside an obstacle or a constraint (names it and the nearest free cell, or
        the lowest free level), an altitude beyond the maps', an unknown planner, heuristic or objective, bounds of
        altitude that hold no level, or a volume that memory cannot hold.
    """
    maps = as_maps(maps)
    given: dict[str, Any] = {"planner": planner, "heuristic": heuristic, "budget_s": budget_s, "seed": seed}
    is_volume = isinstance(altitude_m, Levels)  # a wrong name is refused before the maps are read
    search = PathSearch.of(maps, is_for_volumes=is_volume, snap=snap, refine=refine, **given)
    ends = one_place("start", start, start_xy_m), one_place("goal", goal, goal_xy_m)
    shared = cost_map(
        maps,
        altitude_m,
        weights=weights,
        objective=objective_on(maps, objective),
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
        constraints=constraints,
        preset=preset,
    )
    return shared.found(*ends, search)
