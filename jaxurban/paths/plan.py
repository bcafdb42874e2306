"""plan: a path between two places over metric maps, evaluated the same way for every planner."""

from functools import partial
from typing import Any

from jaxurban.errors import taken_by, typed
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import GivenMaps, as_maps
from jaxurban.paths.cost_map import map_for
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.preset import MapQuery, PathSearch
from jaxurban.paths.snapping import Point, one_place


@partial(typed, makers=(MapQuery.of, PathSearch.of))
def plan(
    maps: GivenMaps,
    start: Point | None = None,
    goal: Point | None = None,
    *,
    altitude_m: float | Levels,
    start_xy_m: Point | None = None,
    goal_xy_m: Point | None = None,
    **asked: Any,
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
      asked: which map (``weights``, ``objective``, ``cost_model``, ``time``, ``time_of_day``, ``constraints`` and
        ``preset``, as in `MapQuery.of`), and how to search (``planner``, ``heuristic``, ``budget_s``, ``seed``,
        ``snap`` and ``refine``, as in `PathSearch.of`).

    Raises:
      InputError: a place outside the maps or inside an obstacle or a constraint (names it and the nearest free cell, or
        the lowest free level), an altitude beyond the maps', an unknown planner, heuristic or objective, bounds of
        altitude that hold no level, or a volume that memory cannot hold.
    """
    maps = as_maps(maps)
    search = PathSearch.of(maps, isinstance(altitude_m, Levels), **taken_by(PathSearch.of, asked))
    ends = one_place("start", start, start_xy_m), one_place("goal", goal, goal_xy_m)
    return map_for(*MapQuery.of(maps, **taken_by(MapQuery.of, asked)), altitude_m).planned(*ends, search)
