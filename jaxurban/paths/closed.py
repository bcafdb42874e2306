"""Why nobody may fly in a cell of a cost map, in words."""

from typing import TYPE_CHECKING

import numpy as np

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.planners.base import Cell

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap


def why_closed(cost_map: "CostMap", cell: Cell, level: int = 0) -> str:
    """Return what closes a cell, an obstacle or each constraint by name, and which level over it is free."""
    z_m, maps, constraints = float(cost_map.altitudes_m[level]), cost_map.maps, cost_map.constraints
    when = {"time": cost_map.time, "time_of_day": cost_map.time_of_day}
    where, is_volume = why_blocked(maps, z_m, cell), cost_map.levels is not None
    if maps.is_free(z_m)[cell]:
        reasons = constraints.reasons(maps, z_m, cell, **when)
        where = f"closed by {' and '.join(reasons)}" if reasons else where
    if not is_volume:
        return f"{where} at {z_m:g} m"
    levels_m, free = cost_map.altitudes_m, np.flatnonzero(cost_map.levels_free[:, cell[0], cell[1]])
    if free.size:
        return f"{where} at {z_m:g} m; the lowest free level there is {levels_m[free[0]]:g} m"
    higher = [higher_m for higher_m in sorted(maps.altitudes_m) if higher_m > levels_m[-1]]
    higher = [higher_m for higher_m in higher if constraints.is_free(maps, higher_m, **when)[cell]]
    above = f"; the lowest free altitude there is {higher[0]:g} m (raise max_altitude_m)" if higher else ""
    return f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m{above}"


def why_blocked(maps: MetricMaps, altitude_m: float, cell: Cell) -> str:
    """Return how the rule of obstacles blocks a cell: by its centre or, under ``"touched"``, only by its edge."""
    if maps.is_free(altitude_m, "centre")[cell]:
        return "in a cell that an obstacle touches"
    return "inside an obstacle (or where there are no data)"
