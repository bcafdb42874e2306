"""What a route meets, cell by cell: the values of the maps at its height, roofs beneath, clearance from obstacles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import binary_erosion

from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import Crossings, crossed_cells
from jaxurban.maps.levels import values_at
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import UNDERSIDE
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.cost import path_states

FEWEST_SATELLITES = 4  # below, no position fix
TOUCHED, VISIBLE, GUESSED = "roof_touched", "num_visible", "roof_guessed"
CLEARANCE, OUTSIDE, OVER_ROOF = "nearest_wall_m", "walls_outside_m", "least_over_roofs_m"
TO_GUESSED = "guessed_roof_away_m"
SAME_HEIGHT_M = 1e-6  # rounding of heights along a step


def cut_evenly(states_m: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step belongs to: at most ``most``, nearly equal.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs.
    """
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(states_m, axis=0), axis=1)))
    wanted_m = along_m[-1] * np.arange(1, most) / most
    after = np.clip(np.searchsorted(along_m, wanted_m), 1, len(along_m) - 1)
    nearest = np.where(wanted_m - along_m[after - 1] <= along_m[after] - wanted_m, after - 1, after)
    cuts = np.setdiff1d(nearest, [0, len(along_m) - 1])
    return np.searchsorted(cuts, np.arange(len(along_m) - 1), side="right")


def clearance_m(ends_m: np.ndarray, is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M]`` the exact distance from straight lines to the nearest obstacle cell; inf without one.

    From the line itself to the side of the cell's square, without any cap: half a cell where the route passes
    the middle of the cell next to an obstacle. Nothing stands outside the map.

    Args:
      ends_m: ``[M, 2, 2]`` start and end (x, y) of each line, metres from the map's southwest corner.
      is_obstacle: ``[Y, X]`` bool.
      resolution_m: side of a cell.
    """
    # Where all four neighbours within the map are obstacles too, another one is nearer.
    row, col = np.nonzero(is_obstacle & ~binary_erosion(is_obstacle, border_value=1))
    if len(row) == 0:
        return np.full(len(ends_m), np.inf if not is_obstacle.any() else 0.0)
    squares = shapely.STRtree(shapely.box(*(np.stack([col, row, col + 1, row + 1]) * resolution_m)))
    (line, _), distance_m = squares.query_nearest(shapely.linestrings(ends_m), return_distance=True, all_matches=False)
    nearest_m = np.empty(len(ends_m))
    nearest_m[line] = distance_m
    return nearest_m


def level_below_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the highest of some levels that is not above each height; the lowest one beneath all of them."""
    ascending_m = np.sort(np.asarray(levels_m, float))
    return ascending_m[np.maximum(np.searchsorted(ascending_m, z_m + SAME_HEIGHT_M, side="right") - 1, 0)]


def nearest_level_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the nearest of some levels, the lower one where two are as near."""
    ascending_m = np.sort(np.asarray(levels_m, float))
    return ascending_m[np.argmin(np.abs(z_m[:, None] - ascending_m), axis=1)]


@dataclass(frozen=True, eq=False)
class RouteProfile:
    """A route over the maps that it was planned on.

    Attributes:
      planned: the route; on one altitude, or between levels.
      maps: that it was planned on.
      cut: the route cut at the cells' borders; a step ends where the ``cell`` cost model counts a cell, and those
        without length are left out.

    Raises:
      InputError: there is no path, or the maps are others.
    """

    planned: PlannedPath
    maps: MetricMaps
    cut: Crossings

    @classmethod
    def of(cls, planned: PlannedPath, maps: MetricMaps) -> "RouteProfile":
        """Return the route cut on its maps."""
        grid, settings = maps.grid, planned.settings
        if not planned.status.has_path:
            raise InputError(f"there is no path to explain: {planned.status.sentence}")
        if (planned.crs, settings["resolution_m"]) != (grid.crs, grid.resolution_m):
            raise InputError(
                f"the path was planned at {settings['resolution_m']:g} m in {planned.crs}, and these maps are "
                f"{grid.resolution_m:g} m in {grid.crs}: give the maps that it was planned on"
            )
        points_m = planned.xy_m - [grid.x_min_m, grid.y_min_m]
        if (points_m < 0).any() or (points_m[:, ::-1] > np.array(grid.shape) * grid.resolution_m).any():
            raise InputError("the path leaves the region of these maps: give the maps that it was planned on")
        states_m = path_states(np.column_stack([points_m, planned.z_m]), grid.resolution_m)
        states_m = states_m[np.append(True, np.any(np.diff(states_m, axis=0) != 0, axis=1))]
        return cls(planned, maps, crossed_cells(states_m, grid.resolution_m))

    def table(self, shown: Mapping[str, str]) -> pd.DataFrame:
        """Return a row for each crossing: its place, the maps that are shown by their columns, roofs and clearance.

        Where the maps know which roofs are guessed, also whether the one beneath is, and how far the nearest is.

        Each takes the maps of the level nearest to it, as the planner did; of satellites and obstacles that below,
        where there are fewer of the ones and more of the others.
        """
        ends_m, grid = self.cut.ends_m, self.maps.grid
        middle, to_m = ends_m.mean(axis=1), np.cumsum(self.cut.length_m)
        lon, lat = grid.lonlat_of_xy(middle[:, 0] + grid.x_min_m, middle[:, 1] + grid.y_min_m)
        columns = {"from_m": to_m - self.cut.length_m, "to_m": to_m, "lon": lon, "lat": lat, "z_m": middle[:, 2]}
        levels_m = self.planned.settings.get("levels_m") or [self.planned.altitude_m]
        level_m, lowest_m = nearest_level_m(middle[:, 2], levels_m), ends_m[:, :, 2].min(axis=1)
        for name, column in {**shown, self._roofs: "roof_m", GUESSED: GUESSED}.items():
            if self.maps.variable(name) in self.maps.ds:
                columns[column] = self._sample(name, level_m)
        if VISIBLE in columns:
            columns[VISIBLE] = columns[VISIBLE].astype(int)
        if GUESSED in columns:
            is_over = columns[GUESSED] = columns[GUESSED].astype(bool)
            away_m = clearance_m(ends_m[:, :, :2], self.maps.m(GUESSED).astype(bool), grid.resolution_m)
            columns[TO_GUESSED] = np.where(is_over, 0.0, away_m)  # `clearance_m` leaves out what roofs surround
        columns[OVER_ROOF] = np.where(columns["roof_m"] > 0, lowest_m - columns["roof_m"], np.nan)
        below_m = level_below_m(lowest_m, levels_m)
        columns[OUTSIDE] = self._outside_m(level_below_m(below_m, self.maps.altitudes_m))
        columns[CLEARANCE] = np.empty(len(below_m))
        for z_m in np.unique(below_m):
            lines = ends_m[below_m == z_m, :, :2]
            columns[CLEARANCE][below_m == z_m] = clearance_m(lines, self._is_obstacle(float(z_m)), grid.resolution_m)
        return pd.DataFrame(columns)

    def _sample(self, name: str, level_m: np.ndarray) -> np.ndarray:
        """Return ``[M]`` float64 the values of a map in the cells crossed, each at its own level.

        Linear between the altitudes around a level; the upper's over an obstacle at the lower.
        """
        maps, settings, cells = self.maps, self.planned.settings, (self.cut.row, self.cut.col)
        when = {"time": settings["time"], "time_of_day": settings["time_of_day"]}
        if "altitude" not in maps.ds[maps.variable(name)].dims:
            return maps.m(name, **when)[cells].astype(float)

        def at(z_m: float, row: np.ndarray, col: np.ndarray) -> np.ndarray:
            return values_at(
                z_m,
                maps.altitudes_m,
                lambda held_m: maps.m(name, held_m, **when)[row, col],
                lambda held_m: maps.is_under_sky(held_m)[row, col],
                is_count=name == VISIBLE,
            )

        values = np.empty(len(level_m))
        for z_m in np.unique(level_m):
            values[level_m == z_m] = at(float(z_m), *(index[level_m == z_m] for index in cells))
        return values

    @property
    def _roofs(self) -> str:
        """The variable of roofs: the highest that touches a cell where the maps hold it, else that at its middle."""
        return TOUCHED if TOUCHED in self.maps.ds else "roof"

    def _is_obstacle(self, z_m: float) -> np.ndarray:
        """Return ``[Y, X]`` bool: a roof reaches a level."""
        if self._roofs == TOUCHED or z_m not in self.maps.altitudes_m:
            return self.maps.m(self._roofs) >= z_m
        return self.maps.m("obstacle", z_m) == 1

    def _outside_m(self, below_m: np.ndarray) -> np.ndarray:
        """Return ``[M]`` how far at least each crossing is from the obstacles outside the region.

        They stand beyond its border; and, since the risk metric counts them up to its threshold and measures between
        the middles of cells, at least its distance less two half diagonals away; ``below_m`` names the maps below each.
        """
        grid, attrs, ends = self.maps.grid, self.maps.ds.attrs, self.cut.ends_m[:, :, :2]
        side_m = np.array([grid.num_cols, grid.num_rows]) * grid.resolution_m
        border_m = np.minimum(ends, side_m - ends).min(axis=(1, 2))
        is_told = "risk_threshold_m" in attrs and "risk" in self.maps.ds
        if not is_told or UNDERSIDE in self.maps.ds:  # what hangs between two maps is in neither's slice
            return border_m
        risk = self._sample("risk", below_m)  # between two maps, the lower one has all obstacles
        # Over an obstacle of the map below no risk is known.
        return np.fmax(border_m, risk * attrs["risk_threshold_m"] - math.sqrt(2) * grid.resolution_m)


def cautious_profile(planned: PlannedPath, maps: MetricMaps) -> pd.DataFrame:
    """Return satellites, roofs and clearance along a route: the profile of a report without metrics and people.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    return RouteProfile.of(planned, maps).table({VISIBLE: VISIBLE})


def guessed_clearances(profile: pd.DataFrame) -> set[str]:
    """Return which least clearances, `CLEARANCE` and `OVER_ROOF`, rest on roofs of guessed height.

    The distance to buildings does where one of guessed height is as near, since it may reach the flight.
    """
    names, over_m = set(), profile[OVER_ROOF]
    if GUESSED in profile:
        if profile[TO_GUESSED].min() <= profile[[CLEARANCE, OUTSIDE]].to_numpy().min():
            names.add(CLEARANCE)
        if over_m.notna().any() and profile[GUESSED].iloc[int(np.nanargmin(over_m))]:
            names.add(OVER_ROOF)
    return names


def without_fix(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end along the route of each segment with too few satellites for a fix, metres."""
    if VISIBLE not in profile:
        return []
    is_short = np.concatenate([[False], profile[VISIBLE] < FEWEST_SATELLITES, [False]])
    changes = np.flatnonzero(is_short[1:] != is_short[:-1]).reshape(-1, 2)
    return [(float(profile["from_m"].iloc[a]), float(profile["to_m"].iloc[b - 1])) for a, b in changes]
