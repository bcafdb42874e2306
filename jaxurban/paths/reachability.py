"""Why a cell is closed, whether two places are joined by free cells, and what would join them where they are not."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from jaxurban.planners.base import Cell

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap


def islands_of(is_free: np.ndarray, cuts_corners: bool) -> np.ndarray:
    """Return the number of the island of each free cell, ``[Y, X]`` or ``[K, Y, X]``, 0 where it is closed.

    On one level cells join as on one altitude; from level to level straight up and down, which all climbs come to.
    """
    touching = generate_binary_structure(2, 2 if cuts_corners else 1)
    if is_free.ndim == 3:
        flat, touching = touching, generate_binary_structure(3, 1)
        touching[1] = flat
    return np.asarray(label(is_free, touching)[0])


def islands_at(on: "CostMap", levels_m: tuple[float, ...]) -> np.ndarray:
    """Return `islands_of` the free cells of other levels under a cost map's constraints."""
    is_free = on.constraints.free_levels(on.maps, levels_m, time=on.time, time_of_day=on.time_of_day)
    return islands_of(is_free[0] if on.levels is None else is_free, on.cuts_corners)


def what_would_join(on: "CostMap", start: Cell, goal: Cell) -> str:
    """Return sentences on what would join two nodes that nothing joins: a greater altitude, or what may."""
    levels_m = on.altitudes_m.tolist()
    higher_m = [z_m for z_m in sorted(on.maps.altitudes_m) if z_m > levels_m[-1]]
    joined = "Start and goal are not joined at a greater altitude of these maps. " if higher_m else ""
    for k, z_m in enumerate(higher_m):
        islands = on.islands_at((z_m,) if on.levels is None else (*levels_m, *higher_m[: k + 1]))
        if islands[start] == islands[goal] != 0:
            joined = f"Start and goal are joined {'at' if on.levels is None else 'with max_altitude_m'} {z_m:g} m. "
            break
    finer = "A smaller clearance or finer maps" if on.constraints.keeps_clear else "Finer maps"
    return f"{joined}{finer} may join them too."


def why_closed(on: "CostMap", cell: Cell, level: int = 0) -> str:
    """Return what closes a cell, an obstacle or each constraint by name, and which level over it is free."""
    z_m, maps, when = float(on.altitudes_m[level]), on.maps, {"time": on.time, "time_of_day": on.time_of_day}
    reasons = on.constraints.reasons(maps, z_m, cell, **when) if maps.is_free(z_m)[cell] else []
    if reasons:
        where = f"closed by {' and '.join(reasons)}"
    elif maps.is_free(z_m, "centre")[cell]:
        where = "in a cell that an obstacle touches"
    else:
        where = "inside an obstacle (or where there are no data)"
    if on.levels is None:
        return f"{where} at {z_m:g} m"
    levels_m, free = on.altitudes_m, np.flatnonzero(on.levels_free[:, cell[0], cell[1]])
    if free.size:
        return f"{where} at {z_m:g} m; the lowest free level there is {levels_m[free[0]]:g} m"
    higher_m = [z_m for z_m in sorted(maps.altitudes_m) if z_m > levels_m[-1]]
    lowest_m = next((z_m for z_m in higher_m if on.constraints.is_free(maps, z_m, **when)[cell]), None)
    above = "" if lowest_m is None else f"; the lowest free altitude there is {lowest_m:g} m (raise max_altitude_m)"
    return f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m{above}"
