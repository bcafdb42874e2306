"""The ends of a query: why a cell is closed, the nearest free one, never in silence, and what joins two of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps.levels import SAME_M, listed_m
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.places import MAX_SNAP_M, XY, End, Point, cell_at, snap_limit_m
from jaxurban.planners.base import Cell, islands_of
from jaxurban.settings import OnGround
from jaxurban.world.grid import Grid

# What an end is that is free at the altitude of flight, and not down to the ground.
OVER_ROOF = "over a roof, or what else closes the way up from the ground"
BELOW_FLOOR = f"where the GPS floor is above the ground, {OVER_ROOF}"


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Where paths may fly at one altitude or between several, under whatever weights: cells, and the islands they join.

    ``Y`` rows, ``X`` columns, ``K`` levels, on one altitude 1.

    Attributes:
      maps, altitudes_m, constraints, is_free: as of `jaxurban.paths.cost_map.CostMap`.
      when: time and time of day, as arguments.
      cuts_corners: whether a free cell joins those that it touches with a corner.

    Examples:
      >>> free_space = ju.cost_map(maps, 60.0).free_space
      >>> [end.cell for end in free_space.ends(start, goal)]
      [(2, 2), (27, 27)]
    """

    maps: MetricMaps
    altitudes_m: np.ndarray
    constraints: Constraints
    is_free: np.ndarray
    when: dict[str, str | None]
    cuts_corners: bool

    @property
    def is_plane(self) -> bool:
        """Whether there is one altitude, and not levels of a volume."""
        return self.is_free.ndim == 2

    @cached_property
    def grid(self) -> Grid:
        """The grid of the maps."""
        return self.maps.grid

    @property
    def levels_free(self) -> np.ndarray:
        """``[K, Y, X]`` where a path may fly, on one altitude too."""
        return self.is_free.reshape(-1, *self.is_free.shape[-2:])

    @cached_property
    def islands(self) -> np.ndarray:
        """``[Y, X]`` or ``[K, Y, X]`` the number of the island of joined free cells, 0 where a cell is closed."""
        return islands_of(self.is_free, self.cuts_corners)

    @cached_property
    def islands_at(self) -> Callable[[tuple[float, ...]], np.ndarray]:
        """The `islands` under the same constraints at other altitudes or levels, ascending, each made once."""

        @cache
        def islands_at(levels_m: tuple[float, ...]) -> np.ndarray:
            altitudes_m = levels_m[0] if self.is_plane else levels_m
            is_free = self.constraints.is_free(self.maps, altitudes_m, **self.when)
            return islands_of(is_free, self.cuts_corners)

        return islands_at

    @cached_property
    def to_ground(self) -> Callable[[int], np.ndarray]:
        """``[Y, X]`` where missions may take off to a level and land from it, by its number, each made once."""

        @cache
        def to_ground(level: int) -> np.ndarray:
            altitude_m = float(self.altitudes_m[level])
            return self.levels_free[level] & self.constraints.is_free_to_ground(
                self.maps, altitude_m, **self.when
            )

        return to_ground

    @cached_property
    def terrain_m(self) -> np.ndarray | None:
        """``[Y, X]`` elevation of the ground; None where the maps hold no terrain."""
        return self.maps.m("terrain") if "terrain" in self.maps.ds else None

    @property
    def remedy(self) -> str:
        """What a user can do so that more cells are free, as the end of a message."""
        remedy = "fly higher" if self.is_plane else "fly at another level, raise max_altitude_m"
        constraints = str(self.constraints)
        return f"{remedy}, or loosen the constraints ({constraints})" if constraints else remedy

    def check_any(self) -> None:
        """Refuse a space without a free cell, on which no path can be planned.

        Raises:
          InputError: no cell is free; says what opens cells.
        """
        if not self.is_free.any():
            raise InputError(f"no cell is free at {listed_m(self.altitudes_m)} m: {self.remedy}")

    def ends(
        self,
        start: Point | XY,
        goal: Point | XY,
        *,
        snap: bool | float = False,
        on_ground: OnGround = False,
    ) -> tuple[End, End]:
        """Return the cells of a query; in a volume the nodes. Arguments and errors are as of `places_near`.

        With ``on_ground`` only cells are free above which the air is, from the ground up (`to_ground`).

        Snapping takes the free cells nearest to both that a way through free cells joins. An end leaves a free cell
        only where nothing within reach of the other end is joined to it. Where no two within reach are joined, the
        nearest free ones are taken.

        Returns:
          `End` of the start and of the goal.
        """
        # The possible ends of each place, the nearest first.
        starts = self.places_near("start", start, snap, on_ground is True)
        goals = self.places_near("goal", goal, snap, bool(on_ground))
        return self._joined(starts, goals) if snap else (starts[0], goals[0])

    def places_near(
        self,
        name: str,
        place: Point | XY,
        snap: bool | float,
        on_ground: bool,
    ) -> list[End]:
        """Return the possible ends of a query at a place: its own cell, or free cells near to it.

        A free cell comes first, and is the only end where ``snap`` is off. Else there is an end on each island of
        joined free cells within reach, in the island's cell nearest to the place; the nearest of all comes first.

        Args:
          name: ``"start"`` or ``"goal"``, for messages.
          place: longitude, latitude in degrees, or `XY` in the maps' CRS; in a volume also an altitude, which is one of
            the levels. Left out, it is the lowest level that is free there.
          snap: False never moves it, True by at most `MAX_SNAP_M`, a number by at most that many metres, from the place
            to the centre of a free cell of its level.
          on_ground: whether only cells count as free where the air is free down to the ground.

        Raises:
          InputError: a place outside the maps, no such level, or a closed cell, where ``snap`` is off or the nearest
            free cell farther away than it allows (names the constraint and the nearest free cell).
        """
        # The cell of the place itself.
        grid = self.grid
        xy_m, cell = cell_at(grid, name, place)
        level = self._level_of(name, place, cell)
        limit_m = snap_limit_m(snap)
        is_free = self.to_ground(level) if on_ground else self.levels_free[level]
        level_index = () if self.is_plane else (level,)  # before row and column
        own = []
        if is_free[cell]:
            offset_m = np.subtract(grid.xy_of_cell(*cell), xy_m)
            own = [End((*level_index, *cell), float(np.hypot(*offset_m)))]
            if limit_m is None:
                return own

        everywhere_m = grid.resolution_m * sum(is_free.shape)

        def within(reach_m: float) -> tuple[np.ndarray, np.ndarray]:
            """Return ``[N, 2]`` row and column of free cells within reach, nearest first, and metres to centres."""
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
            why = BELOW_FLOOR if self.constraints.above_gps_floor else OVER_ROOF
            if not self.levels_free[level][cell]:
                why = self.why_closed(cell, level)
            if away_m.size == 0:
                where = "from the ground up" if on_ground else "at this altitude"
                raise InputError(f"{name} is {why}, and no cell is free {where}: {self.remedy}")
            lon, lat = grid.lonlat_of_cell(*cells[0])
            over = " over the ground" if on_ground else ""
            too_far = "" if limit_m is None else f", farther than it may be moved ({limit_m:g} m)"
            needed_m = math.ceil(away_m[0])
            option = f"--snap {needed_m}, snap={needed_m}"
            if needed_m <= MAX_SNAP_M:
                option = "--snap, snap=True"
            raise InputError(
                f"{name} is {why}; the nearest free cell{over} is at {lon:.6f},{lat:.6f}, {away_m[0]:.0f} m away"
                f"{too_far}: take that place, fly higher, or let it be moved there ({option})"
            )

        # The nearest cell of each island. Cells are sorted by distance, and `unique` gives the first of each island.
        islands = self.islands[level_index]
        _, first = np.unique(islands[tuple(cells.T)], return_index=True)
        ends = list(own)
        for index in np.sort(first):
            free_cell = *level_index, *cells[index].tolist()
            ends.append(End(free_cell, float(away_m[index]), True, on_ground, was_free=bool(own)))
        return ends

    def _level_of(self, name: str, place: Point | XY, cell: Cell) -> int:
        """Return the number of the level of an end, from 0 for the lowest; 0 on one altitude.

        Args:
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
            return int(np.argmax(self.levels_free[:, row, col]))  # the first that is True
        if self.is_plane:
            raise InputError(
                f"{name} has an altitude, which only a path between levels takes: leave it out"
            )
        level = int(np.argmin(np.abs(self.altitudes_m - altitude_m)))
        if not abs(self.altitudes_m[level] - altitude_m) < SAME_M:
            levels = f"the levels {listed_m(self.altitudes_m)} m: choose one of them"
            raise InputError(f"{name} altitude {altitude_m:g} m is none of {levels}")
        return level

    def _joined(self, starts: list[End], goals: list[End]) -> tuple[End, End]:
        """Return the start and the goal that free cells join: fewest leave a free cell, and then they move the least.

        Where no start is joined with any goal, the first of each is returned.

        Args:
          starts, goals: the possible ends, as `places_near` returns them.
        """
        islands = self.islands
        goal_on = {islands[goal.cell]: goal for goal in reversed(goals)}  # the first of each island
        pairs = [
            (start, goal_on[islands[start.cell]])
            for start in starts
            if islands[start.cell] in goal_on
        ]

        def rank(ends: tuple[End, End]) -> tuple[int, float]:
            """Return what makes a pair worse: first how many ends were free where they lay, then how far they move."""
            start, goal = ends
            return start.was_free + goal.was_free, start.snap_distance_m + goal.snap_distance_m

        return min(pairs, key=rank, default=(starts[0], goals[0]))

    def apart_note(self, start: End, goal: End) -> str:
        """Return sentences on what closes the way between two ends, and what would open it; ``""`` if joined."""
        grid, islands = self.grid, self.islands
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
            f"{outer} is {away[nearest] * grid.resolution_m:.0f} m from it"
        )
        between = self._closed_between(cells[inner], outer_cells[nearest])
        for *level, row, col in between[:1].tolist():
            lon, lat = grid.lonlat_of_cell(row, col)
            why = self.why_closed((row, col), *level)
            pocket += f": the way there ends at {lon:.6f},{lat:.6f}, which is {why}"
        return f"{pocket}. {self._what_would_join(start.cell, goal.cell)}"

    def _closed_between(self, cell: Cell, to_cell: np.ndarray) -> np.ndarray:
        """Return ``[N, D]`` the closed cells on the straight line from one free cell to another, in their order."""
        num_halves = 2 * int(np.abs(to_cell - cell).max())
        points = np.linspace(cell, to_cell, num_halves + 1)
        cells = np.ceil(points - 0.5).astype(int)
        # Rounded the other way, so that half a diagonal step is a cell beside it.
        cells[:, -1] = np.floor(points[:, -1] + 0.5)
        return cells[~self.is_free[tuple(cells.T)]]

    def _what_would_join(self, start: Cell, goal: Cell) -> str:
        """Return sentences on what would join a start and a goal that nothing joins: a greater altitude, or other maps.

        Args:
          start, goal: row and column; in a volume level, row and column.
        """
        # The lowest altitude of the maps, above these, at which free cells join them.
        levels_m = self.altitudes_m.tolist()
        is_plane = self.is_plane
        higher_m = [z_m for z_m in sorted(self.maps.altitudes_m) if z_m > levels_m[-1]]
        answer = ""
        if higher_m:
            answer = "Start and goal are not joined at a greater altitude of these maps. "
        for z_m in higher_m:
            levels_m = [z_m] if is_plane else [*levels_m, z_m]
            islands = self.islands_at(tuple(levels_m))
            if islands[start] != 0 and islands[start] == islands[goal]:
                bound = "at" if is_plane else "with max_altitude_m"
                answer = f"Start and goal are joined {bound} {z_m:g} m. "
                break

        return f"{answer}Looser constraints, finer maps or known heights may join them too."

    def why_closed(self, cell: Cell, level: int = 0) -> str:
        """Return what closes a cell, an obstacle or each constraint by name, and which level over it is free.

        The phrase goes after "it is".

        Args:
          cell: row and column.
          level: number of its level; 0 on one altitude.
        """
        # What closes it: constraints where the maps have no obstacle, else an obstacle in its middle or beside that.
        maps, constraints = self.maps, self.constraints
        levels_m = self.altitudes_m.tolist()
        z_m = levels_m[level]
        when = self.when
        reasons = []
        if maps.is_free(z_m)[cell]:
            reasons = constraints.reasons(maps, z_m, cell, **when)
        if reasons:
            where = f"closed by {' and '.join(reasons)}"
        elif maps.is_free(z_m, "centre")[cell]:
            where = "in a cell that an obstacle touches"
        else:
            where = "inside an obstacle (or where there are no data)"
        if self.is_plane:
            return f"{where} at {z_m:g} m"

        # Where it is free: at another level, or above all levels of the volume.
        row, col = cell
        free_levels = np.flatnonzero(self.levels_free[:, row, col])
        if free_levels.size:
            lowest_m = levels_m[free_levels[0]]
            return f"{where} at {z_m:g} m; the lowest free level there is {lowest_m:g} m"
        phrase = f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m"
        for higher_m in sorted(maps.altitudes_m):
            if higher_m > levels_m[-1] and constraints.is_free(maps, higher_m, **when)[cell]:
                return f"{phrase}; the lowest free altitude there is {higher_m:g} m (raise max_altitude_m)"
        return phrase


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
