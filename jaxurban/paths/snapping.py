"""The ends of a query: why a cell is closed, the nearest free one, never in silence, and what joins two of them."""

import math
from typing import TYPE_CHECKING

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps.levels import SAME_M, listed_m
from jaxurban.paths.places import MAX_SNAP_M, XY, End, Point, snap_limit_m
from jaxurban.planners.base import Cell, islands_of

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap


# What an end is that is free at the altitude of flight, and not down to the ground.
OVER_ROOF = "over a roof, or what else closes the way up from the ground"
BELOW_FLOOR = f"where the GPS floor is above the ground, {OVER_ROOF}"


def places_near(
    cost_map: "CostMap",
    name: str,
    place: Point | XY,
    snap: bool | float,
    on_ground: bool,
) -> list[End]:
    """Return the possible ends of a query at a place: its own cell, or free cells near to it.

    A free cell comes first, and is the only end where ``snap`` is off. Else there is an end on each island of joined
    free cells within reach, in the island's cell nearest to the place; the nearest of all comes first.

    Args:
      cost_map: whose cells they are.
      name: ``"start"`` or ``"goal"``, for messages.
      place: longitude, latitude in degrees, or `XY` in the maps' CRS; in a volume also an altitude, which is one of the
        levels. Left out, it is the lowest level that is free there.
      snap: False never moves it, True by at most `MAX_SNAP_M`, a number by at most that many metres, from the place
        to the centre of a free cell of its level.
      on_ground: whether only cells count as free where the air is free down to the ground.

    Raises:
      InputError: a place outside the maps, no such level, or a closed cell, where ``snap`` is off or the nearest free
        cell farther away than it allows (names the constraint and the nearest free cell).
    """
    # The cell of the place itself.
    xy_m, cell = cost_map.cell_of(name, place)
    level = _level_of(cost_map, name, place, cell)
    limit_m = snap_limit_m(snap)
    is_free = cost_map.free_to_ground(level) if on_ground else cost_map.levels_free[level]
    level_index = () if cost_map.levels is None else (level,)  # before row and column
    own = []
    if is_free[cell]:
        offset_m = np.subtract(cost_map.grid.xy_of_cell(*cell), xy_m)
        own = [End((*level_index, *cell), float(np.hypot(*offset_m)))]
        if limit_m is None:
            return own

    grid = cost_map.grid
    everywhere_m = grid.resolution_m * sum(is_free.shape)

    def within(reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Return ``[N, 2]`` row and column, and metres to their centres, of free cells within reach, nearest first."""
        num_cells = math.ceil(reach_m / grid.resolution_m) + 1
        row, col = first = np.maximum(np.subtract(cell, num_cells), 0)
        end_row, end_col = np.add(cell, num_cells + 1)
        cells = np.argwhere(is_free[row:end_row, col:end_col]) + first
        x_m, y_m = grid.xy_of_cell(*cells.T)
        away_m = np.hypot(x_m - xy_m[0], y_m - xy_m[1])
        near = np.argsort(away_m, kind="stable")
        near = near[away_m[near] <= reach_m]
        return cells[near], away_m[near]

    # No cell is within -1 m: the place may not move.
    cells, away_m = within(-1.0 if limit_m is None else min(limit_m, everywhere_m))
    if away_m.size == 0 and not own:
        cells, away_m = within(everywhere_m)
        why = BELOW_FLOOR if cost_map.constraints.above_gps_floor else OVER_ROOF
        if not cost_map.levels_free[level][cell]:
            why = cost_map.why_closed(cell, level)
        if away_m.size == 0:
            where = "from the ground up" if on_ground else "at this altitude"
            raise InputError(f"{name} is {why}, and no cell is free {where}: {cost_map.remedy}")
        lon, lat = grid.lonlat_of_cell(*cells[0])
        over = " over the ground" if on_ground else ""
        too_far = "" if limit_m is None else f", farther than it may be moved ({limit_m:g} m)"
        needed_m = math.ceil(away_m[0])
        option = f"--snap {needed_m} (snap={needed_m})"
        if needed_m <= MAX_SNAP_M:
            option = "--snap (snap=True)"
        raise InputError(
            f"{name} is {why}; the nearest free cell{over} is at {lon:.6f},{lat:.6f}, {away_m[0]:.0f} m away{too_far}: "
            f"take that place, fly higher, or pass {option} to move there"
        )

    # The nearest cell of each island. Cells are sorted by distance, and `unique` gives the first of each island.
    islands = cost_map.islands[level_index]
    _, first = np.unique(islands[tuple(cells.T)], return_index=True)
    ends = list(own)
    for index in np.sort(first):
        free_cell = *level_index, *cells[index].tolist()
        ends.append(End(free_cell, float(away_m[index]), True, on_ground, was_free=bool(own)))
    return ends


def _level_of(cost_map: "CostMap", name: str, place: Point | XY, cell: Cell) -> int:
    """Return the number of the level of an end, from 0 for the lowest; 0 on one altitude.

    Args:
      cost_map: whose levels they are.
      name: ``"start"`` or ``"goal"``, for messages.
      place: of the end, whose altitude is one of the levels; without one, it is the lowest level on which the cell
        is free, or 0 if it is on none.
      cell: row and column of the end.

    Returns:
      The number.

    Raises:
      InputError: an altitude that is none of the levels, or any altitude on a map without levels.
    """
    row, col = cell
    altitude_m = place[2] if len(place) > 2 else None
    if altitude_m is None:
        return int(np.argmax(cost_map.levels_free[:, row, col]))  # the first that is True
    if cost_map.levels is None:
        raise InputError(
            f"{name} has an altitude, which only a path between levels takes: leave it out"
        )
    level = int(np.argmin(np.abs(cost_map.altitudes_m - altitude_m)))
    if not abs(cost_map.altitudes_m[level] - altitude_m) < SAME_M:
        levels = f"the levels {listed_m(cost_map.altitudes_m)} m: choose one of them"
        raise InputError(f"{name} altitude {altitude_m:g} m is none of {levels}")
    return level


def joined_ends(cost_map: "CostMap", starts: list[End], goals: list[End]) -> tuple[End, End]:
    """Return the start and the goal that free cells join: fewest leave a free cell, and then they move the least.

    Where no start is joined with any goal, the first of each is returned.

    Args:
      cost_map: whose cells they are.
      starts, goals: the possible ends, as `places_near` returns them.
    """
    islands = cost_map.islands
    goal_on = {islands[goal.cell]: goal for goal in reversed(goals)}  # the first of each island
    pairs = [
        (start, goal_on[islands[start.cell]]) for start in starts if islands[start.cell] in goal_on
    ]

    def rank(ends: tuple[End, End]) -> tuple[int, float]:
        """Return what makes a pair worse: first how many ends were free where they lay, then how far they move."""
        start, goal = ends
        return start.was_free + goal.was_free, start.snap_distance_m + goal.snap_distance_m

    return min(pairs, key=rank, default=(starts[0], goals[0]))


def snap_note(start: End, goal: End) -> str:
    """Return a sentence for each end that was moved to another cell, empty where none was."""
    sentences = []
    for name, end in (("start", start), ("goal", goal)):
        if end.is_snapped:
            down, where = (" down to the ground", " over the ground") if end.on_ground else ("", "")
            why = "lay in a pocket" if end.was_free else f"was not free{down}"
            sentences.append(
                f"The {name} {why}: it was moved {end.snap_distance_m:.1f} m, to a free cell{where}."
            )
    return " ".join(sentences)


def apart_note(cost_map: "CostMap", start: End, goal: End) -> str:
    """Return sentences on what closes the way between two ends, and what would open it; ``""`` where they are joined.

    Args:
      cost_map: on which they lie.
      start, goal: the ends.
    """
    islands = cost_map.islands
    if islands[start.cell] == islands[goal.cell]:
        return ""
    cells = {"start": start.cell, "goal": goal.cell}
    sizes = {name: np.sum(islands == islands[cell]) for name, cell in cells.items()}
    inner, outer = sorted(cells, key=lambda name: sizes[name])

    # From the inner end to the nearest cell of the outer island, in plan: rows and columns come last.
    outer_cells = np.argwhere(islands == islands[cells[outer]])
    away = np.hypot(*(outer_cells - cells[inner])[:, -2:].T)
    nearest = int(np.argmin(away))
    pocket = (
        f"The {inner} lies in a pocket of {sizes[inner]:,} free cells, and the nearest cell that is joined to the "
        f"{outer} is {away[nearest] * cost_map.grid.resolution_m:.0f} m from it"
    )
    between = _closed_between(cost_map, cells[inner], outer_cells[nearest])
    for *level, row, col in between[:1].tolist():
        lon, lat = cost_map.grid.lonlat_of_cell(row, col)
        why = cost_map.why_closed((row, col), *level)
        pocket += f": the way there ends at {lon:.6f},{lat:.6f}, which is {why}"
    return f"{pocket}. {what_would_join(cost_map, start.cell, goal.cell)}"


def _closed_between(cost_map: "CostMap", cell: Cell, to_cell: np.ndarray) -> np.ndarray:
    """Return ``[N, D]`` the closed cells on the straight line from one free cell to another, in their order."""
    num_halves = 2 * int(np.abs(to_cell - cell).max())
    points = np.linspace(cell, to_cell, num_halves + 1)
    cells = np.ceil(points - 0.5).astype(int)
    # Rounded the other way, so that half a diagonal step is a cell beside it.
    cells[:, -1] = np.floor(points[:, -1] + 0.5)
    return cells[~cost_map.is_free[tuple(cells.T)]]


def free_to_ground(cost_map: "CostMap", level: int) -> np.ndarray:
    """Return ``[Y, X]`` where a mission may take off to a level of a cost map and land from it."""
    altitude_m = float(cost_map.altitudes_m[level])
    return cost_map.levels_free[level] & cost_map.constraints.is_free_to_ground(
        cost_map.maps, altitude_m, **cost_map.when
    )


def islands_at(cost_map: "CostMap", levels_m: tuple[float, ...]) -> np.ndarray:
    """Return `islands_of` the cells that are free at other altitudes, under a cost map's constraints.

    Args:
      cost_map: the map.
      levels_m: the ascending levels of a volume, or one altitude.
    """
    altitudes_m = levels_m[0] if cost_map.levels is None else levels_m
    is_free = cost_map.constraints.is_free(cost_map.maps, altitudes_m, **cost_map.when)
    return islands_of(is_free, cost_map.cuts_corners)


def what_would_join(cost_map: "CostMap", start: Cell, goal: Cell) -> str:
    """Return sentences on what would join a start and a goal that nothing joins: a greater altitude, or other maps.

    Args:
      cost_map: on which they are not joined.
      start, goal: row and column; in a volume level, row and column.
    """
    # The lowest altitude of the maps, above those of the cost map, at which free cells join them.
    levels_m = cost_map.altitudes_m.tolist()
    is_plane = cost_map.levels is None
    higher_m = [z_m for z_m in sorted(cost_map.maps.altitudes_m) if z_m > levels_m[-1]]
    answer = ""
    if higher_m:
        answer = "Start and goal are not joined at a greater altitude of these maps. "
    for z_m in higher_m:
        levels_m = [z_m] if is_plane else [*levels_m, z_m]
        islands = cost_map.islands_at(tuple(levels_m))
        if islands[start] != 0 and islands[start] == islands[goal]:
            bound = "at" if is_plane else "with max_altitude_m"
            answer = f"Start and goal are joined {bound} {z_m:g} m. "
            break

    others = "Finer maps"
    if str(cost_map.constraints):  # a zone, a bound or a clearance, which another sentence lists
        others = "Looser constraints or finer maps"
    if "roof_guessed" in cost_map.maps.ds:
        others += ", or known heights of roofs that are guessed,"
    return f"{answer}{others} may join them too."


def why_closed(cost_map: "CostMap", cell: Cell, level: int = 0) -> str:
    """Return what closes a cell, an obstacle or each constraint by name, and which level over it is free.

    The phrase goes after "it is".

    Args:
      cost_map: on which the cell is closed.
      cell: row and column.
      level: number of its level; 0 on one altitude.
    """
    # What closes it: constraints where the maps have no obstacle, else an obstacle in its middle or beside that.
    maps, constraints = cost_map.maps, cost_map.constraints
    levels_m = cost_map.altitudes_m.tolist()
    z_m = levels_m[level]
    when = cost_map.when
    reasons = []
    if maps.is_free(z_m)[cell]:
        reasons = constraints.reasons(maps, z_m, cell, **when)
    if reasons:
        where = f"closed by {' and '.join(reasons)}"
    elif maps.is_free(z_m, "centre")[cell]:
        where = "in a cell that an obstacle touches"
    else:
        where = "inside an obstacle (or where there are no data)"
    if cost_map.levels is None:
        return f"{where} at {z_m:g} m"

    # Where it is free: at another level, or above all levels of the volume.
    row, col = cell
    free_levels = np.flatnonzero(cost_map.levels_free[:, row, col])
    if free_levels.size:
        lowest_m = levels_m[free_levels[0]]
        return f"{where} at {z_m:g} m; the lowest free level there is {lowest_m:g} m"
    phrase = f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m"
    for higher_m in sorted(maps.altitudes_m):
        if higher_m > levels_m[-1] and constraints.is_free(maps, higher_m, **when)[cell]:
            return (
                f"{phrase}; the lowest free altitude there is {higher_m:g} m (raise max_altitude_m)"
            )
    return phrase
