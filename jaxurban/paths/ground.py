"""The ground under a route: its elevation at the route's points and between them."""

from dataclasses import dataclass

import numpy as np

from jaxurban.world.grid import Grid

SAMPLES_A_CELL = 2  # the ground between cell centres bends little


@dataclass(frozen=True)
class Ground:
    """The ground under a path, at its points and between them. ``G`` places in order of travel.

    Attributes:
      at: ``[G]`` places along the path, counted in its points: 2.5 is halfway from the third point to the fourth.
      lonlat: ``[G, 2]`` longitude, latitude in degrees.
      elevation_m: ``[G]`` above the zero of the terrain file, whatever its vertical datum is.
    """

    at: np.ndarray
    lonlat: np.ndarray
    elevation_m: np.ndarray


def ground_along(points_m: np.ndarray, terrain_m: np.ndarray, grid: Grid) -> Ground:
    """Return the ground under a polyline, every half cell and at its points.

    Args:
      points_m: ``[N, 2]`` x, y from the grid's southwest corner, N at least 1.
      terrain_m: ``[Y, X]`` elevation of the ground in each cell.
      grid: of ``terrain_m``.
    """
    length_m = np.hypot(*np.diff(points_m, axis=0).T)
    per_leg = np.maximum(np.ceil(length_m * SAMPLES_A_CELL / grid.resolution_m), 1).astype(int)
    leg = np.repeat(np.arange(len(per_leg)), per_leg)
    within = np.arange(len(leg)) - np.repeat(np.cumsum(per_leg) - per_leg, per_leg)
    at = np.append(leg + within / per_leg[leg], len(points_m) - 1.0)
    number = np.arange(len(points_m))
    x_m, y_m = (np.interp(at, number, values) for values in points_m.T)
    lonlat = np.stack(grid.lonlat_of_xy(x_m + grid.x_min_m, y_m + grid.y_min_m), axis=-1)
    return Ground(at, lonlat, elevation_at(x_m, y_m, terrain_m, grid.resolution_m))


def elevation_at(x_m: np.ndarray, y_m: np.ndarray, terrain_m: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M]`` the elevation at points, bilinear between cell centres; that of the cell beside missing data.

    Args:
      x_m, y_m: ``[M]`` from the southwest corner.
      terrain_m: ``[Y, X]`` elevation at cell centres; as at the border beyond the outermost centres.
      resolution_m: side of a cell.
    """
    ends = np.array(terrain_m.shape) - 1
    place = np.clip(np.stack([y_m, x_m], axis=-1) / resolution_m - 0.5, 0, ends)
    low = np.minimum(place.astype(int), np.maximum(ends - 1, 0))
    high = np.minimum(low + 1, ends)
    up, right = (place - low).T
    (south, west), (north, east) = low.T, high.T
    terrain_m = terrain_m.astype(np.float64)
    smooth_m = (1 - up) * ((1 - right) * terrain_m[south, west] + right * terrain_m[south, east]) + up * (
        (1 - right) * terrain_m[north, west] + right * terrain_m[north, east]
    )
    own = np.rint(place).astype(int)
    return np.where(np.isnan(smooth_m), terrain_m[own[:, 0], own[:, 1]], smooth_m)
