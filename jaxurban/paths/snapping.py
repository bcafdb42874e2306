"""The ends of a query: why a cell is closed, the nearest free one, never in silence, and what joins two of them."""

import math
import numbers
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from jaxurban.errors import InputError
from jaxurban.planners.base import Cell

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap

# Longitude, latitude in degrees, and between levels an altitude if liked.
Point = tuple[float | None, ...]
IN_METRES = "easting, northing in metres such as (583960.0, 4507351.0)"
IN_DEGREES = "longitude, latitude in degrees such as (-74.0, 40.7)"
MAX_SNAP_M = 50.0  # about half a city block, unless another distance is given


class XY(NamedTuple):
    """A place in the maps' CRS: easting, northing in metres; between levels its altitude if liked.

    Examples:
      >>> place = ju.XY(586650.0, 4514550.0)
      >>> ju.cost_map(maps, 60.0).plan(place, goal).status.value
      'optimal'
    """

    x_m: float
    y_m: float
    altitude_m: float | None = None


def one_place(name: str, lonlat: Point | XY | None, xy_m: Point | None) -> Point | XY:
    """Return a place that is given in degrees or in metres (`XY` always is).

    Raises:
      InputError: it is given in neither, or in both, or is not two numbers, and maybe an altitude.
    """
    if (lonlat is None) == (xy_m is None):
        fault = "is missing" if xy_m is None else "must be given in one way, not both"
        raise InputError(f"{name} {fault}: give it as longitude, latitude or as {name}_xy_m")
    place: Any = lonlat if xy_m is None else xy_m
    is_xy = xy_m is not None or isinstance(lonlat, XY)
    try:
        numbers: Any = [None if value is None else float(value) for value in place]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (2, 3) or None in numbers[:2]:
        raise InputError(f"{name} must be {IN_METRES if is_xy else IN_DEGREES}, got {place!r}")
    return XY(*numbers) if is_xy else tuple(numbers)


@dataclass(frozen=True)
class End:
    """Where a query starts or ends.

    Attributes:
      cell: row and column; in a volume level, row and column.
      snap_distance_m: from the place that was given to the centre of the cell.
      is_snapped: the cell of the given place was closed, so this is another one.
    """

    cell: Cell
    snap_distance_m: float
    is_snapped: bool = False


def places_near(
    cost_map: "CostMap",
    name: str,
    xy_m: tuple[float, float],
    level: int,
    cell: Cell,
    snap: bool | float,
) -> list[End]:
    """Return the cell of a place; if it is closed and ``snap`` allows it, of each island the nearest free cell.

    The nearest one of all comes first.

    Args:
      cost_map: whose cells.
      name: ``"start"`` or ``"goal"``, for messages.
      xy_m: easting, northing of the place.
      level: its number; 0 on one altitude.
      cell: row and column of the cell that it lies in.
      snap: False never moves it, True by at most `MAX_SNAP_M`, a number by at most so many metres, from the place
        to the centre of the free cell of its level.

    Raises:
      InputError: the cell is closed, and ``snap`` is off or the nearest free cell farther away than it allows.
    """
    cap_m = snap_limit_m(snap)
    is_free = cost_map.levels_free[level]
    of_level = () if cost_map.levels is None else (level,)
    if is_free[cell]:
        offset_m = np.subtract(cost_map.grid.xy_of_cell(*cell), xy_m)
        return [End((*of_level, *cell), float(np.hypot(*offset_m)))]
    rows, cols = np.nonzero(is_free)
    if rows.size == 0:
        raise InputError(
            f"{name} is {cost_map.why_closed(cell, level)}, and no cell is free at this altitude: {cost_map.remedy}"
        )
    x_m, y_m = cost_map.grid.xy_of_cell(rows, cols)
    away_m = np.hypot(x_m - xy_m[0], y_m - xy_m[1])
    near = np.flatnonzero(away_m <= (-1.0 if cap_m is None else cap_m))
    near = near[np.argsort(away_m[near], kind="stable")]
    if near.size == 0:
        nearest = int(np.argmin(away_m))
        lon, lat = cost_map.grid.lonlat_of_cell(rows[nearest], cols[nearest])
        needed_m = math.ceil(away_m[nearest])
        too_far = "" if cap_m is None else f", farther than it may be moved ({cap_m:g} m)"
        option = f"--snap {needed_m} (snap={needed_m})"
        if needed_m <= MAX_SNAP_M:
            option = "--snap (snap=True)"
        raise InputError(
            f"{name} is {cost_map.why_closed(cell, level)}; the nearest free cell is at {lon:.6f},{lat:.6f}, "
            f"{away_m[nearest]:.0f} m away{too_far}: take that place, fly higher, or pass {option} to move there"
        )
    _, first = np.unique(cost_map.islands[of_level][rows[near], cols[near]], return_index=True)
    nearest_of = near[np.sort(first)]
    return [
        End((*of_level, int(rows[k]), int(cols[k])), float(away_m[k]), True) for k in nearest_of
    ]


def joined_ends(cost_map: "CostMap", starts: list[End], goals: list[End]) -> tuple[End, End]:
    """Return the start and the goal, of those that `places_near` gives, that free cells join and that move the least.

    Where no two are joined, the nearest ones.
    """
    islands = cost_map.islands

    def apart_then_moved_m(ends: tuple[End, End]) -> tuple[bool, float]:
        start, goal = ends
        are_apart = bool(islands[start.cell] != islands[goal.cell])
        return are_apart, start.snap_distance_m + goal.snap_distance_m

    return min(product(starts, goals), key=apart_then_moved_m)


def snap_note(start: End, goal: End) -> str:
    """Return a sentence for each end that was moved out of a closed cell, empty where none was."""
    return " ".join(
        f"The {name} was not free: it was moved {end.snap_distance_m:.1f} m, to a free cell."
        for name, end in (("start", start), ("goal", goal))
        if end.is_snapped
    )


def pocket_note(cost_map: "CostMap", start: End, goal: End) -> str:
    """Return a sentence on which of two ends that nothing joins is closed in, empty where they are joined."""
    islands = cost_map.islands
    if islands[start.cell] == islands[goal.cell]:
        return ""
    ends = {"start": start.cell, "goal": goal.cell}
    sizes = {name: int(np.sum(islands == islands[cell])) for name, cell in ends.items()}
    inner, outer = sorted(ends, key=lambda name: sizes[name])
    cells = np.argwhere(islands == islands[ends[outer]])[:, -2:]
    away_m = float(np.hypot(*(cells - ends[inner][-2:]).T).min()) * cost_map.grid.resolution_m
    return (
        f"The {inner} lies in a pocket of {sizes[inner]:,} free cells, and the nearest cell that is joined to the "
        f"{outer} is {away_m:.0f} m from it."
    )


def snap_limit_m(snap: Any) -> float | None:
    """Return how far a place may be moved; None where it may not.

    Raises:
      InputError: neither a bool nor metres above 0.
    """
    if isinstance(snap, bool | np.bool_):
        return MAX_SNAP_M if snap else None
    if not isinstance(snap, numbers.Real) or not float(snap) > 0:
        raise InputError(
            f"snap must be True (at most {MAX_SNAP_M:g} m), False, or metres above 0, got {snap!r}"
        )
    return float(snap)


def islands_of(is_free: np.ndarray, cuts_corners: bool) -> np.ndarray:
    """Return the number of the island of each free cell, ``[Y, X]`` or ``[K, Y, X]``, 0 where it is closed.

    On one level cells join as on one altitude; from level to level straight up and down, which all climbs come to.
    """
    touching = flat = generate_binary_structure(2, 2 if cuts_corners else 1)
    if is_free.ndim == 3:
        touching = generate_binary_structure(3, 1)
        touching[1] = flat
    islands, _ = label(is_free, touching)
    return islands


def islands_at(cost_map: "CostMap", levels_m: tuple[float, ...]) -> np.ndarray:
    """Return `islands_of` the free cells of other levels under a cost map's constraints."""
    levels = levels_m[0] if cost_map.levels is None else levels_m
    is_free = cost_map.constraints.is_free(
        cost_map.maps, levels, time=cost_map.time, time_of_day=cost_map.time_of_day
    )
    return islands_of(is_free, cost_map.cuts_corners)


def what_would_join(cost_map: "CostMap", start: Cell, goal: Cell) -> str:
    """Return sentences on what would join two nodes that nothing joins: a greater altitude, or what may."""
    levels_m = cost_map.altitudes_m.tolist()
    is_plane = cost_map.levels is None
    higher_m = [z_m for z_m in sorted(cost_map.maps.altitudes_m) if z_m > levels_m[-1]]
    joined = (
        "Start and goal are not joined at a greater altitude of these maps. " if higher_m else ""
    )
    for z_m in higher_m:
        levels_m = [z_m] if is_plane else [*levels_m, z_m]
        islands = cost_map.islands_at(tuple(levels_m))
        if islands[start] == islands[goal] != 0:
            bound = "at" if is_plane else "with max_altitude_m"
            joined = f"Start and goal are joined {bound} {z_m:g} m. "
            break
    finer = "Finer maps"
    if cost_map.constraints.keeps_clear:
        finer = "A smaller clearance or finer maps"
    return f"{joined}{finer} may join them too."


def why_closed(cost_map: "CostMap", cell: Cell, level: int = 0) -> str:
    """Return what closes a cell, an obstacle or each constraint by name, and which level over it is free."""
    maps, constraints = cost_map.maps, cost_map.constraints
    levels_m = cost_map.altitudes_m.tolist()
    z_m = levels_m[level]
    when = {"time": cost_map.time, "time_of_day": cost_map.time_of_day}
    reasons = constraints.reasons(maps, z_m, cell, **when) if maps.is_free(z_m)[cell] else []
    if reasons:
        where = f"closed by {' and '.join(reasons)}"
    elif maps.is_free(z_m, "centre")[cell]:
        where = "in a cell that an obstacle touches"
    else:
        where = "inside an obstacle (or where there are no data)"
    if cost_map.levels is None:
        return f"{where} at {z_m:g} m"
    free = np.flatnonzero(cost_map.levels_free[:, cell[0], cell[1]])
    if free.size:
        return f"{where} at {z_m:g} m; the lowest free level there is {levels_m[free[0]]:g} m"
    sentence = f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m"
    for higher_m in sorted(maps.altitudes_m):
        if higher_m > levels_m[-1] and constraints.is_free(maps, higher_m, **when)[cell]:
            return f"{sentence}; the lowest free altitude there is {higher_m:g} m (raise max_altitude_m)"
    return sentence
