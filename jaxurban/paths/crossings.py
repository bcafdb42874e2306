"""A route cut at cell borders, for everything that is summed along it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.ndimage import binary_erosion

from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.planners.cost import path_states

SAME_HEIGHT_M = 1e-6  # rounding of heights along a step


@dataclass(frozen=True, eq=False)
class RouteCrossings:
    """A route as steps, and each step as crossings of one cell. ``S`` steps, ``M`` crossings, in order of travel.

    A step ends where the ``cell`` cost model counts a cell; steps without length are left out. Points are metres
    from the map's southwest corner. A route of one point has no step, and one crossing of no length.

    Attributes:
      states: ``[S + 1, 3]`` x, y and altitude of the steps' ends.
      step: ``[M]`` the step of each crossing.
      row, col: ``[M]`` its cell.
      ground_m: ``[M]`` its length over the ground.
      length_m: ``[M]`` its length in the air: longer where the route climbs or descends.
      ends: ``[M, 2, 3]`` x, y, altitude of its start and end.
    """

    states: np.ndarray
    step: np.ndarray
    row: np.ndarray
    col: np.ndarray
    ground_m: np.ndarray
    length_m: np.ndarray
    ends: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """``[M, 3]`` x, y and altitude of the crossings' middles."""
        return self.ends.mean(axis=1)


def cut_route(points_m: np.ndarray, z_m: np.ndarray, resolution_m: float) -> RouteCrossings:
    """Return the crossings of a route.

    Args:
      points_m: ``[N, 2]`` x, y from the map's southwest corner.
      z_m: ``[N]`` altitude; it changes evenly between two points.
      resolution_m: side of a cell.
    """
    states = _states(points_m, z_m, resolution_m)
    ground_m = np.hypot(*np.diff(states[:, :2], axis=0).T)
    air_m = np.hypot(ground_m, np.diff(states[:, 2]))
    crossed = crossed_cells(states[:, :2], resolution_m)
    if not air_m.any():
        here, none = states[:1], np.zeros(1)
        return RouteCrossings(here, np.zeros(1, np.int64), crossed.row, crossed.col, none, none, here[None, [0, 0]])
    is_level = crossed.length_m > 0  # not so for a route that goes only up and down
    # Straight up or down: within one cell, half of it nearer to either end's altitude.
    climbs = np.repeat(np.flatnonzero((ground_m == 0) & (air_m > 0)), 2)
    climb_cells = np.floor(states[climbs, :2] / resolution_m).astype(np.int64)
    step = np.append(crossed.segment[is_level], climbs)
    order = np.argsort(step, kind="stable")
    step = step[order]
    row = np.append(crossed.row[is_level], climb_cells[:, 1])[order]
    col = np.append(crossed.col[is_level], climb_cells[:, 0])[order]
    over_m = np.append(crossed.length_m[is_level], np.zeros(len(climbs)))[order]
    is_climb = ground_m[step] == 0
    share = np.where(is_climb, 0.5, over_m / np.where(is_climb, 1.0, ground_m[step]))
    done = np.cumsum(share)
    is_first = np.append(True, step[1:] != step[:-1])
    before = done - share
    before -= np.maximum.accumulate(np.where(is_first, before, 0.0))
    ends = [states[step] + at[:, None] * (states[step + 1] - states[step]) for at in (before, before + share)]
    return RouteCrossings(states, step, row, col, over_m, share * air_m[step], np.stack(ends, axis=1))


def _states(points_m: np.ndarray, z_m: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return the ends of the steps with their altitudes, those of steps without length left out."""
    states = [np.append(points_m[0], z_m[0])[None]]
    for start, end, low_m, high_m in zip(points_m[:-1], points_m[1:], z_m[:-1], z_m[1:], strict=True):
        ends = path_states(np.stack([start, end]), resolution_m)[1:]
        length_m = np.hypot(*(end - start))
        share = np.hypot(*(ends - start).T) / length_m if length_m > 0 else np.ones(len(ends))
        height_m = np.where(share == 1, high_m, low_m + share * (high_m - low_m))  # a node's own, to the last bit
        states.append(np.column_stack([ends, height_m]))
    joined = np.concatenate(states)
    return joined[np.append(True, np.any(np.diff(joined, axis=0) != 0, axis=1))]


def cut_evenly(states: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step belongs to: at most ``most``, nearly equal.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs.
    """
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(states, axis=0), axis=1)))
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
