"""Clearances: the cells that are closed because an obstacle stands nearer than a path may come.

A clearance is kept between the squares of cells, so that no point of a free cell is nearer to the outline of a
building, which lies within the cells that it touches. These distances come in steps: 0, 1, 1.41, 2, 2.24 ... cells.
What is asked beyond a step, up to half a cell, the legs of routes keep from closed cells; more closes the next step.
A straight line from a leg to an obstacle runs through closed cells last: so it is as long as both together, or longer.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from jaxurban.kernels.tolerances import FILE_MARGIN_M, SAME_LENGTH
from jaxurban.maps.rules import roof_limits_m
from jaxurban.settings import UnknownHeights

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.constraints import Constraints
    from jaxurban.planners.base import Cell

# Cell sides: steps between the centres of cells keep half a side from closed cells.
MOST_LEG_MARGIN = 0.49
MOST_STEPS = 10**5  # sides, more than maps have: their border is an obstacle, so all is closed


def reaches_m(
    maps: "MetricMaps", horizontal_m: float, unknown_heights: UnknownHeights
) -> tuple[np.ndarray, np.ndarray]:
    """Return up to which height above its ground what stands in each cell reaches, and may reach, ``[Y, X]`` each.

    The first is of known and guessed heights, the second the bound of the guessed ones (`roof_limits_m`), 0 where there
    is nothing. Where a horizontal distance is kept, a roof counts in every cell that it touches; otherwise where the
    maps' rule of obstacles counts it. One of guessed height counts in every cell that it touches, up to its bound.
    Cells without data reach to inf.

    Args:
      maps: the metric maps.
      horizontal_m: the distance that is kept from obstacles; 0 for none.
      unknown_heights: how high roofs of unknown height count.
    """
    name = "roof_touched" if horizontal_m or maps.obstacles == "touched" else "roof"
    roof_m, limit_m = maps.m(name), roof_limits_m(maps, unknown_heights)
    is_known = maps.ds["has_data"].values & ~np.isnan(roof_m) & ~np.isnan(limit_m)
    roof_m = np.where(is_known, roof_m, np.float32(np.inf))
    return roof_m, np.where(is_known, limit_m, np.float32(0))


def _over_lowest_ground_m(maps: "MetricMaps", reach_m: float) -> np.ndarray:
    """Return ``[Y, X]`` how much higher the ground of each cell is than the lowest known ground around it, metres.

    Around it are all cells within ``reach_m`` and, as the window is square and whole cells wide, some beyond. The
    result is 0 where the ground of the cell itself is not known.
    """
    from scipy.ndimage import minimum_filter

    ground_m = np.where(maps.ds["has_data"].values, maps.m("terrain"), np.inf)
    # One cell more, as the distance is between squares and not between centres.
    reach_cells = math.ceil(reach_m / maps.grid.resolution_m) + 1
    reach_cells = min(reach_cells, max(ground_m.shape))
    lowest_m = minimum_filter(ground_m, 2 * reach_cells + 1, mode="nearest")
    return np.subtract(ground_m, lowest_m, out=np.zeros_like(ground_m), where=np.isfinite(ground_m))


def limit_near_m(
    maps: "MetricMaps", cell: "Cell", horizontal_m: float, unknown_heights: UnknownHeights
) -> float:
    """Return up to which height roofs of guessed height may reach that stand in a cell or nearer than a clearance.

    The highest counts; 0 without such a roof, inf where nothing bounds one.

    Args:
      maps: the metric maps.
      cell: row and column.
      horizontal_m: the clearance.
      unknown_heights: how high roofs of unknown height count.
    """
    limit_m = roof_limits_m(maps, unknown_heights)
    away = np.indices(limit_m.shape) - np.reshape(cell, (2, 1, 1))
    is_near = _closes(away, horizontal_m, maps.grid.resolution_m)
    return float(np.nanmax(limit_m[is_near], initial=0.0))


def _closes(away: np.ndarray, horizontal_m: float, resolution_m: float) -> np.ndarray:
    """Return ``[Y, X]`` whether what stands so many rows and columns away, ``[2, Y, X]``, closes a cell."""
    away = np.abs(away)
    apart_m = np.hypot(*np.maximum(away - 1, 0)) * resolution_m
    step_m, _ = closing_step_m(horizontal_m, resolution_m)
    return (apart_m < step_m * (1 - SAME_LENGTH)) | (away.max(axis=0) == 0)


def highest_within(top_m: np.ndarray, horizontal_m: float, resolution_m: float) -> np.ndarray:
    """Return ``[Y, X]`` the highest of the cells that close each cell by a horizontal clearance, and of itself.

    These are the cells that `closed_by_clearance` looks at; inf where the maps' border is as near.

    Args:
      top_m: ``[Y, X]`` of each cell.
      horizontal_m: the clearance.
      resolution_m: side of a cell.
    """
    from scipy.ndimage import maximum_filter

    step_m, _ = closing_step_m(horizontal_m, resolution_m)
    reach = min(math.ceil(step_m / resolution_m), max(top_m.shape))
    away = np.indices((2 * reach + 1,) * 2) - reach
    is_near = _closes(away, horizontal_m, resolution_m)
    return maximum_filter(top_m, footprint=is_near, mode="constant", cval=np.inf)


def reach_said(limit_m: float) -> str:
    """Return how high what is of guessed height may reach, with the remedies, in words that go after "that"."""
    if math.isfinite(limit_m):
        return (
            f"may reach {limit_m:g} m (fly higher, give its height, or set [buildings] highest_m)"
        )
    return "may reach any height (give its height, or set [buildings] highest_m)"


def distance_to_obstacles_m(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[Y, X]`` exact distance from each cell's square to the nearest obstacle's, or to the maps' border.

    Squares that touch, by a side or a corner, are 0 apart. What stands beyond the border is not known, so that it
    counts as an obstacle.

    Args:
      is_obstacle: ``[Y, X]`` bool.
      resolution_m: side of a cell.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt

    # From a cell's centre to the obstacles grown by one cell all around it is as far as from square to square.
    grown = binary_dilation(np.pad(is_obstacle, 1, constant_values=True), np.ones((3, 3), bool))
    return distance_transform_edt(~grown)[1:-1, 1:-1] * resolution_m


def closing_step_m(horizontal_m: float, resolution_m: float) -> tuple[float, float]:
    """Return how a clearance is kept on cells: a distance below which cells are closed, and a margin of legs beside it.

    Distances between the squares of cells come in steps: 0, 1, 1.41, 2, 2.24 ... sides. The first value is the least
    step that the clearance exceeds by `MOST_LEG_MARGIN` sides or less; the second is that excess, which the legs of
    routes keep from closed cells, 0 where the step alone keeps the clearance. Both are metres, and `FILE_MARGIN_M` is
    included. From `MOST_STEPS` on steps are whole sides. A clearance of 0 gives 0 and 0: only the cells of obstacles
    themselves are closed.

    Args:
      horizontal_m: the clearance.
      resolution_m: side of a cell.
    """
    if horizontal_m == 0:
        return 0.0, 0.0
    clearance_sides = (horizontal_m + FILE_MARGIN_M) / resolution_m
    least = clearance_sides - MOST_LEG_MARGIN
    step = float(math.ceil(least))
    if least < MOST_STEPS:
        # Of each offset in rows the offsets in columns around the one that reaches the least distance.
        rows = np.arange(math.ceil(least) + 1)
        cols = np.ceil(np.sqrt(np.maximum(least**2 - rows**2, 0)))
        steps = np.hypot(rows, cols + np.array([[-1], [0], [1]]))
        step = float(steps[steps >= least].min())
    return step * resolution_m, max(0.0, clearance_sides - step) * resolution_m


def kept_m(horizontal_m: float, resolution_m: float) -> float:
    """Return the least distance of routes, in their files too, from obstacles under a horizontal clearance, metres.

    It is the clearance or, as distances between cells come in steps, more.
    """
    step_m, _ = closing_step_m(horizontal_m, resolution_m)
    return max(horizontal_m, step_m - FILE_MARGIN_M)


def closed_by_clearance(maps: "MetricMaps", altitude_m: float, limits: "Constraints") -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that clearances and roofs of unknown height close at an altitude above the ground.

    Obstacles are roofs (`reaches_m`) that reach the altitude, or end less than the vertical clearance below; over the
    bounds of unknown heights no more is kept, and bare ground is none. Over terrain the height of a roof is measured
    from the lowest ground within the horizontal clearance, since a path may pass it there. No margin is added to the
    vertical one for what a file may change, as files round heights up.

    Cells nearer to obstacles, or to the maps' border, than the step of `closing_step_m` are closed; the rest of the
    horizontal clearance and `FILE_MARGIN_M` the legs of routes keep from closed cells.
    """
    from jaxurban.world.surface import stands_at  # imported here: it brings JAX

    horizontal_m, resolution_m = limits.horizontal_m, maps.grid.resolution_m
    roof_m, limit_m = reaches_m(maps, horizontal_m, limits.of_unknown)
    if "terrain" in maps.ds:  # above the ground from which a path may pass it
        rise_m = _over_lowest_ground_m(maps, horizontal_m)
        roof_m = roof_m + (roof_m > 0) * rise_m
        limit_m = limit_m + (limit_m > 0) * rise_m
    is_obstacle = stands_at(roof_m, np.float32(altitude_m - limits.vertical_m))
    is_obstacle |= stands_at(limit_m, np.float32(altitude_m))
    # The maps' own obstacles count too, which are known at the altitudes of the maps alone.
    if altitude_m in maps.altitudes_m:
        is_obstacle |= maps.m("obstacle", altitude_m) != 0

    step_m, _ = closing_step_m(horizontal_m, resolution_m)
    if step_m == 0:
        return is_obstacle
    return distance_to_obstacles_m(is_obstacle, resolution_m) < step_m * (1 - SAME_LENGTH)
