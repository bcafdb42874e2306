"""plan and cost_map: from maps and what is left to their scenario to a cost map, and to a path on it."""

import math
from dataclasses import replace
from functools import cache, partial
from typing import Any, Unpack

import numpy as np

from jaxurban.checks import finite, typed
from jaxurban.errors import InputError, warn
from jaxurban.maps.free_memory import free_bytes
from jaxurban.maps.levels import Levels, around, values_at
from jaxurban.maps.memory import format_bytes
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.weights import WeightsLike, weights_on
from jaxurban.paths.choices import PathChoice, parted
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import NO_WEIGHT, CostMap
from jaxurban.paths.finish import plan_on
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, Point, one_place
from jaxurban.paths.search import PathSearch
from jaxurban.planners.cost import CostModel
from jaxurban.settings import (
    CostKind,
    Objective,
    Preset,
    Vehicle,
    iso_utc,
)
from jaxurban.world.grid import Grid

NODE_BYTES = 64  # of a volume and a search that visits all of it (docs/algorithms/search.md)


def rules_on(
    maps: MetricMaps,
    cost_model: CostModel | CostKind | None = None,
    constraints: Constraints | None = None,
    preset: Preset = "",
) -> tuple[MetricMaps, CostModel, Constraints]:
    """Return maps under a rule of obstacles, a cost model and constraints, in none of which anything is left out.

    What the arguments leave out is as the maps' scenario says, or as the preset does (see `cost_map`), which the maps
    then record.

    Args:
      maps: that keep the rule of obstacles with which they were opened, if one was named then.
      cost_model: whole, by its kind alone, or None.
      constraints: whole, with clearances or vehicle None, or None.
      preset: ``"paper"``, or ``""`` for that of the scenario.

    Raises:
      InputError: an unknown preset or cost model.
    """
    planning = replace(maps.planning, preset=preset or maps.planning.preset)
    if preset:
        recorded = maps.recorded
        own = recorded.get("planning", {}) | {"preset": preset}
        maps = maps.with_recorded(recorded | {"planning": own})
        if maps.rule is None:
            maps = maps.with_obstacles(planning.rules.obstacles)
    model = CostModel.of(cost_model or planning.rules.cost_model)
    vehicle = Vehicle(**maps.recorded.get("vehicle", {}))
    return maps, model, (constraints or Constraints()).under(planning, vehicle)


@typed
def cost_map(
    maps: MapsLike,
    altitude_m: float | Levels,
    *,
    weights: WeightsLike = None,
    objective: Objective = "weighted",
    cost_model: CostModel | CostKind | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    constraints: Constraints | None = None,
    preset: Preset = "",
) -> CostMap:
    """Return the maps at one altitude, or between levels, under weights, on which any number of paths can be planned.

    Weights, cost model, rule of obstacles, clearances and vehicle that are left out here are as the maps'
    scenario gives them, if there is one.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      altitude_m: within the range of the maps' altitudes; between two of them metrics are taken linearly from both
        (`values_at`), obstacles from the roofs' own heights. Or `Levels`, for paths that climb and descend.
      weights: of distance and metrics by name; those not named are as the scenario has them, or as in `Weights()`.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path, whose weighted cost is reported.
      cost_model: how steps are costed, or its kind alone: ``"line"``, the default, or ``"cell"`` (the paper).
      time: UTC time of the GPS map, the first if left out. Where it is named, zones that are not in force then, nor
        within an hour, close nothing (`Constraints.at`).
      time_of_day: of the population map; the first if left out.
      constraints: no-fly zones, bounds on maps and clearances, from `Constraints.read`; no path enters a cell that they
        close. Left out, paths keep 3 m over roofs.
      preset: ``"paper"`` for the paper's ``cell``, obstacles at centres and no clearance, instead of the defaults of
        what is left out here and in the scenario.

    Returns:
      `CostMap`, whose costs, weights and free cells all its paths share.

    Raises:
      InputError: an altitude beyond the maps', an unknown time, time of day, preset, cost model or objective, a wrong
        weight, a bound on a map that is not there, bounds of altitude that hold no level, no free cell in a volume, or
        more of them than memory holds.

    Examples:
      >>> cost_map = ju.cost_map(maps, 20.0, weights={"gps": 3.0})
      >>> cost_map.facts["weights"]
      'distance 0.1, gps 3, lidar 1, population 1, risk 1'
      >>> cost_map.facts["free"]
      '84.8% of the cells'
      >>> cost_map.plan(start, goal).status.value
      'optimal'
    """
    maps, model, limits = rules_on(as_maps(maps), cost_model, constraints, preset)
    of_layers = weights_on(maps, weights)
    climbs = altitude_m if isinstance(altitude_m, Levels) else Levels()
    is_weighed = any([*of_layers.to_dict().values(), climbs.climb_cost, climbs.descent_cost])
    if objective == "weighted" and not is_weighed:
        warn(f"{NO_WEIGHT} Give one a weight above 0.")
    rules: dict[str, Any] = {
        "weights": of_layers,
        "objective": objective,
        "cost_model": model,
        "constraints": limits.at(time),
        "time": time,
        "time_of_day": time_of_day,
    }
    if isinstance(altitude_m, Levels):
        volume = map_at(maps, altitude_m.of(maps.altitudes_m), altitude_m, **rules)
        volume.free_space.check_any()
        return volume
    altitudes_m = np.array([finite("altitude_m", altitude_m, "metres, or Levels")])
    around(altitudes_m[0], maps.altitudes_m)
    return map_at(maps, altitudes_m, None, **rules)


def map_at(
    maps: MetricMaps,
    altitudes_m: np.ndarray,
    levels: Levels | None,
    *,
    constraints: Constraints,
    time: str | None,
    time_of_day: str | None,
    **rules: Any,
) -> CostMap:
    """Return the cost map at altitudes that the maps reach.

    Its arrays have an axis of levels in a volume, ``[M, K, Y, X]`` costs of M metrics and ``[K, Y, X]`` free cells, and
    none on one altitude.

    Args:
      maps: the metric maps.
      altitudes_m: ``[K]`` the levels of a volume, ascending; ``[1]`` on one altitude.
      levels: how a path may climb in a volume; None on one altitude.
      constraints: the rules that close cells.
      time, time_of_day: at which the maps are read; None for the first time that they hold.
      rules: further attributes of `CostMap`: weights, objective and cost model.

    Raises:
      InputError: a volume that memory cannot hold, or an unknown time or time of day.
    """
    if levels is not None:
        _check_fits(len(altitudes_m), maps.grid)
    is_free = constraints.is_free(maps, altitudes_m.tolist(), time=time, time_of_day=time_of_day)

    # The cost of each metric on each level, [M, K, Y, X]. `cache` reads each map once, however many levels take values
    # from it.
    costs = np.empty((len(maps.metrics), *is_free.shape), np.float32)
    is_under_sky = cache(maps.is_under_sky)
    for (name, metric), metric_costs in zip(maps.metrics.items(), costs, strict=True):
        read = cache(partial(maps.m, name, time=time, time_of_day=time_of_day))
        has_altitudes = "altitude" in maps.ds[maps.variable(name)].dims
        for level, z_m in enumerate(altitudes_m.tolist()):
            m = values_at(z_m, maps.altitudes_m, read, is_under_sky) if has_altitudes else read()
            # Searches take no NaN: where a closed cell has no value, m counts as 0.
            is_closed_gap = np.isnan(m) & ~is_free[level]
            metric_costs[level] = metric.cost(np.where(is_closed_gap, np.float32(0), m))

    # On one altitude arrays have no axis of levels.
    if levels is None:
        costs = costs[:, 0]
        is_free = is_free[0]

    return CostMap(
        maps=maps,
        altitudes_m=altitudes_m,
        levels=levels,
        time=maps.default_time if time is None else iso_utc(time),
        time_of_day=time_of_day or next(iter(maps.times_of_day), None),
        constraints=constraints,
        **rules,
        names=tuple(maps.metrics),
        costs=costs,
        is_free=is_free,
    )


def _check_fits(num_levels: int, grid: Grid) -> None:
    """Raise InputError where a volume, and a search that visits all of it, take more memory than is free."""
    needed_bytes = num_levels * math.prod(grid.shape) * NODE_BYTES
    available_bytes = free_bytes()
    if needed_bytes > available_bytes:
        raise InputError(
            f"a volume of {num_levels} levels of {grid.num_rows} x {grid.num_cols} cells takes up to "
            f"{format_bytes(needed_bytes)} of memory and {format_bytes(available_bytes)} are free: choose a longer "
            "level_step_m, closer altitude bounds, or coarser maps"
        )


@typed
def plan(
    maps: MapsLike,
    start: Point | XY,
    goal: Point | XY,
    *,
    altitude_m: float | Levels,
    **choice: Unpack[PathChoice],
) -> PlannedPath:
    """Return a path from ``start`` to ``goal``, at one altitude or between levels.

    For many queries on one map and weights, make a `cost_map` once and call its ``plan``: what planners derive from
    the map is then shared. What is left out here is as the maps' scenario gives it (``[weights]``, ``[planning]`` and
    ``[vehicle]``), as for the command ``plan``, if there is one (`MetricMaps.recorded`).

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      start, goal: longitude, latitude in degrees, or an `XY` in the maps' CRS; between levels also an altitude, one of
        the levels (left out, the lowest that is free there).
      altitude_m: within the range of the maps' altitudes; between two of them metrics are taken linearly from both,
        which the path's message says, and obstacles from the roofs' own heights. Or `Levels`, for a path that may climb
        and descend on its way. It costs the metrics of the cells it enters, its length in space, and each metre of
        climb and descent; 8 neighbours are 26 there. ``objective="distance"`` leaves climb and descent out too.
      weights: numbers by name, such as ``{"gps": 2.0}``: how much the distance (per metre) and each metric count.
      objective, cost_model, time, time_of_day, constraints, preset: which map, as in `cost_map`.
      planner: ``"ptp"``, ``"astar"`` (the default), ``"bitstar-dist"``, ``"bitstar-plus"``, ``"theta-star"``, or the
        paper's ``"astar-dist"`` and ``"astar-plus"``; between levels ``"astar-volume"``.
      heuristic: of the planner; left out, its own.
      backend: ``"numba"``, ``"jax"`` for A* and BIT* in JAX, or ``"auto"``, which is Numba here;
        ``path.search.backend`` says what ran.
      budget_s: seconds that the search may take.
      max_samples: of BIT*: end after so many, so that the same call gives the same path on any machine; without
        ``budget_s`` there is then no limit of seconds.
      seed: for sampling planners; without ``max_samples`` their budget is a time, so that one seed gives another route
        in each run.
      snap: whether a start or goal that is not free moves to the nearest free cell: True by at most 50 m, a number by
        at most that many metres (`PathSearch`).
      on_ground: plan a mission: start and goal are free only where the air is, down to the ground, so that it may take
        off and land there; ``"goal"`` asks it of the goal alone. What takes off or lands through a roof is not saved as
        a ``.plan``.
      refine: then move the waypoints downhill, off the grid.
      exposure: budgets by layer, such as ``{"population": 120.0}``: most of (1 / l0) x integral of c ds along the path
        (`PlannedPath.exposure_by_layer`). The cheapest path of the grid within them is searched for; ``search`` carries
        its lower bound and gap.

    Returns:
      `PlannedPath`. Where the search ended without a path, its status and message say why, and its cost is inf.

    Raises:
      InputError: a place outside the maps or inside an obstacle or a constraint (names it and the nearest free cell, or
        the lowest free level), an altitude beyond the maps', an unknown planner, heuristic or objective, bounds of
        altitude that hold no level, or a volume that memory cannot hold.

    Examples:
      >>> path = ju.plan(maps, start, goal, altitude_m=60.0, weights={"population": 5.0})
      >>> path.status.value, len(path.xy_m), round(path.length_m)
      ('optimal', 38, 864)
      >>> levels = ju.Levels(min_altitude_m=20.0, max_altitude_m=60.0, level_step_m=20.0)
      >>> climbing = ju.plan(maps, (*start, 20.0), (*goal, 60.0), altitude_m=levels)
      >>> climbing.z_m[[0, -1]].tolist()
      [20.0, 60.0]
    """
    maps = as_maps(maps)
    map_choice, search_choice = parted(choice)
    search = PathSearch.of(maps.planning, isinstance(altitude_m, Levels), **search_choice)
    start_place = one_place("start", start)
    goal_place = one_place("goal", goal)
    return plan_on(cost_map(maps, altitude_m, **map_choice), start_place, goal_place, search)
